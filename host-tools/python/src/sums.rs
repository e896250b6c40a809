//! Exact sums of runs, which workers pass on, and the fit to all of them.

use inerter_analysis::{merge::Runs, results::FitJson};
use inerter_core::Settings;
use inerter_data::{json::machine_json_line, replay::Outcome};
use pyo3::{
    prelude::*,
    types::{PyBytes, PyType},
};

use crate::{error::Failure, watch::watch};

/// Exact sums of one run or of several.
#[pyclass(frozen, eq, module = "inerter")]
#[derive(Clone, PartialEq)]
pub struct Sums {
    runs: Runs,
}

impl Sums {
    /// The sums of one run, from the estimator's outcome with these settings.
    pub fn of(name: &str, settings: &Settings, outcome: &Outcome) -> Self {
        Self { runs: Runs::of(name, settings, outcome) }
    }
}

#[pymethods]
impl Sums {
    /// Decodes the bytes of `to_bytes`.
    #[classmethod]
    fn from_bytes(_: &Bound<'_, PyType>, py: Python<'_>, bytes: &[u8]) -> PyResult<Self> {
        let runs = py.detach(|| Runs::from_bytes(bytes)).map_err(Failure::from)?;
        Ok(Self { runs })
    }

    /// The bytes are the same for any order and grouping of the additions.
    fn to_bytes<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let bytes = py.detach(|| self.runs.to_bytes());
        PyBytes::new(py, &bytes)
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        Ok((py.get_type::<Self>().getattr("from_bytes")?, (self.to_bytes(py),)))
    }

    /// Adds two sums, without a fit.
    fn __add__(&self, py: Python<'_>, other: PyRef<'_, Self>) -> PyResult<Self> {
        let (ours, others) = (self.runs.clone(), other.runs.clone());
        let runs = py.detach(|| ours.and(others)).map_err(Failure::from)?;
        Ok(Self { runs })
    }

    /// Names of the runs, in alphabetical order.
    #[getter]
    fn names(&self) -> Vec<String> {
        self.runs.names()
    }

    fn __len__(&self) -> usize {
        self.runs.count()
    }

    fn __repr__(&self) -> String {
        format!("inerter.Sums of {}", inerter_data::words::plural(self.runs.count() as u64, "run"))
    }
}

/// The line of `inerter fit --json`, remarks for a person, and the sums of all runs.
#[pyfunction]
pub fn merge(
    py: Python<'_>,
    sums: Vec<PyRef<'_, Sums>>,
    offset_n: Option<f64>,
) -> PyResult<(String, Vec<String>, Sums)> {
    let sums: Vec<Runs> = sums.iter().map(|sums| sums.runs.clone()).collect();
    watch(py, None, move |_| {
        let runs = Runs::all(sums)?;
        let merged = runs.merged(offset_n)?;
        let line = machine_json_line(runs.settings().machine, &FitJson::new(&merged, offset_n));
        Ok((line, merged.remarks(&runs.settings()), Sums { runs }))
    })
}
