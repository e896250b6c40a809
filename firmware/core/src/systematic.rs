//! What averaging does not remove from each parameter's uncertainty: by what the settings state, and by the motion.

use crate::budget::{Budget, Source};
use crate::constants;
use crate::detail::{Band, Detail};
use crate::ldl::UNKNOWNS;
use crate::math::{greater, lesser, magnitude, sqrt, square};
use crate::settings::Settings;

const STRUCTURE_MODEL_U95: f32 = constants::STRUCTURE_MODEL_U95 as f32;
/// Relative model error of the structure mass where the stiffness is unknown. At the device's natural frequency
/// the terminal stands while the screw moves; above it, the terminal moves against the screw. 1.5 holds up to 1.2 times
/// that frequency.
const LOOSE_STRUCTURE_U95: f32 = 1.5;
/// A contact whose stiffness is not set is assumed to give the device a natural frequency of 5 Hz at least; its square
/// [rad^2/s^2].
const LEAST_OWN_FREQUENCY_SQUARED: f32 = 987.0;
/// Fraction of the encoder steps' share in the scatter that affects a parameter, by the harmonics of a stroke. The
/// steps are noise in the position; in the acceleration most of it lies beyond the motion's own frequencies.
const STEPS: f32 = 0.25;
/// The same by the motion's own frequency `w`, per `(w h)^4`: the spectrum of a second difference over a box `h`,
/// against a flat one of the same variance and correlation length.
const STEPS_AT_FREQUENCY: f32 = 3.0 / 8.0 / 2.09;
/// How often a pattern of steps adds up at most, except through a tone's harmonics: a pattern that stays for longer
/// acts differently from stroke to stroke.
pub const MOST_REPEATS: f32 = 8.0;
/// Variance of the amplitude of a tone that is read in counts, over `(count / amplitude)^3` and the square of the
/// amplitude, at any place among the counts: `zeta(3) / pi^4`, by the first harmonic of a sawtooth of a sine.
const AMPLITUDE: f32 = 0.01234;

/// Fraction of the acceleration that a jump of a gap `eps` at each of its zero crossings takes, over `eps w^2 / a`:
/// `2 / (sqrt(2) pi)` for a tone, 0.40 for a normal random motion, with `w` weighted by the squared acceleration and
/// `a` its rms.
const GAP: f32 = 0.45;
/// Force over Coulomb friction below which a reversal is left out, as friction may hold the screw there.
const MAY_HOLD: f32 = 1.5;
const CORRELATION_BOXES: f32 = constants::CORRELATION_BOXES as f32;

/// What the settings state, each as the half width of its 95 % interval.
#[derive(Clone, Copy, Debug)]
pub struct Systematic {
    /// Relative, of forces.
    gain: f32,
    /// Relative, of travel.
    lead: f32,
    /// Relative, of time.
    timebase: f32,
    /// Of the skew \[s\].
    skew_s: f32,
    /// Structure mass \[kg\].
    structure_mass_kg: f32,
    /// Of the structure mass \[kg\].
    structure_u95_kg: f32,
    /// The contact's compliance \[m/N\]; 0 if its stiffness is unknown.
    compliance_m_per_n: f32,
    /// Of the compliance \[m/N\]; infinite if the stiffness is unknown.
    compliance_u95_m_per_n: f32,
    /// Damping of the contact \[N s/m\].
    damping_n_s_per_m: f32,
    /// The encoder's count \[m\].
    count_m: f32,
    /// Variance of the velocity at a reversal by the counts that the long kernel reads, and the short one \[m^2/s^2\].
    velocity_squares: [f32; 2],
    /// How far the long kernel moves a reversal \[s\].
    reach_s: f32,
}

/// A parameter as a fit gives it, before the uncertainty that averaging does not remove.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    /// Value.
    pub value: f32,
    /// Standard error if the residual were white before the kernel.
    pub error: f32,
    /// What it loses if the force is a second later.
    pub per_skew: f32,
    /// Uncertainty that remains after the correction for the encoder's steps.
    pub steps: f32,
}

