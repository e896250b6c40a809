//! Our update compared with other recursive least squares, on the same regressors in the same run.
//!
//! The motion is that of the EMPS axis (95 kg, stages of constant velocity, one count of 50 nm, 1 kHz), made here from
//! the law itself; 8 minutes of standstill follow, in which the encoder flickers by one count and the force is noise.
//! Each method gets the regressors `[a, v, sgn v, 1]` and the force that one matched kernel made of counts and force,
//! and forgets by 0.999 per update.
//!
//! Then each is asked what it can report: backlash with a terminal sensor, intervals that hold, a change of the device,
//! inertance in slow motion, on the regressors of the simulated device ([`cases`]).
//!
//! `bench regressors FILE` writes the regressors for `tests/python/bench_rivals.py`;
//! `bench compare [--python FILE | --without-python REASON] [--write FILE]` prints the table.

mod answers;
mod cases;
mod kernels;
mod machine;
mod methods;
mod report;
mod table;

use answers::Instrument;
use cases::Case;
use inerter_core::{RawSample, Settings, State};
use machine::{FORGETTING, MEMORY, METRES_PER_COUNT, NEWTONS_PER_CODE, RATE_HZ, Run, Update};
use methods::{Entry, METHODS, Ours, Tuning};
use report::Report;
use std::{
    error::Error,
    fs,
    hint::black_box,
    io::{BufWriter, Write},
    process::ExitCode as Exit,
    time::{Duration, Instant},
};
use table::{Line, Python, markdown};

fn main() -> Exit {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let result = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["regressors", file] => write_regressors(file),
        ["compare", ref options @ ..] => compare(options),
        _ => {
            Err("usage: bench regressors FILE | bench compare [--python FILE] [--without-python REASON] [--write FILE]"
                .into())
        }
    };
    match result {
        Ok(()) => Exit::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            Exit::FAILURE
        }
    }
}

/// Little-endian: `u64` motion updates, `u64` updates, then five `f64` an update; `u64` cases, then for each `f64`
/// forgetting, `u64` updates between two values written down or 0, `u64` updates, then five `f64` an update.
fn write_regressors(file: &str) -> Result<(), Box<dyn Error>> {
    let (run, cases) = (Run::new(), cases::all()?);
    let mut out = BufWriter::new(fs::File::create(file).map_err(|error| format!("cannot write {file}: {error}"))?);
    out.write_all(&(run.motion as u64).to_le_bytes())?;
    write_updates(&mut out, &run.updates)?;
    out.write_all(&(cases.len() as u64).to_le_bytes())?;
    for case in &cases {
        let track = if case.is_tracked() { cases::TRACK as u64 } else { 0 };
        out.write_all(&case.forgetting.to_le_bytes())?;
        out.write_all(&track.to_le_bytes())?;
        write_updates(&mut out, &case.updates)?;
    }
    Ok(out.flush()?)
}

