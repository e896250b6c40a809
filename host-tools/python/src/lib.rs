//! The Rust half of the Python package: reads files and returns the results that the command line gives.
//!
//! Results are JSON (docs/CLI.md); tables are Arrow. The user-facing API is written in Python (`python/inerter`). Work
//! runs in its own thread (`watch`), so that other Python threads continue and Ctrl-C stops it.

mod device;
mod error;
mod results;
mod run;
mod simulate;
mod store;
mod sums;
mod table;
mod watch;

/// The module `inerter._inerter`.
#[pyo3::pymodule]
mod _inerter {
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::{
        device::{Device, connect},
        error::InerterError,
        results::{compare, diagnose, identify, interval_text, plan, plot, printable, replay, report},
        run::{Run, from_columns, open, with_settings},
        simulate::simulate,
        store::Store,
        sums::{Sums, merge},
        table::Table,
    };

    #[pymodule_init]
    fn add_version(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
