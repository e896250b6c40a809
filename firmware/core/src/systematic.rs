//! What no averaging removes of each parameter: by what the settings state, and by what the motion makes of it.

use crate::budget::{Budget, Source};
use crate::constants;
use crate::detail::{Band, Detail};
use crate::ldl::UNKNOWNS;
use crate::math::{greater, lesser, magnitude, sqrt, square};
use crate::settings::Settings;

const STRUCTURE_MODEL_U95: f32 = constants::STRUCTURE_MODEL_U95 as f32;
/// Model error of the structure mass where the contact's stiffness is not known: at the device's own frequency the terminal stands while the screw
/// moves, and from there on moves against it. 1.5 holds up to 1.2 times that frequency.
const LOOSE_STRUCTURE_U95: f32 = 1.5;
/// A contact whose stiffness is not set is taken to give the device an own frequency of 5 Hz at least; its square [rad^2/s^2].
const LEAST_OWN_FREQUENCY_SQUARED: f32 = 987.0;
/// Part of their share in the scatter that the encoder's steps have in a parameter, by the harmonics of a stroke. They are
/// noise in the position, and in the acceleration they have most of it beyond the motion's own frequencies.
const STEPS: f32 = 0.25;
/// The same by the motion's own frequency `w`, per `(w L)^4`: the spectrum of a second difference over a box `L` against a flat
/// one of the same variance and correlation length.
const STEPS_AT_FREQUENCY: f32 = 3.0 / 8.0 / 2.09;
/// Times that a pattern of steps adds up at most, but for what a tone's harmonics tell: one that stays for longer differs from stroke
/// to stroke in what it does.
pub const MOST_REPEATS: f32 = 8.0;
/// Variance of the amplitude of a tone that is read in counts, over `(count / amplitude)^3` and the amplitude's square, wherever among the
/// counts it stands: `zeta(3) / pi^4`, by the first harmonic of a sawtooth of a sine.
const AMPLITUDE: f32 = 0.01234;

/// Part of the acceleration that a jump of a gap `g` takes whenever it turns, over `g w^2 / a`: `2 / (sqrt(2) pi)` of a tone, 0.40 of a
/// normal random motion, `w` weighted by the squared acceleration and `a` its rms.
const GAP: f32 = 0.45;
/// Force over Coulomb friction under which a reversal is left out, as friction may hold the screw there.
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
    /// The contact's compliance \[m/N\]; 0 where its stiffness is not known.
    compliance_m_per_n: f32,
    /// Of it \[m/N\]; infinite where its stiffness is not known.
    compliance_u95_m_per_n: f32,
    /// Damping of the contact \[N s/m\].
    damping_n_s_per_m: f32,
    /// The encoder's count \[m\].
    count_m: f32,
    /// Variance of a reversal's velocity by the counts that the long kernel reads, and the short one \[m^2/s^2\].
    velocity_squares: [f32; 2],
    /// How far the long kernel moves a reversal \[s\].
    reach_s: f32,
}

/// A parameter as a fit gives it, before what no averaging removes.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    /// Value.
    pub value: f32,
    /// Standard error, were the residual white before the kernel.
    pub error: f32,
    /// What a force that is late by a second more takes from it.
    pub per_skew: f32,
    /// How far what is known of the encoder's steps leaves it undecided.
    pub steps: f32,
}

/// What a fit's parameters have in common.
#[derive(Clone, Copy, Debug)]
pub struct Scatter {
    /// The inertance of the fit, with the structure's mass \[kg\].
    pub inertance_kg: f32,
    /// Degrees of freedom of the residual.
    pub freedom: f32,
    /// Part of the residual's variance that the encoder's steps explain, and the part that sums of independent readings
    /// keep of it.
    pub steps_share: [f32; 2],
    /// Square of the motion's frequency, weighted by the squared velocity, times that of the kernel's box.
    pub frequency_squared: f32,
    /// Variance of a parameter by the places of the reversals, per squared standard error and per reversal that comes again
    /// ([`Systematic::places`]).
    pub places: f32,
}

