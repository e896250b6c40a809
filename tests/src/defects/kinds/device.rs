//! Defects of the device: friction, inertance and other forces on the screw.

use super::kind::{Kind, kind};
use crate::defects::{draw::Draw, scene::Scene};
use inerter_plant::Inerter;
use std::f64::consts::TAU;

/// A lead that matches a common number of counts per turn, or 10 mm if none matches.
fn turn_m(scene: &Scene, draw: &mut Draw) -> f64 {
    scene.turn_counts(draw).map_or(0.01, |counts| counts * scene.instruments.sensors.metres_per_count)
}

pub const KINDS: [Kind; 22] = [
    kind("friction that grows with the load", &["load_dependent"], |scene, draw| {
        scene.second_body().load = draw.between(0.005, 0.08);
    }),
    kind("force once a turn", &["position_periodic"], |scene, draw| {
        scene.second_body().ripple_n = draw.between(0.03, 0.4) * scene.device.coulomb_n;
        scene.body.turn_m = turn_m(scene, draw);
    }),
    kind("force twice a turn", &["position_periodic"], |scene, draw| {
        scene.second_body().ripple_n = draw.between(0.03, 0.4) * scene.device.coulomb_n;
        scene.body.turn_m = turn_m(scene, draw) / 2.0;
    }),
    kind("friction that varies once a turn", &["position_periodic"], |scene, draw| {
        scene.second_body().ripple_friction = draw.between(0.05, 0.5);
        scene.body.turn_m = turn_m(scene, draw);
    }),
    kind("friction greater at low speed (Stribeck)", &["stribeck"], |scene, draw| {
        let (surplus, fall, power) = (draw.between(0.1, 0.6), draw.between(2e-3, 15e-3), draw.one_of(&[1.0, 2.0]));
        if power == 2.0 {
            // Both plants can do this one.
            scene.device = Inerter { stribeck_ratio: 1.0 + surplus, stribeck_velocity_m_per_s: fall, ..scene.device };
        }
        scene.body.stribeck = (surplus, fall, power);
        scene.by_second |= power != 2.0;
    }),
    kind("friction that turns over a distance (presliding)", &["presliding"], |scene, draw| {
        let presliding_m = draw.between(5e-6, 200e-6);
        scene.device.presliding_m = presliding_m;
        // The elements slip one after the other, so most of the friction is already reached at `presliding_m`.
        scene.body.presliding_m = 3.0 * presliding_m;
    }),
    kind("dry friction that falls as it warms", &["drift"], |scene, draw| {
        let part = -draw.between(0.1, 0.4);
        scene.truth[2].0 *= 1.0 + part;
        scene.second_body().warming = (part, 0.0, draw.between(0.3, 1.0));
    }),
    kind("viscous friction that falls as it warms", &["drift"], |scene, draw| {
        let part = -draw.between(0.2, 0.6);
        scene.truth[1].0 *= 1.0 + part;
        scene.second_body().warming = (0.0, part, draw.between(0.3, 1.0));
    }),
    kind("dry friction that differs by direction", &["direction"], |scene, draw| {
        scene.device.coulomb_asymmetry = draw.sign() * draw.between(0.1, 0.5);
    }),
    kind("viscous friction that differs by direction", &["direction"], |scene, draw| {
        scene.device.viscous_asymmetry = draw.sign() * draw.between(0.1, 0.6);
    }),
    kind("friction by the square of the velocity", &["quadratic_friction"], |scene, draw| {
        let quadratic = draw.between(0.2, 2.0) * scene.device.viscous_n_s_per_m / scene.seen.speed_rms_m_per_s;
        // Any slope of the friction that occurs in the run counts as true.
        scene.truth[1].1 += 2.0 * quadratic * scene.seen.speed_m_per_s;
        scene.second_body().quadratic = quadratic;
    }),
    kind("inertance that changes with the position", &[], |scene, draw| {
        let part = draw.between(0.01, 0.2);
        let truth = scene.device.inertance_kg;
        scene.truth[0] = (truth * (1.0 - part), truth * (1.0 + part));
        scene.second_body().inertance_by_place = draw.sign() * part / scene.seen.stroke_m;
    }),
    kind("inertance that grows with the speed", &[], |scene, draw| {
        let part = draw.between(0.01, 0.2);
        scene.truth[0].1 *= 1.0 + part;
        scene.second_body().inertance_by_speed = part / 3.0 / scene.seen.speed_m_per_s.powi(2);
    }),
    kind("a spring in parallel", &["spring"], |scene, draw| {
        let own = TAU * draw.between(0.05, 0.5);
        scene.second_body().spring_n_per_m = scene.device.inertance_kg * own * own;
    }),
    kind("a hose that pulls either way", &["spring"], |scene, draw| {
        scene.second_body().hose =
            (draw.between(0.05, 0.5) * scene.device.coulomb_n, draw.between(0.1, 0.5) * scene.seen.stroke_m);
    }),
    kind("a bumper at the end of the stroke", &["spring"], |scene, draw| {
        let stop_m = draw.within(0.7, 0.95) * scene.seen.stroke_m;
        let stiffness = draw.between(0.1, 1.0) * scene.seen.peak_n / (0.1 * scene.seen.stroke_m);
        scene.second_body().stop = (stop_m, stiffness);
    }),
    kind("a flywheel that slips on its shaft", &[], |scene, draw| {
        let most_n = (scene.seen.peak_n - scene.device.coulomb_n).max(1.0);
        scene.second_body().slip_n = draw.within(0.6, 0.95) * most_n;
    }),
    kind("a shaft that bends", &["compliance"], |scene, draw| {
        let own = TAU * draw.between(40.0, 150.0);
        // The apparent inertance grows with the frequency; the range covers the highest frequency of the motions.
        scene.truth[0].1 /= 1.0 - (TAU * 17.0 / own).powi(2);
        scene.second_body().shaft_n_per_m = scene.device.inertance_kg * own * own;
    }),
    kind("a damper that relaxes", &["relaxation", "spring"], |scene, draw| {
        let damping = draw.between(0.5, 5.0) * scene.device.viscous_n_s_per_m;
        scene.truth[1].1 += damping;
        scene.second_body().relaxing = (damping, draw.between(3e-3, 50e-3));
    }),
    kind("backlash that nobody stated", &[], |scene, draw| {
        scene.device.backlash_m = draw.between(20e-6, 500e-6);
    }),
    kind("flanks that bounce", &[], |scene, draw| {
        scene.device.backlash_m = draw.between(50e-6, 500e-6);
        scene.device.contact_damping_n_s_per_m *= 0.2;
        scene.settings.contact_damping_n_s_per_m *= 0.2;
    }),
    kind("a friction damper without mass", &["wrong_sign"], |scene, draw| {
        let inertance_kg = 0.002 * scene.device.inertance_kg;
        scene.truth[0] = (inertance_kg, inertance_kg);
        scene.device.inertance_kg = inertance_kg;
        scene.device.backlash_m = draw.between(50e-6, 500e-6);
        scene.by_second = true;
    }),
];
