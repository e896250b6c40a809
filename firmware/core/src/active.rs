//! The settings, quantised once to the integers that the signal path uses.

use crate::backlash::active::BacklashActive;
use crate::constants::{
    BOXES_VARIANCE, FAST_BOX_S, LONGEST_SPACING, REST_COUNTS, REST_WINDOW_S, REVERSAL_KERNEL_S, REVERSAL_REACH_S,
    SIGN_KERNEL_S, SLOW_BOX_S, UPDATES_PER_BOX,
};
use crate::gate::BLOCKS;
use crate::kernel::{MORE_REGRESSORS, Normaliser, REGRESSORS};
use crate::ldl::UNKNOWNS;
use crate::line::VELOCITY_BITS;
use crate::math::{exponent, power_of_two, term};
use crate::plausible::{SLIP_COUNTS, SLIP_FACTOR};
use crate::settings::{Settings, SettingsError};
use crate::systematic::Systematic;

/// Greatest encoder travel per sample at full scale [counts / oversampling]: keeps the velocity's comb within 64 bits.
const GREATEST_TRAVEL: f64 = 64e6;
/// A weak reversal grazes if the encoder moves less than this across the window [counts].
const GRAZING_COUNTS: f64 = 4.0;

/// Quantised settings: immutable, apart from the state.
#[derive(Clone, Debug)]
pub struct Active {
    pub(crate) settings: Settings,
    pub(crate) signal: Signal,
    pub(crate) fast: BankActive,
    pub(crate) slow: BankActive,
    pub(crate) systematic: Systematic,
    pub(crate) backlash: BacklashActive,
    /// See `Settings::sign_effects`.
    pub(crate) sign_effects: (f64, f64, f64),
}

impl Active {
    /// The settings that this was made from.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }
}

/// What the path before the banks needs.
#[derive(Clone, Debug, Default)]
pub(crate) struct Signal {
    pub position_reversed: bool,
    pub force_reversed: bool,
    /// Samples by which the force is behind the position.
    pub force_late: i8,
    pub force_zero_code: i32,
    pub force_min_code: i32,
    pub force_max_code: i32,
    /// Half width of the sign's kernel [samples].
    pub sign_half_width: u8,
    /// Half width of the kernel that relocates a reversal [samples], and how far the zero may move [samples].
    pub reversal_half_width: u8,
    pub reversal_reach: u8,
    /// Length of a block [samples]; rest is detected in windows of `gate::BLOCKS` of them.
    pub rest_block: u16,
    pub rest_limit: u32,
    pub grazing_limit: u32,
    /// Position codes per encoder count.
    pub codes_per_count: u32,
    /// Greatest velocity that may be creep, `GRAZING_COUNTS` in a window of rest, as the sign's kernel gives it
    /// [2^-VELOCITY_BITS codes per sample, times m^2].
    pub creep_limit: u32,
    /// Samples that wait in the delay line until the gate has judged them.
    pub delay: u8,
    pub publish_samples: u32,
    pub newtons_per_code: f32,
    /// Greatest bend of the position that is not a slip: by steps [codes], and by the force [codes kg per code].
    pub bend: (u32, f64),
}

/// What one bank needs.
#[derive(Clone, Debug)]
pub(crate) struct BankActive {
    /// Samples from update to update.
    pub spacing: u32,
    /// Consecutive good samples that a kernel output requires.
    pub support: u32,
    pub normaliser: Normaliser,
    /// Updates in the memory.
    pub memory: u32,
    /// The device counts as at rest after this many samples without an update.
    pub hold_samples: u32,
    pub scales: Scales,
}

