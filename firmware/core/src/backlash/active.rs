//! Settings of the two backlash routes, quantised to integers.

use crate::backlash::flanks::FlankActive;
use crate::backlash::terminal::TerminalActive;
use crate::constants::UNSTATED_STIFFNESS_U95;
use crate::math::{power, term};
use crate::qformat::Term;
use crate::settings::Settings;

/// Time left out on either side of a flight [s], and in lags of the contact: less than 1e-3 of an impact is then left.
const GUARD_S: f32 = 0.004;
const GUARD_LAGS: f32 = 7.0;
/// Longest guard [samples]: the finest line must hold it beside the flanks.
const LONGEST_GUARD: u32 = 31;
/// Time constant of the smoothed force [s]: short compared with the guard.
const SMOOTHING_S: f32 = 0.001;
/// Memory of the force's noise and of its peak [s], at most: rounded down to a power of two of samples.
const NOISE_S: f32 = 0.125;
const PEAK_S: f32 = 2.0;
/// Travel that counts as motion [counts], and the time for which it does [s].
const TRAVEL_COUNTS: f32 = 8.0;
const MOVING_S: f32 = 0.25;
/// Shortest flank that is evaluated [s], and [samples].
const LEAST_FLANK_S: f32 = 0.008;
const LEAST_FLANK_SAMPLES: u32 = 8;
/// A unit of length is this fraction of an encoder count, and 1 nm at least: 2^31 of them are 1 m at least.
const UNIT_COUNTS: f32 = 1.0 / 256.0;
const LEAST_UNIT_M: f32 = 1e-9;
/// Mean of the magnitude of white noise's second difference, over its rms: `sqrt(6) sqrt(2 / pi)`.
const MEAN_BEND: f32 = 1.954;
/// Bits of the stretch in the memory.
const STRETCH_BITS: i32 = 13;

/// Quantised settings of the backlash.
#[derive(Clone, Debug)]
pub(crate) struct BacklashActive {
    pub flanks: FlankActive,
    pub terminal: TerminalActive,
    /// Shortest flank that is evaluated [samples].
    pub least_flank: u32,
    /// Encoder count [units].
    pub count_units: u32,
    /// Whether the stiffness is known: the route by the force alone needs it.
    pub stiffness_known: bool,
    /// Whether the guard outlasts the effect of an impact.
    pub lag_fits: bool,
    /// Length of a unit [m].
    pub unit_m: f32,
    pub scales: BacklashScales,
}

/// Factors from sums to SI, and uncertainties that averaging does not remove.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BacklashScales {
    /// Samples in a block of the terminal's route.
    pub block: f32,
    /// One step of the stretch in the memory [units].
    pub stretch: f32,
    /// Relative 95 % uncertainties: of the stiffness, of the encoder's scale and of the force's.
    pub stiffness_u95: f32,
    pub lead_u95: f32,
    pub gain_u95: f32,
    /// Rms of the force's noise [codes] per mean bend as the flanks keep it.
    pub noise: f32,
    /// Stiffness [N/m] and damping [N s/m] per unit of the terminal's least squares.
    pub stiffness: f32,
    pub damping: f32,
    /// Damping that the skew adds, over the stiffness [s], and its uncertainty.
    pub skew_s: f32,
    pub skew_u95_s: f32,
    /// Samples firm on one flank alone after which a load is one-sided.
    pub one_sided: u32,
}

