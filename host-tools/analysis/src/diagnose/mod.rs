//! Which cause breaks the law: regressors added to it, one at a time, the one that explains most first.
//!
//! Rows are what the estimator's kernels make of force and motion, as on the device. What could be added is in `columns`: a
//! cause is named where its F statistic is beyond what clean runs reach ([`LIMIT`], docs/THEORY.md), and the parameters are
//! given again with all causes beside them.

mod cause;
mod columns;
mod hidden;
mod kind;
mod latest;
mod search;
mod selection;

pub use cause::Cause;
pub use hidden::{Judged, TOLD, judged, reach};
pub use kind::{Kind, LIMIT, LIMIT_AT_REVERSALS};
pub use latest::Latest;
pub use search::{Diagnosis, diagnose, is_suspect, suspected};
