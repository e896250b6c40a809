//! The tables of a recording: results of our estimator only.

use std::path::Path;

use inerter_analysis::results::{Replayed, replayed};
use inerter_core::{Machine, Parameter};
use inerter_data::{
    calibration::Calibration,
    export::{Cells, EstimateTable, HeldColumn, Source, settings_by_name, table_bytes},
    json::{EventJson, ReversalJson, Shown, rounded_s},
    names::{self, name},
    recording,
    words::{code, printable, utc},
};
use inerter_wire::{EstimatorEvent, EventKind, catalogue};
use serde_json::{Value, json};

use crate::{
    error::{StoreError, unreadable},
    place::{Part, Place, VERSION, serial},
    row::{LONGEST_ROW, MOST_COLUMNS, OBJECTS},
    sums::{Sum, lines},
};

/// Opens a file that must be a recording.
pub(crate) fn opened(path: &Path) -> Result<Source, StoreError> {
    if !recording::is_recording(path).map_err(unreadable(path))? {
        return Err(StoreError::NoRecording { path: path.into() });
    }
    Ok(Source::open(path, &Default::default(), |_| ())?)
}

/// All files of a run except its recording.
pub(crate) struct Tables {
    pub place: Place,
    /// In writing order, the run's row last.
    pub files: Vec<(Part, Vec<u8>)>,
}

impl Tables {
    /// The tables of a recording at its place; `progress` gets the completed fraction, from 0 to 1, and may stop the
    /// work.
    pub(crate) fn of(
        source: &Source,
        place: Place,
        progress: &mut dyn FnMut(f64) -> Result<(), StoreError>,
    ) -> Result<Self, StoreError> {
        let run = place.name();
        let machine = source.settings.machine;
        let (mut estimates, mut reversals, mut events) =
            (EstimateTable::default(), Vec::new(), Vec::<(f64, Option<u32>, String, String)>::new());
        let mut taken = 0_u64;
        let total = source.extent.samples.max(1) as f64;
        let samples = source.samples()?.map(|sample| {
            taken += 1;
            if taken.is_multiple_of(4096) {
                progress(taken as f64 / total)?;
            }
            sample.map_err(StoreError::from)
        });
        let replayed = replayed(&source.settings, source.start_s, samples, |t_s, event| -> Result<(), StoreError> {
            let kind = match event {
                EstimatorEvent::Estimate(estimated) => {
                    estimates.push(t_s, source, estimated);
                    return Ok(());
                }
                EstimatorEvent::Reversal(reversal) => {
                    reversals.push(ReversalJson::new(Some(t_s), reversal));
                    return Ok(());
                }
                EstimatorEvent::Changed(change) => EventKind::Changed(*change),
                EstimatorEvent::Warned(warning) => EventKind::Warned(*warning),
            };
            let EventJson { index, code, event, .. } = EventJson::new(None, event.index(), &kind, machine);
            events.push((t_s, Some(index), code, event));
            Ok(())
        })?;
        let end_s = replayed.outcome.t_s;
        events.extend(replayed.remarks().map(|(code, text)| (end_s, None, format!("cause.{code}"), text)));
        events.extend(source.markers.iter().map(|marker| {
            let t_s = source.time_s(marker.periods);
            (t_s, None, "marker".to_owned(), printable(&marker.text).into_owned())
        }));
        events.sort_by(|one, other| one.0.total_cmp(&other.0));
        if estimates.rows() == 0 {
            estimates = EstimateTable::without_rows(source, &replayed.outcome.estimated());
        }
        let named = |rows: usize| text("run", vec![Some(run); rows]);
        let with_run =
            |rows, columns: Vec<_>| table_bytes(&[named(rows)].into_iter().chain(columns).collect::<Vec<_>>());
        let row = row(source, &replayed);
        let row_json = format!("{}\n", json_of(run, &row)).into_bytes();
        // Nothing is written yet. The run's name is a column too.
        if row_json.len() > LONGEST_ROW || row.len() >= MOST_COLUMNS {
            return Err(StoreError::LongTexts { file: source.name.clone() });
        }
        let mut files = vec![
            (Part::Estimates, with_run(estimates.rows(), estimates.held().collect())?),
            (Part::Reversals, with_run(reversals.len(), reversal_columns(machine, &reversals))?),
            (Part::Events, with_run(events.len(), event_columns(&events))?),
            (Part::Row, row_json),
        ];
        let table = with_run(1, row)?;
        let summed = files.iter().map(|(part, bytes)| (place.file(*part), Sum::of(bytes)));
        let recording = (place.file(Part::Recording), run.to_owned());
        let of_run = (place.file(Part::Run), Sum::of(&table));
        let sums = lines(&[recording].into_iter().chain(summed).chain([of_run]).collect::<Vec<_>>());
        files.extend([(Part::Sums, sums.into_bytes()), (Part::Run, table)]);
        Ok(Self { place, files })
    }