impl Settings {
    /// Quantised settings of the backlash.
    pub(crate) fn backlash(&self) -> BacklashActive {
        // Single precision suffices: only the sums of the lag's terms must be exact.
        let single = |value: f64| value as f32;
        let magnitude = |value: f64| if value < 0.0 { -value as f32 } else { value as f32 };
        let rate = single(self.sample_rate_hz);
        let oversampling = single(self.oversampling);
        let count_m = magnitude(self.metres_per_count);
        let newtons = magnitude(self.newtons_per_code);
        let code_m = count_m / oversampling;
        let position_shift = exponent((count_m * UNIT_COUNTS).max(LEAST_UNIT_M) / code_m).clamp(-20, 30);
        let unit_m = code_m * power(position_shift);

        let stiffness = single(self.stiffness_n_per_m);
        let known = stiffness > 0.0;
        let compliance = if known { 1.0 / stiffness } else { 0.0 };
        let lag = single(self.contact_damping_n_s_per_m) * compliance;
        let skew = single(self.skew_parts().1);
        let guard_s = (rate * GUARD_S + 0.5) as u32;
        let settled = rate * lag * GUARD_LAGS + 0.5;
        let guard = guard_s.max(settled as u32).clamp(2, LONGEST_GUARD);
        // Classification comes one to two blocks late.
        let block = guard_s.max(guard.div_ceil(2)).clamp(2, guard);
        let per_code = newtons * compliance / unit_m;
        let (kept, by_force) = lag_terms((lag - skew) * rate);
        let fraction = power(FlankActive::FRACTION as i32);
        let codes = self.force_max_code - self.force_min_code;
        let stretch_shift = (exponent(single(codes) * per_code) - STRETCH_BITS).clamp(0, 30) as u8;

        let block_s = block as f32 / rate;
        let structure = single(self.structure_mass_kg) * unit_m / (block_s * block_s * newtons);
        let stiffness_u95 = single(self.stiffness_u95_n_per_m) * compliance;
        BacklashActive {
            flanks: FlankActive {
                kept: real(kept),
                by_force: by_force.map(|part| real(part * per_code * fraction)),
                position_shift: position_shift as i8,
                stretch_shift,
                smoothing: (65536.0 * (1.0 - decay(1.0 / (rate * SMOOTHING_S)))) as i32,
                noise_shift: exponent(rate * NOISE_S).clamp(1, 20) as u8,
                peak_shift: exponent(rate * PEAK_S).clamp(1, 20) as u8,
                travel: (TRAVEL_COUNTS * oversampling) as u32,
                moving: (rate * MOVING_S) as u32,
                guard: guard as u8,
            },
            terminal: TerminalActive {
                present: self.terminal_sensor,
                units: real(single(self.metres_per_terminal_code) / unit_m / 256.0),
                block: block as u16,
                structure: real(structure),
                guard: guard as u8,
            },
            least_flank: ((rate * LEAST_FLANK_S) as u32).max(LEAST_FLANK_SAMPLES),
            count_units: (count_m / unit_m) as u32,
            stiffness_known: known,
            lag_fits: settled <= LONGEST_GUARD as f32,
            unit_m,
            scales: BacklashScales {
                block: block as f32,
                stretch: power(i32::from(stretch_shift)),
                stiffness_u95: if stiffness_u95 > 0.0 { stiffness_u95 } else { UNSTATED_STIFFNESS_U95 as f32 },
                lead_u95: single(self.lead_u95),
                gain_u95: single(self.force_gain_u95),
                noise: power(-(FlankActive::FORCE_BITS as i32)) / MEAN_BEND,
                stiffness: newtons / unit_m,
                damping: newtons / unit_m * (block - 1) as f32 / (block as f32 * rate),
                skew_s: skew,
                skew_u95_s: single(self.skew_u95_s),
                one_sided: (2.0 * rate) as u32,
            },
        }
    }
}

/// The factor in the form in which the signal path multiplies by it.
fn real(factor: f32) -> Term {
    term(f64::from(factor))
}

/// `e` with `2^e <= value < 2^(e + 1)`, for normal numbers.
fn exponent(value: f32) -> i32 {
    ((value.to_bits() >> 23) & 0xff) as i32 - 127
}

/// A first-order lag [samples] of a force that is linear between samples: the fraction of the output that is kept, and
/// the weights of the new and the last force. A lead, which a skew may leave, extrapolates the line through both.
fn lag_terms(lag: f32) -> (f32, [f32; 2]) {
    if lag <= 0.0 {
        return (0.0, [1.0 - lag, lag]);
    }
    let kept = decay(1.0 / lag);
    let part = lag * (1.0 - kept);
    (kept, [1.0 - part, part - kept])
}

