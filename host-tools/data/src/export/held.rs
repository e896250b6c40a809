//! Tables in memory.

use std::borrow::Cow;

/// A column of a table in memory; unknown values are `None`, and null in the file.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldColumn<'a> {
    /// Name, with its unit at the end, if any.
    pub name: Cow<'a, str>,
    /// Unit; empty for a plain number or a text.
    pub unit: &'static str,
    /// Values, as many as in every other column of the table.
    pub cells: Cells<'a>,
}

/// Values of a column.
#[derive(Clone, Debug, PartialEq)]
pub enum Cells<'a> {
    /// Numbers.
    Float(Cow<'a, [Option<f64>]>),
    /// Integers.
    Whole(Cow<'a, [Option<i64>]>),
    /// Texts; if they are all the same, they take hardly any space.
    Text(Vec<Option<Cow<'a, str>>>),
}