/// Conversion of regressors to SI.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scales {
    /// SI value of one unit of acceleration, velocity, sign, one and force.
    pub units: [f64; REGRESSORS],
    /// SI value of one unit of speed and force rate.
    pub more_units: [f64; MORE_REGRESSORS],
    /// Unit of the force over the unit of each other regressor.
    pub force_per: [f32; UNKNOWNS],
    /// The force's unit [N].
    pub force: f32,
    /// The unit of the force's rate over the force's [s^-1].
    pub rate_per_force: f32,
    /// The unit of the force's second derivative over the force's [s^-2].
    pub curvature_per_force: f32,
    /// Length of the kernel's box, squared [s^2].
    pub box_squared: f32,
    /// Mean square of the encoder's quantisation noise in the acceleration [regressor units^2].
    pub quantisation: f32,
    /// Variance of white force noise behind the kernel, over that in a sample [N^2 per code^2].
    pub noise: f32,
    /// Half a code of the force [N].
    pub half_code: f32,
    /// Fraction of `quantisation` that sums of independent readings keep.
    pub quantisation_kept: f32,
    /// Unit of the jerk [m/s^3].
    pub jerk: f32,
    /// Mean square of the encoder's quantisation noise in the jerk [regressor units^2].
    pub jerk_quantisation: f32,
}

impl Settings {
    /// Checks each setting alone and all of them together, and quantises them; returns the first error found. The
    /// integers are the same on every machine.
    pub fn validate(&self) -> Result<Active, SettingsError> {
        for (info, value) in Self::TABLE.iter().zip(self.values()) {
            info.check(value)?;
        }
        if self.force_min_code >= self.force_max_code {
            return Err(SettingsError::Conflict {
                field: "force_min_code",
                other: "force_max_code",
                rule: "the least code must be below the greatest",
            });
        }
        if self.force_zero_code <= self.force_min_code || self.force_zero_code >= self.force_max_code {
            return Err(SettingsError::Conflict {
                field: "force_zero_code",
                other: "force_min_code and force_max_code",
                rule: "the code at no force must lie between the saturated codes",
            });
        }
        let codes_per_sample = self.full_scale_velocity_m_per_s * self.codes_per_metre() / self.sample_rate_hz;
        if codes_per_sample > GREATEST_TRAVEL {
            return Err(SettingsError::Conflict {
                field: "full_scale_velocity_m_per_s",
                other: "metres_per_count",
                rule: "at full scale the encoder counts more than 6.4e7 in a sample; lower the one or raise the other",
            });
        }
        if self.structure_mass_kg > 0.0 && self.stiffness_n_per_m > 0.0 {
            // (w / w0)^2 at the first zero of the fast kernel, where its band ends.
            let band = core::f64::consts::TAU / FAST_BOX_S;
            if self.structure_mass_kg / self.stiffness_n_per_m * band * band > 1.0 {
                return Err(SettingsError::Conflict {
                    field: "stiffness_n_per_m",
                    other: "structure_mass_kg",
                    rule: "the structure resonates within the estimator's band of 62 Hz; set the stiffness to 0 if it is unknown",
                });
            }
        }
        Ok(Active {
            settings: *self,
            signal: self.signal(),
            fast: self.bank(FAST_BOX_S),
            slow: self.bank(SLOW_BOX_S),
            systematic: Systematic::of(self),
            backlash: self.backlash(),
            sign_effects: self.sign_effects(),
        })
    }

    fn signal(&self) -> Signal {
        let rate = self.sample_rate_hz;
        let per_metre = self.codes_per_metre();
        let rest_block = rounded(rate * REST_WINDOW_S / BLOCKS as f64).max(1.0);
        let sign_half_width = rounded(rate * SIGN_KERNEL_S).max(1.0);
        let reversal_reach = rounded(rate * REVERSAL_REACH_S).max(1.0);
        // The window and a block on either side of it.
        let delay = rest_block * (BLOCKS as f64 + 2.0);
        // The signs on both sides must be known, and those that are changed must still be in the delay line.
        let reversal_half_width = rounded(rate * REVERSAL_KERNEL_S)
            .min(delay - sign_half_width - reversal_reach - 2.0)
            .max(reversal_reach + 1.0);
        Signal {
            position_reversed: self.metres_per_count < 0.0,
            force_late: self.skew_parts().0 as i8,
            force_reversed: self.newtons_per_code < 0.0,
            force_zero_code: self.force_zero_code as i32,
            force_min_code: self.force_min_code as i32,
            force_max_code: self.force_max_code as i32,
            sign_half_width: sign_half_width as u8,
            reversal_half_width: reversal_half_width as u8,
            reversal_reach: reversal_reach as u8,
            rest_block: rest_block as u16,
            rest_limit: (REST_COUNTS * self.oversampling).max(self.stuck_displacement_m * per_metre) as u32,
            grazing_limit: (GRAZING_COUNTS * self.oversampling) as u32,
            codes_per_count: self.oversampling as u32,
            creep_limit: (GRAZING_COUNTS * self.oversampling / (rest_block * BLOCKS as f64)
                * sign_half_width
                * sign_half_width
                * f64::from(1_u32 << VELOCITY_BITS)) as u32,
            delay: delay as u8,
            publish_samples: rounded(rate / self.publish_rate_hz).max(1.0) as u32,
            newtons_per_code: magnitude(self.newtons_per_code) as f32,
            bend: (
                (SLIP_COUNTS * self.oversampling) as u32,
                SLIP_FACTOR * magnitude(self.newtons_per_code) * per_metre / (rate * rate),
            ),
        }
    }

