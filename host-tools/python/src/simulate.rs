//! Simulated runs.

use std::path::PathBuf;

use inerter_data::{csv::motion::Displacements, settings::Overrides};
use inerter_simulate::{Described, Motion, file};
use pyo3::prelude::*;

use crate::{
    run::{Given, Run, floats, opened, overrides},
    watch::watch,
};

/// Simulates a run in memory or, if `path` is given, in a file, which is then opened.
///
/// The motion is a name, a CSV of points, or the displacements themselves: the time from point to point and the raw
/// bytes of 64-bit floats.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "the flags of the command, by name in Python")]
pub fn simulate(
    py: Python<'_>,
    name: Option<String>,
    file: Option<PathBuf>,
    points: Option<(f64, Vec<u8>)>,
    preset: String,
    given: Given,
    seed: u64,
    duration_s: Option<f64>,
    load_n: f64,
    change: Option<(f64, Given)>,
    settings: Given,
    path: Option<PathBuf>,
    replace: bool,
    told: Option<Py<PyAny>>,
) -> PyResult<Run> {
    watch(py, told, move |progress| {
        let motion = match (name, file, points) {
            (_, Some(file), _) => Motion::File(file),
            (_, _, Some((period_s, bytes))) => Motion::Points(Displacements { period_s, terminal_m: floats(&bytes) }),
            (name, ..) => Motion::Named(name.unwrap_or_default()),
        };
        let overrides = overrides(&settings)?;
        let described = Described { preset, given, motion, seed, duration_s, load_n, change, overrides };
        let setup = described.ending()?;
        let whole_s = setup.duration_s.unwrap_or(f64::INFINITY);
        let advance = |t_s: f64| progress.set(t_s / whole_s).map_err(|_| inerter_data::Error::Interrupted);
        let Some(path) = path else {
            return Ok(Run::held(file::held(&setup, advance)?, described.overrides));
        };
        let beside = file::write(&setup, &path, replace, advance)?;
        opened(path, Overrides::from_inputs(beside.as_deref(), &[])?, progress)
    })
}