/// What a fit's parameters have in common.
#[derive(Clone, Copy, Debug)]
pub struct Scatter {
    /// The inertance of the fit, with the structure's mass \[kg\].
    pub inertance_kg: f32,
    /// Degrees of freedom of the residual.
    pub freedom: f32,
    /// Fraction of the residual's variance that the encoder's steps explain, and the fraction of it that sums of
    /// independent readings keep.
    pub steps_share: [f32; 2],
    /// Square of the motion's frequency, weighted by the squared velocity, times that of the kernel's box.
    pub frequency_squared: f32,
    /// Variance of a parameter by the places of the reversals, per squared standard error and per recurring reversal
    /// ([`Systematic::places`]).
    pub places: f32,
}

/// What is known of a run's motion beside the sums on which a fit is based.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Motion {
    /// How often each stroke has come, sample by sample: 1 if none recurred.
    pub repeats: f32,
    /// Fraction of the structure's mass that is hidden by its motion across the gap ([`apart`]).
    pub apart: f32,
    /// Mean square of the motion's frequency, weighted by the squared acceleration \[rad^2/s^2\].
    pub frequency_squared: f32,
    /// The same, weighted by the squared velocity.
    pub low_squared: f32,
    /// Mean square of the acceleration \[m^2/s^4\]; infinite if counts do not matter.
    pub acceleration_squared: f32,
    /// Readings of the position; infinite if their number is unknown.
    pub readings: f32,
    /// Fraction of the strokes that were as long as the one before: nearly 1 for a tone that keeps its amplitude,
    /// nearly 0 for other motions.
    pub steady: f32,
    /// Number of reversals, each weighted by how often its stroke has recurred.
    pub reversals_again: f32,
    /// Viscous and Coulomb friction for which a fit mistakes the second derivative of the force [N s/m and N, per
    /// N/s^2]; 0 if it was not measured.
    pub friction_in_curvature: [f32; 2],
}

impl Scatter {
    /// For residuals that are assumed to be white, whatever the motion.
    pub const fn white(inertance_kg: f32, freedom: f32) -> Self {
        Self { inertance_kg, freedom, steps_share: [0.0; 2], frequency_squared: 0.0, places: 0.0 }
    }

    /// Its effect on every parameter's error in this motion.
    pub fn in_motion(&self, motion: &Motion) -> Spread {
        // Upper bound of the squared kernel at the motion's frequency: (sin x / x)^8 with x = w h / 2.
        let root = 1.0 + self.frequency_squared / 12.0;
        let kernel = 1.0 / square(square(root));
        let of_steps = STEPS + STEPS_AT_FREQUENCY * square(self.frequency_squared) * kernel;
        let of_steps = lesser(1.0, of_steps);
        let [share, kept] = self.steps_share;
        let noise = kernel * (1.0 - kept) + of_steps * kept;
        let steps = of_steps * share;
        let pattern = steps * (motion.held_repeats() - 1.0);
        let tone = motion.steps_in_harmonics(self.frequency_squared) * share * (motion.repeats - 1.0);
        let places = self.places * motion.reversals_again;
        Spread {
            inertance_kg: self.inertance_kg,
            freedom: self.freedom,
            noise: sqrt(noise),
            pattern: together(pattern, places),
            tone: together(greater(tone, pattern), places),
            places,
            steps,
            kernel,
        }
    }
}

/// The scatter in a motion, per standard error of a parameter.
#[derive(Clone, Copy, Debug)]
pub struct Spread {
    /// The inertance of the fit, with the structure's mass \[kg\].
    inertance_kg: f32,
    /// Degrees of freedom of the residual.
    freedom: f32,
    /// Standard deviation by what scatters.
    noise: f32,
    /// Variance by the encoder's steps where strokes recur, and the steps with them.
    pattern: f32,
    /// The same for friction, which in a single tone only the harmonics identify.
    tone: f32,
    /// The same for every parameter: recurring reversals are placed by the same counts.
    places: f32,
    /// Variance by steps that do not recur.
    steps: f32,
    /// Fraction of the squared motion that the kernel passes.
    kernel: f32,
}

impl Spread {
    /// Variance of a parameter's shift between the fit to a part and the fit to all, per difference of their squared
    /// standard errors. The steps near rest, by which the fits differ, are the same whenever a stroke recurs.
    pub(crate) fn moved(&self, motion: &Motion) -> f32 {
        square(self.noise) + self.steps * (motion.repeats - 1.0)
    }
}

