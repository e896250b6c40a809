//! `inerter store`: runs kept in a folder or in S3, with tables that other programs query.

use std::collections::BTreeSet;

use inerter_analysis::results::LimitsJson;
use inerter_core::Machine;
use inerter_data::{
    json::{json_line, machine_json},
    limits::{Judged, Verdict, verdict},
    output::{self, refuse_existing},
    words::{csv_text, interval_text, plural, printable, shortened_to},
};
use inerter_store::{Choice, Condition, Damage, OBJECTS, Place, Row, Store, StoreError};
use serde_json::{Value, json};

use crate::{
    Error,
    cmd::{
        limits::{Held, heard, judged_line, prove},
        print::{aligned, csv_line, print_json},
        store::{AddArgs, Args, Command, GetArgs, ListArgs, RemoveArgs, ShowArgs, VerifyArgs},
        terminal::{self, Progress, say, tidy_at_interrupts},
    },
    error::{DialogueError, Failure, Shown},
};

/// Characters of a run's name that a table shows.
const SHORT: usize = 12;
/// Characters of another cell that a table shows; JSON and CSV have all of them.
const CELL: usize = 60;
/// Characters of a value that `show` prints.
const VALUE: usize = 200;
/// Maximum number of columns of a CSV: ours have about 50 for each kind of machine. Each row has a cell for each column
/// of all rows, so rows with columns of their own would make it grow with the square of their number.
const MOST_CSV_COLUMNS: usize = 1024;

pub fn run(args: &Args) -> Result<(), Error> {
    match &args.command {
        Command::Add(args) => add(args),
        Command::Ls(args) => list(&args.url, &args.list, &[]),
        Command::Query(args) => list(&args.url, &args.list, &args.conditions),
        Command::Show(args) => show(args),
        Command::Get(args) => get(args),
        Command::Verify(args) => verify(args),
        Command::Remove(args) => remove(args),
    }
}

/// Works on the store and shows the progress; Ctrl-C stops the work.
fn watched<T>(label: &'static str, work: impl FnOnce(&mut dyn FnMut(f64) -> Result<(), StoreError>) -> T) -> T {
    let mut bar = Progress::new(label, 1000);
    let done = work(&mut |part| {
        bar.set_part(part);
        Ok(terminal::go_on()?)
    });
    bar.done();
    done
}

fn add(args: &AddArgs) -> Result<(), Error> {
    terminal::catch_interrupts();
    let store = Store::create(&args.url)?;
    let mut failed = 0;
    for file in &args.files {
        let name = file.display().to_string();
        match watched("adding", |progress| store.add(file, progress)) {
            Ok(added) => {
                let (run, is_new) = (added.row.name(), added.is_new);
                if args.json {
                    print_json(&json!({"kind": "added", "file": name, "run": run, "new": is_new}))?;
                } else {
                    let how = if is_new { "added" } else { "already there" };
                    output::line(format!("{name}: {how} as {}", short(added.row.place())))?;
                }
            }
            Err(error @ StoreError::Data(inerter_data::Error::Interrupted)) => return Err(error.into()),
            // There is no other file; or the store is at fault, and the other files would fail too.
            Err(error)
                if args.files.len() == 1
                    || !matches!(
                        error,
                        StoreError::Data(_)
                            | StoreError::NoRecording { .. }
                            | StoreError::Changed { .. }
                            | StoreError::LongTexts { .. }
                    ) =>
            {
                return Err(error.into());
            }
            Err(error) => {
                failed += 1;
                say(format!("error: {}", Shown(error.into())));
            }
        }
    }
    if failed > 0 { Err(Failure::NotAdded { failed, of: args.files.len() }.into()) } else { Ok(()) }
}

fn short(place: &Place) -> &str {
    place.name().get(..SHORT).unwrap_or_default()
}

/// The beginning of a text as it may be shown: a file of the store may hold one of any length.
fn cut(text: &str, letters: usize) -> String {
    shortened_to(letters, &printable(text)).into_owned()
}

fn list(url: &str, args: &ListArgs, conditions: &[String]) -> Result<(), Error> {
    let conditions = conditions.iter().map(|text| text.parse()).collect::<Result<Vec<Condition>, _>>()?;
    args.limits.check([], [], args.force)?;
    let choice = Choice { device: args.device.clone(), from: args.from.clone(), to: args.to.clone(), conditions };
    let listed = Store::open(url)?.runs(&choice)?;
    listed.damages.iter().for_each(|damage| say(format!("error: {}: {}", damage.file, damage.problem)));
    // Before anything is judged and written.
    let columns = args.csv.then(|| csv_columns(url, &listed.rows)).transpose()?;
    let runs = judged(args, &listed.rows)?;
    let said = heard(print(args, &runs, columns.as_deref()), true);
    intact(url, &listed.damages)?;
    if args.limits.are_given() && runs.is_empty() {
        return Err(Failure::NothingHeld.into());
    }
    prove(&held(&runs)).and(said)
}

