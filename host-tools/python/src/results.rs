//! Results of runs, as the command line's JSON.

use std::path::{Path, PathBuf};

use inerter_analysis::{
    compare::Rig,
    diagnose::Encoder,
    identify::{Options, identify as identified},
    plan::{Asked, Plan},
    results::{self, IdentifyJson},
};
use inerter_core::{Machine, Settings};
use inerter_data::{
    json::machine_json_line,
    limits::{Limits, LimitsError},
    names::description,
    output, words,
};
use inerter_view::{
    compared::{self, Comparison},
    figure::{Axis, Colour, Figure, Layer, Panel, Shape, Stroke, render_png, svg},
    page::{Content, Kind, figure, html},
};
use inerter_wire::EstimatorEvent;
use pyo3::{exceptions::PyValueError, prelude::*, types::PyString};

use crate::{
    error::Failure,
    run::{Given, Run, at_least, overrides},
    sums::Sums,
    table::Table,
    watch::watch,
};

/// Default for the least counts of a turn or a line, and for the shortest segment \[s\], as on the command line.
const LEAST_COUNTS: f64 = 4.0;
const LEAST_SEGMENT_S: f64 = 0.5;
/// Height of the figure of a motion \[px\].
const MOTION_PX: u32 = 240;

/// A figure as an SVG document, with its caption.
type Drawn = (String, String);

fn drawn(figure: &Figure) -> Drawn {
    (svg(figure), figure.caption.clone())
}

/// A value with its interval, both rounded to the digits that the interval justifies, as the command line writes them.
#[pyfunction]
pub fn interval_text(value: f64, u95: f64) -> String {
    words::interval_text(value, u95)
}

/// One line of text that is safe to show, wherever it comes from, as the command line writes it.
#[pyfunction]
pub fn printable(text: &Bound<'_, PyString>) -> String {
    // A string of Python may hold surrogates, which are no text here.
    words::printable(&text.to_string_lossy()).into_owned()
}

/// The last line of `inerter replay --json`, and the sums.
#[pyfunction]
pub fn replay(py: Python<'_>, run: &Run, limits: Option<PathBuf>, told: Option<Py<PyAny>>) -> PyResult<(String, Sums)> {
    let source = run.source.clone();
    watch(py, told, move |progress| {
        let limits = read(limits.as_deref(), source.settings.machine)?;
        let (start_s, duration_s) = (source.start_s, source.duration_s().max(f64::MIN_POSITIVE));
        let samples = source.samples()?.map(|sample| sample.map_err(Failure::from));
        let replayed = results::replayed(&source.settings, start_s, samples, |t_s, event| match event {
            EstimatorEvent::Estimate(_) => progress.set((t_s - start_s) / duration_s),
            _ => Ok(()),
        })?;
        let sums = Sums::of(&source.name, &source.settings, &replayed.outcome);
        let within = limits.map(|limits| replayed.told().within(&limits));
        Ok((machine_json_line(source.settings.machine, &replayed.json(within.as_deref())), sums))
    })
}

/// Reads the limits from a file, if one is given.
fn read(limits: Option<&Path>, machine: Machine) -> Result<Option<Limits>, LimitsError> {
    limits.map(|path| Limits::read(path, machine)).transpose()
}