    /// Position codes (counts / oversampling) per metre.
    fn codes_per_metre(&self) -> f64 {
        self.oversampling / magnitude(self.metres_per_count)
    }

    fn bank(&self, box_s: f64) -> BankActive {
        let rate = self.sample_rate_hz;
        let period = 1.0 / rate;
        let spacing = rounded(rate * box_s / f64::from(UPDATES_PER_BOX)).clamp(1.0, LONGEST_SPACING);
        let length = spacing * f64::from(UPDATES_PER_BOX);
        let gain = length * length * length * length;
        let newtons_per_code = magnitude(self.newtons_per_code);

        // Codes of each comb per SI unit.
        let acceleration = gain * period * period * self.codes_per_metre();
        let velocity = 24.0 * gain * period * self.codes_per_metre();
        let sign = 24.0 * gain * f64::from(crate::sign::ONE);
        let force = 12.0 * gain / newtons_per_code;
        let force_rate = 24.0 * gain * period / newtons_per_code;
        let curvature = gain * period * period / newtons_per_code;
        let jerk = 2.0 * gain * period * period * period * self.codes_per_metre();
        let greatest_code =
            (self.force_max_code - self.force_zero_code).max(self.force_zero_code - self.force_min_code);

        let fit = |greatest: f64| (exponent(greatest) - 30).clamp(-60, 60) as i8;
        let acceleration_shift = fit(acceleration * self.full_scale_acceleration_m_per_s2);
        let velocity_shift = fit(velocity * self.full_scale_velocity_m_per_s);
        let sign_shift = fit(sign);
        // One bit of headroom for the corrections.
        let force_shift = fit(12.0 * gain * greatest_code * 2.0);
        // Behind a box, a derivative is at most twice the greatest value over the length of the box.
        let steepest = 2.0 / (length * period);
        let force_rate_shift = fit(force_rate * newtons_per_code * greatest_code * steepest * 2.0);
        let curvature_shift = fit(curvature * newtons_per_code * greatest_code * steepest * steepest);
        let jerk_shift = fit(jerk * self.full_scale_acceleration_m_per_s2 * steepest);
        let down = |shift: i8| power_of_two(-i32::from(shift));

        // The remaining skew: the series of F(t + skew). Structure mass: see docs/THEORY.md.
        let (compliance, lag) = if self.stiffness_n_per_m > 0.0 {
            (self.structure_mass_kg / self.stiffness_n_per_m, self.contact_damping_n_s_per_m / self.stiffness_n_per_m)
        } else {
            (0.0, 0.0)
        };
        let (_, skew) = self.skew_parts();
        let force_down = 12.0 * down(force_shift);
        let second = 0.5 * skew * skew - compliance;
        let third = compliance * (lag - skew) + skew * skew * skew / 6.0;
        let fourth =
            compliance * (compliance - lag * lag + lag * skew - 0.5 * skew * skew) + skew * skew * skew * skew / 24.0;
        let force_terms = [
            term(skew * force_down / 24.0 * rate),
            term(second * force_down * rate * rate),
            term(third * force_down / 2.0 * rate * rate * rate),
            term(fourth * force_down * rate * rate * rate * rate),
        ];
        let force_rate_down = 24.0 * down(force_rate_shift);
        let force_rate_terms =
            [term(skew * force_rate_down * rate), term(second * force_rate_down / 2.0 * rate * rate)];
        let regressor_per_newton = force * down(force_shift);
        let snap_per_code = rate * rate * rate * rate / (gain * self.codes_per_metre());
        let snap_term = term(self.structure_mass_kg * compliance * regressor_per_newton * snap_per_code);

        let memory = rounded(self.memory_s * rate / spacing).max(1.0) as u32;
        // Two of the boxes remain, a triangle differenced twice: 8/3 M^3 of a single sample's variance.
        let step = self.oversampling * down(acceleration_shift);
        let quantisation = step * step / 12.0 * (8.0 / 3.0) * length * length * length;
        // One box remains, summed over two samples and differenced three times.
        let jerk_step = self.oversampling * down(jerk_shift);
        let jerk_quantisation = jerk_step * jerk_step / 12.0 * (80.0 * length - 70.0);
        BankActive {
            spacing: spacing as u32,
            support: 4 * length as u32 + 2,
            normaliser: Normaliser {
                acceleration_shift,
                velocity_shift,
                sign_shift,
                force_shift,
                force_rate_shift,
                curvature_shift,
                jerk_shift,
                force_terms,
                force_rate_terms,
                snap_term,
            },
            memory,
            hold_samples: 24 * length as u32,
            scales: Scales {
                box_squared: (length * period * length * period) as f32,
                rate_per_force: (regressor_per_newton / (force_rate * down(force_rate_shift))) as f32,
                curvature_per_force: (regressor_per_newton / (curvature * down(curvature_shift))) as f32,
                more_units: [1.0 / (velocity * down(velocity_shift)), 1.0 / (force_rate * down(force_rate_shift))],
                jerk: (1.0 / (jerk * down(jerk_shift))) as f32,
                jerk_quantisation: jerk_quantisation as f32,
                noise: (BOXES_VARIANCE / length * newtons_per_code * newtons_per_code) as f32,
                half_code: (0.5 * newtons_per_code) as f32,
                quantisation_kept: (1.0 / self.oversampling) as f32,
                ..scales(
                    [
                        acceleration * down(acceleration_shift),
                        velocity * down(velocity_shift),
                        sign * down(sign_shift),
                        f64::from(crate::kernel::ONE),
                        regressor_per_newton,
                    ],
                    quantisation,
                )
            },
        }
    }

