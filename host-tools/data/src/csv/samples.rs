//! Converts columns of SI numbers to the counts and codes that a board would have delivered.
//!
//! Rates above 5000 Hz are decimated as on the board: the counts of N samples are summed, their forces averaged. The
//! force scale is the power of two at which the largest force uses a little under 22 bits.

use inerter_core::{RawSample, Settings};

use super::{
    error::CsvError,
    read::{Table, column_names},
    timebase::{self, Timebase},
};
use crate::{
    error::Error,
    full_scale::Peaks,
    run::Run,
    series::Series,
    settings::{Overrides, range_of},
    words::plural,
};

/// `max |F| * 1.25` may reach this code at most.
const FULL_SCALE_CODE: f64 = 4_194_304.0;

/// Quantises a table; `overrides` must hold `metres_per_count`.
pub fn to_run(mut table: Table, overrides: &Overrides) -> Result<Run, Error> {
    let file = table.file.clone();
    if overrides.get("metres_per_count").is_none() {
        return Err(CsvError::MetresPerCount { file }.into());
    }
    let mut settings = Settings::default();
    overrides.apply(&mut settings)?;
    if overrides.get("machine").is_none() {
        settings.machine = table.machine;
    }
    let (force_column, terminal_column) = column_names(table.machine);
    if settings.machine != table.machine {
        let (force, terminal) = column_names(settings.machine);
        let set = settings.machine as u8;
        return Err(CsvError::Machine { file, column: force_column, set, force, terminal }.into());
    }
    let timebase = timebase::find(&file, &table.t_s, table.time_decimals)?;
    let mut notes = std::mem::take(&mut table.notes);
    notes.extend(timebase_notes(&file, &timebase));

    let group = set_rate(&file, &mut settings, timebase.rate_hz, overrides.get("sample_rate_hz"))?;
    if group > 1 {
        settings.oversampling *= group as f64;
        notes.push(format!(
            "{file}: {} Hz is reduced to {} Hz by summing {group} samples into one",
            timebase.rate_hz, settings.sample_rate_hz
        ));
    }
    if overrides.get("newtons_per_code").is_none() {
        settings.newtons_per_code = scale(&table.force_n, 1e3);
    }
    if !table.terminal_m.is_empty() {
        if overrides.get("metres_per_terminal_code").is_none() {
            settings.metres_per_terminal_code = scale(&table.terminal_m, 1e-2);
        }
        match overrides.get("terminal_sensor") {
            None => settings.terminal_sensor = true,
            Some(0.0) => notes.push(format!(
                "{file}: the column {terminal_column} is ignored, as the settings say terminal_sensor = 0; \
                 --set terminal_sensor=1 uses it"
            )),
            Some(_) => {}
        }
    }

    let (samples, first) = quantise(&table, &timebase.index, group, &settings)?;
    let start_s = table.t_s.first().copied().unwrap_or(0.0) + (first as f64 + 0.5) * group as f64 / timebase.rate_hz
        - 0.5 / timebase.rate_hz;
    if samples.len() < 2 {
        return Err(CsvError::TooFew { file, samples: samples.len() }.into());
    }
    let calibration = overrides.calibration().cloned();
    let trouble = calibration.as_ref().and_then(|calibration| calibration.trouble(None));
    notes.extend(trouble.map(|trouble| format!("{file}: {trouble}")));
    let mut run = Run { name: file, settings, samples, start_s, notes, calibration, ..Run::default() };
    Peaks::of(&Series::of(&run)).hold(&mut run.settings, overrides)?;
    Ok(run)
}

fn timebase_notes(file: &str, timebase: &Timebase) -> Vec<String> {
    let mut notes = Vec::new();
    if timebase.discontinuities > 0 {
        notes.push(format!(
            "{file}: {} missing in {}; the estimator assumes nothing about them",
            plural(timebase.missing, "sample"),
            plural(timebase.discontinuities, "place")
        ));
    }
    if timebase.irregular > timebase.discontinuities {
        notes.push(format!(
            "{file}: {} more than 20 % off the period at {} Hz",
            plural(timebase.irregular, "interval"),
            timebase.rate_hz
        ));
    }
    notes
}