    pub(crate) fn bytes(&self, part: Part) -> &[u8] {
        self.files.iter().find(|(one, _)| *one == part).map_or(&[], |(_, bytes)| bytes)
    }
}

/// A row as JSON; objects stay objects.
fn json_of(run: &str, row: &[HeldColumn]) -> Value {
    let value = |column: &HeldColumn| match &column.cells {
        Cells::Float(values) => json!(values.first().copied().flatten()),
        Cells::Whole(values) => json!(values.first().copied().flatten()),
        Cells::Text(values) => {
            let text = values.first().and_then(|value| value.as_deref());
            text.filter(|_| OBJECTS.contains(&&*column.name))
                .and_then(|text| serde_json::from_str(text).ok())
                .unwrap_or_else(|| json!(text))
        }
    };
    let values = row.iter().map(|column| (column.name.clone(), value(column)));
    Value::Object([("run".to_owned(), json!(run))].into_iter().chain(values).collect())
}

fn float(
    machine: Machine,
    linear: &str,
    unit: &'static str,
    values: impl IntoIterator<Item = Option<f64>>,
) -> HeldColumn {
    let finite = values.into_iter().map(|value| value.filter(|value| value.is_finite()));
    HeldColumn {
        name: name(machine, linear).into_owned(),
        unit: names::unit(machine, unit),
        cells: Cells::Float(finite.collect()),
    }
}

fn whole(name: &'static str, values: impl IntoIterator<Item = Option<i64>>) -> HeldColumn {
    HeldColumn { name: name.into(), unit: "", cells: Cells::Whole(values.into_iter().collect()) }
}

fn text(name: &'static str, values: impl IntoIterator<Item = Option<impl Into<String>>>) -> HeldColumn {
    let cells = values.into_iter().map(|value| value.map(Into::into)).collect();
    HeldColumn { name: name.into(), unit: "", cells: Cells::Text(cells) }
}

fn reversal_columns(machine: Machine, reversals: &[ReversalJson]) -> Vec<HeldColumn> {
    let all = |of: fn(&ReversalJson) -> Option<f64>| reversals.iter().map(of);
    vec![
        float(machine, "t_s", "s", all(|reversal| reversal.t_s)),
        whole("index", reversals.iter().map(|reversal| Some(reversal.index.into()))),
        float(machine, "value_m", "m", all(|reversal| reversal.value_m.map(f64::from))),
        float(machine, "error_m", "m", all(|reversal| reversal.error_m.map(f64::from))),
        text("route", reversals.iter().map(|reversal| Some(&*reversal.route))),
        whole("rising", reversals.iter().map(|reversal| Some(reversal.rising.into()))),
    ]
}

fn event_columns(events: &[(f64, Option<u32>, String, String)]) -> Vec<HeldColumn> {
    vec![
        float(Machine::Linear, "t_s", "s", events.iter().map(|event| Some(rounded_s(event.0)))),
        whole("index", events.iter().map(|event| event.1.map(i64::from))),
        text("code", events.iter().map(|event| Some(&*event.2))),
        text("text", events.iter().map(|event| Some(&*event.3))),
    ]
}