impl Motion {
    /// From the detail and the repeats that the estimator publishes for a run. Counts and the effect of the force's
    /// second derivative are not included.
    pub fn of(detail: &Detail, repeats: f32) -> Self {
        let within = Self::within(&detail.band, repeats, [0.0; 2]);
        let gap_m = detail.contact.gap_m(&detail.backlash);
        Self { apart: apart(gap_m, within.frequency_squared, f32::INFINITY), ..within }
    }

    /// How often a pattern of steps adds up in a parameter.
    fn held_repeats(&self) -> f32 {
        if self.repeats < MOST_REPEATS { self.repeats } else { MOST_REPEATS }
    }

    /// Fraction of the steps' share in the scatter that affects Coulomb and viscous friction in a single tone. Both
    /// move the same force at the tone's own frequency; only the harmonics, `1/n` of the first, distinguish them. For a
    /// tone `w` and a box `L` this is the mean of the steps' spectrum (above) over the harmonics, weighted by the
    /// kernel and `1/n^2`, within a fourth from `w h` 0.1 to 1. It is 0 for a motion of several frequencies.
    fn steps_in_harmonics(&self, frequency_squared: f32) -> f32 {
        let alike = if self.frequency_squared > 0.0 { self.low_squared / self.frequency_squared } else { 0.0 };
        let passed = square(square(square(frequency_squared)));
        let of_tone = 0.02 + 1.9 * frequency_squared / (1.0 + 0.5 * frequency_squared + 2.0 * passed);
        of_tone * square(square(alike))
    }

    /// Relative variance of a tone's amplitude by the count in which it is read, beyond what scatters. Recurring
    /// readings are at the same place within a count each time. And however many readings differ, a tone that keeps its
    /// amplitude and its place among the counts is read too large or too small. `kernel` is the fraction of the tone's
    /// square that the kernel passes.
    fn amplitude_by_counts(&self, count_m: f32, kernel: f32) -> f32 {
        let count_over_amplitude_squared =
            square(count_m * self.low_squared) * kernel / (2.0 * self.acceleration_squared);
        if count_over_amplitude_squared > 0.0 {
            let by_readings = (self.repeats - 1.0) / (6.0 * self.readings);
            let by_place = AMPLITUDE * sqrt(count_over_amplitude_squared);
            count_over_amplitude_squared * (by_readings + by_place) * square(self.steady)
        } else {
            0.0
        }
    }

    /// Greatest variance that steps have in the shift between two fits, over what they have in each parameter
    /// ([`Source::Encoder`]): at worst, all of them pass the kernel for some regressor and add up as often as they
    /// recur. `box_s` is the length of the kernel's box.
    pub fn pattern_in_differences(&self, box_s: f32) -> [f32; UNKNOWNS] {
        let further = if self.repeats > MOST_REPEATS { (self.repeats - 1.0) / (MOST_REPEATS - 1.0) } else { 1.0 };
        let any = further / STEPS;
        let by_tone = 1.0 / self.steps_in_harmonics(self.low_squared * box_s * box_s);
        let friction = lesser(any, by_tone);
        [any, friction, friction, any]
    }

    /// How far the force of this inertance stretches the contact, over the screw's own motion, per unit of compliance
    /// [N/m].
    fn stretch_per_compliance(&self, inertance_kg: f32) -> f32 {
        magnitude(inertance_kg) * self.frequency_squared
    }

    pub(crate) fn within(band: &Band, repeats: f32, friction_in_curvature: [f32; 2]) -> Self {
        let [low, high] = [band.low_hz, band.high_hz].map(|hz| core::f32::consts::TAU * hz);
        Self {
            repeats,
            apart: 0.0,
            frequency_squared: square(high),
            low_squared: square(low),
            acceleration_squared: f32::INFINITY,
            readings: f32::INFINITY,
            steady: 0.0,
            reversals_again: 0.0,
            friction_in_curvature,
        }
    }
}