/// What is known of a run beside the sums that a fit rests on.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Motion {
    /// How often each stroke has come, sample by sample: 1 where none came again.
    pub repeats: f32,
    /// Part of the structure's mass that its motion across the gap leaves out ([`apart`]).
    pub apart: f32,
    /// Mean square of the motion's frequency, weighted by the squared acceleration \[rad^2/s^2\].
    pub frequency_squared: f32,
    /// The same, weighted by the squared velocity.
    pub low_squared: f32,
    /// Mean square of the acceleration \[m^2/s^4\]; infinite where counts do not matter.
    pub acceleration_squared: f32,
    /// Readings of the position; infinite where that is not known.
    pub readings: f32,
    /// Part of the strokes that were as long as the one before: nearly 1 of a tone that keeps its amplitude, nearly 0 of other motions.
    pub steady: f32,
    /// Reversals, each as often as its stroke has come again.
    pub reversals_again: f32,
    /// Viscous and Coulomb friction that the second derivative of the force is taken for [N s/m and N, per N/s^2]; 0 where it was not
    /// measured.
    pub friction_in_curvature: [f32; 2],
}

impl Scatter {
    /// Of residuals that are taken for white, whatever the motion.
    pub const fn white(inertance_kg: f32, freedom: f32) -> Self {
        Self { inertance_kg, freedom, steps_share: [0.0; 2], frequency_squared: 0.0, places: 0.0 }
    }

    /// What it makes of every parameter's error in this motion.
    pub fn in_motion(&self, motion: &Motion) -> Spread {
        // The kernel at the motion's frequency, squared: (sin x / x)^8 with x = w L / 2, from above.
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

/// What scatters in a motion, per standard error of a parameter.
#[derive(Clone, Copy, Debug)]
pub struct Spread {
    /// The inertance of the fit, with the structure's mass \[kg\].
    inertance_kg: f32,
    /// Degrees of freedom of the residual.
    freedom: f32,
    /// By what scatters.
    noise: f32,
    /// Variance by the encoder's steps where strokes come again and they with them.
    pattern: f32,
    /// The same of friction, which the harmonics of a single tone tell.
    tone: f32,
    /// The same of every parameter: reversals that come again are placed by the same counts.
    places: f32,
    /// Variance by steps that do not come again.
    steps: f32,
    /// What the kernel leaves of the motion's square.
    kernel: f32,
}

impl Spread {
    /// Variance of what a parameter moves by between the fit to a part and the fit to all, per difference of their squared
    /// standard errors: steps near rest, by which they differ, are the same whenever a stroke comes again.
    pub(crate) fn moved(&self, motion: &Motion) -> f32 {
        square(self.noise) + self.steps * (motion.repeats - 1.0)
    }
}

impl Motion {
    /// Of a run whose detail and repeats the estimator tells so. Neither the count nor what the force's second derivative does is
    /// among them.
    pub fn of(detail: &Detail, repeats: f32) -> Self {
        let within = Self::within(&detail.band, repeats, [0.0; 2]);
        let gap_m = detail.contact.gap_m(&detail.backlash);
        Self { apart: apart(gap_m, within.frequency_squared, f32::INFINITY), ..within }
    }

    /// Times that a pattern of steps adds up in a parameter.
    fn held_repeats(&self) -> f32 {
        if self.repeats < MOST_REPEATS { self.repeats } else { MOST_REPEATS }
    }

    /// Part of their share in the scatter that steps have in Coulomb's and in viscous friction by a single tone, of which both move the
    /// same force at its own frequency: only the harmonics, `1/n` of the first, tell one from the other. For a tone `w` and a box `L`
    /// that is the mean of the steps' spectrum (above) over them, weighted by the kernel and `1/n^2`, within a fourth from
    /// `w L` 0.1 to 1. 0 of a motion of several frequencies.
    fn steps_in_harmonics(&self, frequency_squared: f32) -> f32 {
        let alike = if self.frequency_squared > 0.0 { self.low_squared / self.frequency_squared } else { 0.0 };
        let passed = square(square(square(frequency_squared)));
        let of_tone = 0.02 + 1.9 * frequency_squared / (1.0 + 0.5 * frequency_squared + 2.0 * passed);
        of_tone * square(square(alike))
    }

    /// Variance of a tone's amplitude by the count that it is read in, over its square, beside what scatters. Readings that come again
    /// stand a count's part off each time; and however many differ, a tone that keeps its amplitude and its place among the counts is
    /// read too large or too small. `kernel` is what it leaves of the tone's square.
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

    /// Variance that steps have at most in what moves between two fits, over what they have in each parameter
    /// ([`Source::Encoder`]): of some regressor all of them pass the kernel, whose box is given, and add up as often as they come again.
    pub fn pattern_in_differences(&self, box_s: f32) -> [f32; UNKNOWNS] {
        let further = if self.repeats > MOST_REPEATS { (self.repeats - 1.0) / (MOST_REPEATS - 1.0) } else { 1.0 };
        let any = further / STEPS;
        let by_tone = 1.0 / self.steps_in_harmonics(self.low_squared * box_s * box_s);
        let friction = lesser(any, by_tone);
        [any, friction, friction, any]
    }

    /// What the force of so much inertance stretches the contact by, over the screw's own motion, per unit of compliance [N/m].
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
    /// Of these settings.
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
            // The mean of the positions behind less that of those before: readings anywhere within a count each.
            velocity_squares: [constants::REVERSAL_KERNEL_S, constants::SIGN_KERNEL_S].map(|half_width_s| {
                let cubed = half_width_s * half_width_s * half_width_s;
                (settings.metres_per_count * settings.metres_per_count / (6.0 * cubed * settings.sample_rate_hz)) as f32
            }),
            reach_s: constants::REVERSAL_REACH_S as f32,
        }
    }

