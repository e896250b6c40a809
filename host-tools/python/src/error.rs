//! Everything that may fail, as one exception with the command line's error code and help.

use inerter_data::words::printable;
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

impl<E: Diagnostic + Send + Sync + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Ours(Box::new(error))
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        let error = match failure {
            Failure::Ours(error) => error,
            Failure::Python(error) => return error,
            Failure::Stopped => return InerterError::new_err("interrupted"),
        };
        let raised = InerterError::new_err(shown(&error.to_string()));
        let text = |part: Option<Box<dyn std::fmt::Display + '_>>| part.map(|part| shown(&part.to_string()));
        let described = Python::attach(|py| {
            let value = raised.value(py);
            value.setattr("code", text(error.code()))?;
            value.setattr("help", text(error.help()))?;
            match text(error.help()) {
                // Python shows notes below the message.
                Some(help) if value.hasattr("add_note")? => value.call_method1("add_note", (help,)).map(drop),
                _ => Ok(()),
            }
        });
        described.err().unwrap_or(raised)
    }
}
