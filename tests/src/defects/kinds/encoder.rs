//! Defects of the encoder and of its mount.

use super::kind::{Kind, kind};
use crate::defects::{draw::Draw, instruments::play, plant::Trace, scene::Scene};
use inerter_core::RawSample;
use std::f64::consts::TAU;

/// Changes each position at the encoder, given the length of a count \[m\].
fn on_shaft(scene: &mut Scene, change: impl Fn(f64, f64) -> f64) {
    let count_m = scene.instruments.sensors.metres_per_count;
    scene.trace.position_m.iter_mut().for_each(|x| *x = change(*x, count_m));
}

/// Adds the function's return value to the count of this sample and all later ones.
fn on_counts(scene: &mut Scene, change: impl Fn(&RawSample, &RawSample, &mut Draw) -> i32 + 'static) {
    scene.on_samples(move |samples, draw| {
        let mut lost = 0_i32;
        for n in 1..samples.len() {
            let (before, here) = (samples[n - 1], samples[n]);
            // The true counts of both samples, without the earlier slips.
            let before = RawSample { position_count: before.position_count - lost, ..before };
            lost += change(&before, &here, draw);
            samples[n].position_count += lost;
        }
    });
}

/// A common number of counts per turn.
fn turn_counts(scene: &Scene, draw: &mut Draw) -> f64 {
    scene.turn_counts(draw).unwrap_or(4096.0)
}

pub const KINDS: [Kind; 12] = [
    kind("encoder inverted", &["wrong_sign"], |scene, _| {
        scene.on_each_sample(|sample, _| sample.position_count = -sample.position_count);
    }),
    kind("an encoder off its centre", &["encoder_error"], |scene, draw| {
        let (off_m, counts, phase) = (draw.between(2e-6, 50e-6), turn_counts(scene, draw), draw.within(0.0, TAU));
        on_shaft(scene, |x, count_m| x + off_m * (TAU * x / (counts * count_m) + phase).sin());
    }),
    kind("an error within the encoder's lines", &["encoder_error"], |scene, draw| {
        let part = draw.between(0.3, 2.0);
        on_shaft(scene, |x, count_m| x + part * count_m * (TAU * x / (4.0 * count_m)).sin());
    }),
    kind("a line that is missing", &["encoder_error", "count_slip"], |scene, draw| {
        let (counts, place) = (turn_counts(scene, draw), draw.unit());
        // One line is four counts, which are missing each time it passes, in either direction.
        on_shaft(scene, |x, count_m| x - 4.0 * count_m * (x / (counts * count_m) + place).floor());
    }),
    kind("counts that slip once", &["count_slip"], |scene, draw| {
        let (place, by) = (draw.within(0.2, 0.8), (draw.sign() * draw.between(5.0, 500.0)) as i32);
        scene.on_samples(move |samples, _| {
            let from = (place * samples.len() as f64) as usize;
            samples.iter_mut().skip(from).for_each(|sample| sample.position_count += by);
        });
    }),
    kind("counts that slip again and again", &["count_slip"], |scene, draw| {
        let (by, often) = (draw.between(3.0, 200.0), draw.between(0.3, 5.0) / scene.instruments.sensors.sample_rate_hz);
        on_counts(scene, move |_, _, draw| if draw.happens(often) { (draw.sign() * by) as i32 } else { 0 });
    }),
    kind("counts that are lost at speed", &["count_slip"], |scene, draw| {
        let sensors = &scene.instruments.sensors;
        let fastest = scene.seen.speed_m_per_s / sensors.metres_per_count / sensors.sample_rate_hz;
        let (from, part) = (draw.within(0.6, 0.9) * fastest, draw.between(0.02, 0.3));
        on_counts(scene, move |before, here, draw| {
            let moved = here.position_count - before.position_count;
            let is_fast = f64::from(moved.abs()) > from;
            if is_fast { -(part * f64::from(moved) + draw.unit() - 0.5).round() as i32 } else { 0 }
        });
    }),
    kind("an encoder whose lowest bits stand still", &[], |scene, draw| {
        let step = draw.one_of(&[2, 4, 8]);
        scene.on_each_sample(move |sample, _| sample.position_count = sample.position_count.div_euclid(step) * step);
    }),
    kind("positions that are wrong for one sample", &["count_slip"], |scene, draw| {
        let (by, often) =
            (draw.between(5.0, 2000.0), draw.between(0.1, 10.0) / scene.instruments.sensors.sample_rate_hz);
        scene.on_each_sample(move |sample, draw| {
            if draw.happens(often) {
                sample.position_count += (draw.sign() * by) as i32;
            }
        });
    }),
    kind("play between screw and encoder", &["encoder_error"], |scene, draw| {
        let width_m = draw.between(5e-6, 100e-6);
        play(&mut scene.trace.position_m, width_m);
    }),
    kind("an encoder on a frame that bends", &["compliance"], |scene, draw| {
        let stiffness = draw.between(3.0, 100.0) * scene.device.stiffness_n_per_m;
        let Trace { position_m, force_n, .. } = &mut scene.trace;
        position_m.iter_mut().zip(force_n).for_each(|(x, force)| *x += *force / stiffness);
    }),
    kind("an encoder that flickers", &[], |scene, draw| {
        let most = draw.between(1.0, 6.0);
        scene.on_each_sample(move |sample, draw| {
            sample.position_count += (most * draw.within(-1.0, 1.0)).round() as i32;
        });
    }),
];