    /// Variance that a skew and a stiffness within their intervals leave in the residual of a fit \[N^2\]; none where no stiffness is
    /// set; `late` and `curved` are the mean squares that the law leaves of the force's rate and of its second derivative.
    pub(crate) fn forgiven(&self, late: f32, curved: f32) -> f32 {
        let bent = self.structure_mass_kg * self.compliance_u95_m_per_n;
        square(self.skew_s) * late + if bent.is_finite() { square(bent) * curved } else { 0.0 }
    }

    /// Variance of each parameter over its squared standard error by the place of one reversal: friction is wrong by twice itself from
    /// there to where the screw turns, in which the acceleration is at its greatest. The inertance's standard error is by so much
    /// variance of the residual in a box of this square length.
    pub fn places(
        &self,
        [inertance, coulomb]: [f32; 2],
        inertance_error: f32,
        variance: f32,
        box_squared: f32,
        acceleration_squared: f32,
    ) -> f32 {
        // As of a tone.
        let greatest_squared = 2.0 * acceleration_squared;
        let [long, short] = self.velocity_squares;
        // One at which friction may hold the screw is left out; one that the short kernel places too far off stays there.
        let turns_freely = greatest_squared * square(inertance) > square(MAY_HOLD * coulomb);
        let is_moved = greatest_squared * square(self.reach_s) > 4.0 * short;
        let part = inertance_error * coulomb / (variance * CORRELATION_BOXES);
        let places = 4.0 * if is_moved { long } else { short } * square(part) / box_squared;
        if turns_freely && places.is_finite() { places } else { 0.0 }
    }

