//! The Rust half of the Python package: files in, results out, each as the command line gives it.
//!
//! Results are JSON (docs/CLI.md), tables are Arrow. What a user sees is written in Python (`python/inerter`). Work
//! runs in a thread of its own (`watch`), so that other threads of Python continue and Ctrl-C ends it.

mod device;
mod error;
mod results;
mod run;
mod simulate;
mod store;
mod sums;
mod table;
mod watch;

use pyo3::prelude::*;

/// The module `inerter._inerter`.
#[pymodule]
fn _inerter(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("InerterError", module.py().get_type::<error::InerterError>())?;
    module.add_class::<device::Device>()?;
    module.add_class::<run::Run>()?;
    module.add_class::<store::Store>()?;
    module.add_class::<sums::Sums>()?;
    module.add_class::<table::Table>()?;
    module.add_function(wrap_pyfunction!(device::connect, module)?)?;
    module.add_function(wrap_pyfunction!(run::open, module)?)?;
    module.add_function(wrap_pyfunction!(run::from_columns, module)?)?;
    module.add_function(wrap_pyfunction!(run::with_settings, module)?)?;
    module.add_function(wrap_pyfunction!(results::interval_text, module)?)?;
    module.add_function(wrap_pyfunction!(results::replay, module)?)?;
    module.add_function(wrap_pyfunction!(results::compare, module)?)?;
    module.add_function(wrap_pyfunction!(results::diagnose, module)?)?;
    module.add_function(wrap_pyfunction!(results::identify, module)?)?;
    module.add_function(wrap_pyfunction!(results::plan, module)?)?;
    module.add_function(wrap_pyfunction!(results::plot, module)?)?;
    module.add_function(wrap_pyfunction!(results::report, module)?)?;
    module.add_function(wrap_pyfunction!(simulate::simulate, module)?)?;
    module.add_function(wrap_pyfunction!(sums::merge, module)?)?;
    Ok(())
}
