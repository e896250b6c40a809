//! CSV files with samples or motions.
//!
//! Input: a byte (bit 0: a motion instead of samples; the other bits: which settings are given), then the file.
//!
//! Properties: a table has complete columns of finite numbers, and its times increase. A table that is written out
//! reads back unchanged. A run made from it has valid settings and at least two samples, and can be replayed. Every
//! error can be displayed.

use std::fmt::Write;

use inerter_core::Machine;
use inerter_data::{
    csv::{self, Table, column_names, motion, parse, timebase},
    replay::Replay,
    run::Run,
    series::Series,
    settings::Overrides,
};
use inerter_plant::{Excitation, Inerter, Sensors, Simulation};
use miette::Diagnostic;

use crate::input::{Input, seed};

/// Settings given or not, by the bits of the first byte from bit 1 on.
const GIVEN: [(&str, f64); 7] = [
    ("metres_per_count", 2.44e-6),
    ("newtons_per_code", 0.002),
    ("sample_rate_hz", 1_000.0),
    ("terminal_sensor", 0.0),
    ("machine", 1.0),
    ("metres_per_terminal_code", 1e-7),
    ("force_zero_code", -1_000.0),
];

/// Maximum number of samples to replay.
const REPLAYED: usize = 1_000;

/// Checks an input.
pub fn check(mut input: Input) {
    let kind = input.byte();
    if kind & 1 == 1 { check_motion(input.rest()) } else { check_samples(kind >> 1, input.rest()) }
}

/// What was read; an error is displayed.
pub fn shown<T>(read: Result<T, impl Diagnostic>) -> Option<T> {
    read.inspect_err(|error| show(error)).ok()
}

/// Displays an error with its help and its place in the file.
pub fn show(error: &dyn Diagnostic) {
    let help = error.help().map(|help| help.to_string());
    assert!(!error.to_string().is_empty() && help.is_none_or(|help| !help.is_empty()));
    for label in error.labels().into_iter().flatten() {
        let source = error.source_code().expect("a place has a text");
        source.read_span(label.inner(), 1, 1).expect("the place lies in the text");
    }
}

fn check_motion(bytes: &[u8]) {
    let Some(read) = shown(motion::parse("m.csv", bytes)) else { return };
    assert!(read.period_s > 0.0 && read.period_s.is_finite() && read.terminal_m.len() >= 8);
    assert!(read.terminal_m.iter().all(|value| value.is_finite()));
}

