//! Wrong scales. They form a group of their own, because another device would give exactly the same samples.

use super::kind::{Group, Kind};
use crate::defects::{draw::Draw, instruments::creep, scene::Scene};

const fn kind(name: &'static str, make: fn(&mut Scene, &mut Draw)) -> Kind {
    Kind { name, group: Group::Scale, names: &[], make }
}

pub const KINDS: [Kind; 7] = [
    kind("force gain wrong", |scene, draw| {
        scene.settings.newtons_per_code *= 1.0 + draw.sign() * draw.between(0.01, 0.2);
    }),
    kind("metres per count wrong by a factor of 4", |scene, draw| {
        scene.settings.metres_per_count *= draw.one_of(&[0.25, 4.0]);
    }),
    kind("lead wrong", |scene, draw| {
        scene.settings.metres_per_count *= 1.0 + draw.sign() * draw.between(0.01, 0.1);
    }),
    kind("clock off", |scene, draw| {
        scene.settings.sample_rate_hz *= 1.0 + draw.sign() * draw.between(0.003, 0.05);
    }),
    kind("structure mass wrong", |scene, draw| {
        scene.settings.structure_mass_kg += draw.between(0.005, 0.03) * scene.device.inertance_kg;
    }),
    // Over times longer than its time constant, creep acts as a gain: the scale calibrated with a weight is not the
    // scale of a motion.
    kind("creep of the load cell", |scene, draw| {
        let (part, time_s) = (draw.between(0.005, 0.05), draw.between(0.5, 10.0));
        creep(&mut scene.trace.force_n, scene.trace.step_s, part, time_s);
    }),
    kind("stiffness wrong", |scene, draw| {
        scene.settings.stiffness_n_per_m *= draw.one_of(&[0.3, 0.5, 2.0, 3.0]);
        scene.settings.stiffness_u95_n_per_m = 1e-6 * scene.settings.stiffness_n_per_m;
    }),
];
