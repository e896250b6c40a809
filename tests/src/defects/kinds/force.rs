//! Defects of the force channel: load cell, mount, amplifier and converter.

use super::kind::{Kind, kind};
use crate::defects::instruments::{lag, play, resonance};
use crate::defects::{draw::Draw, plant::Trace, scene::Scene};
use std::f64::consts::TAU;

/// Changes the force at the converter, given the time \[s\].
fn on_force(scene: &mut Scene, change: impl Fn(f64, f64, &mut Draw) -> f64 + 'static) {
    scene.instruments.on_force.push(Box::new(change));
}

/// Time since the last event \[s\], negative before it. The golden ratio places each event at another phase of its
/// period, so that events do not follow the motion.
fn since_s(turns: f64, every_s: f64) -> f64 {
    (turns.fract() - (turns.floor() * 0.618).fract() * 0.8) * every_s
}

/// Converts a force to a number of codes.
fn code(scene: &Scene, force_n: f64) -> i32 {
    (force_n / scene.instruments.sensors.newtons_per_code) as i32
}

pub const KINDS: [Kind; 25] = [
    kind("force inverted", &["wrong_sign"], |scene, _| {
        scene.on_each_sample(|sample, _| sample.force_code = -sample.force_code);
    }),
    kind("a low-pass that nobody stated", &["skew"], |scene, draw| {
        let time_s = 1.0 / (TAU * draw.between(20.0, 200.0));
        lag(&mut scene.trace.force_n, scene.trace.step_s, time_s);
    }),
    kind("a skew that nobody stated", &["skew"], |scene, draw| {
        let late_s = draw.sign() * draw.between(0.2e-3, 5e-3);
        let trace = &scene.trace;
        let moved =
            (0..trace.force_n.len()).map(|n| trace.at(&trace.force_n, n as f64 * trace.step_s - late_s)).collect();
        scene.trace.force_n = moved;
    }),
    kind("a skew that comes midway", &["skew"], |scene, draw| {
        let (samples, from) = (draw.within(1.0, 4.0) as usize, draw.within(0.2, 0.8));
        scene.on_samples(move |all, _| {
            let codes: Vec<i32> = all.iter().map(|sample| sample.force_code).collect();
            let from = (from * all.len() as f64) as usize;
            all.iter_mut().enumerate().skip(from).for_each(|(n, sample)| sample.force_code = codes[n - samples]);
        });
    }),
    kind("a load cell that sits loose", &["force_nonlinear"], |scene, draw| {
        let dead_n = draw.between(0.01, 0.1) * scene.seen.peak_n;
        scene.trace.force_n.iter_mut().for_each(|force| *force -= force.clamp(-dead_n, dead_n));
    }),
    kind("a load cell that is not straight", &["force_nonlinear"], |scene, draw| {
        let part = draw.sign() * draw.between(0.003, 0.05) / scene.seen.peak_n;
        scene.trace.force_n.iter_mut().for_each(|force| *force += part * *force * *force);
    }),
    kind("a force that saturates softly", &["clipped_force", "force_nonlinear"], |scene, draw| {
        let part = draw.between(0.01, 0.1) / scene.seen.peak_n.powi(2);
        scene.trace.force_n.iter_mut().for_each(|force| *force -= part * force.powi(3));
    }),
    kind("a force clipped below its rails", &["clipped_force", "force_nonlinear"], |scene, draw| {
        let most = draw.within(0.6, 0.95) * scene.seen.peak_n;
        on_force(scene, move |force, _, _| force.clamp(-most, most));
    }),
    kind("the same with noise behind the clip", &["clipped_force", "force_nonlinear"], |scene, draw| {
        let most = draw.within(0.6, 0.95) * scene.seen.peak_n;
        scene.instruments.late_noise_n = scene.instruments.sensors.force_noise_n;
        scene.instruments.sensors.force_noise_n *= 0.1;
        on_force(scene, move |force, _, _| force.clamp(-most, most));
    }),
    kind("a force clipped on one side", &["clipped_force", "force_nonlinear"], |scene, draw| {
        let most = draw.within(0.6, 0.95) * scene.seen.peak_n;
        on_force(scene, move |force, _, _| force.min(most));
    }),
    kind("a force of few bits", &[], |scene, draw| {
        let step = code(scene, draw.between(0.003, 0.05) * scene.seen.peak_n).max(2);
        scene.on_each_sample(move |sample, _| sample.force_code = sample.force_code.div_euclid(step) * step);
    }),
    kind("a force that stands still from some moment on", &["dead_force"], |scene, draw| {
        let from = draw.within(0.1, 0.9);
        scene.on_samples(move |all, _| {
            let from = (from * all.len() as f64) as usize;
            let held = all.get(from).map_or(0, |sample| sample.force_code);
            all.iter_mut().skip(from).for_each(|sample| sample.force_code = held);
        });
    }),
    kind("a cable that breaks and leaves noise", &["dead_force"], |scene, draw| {
        let from_s = draw.within(0.1, 0.9) * scene.seen.duration_s;
        let noise_n = scene.instruments.sensors.force_noise_n;
        on_force(scene, move |force, t_s, draw| if t_s < from_s { force } else { noise_n * draw.noise() });
    }),
    kind("a contact that fails for moments", &["dead_force"], |scene, draw| {
        let (length_s, every_s) = (draw.between(5e-3, 50e-3), draw.between(0.5, 5.0));
        let offset_s = draw.within(0.0, every_s);
        on_force(scene, move |force, t_s, _| {
            let fails = (0.0..length_s).contains(&since_s((t_s + offset_s) / every_s, every_s));
            if fails { 0.0 } else { force }
        });
    }),
    kind("an offset that drifts", &["drift"], |scene, draw| {
        let rate = draw.sign() * draw.between(0.1, 2.0) * scene.device.coulomb_n / scene.seen.duration_s;
        on_force(scene, move |force, t_s, _| force + rate * t_s);
    }),
    kind("hysteresis of the load cell", &["force_nonlinear"], |scene, draw| {
        let width = draw.between(0.004, 0.06) * scene.seen.peak_n;
        let mut late = scene.trace.force_n.clone();
        play(&mut late, width);
        scene.trace.force_n.iter_mut().zip(late).for_each(|(force, late)| *force = 0.5 * (*force + late));
    }),
    kind("a mount that rings", &["skew", "compliance"], |scene, draw| {
        let (rate, damping) = (TAU * draw.between(40.0, 200.0), draw.between(0.02, 0.2));
        resonance(&mut scene.trace.force_n, scene.trace.step_s, rate, damping);
    }),
    kind("pickup of the mains", &[], |scene, draw| {
        let (amplitude_n, hz) = (draw.between(0.005, 0.1) * scene.seen.peak_n, draw.one_of(&[16.7, 50.0, 60.0]));
        on_force(scene, move |force, t_s, _| force + amplitude_n * (TAU * hz * t_s).sin());
    }),
    kind("impulses in the force", &[], |scene, draw| {
        let (height_n, often) = (draw.between(0.1, 2.0) * scene.seen.peak_n, draw.between(0.0005, 0.02));
        on_force(
            scene,
            move |force, _, draw| {
                if draw.happens(often) { force + height_n * draw.sign() * draw.unit() } else { force }
            },
        );
    }),
    kind("coloured noise of the force", &[], |scene, draw| {
        let (rms_n, hz) = (draw.between(0.002, 0.05) * scene.seen.peak_n, draw.between(0.5, 20.0));
        let mut own = Draw::new((draw.unit() * 1e9) as u64, 1);
        let part = TAU * hz * scene.trace.step_s;
        let mut state = 0.0;
        scene.trace.force_n.iter_mut().for_each(|force| {
            state += -part * state + (2.0 * part).sqrt() * own.noise();
            *force += rms_n * state;
        });
    }),
    kind("noise that grows with the force", &[], |scene, draw| {
        let part = draw.between(0.01, 0.1);
        on_force(scene, move |force, _, draw| force * (1.0 + part * draw.noise()));
    }),
    kind("crosstalk from the encoder's edges", &[], |scene, draw| {
        let step = code(scene, draw.between(0.002, 0.03) * scene.seen.peak_n);
        scene.on_each_sample(move |sample, _| {
            sample.force_code += step * i32::from(sample.position_count & 3 == 0);
        });
    }),
    kind("crosstalk from the position", &["spring"], |scene, draw| {
        let rate = draw.sign() * draw.between(0.003, 0.05) * scene.seen.peak_n / scene.seen.stroke_m;
        let Trace { position_m, force_n, .. } = &mut scene.trace;
        force_n.iter_mut().zip(position_m).for_each(|(force, x)| *force += rate * *x);
    }),
    kind("knocks against the rig", &[], |scene, draw| {
        let (height_n, every_s) = (draw.between(0.1, 1.0) * scene.seen.peak_n, draw.between(1.0, 8.0));
        let length_s = draw.between(3e-3, 20e-3);
        on_force(scene, move |force, t_s, _| {
            let since_s = since_s(t_s / every_s, every_s);
            let inside = (0.0..length_s).contains(&since_s);
            if inside { force + height_n * (TAU / 2.0 * since_s / length_s).sin() } else { force }
        });
    }),
    kind("an amplifier that switches its range", &["force_nonlinear"], |scene, draw| {
        let (from, part) = (draw.within(0.3, 0.8) * scene.seen.peak_n, 1.0 + draw.sign() * draw.between(0.005, 0.05));
        on_force(scene, move |force, _, _| if force.abs() > from { part * force } else { force });
    }),
];
