//! What the device published, as a table; for a CSV what it would have published.

use std::ops::Range;

use inerter_core::{LawStatus, Parameter};
use inerter_wire::{
    Estimated, EstimatorEvent, Frame, Pairing, Record,
    catalogue::{self, Field},
};

use super::Source;
#[cfg(feature = "parquet")]
use super::{Cells, HeldColumn};
use crate::{
    error::Error,
    json::{DetailJson, rounded_s},
    names::{beside, name},
    output::{OutputError, Pending},
    recording::{self, Extent, Item},
    replay::Replay,
};

/// A column of the table; unknown values are `None`.
#[derive(Clone, Debug, PartialEq)]
pub struct EstimateColumn {
    /// Name, with its unit at the end, if any.
    pub name: String,
    /// Unit; empty for a plain number.
    pub unit: &'static str,
    /// Values in order of time.
    pub values: Vec<Option<f64>>,
}

/// Estimates, column by column.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EstimateTable {
    /// Columns, all of one length.
    pub columns: Vec<EstimateColumn>,
}

impl EstimateTable {
    /// Collects the estimates whose time since the first sample lies in `range_s` \[s\].
    pub fn collect(source: &Source, range_s: &Range<f64>) -> Result<Self, Error> {
        let mut table = Self::default();
        let mut take = |since_s: f64, event: &EstimatorEvent| match event {
            EstimatorEvent::Estimate(estimated) if range_s.contains(&since_s) => {
                table.push(source.start_s + since_s, source, estimated);
            }
            _ => {}
        };
        match source.recording() {
            Some(path) => {
                let (mut clock, mut pairing) = (Extent::default(), Pairing::new());
                let since_s = |clock: &Extent, index| {
                    let first = source.extent.indices.map_or(index, |(first, _)| first);
                    let before = || i64::from(u32::wrapping_sub(index, first) as i32);
                    clock.periods_of(index).unwrap_or_else(before) as f64 / source.settings.sample_rate_hz
                };
                recording::read(path, |incoming| {
                    let Item::Frame(Frame::Message { message, .. }) = incoming.item else { return };
                    for event in pairing.take(&message) {
                        take(since_s(&clock, event.index()), &event);
                    }
                    if let Record::Samples(batch) = message
                        && batch.check().is_ok()
                    {
                        batch.iter().flatten().for_each(|sample| clock.take(&sample));
                    }
                })?;
                // An estimate whose detail did not arrive.
                if let Some(event) = pairing.flush() {
                    take(since_s(&clock, event.index()), &event);
                }
            }
            None => {
                let mut replay = Replay::new(&source.settings, 0.0)?;
                for sample in source.samples()? {
                    for event in replay.step(&sample?) {
                        take(replay.time_s(), &event);
                    }
                }
            }
        }
        Ok(table)
    }

    /// The columns without rows, for a run that ended with this estimate.
    pub fn without_rows(source: &Source, last: &Estimated) -> Self {
        let mut table = Self::default();
        table.push(0.0, source, last);
        table.columns.iter_mut().for_each(|column| column.values.clear());
        table
    }

    /// The columns as a table in memory.
    #[cfg(feature = "parquet")]
    pub fn held(self) -> impl Iterator<Item = HeldColumn> {
        let columns = self.columns.into_iter();
        columns.map(|EstimateColumn { name, unit, values }| HeldColumn { name, unit, cells: Cells::Float(values) })
    }

