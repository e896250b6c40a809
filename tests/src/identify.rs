//! Hidden devices for `inerter identify`: drawn from a seed, moved by the grid's motions, with a terminal sensor.

use inerter_analysis::identify::{FoundStatus, Identified, IdentifyError, Options, identify};
use inerter_core::Settings;
use inerter_data::run::Run;
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{calibrated, raw};

use std::array;

use crate::{
    grid::{Result, seeded, sensors, shaken},
    skew::Draw,
};

/// Motions that excite all parameters.
pub const MOTIONS: [&str; 4] = ["mid", "multi", "random", "two"];
/// Length of a run \[s\].
pub const DURATION_S: f64 = 20.0;

/// The identified parameters and the goals for their errors, in SI; a goal in % is relative to the value.
pub const GOALS: [(&str, f64); 6] =
    [("mt %", 1e-3), ("fc N", 0.5), ("cf N s/m", 3.0), ("ks %", 5e-3), ("cs %", 5e-2), ("eps um", 1e-6)];

/// An unknown device: half to twice the paper's, with up to 0.1 mm of backlash.
pub fn hidden(seed: u64) -> Inerter {
    let mut draw = Draw::new(0x1de7 + seed);
    let mut about = |middle: f64, factor: f64| middle * factor.powf(2.0 * draw.unit() - 1.0);
    let device = Inerter {
        inertance_kg: about(300.0, 1.6),
        viscous_n_s_per_m: about(60.0, 2.0),
        coulomb_n: about(45.0, 1.8),
        stiffness_n_per_m: about(2.1e6, 1.8),
        contact_damping_n_s_per_m: about(1500.0, 1.6),
        structure_mass_kg: about(1.5, 1.5),
        ..Inerter::paper()
    };
    Inerter { backlash_m: 1e-4 * draw.unit(), ..device }
}

/// 1 kHz, 1 N, 2.44 um per count, terminal 1 um.
pub fn instruments(seed: u64) -> Sensors {
    seeded(Sensors { terminal_noise_m: 1e-6, ..sensors() }, seed)
}

/// The run that the instruments record: calibrated without error, with stiffness and damping unknown. The sensors' seed
/// is also the seed of the motion.
pub fn recorded(device: &Inerter, motion: &str, sensors: &Sensors, duration_s: f64) -> Result<Run> {
    let settings = Settings {
        terminal_sensor: true,
        stiffness_n_per_m: 0.0,
        contact_damping_n_s_per_m: 0.0,
        structure_mass_u95_kg: 0.02,
        force_gain_u95: 0.0,
        lead_u95: 0.0,
        timebase_u95: 0.0,
        ..calibrated(device, sensors)?
    };
    let samples = shaken(device, motion, *sensors)?.lasting(duration_s).map(|sample| raw(&sample)).collect();
    Ok(Run { name: format!("{motion} {}", sensors.seed), settings, samples, ..Run::default() })
}

/// Identifies a run without prior knowledge.
pub fn identified(run: Run) -> Result<Identified, IdentifyError> {
    identify(&[run], &Options { no_profiles: true, ..Options::default() }, &mut |_| ())
}

/// Error and interval of each of [`GOALS`], in the unit of the goal; `None` if no value was found.
pub fn errors(device: &Inerter, found: &Identified) -> [Option<(f64, f64)>; 6] {
    let p = &found.parameters;
    let all = [
        (&p.inertance_kg, device.inertance_kg),
        (&p.coulomb_n, device.coulomb_n),
        (&p.viscous_n_s_per_m, device.viscous_n_s_per_m),
        (&p.stiffness_n_per_m, device.stiffness_n_per_m),
        (&p.contact_damping_n_s_per_m, device.contact_damping_n_s_per_m),
        (&p.backlash_m, device.backlash_m),
    ];
    array::from_fn(|i| {
        let ((found, truth), (name, _)) = (all[i], GOALS[i]);
        let per = if name.ends_with('%') { truth } else { 1.0 };
        let known = found.value.zip(found.u95).filter(|_| found.status != FoundStatus::NotIdentifiable);
        known.map(|(value, u95)| ((value - truth) / per, u95 / per))
    })
}
