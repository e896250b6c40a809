//! `cargo xtask validation`: evidence for the intervals, from recordings of real machines and from other methods.
//!
//! Usage: validation --data FOLDER | validation --rivals FOLDER [--update]
//! The first form writes the data for the comparison, the second the table.

use inerter_core::{Bank, Parameter, Settings, Source};
use inerter_data::{replay::Outcome, run::Run};
use inerter_plant::{Inerter, Sensors};
use inerter_tests::{
    coverage::stated_true,
    data::{Recording, replayed},
    defects::draw::Draw,
    grid::{Result, calibrated, error, four, raw, rms, sensors, shaken, three, truth},
    sheet::{self, Asked, line, row, significant},
    sums::SEPARABLE,
    updates::{fit, left, rows},
};
use serde_json::{Value, json};
use std::{fs, path::Path};

/// Seed of the simulated data. No other test uses it.
const SEED: u64 = 5001;
/// Number of bootstrap resamplings.
const RESAMPLED: usize = 2000;
/// Lengths of the bootstrap blocks \[s\].
const BLOCKS_S: [f64; 3] = [0.5, 1.0, 2.0];
/// Number of parts into which a recording of the Lodz inerters is divided.
const PARTS: usize = 3;
/// The authors' own results for the EMPS record, by zero-phase least squares: mt, cf, fc.
const EMPS: [f64; 3] = [95.1089, 203.5034, 20.3935];

pub fn run(words: &[&str]) -> Result<bool> {
    match words {
        ["--data", folder] => write_data(Path::new(folder)).map(|()| true),
        ["--rivals", folder] => table(Path::new(folder), Asked::Compare),
        ["--rivals", folder, "--update"] => table(Path::new(folder), Asked::Update),
        _ => Err("usage: validation --data FOLDER | validation --rivals FOLDER [--update]".into()),
    }
}

/// One run for all methods.
struct Data {
    name: &'static str,
    run: Run,
    truth: [f64; 3],
    noise_n: f64,
}

/// The simulated runs, and the EMPS record if it is available.
fn data() -> Result<Vec<Data>> {
    // The other methods have no structure mass.
    let device = Inerter { structure_mass_kg: 0.0, ..Inerter::paper() };
    let mut all = Vec::new();
    for name in ["mid", "random", "two"] {
        let sensors = Sensors { encoder_phase_count: 0.4, seed: SEED, ..sensors() };
        let settings = stated_true(calibrated(&device, &sensors));
        let samples = shaken(&device, name, sensors)?.lasting(20.0).map(|sample| raw(&sample)).collect();
        let run = Run { settings, samples, ..Run::default() };
        all.push(Data { name, run, truth: truth(&device), noise_n: sensors.force_noise_n });
    }
    if let Some(run) = Recording::Emps.run(1) {
        // The noise of its force, estimated from fourth differences.
        all.push(Data { name: "EMPS", run: run?, truth: EMPS, noise_n: 1.0 });
    }
    Ok(all)
}

fn write_data(folder: &Path) -> Result<()> {
    let mut list = Vec::new();
    for Data { name, run, noise_n, .. } in data()? {
        let settings = &run.settings;
        let mut text = String::from("t_s,position_m,force_n\n");
        for (elapsed, sample) in run.elapsed() {
            let t_s = elapsed as f64 / settings.sample_rate_hz;
            let position_m = f64::from(sample.position_count) * settings.metres_per_count;
            let force_n = (f64::from(sample.force_code) - settings.force_zero_code) * settings.newtons_per_code;
            text += &format!("{t_s:.6},{position_m:.10e},{force_n:.10e}\n");
        }
        let file = format!("{}.csv", name.to_lowercase());
        fs::write(folder.join(&file), text)?;
        list.push(json!({"name": name, "file": file, "count_m": settings.metres_per_count, "noise_n": noise_n}));
    }
    Ok(fs::write(folder.join("data.json"), serde_json::to_string(&list)?)?)
}

/// Part of a run, by sample numbers.
fn part(run: &Run, from: usize, to: usize) -> Run {
    Run { samples: run.samples.get(from..to).unwrap_or_default().to_vec(), ..run.clone() }
}

fn value(parameter: &Parameter) -> f64 {
    f64::from(parameter.fitted().value)
}

fn values(outcome: &Outcome, settings: &Settings) -> [f64; 4] {
    let [mt, cf, fc, offset_n] = four(&outcome.estimate.whole_run).map(|parameter| value(&parameter));
    [mt + settings.structure_mass_kg, cf, fc, offset_n]
}

fn interval(parameter: &Parameter) -> String {
    match parameter.known() {
        Some(found) => format!("{} +- {}", significant(f64::from(found.value)), significant(f64::from(found.u95))),
        None => "not given".into(),
    }
}

