//! What the page holds.

use inerter_analysis::compare::{Rig, Row, Side};
use inerter_data::limits::Judged;

use crate::page::Content;

/// Runs beside each other.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// The runs, the first being what the others are held against.
    pub runs: Vec<Content>,
    /// The same, as they were compared.
    pub sides: Vec<Side>,
    /// Whether they share a rig.
    pub rig: Rig,
    /// Parameters that any of them tells.
    pub rows: Vec<Row>,
    /// What each run says of limits; empty where there are none.
    pub within: Vec<Vec<Judged>>,
}
