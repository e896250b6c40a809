//! The simulated inerter: stick, slip, contact and free flight located exactly.
//!
//! It provides the truth in `f64` for tests of the estimator. A rig moves terminal 1 along a prescribed motion
//! ([`Excitation`]); the device ([`Inerter`]) responds ([`Plant`]); imperfect instruments ([`Sensors`]) turn that into
//! counts and codes ([`Simulation`]). Nothing here depends on the firmware: both share only the physics.
//!
//! Glossary:
//! - `x1` prescribed terminal displacement \[m\]; `x2` screw displacement referred to the terminal \[m\];
//!   `d = x1 - x2`.
//! - *contact*: `abs(d) > backlash / 2`, the flanks touch; *flight*: they do not, and the force is zero.
//! - *stuck*: the screw is at rest and friction balances any force up to the Coulomb force; *slip*: it rotates.
//! - *segment*: an interval without a change of mode, on which the solution is one polynomial.
//!
//! ```
//! use inerter_plant::{Excitation, Inerter, Sensors, Simulation};
//!
//! let excitation = Excitation::parse("mid", 1)?;
//! let sensors = Sensors { force_noise_n: 1.0, seed: 7, ..Sensors::default() };
//! let simulation = Simulation::new(Inerter::paper(), excitation, sensors)?;
//! for sample in simulation.take(1000) {
//!     let _ = (sample.t_s, sample.index, sample.position_count, sample.force_code, sample.truth.x2_m);
//! }
//! # Ok::<(), inerter_plant::PlantError>(())
//! ```

mod dynamics;
mod error;
mod excitation;
mod inerter;
mod polynomial;
mod sensors;
mod simulation;
mod table;

pub use dynamics::{Flank, Motion, Plant, Segment, Truth};
pub use error::PlantError;
pub use excitation::{Excitation, Moves, Point, Tone};
pub use inerter::Inerter;
pub use sensors::Sensors;
pub use simulation::{Hands, Sample, Simulation};
pub use table::{FieldInfo, FieldKind};