fn table(folder: &Path, asked: Asked) -> Result<bool> {
    let mut text = String::from(
        "# Validation

`cargo xtask validation --update` writes this table. [VALIDATION](../VALIDATION.md) explains its
purpose.
",
    );
    text += &methods(folder)?;
    text += &another_plant(folder)?;
    if let Some(run) = Recording::Emps.run(1).transpose()? {
        text += &prediction(&run)?;
        text += &bootstrap(&run)?;
    }
    text += &scatter()?;
    print!("{text}");
    sheet::conclude("validation", &text, 2, asked)
}

fn read(folder: &Path, name: &str) -> Result<Vec<Value>> {
    let path = folder.join(name);
    let text = fs::read_to_string(&path).map_err(|error| format!("cannot read {}: {error}", path.display()))?;
    Ok(serde_json::from_str(&text)?)
}

/// The same data analysed with other methods.
fn methods(folder: &Path) -> Result<String> {
    let rivals = read(folder, "rivals.json")?;
    let mut text = String::from(
        "
## Identical data through other methods

Each cell is a value +- the half width of the 95 % interval that the method itself states. *off*:
distance of mt, cf and fc from the true value (for EMPS, from the published fit), in half widths of
that interval.

| data | method | mt kg | cf N s/m | fc N | off |
|---|---|--:|--:|--:|--:|
",
    );
    for Data { name, run, truth, .. } in data()? {
        let outcome = replayed(&run)?;
        let found = three(&outcome.estimate.whole_run);
        let pairs = found.map(|parameter| Some((value(&parameter), f64::from(parameter.u95()))));
        let mut add = |method: &str, pairs: [Option<(f64, f64)>; 3]| {
            let shown = pairs.map(|pair| match pair {
                Some((value, u95)) => format!("{} +- {}", sheet::mean(value, u95), significant(u95)),
                None => "-".into(),
            });
            let off = [0, 1, 2].map(|i| match pairs[i] {
                Some((value, u95)) => format!("{:.1}", (value - truth[i]).abs() / u95),
                None => "-".into(),
            });
            text += &row(&[name, method], shown.into_iter().chain([off.join(", ")]));
        };
        add("`inerter replay`", pairs);
        for rival in rivals.iter().filter(|rival| rival["name"] == name) {
            let of = |key: &str, i: usize| rival[key][i].as_f64();
            let pairs = std::array::from_fn(|i| of("values", i).zip(of("u95", i)));
            add(rival["method"].as_str().unwrap_or("?"), pairs);
        }
    }
    Ok(text)
}

/// Verdict on the runs of the plant written in Python.
fn another_plant(folder: &Path) -> Result<String> {
    let rows = read(folder, "plant.json")?;
    let mut text = String::from(
        "
## Another plant

This plant (`tests/python/plant.py`) has a motion in closed form, and computes the force by the law
at the moment of each sample. Nothing is integrated, and nothing elastic lies between friction and
load cell. The plant has set no constant. Its kinds of defects, sizes and draws are its own. Half of
the runs state a stiffness, so their flanks are known to be closed.

- *wrong*: the true value lies outside the interval that `inerter replay --json` gives. *reported*:
  the law is called broken, or a message names the defect. *assumed*: only `assumes` names it.
  *silent*: nothing does.
- *device: silent*: silent by the device's own intervals and messages.
- *any message*: runs with a warning or a cause.

| kind | runs | wrong: reported | assumed | silent | device: silent | called broken | any message |
|---|--:|--:|--:|--:|--:|--:|--:|
",
    );
    for row in &rows {
        let cells =
            ["kind", "runs", "told", "assumed", "silent", "device", "broken", "words"].map(|key| match &row[key] {
                Value::String(text) => text.clone(),
                number => number.to_string(),
            });
        text += &line(cells);
    }
    Ok(text)
}

/// The force of each half of the EMPS record, predicted from the other half.
fn prediction(run: &Run) -> Result<String> {
    let mut text = String::from(
        "
## Half of the EMPS record by the other half

- *predicted*: rms of this half's force minus the force that the other half's parameters predict
  from its motion. *own*: the same with the parameters of its own least squares. *force*: rms of the
  force itself. All three are taken from all updates, after the estimator's kernels.
- *apart*: distance between the halves' values of mt, cf and fc, relative to the root sum of squares
  of both intervals. With exact intervals, 95 % of such ratios are below 1.

| half | mt kg | cf N s/m | fc N | predicted N | own N | force N | apart |
|---|--:|--:|--:|--:|--:|--:|--:|
",
    );
    let middle = run.samples.len() / 2;
    let halves = [part(run, 0, middle), part(run, middle, run.samples.len())];
    let outcomes = [replayed(&halves[0])?, replayed(&halves[1])?];
    let found = outcomes.each_ref().map(|outcome| three(&outcome.estimate.whole_run));
    let apart = [0, 1, 2].map(|i| {
        let [first, second] = found.map(|found| found[i]);
        let both = f64::from(first.u95()).hypot(f64::from(second.u95()));
        format!("{:.1}", (value(&first) - value(&second)).abs() / both)
    });
    for (place, (half, name)) in halves.iter().zip(["first", "second"]).enumerate() {
        let rows = rows(&half.settings, &half.samples, Bank::Fast)?;
        let own = fit(rows.iter().copied(), SEPARABLE).ok_or("a half that shows nothing")?;
        let other = values(&outcomes[1 - place], &half.settings);
        let of = |values: &[f64; 4]| significant(rms(rows.iter().map(|row| left(values, row))));
        let shown = found[place].map(|parameter| interval(&parameter));
        let figures = [of(&other), of(&own), significant(rms(rows.iter().map(|row| row[4]))), apart.join(", ")];
        text += &row(&[name], shown.into_iter().chain(figures));
    }
    Ok(text)
}

