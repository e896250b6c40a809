//! The paper's device and rig done again: its figures and a page.

mod figures;
mod html;

pub use figures::figures;
pub use html::{found_text, html, truth_text};
