//! A run as a page that can be handed on: one HTML file with figures, tables and words, and the same figures as files.
//!
//! [`Story::of`] takes a run through the estimator and keeps what is to be told; `figures` draws it, [`html`] writes it.

mod bode;
mod error;
mod figures;
mod html;
mod layout;
mod story;

pub use bode::degrees;
pub use error::PageError;
pub use figures::{Kind, figure};
pub use html::{html, page_css};
pub use story::{Moment, Story};
