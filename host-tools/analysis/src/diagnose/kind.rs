//! What may violate the law, and the evidence required.

pub use inerter_data::causes::Kind;

/// F statistic from which a cause is named: a run without a fault does not reach it (docs/tables/diagnose.md).
pub const LIMIT: f64 = 30.0;
