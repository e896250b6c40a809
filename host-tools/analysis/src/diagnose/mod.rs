//! Finds which causes violate the law: adds regressors to it one at a time, beginning with the one that explains most.
//!
//! `columns` makes rows of force and motion through the kernels of `filter`; `candidate` lists the possible terms, and
//! defines what a found one is; `selection` computes how much each would explain. `search` adds them, `found` fits them
//! together, `fitted` gives sizes and parameters with their intervals. A cause is named if its F statistic exceeds what
//! clean runs reach ([`LIMIT`], docs/THEORY.md, 14). `hidden` judges what may have shifted the parameters, even if it
//! is too small to be named.

mod candidate;
mod cause;
mod columns;
mod filter;
mod fitted;
mod found;
mod hidden;
mod latest;
mod search;
mod selection;

pub use candidate::{Encoder, Kind, LIMIT};
pub use cause::Cause;
pub use hidden::{Judged, TOLD, assumptions, judged, reach, widened};
pub use latest::Latest;
pub use search::{Diagnosis, diagnose, is_reversed, is_suspect, suspected};
