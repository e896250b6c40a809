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
    macro_rules! add {
        ($($room:ident::$function:ident,)+) => {$(module.add_function(wrap_pyfunction!($room::$function, module)?)?;)+};
    }
    add! {
        device::connect,
        run::open,
        run::from_columns,
        run::with_settings,
        results::interval_text,
        results::printable,
        results::replay,
        results::compare,
        results::diagnose,
        results::identify,
        results::plan,
        results::plot,
        results::report,
        simulate::simulate,
        sums::merge,
    }
    Ok(())
}
