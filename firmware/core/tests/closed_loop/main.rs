//! The whole estimator on a simulated inerter with known true values: the part that `cargo test -p inerter-core` runs.
//!
//! Each test compares with something that core did not compute: the plant's true values, an analytic motion, the same
//! computation in f64 (`reference`, `textbook`), or another run that differs in a known way. Nothing is compared with
//! earlier results of core. Grids of motions, seeds and rigs, and recordings of real machines, are in `tests` (crate
//! `inerter-tests`).

mod backlash;
mod budgets;
mod changes;
mod contact;
mod fixed_point;
mod gates;
mod invariance;
mod limits;
mod linear;
mod parts;
mod reference;
mod regime;
mod regressors;
mod rig;
mod robust;
mod settings;
mod textbook;