/// `e^-x` of a positive number, within 3e-6.
fn decay(x: f32) -> f32 {
    if x > 20.0 {
        return 0.0;
    }
    // A sixteenth of the exponent by the series, then four squarings.
    let y = x / 16.0;
    let part = (1..=10).rev().fold(1.0, |sum, n| 1.0 - sum * y / n as f32);
    (0..4).fold(part, |value, _| value * value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decay_is_the_exponential() {
        for x in [1e-6, 0.01, 0.4, 1.75, 7.0, 15.0, 30.0, 1e3, 1e6] {
            let exact = f32::exp(-x);
            assert!((decay(x) - exact).abs() < 3e-6, "{x}: {} {exact}", decay(x));
        }
    }

    /// A lag delays a ramp by itself; a lead advances it.
    #[test]
    fn ramps_are_shifted() {
        for lag in [-0.3, 0.0, 0.2, 0.57, 3.0] {
            let (kept, [now, then]) = lag_terms(lag);
            let stretch = (1..200).fold(0.0, |stretch, n| kept * stretch + now * n as f32 + then * (n - 1) as f32);
            assert!((stretch - (199.0 - lag)).abs() < 1e-3, "{lag}: {stretch}");
        }
    }

    /// The integers and factors of three devices, by hand: a guard by the lag, one by the time, and one that a lag of
    /// 9.2 ms exceeds.
    #[test]
    fn settings_become_integers_and_factors() {
        let lagging = Settings {
            stiffness_n_per_m: 2e6,
            contact_damping_n_s_per_m: 4800.0,
            skew_s: 2.3e-3,
            structure_mass_kg: 10.0,
            lead_u95: 0.003,
            ..Settings::default()
        };
        let fine = Settings {
            sample_rate_hz: 4000.0,
            metres_per_count: -1e-8,
            oversampling: 8.0,
            newtons_per_code: -1e-4,
            force_min_code: -40_000.0,
            force_max_code: 30_000.0,
            metres_per_terminal_code: -2e-9,
            structure_mass_kg: 3.0,
            stiffness_n_per_m: 5e6,
            stiffness_u95_n_per_m: 1e5,
            contact_damping_n_s_per_m: 2500.0,
            force_gain_u95: 0.02,
            skew_u95_s: 3e-5,
            ..Settings::default()
        };
        let slow = Settings {
            sample_rate_hz: 500.0,
            stiffness_n_per_m: 1e6,
            contact_damping_n_s_per_m: 9200.0,
            ..Settings::default()
        };
        // Shifts of position, stretch, noise and peak; travel and time that count as motion; guard and block; shortest
        // flank; count; samples of a one-sided load. The skew within a sample, and the stiffness's relative
        // uncertainty.
        for (settings, integers, skew_s, stiffness_u95) in [
            (lagging, [-8, 7, 6, 10, 8, 250, 17, 9, 8, 256, 2000], 3e-4, 0.01),
            (fine, [-1, 0, 8, 12, 64, 1000, 16, 16, 32, 16, 8000], 0.0, 0.02),
            (slow, [-8, 8, 5, 9, 8, 125, 31, 16, 8, 256, 1000], 0.0, 0.01),
        ] {
            let BacklashActive { flanks, terminal, least_flank, count_units, unit_m, scales, .. } =
                settings.validate().unwrap().backlash;
            let found = [
                i64::from(flanks.position_shift),
                i64::from(flanks.stretch_shift),
                i64::from(flanks.noise_shift),
                i64::from(flanks.peak_shift),
                i64::from(flanks.travel),
                i64::from(flanks.moving),
                i64::from(flanks.guard),
                i64::from(terminal.block),
                i64::from(least_flank),
                i64::from(count_units),
                i64::from(scales.one_sided),
            ];
            assert_eq!(found, integers);
            assert_eq!(terminal.guard, flanks.guard);
            let near = |found: f64, wanted: f64, size: f64, what: &str| {
                assert!((found - wanted).abs() <= 3e-5 * size.abs(), "{what}: {found} for {wanted}");
            };
            let alike = |found: f32, wanted: f64, what: &str| near(f64::from(found), wanted, wanted, what);
            let factor = |term: Term| f64::from(term.coefficient) * 2_f64.powi(-32 - i32::from(term.shift));
            let rate = settings.sample_rate_hz;
            let block = f64::from(terminal.block);
            let newtons = settings.newtons_per_code.abs();
            let unit = settings.metres_per_count.abs() / f64::from(count_units);
            alike(unit_m, unit, "unit");
            // A steady force stretches by force over stiffness, and a ramp by that of the lag before.
            let lag = (settings.contact_damping_n_s_per_m / settings.stiffness_n_per_m - skew_s) * rate;
            let steady = newtons / settings.stiffness_n_per_m / unit * 4096.0;
            let kept = (-1.0 / lag).exp();
            let [now, then] = flanks.by_force.map(factor);
            near(factor(flanks.kept), kept, kept, "kept");
            near(now + then, (1.0 - kept) * steady, steady, "steady force");
            near(then, (lag - kept * (1.0 + lag)) * steady, lag * steady, "ramp");
            let smoothing = 65_536.0 * (1.0 - (-1000.0 / rate).exp());
            near(f64::from(flanks.smoothing), smoothing, smoothing + 65_536.0, "smoothing");
            let terminal_units = settings.metres_per_terminal_code / unit / 256.0;
            near(factor(terminal.units), terminal_units, terminal_units, "terminal");
            let structure = settings.structure_mass_kg * unit * (rate / block).powi(2) / newtons;
            near(factor(terminal.structure), structure, structure, "structure");
            alike(scales.block, block, "block");
            alike(scales.stretch, 2_f64.powi(i32::from(flanks.stretch_shift)), "stretch");
            alike(scales.stiffness_u95, stiffness_u95, "stiffness's uncertainty");
            alike(scales.lead_u95, settings.lead_u95, "lead");
            alike(scales.gain_u95, settings.force_gain_u95, "gain");
            // The noise has 5 fraction bits.
            let noise = 1.0 / 32.0 / (6.0 * 2.0 / core::f64::consts::PI).sqrt();
            near(f64::from(scales.noise), noise, 10.0 * noise, "noise");
            alike(scales.stiffness, newtons / unit, "stiffness");
            // From a block's first sample to its last is one sample less than a block.
            alike(scales.damping, newtons / unit * (block - 1.0) / block / rate, "damping");
            near(f64::from(scales.skew_s), skew_s, 1e-3, "skew");
            alike(scales.skew_u95_s, settings.skew_u95_s, "skew's uncertainty");
        }
    }
}
