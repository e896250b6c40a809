//! Everything that may fail, as one exception with the command line's error code and help.

use inerter_analysis::{
    calibrate::CalibrateError, compare::CompareError, fit::FitError, identify::IdentifyError, merge::MergeError,
    plan::PlanError,
};
use inerter_data::{
    csv::{ColumnsError, CsvError},
    limits::LimitsError,
    output::OutputError,
    settings::SettingsInputError,
    words::printable,
};
use inerter_device::DeviceError;
use inerter_simulate::SimulateError;
use inerter_store::StoreError;
use inerter_view::page::PageError;
use miette::Diagnostic;
use pyo3::{create_exception, exceptions::PyException, prelude::*};

create_exception!(
    inerter,
    InerterError,
    PyException,
    "Raised when something cannot be done. `code` is that of the command line, `help` says what to do next."
);

/// A text for a traceback, which prints it as it is: it may quote files and devices.
fn shown(text: &str) -> String {
    printable(text).into_owned()
}

/// A failure in the libraries or in Python.
#[derive(Debug)]
pub enum Failure {
    Ours(Box<dyn Diagnostic + Send + Sync>),
    Python(PyErr),
    /// The caller no longer waits for the result.
    Stopped,
}

macro_rules! ours {
    ($($error:ty),*) => {$(
        impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                Self::Ours(Box::new(error))
            }
        }
    )*};
}

ours!(
    inerter_data::Error,
    CsvError,
    ColumnsError,
    SettingsInputError,
    OutputError,
    DeviceError,
    CalibrateError,
    CompareError,
    FitError,
    IdentifyError,
    LimitsError,
    MergeError,
    PlanError,
    PageError,
    SimulateError,
    StoreError
);

impl From<PyErr> for Failure {
    fn from(error: PyErr) -> Self {
        Self::Python(error)
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        Python::attach(|py| failure.raised(py))
    }
}

impl Failure {
    /// Converts to a Python exception.
    fn raised(self, py: Python<'_>) -> PyErr {
        let error = match self {
            Self::Ours(error) => error,
            Self::Python(error) => return error,
            Self::Stopped => return InerterError::new_err("interrupted"),
        };
        let raised = InerterError::new_err(shown(&error.to_string()));
        let text = |part: Option<Box<dyn std::fmt::Display + '_>>| part.map(|part| shown(&part.to_string()));
        let value = raised.value(py);
        let described = value
            .setattr("code", text(error.code()))
            .and_then(|()| value.setattr("help", text(error.help())))
            .and_then(|()| match text(error.help()) {
                // Python shows notes below the message.
                Some(help) if value.hasattr("add_note")? => value.call_method1("add_note", (help,)).map(drop),
                _ => Ok(()),
            });
        described.err().unwrap_or(raised)
    }
}
