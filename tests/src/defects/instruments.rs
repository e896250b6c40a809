//! The instruments of the defects: load cell, encoder and sampler, written independently of the simulator.
//!
//! A defect acts at one of four places: on the force at the load cell or the position at the encoder (it changes the
//! trace), on the time at which a sample is taken, on the force's electronics, or on the samples as sent.

use super::{draw::Draw, plant::Trace};
use inerter_core::RawSample;
use inerter_plant::Sensors;

/// Acts on the samples as sent.
pub type OnSamples = Box<dyn Fn(&mut Vec<RawSample>, &mut Draw)>;
/// Maps the nominal time of a sample to the time at which it is truly taken \[s\].
pub type Clock = Box<dyn Fn(f64, &mut Draw) -> f64>;
/// Maps the force and the time \[s\] to the converted force, before the converter's noise.
pub type OnForce = Box<dyn Fn(f64, f64, &mut Draw) -> f64>;

/// Instruments, with their defects.
#[derive(Default)]
pub struct Instruments {
    /// Scales, noise and offset.
    pub sensors: Sensors,
    /// When a sample is truly taken.
    pub clock: Option<Clock>,
    /// Defects of the force channel's electronics.
    pub on_force: Vec<OnForce>,
    /// Noise that the converter adds after these defects \[N\].
    pub late_noise_n: f64,
    /// Defects of the samples as sent.
    pub on_samples: Vec<OnSamples>,
}

impl Instruments {
    /// The samples of a trace.
    pub fn samples(&self, trace: &Trace, duration_s: f64, draw: &mut Draw) -> Vec<RawSample> {
        let sensors = &self.sensors;
        let count = (duration_s * sensors.sample_rate_hz) as u32;
        let mut samples: Vec<RawSample> = (0..count)
            .map(|n| {
                let nominal_s = f64::from(n) / sensors.sample_rate_hz;
                let t_s = self.clock.as_ref().map_or(nominal_s, |clock| clock(nominal_s, draw));
                let position = trace.at(&trace.position_m, t_s) / sensors.metres_per_count;
                let mut force = trace.at(&trace.force_n, t_s) + sensors.force_offset_n;
                force += sensors.force_noise_n * draw.noise();
                force = self.on_force.iter().fold(force, |force, defect| defect(force, t_s, draw));
                force += self.late_noise_n * draw.noise();
                RawSample {
                    index: n,
                    position_count: (position + sensors.encoder_phase_count).floor() as i32,
                    force_code: (force / sensors.newtons_per_code).round() as i32,
                    terminal_code: 0,
                }
            })
            .collect();
        self.on_samples.iter().for_each(|defect| defect(&mut samples, draw));
        samples
    }
}

/// A first-order low-pass on a signal, with its time constant \[s\].
pub fn lag(signal: &mut [f64], step_s: f64, time_s: f64) {
    let part = 1.0 - (-step_s / time_s).exp();
    let mut state = signal.first().copied().unwrap_or(0.0);
    signal.iter_mut().for_each(|value| {
        state += part * (*value - state);
        *value = state;
    });
}

/// A second-order resonance driven by the signal, with natural frequency \[rad/s\] and damping ratio.
pub fn resonance(signal: &mut [f64], step_s: f64, rate: f64, damping: f64) {
    let (mut x, mut v) = (signal.first().copied().unwrap_or(0.0), 0.0);
    for value in signal {
        // Semi-implicit Euler: with low damping, stable up to a natural frequency of about 2 rad per step.
        v += step_s * (rate * rate * (*value - x) - 2.0 * damping * rate * v);
        x += step_s * v;
        *value = x;
    }
}

/// Play of this width: the output trails the signal by half of it.
pub fn play(signal: &mut [f64], width: f64) {
    let mut at = signal.first().copied().unwrap_or(0.0);
    signal.iter_mut().for_each(|value| {
        at = at.clamp(*value - 0.5 * width, *value + 0.5 * width);
        *value = at;
    });
}

/// Creep with one time constant \[s\]: a fraction of the signal arrives late.
pub fn creep(signal: &mut [f64], step_s: f64, part: f64, time_s: f64) {
    let mut slow = signal.to_vec();
    lag(&mut slow, step_s, time_s);
    signal.iter_mut().zip(slow).for_each(|(value, slow)| *value = (1.0 - part) * *value + part * slow);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filters_do_what_their_names_say() {
        let step_s = 1e-4;
        let mut late = vec![1.0; 100];
        late[0] = 0.0;
        lag(&mut late, step_s, 50.0 * step_s);
        assert!((late[50] - (1.0 - (-1.0_f64).exp())).abs() < 0.02, "{}", late[50]);
        let mut loose: Vec<f64> = (0..200).map(|n| (f64::from(n) * 0.1).sin()).collect();
        play(&mut loose, 0.4);
        let most = loose.iter().fold(0.0, |most, x| f64::max(most, *x));
        assert!((most - 0.8).abs() < 0.01, "{most}");
        // At half its natural frequency a resonance gives 4/3 of the signal.
        let mut rung: Vec<f64> = (0..40_000).map(|n| (f64::from(n) * step_s * 100.0).sin()).collect();
        resonance(&mut rung, step_s, 200.0, 0.05);
        let most = rung[30_000..].iter().fold(0.0, |most, x| f64::max(most, *x));
        assert!((most - 4.0 / 3.0).abs() < 0.02, "{most}");
        let mut crept = vec![1.0; 1000];
        crept[0] = 0.0;
        creep(&mut crept, step_s, 0.1, 20.0 * step_s);
        assert!((crept[1] - 0.905).abs() < 1e-3 && (crept[999] - 1.0).abs() < 1e-3, "{crept:?}");
    }

    #[test]
    fn instruments_floor_counts_and_round_codes() {
        let sensors = Sensors { metres_per_count: 1e-3, newtons_per_code: 0.5, ..Sensors::default() };
        let instruments = Instruments { sensors, ..Instruments::default() };
        let trace = Trace { step_s: 1e-3, position_m: vec![1.7e-3; 50], force_n: vec![-1.1; 50] };
        let samples = instruments.samples(&trace, 0.02, &mut Draw::new(1, 1));
        assert_eq!(samples.len(), 20);
        assert!(samples.iter().all(|sample| (sample.position_count, sample.force_code) == (1, -2)));
    }
}
