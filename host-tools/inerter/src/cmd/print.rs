//! Machine-readable results on standard output: one object per line.

use inerter_core::Machine;
use inerter_data::{
    json::{json_line, machine_json_line},
    output,
};
use serde::Serialize;

use crate::Error;

/// An object whose first key is its kind.
#[derive(Serialize)]
pub struct Kind<'a, T> {
    pub kind: &'static str,
    #[serde(flatten)]
    pub of: &'a T,
}

/// Prints an object.
pub fn print_json(value: &impl Serialize) -> Result<(), Error> {
    Ok(output::line(json_line(value))?)
}

/// Prints an object with the key names of this machine.
pub fn print_machine_json(machine: Machine, value: &impl Serialize) -> Result<(), Error> {
    Ok(output::line(machine_json_line(machine, value))?)
}

/// Prints a line and flushes it, because a reader waits for it.
pub fn print_now(line: impl AsRef<str>) -> Result<(), Error> {
    output::line(line)?;
    Ok(output::flush()?)
}