impl Systematic {
    /// From these settings.
    pub fn of(settings: &Settings) -> Self {
        let stiffness = settings.stiffness_n_per_m;
        let stiffness_u95 = match settings.stiffness_u95_n_per_m {
            0.0 => constants::UNSTATED_STIFFNESS_U95 * stiffness,
            stated => stated,
        };
        Self {
            gain: settings.force_gain_u95 as f32,
            lead: settings.lead_u95 as f32,
            timebase: settings.timebase_u95 as f32,
            skew_s: settings.skew_u95_s as f32,
            structure_mass_kg: settings.structure_mass_kg as f32,
            structure_u95_kg: settings.structure_mass_u95_kg as f32,
            compliance_m_per_n: if stiffness > 0.0 { (1.0 / stiffness) as f32 } else { 0.0 },
            compliance_u95_m_per_n: if stiffness > 0.0 {
                (stiffness_u95 / stiffness / stiffness) as f32
            } else {
                f32::INFINITY
            },
            damping_n_s_per_m: settings.contact_damping_n_s_per_m as f32,
            count_m: settings.metres_per_count as f32,
            // The mean of the later positions less that of the earlier ones; each reading lies anywhere within a count.
            velocity_squares: [constants::REVERSAL_KERNEL_S, constants::SIGN_KERNEL_S].map(|half_width_s| {
                let cubed = half_width_s * half_width_s * half_width_s;
                (settings.metres_per_count * settings.metres_per_count / (6.0 * cubed * settings.sample_rate_hz)) as f32
            }),
            reach_s: constants::REVERSAL_REACH_S as f32,
        }
    }

    /// Variance that a skew and a stiffness within their intervals leave in the residual of a fit \[N^2\]; that of the
    /// skew alone if no stiffness is set. `late` and `curved` are the mean squares of the force's rate and of its
    /// second derivative that the law does not explain.
    pub(crate) fn forgiven(&self, late: f32, curved: f32) -> f32 {
        let bent = self.structure_mass_kg * self.compliance_u95_m_per_n;
        square(self.skew_s) * late + if bent.is_finite() { square(bent) * curved } else { 0.0 }
    }

    /// Variance of each parameter, over its squared standard error, by the place of one reversal: from there to where
    /// the screw reverses, friction is wrong by twice itself, and the acceleration is at its greatest.
    /// `inertance_error` is the standard error of the inertance with a residual of this variance, behind boxes of this
    /// squared length.
    pub fn places(
        &self,
        [inertance, coulomb]: [f32; 2],
        inertance_error: f32,
        variance: f32,
        box_squared: f32,
        acceleration_squared: f32,
    ) -> f32 {
        // As for a tone.
        let greatest_squared = 2.0 * acceleration_squared;
        let [long, short] = self.velocity_squares;
        // A reversal at which friction may hold the screw is left out; one that the short kernel places too far off
        // stays there.
        let turns_freely = greatest_squared * square(inertance) > square(MAY_HOLD * coulomb);
        let is_moved = greatest_squared * square(self.reach_s) > 4.0 * short;
        let part = inertance_error * coulomb / (variance * CORRELATION_BOXES);
        let places = 4.0 * if is_moved { long } else { short } * square(part) / box_squared;
        if turns_freely && places.is_finite() { places } else { 0.0 }
    }

    /// Budget of the inertance, which still includes the structure's mass \[kg\].
    pub fn inertance(&self, found: &Found, spread: &Spread, motion: &Motion) -> Budget {
        let mass = self.structure_mass_kg;
        let loose = LOOSE_STRUCTURE_U95 * mass;
        // The structure moves as the screw does, except that the force bends the contact.
        let stretch = motion.stretch_per_compliance(found.value);
        let bent = mass * stretch * self.compliance_u95_m_per_n;
        let follows = magnitude(1.0 - stretch * self.compliance_m_per_n);
        let flanks = motion.apart * mass;
        let of_tone = square(found.value) * motion.amplitude_by_counts(self.count_m, spread.kernel);
        let error_squared = square(found.error);
        // Where it is unknown, nothing is added.
        let placed = if spread.places > 0.0 { spread.places * error_squared } else { 0.0 };
        let of_tone = together(of_tone, placed);
        self.common(found, spread, greater(spread.pattern * error_squared, of_tone))
            .and(Source::Lead, found.value * self.lead)
            .and(Source::Timebase, 2.0 * found.value * self.timebase)
            .and(Source::Structure, follows * self.structure_u95_kg)
            .and(Source::Structure, flanks)
            .and(Source::Stiffness, if bent < loose { bent } else { loose })
    }

    /// Budget of viscous friction \[N s/m\].
    pub fn viscous(&self, found: &Found, spread: &Spread, motion: &Motion) -> Budget {
        let [in_curvature, _] = motion.friction_in_curvature;
        let budget =
            self.common(found, spread, spread.tone * square(found.error)).and(Source::Lead, found.value * self.lead);
        self.bent(budget.and(Source::Timebase, found.value * self.timebase), in_curvature, found, spread, motion)
    }

