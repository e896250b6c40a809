//! Tables in memory.

/// A column of a table in memory; unknown values are `None`, and null in the file.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldColumn {
    /// Name, with its unit at the end, if any.
    pub name: String,
    /// Unit; empty for a plain number or a text.
    pub unit: &'static str,
    /// Values, as many as in every other column of the table.
    pub cells: Cells,
}

/// Values of a column.
#[derive(Clone, Debug, PartialEq)]
pub enum Cells {
    /// Numbers.
    Float(Vec<Option<f64>>),
    /// Integers.
    Whole(Vec<Option<i64>>),
    /// Texts; if they are all the same, they take hardly any space.
    Text(Vec<Option<String>>),
}
