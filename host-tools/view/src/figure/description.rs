//! The contents of a figure, and its colours.

use super::scale::Scale;

/// Nominal width of a figure \[px\]: the text width of an A4 page.
pub const WIDTH_PX: u32 = 720;

/// Panels one below the other.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Short name, also used for its file.
    pub name: &'static str,
    /// Its title, shown above it in a file; a page has its own heading.
    pub title: String,
    /// Its caption.
    pub caption: String,
    /// From top to bottom.
    pub panels: Vec<Panel>,
}

impl Figure {
    /// Height of all panels \[px\].
    pub(super) fn height_px(&self) -> u32 {
        self.panels.iter().map(|panel| panel.height_px).sum()
    }
}

/// Two axes and the data between them.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// Height with axes and legend \[px\].
    pub height_px: u32,
    /// From back to front.
    pub layers: Vec<Layer>,
}

impl Panel {
    /// A panel of these axes; a text is a linear axis over all data.
    pub fn new(x: impl Into<Axis>, y: impl Into<Axis>, height_px: u32, layers: Vec<Layer>) -> Self {
        Self { x: x.into(), y: y.into(), height_px, layers }
    }

    /// Removes the layers' names, when another panel shows them.
    pub(crate) fn unname(&mut self) {
        self.layers.iter_mut().for_each(|layer| layer.label = None);
    }
}

/// An axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Its label, with the unit.
    pub label: String,
    /// Linear or logarithmic.
    pub scale: Scale,
    /// Its range; if `None`, all data plus a margin.
    pub range: Option<(f64, f64)>,
}

impl Axis {
    /// A linear axis over all data.
    pub fn new(label: impl Into<String>) -> Self {
        Self { label: label.into(), scale: Scale::Linear, range: None }
    }

    /// A logarithmic axis over all data that is above zero.
    pub fn log(label: impl Into<String>) -> Self {
        Self { scale: Scale::Log, ..Self::new(label) }
    }

    /// The same from `low` to `high`.
    #[must_use]
    pub fn within(self, low: f64, high: f64) -> Self {
        Self { range: Some((low, high)), ..self }
    }
}

impl From<&str> for Axis {
    fn from(label: &str) -> Self {
        Self::new(label)
    }
}

/// One set of data.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Name in the legend; `None` if it needs none.
    pub label: Option<String>,
    /// Its colour.
    pub colour: Colour,
    /// Its shape and data.
    pub shape: Shape,
}

impl Layer {
    /// A layer with a name.
    pub fn new(label: impl Into<String>, colour: Colour, shape: Shape) -> Self {
        Self { label: Some(label.into()), colour, shape }
    }

    /// A line with a name.
    pub fn line(label: impl Into<String>, colour: Colour, points: Vec<(f64, f64)>, stroke: Stroke) -> Self {
        Self::new(label, colour, Shape::Line(points, stroke))
    }

    /// A layer without a name.
    pub fn unnamed(colour: Colour, shape: Shape) -> Self {
        Self { label: None, colour, shape }
    }
}

/// Shape and data of a layer; values that are not finite are left out, and break a line or a band.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A line through points `(x, y)`.
    Line(Vec<(f64, f64)>, Stroke),
    /// A line in a band, through points with the half width of their interval: `(x, y, half)`.
    Band(Vec<(f64, f64, f64)>, Stroke),
    /// Points with the half width of their interval: `(x, y, half)`.
    Points(Vec<(f64, f64, f64)>),
    /// Bars from zero: `(left, right, height)`.
    Bars(Vec<(f64, f64, f64)>),
    /// A line across the panel at this `y`.
    Level(f64, Stroke),
    /// A line from top to bottom at this `x`.
    Instant(f64, Stroke),
    /// An area from top to bottom between these `x`.
    Span(f64, f64),
}

/// How a line looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stroke {
    /// Thin, for dense data.
    Thin,
    /// Of ordinary width.
    Solid,
    /// Wide and pale, as a background for another line.
    Wide,
    /// Of ordinary width, in dashes.
    Dashed,
}

/// A colour, by its role in a figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colour {
    /// Axes and text.
    Ink,
    /// Grid lines.
    Grid,
    /// Behind everything.
    Paper,
    /// Measured data.
    Blue,
    /// A model.
    Vermilion,
    /// The residual of a model.
    Green,
    /// A second model.
    Purple,
    /// Marks and spans.
    Orange,
}

impl Colour {
    /// All of them.
    pub const ALL: [Self; 8] =
        [Self::Ink, Self::Grid, Self::Paper, Self::Blue, Self::Vermilion, Self::Green, Self::Purple, Self::Orange];

    /// Red, green and blue on white paper. No two are equal, because a page finds colours by these values.
    pub const fn rgb(self) -> [u8; 3] {
        self.look().0
    }

    /// The same on a dark screen.
    pub const fn dark_rgb(self) -> [u8; 3] {
        self.look().1
    }

    /// Name of its CSS variable.
    pub const fn variable(self) -> &'static str {
        self.look().2
    }

    const fn look(self) -> ([u8; 3], [u8; 3], &'static str) {
        match self {
            Self::Ink => ([0x22, 0x22, 0x26], [0xE6, 0xE6, 0xEA], "--ink"),
            Self::Grid => ([0xE4, 0xE4, 0xE8], [0x38, 0x39, 0x40], "--grid"),
            Self::Paper => ([0xFF, 0xFF, 0xFF], [0x16, 0x17, 0x1B], "--paper"),
            Self::Blue => ([0x00, 0x72, 0xB2], [0x56, 0xB4, 0xE9], "--blue"),
            Self::Vermilion => ([0xD5, 0x5E, 0x00], [0xFF, 0x8F, 0x3F], "--vermilion"),
            Self::Green => ([0x00, 0x9E, 0x73], [0x2F, 0xC9, 0x9B], "--green"),
            Self::Purple => ([0xCC, 0x79, 0xA7], [0xE3, 0x9A, 0xC4], "--purple"),
            Self::Orange => ([0xE6, 0x9F, 0x00], [0xF2, 0xB7, 0x33], "--orange"),
        }
    }
}

/// A colour as CSS writes it.
pub fn css([red, green, blue]: [u8; 3]) -> String {
    format!("#{red:02X}{green:02X}{blue:02X}")
}
