//! Which cause breaks the law: regressors added to it, one at a time, the one that explains most first.
//!
//! `columns` makes rows of force and motion behind the kernels of `filter`, `candidate` says what could be added to the
//! law, `selection` how much that would explain. `search` adds it, `found` fits it together, `fitted` gives sizes and
//! parameters with their intervals. A cause is named where its F statistic is beyond what clean runs reach ([`LIMIT`],
//! docs/THEORY.md, 14). `hidden` judges what may have moved the parameters, also where it is too small to be named.

mod candidate;
mod cause;
mod columns;
mod filter;
mod fitted;
mod found;
mod hidden;
mod kind;
mod latest;
mod search;
mod selection;

pub use candidate::Encoder;
pub use cause::Cause;
pub use hidden::{Judged, TOLD, assumptions, judged, reach, widened};
pub use kind::{Kind, LIMIT};
pub use latest::Latest;
pub use search::{Diagnosis, diagnose, is_reversed, is_suspect, suspected};
