//! Runs beside each other on one page: parameters with their differences, and figures of all runs laid over each other.

mod comparison;
mod figures;
mod html;

pub use comparison::{Comparison, DRAWN};
pub use html::html;
