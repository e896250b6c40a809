//! Figures: one description, rendered as SVG for pages and print or as PNG.
//!
//! Glossary: a *figure* consists of panels one below the other; a *panel* of two axes and layers; a *layer* is one set
//! of data with a style and, optionally, a label in the panel's legend. All lengths are CSS pixels at the figure's
//! nominal width.
//!
//! Colours are those of Okabe and Ito, which can be distinguished with every kind of colour vision. In a page they are
//! CSS variables, with separate values for the light and dark schemes. Lines are thinned to what the width can show
//! ([`decimate`]): the file for an hour of data is no larger than for a minute.

pub mod decimate;
mod description;
mod draw;
mod output;
mod scale;

pub use description::{Axis, Colour, Figure, Layer, Panel, Shape, Stroke, WIDTH_PX, css};
pub use output::{render_png, svg, svg_for_page};
pub use scale::Scale;
pub(crate) use scale::ends;

#[cfg(test)]
mod tests;