    /// What friction and force do to the sign's velocity: the kernel's kink at a reversal [velocity codes per N and
    /// cube of the half width], and the velocity due to a sum of the force [velocity codes per force code], both times
    /// `mt`. The third is viscous friction [force codes per position code and sample, per N s/m].
    fn sign_effects(&self) -> (f64, f64, f64) {
        let period = 1.0 / self.sample_rate_hz;
        let per_impulse = period * period * self.codes_per_metre();
        // Two boxes of m samples have a mean distance of m / 3 from their centre and a gain of m^2.
        let newtons_per_code = magnitude(self.newtons_per_code);
        let viscous = self.sample_rate_hz / (self.codes_per_metre() * newtons_per_code);
        (per_impulse / 3.0, newtons_per_code * per_impulse, viscous)
    }
}

/// From the number of regressor units per SI unit.
fn scales(per_si: [f64; REGRESSORS], quantisation: f64) -> Scales {
    let units = per_si.map(|per_si| 1.0 / per_si);
    let [.., force] = units;
    let [a, v, s, one, _] = per_si;
    Scales {
        units,
        force_per: [a, v, s, one].map(|per_si| (force * per_si) as f32),
        force: force as f32,
        rate_per_force: 0.0,
        curvature_per_force: 0.0,
        box_squared: 0.0,
        quantisation: quantisation as f32,
        more_units: [0.0; MORE_REGRESSORS],
        noise: 0.0,
        half_code: 0.0,
        quantisation_kept: 1.0,
        jerk: 0.0,
        jerk_quantisation: 0.0,
    }
}

fn magnitude(value: f64) -> f64 {
    if value < 0.0 { -value } else { value }
}

