//! Runs: opened from files, or built from arrays.

use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{Arc, OnceLock},
};

use inerter_core::{Machine, Settings};
use inerter_data::{
    Error,
    calibration::Calibration,
    csv,
    export::{EstimateTable, Source},
    settings::Overrides,
    words::printable,
};
use pyo3::{exceptions::PyValueError, prelude::*};

use crate::{
    error::Failure,
    table::Table,
    watch::{Progress, watch},
};

/// Settings that override those of a run, by name.
pub type Given = BTreeMap<String, f64>;

/// A run: settings and samples, with the known data of the device.
#[pyclass(frozen, module = "inerter")]
#[derive(Clone)]
pub struct Run {
    pub source: Source,
    overrides: Arc<Overrides>,
    /// Kept for a CSV or arrays, whose samples change with the settings.
    columns: Option<Arc<csv::Table>>,
    /// Filled on first request: for a CSV the estimates need a replay.
    estimates: Arc<OnceLock<Py<Table>>>,
}

/// Settings by name, which errors use too.
pub fn overrides(given: &Given) -> Result<Overrides, Failure> {
    laid(Overrides::default(), given)
}

/// The overrides, with these settings taking precedence.
fn laid(mut overrides: Overrides, given: &Given) -> Result<Overrides, Failure> {
    given.iter().try_for_each(|(name, value)| overrides.set(name, *value, "settings"))?;
    Ok(overrides)
}

/// Opens a recording (.mcap) or a CSV file; `told` is called with the fraction read.
#[pyfunction]
pub fn open(py: Python<'_>, path: PathBuf, settings: Given, told: Option<Py<PyAny>>) -> PyResult<Run> {
    watch(py, told, move |progress| opened(path, overrides(&settings)?, progress))
}

/// The run of a file, with settings that override its own.
pub fn opened(path: PathBuf, overrides: Overrides, progress: &Progress) -> Result<Run, Failure> {
    // The file is read again later, whatever Python's working directory is by then. The run keeps the name that was
    // given.
    let name = path.display().to_string();
    let path = std::path::absolute(&path).unwrap_or(path);
    if !inerter_data::recording::is_recording(&path)
        .map_err(|source| csv::CsvError::Read { path: path.clone(), source })?
    {
        return Run::of_columns(name, Arc::new(csv::read(&path)?), overrides);
    }
    let length = path.metadata().map_or(1, |metadata| metadata.len()).max(1);
    let mut source = Source::open(&path, &overrides, |read| progress.tell(read as f64 / length as f64))?;
    source.name = name;
    progress.set(1.0)?;
    Ok(Run::of(source, overrides))
}

/// A run from columns of equal length, each as raw bytes: 64-bit floats, or 64-bit integers for the encoder count.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "a column each")]
pub fn from_columns(
    py: Python<'_>,
    name: String,
    rotary: bool,
    t_s: &[u8],
    encoder_count: &[u8],
    force: &[u8],
    terminal: &[u8],
    settings: Given,
) -> PyResult<Run> {
    let machine = if rotary { Machine::Rotary } else { Machine::Linear };
    let made = || -> Result<Run, Failure> {
        let overrides = overrides(&settings)?;
        let counts = encoder_count.as_chunks().0.iter().map(|eight| i64::from_le_bytes(*eight)).collect();
        let table = csv::Table::of_columns(name, machine, floats(t_s), counts, floats(force), floats(terminal))?;
        Run::of_columns(table.file.clone(), Arc::new(table), overrides)
    };
    Ok(py.detach(made)?)
}

/// The run with these settings overriding its own.
#[pyfunction]
pub fn with_settings(py: Python<'_>, run: &Run, settings: Given) -> PyResult<Run> {
    Ok(py.detach(|| run.with(&settings))?)
}

/// Decodes a column of numbers.
pub fn floats(bytes: &[u8]) -> Vec<f64> {
    bytes.as_chunks().0.iter().map(|eight| f64::from_le_bytes(*eight)).collect()
}

#[pymethods]
impl Run {
    fn __repr__(&self) -> String {
        let Settings { sample_rate_hz, .. } = self.source.settings;
        let name = printable(&self.source.name);
        format!("inerter.Run of {:.1} s at {sample_rate_hz} Hz: {name}", self.duration_s())
    }

    /// Where it came from.
    #[getter]
    fn name(&self) -> &str {
        &self.source.name
    }

