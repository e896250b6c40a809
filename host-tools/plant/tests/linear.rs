//! Without friction and backlash the device is linear, and its response to a sine is known in closed form.

use std::f64::consts::TAU;

use inerter_plant::{Excitation, Inerter, Plant};

/// `F/x1 = (mt s^2 + cf s)(cs s + ks) / (mt s^2 + (cs + cf) s + ks)` at `s = j w`: real and imaginary part.
fn force_per_displacement(p: &Inerter, w: f64) -> (f64, f64) {
    let (mt, cf, ks, cs) = (p.inertance_kg, p.viscous_n_s_per_m, p.stiffness_n_per_m, p.contact_damping_n_s_per_m);
    let multiply = |a: (f64, f64), b: (f64, f64)| (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
    let above = multiply((-mt * w * w, cf * w), (ks, cs * w));
    let below = (ks - mt * w * w, (cs + cf) * w);
    let square = below.0 * below.0 + below.1 * below.1;
    multiply(above, (below.0 / square, -below.1 / square))
}

/// Maximum deviation of the force from the closed form, relative to its amplitude, after transients have decayed.
fn deviation(device: Inerter, frequency_hz: f64) -> f64 {
    let w = TAU * frequency_hz;
    let (re, im) = force_per_displacement(&device, w);
    let amplitude_m = 1e-3;
    let amplitude_n = amplitude_m * re.hypot(im);
    let decay = (device.contact_damping_n_s_per_m + device.viscous_n_s_per_m) / (2.0 * device.inertance_kg);
    // The slowest transient: friction alone if the contact is stiff, or the contact's resonance.
    let slowest = decay.min(device.viscous_n_s_per_m / device.inertance_kg);
    let settled_s = 30.0 / slowest;
    let mut plant = Plant::new(device, Excitation::sine(frequency_hz, amplitude_m)).unwrap();
    let mut segment = plant.next_segment();
    while segment.start_s() < settled_s {
        segment = plant.next_segment();
    }
    let mut worst = 0.0f64;
    while segment.start_s() < settled_s + 2.0 / frequency_hz {
        for k in 0..4 {
            let truth = segment.at_fraction(f64::from(k) * 0.27);
            let (sin, cos) = (w * truth.t_s).sin_cos();
            let exact = amplitude_m * (re * sin + im * cos);
            worst = worst.max((truth.force_n - exact).abs() / amplitude_n);
        }
        segment = plant.next_segment();
    }
    worst
}

#[test]
fn force_per_displacement_is_the_closed_form() {
    let linear = Inerter { coulomb_n: 0.0, ..Inerter::paper() };
    // Ten times the paper's viscous friction, so that transients decay sooner. The device is linear, so any value will
    // do.
    let damped = Inerter { viscous_n_s_per_m: 314.0, ..linear };
    let stiff = Inerter { stiffness_n_per_m: 1e9, contact_damping_n_s_per_m: 1e5, viscous_n_s_per_m: 1e3, ..linear };
    let soft = Inerter { stiffness_n_per_m: 2e4, inertance_kg: 2.0, ..linear };
    // Below, at and above the resonance at 13.3 Hz, including the paper's three tests.
    let damped = [0.053, 0.5, 3.2, 10.0, 13.3, 15.9, 40.0, 100.0].map(|frequency_hz| ("damped", damped, frequency_hz));
    let others = [("paper's friction", linear, 15.9), ("stiff", stiff, 15.9), ("soft and light", soft, 15.9)];
    let mut worst = 0.0f64;
    for (name, device, frequency_hz) in damped.into_iter().chain(others) {
        let error = deviation(device, frequency_hz);
        println!("{name}, {frequency_hz} Hz: {error:.1e}");
        worst = worst.max(error);
    }
    assert!(worst < 1e-8, "{worst:.1e}");
}