    /// Rows of the table.
    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, |column| column.values.len())
    }

    /// Adds an estimate at the time `t_s` \[s\].
    pub fn push(&mut self, t_s: f64, source: &Source, estimated: &Estimated) {
        let row = row(rounded_s(t_s), source, estimated);
        if self.columns.is_empty() {
            let column = |(name, unit, _): &Cell| EstimateColumn { name: name.clone(), unit, values: Vec::new() };
            self.columns = row.iter().map(column).collect();
        }
        for (column, (_, _, value)) in self.columns.iter_mut().zip(row) {
            column.values.push(value.filter(|value| value.is_finite()));
        }
    }

    /// Writes it as CSV; an unknown value is an empty cell.
    pub(super) fn write_csv(&self, file: &Pending) -> Result<(), OutputError> {
        let failed = |error| OutputError::write(file.name(), super::text::into_io(error));
        let mut writer = csv::Writer::from_writer(std::io::BufWriter::new(file.open()?));
        writer.write_record(self.columns.iter().map(|column| &column.name)).map_err(failed)?;
        for number in 0..self.rows() {
            let row: Vec<Option<f64>> =
                self.columns.iter().map(|column| column.values.get(number).copied().flatten()).collect();
            writer.serialize(row).map_err(failed)?;
        }
        writer.flush().map_err(|source| OutputError::write(file.name(), source))
    }
}

/// Name, unit and value.
type Cell = (String, &'static str, Option<f64>);

/// One row; the columns are always the same.
fn row(t_s: f64, source: &Source, estimated: &Estimated) -> Vec<Cell> {
    let Estimated { estimate, law, detail } = estimated;
    let plain = |name: &str, value: Option<f64>| (name.to_string(), "", value);
    let machine = source.settings.machine;
    let quantity =
        |linear: &str, unit, value| (name(machine, linear).into_owned(), catalogue::unit(machine, unit), value);
    let mut row = vec![("t_s".to_string(), "s", Some(t_s)), plain("index", Some(estimate.index.into()))];
    for (prefix, parameters) in [("", &estimate.recent), ("whole_run_", &estimate.whole_run)] {
        let parameters = catalogue::parameters(machine, parameters);
        row.extend(parameters.flat_map(|(field, parameter)| pair(prefix, field, &parameter)));
    }
    // As in the JSON, which leaves placeholder values out.
    let detail = detail.as_ref().map(|detail| (detail, DetailJson::new(detail, &source.settings)));
    let backlash = detail.as_ref().map(|(_, json)| &json.backlash_m);
    row.extend([
        plain("moving", Some(u8::from(estimate.moving).into())),
        quantity("residual_rms_n", "N", Some(estimate.residual_rms_n.into())),
        plain("updates", Some(estimate.updates.into())),
        quantity("backlash_m", "m", backlash.and_then(|backlash| backlash.value).map(f64::from)),
        quantity("backlash_u95_m", "m", backlash.and_then(|backlash| backlash.u95).map(f64::from)),
        plain("reversals", backlash.map(|backlash| backlash.reversals.into())),
    ]);
    let measured = detail.as_ref().filter(|(_, json)| json.stiffness_n_per_m.is_some());
    let values = measured.map(|(detail, _)| [detail.stiffness_n_per_m, detail.contact_damping_n_s_per_m]);
    for (number, field) in catalogue::contact_fields(machine).enumerate() {
        let parameter = values.and_then(|values| values.get(number).copied());
        row.extend(pair("", field, &parameter.unwrap_or_default()));
    }
    let band = detail.as_ref().and_then(|(_, json)| json.band_hz);
    let misfit = law.and_then(|law| law.misfit);
    let known = law.map(|law| law.status).filter(|status| *status != LawStatus::Unknown);
    row.extend([
        ("band_low_hz".into(), "Hz", band.map(|[low, _]| low.into())),
        ("band_high_hz".into(), "Hz", band.map(|[_, high]| high.into())),
        plain("changes", detail.map(|(detail, _)| detail.changes.into())),
        plain("law_ratio", misfit.map(|misfit| misfit.ratio.into())),
        plain("law_limit", misfit.map(|misfit| misfit.limit.into())),
        plain("law_broken", known.map(|status| u8::from(status == LawStatus::Broken).into())),
    ]);
    row
}

/// A parameter and its interval: `inertance_kg`, `inertance_u95_kg`.
fn pair(prefix: &str, field: &'static Field, parameter: &Parameter) -> [Cell; 2] {
    let known = parameter.known();
    [
        (format!("{prefix}{}", field.path), field.unit, known.map(|known| known.value.into())),
        (format!("{prefix}{}", beside(field, "_u95")), field.unit, known.map(|known| known.u95.into())),
    ]
}