    /// Budget of Coulomb friction \[N\].
    pub fn coulomb(&self, found: &Found, spread: &Spread, motion: &Motion) -> Budget {
        let [_, in_curvature] = motion.friction_in_curvature;
        self.bent(self.common(found, spread, spread.tone * square(found.error)), in_curvature, found, spread, motion)
    }

    /// Adds the effect of a wrong compliance. The structure moves with the force's second derivative. The contact's
    /// damping subtracts a term in the third derivative, which is the first times minus the square of the motion's
    /// frequency.
    fn bent(&self, budget: Budget, in_curvature: f32, found: &Found, spread: &Spread, motion: &Motion) -> Budget {
        let lag = self.damping_n_s_per_m * self.compliance_m_per_n;
        let per_compliance =
            self.structure_mass_kg * (in_curvature + 2.0 * lag * motion.frequency_squared * found.per_skew);
        // Zero times an unknown compliance is zero.
        if per_compliance == 0.0 {
            return budget;
        }
        let own = magnitude(spread.inertance_kg) * greater(motion.frequency_squared, LEAST_OWN_FREQUENCY_SQUARED);
        let loosest = LOOSE_STRUCTURE_U95 / own;
        let known = self.compliance_u95_m_per_n;
        budget.and(Source::Stiffness, per_compliance * if known < loosest { known } else { loosest })
    }

    /// Budget of the offset \[N\].
    pub fn offset(&self, found: &Found, spread: &Spread) -> Budget {
        self.common(found, spread, spread.pattern * square(found.error))
    }

    /// The part of the budget that all parameters have; `repeated` is the variance by recurring steps.
    fn common(&self, found: &Found, spread: &Spread, repeated: f32) -> Budget {
        Budget::of_scatter(spread.noise * found.error, spread.freedom)
            .and_variance(Source::Encoder, repeated)
            .and(Source::Encoder, found.steps)
            .and(Source::Skew, found.per_skew * self.skew_s)
            .and(Source::Gain, found.value * self.gain)
    }
}

/// Variance of a sum whose parts, of these variances, are caused by the same counts.
fn together(one: f32, other: f32) -> f32 {
    one + other + 2.0 * sqrt(one) * sqrt(other)
}