    /// Of the inertance, which still holds the structure's mass \[kg\].
    pub fn inertance(&self, found: &Found, spread: &Spread, motion: &Motion) -> Budget {
        let mass = self.structure_mass_kg;
        let loose = LOOSE_STRUCTURE_U95 * mass;
        // The structure moves as the screw does, but for what the force bends the contact.
        let stretch = motion.stretch_per_compliance(found.value);
        let bent = mass * stretch * self.compliance_u95_m_per_n;
        let follows = magnitude(1.0 - stretch * self.compliance_m_per_n);
        let flanks = motion.apart * mass;
        let of_tone = square(found.value) * motion.amplitude_by_counts(self.count_m, spread.kernel);
        let error_squared = square(found.error);
        // Where nothing is known of it, nothing is added.
        let placed = if spread.places > 0.0 { spread.places * error_squared } else { 0.0 };
        let of_tone = together(of_tone, placed);
        self.common(found, spread, greater(spread.pattern * error_squared, of_tone))
            .and(Source::Lead, found.value * self.lead)
            .and(Source::Timebase, 2.0 * found.value * self.timebase)
            .and(Source::Structure, follows * self.structure_u95_kg)
            .and(Source::Structure, flanks)
            .and(Source::Stiffness, if bent < loose { bent } else { loose })
    }

    /// Of viscous friction \[N s/m\].
    pub fn viscous(&self, found: &Found, spread: &Spread, motion: &Motion) -> Budget {
        let [in_curvature, _] = motion.friction_in_curvature;
        let budget =
            self.common(found, spread, spread.tone * square(found.error)).and(Source::Lead, found.value * self.lead);
        self.bent(budget.and(Source::Timebase, found.value * self.timebase), in_curvature, found, spread, motion)
    }

    /// Of Coulomb friction \[N\].
    pub fn coulomb(&self, found: &Found, spread: &Spread, motion: &Motion) -> Budget {
        let [_, in_curvature] = motion.friction_in_curvature;
        self.bent(self.common(found, spread, spread.tone * square(found.error)), in_curvature, found, spread, motion)
    }

    /// With what a wrong compliance takes. The structure moves with the force's second derivative, and the contact's damping takes from that
    /// in proportion to the third, which is the first times minus the square of the motion's frequency.
    fn bent(&self, budget: Budget, in_curvature: f32, found: &Found, spread: &Spread, motion: &Motion) -> Budget {
        let lag = self.damping_n_s_per_m * self.compliance_m_per_n;
        let per_compliance =
            self.structure_mass_kg * (in_curvature + 2.0 * lag * motion.frequency_squared * found.per_skew);
        // A product with nothing is nothing, however little is known of the other.
        if per_compliance == 0.0 {
            return budget;
        }
        let own = magnitude(spread.inertance_kg) * greater(motion.frequency_squared, LEAST_OWN_FREQUENCY_SQUARED);
        let loosest = LOOSE_STRUCTURE_U95 / own;
        let known = self.compliance_u95_m_per_n;
        budget.and(Source::Stiffness, per_compliance * if known < loosest { known } else { loosest })
    }

    /// Of the offset \[N\].
    pub fn offset(&self, found: &Found, spread: &Spread) -> Budget {
        self.common(found, spread, spread.pattern * square(found.error))
    }

    /// With the variance that steps have where they come again.
    fn common(&self, found: &Found, spread: &Spread, repeated: f32) -> Budget {
        Budget::of_scatter(spread.noise * found.error, spread.freedom)
            .and_variance(Source::Encoder, repeated)
            .and(Source::Encoder, found.steps)
            .and(Source::Skew, found.per_skew * self.skew_s)
            .and(Source::Gain, found.value * self.gain)
    }
}

/// Variance of the sum of what the same counts make, of these variances.
fn together(one: f32, other: f32) -> f32 {
    one + other + 2.0 * sqrt(one) * sqrt(other)
}

/// Part of a structure's mass that a gap leaves out of its motion at most, half of it ahead of the screw while the force pushes one way and
/// half behind while it pushes the other: 0 where flanks do not part, and 5 % where the gap is infinite, as it is not known, or nothing
/// of the motion. `frequency_squared` is the motion's, weighted by the squared acceleration, whose mean square is given too.
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