/// The result of the run: one row.
fn row(source: &Source, replayed: &Replayed) -> Vec<HeldColumn> {
    let outcome = &replayed.outcome;
    let (settings, extent) = (&source.settings, &source.extent);
    let machine = settings.machine;
    let device = |key: &str| {
        let known = source.device.as_ref().and_then(|device| device.get(key));
        known.map(|text| printable(text))
    };
    let calibration = source.calibration.as_ref();
    let count = |value: u64| Some(i64::try_from(value).unwrap_or(i64::MAX));
    let mut columns = vec![
        whole("version", [Some(VERSION as i64)]),
        text("software", [Some(concat!("inerter ", env!("CARGO_PKG_VERSION")))]),
        text("recorded_utc", [Some(utc(source.first_ns))]),
        text("serial", [serial(source).map(printable)]),
        text("firmware", [device("firmware")]),
        text("board", [device("board")]),
        text("calibration_date", [calibration.map(|calibration| calibration.date.to_string())]),
        text("calibration_certificate", [calibration.and_then(Calibration::certificate_text)]),
        text("calibration_expires", [calibration.and_then(|calibration| Some(calibration.expires?.to_string()))]),
        text("machine", [Some(if machine == Machine::Linear { "linear" } else { "rotary" })]),
        float(machine, "duration_s", "s", [Some(source.duration_s())]),
        float(machine, "sample_rate_hz", "Hz", [Some(settings.sample_rate_hz)]),
        whole("samples", [count(extent.samples)]),
        whole("lost_samples", [count(extent.missing)]),
        whole("saturated", [Some(outcome.counters.saturated.into())]),
        whole("wrong_samples", [count(replayed.wrong_samples() as u64)]),
        whole("changes", [Some(outcome.detail.changes.into())]),
        whole("reversals", [Some(outcome.detail.backlash.reversals.into())]),
    ];
    let parameters = catalogue::parameters(machine, &outcome.estimate.whole_run);
    for ((field, parameter), judged) in parameters.zip(&replayed.judged) {
        let budget = &judged.budget;
        let interval = Some((f64::from(budget.u95()), f64::from(budget.same_rig_u95())));
        columns.extend(of_parameter(field, &parameter, interval));
    }
    let contact = [outcome.detail.stiffness_n_per_m, outcome.detail.contact_damping_n_s_per_m];
    let backlash = outcome.detail.backlash.known();
    for (what, value) in [("", backlash.map(|known| known.value)), ("_u95", backlash.map(|known| known.u95))] {
        columns.push(float(machine, &format!("backlash{what}_m"), "m", [value.map(f64::from)]));
    }
    for (field, parameter) in catalogue::contact_fields(machine).zip(contact) {
        columns.extend(of_parameter(field, &parameter, None));
    }
    let misfit = outcome.law.misfit;
    let causes: Vec<&str> = replayed.remarks().map(|(code, _)| code).collect();
    columns.extend([
        text("law", [Some(code(&outcome.law.status))]),
        float(machine, "law_ratio", "", [misfit.map(|misfit| misfit.ratio.into())]),
        float(machine, "law_limit", "", [misfit.map(|misfit| misfit.limit.into())]),
        float(machine, "residual_rms_n", "N", [Some(outcome.estimate.residual_rms_n.into())]),
        text("causes", [Some(causes.join(" "))]),
        text("settings", [Some(json!(settings_by_name(source)).to_string())]),
        text("truth", [source.truth.as_ref().map(|truth| json!(truth).to_string())]),
    ]);
    columns
}

/// Value, intervals and status. Without an `interval` the parameter's own is used, and the same-rig interval is
/// unknown.
fn of_parameter(
    field: &'static catalogue::Field,
    parameter: &Parameter,
    interval: Option<(f64, f64)>,
) -> Vec<HeldColumn> {
    let known = parameter.known();
    let own = known.map(|known| f64::from(known.u95));
    let number = |name: String, value: Option<f64>| HeldColumn {
        name,
        unit: field.unit,
        cells: Cells::Float(vec![value.filter(|value| value.is_finite())]),
    };
    let mut columns = vec![
        number(field.path.into(), known.map(|known| known.value.into())),
        number(names::beside(field, "_u95"), known.and(interval.map(|(u95, _)| u95)).or(own)),
    ];
    if let Some((_, same_rig)) = interval {
        columns.push(number(names::beside(field, "_same_rig_u95"), known.map(|_| same_rig)));
    }
    columns.push(HeldColumn {
        name: format!("{}_status", names::stem(field)),
        unit: "",
        cells: Cells::Text(vec![Some(Shown::of(field, parameter).word().into())]),
    });
    columns
}