/// A run with its verdicts, if there are limits.
type Run<'a> = (&'a Row, Option<Vec<Judged>>);

/// Checks each run against the limits, and writes the files that hold the verdicts.
fn judged<'a>(args: &ListArgs, rows: &'a [Row]) -> Result<Vec<Run<'a>>, Error> {
    let of = |machine: Machine| match rows.iter().any(|row| row.machine() == machine) {
        true => args.limits.read(machine),
        false => Ok(None),
    };
    let (linear, rotary) = (of(Machine::Linear)?, of(Machine::Rotary)?);
    if rows.is_empty() {
        // Report a mistake in the limits file even if there are no runs.
        args.limits.read(Machine::Linear).or_else(|error| args.limits.read(Machine::Rotary).map_err(|_| error))?;
    }
    let judged = |row: &'a Row| {
        let limits = if row.machine() == Machine::Linear { &linear } else { &rotary };
        (row, limits.as_ref().map(|limits| row.within(limits)))
    };
    let runs: Vec<Run> = rows.iter().map(judged).collect();
    args.limits.write(args.force, &held(&runs))?;
    Ok(runs)
}

fn held<'a>(runs: &'a [Run]) -> Vec<Held<'a>> {
    let of = |(row, judged): &'a Run| {
        let judged = judged.as_deref()?;
        Some(Held { run: row.name().into(), is_file: false, machine: row.machine(), judged })
    };
    runs.iter().filter_map(of).collect()
}

/// Fails if files of the store are damaged.
fn intact(url: &str, damages: &[Damage]) -> Result<(), Error> {
    let files = damages.len();
    if files == 0 { Ok(()) } else { Err(Failure::StoreDamage { url: url.into(), files }.into()) }
}

fn print(args: &ListArgs, runs: &[Run], columns: Option<&[&str]>) -> Result<(), Error> {
    if args.json {
        let mut lines = runs.iter().map(|(row, judged)| {
            let mut line = json!(row);
            if let Some(judged) = judged {
                let limits = machine_json(row.machine(), &LimitsJson::new(judged));
                line["limits"] = serde_json::from_slice(&limits).unwrap_or_default();
            }
            json_line(&line)
        });
        return Ok(lines.try_for_each(output::line)?);
    }
    if let Some(columns) = columns {
        return csv(args, runs, columns);
    }
    if runs.is_empty() {
        say("no run matches");
        return Ok(());
    }
    let mut head: Vec<String> =
        ["run", "device", "date", "length", "inertance", "viscous", "Coulomb", "law"].map(String::from).into();
    head.extend(args.limits.are_given().then(|| "limits".to_string()));
    let mut table = vec![head];
    table.extend(runs.iter().map(|(row, judged)| {
        let verdict = judged.as_deref().map(|judged| verdict(judged).to_string());
        cells(row).iter().map(|cell| cut(cell, CELL)).chain(verdict).collect()
    }));
    aligned(&table, "  ").iter().try_for_each(output::line)?;
    for (row, judged) in runs {
        let unproven = judged.iter().flatten().filter(|judged| judged.verdict != Verdict::Pass);
        let said = |judged: &Judged| format!("{}  {}", short(row.place()), judged_line(row.machine(), judged));
        unproven.map(said).try_for_each(output::line)?;
    }
    say(plural(runs.len() as u64, "run"));
    Ok(())
}

/// The cells of a run in the list for a person.
fn cells(row: &Row) -> [String; 8] {
    // Columns of a linear machine, or of a rotary one.
    let value = |columns: [(&str, &str, &str); 2]| {
        let known = columns.into_iter().find_map(|(name, u95, unit)| Some((row.number(name)?, row.number(u95)?, unit)));
        known.map_or("-".into(), |(value, u95, unit)| format!("{} {unit}", interval_text(value, u95)))
    };
    [
        short(row.place()).to_string(),
        row.device().to_string(),
        row.date().to_string(),
        row.number("duration_s").map_or("-".into(), |seconds| format!("{seconds:.1} s")),
        value([("inertance_kg", "inertance_u95_kg", "kg"), ("inertia_kg_m2", "inertia_u95_kg_m2", "kg m²")]),
        value([
            ("viscous_n_s_per_m", "viscous_u95_n_s_per_m", "N s/m"),
            ("viscous_n_m_s", "viscous_u95_n_m_s", "N m s"),
        ]),
        value([("coulomb_n", "coulomb_u95_n", "N"), ("coulomb_n_m", "coulomb_u95_n_m", "N m")]),
        row.text("law").unwrap_or("-").to_string(),
    ]
}

