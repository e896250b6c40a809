//! What may break the law, and how strong its evidence must be.

pub use inerter_data::causes::Kind;

/// F statistic from which on a cause is named: a run without a fault does not reach it (docs/tables/diagnose.md).
pub const LIMIT: f64 = 30.0;
