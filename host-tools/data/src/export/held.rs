//! Tables that are in memory.

use std::borrow::Cow;

/// A column of a table in memory; unknown values are `None`, and null in the file.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldColumn<'a> {
    /// Name, with the unit at its end where there is one.
    pub name: Cow<'a, str>,
    /// Unit; empty for a plain number or a text.
    pub unit: &'static str,
    /// Values, as many as in all columns of the table.
    pub cells: Cells<'a>,
}

/// Values of a column.
#[derive(Clone, Debug, PartialEq)]
pub enum Cells<'a> {
    /// Numbers.
    Float(Cow<'a, [Option<f64>]>),
    /// Whole numbers.
    Whole(Cow<'a, [Option<i64>]>),
    /// Texts; where they all are the same they take hardly any room.
    Text(Vec<Option<Cow<'a, str>>>),
}