/// A positive value, rounded to the nearest whole number.
fn rounded(value: f64) -> f64 {
    ((value + 0.5) as i64) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{constants::RATE_TAPS, kernel::tests::convolve};

    /// Length of a bank's box [samples].
    fn length(bank: &BankActive) -> f64 {
        f64::from(bank.spacing * UPDATES_PER_BOX)
    }

    fn value(term: crate::qformat::Term) -> f64 {
        f64::from(term.coefficient) * 2_f64.powi(-32 - i32::from(term.shift))
    }

    /// Product of two power series up to the fourth power.
    fn times(a: [f64; 5], b: [f64; 5]) -> [f64; 5] {
        core::array::from_fn(|n| (0..=n).map(|i| a[i] * b[n - i]).sum())
    }

    /// One over a power series that begins with one.
    fn inverse(a: [f64; 5]) -> [f64; 5] {
        let mut inverse = [1.0, 0.0, 0.0, 0.0, 0.0];
        for n in 1..5 {
            inverse[n] = -(1..=n).map(|i| a[i] * inverse[n - i]).sum::<f64>();
        }
        inverse
    }

    /// The force that acts on the screw is `(F - mr s^2 x2) / (1 + r s^2 / (1 + tau s))`, of a force that comes late
    /// `exp(skew s)` of it: each term of the series.
    #[test]
    fn a_late_force_across_a_soft_contact_is_undone_by_its_series() {
        for (sample_rate_hz, mass, own_hz, lag_s, skew_s) in [
            (50.0, 0.0, 0.0, 0.0, 0.005),
            (50.0, 30.0, 63.0, 0.0, 0.0),
            (50.0, 30.0, 63.0, 0.004, 0.0),
            (50.0, 30.0, 63.0, 0.003, 0.0045),
            (90.0, 2.0, 70.0, 0.002, -0.0035),
            (1000.0, 2.0, 63.0, 0.001, 0.0004),
            (1000.0, 2.0, 63.0, 0.001, 0.0024),
        ] {
            let stiffness = mass * (core::f64::consts::TAU * own_hz).powi(2);
            let settings = Settings {
                sample_rate_hz,
                skew_s,
                structure_mass_kg: mass,
                stiffness_n_per_m: stiffness,
                contact_damping_n_s_per_m: lag_s * stiffness,
                metres_per_count: -3e-6,
                oversampling: 2.0,
                newtons_per_code: -7e-3,
                ..Settings::default()
            };
            let active = settings.validate().unwrap();
            let late = settings.skew_parts().1;
            let compliance = if stiffness > 0.0 { mass / stiffness } else { 0.0 };
            let exponential = [1.0, late, late.powi(2) / 2.0, late.powi(3) / 6.0, late.powi(4) / 24.0];
            let mut structure = times([0.0, 0.0, compliance, 0.0, 0.0], inverse([1.0, lag_s, 0.0, 0.0, 0.0]));
            structure[0] = 1.0;
            let wanted = times(inverse(structure), exponential);
            for bank in [&active.fast, &active.slow] {
                let gain = length(bank).powi(4);
                // A regressor's unit by a code of the comb, which has so many a code of force and sample.
                let per_code = 7e-3 / gain / bank.scales.units[4];
                let terms = bank.normaliser.force_terms;
                for (n, of_comb) in [24.0, 1.0, 2.0, 1.0].into_iter().enumerate() {
                    let found = value(terms[n]) * of_comb / per_code / sample_rate_hz.powi(n as i32 + 1);
                    let wanted = wanted[n + 1];
                    assert!((found - wanted).abs() <= 1e-6 * wanted.abs(), "{n}: {found} for {wanted}, {settings:?}");
                }
                let per_code = 7e-3 / gain * sample_rate_hz / bank.scales.more_units[1];
                for (n, of_comb) in [1.0, 2.0].into_iter().enumerate() {
                    let found = value(bank.normaliser.force_rate_terms[n]) * of_comb
                        / per_code
                        / sample_rate_hz.powi(n as i32 + 1);
                    let wanted = wanted[n + 1];
                    assert!((found - wanted).abs() <= 1e-6 * wanted.abs(), "rate {n}: {found} for {wanted}");
                }
                let snap = sample_rate_hz.powi(4) * 3e-6 / 2.0 / gain / bank.scales.units[4];
                let found = value(bank.normaliser.snap_term) / snap;
                let wanted = mass * compliance;
                assert!((found - wanted).abs() <= 1e-6 * wanted, "snap: {found} for {wanted}");
            }
        }
    }

    /// What steps of a count, and noise in the force, are behind the kernel: the sum of its squares.
    #[test]
    fn noise_behind_the_kernels_is_the_sum_of_their_squares() {
        for (sample_rate_hz, oversampling) in [(1000.0, 1.0), (1000.0, 5.0), (2600.0, 3.0)] {
            let settings = Settings { sample_rate_hz, oversampling, ..Settings::default() };
            let active = settings.validate().unwrap();
            for bank in [&active.fast, &active.slow] {
                let length = length(bank);
                let single = std::vec![1.0 / length; length as usize];
                let boxes = convolve(&convolve(&single, &single), &convolve(&single, &single));
                let squares = |taps: &[f64]| convolve(&boxes, taps).iter().map(|each| each * each).sum::<f64>();
                let count_square = settings.metres_per_count.powi(2) / 12.0;
                let near = |found: f64, wanted: f64, part: f64, what: &str| {
                    assert!((found / wanted - 1.0).abs() < part, "{what}: {found} for {wanted} at {sample_rate_hz} Hz");
                };
                let acceleration = squares(&[1.0, -2.0, 1.0]) * sample_rate_hz.powi(4) * count_square;
                let scales = &bank.scales;
                near(f64::from(scales.quantisation) * scales.units[0].powi(2), acceleration, 0.01, "acceleration");
                let third = convolve(&[0.5, 0.5], &[1.0, -3.0, 3.0, -1.0]);
                let jerk = squares(&third) * sample_rate_hz.powi(6) * count_square;
                near(f64::from(scales.jerk_quantisation * scales.jerk * scales.jerk), jerk, 1e-4, "jerk");
                near(f64::from(scales.noise), squares(&[1.0]) * settings.newtons_per_code.powi(2), 0.01, "force");
                near(f64::from(scales.quantisation_kept), 1.0 / oversampling, 1e-6, "kept");
                near(f64::from(scales.half_code), 0.5 * settings.newtons_per_code, 1e-6, "half a code");
            }
        }
    }

    /// Rest, creep and what else is counted in samples and codes, by hand for a rig at 2 kHz.
    #[test]
    fn times_and_travels_are_in_samples_and_codes() {
        let settings = Settings {
            sample_rate_hz: 2000.0,
            oversampling: 4.0,
            metres_per_count: -1e-6,
            newtons_per_code: -0.01,
            stuck_displacement_m: 0.0,
            publish_rate_hz: 8.0,
            memory_s: 6.0,
            ..Settings::default()
        };
        let signal = settings.signal();
        // 24 ms in eight blocks, 5 ms, 15 ms and 2 ms.
        assert_eq!((signal.rest_block, signal.sign_half_width), (6, 10));
        assert_eq!((signal.reversal_half_width, signal.reversal_reach), (30, 4));
        // Ten blocks.
        assert_eq!((signal.delay, signal.publish_samples), (60, 250));
        assert_eq!((signal.rest_limit, signal.grazing_limit, signal.codes_per_count), (8, 16, 4));
        // Four counts of four codes in 48 samples, through a kernel of gain 100.
        assert_eq!(signal.creep_limit, (16.0 / 48.0 * 100.0 * f64::from(1 << VELOCITY_BITS)) as u32);
        assert_eq!((signal.position_reversed, signal.force_reversed), (true, true));
        // Three counts of four codes. Twice 0.01 N on 1 kg for 0.5 ms, at 4e6 codes a metre.
        assert_eq!(signal.bend.0, 12);
        assert!((signal.bend.1 / (2.0 * 0.01 * 0.0005 * 0.0005 * 4e6) - 1.0).abs() < 1e-12);
        let wider = Settings { stuck_displacement_m: 5e-6, ..settings };
        assert_eq!(wider.signal().rest_limit, 20);
        let (kink, per_force, per_viscous) = settings.sign_effects();
        // An impulse of 1 N in a sample is so many codes a sample on 1 kg.
        let per_impulse = 0.0005 * 0.0005 * 4e6;
        // Through two boxes of m samples, of gain m^2, whose mean distance from their centre is m / 3.
        assert!((kink / (per_impulse / 3.0) - 1.0).abs() < 1e-12);
        assert!((per_force / (0.01 * per_impulse) - 1.0).abs() < 1e-12);
        // One code a sample is 0.5 mm/s.
        assert!((per_viscous / (0.0005 / 0.01) - 1.0).abs() < 1e-12);
        let active = settings.validate().unwrap();
        // Boxes of 32 and 128 samples, two updates in each: six of them without one are rest.
        assert_eq!((active.fast.spacing, active.slow.spacing), (16, 64));
        assert_eq!((active.fast.memory, active.slow.memory), (750, 188));
        assert_eq!((active.fast.support, active.slow.support), (130, 514));
        assert_eq!((active.fast.hold_samples, active.slow.hold_samples), (768, 3072));
        let taps: f64 = RATE_TAPS.iter().sum();
        assert_eq!(taps, 24.0);
    }

    /// At low rates a time is a sample at least, and the kernel that relocates a reversal fits into the delay line.
    #[test]
    fn the_long_kernel_fits_into_the_line_at_low_rates() {
        let widths = |sample_rate_hz: f64| {
            let signal = Settings { sample_rate_hz, ..Settings::default() }.signal();
            let [sign, reach, half] = [signal.sign_half_width, signal.reversal_reach, signal.reversal_half_width];
            (signal.rest_block, signal.delay, sign, reach, half)
        };
        // 15 ms are 7 samples, but of ten only 10 - 2 - 1 - 2 wait long enough.
        assert_eq!(widths(480.0), (1, 10, 2, 1, 5));
        // Beyond the reach at least.
        assert_eq!(widths(50.0), (1, 10, 1, 1, 2));
    }

    /// Each regressor is scaled by a power of two to 31 bits at full scale, and to no more.
    #[test]
    fn full_scale_fills_a_regressor() {
        // The greatest force is 4 million codes, on one side and on the other.
        for (zero, least, greatest) in [(3e6, -1e6, 4e6), (-3e6, -4e6, 1e6)] {
            let settings = Settings {
                force_zero_code: zero,
                force_min_code: least,
                force_max_code: greatest,
                ..Settings::default()
            };
            let active = settings.validate().unwrap();
            let force_n = 4e6 * settings.newtons_per_code;
            for (bank, box_s) in [(&active.fast, 0.016), (&active.slow, 0.064)] {
                let Scales { units, more_units, .. } = bank.scales;
                let [a, v, s, one, force] = units;
                // Behind a box nothing changes faster than from one end of its range to the other.
                let steepest = 2.0 / box_s;
                let curvature = f64::from(bank.scales.curvature_per_force) * force;
                for (what, full_scale, unit) in [
                    ("acceleration", settings.full_scale_acceleration_m_per_s2, a),
                    ("velocity", settings.full_scale_velocity_m_per_s, v),
                    ("sign", 1.0, s),
                    ("force", 2.0 * force_n, force),
                    ("rate", 2.0 * force_n * steepest, more_units[1]),
                    ("curvature", force_n * steepest * steepest, curvature),
                    ("jerk", settings.full_scale_acceleration_m_per_s2 * steepest, f64::from(bank.scales.jerk)),
                ] {
                    let units = full_scale / unit;
                    assert!((2_f64.powi(30)..2_f64.powi(31)).contains(&units), "{what}: {units} of {box_s} s");
                }
                // What the scales hold twice is the same.
                let near = |found: f32, wanted: f64| assert!((f64::from(found) / wanted - 1.0).abs() < 1e-6, "{found}");
                near(bank.scales.force, force);
                near(bank.scales.rate_per_force, more_units[1] / force);
                near(bank.scales.box_squared, box_s * box_s);
                for (found, unit) in bank.scales.force_per.into_iter().zip([a, v, s, one]) {
                    near(found, force / unit);
                }
                assert!((more_units[0] / v - 1.0).abs() < 1e-12);
                assert!((one * f64::from(crate::kernel::ONE) - 1.0).abs() < 1e-12);
            }
        }
    }
}