/// Sets the rate; returns how many samples of the file make one of ours.
fn set_rate(file: &str, settings: &mut Settings, rate_hz: f64, given: Option<f64>) -> Result<usize, CsvError> {
    let (min_hz, most_hz) = range_of("sample_rate_hz");
    let (_, most_group) = range_of("oversampling");
    let max_hz = most_hz * most_group;
    if !(min_hz..=max_hz).contains(&rate_hz) {
        return Err(CsvError::Rate { file: file.into(), rate_hz, min_hz, max_hz });
    }
    let group = (rate_hz / most_hz - 1e-9).ceil().max(1.0);
    settings.sample_rate_hz = rate_hz / group;
    if let Some(set_hz) = given {
        if (set_hz / settings.sample_rate_hz - 1.0).abs() > 1e-3 {
            return Err(CsvError::RateConflict { file: file.into(), set_hz, rate_hz: settings.sample_rate_hz });
        }
        settings.sample_rate_hz = set_hz;
    }
    Ok(group as usize)
}

/// The power of two at which the largest value plus 25 % stays within 22 bits, at most `most`.
fn scale(values: &[f64], most: f64) -> f64 {
    let largest = values.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    let exponent = (largest * 1.25 / FULL_SCALE_CODE).log2().ceil();
    if largest == 0.0 { 2f64.powi(-20) } else { exponent.clamp(-39.0, 60.0).exp2().min(most.log2().floor().exp2()) }
}

/// Averages groups of complete samples into raw samples; also returns the number of the first group that exists.
fn quantise(
    table: &Table,
    index: &[u64],
    group: usize,
    settings: &Settings,
) -> Result<(Vec<RawSample>, u64), CsvError> {
    let mut samples = Vec::with_capacity(index.len() / group);
    let (mut at, mut first) = (0, None);
    let size = group as u64;
    while let Some(number) = index.get(at).map(|index| index / size) {
        let members = index.get(at..).unwrap_or_default().iter().take_while(|index| **index / size == number).count();
        if members == group {
            first.get_or_insert(number);
            samples.push(sample(table, at, group, number, settings)?);
        }
        at += members;
    }
    Ok((samples, first.unwrap_or(0)))
}

fn sample(table: &Table, at: usize, group: usize, number: u64, settings: &Settings) -> Result<RawSample, CsvError> {
    let mean = |column: &[f64]| column.get(at..at + group).unwrap_or_default().iter().sum::<f64>() / group as f64;
    let counts = table.encoder_count.get(at..at + group).unwrap_or_default();
    let code = |column: &'static str, value: f64, scale: f64, zero: f64, setting: &str| {
        let code = (value / scale).round() + zero;
        if code.abs() <= f64::from(i32::MAX) {
            return Ok(code as i32);
        }
        Err(CsvError::DoesNotFit {
            file: table.file.clone(),
            line: table.line.get(at).copied().unwrap_or(0),
            column,
            value,
            scale: format!("{setting} = {scale:?}"),
            advice: "check the number; if it is right, give a coarser scale with --set, or leave the scale out",
        })
    };
    let (force_column, terminal_column) = column_names(table.machine);
    let terminal_code = if table.terminal_m.is_empty() {
        0
    } else {
        let (terminal, scale) = (mean(&table.terminal_m), settings.metres_per_terminal_code);
        code(terminal_column, terminal, scale, 0.0, "metres_per_terminal_code")?
    };
    Ok(RawSample {
        index: number as u32,
        position_count: counts.iter().fold(0_i64, |sum, count| sum.wrapping_add(*count)) as i32,
        force_code: code(
            force_column,
            mean(&table.force_n),
            settings.newtons_per_code,
            settings.force_zero_code,
            "newtons_per_code",
        )?,
        terminal_code,
    })
}

#[cfg(test)]
#[path = "samples_tests.rs"]
mod tests;