/// The line of `inerter compare --json`, the kind of its intervals, and the loops of its page, if there are any. The
/// runs have these names. `path` is the page to write.
#[pyfunction]
pub fn compare(
    py: Python<'_>,
    runs: Vec<(Option<String>, PyRef<'_, Run>)>,
    is_one_rig: Option<bool>,
    path: Option<PathBuf>,
    replace: bool,
    limits: Option<PathBuf>,
    told: Option<Py<PyAny>>,
) -> PyResult<(String, Vec<String>, Option<Drawn>)> {
    let runs: Vec<(Option<String>, Run)> = runs.into_iter().map(|(name, run)| (name, (*run).clone())).collect();
    watch(py, told, move |progress| {
        path.iter().filter(|_| !replace).try_for_each(|path| output::refuse_existing(path))?;
        let count = runs.len() as f64;
        let contents = runs.into_iter().enumerate().map(|(number, (name, run))| -> Result<Content, Failure> {
            let mut whole = run.whole()?;
            whole.name = name.unwrap_or(whole.name);
            Ok(Content::of(whole, |part| progress.tell((number as f64 + part) / count))?)
        });
        let rig = is_one_rig.map(|is_one| if is_one { Rig::Same } else { Rig::Other("stated by rigs".into()) });
        let mut comparison = Comparison::of(contents, rig)?;
        let machine = comparison.machine();
        if let Some(limits) = read(limits.as_deref(), machine)? {
            comparison = comparison.within(&limits);
        }
        // Write nothing if the caller no longer waits for it.
        progress.tell(1.0);
        path.iter().try_for_each(|path| output::write(path, replace, compared::html(&comparison).0))?;
        let loops = compared::loops(&comparison);
        Ok((machine_json_line(machine, &comparison.json()), comparison.words(), loops.as_ref().map(drawn)))
    })
}

/// The line of `inerter diagnose --json`, and the text for a person.
#[pyfunction]
pub fn diagnose(
    py: Python<'_>,
    run: &Run,
    counts_per_turn: Option<f64>,
    counts_per_line: Option<f64>,
    told: Option<Py<PyAny>>,
) -> PyResult<(String, Vec<String>)> {
    at_least("counts_per_turn", counts_per_turn, LEAST_COUNTS)?;
    at_least("counts_per_line", counts_per_line, LEAST_COUNTS)?;
    let run = run.clone();
    watch(py, told, move |progress| {
        let run = run.whole()?;
        let (machine, mut words) = (run.settings.machine, Vec::new());
        let changed = |since_s| {
            words.push(format!("The device changed at {since_s:.1} s: only the motion since then is used."));
        };
        let encoder = Encoder { counts_per_turn, counts_per_line };
        let found = results::diagnosed::<Failure>(&run, encoder, changed, |part| progress.tell(part))?;
        words.extend(found.words(machine));
        Ok((machine_json_line(machine, &found.json(machine)), words))
    })
}

/// The line of `inerter identify --json`.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "the options of the command, by name in Python")]
pub fn identify(
    py: Python<'_>,
    runs: Vec<PyRef<'_, Run>>,
    staged: bool,
    segment_s: Option<f64>,
    free_structure_mass: bool,
    free_skew: bool,
    profiles: bool,
    told: Option<Py<PyAny>>,
) -> PyResult<String> {
    at_least("segment_s", segment_s, LEAST_SEGMENT_S)?;
    let options = Options { staged, segment_s, free_structure_mass, free_skew, excite: None, no_profiles: !profiles };
    let runs: Vec<Run> = runs.iter().map(|run| (**run).clone()).collect();
    watch(py, told, move |progress| {
        let files = runs.iter().map(|run| run.source.name.clone()).collect();
        let runs = runs.iter().map(Run::whole).collect::<Result<Vec<_>, _>>()?;
        let found = identified(&runs, &options, &mut |part| progress.tell(part))?;
        let machine = runs.first().map(|run| run.settings.machine).unwrap_or_default();
        Ok(machine_json_line(machine, &IdentifyJson::new(files, &runs, &found)))
    })
}

/// The line of `inerter plan --json` without its files, its remarks, what is not achievable, the points of the motion
/// (time \[s\] and displacement \[m\]), and its figure.
type Designed = (String, Vec<String>, Option<String>, Table, Drawn);

/// The planned motion over time.
fn motion_figure(planned: &Plan) -> Figure {
    let Settings { machine, sample_rate_hz, .. } = planned.expected.settings;
    let points = planned.points(sample_rate_hz).map(|point| (point.t_s, 1e3 * point.terminal_m)).collect();
    Figure {
        name: "motion",
        title: "Motion".into(),
        caption: description(machine, "Displacement of the terminal over time, as the shaker moves it."),
        panels: vec![Panel::new(
            "Time [s]",
            Axis::new(description(machine, "Displacement of the terminal [mm]")),
            MOTION_PX,
            vec![Layer::unnamed(Colour::Blue, Shape::Line(points, Stroke::Thin))],
        )],
    }
}

/// Designs a motion, or predicts what a given motion can identify.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "the options of the command, by name in Python")]
pub fn plan(
    py: Python<'_>,
    run: Option<PyRef<'_, Run>>,
    preset: Option<String>,
    given: Given,
    force_noise_n: Option<f64>,
    settings: Given,
    wants: String,
    motion: Option<(String, u64)>,
    limits: Given,
    told: Option<Py<PyAny>>,
) -> PyResult<Designed> {
    let run = run.map(|run| run.source.clone());
    watch(py, told, move |progress| {
        let overrides = overrides(&settings)?;
        let limit = |name: &str| limits.get(name).copied();
        let asked = Asked {
            run,
            preset,
            given,
            force_noise_n,
            overrides,
            wants,
            motion,
            stroke_m: limit("stroke_m"),
            speed_m_per_s: limit("speed_m_per_s"),
            force_n: limit("force_n"),
            duration_s: limit("duration_s"),
            lowest_hz: limit("lowest_hz"),
            highest_hz: limit("highest_hz"),
            fade_s: limit("fade_s"),
        };
        let planned = asked.planned::<Failure>(|part| progress.tell(part))?;
        let machine = planned.expected.settings.machine;
        let line = machine_json_line(machine, &planned.json::<()>(&[]));
        let missed = planned.missed().map(|missed| missed.to_string());
        let figure = drawn(&motion_figure(&planned));
        Ok((line, planned.remarks(), missed, Table::motion(&planned), figure))
    })
}

/// A figure of `inerter plot` as an SVG document, with its caption; `path` is a PNG to write as well.
#[pyfunction]
pub fn plot(
    py: Python<'_>,
    run: &Run,
    name: &str,
    path: Option<PathBuf>,
    replace: bool,
    told: Option<Py<PyAny>>,
) -> PyResult<Drawn> {
    let Some(kind) = Kind::ALL.into_iter().find(|kind| kind.name() == name) else {
        let known = Kind::ALL.map(Kind::name).join(", ");
        return Err(PyValueError::new_err(format!("there is no figure '{name}'; there are: {known}")));
    };
    let run = run.clone();
    watch(py, told, move |progress| {
        path.iter().filter(|_| !replace).try_for_each(|path| output::refuse_existing(path))?;
        let content = Content::of(run.whole()?, |part| progress.tell(part))?;
        let figure = figure(&content, kind)?;
        // Write nothing if the caller no longer waits for it.
        progress.tell(1.0);
        path.iter().try_for_each(|path| render_png(&figure, path, replace))?;
        Ok(drawn(&figure))
    })
}

/// Writes the page of `inerter report`; returns the names of its figures.
#[pyfunction]
pub fn report(
    py: Python<'_>,
    run: &Run,
    path: PathBuf,
    replace: bool,
    limits: Option<PathBuf>,
    told: Option<Py<PyAny>>,
) -> PyResult<Vec<&'static str>> {
    let run = run.clone();
    watch(py, told, move |progress| {
        if !replace {
            output::refuse_existing(&path)?;
        }
        let content = Content::of(run.whole()?, |part| progress.tell(part))?;
        let limits = read(limits.as_deref(), content.run.settings.machine)?;
        let within = limits.map(|limits| content.told().within(&limits)).unwrap_or_default();
        let (page, figures) = html(&content, &within);
        // Write nothing if the caller no longer waits for it.
        progress.tell(1.0);
        output::write(&path, replace, &page)?;
        Ok(figures.iter().map(|figure| figure.name).collect())
    })
}