/// Columns that hold objects, for programs.
fn is_object(name: &&str) -> bool {
    OBJECTS.contains(name)
}

/// All columns of the rows except objects; a rotary machine has other columns.
fn csv_columns<'a>(url: &str, rows: &'a [Row]) -> Result<Vec<&'a str>, Error> {
    let mut known = BTreeSet::new();
    let columns = rows.iter().flat_map(Row::columns).filter(|name| !is_object(name));
    let names: Vec<&str> = columns.filter(|name| known.insert(*name)).take(MOST_CSV_COLUMNS + 1).collect();
    if names.len() > MOST_CSV_COLUMNS {
        return Err(Failure::WideCsv { url: url.into(), most: MOST_CSV_COLUMNS }.into());
    }
    Ok(names)
}

/// These columns, and the verdict if there are limits.
fn csv(args: &ListArgs, runs: &[Run], names: &[&str]) -> Result<(), Error> {
    let cell = |value: Option<Value>| match value {
        Some(Value::String(text)) => csv_text(&text).into_owned(),
        Some(value @ (Value::Array(_) | Value::Object(_))) => csv_text(&value.to_string()).into_owned(),
        Some(value) => value.to_string(),
        None => String::new(),
    };
    let limits = args.limits.are_given().then(|| "limits".to_string());
    output::lines(csv_line(names.iter().map(|name| csv_text(name).into_owned()).chain(limits)))?;
    // Lines are printed as they are made: rows with columns of their own make each other longer.
    for (row, judged) in runs {
        let verdict = judged.as_deref().map(|judged| verdict(judged).to_string().to_lowercase());
        output::lines(csv_line(names.iter().map(|name| cell(row.get(name))).chain(verdict)))?;
    }
    Ok(())
}

fn show(args: &ShowArgs) -> Result<(), Error> {
    let store = Store::open(&args.url)?;
    let row = store.row(&store.find(&args.run)?)?;
    if args.json {
        return print_json(&row);
    }
    let name_width = row.columns().map(|name| cut(name, CELL).chars().count()).max().unwrap_or(0);
    for name in row.columns().filter(|name| !is_object(name)) {
        let value = match row.get(name) {
            None => "-".to_string(),
            Some(Value::String(text)) => text,
            Some(value) => value.to_string(),
        };
        output::line(format!("{:<name_width$}  {}", cut(name, CELL), cut(&value, VALUE)))?;
    }
    let file = store.file(row.place()).map(|file| file.display().to_string());
    Ok(file.map_or(Ok(()), |file| output::line(format!("{:<name_width$}  {file}", "recording")))?)
}

fn get(args: &GetArgs) -> Result<(), Error> {
    tidy_at_interrupts();
    if !args.force {
        refuse_existing(&args.output)?;
    }
    let store = Store::open(&args.url)?;
    let place = store.find(&args.run)?;
    store.get(&place, &args.output, args.force)?;
    say(format!("{} written to {}", short(&place), args.output.display()));
    Ok(())
}

fn verify(args: &VerifyArgs) -> Result<(), Error> {
    terminal::catch_interrupts();
    let store = Store::open(&args.url)?;
    if args.repair {
        let count = watched("repairing", |progress| store.repair(progress))?;
        say(format!("{} repaired", plural(count as u64, "run")));
    }
    let verified = watched("reading", |progress| store.verify(progress))?;
    let (runs, damages) = (verified.runs, verified.damages);
    for damage in &damages {
        if args.json {
            let (run, file, problem) = (&damage.run, &damage.file, damage.problem);
            print_json(&json!({"kind": "damage", "run": run, "file": file, "problem": problem}))?;
        } else {
            output::line(format!("{:<10}  {}", damage.problem, damage.file))?;
        }
    }
    if args.json {
        print_json(&json!({"kind": "verified", "store": args.url, "runs": runs, "damages": damages.len()}))?;
    } else if damages.is_empty() {
        output::line(format!("{}: every file is as it was written", plural(runs as u64, "run")))?;
    }
    intact(&args.url, &damages)
}

fn remove(args: &RemoveArgs) -> Result<(), Error> {
    tidy_at_interrupts();
    let store = Store::open(&args.url)?;
    // Find all runs before the first one is removed.
    let places = args.runs.iter().map(|run| store.find(run)).collect::<Result<BTreeSet<Place>, _>>()?;
    if !args.yes && !terminal::can_ask() {
        return Err(DialogueError::UnconfirmedRemoval.into());
    }
    let question = format!("Remove {} and the recording with each? [y/N]", plural(places.len() as u64, "run"));
    if !args.yes && !terminal::is_confirmed(&question) {
        say("nothing was removed");
        return Ok(());
    }
    for place in &places {
        store.remove(place)?;
        output::line(format!("{} removed", short(place)))?;
    }
    Ok(())
}