/// The scatter of the EMPS parameters over resampled residuals.
fn bootstrap(run: &Run) -> Result<String> {
    let outcome = replayed(run)?;
    let rows = rows(&run.settings, &run.samples, Bank::Fast)?;
    let values = fit(rows.iter().copied(), SEPARABLE).ok_or("a record that shows nothing")?;
    let residuals: Vec<f64> = rows.iter().map(|row| left(&values, row)).collect();
    let budgets = outcome.budgets.whole_run;
    let mut text = format!(
        "
## Block bootstrap of the EMPS residuals

Half widths of 95 % intervals. *blocks*: of {RESAMPLED} fits to the fitted force with residuals that are
drawn in blocks of neighbours (circular, {} updates). *estimator*: as the estimator states them,
from scatter alone (`noise` and `encoder` of its budget), with the misfit of the law, and from all
sources.

| by | mt kg | cf N s/m | fc N |
|---|--:|--:|--:|
",
        rows.len()
    );
    let mut random = Draw::new(SEED, 1);
    for block_s in BLOCKS_S {
        // Two updates per box of 16 ms.
        let block = (block_s / 0.008) as usize;
        let mut fits: Vec<[f64; 4]> = Vec::new();
        for _ in 0..RESAMPLED {
            let mut resampled = rows.clone();
            for (rows, own) in resampled.chunks_mut(block).zip(residuals.chunks(block)) {
                let from = (random.unit() * residuals.len() as f64) as usize;
                let others = residuals[from..].iter().chain(&residuals);
                for ((row, own), other) in rows.iter_mut().zip(own).zip(others) {
                    row[4] = row[4] - own + other;
                }
            }
            fits.extend(fit(resampled.into_iter(), SEPARABLE));
        }
        let widths = (0..3).map(|i| {
            let mut all: Vec<f64> = fits.iter().map(|values| values[i]).collect();
            all.sort_by(f64::total_cmp);
            let at = |part: f64| all[(part * all.len() as f64) as usize];
            significant(0.5 * (at(0.975) - at(0.025)))
        });
        text += &row(&[&format!("blocks of {block_s} s")], widths);
    }
    for (name, sources) in [
        ("estimator, scatter", &[Source::Noise, Source::Encoder][..]),
        ("estimator, scatter and misfit", &[Source::Noise, Source::Encoder, Source::Model]),
        ("estimator, all sources", &Source::ALL),
    ] {
        let widths = budgets.iter().take(3).map(|budget| {
            let parts = sources.iter().map(|source| f64::from(budget.given_u95(*source)).powi(2));
            significant(parts.sum::<f64>().sqrt())
        });
        text += &row(&[name], widths);
    }
    Ok(text)
}

/// Parts of the Lodz recordings compared with their intervals.
fn scatter() -> Result<String> {
    let mut text = format!(
        "
## Scatter of the Lodz recordings

Each recording is divided into {PARTS} consecutive parts of the same length. Each part is estimated on
its own. *off*: distance of the part's value from that of the whole recording, relative to the
part's interval.

| recording | part | mt kg | cf N s/m | fc N | off: mt | cf | fc |
|---|---|--:|--:|--:|--:|--:|--:|
"
    );
    for (recording, name) in [(Recording::LodzSymmetric, "r0"), (Recording::LodzAsymmetric, "r16")] {
        let Some(run) = recording.run(1).transpose()? else { continue };
        let whole = three(&replayed(&run)?.estimate.whole_run);
        let length = run.samples.len() / PARTS;
        let parts = (0..PARTS).map(|place| part(&run, place * length, (place + 1) * length));
        let mut rows = vec![("whole".to_string(), whole)];
        for (place, part) in parts.enumerate() {
            rows.push(((place + 1).to_string(), three(&replayed(&part)?.estimate.whole_run)));
        }
        for (place, found) in rows {
            let shown = found.map(|parameter| interval(&parameter));
            let off = found.iter().zip(&whole).map(|(found, whole)| match found.known() {
                Some(interval) if place != "whole" => {
                    let (error, u95) = error(interval, value(whole));
                    format!("{:.2}", error.abs() / u95)
                }
                _ => "-".into(),
            });
            text += &row(&[name, &place], shown.into_iter().chain(off));
        }
    }
    Ok(text)
}
