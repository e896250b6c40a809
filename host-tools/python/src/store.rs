//! Stores of runs.

use std::{
    path::PathBuf,
    sync::{Arc, OnceLock},
};

use inerter_data::json::json_line;
use inerter_store::{Choice, Row, StoreError};
use pyo3::prelude::*;

use crate::{
    error::Failure,
    watch::{Progress, watch},
};

/// A store, which is opened when something is asked of it.
#[pyclass(frozen, module = "inerter")]
pub struct Store {
    url: String,
    opened: Arc<OnceLock<Arc<inerter_store::Store>>>,
}

/// What is the matter with a file: run, file, problem.
type Damage = (String, String, &'static str);

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

    /// Name of the run, and whether it is new.
    #[pyo3(signature = (path, told = None))]
    fn add(&self, py: Python<'_>, path: PathBuf, told: Option<&Bound<'_, PyAny>>) -> PyResult<(String, bool)> {
        let (url, opened) = (self.url.clone(), self.opened.clone());
        watch(py, told, move |progress| {
            let store = Arc::new(inerter_store::Store::create(&url)?);
            let store = opened.get_or_init(|| store);
            let added = store.add(&path, &mut told_by(progress))?;
            Ok((added.row.name().to_owned(), added.is_new))
        })
    }

    /// Each run as JSON.
    fn rows(
        &self,
        py: Python<'_>,
        device: Option<String>,
        from: Option<String>,
        to: Option<String>,
        conditions: Vec<String>,
    ) -> PyResult<Vec<String>> {
        self.work(py, move |store| {
            let conditions = conditions.iter().map(|text| text.parse()).collect::<Result<_, StoreError>>()?;
            let rows = store.runs(&Choice { device, from, to, conditions })?;
            Ok(rows.iter().map(json_line).collect())
        })
    }

    /// One run as JSON.
    fn row(&self, py: Python<'_>, run: String) -> PyResult<String> {
        self.work(py, move |store| Ok(json_line(&store.find(&run)?)))
    }

    /// Where its recording lies, where that is a file of this computer.
    fn path(&self, py: Python<'_>, run: String) -> PyResult<Option<PathBuf>> {
        self.work(py, move |store| Ok(store.find(&run).map(|row| store.file(&row))?))
    }

    /// Writes its recording into a file.
    fn get(&self, py: Python<'_>, run: String, path: PathBuf, replace: bool) -> PyResult<()> {
        self.work(py, move |store| Ok(store.get(&store.find(&run)?, &path, replace)?))
    }

    #[pyo3(signature = (told = None))]
    fn verify(&self, py: Python<'_>, told: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<Damage>> {
        let (url, opened) = (self.url.clone(), self.opened.clone());
        watch(py, told, move |progress| {
            let damages = open(&url, &opened)?.verify(&mut told_by(progress))?;
            Ok(damages.into_iter().map(|damage| (damage.run, damage.file, damage.problem)).collect())
        })
    }

    fn remove(&self, py: Python<'_>, run: String) -> PyResult<()> {
        self.work(py, move |store| {
            let row: Row = store.find(&run)?;
            Ok(store.remove(&row)?)
        })
    }
}

impl Store {
    fn work<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&inerter_store::Store) -> Result<T, Failure> + Send + 'static,
    ) -> PyResult<T> {
        let (url, opened) = (self.url.clone(), self.opened.clone());
        watch(py, None, move |_| work(&*open(&url, &opened)?))
    }
}

fn open(url: &str, opened: &OnceLock<Arc<inerter_store::Store>>) -> Result<Arc<inerter_store::Store>, StoreError> {
    if let Some(store) = opened.get() {
        return Ok(store.clone());
    }
    let store = Arc::new(inerter_store::Store::open(url)?);
    Ok(opened.get_or_init(|| store).clone())
}

/// Nobody waits any more: the work ends.
fn told_by(progress: &Progress) -> impl FnMut(f64) -> Result<(), StoreError> + '_ {
    |part| progress.set(part).map_err(|_| inerter_data::Error::Interrupted.into())
}