fn check_samples(given: u8, bytes: &[u8]) {
    let Some(table) = shown(parse("r.csv", bytes)) else { return };
    let length = table.t_s.len();
    assert!(length > 0 && table.encoder_count.len() == length && table.force_n.len() == length);
    assert!(table.line.len() == length && [0, length].contains(&table.terminal_m.len()));
    assert!(table.t_s.windows(2).all(|pair| pair[0] < pair[1]) && table.line.windows(2).all(|pair| pair[0] < pair[1]));
    assert!([&table.t_s, &table.force_n, &table.terminal_m].iter().all(|all| all.iter().all(|one| one.is_finite())));
    let again = parse("r.csv", text(&table).as_bytes()).expect("what was written is read");
    assert!(again.t_s == table.t_s && again.encoder_count == table.encoder_count && again.machine == table.machine);
    assert!(again.force_n == table.force_n && again.terminal_m == table.terminal_m);
    if let Ok(timebase) = timebase::find("r.csv", &table.t_s, table.time_decimals) {
        assert!(timebase.rate_hz > 0.0 && timebase.index.windows(2).all(|pair| pair[0] < pair[1]), "{timebase:?}");
    }
    let mut overrides = Overrides::default();
    for (bit, (name, value)) in GIVEN.into_iter().enumerate() {
        if given >> bit & 1 == 1 {
            overrides.set(name, value, "given").expect("a value that may be");
        }
    }
    match csv::to_run(table, &overrides) {
        Ok(run) => check_run(&run),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

fn check_run(run: &Run) {
    assert!(run.samples.len() >= 2 && run.start_s.is_finite());
    assert!(run.duration_s() >= 0.0 && run.elapsed().count() == run.samples.len());
    let series = Series::of(run);
    let mut values = series.stretches.iter().flat_map(|stretch| stretch.position_m.iter().chain(&stretch.force_n));
    assert!(values.all(|value| value.is_finite()));
    check_replay(run, REPLAYED);
}

/// Replays up to this many samples of a run.
pub fn check_replay(run: &Run, most: usize) {
    if let Ok(mut replay) = Replay::new(&run.settings, run.start_s) {
        run.samples.iter().take(most).for_each(|sample| replay.step(sample).for_each(drop));
        assert!(replay.outcome().t_s.is_finite());
    }
}

/// A table as a CSV file.
fn text(table: &Table) -> String {
    let (force, terminal) = column_names(table.machine);
    let has_terminal = !table.terminal_m.is_empty();
    let mut text =
        format!("t_s,encoder_count,{force}{}\n", if has_terminal { format!(",{terminal}") } else { String::new() });
    for (row, t_s) in table.t_s.iter().enumerate() {
        // Writing to a String cannot fail.
        let _ = write!(text, "{t_s:?},{},{:?}", table.encoder_count[row], table.force_n[row]);
        if let Some(terminal) = table.terminal_m.get(row) {
            let _ = write!(text, ",{terminal:?}");
        }
        text.push('\n');
    }
    text
}

/// Runs and motions of the plant, as this program and others write them.
pub fn seeds() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for (kind, sample_rate_hz, count) in
        [(0b10, 1_000.0, 40), (0b110, 4_096.0, 20), (0b10, 10_000.0, 60), (0b1010, 333.0, 12)]
    {
        let excitation = Excitation::preset("mid", 1).expect("a motion of the plant");
        let sensors = Sensors { sample_rate_hz, ..Sensors::default() };
        let simulation = Simulation::new(Inerter::paper(), excitation, sensors).expect("a plant");
        let mut table = Table::default();
        for sample in simulation.skip(700).take(count) {
            table.t_s.push((sample.t_s * 1e6).round() / 1e6);
            table.encoder_count.push(sample.position_count.into());
            table.force_n.push(f64::from(sample.force_code) * 2e-3);
        }
        let plain = text(&table);
        seeds.push(seed(&[kind], &plain));
        let european = plain.replace(',', ";").replace('.', ",");
        seeds.push(seed(&[kind], format!("# a comment\r\n\r\n{}", european.replace('\n', "\r\n"))));
        table.machine = Machine::Rotary;
        table.terminal_m = table.t_s.iter().map(|t_s| t_s.sin()).collect();
        seeds.push(seed(&[kind | 0b100000], text(&table)));
        seeds.push(seed(&[kind], text(&table).replace(',', "\t").replace("force", "\"force\"")));
        // With a missing sample, and truncated.
        table.t_s.drain(5..6);
        table.machine = Machine::Linear;
        let cut = text(&table);
        seeds.push(seed(&[kind], &cut[..cut.len() - 4]));
    }
    let point = |k: u32| {
        let t_s = f64::from(k) * 1e-3;
        motion::Point { t_s, terminal_m: t_s.sin(), velocity_m_per_s: t_s.cos(), acceleration_m_per_s2: 0.0 }
    };
    for machine in [Machine::Linear, Machine::Rotary] {
        seeds.push(seed(&[1], motion::text(machine, &["a motion".into()], (0..20).map(point))));
    }
    for other in
        [&b"PK\x03\x04"[..], b"\xff\xfet\0_\0", b"t_s,encoder_count,force_n\n0,1.5,2\n", b"1,2,3\n", b"time;count\n"]
    {
        seeds.push(seed(&[2], other));
    }
    seeds
}
