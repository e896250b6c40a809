//! A run as a page to share: one HTML file with figures, tables and text, and the same figures as files.
//!
//! [`Content::of`] runs a run through the estimator and keeps what the page needs; `figures` draws it, [`html`] writes
//! it.

mod bode;
mod content;
mod error;
mod figures;
mod html;
mod layout;
mod limits;

pub use bode::degrees;
pub(crate) use bode::{MOST_TIMES, apparent_kg, measured, response_panels};
pub use content::Content;
pub use error::PageError;
pub use figures::{Kind, figure};
pub(crate) use figures::{Timed, known, over_run, settled};
pub use html::html;
pub(crate) use html::{calibration_text, device_text, file_name, notes_of};
pub(crate) use layout::{LOW_PX, TALL_PX};
pub(crate) use limits::{limits_table, shown};
