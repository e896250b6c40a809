//! What a motion demands of the rig.

use inerter_plant::Truth;
use serde::Serialize;

/// Peaks of displacement, speed and force.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Peaks {
    /// Displacement of the terminal \[m\].
    pub stroke_m: f64,
    /// Speed of the terminal \[m/s\].
    pub speed_m_per_s: f64,
    /// Force on the load cell \[N\].
    pub force_n: f64,
}

impl Peaks {
    /// Includes one more state, for a device with this structure mass \[kg\].
    pub(super) fn take(&mut self, truth: &Truth, structure_mass_kg: f64) {
        *self = self.and(Self {
            stroke_m: truth.x1_m.abs(),
            speed_m_per_s: truth.v1_m_per_s.abs(),
            force_n: (truth.force_n + structure_mass_kg * truth.a1_m_per_s2).abs(),
        });
    }

    /// The larger of both, for each peak.
    pub(super) fn and(self, other: Self) -> Self {
        Self {
            stroke_m: self.stroke_m.max(other.stroke_m),
            speed_m_per_s: self.speed_m_per_s.max(other.speed_m_per_s),
            force_n: self.force_n.max(other.force_n),
        }
    }
}
