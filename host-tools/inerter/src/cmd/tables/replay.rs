//! Runs of a store through the estimator, all or a share of them: for Slurm and plain shells.

use inerter_analysis::results::replayed;
use inerter_data::{export::Source, json::machine_json, settings::Overrides, words::plural};
use inerter_store::{Outcome, Place, Store, StoreError};
use serde_json::{Value, json};

use crate::{
    Error,
    cmd::{
        args::FileSettingsArgs,
        print::print_json,
        shard::StoreArgs,
        terminal::{self, Progress, say},
    },
    error::Failure,
};

/// Replays the runs that the batch does not have yet. A run that fails is saved with its error, and the others
/// continue.
pub fn run(url: &str, args: &StoreArgs, settings: &FileSettingsArgs, as_json: bool) -> Result<(), Error> {
    terminal::catch_interrupts();
    let store = Store::open(url)?;
    let overrides = settings.overrides()?;
    let is_ours = |place: &Place| args.shard.is_none_or(|shard| shard.has(place));
    let ours: Vec<Place> = store.places()?.into_iter().filter(is_ours).collect();
    let given: Value = overrides.given().collect();
    let kept = if args.again { Default::default() } else { store.kept(&args.batch, "replay", &given)? };
    let todo: Vec<&Place> = ours.iter().filter(|place| !kept.contains(place.name())).collect();
    let mut bar = Progress::new("replaying", todo.len() as u64);
    let mut failed = 0;
    for (number, place) in todo.iter().enumerate() {
        let result = match last_line(&store, place, &overrides) {
            Ok(line) => Ok(line),
            Err(error) if terminal::interrupted() || is_of_store(&error) => return Err(error),
            // The run was removed meanwhile.
            Err(_) if !store.has_run(place)? => continue,
            Err(error) => Err((error.code().map(|code| code.to_string()).unwrap_or_default(), error.to_string())),
        };
        let error = result.as_ref().err().map(|(_, text)| text.clone());
        let outcome = Outcome { kind: "replay".into(), given: given.clone(), result };
        store.keep(&args.batch, place, &outcome)?;
        failed += usize::from(error.is_some());
        if as_json {
            print_json(&json!({"kind": "kept", "run": place.name(), "batch": args.batch, "error": error}))?;
        } else if let Some(error) = error {
            say(format!("error: {}: {error}", place.name()));
        }
        bar.set(number as u64 + 1);
    }
    bar.done();
    let before = ours.len() - todo.len();
    say(format!(
        "{} replayed, {failed} failed, {before} already done: batch `{}` of {url}",
        plural(todo.len() as u64, "run"),
        args.batch
    ));
    if failed > 0 { Err(Failure::NotReplayed { failed, of: todo.len() }.into()) } else { Ok(()) }
}

/// Whether the store, not the run, is at fault; such an error is not saved as a result.
fn is_of_store(error: &Error) -> bool {
    error.downcast_ref::<StoreError>().is_some_and(|error| !matches!(error, StoreError::Damaged { .. }))
}

/// The last line of `replay --json`.
fn last_line(store: &Store, place: &Place, overrides: &Overrides) -> Result<Value, Error> {
    let recording = store.local(place)?;
    let source = Source::open(recording.path(), overrides, |_| ())?;
    let samples = source.samples()?.map(|sample| sample.map_err(Error::from));
    let replayed = replayed(&source.settings, source.start_s, samples, |_, _| terminal::go_on().map_err(Error::from))?;
    // In the form in which it would be printed.
    Ok(serde_json::from_slice(&machine_json(source.settings.machine, &replayed.json(None))).unwrap_or_default())
}