/// Greatest fraction of a structure's mass that a gap hides: the structure is half of the gap ahead of the screw while
/// the force pushes one way, and half of it behind while it pushes the other. 0 where flanks do not part, and 5 % where
/// the gap is infinite, which means unknown, or the motion is unknown. `frequency_squared` is the motion's, weighted by
/// the squared acceleration, whose mean square is given too.
pub fn apart(gap_m: f32, frequency_squared: f32, acceleration_squared: f32) -> f32 {
    if gap_m == 0.0 {
        return 0.0;
    }
    let known = gap_m.is_finite() && frequency_squared > 0.0 && acceleration_squared > 0.0;
    if known && acceleration_squared.is_finite() {
        lesser(1.0, GAP * gap_m * frequency_squared / sqrt(acceleration_squared))
    } else {
        STRUCTURE_MODEL_U95
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A structure of 30 kg behind a contact of 2 MN/m, known to 0.1 MN/m: 25 nm/N of its compliance. Its lag is
    /// 0.6 ms.
    fn settings() -> Settings {
        Settings {
            skew_u95_s: 2e-5,
            structure_mass_kg: 30.0,
            structure_mass_u95_kg: 2.0,
            stiffness_n_per_m: 2e6,
            stiffness_u95_n_per_m: 1e5,
            contact_damping_n_s_per_m: 1200.0,
            ..Settings::default()
        }
    }

    fn motion(frequency_squared: f32) -> Motion {
        Motion {
            repeats: 1.0,
            apart: 0.03,
            frequency_squared,
            low_squared: frequency_squared,
            acceleration_squared: f32::INFINITY,
            readings: f32::INFINITY,
            steady: 0.0,
            reversals_again: 0.0,
            friction_in_curvature: [500.0, -300.0],
        }
    }

    fn near(found: f32, wanted: f64, what: &str) {
        assert!((f64::from(found) - wanted).abs() <= 1e-5 * wanted.abs(), "{what}: {found} for {wanted}");
    }

    /// `skew^2 late + (m u(1/k))^2 curved`.
    #[test]
    fn a_skew_and_a_stiffness_within_their_intervals_are_forgiven() {
        let of = |settings: &Settings| Systematic::of(settings).forgiven(4e6, 9e8);
        near(of(&settings()), 4e-10 * 4e6 + 5.625e-13 * 9e8, "both");
        near(of(&Settings { stiffness_n_per_m: 0.0, ..settings() }), 1.6e-3, "skew alone");
        near(of(&Settings { stiffness_n_per_m: 0.0, structure_mass_kg: 0.0, ..settings() }), 1.6e-3, "no structure");
        // 1 % where it is not stated: 5 nm/N.
        near(of(&Settings { stiffness_u95_n_per_m: 0.0, ..settings() }), 1.6e-3 + 2.25e-14 * 9e8, "not stated");
    }

    /// `m (curvature's + 2 lag w^2 skew's) u(1/k)` for friction, where the compliance is no less known than by a
    /// natural frequency of 5 Hz, or of the motion: 1.5 over `mt w0^2`.
    #[test]
    fn a_wrong_compliance_is_in_the_friction_by_the_structure() {
        let found = Found { value: 40.0, error: 0.4, per_skew: 2e3, steps: 0.0 };
        let parts = |settings: &Settings, frequency_squared: f32| {
            let (systematic, motion) = (Systematic::of(settings), motion(frequency_squared));
            let spread = Scatter::white(-300.0, 55.0).in_motion(&motion);
            [systematic.viscous(&found, &spread, &motion), systematic.coulomb(&found, &spread, &motion)]
                .map(|budget| budget.given_u95(Source::Stiffness))
        };
        let [viscous, coulomb] = parts(&settings(), 500.0);
        near(viscous, 30.0 * (500.0 + 2.0 * 6e-4 * 500.0 * 2e3) * 2.5e-8, "viscous");
        near(coulomb, 30.0 * (-300.0 + 2.0 * 6e-4 * 500.0 * 2e3) * 2.5e-8, "coulomb");
        let unknown = Settings { stiffness_n_per_m: 0.0, ..settings() };
        for (frequency_squared, own) in [(500.0, 987.0), (2000.0, 2000.0)] {
            let [viscous, coulomb] = parts(&unknown, frequency_squared);
            near(viscous, 30.0 * 500.0 * 1.5 / (300.0 * own), "viscous of an unknown contact");
            near(coulomb, 30.0 * 300.0 * 1.5 / (300.0 * own), "coulomb of an unknown contact");
        }
        assert_eq!(parts(&Settings { structure_mass_kg: 0.0, ..unknown }, 500.0), [0.0; 2]);
    }

    /// The structure's mass where it follows the screw and where flanks hide it; and what the contact's stretch makes
    /// of it, at most 1.5 times that mass.
    #[test]
    fn a_structure_is_in_the_inertance_as_it_moves() {
        let found = Found { value: -300.0, error: 0.4, per_skew: 0.0, steps: 0.0 };
        let parts = |settings: &Settings, frequency_squared: f32| {
            let motion = motion(frequency_squared);
            let spread = Scatter::white(-300.0, 55.0).in_motion(&motion);
            let budget = Systematic::of(settings).inertance(&found, &spread, &motion);
            [Source::Structure, Source::Stiffness].map(|source| budget.given_u95(source))
        };
        // The stretch is 300 kg times 500 /s^2 over 2 MN/m: 7.5 % of the motion.
        let [structure, stiffness] = parts(&settings(), 500.0);
        near(structure, ((0.925_f64 * 2.0).powi(2) + (0.03_f64 * 30.0).powi(2)).sqrt(), "structure");
        near(stiffness, 30.0 * 300.0 * 500.0 * 2.5e-8, "stiffness");
        // Above the natural frequency: the stretch is 1.5 times the motion, and the structure moves against the screw.
        let loose = Settings { stiffness_n_per_m: 1e5, stiffness_u95_n_per_m: 1e6, ..settings() };
        let [structure, stiffness] = parts(&loose, 500.0);
        near(structure, ((0.5_f64 * 2.0).powi(2) + (0.03_f64 * 30.0).powi(2)).sqrt(), "structure of a loose contact");
        near(stiffness, 45.0, "stiffness of a loose contact");
    }
}
