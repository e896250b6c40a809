//! The reproduction of the paper's device and rig: its figures and a page.

mod figures;
mod html;

pub use figures::figures;
pub use html::{found_text, html, truth_text};
