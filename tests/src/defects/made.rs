//! A run with a defect: device, motion, rig and defect are all random.

use super::{
    draw::Draw,
    instruments::Instruments,
    kinds::Kind,
    plant::{Body, Trace, first_trace, trace},
    scene::{Scene, Seen},
};
use crate::{
    coverage::stated_true,
    grid::{Error, calibrated, truth},
};
use inerter_core::{RawSample, Settings};
use inerter_plant::{Excitation, Inerter, Sensors};
use std::f64::consts::TAU;

/// Motions, by the kind of excitation.
pub const MOTIONS: [&str; 6] = ["slow tone", "tone", "fast tone", "multisine", "random", "two tones"];

/// A device of realistic size. In most cases its natural frequency is above the frequencies of the motions.
fn device(draw: &mut Draw) -> Inerter {
    let inertance_kg = draw.between(40.0, 600.0);
    let own = TAU * draw.between(12.0, 50.0);
    let stiffness_n_per_m = inertance_kg * own * own;
    Inerter {
        inertance_kg,
        viscous_n_s_per_m: draw.between(0.03, 0.5) * inertance_kg,
        coulomb_n: draw.between(0.03, 0.4) * inertance_kg,
        stiffness_n_per_m,
        contact_damping_n_s_per_m: 2.0 * draw.between(0.015, 0.08) * inertance_kg * own,
        structure_mass_kg: draw.between(0.002, 0.01) * inertance_kg,
        ..Inerter::paper()
    }
}

/// A random rig for this device.
fn sensors(device: &Inerter, draw: &mut Draw) -> Sensors {
    let scale = device.inertance_kg / 300.0;
    Sensors {
        sample_rate_hz: draw.one_of(&[1000.0, 1000.0, 2000.0]),
        metres_per_count: draw.one_of(&[0.5e-6, 1e-6, 2.441_406_25e-6, 5e-6]),
        encoder_phase_count: draw.unit(),
        newtons_per_code: 0.002 * scale,
        force_offset_n: draw.within(-10.0, 10.0) * scale,
        force_noise_n: draw.between(0.2, 4.0) * scale,
        ..Sensors::default()
    }
}

/// A random motion like those of the grid, and its length \[s\].
fn excitation(motion: &str, seed: u64, draw: &mut Draw) -> Result<(Excitation, f64), Error> {
    let tone = |draw: &mut Draw, low, high, slow: f64, quick: f64| {
        let frequency: f64 = draw.between(low, high);
        format!("{frequency:.4}Hz:{:.5}mm", 1e3 * draw.between(slow, quick) / (TAU * frequency))
    };
    let text = match motion {
        "slow tone" => format!("sine:{}", tone(draw, 0.04, 0.1, 4e-3, 8e-3)),
        "tone" => format!("sine:{}", tone(draw, 2.0, 5.0, 0.05, 0.12)),
        "fast tone" => format!("sine:{}", tone(draw, 9.0, 17.0, 0.05, 0.1)),
        "two tones" => {
            format!("tones:{},{}", tone(draw, 0.6, 1.2, 0.03, 0.05), tone(draw, 4.0, 8.0, 0.02, 0.04))
        }
        "multisine" => format!("multi:0.5-{:.2}Hz:{:.3}mm/s", draw.within(8.0, 15.0), draw.within(15.0, 40.0)),
        _ => format!("random:0.5-{:.2}Hz:{:.3}mm/s", draw.within(8.0, 15.0), draw.within(15.0, 40.0)),
    };
    let duration_s = if motion == "slow tone" { 60.0 } else { 20.0 };
    Ok((Excitation::parse(&text, seed)?, duration_s))
}

/// Makes the run of a kind, a motion and a seed; a clean run if there is no kind. Returns its ingredients and samples.
pub fn make(kind: Option<&Kind>, motion: usize, seed: u64) -> Result<(Scene, Vec<RawSample>), Error> {
    // Device, rig and motion depend only on the seed, not on the defect.
    let mut draw = Draw::new(seed, motion as u64);
    let name = MOTIONS.get(motion).copied().unwrap_or_default();
    let device = device(&mut draw);
    let sensors = sensors(&device, &mut draw);
    let (excitation, duration_s) = excitation(name, seed, &mut draw)?;
    let by_second = draw.happens(0.5);
    let settings = Settings { skew_s: 0.0, ..stated_true(calibrated(&device, &sensors)) };
    let truth = truth(&device).map(|value| (value, value));
    let traced = |scene: &Scene| {
        if scene.by_second {
            Ok(trace(&scene.device, &scene.body, &excitation, duration_s))
        } else {
            first_trace(&scene.device, &excitation, duration_s)
        }
    };
    let mut scene = Scene {
        device,
        body: Body::default(),
        trace: Trace::default(),
        instruments: Instruments { sensors, ..Instruments::default() },
        settings,
        truth,
        seen: Seen::default(),
        by_second,
    };
    scene.trace = traced(&scene)?;
    scene.seen = Seen::of(&scene.trace, duration_s);
    // The defect's random numbers depend on its name.
    let stream =
        kind.map_or(0, |kind| kind.name.bytes().fold(7, |sum: u64, byte| sum.wrapping_mul(31) + u64::from(byte)));
    let mut own = Draw::new(seed, 1000 + 8 * (stream & 0xffff_ffff) + motion as u64);
    if let Some(kind) = kind {
        (kind.make)(&mut scene, &mut own);
        // A defect of the device; the others change the trace, the instruments or the settings.
        if (scene.device, scene.body, scene.by_second) != (device, Body::default(), by_second) {
            scene.trace = traced(&scene)?;
        }
    }
    let samples = scene.instruments.samples(&scene.trace, duration_s, &mut own);
    Ok((scene, samples))
}
