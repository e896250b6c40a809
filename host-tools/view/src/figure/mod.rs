//! Figures: one description, rendered as SVG for pages and print or as PNG.
//!
//! Glossary: a *figure* is panels below each other; a *panel* two axes and layers; a *layer* one set of data with a
//! look and, where it shall be named, a label in the panel's legend. All lengths are CSS pixels at the figure's nominal
//! width.
//!
//! Colours are those of Okabe and Ito, which all kinds of colour vision tell apart. In a page they are CSS variables,
//! so that light and dark each have their own. Lines are thinned to what the width can show ([`decimate`]): an hour of
//! data makes no larger a file than a minute.

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