fn write_updates(out: &mut impl Write, updates: &[Update]) -> std::io::Result<()> {
    out.write_all(&(updates.len() as u64).to_le_bytes())?;
    for update in updates {
        for value in update.phi.iter().chain([&update.target]) {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

/// Time of one run over `count` updates, the best of several \[ns per update\].
fn nanoseconds(count: usize, mut run: impl FnMut()) -> f64 {
    let mut best = f64::INFINITY;
    let start = Instant::now();
    let mut rounds = 0;
    while rounds < 5 || (start.elapsed() < Duration::from_millis(200) && rounds < 200) {
        let begin = Instant::now();
        run();
        best = best.min(begin.elapsed().as_secs_f64());
        rounds += 1;
    }
    best * 1e9 / count as f64
}

fn line(run: &Run, tuning: &Tuning, (name, arithmetic, _, fresh): &Entry) -> Line {
    let mut method = fresh(tuning);
    method.updates(run.motion());
    let motion = method.parameters();
    method.updates(&run.updates[run.motion..]);
    let rest = method.parameters();
    let nanoseconds = nanoseconds(run.motion, || {
        let mut method = fresh(tuning);
        method.updates(black_box(run.motion()));
        black_box(method.parameters());
    });
    let (name, arithmetic) = ((*name).into(), (*arithmetic).into());
    Line { name, arithmetic, nanoseconds, motion, rest, remark: method.remark() }
}

/// Our line: regressors are integers before the clock starts, as they are in the instrument.
fn our_line(run: &Run, tuning: &Tuning) -> Line {
    let integers: Vec<_> = run.motion().iter().map(|update| tuning.quantised(update)).collect();
    let time = nanoseconds(integers.len(), || {
        let mut ours = Ours::new(*tuning);
        black_box(&integers).iter().for_each(|regressors| ours.take(regressors));
        black_box(&ours);
    });
    Line { nanoseconds: time, ..line(run, tuning, &METHODS[0]) }
}

/// The whole instrument on the raw counts and codes: both banks, sign, gates, updates, solves and intervals.
fn instrument_line(run: &Run) -> Result<Line, Box<dyn Error>> {
    let settings = Settings {
        sample_rate_hz: RATE_HZ,
        metres_per_count: METRES_PER_COUNT,
        newtons_per_code: NEWTONS_PER_CODE,
        memory_s: f64::from(MEMORY) / RATE_HZ,
        ..Settings::default()
    };
    let active = settings.validate()?;
    let (moving, resting) = run.raw.split_at(run.moving);
    let mut state = State::new(&active);
    let mut parameters = |samples: &[RawSample]| {
        samples.iter().for_each(|sample| {
            active.step(&mut state, sample);
        });
        let recent = active.publish(&state).estimate.recent;
        [recent.inertance_kg, recent.viscous_n_s_per_m, recent.coulomb_n, recent.offset_n]
            .map(|one| f64::from(one.fitted().value))
    };
    let motion = parameters(moving);
    let rest = parameters(resting);
    let time = nanoseconds(moving.len(), || {
        let mut state = State::new(&active);
        for sample in black_box(moving) {
            black_box(active.step(&mut state, sample));
        }
    });
    Ok(Line {
        name: "ours: the whole instrument from raw counts (`Active::step`)".into(),
        arithmetic: "i32, i64".into(),
        nanoseconds: time,
        motion,
        rest,
        remark: "two banks, kernels, sign, gates, solves at 5 Hz; the same memory".into(),
    })
}

fn compare(options: &[&str]) -> Result<(), Box<dyn Error>> {
    let (mut python, mut without, mut write) = (None, None, None);
    let mut rest = options.iter();
    while let Some(&option) = rest.next() {
        let value = rest.next().ok_or_else(|| format!("{option}: a value is missing"))?;
        match option {
            "--python" => python = Some(*value),
            "--without-python" => without = Some(*value),
            "--write" => write = Some(*value),
            _ => return Err(format!("unknown option {option}").into()),
        }
    }
    let run = Run::new();
    let mut lines = rust_lines(&run)?;
    let cases: Vec<Case> = cases::all()?;
    let mut answers = answers::rust(&cases);
    if let Some(file) = python {
        let text = fs::read_to_string(file).map_err(|error| format!("cannot read {file}: {error}"))?;
        let python = Python::read(&text, cases.len()).map_err(|error| format!("{file}: {error}"))?;
        lines.extend(python.lines);
        answers.extend(python.answers);
    }
    answers::check_driving(&cases, &answers)?;
    let instrument = Instrument::new()?;
    let report = Report { cases: &cases, answers: &answers, instrument: &instrument };
    let table = markdown(&lines, without) + &report.markdown();
    print!("{table}");
    if let Some(file) = write {
        fs::write(file, &table).map_err(|error| format!("cannot write {file}: {error}"))?;
        println!("\nwritten {file}");
    }
    Ok(())
}

fn rust_lines(run: &Run) -> Result<Vec<Line>, Box<dyn Error>> {
    let tuning = tuning(run);
    let mut lines = vec![our_line(run, &tuning), instrument_line(run)?];
    lines.extend(METHODS[1..].iter().map(|entry| line(run, &tuning, entry)));
    Ok(lines)
}

/// The random walk forgets by the motion alone.
fn tuning(run: &Run) -> Tuning {
    Tuning { walk: Tuning::of(run.motion(), FORGETTING).walk, ..Tuning::of(&run.updates, FORGETTING) }
}

#[cfg(test)]
mod tests {
    use super::*;

    use machine::TRUTH;

    #[test]
    fn every_method_knows_the_machine_after_motion() {
        let run = Run::new();
        assert!(run.motion().iter().filter(|update| update.moving).count() > run.motion * 9 / 10);
        assert!(run.updates[run.motion + 100..].iter().all(|update| !update.moving));
        // One rival does not keep its covariance symmetric, and forgetting makes the halves drift apart.
        for line in rust_lines(&run).unwrap().iter().filter(|line| !line.name.contains("RlsParallel")) {
            assert!((line.motion[0] / TRUTH[0] - 1.0).abs() < 0.05, "{line:?}");
            assert!(line.nanoseconds > 0.0);
        }
    }

    #[test]
    fn ours_is_held_at_rest() {
        let run = Run::new();
        for line in [our_line(&run, &tuning(&run)), instrument_line(&run).unwrap()] {
            assert!((line.rest[0] / TRUTH[0] - 1.0).abs() < 0.01, "{line:?}");
        }
    }
}
