//! Compared runs on one page: parameters with their differences, and overlaid figures of all runs.

mod comparison;
mod figures;
mod html;

pub use comparison::{Comparison, DRAWN};
pub use figures::loops;
pub use html::html;