    /// `linear` or `rotary`.
    #[getter]
    fn machine(&self) -> &'static str {
        match self.source.settings.machine {
            Machine::Linear => "linear",
            Machine::Rotary => "rotary",
        }
    }

    /// All settings by name, including those that were given; `inerter replay --help` lists their units.
    #[getter]
    fn settings(&self) -> Given {
        by_name(&self.source.settings)
    }

    /// What was corrected or found missing while reading.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.source.notes.clone()
    }

    /// The device that recorded it, by name; empty if unknown.
    #[getter]
    fn device(&self) -> BTreeMap<String, String> {
        self.source.device.clone().unwrap_or_default()
    }

    /// What is known about the calibration of the rig, as text: `date`, and `certificate` and `expires` if stated;
    /// empty if nothing is known.
    #[getter]
    fn calibration(&self) -> BTreeMap<String, String> {
        self.source.calibration.as_ref().map(Calibration::texts).unwrap_or_default()
    }

    /// The true parameters of a simulated device, as text by name; each name ends in its unit. Empty for a real device.
    #[getter]
    fn truth(&self) -> BTreeMap<String, String> {
        self.source.truth.clone().unwrap_or_default()
    }

    /// Time from the first sample to the last [s].
    #[getter]
    fn duration_s(&self) -> f64 {
        self.source.duration_s()
    }

    /// All samples, one row each: `t_s` [s], `encoder_count` (it does not wrap), `position_m` of the screw [m],
    /// `force_n` [N], `terminal_m` [m] if it was measured, `index` (the device's counter: a jump means missing
    /// samples), and `saturated` (true or false). A rotary machine has `angle_rad` [rad], `torque_n_m` [N m] and
    /// `terminal_rad` [rad].
    ///
    /// A recording is read when the table is used, which raises InerterError if the file is gone.
    #[getter]
    fn samples(&self) -> Table {
        Table::samples(&self.source)
    }

    /// What the device published, one row per estimate, with the columns of `inerter export --estimates`: `t_s` [s],
    /// and for the recent motion and for the whole run (`whole_run_`) each parameter with the half width of its 95 %
    /// interval (`_u95`). A name ends in its unit; what the motion cannot identify is null.
    ///
    /// For a recording they follow from the settings that the device had. For a CSV, arrays or a simulation in memory
    /// they are what a device would have published, computed on first use.
    ///
    /// Raises InerterError if the file can no longer be read, and KeyboardInterrupt on Ctrl-C.
    #[getter]
    fn estimates(&self, py: Python<'_>) -> PyResult<Py<Table>> {
        if let Some(known) = self.estimates.get() {
            return Ok(known.clone_ref(py));
        }
        let source = self.source.clone();
        let table = watch(py, None, move |_| Ok(EstimateTable::collect(&source, &(0.0..f64::INFINITY))?))?;
        let table = Py::new(py, Table::estimates(table))?;
        Ok(self.estimates.get_or_init(|| table).clone_ref(py))
    }
}

impl Run {
    /// A run whose samples are in memory.
    pub fn held(run: inerter_data::run::Run, overrides: Overrides) -> Self {
        Self::of(Source::held(run), overrides)
    }

    /// A run whose columns are kept.
    fn of_columns(name: String, table: Arc<csv::Table>, overrides: Overrides) -> Result<Self, Failure> {
        let run = inerter_data::run::Run { name, ..csv::to_run((*table).clone(), &overrides)? };
        Ok(Self { columns: Some(table), ..Self::held(run, overrides) })
    }

    fn of(source: Source, overrides: Overrides) -> Self {
        Self { source, overrides: Arc::new(overrides), columns: None, estimates: Arc::default() }
    }

    /// The same run with these settings overriding its own, as if it had been opened with them.
    fn with(&self, given: &Given) -> Result<Self, Failure> {
        let both = laid((*self.overrides).clone(), given)?;
        if let Some(table) = &self.columns {
            return Self::of_columns(self.source.name.clone(), table.clone(), both);
        }
        let mut source = self.source.clone();
        overrides(given)?.apply(&mut source.settings)?;
        Ok(Self::of(source, both))
    }

    /// The run with its samples in memory.
    pub fn whole(&self) -> Result<inerter_data::run::Run, Error> {
        self.source.whole(&self.overrides)
    }
}

/// All settings by name.
pub fn by_name(settings: &Settings) -> Given {
    Settings::TABLE.iter().zip(settings.values()).map(|(info, value)| (info.name.to_string(), value)).collect()
}

/// Rejects a value below `least`.
pub fn at_least(name: &str, value: Option<f64>, least: f64) -> PyResult<()> {
    match value {
        Some(value) if !(value.is_finite() && value >= least) => {
            Err(PyValueError::new_err(format!("{name} must be a number from {least} on, not {value}")))
        }
        _ => Ok(()),
    }
}
