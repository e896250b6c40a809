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
    let functions = [
        wrap_pyfunction!(device::connect, module)?,
        wrap_pyfunction!(run::open, module)?,
        wrap_pyfunction!(run::from_columns, module)?,
        wrap_pyfunction!(run::with_settings, module)?,
        wrap_pyfunction!(results::interval_text, module)?,
        wrap_pyfunction!(results::printable, module)?,
        wrap_pyfunction!(results::replay, module)?,
        wrap_pyfunction!(results::compare, module)?,
        wrap_pyfunction!(results::diagnose, module)?,
        wrap_pyfunction!(results::identify, module)?,
        wrap_pyfunction!(results::plan, module)?,
        wrap_pyfunction!(results::plot, module)?,
        wrap_pyfunction!(results::report, module)?,
        wrap_pyfunction!(simulate::simulate, module)?,
        wrap_pyfunction!(sums::merge, module)?,
    ];
    functions.into_iter().try_for_each(|function| module.add_function(function))
}
