//! Stores of runs.

use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{Arc, OnceLock},
};

use inerter_data::json::json_line;
use inerter_store::{Choice, Damage, Day, Outcome, StoreError};
use pyo3::prelude::*;

use crate::{
    error::Failure,
    run::{Given, overrides},
    watch::{Progress, watch},
};

/// A store, opened on first use.
#[pyclass(frozen, module = "inerter")]
#[derive(Clone)]
pub struct Store {
    url: String,
    opened: Arc<OnceLock<Arc<inerter_store::Store>>>,
}

/// Damage to a file: run, file, problem.
type Damaged = (String, String, &'static str);

fn plain(Damage { run, file, problem }: Damage) -> Damaged {
    (run, file, problem)
}

#[pymethods]
impl Store {
    #[new]
    fn new(url: String) -> Self {
        Self { url, opened: Arc::default() }
    }

    #[getter]
    fn url(&self) -> &str {
        &self.url
    }

    /// Returns the name of the run, and whether it is new.
    fn add(&self, py: Python<'_>, path: PathBuf, told: Option<Py<PyAny>>) -> PyResult<(String, bool)> {
        let this = self.clone();
        watch(py, told, move |progress| {
            let store = Arc::new(inerter_store::Store::create(&this.url)?);
            let added = this.opened.get_or_init(|| store).add(&path, &mut told_by(progress))?;
            Ok((added.row.name().to_owned(), added.is_new))
        })
    }

    /// Each run as JSON, and the damaged files.
    fn rows(
        &self,
        py: Python<'_>,
        device: Option<String>,
        from: Option<String>,
        to: Option<String>,
        conditions: Vec<String>,
    ) -> PyResult<(Vec<String>, Vec<Damaged>)> {
        self.work(py, move |store| {
            let conditions = conditions.iter().map(|text| text.parse()).collect::<Result<_, StoreError>>()?;
            let day = |text: Option<String>| text.map(|text| text.parse::<Day>()).transpose();
            let listed = store.runs(&Choice { device, from: day(from)?, to: day(to)?, conditions })?;
            Ok((listed.rows.iter().map(json_line).collect(), listed.damages.into_iter().map(plain).collect()))
        })
    }

    /// One run as JSON.
    fn row(&self, py: Python<'_>, run: String) -> PyResult<String> {
        self.work(py, move |store| Ok(json_line(&store.row(&store.find(&run)?)?)))
    }

    /// The full name of a run.
    fn find(&self, py: Python<'_>, run: String) -> PyResult<String> {
        self.work(py, move |store| Ok(store.find(&run)?.name().to_owned()))
    }

    /// The path of its recording, if that is a local file.
    fn path(&self, py: Python<'_>, run: String) -> PyResult<Option<String>> {
        self.work(py, move |store| {
            let file = store.file(&store.find(&run)?);
            Ok(file.map(|file| file.display().to_string()))
        })
    }

    /// Copies its recording into a file.
    fn get(&self, py: Python<'_>, run: String, path: PathBuf, replace: bool) -> PyResult<()> {
        self.work(py, move |store| Ok(store.get(&store.find(&run)?, &path, replace)?))
    }

    fn verify(&self, py: Python<'_>, repair: bool, told: Option<Py<PyAny>>) -> PyResult<Vec<Damaged>> {
        let this = self.clone();
        watch(py, told, move |progress| {
            let store = this.open()?;
            if repair {
                store.repair(&mut told_by(progress))?;
            }
            Ok(store.verify(&mut told_by(progress))?.damages.into_iter().map(plain).collect())
        })
    }

    /// Saves the outcome of a run: the command's JSON, or the code and text of an error.
    #[allow(clippy::too_many_arguments, reason = "the columns of a batch")]
    fn keep(
        &self,
        py: Python<'_>,
        batch: String,
        run: String,
        kind: String,
        given: Given,
        result: Option<String>,
        error: (String, String),
    ) -> PyResult<()> {
        self.work(py, move |store| {
            // Invalid settings are the caller's error, not the run's.
            overrides(&given)?;
            let result = result.map(|text| serde_json::from_str(&text).unwrap_or_default()).ok_or(error);
            let outcome = Outcome { kind, given: serde_json::json!(given), result };
            Ok(store.keep(&batch, &store.find(&run)?, &outcome)?)
        })
    }

    /// Names of the runs that a batch already has. Fails if the batch was made by another command or with other
    /// settings.
    fn kept(&self, py: Python<'_>, batch: String, kind: String, given: Given) -> PyResult<Vec<String>> {
        self.work(py, move |store| {
            overrides(&given)?;
            Ok(store.kept(&batch, &kind, &serde_json::json!(given))?.into_iter().collect())
        })
    }

    /// Rows of a batch as JSON, by the names of the runs. Only one is parsed here at a time: parsed values take many
    /// times as much memory.
    fn results(&self, py: Python<'_>, batch: String) -> PyResult<Vec<String>> {
        self.work(py, move |store| {
            let mut rows = BTreeMap::new();
            store.each_result(&batch, &mut |run, values| {
                rows.insert(run, json_line(&values));
                Ok(())
            })?;
            Ok(rows.into_values().collect())
        })
    }

    fn remove(&self, py: Python<'_>, run: String) -> PyResult<()> {
        self.work(py, move |store| Ok(store.remove(&store.find(&run)?)?))
    }
}

impl Store {
    fn work<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&inerter_store::Store) -> Result<T, Failure> + Send + 'static,
    ) -> PyResult<T> {
        let this = self.clone();
        watch(py, None, move |_| work(&*this.open()?))
    }

    fn open(&self) -> Result<Arc<inerter_store::Store>, StoreError> {
        if let Some(store) = self.opened.get() {
            return Ok(store.clone());
        }
        let store = Arc::new(inerter_store::Store::open(&self.url)?);
        Ok(self.opened.get_or_init(|| store).clone())
    }
}

/// Nobody waits any more, so the work ends.
fn told_by(progress: &Progress) -> impl FnMut(f64) -> Result<(), StoreError> + '_ {
    |part| progress.set(part).map_err(|_| inerter_data::Error::Interrupted.into())
}
