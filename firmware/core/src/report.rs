//! Converts moments to values in SI with their intervals: the edge of the fixed-point world.
//!
//! Floats are allowed here: basic arithmetic gives the same bits on every machine, and only a few rounded integers are
//! fed back (see [`Feedback`]).

use crate::active::{Active, Scales};
use crate::backlash::report::Found as Backlash;
use crate::bank::BankState;
use crate::budget::{Budget, Budgets, Source};
use crate::constants;
use crate::detail::{Band, Detail, Friction, Law, LawStatus};
use crate::estimate::{Bank, Estimate, Interval, Parameter, Parameters, Status};
use crate::feedback::Feedback;
use crate::fit::{Fit, Knowledge, fit};
use crate::ldl::UNKNOWNS;
use crate::line::VELOCITY_BITS;
use crate::math::{greater, magnitude, single, sqrt, square, term};
use crate::noise::Noise;
use crate::output::Published;
use crate::qformat::Term;
use crate::regime::{self, Assessment, Explained};
use crate::state::State;
use crate::systematic::{Found, Motion, Scatter, Spread, apart};
use crate::trial::Trial;

// Single precision, as everywhere here.
const WIDEST_INTERVAL: f32 = constants::WIDEST_INTERVAL as f32;
const CLEAR_OF_STEPS: f32 = constants::CLEAR_OF_STEPS as f32;
/// The same where the slow bank's kernel smooths away all but [`SMOOTHED`] of the acceleration's mean square, as with
/// moves that are shorter than the kernel. At 145, one value of the reference device in three lies outside its
/// interval; at 210, so does the friction of an axis. For the whole run only: changes are judged by one bank, and a
/// live estimate that switches from one bank to the other would show them later.
const AMONG_STEPS: f32 = 500.0;
const SMOOTHED: f32 = 0.1;
/// Quartiles of the force's fourth differences, each with its ratio to the rms of the noise; then the ratio of the
/// lower one alone.
const QUARTILES: [(u32, f32); 3] =
    [(1, QUARTILE), (2, constants::QUARTILES[1] as f32), (3, constants::QUARTILES[2] as f32)];
const QUARTILE: f32 = constants::QUARTILES[0] as f32;
/// Variance of rounding the force to codes [codes^2].
const STEPS: f32 = constants::ROUNDING as f32;
/// Relative interval of Coulomb friction below which reversals are relocated with it.
const FRICTION_KNOWN: f32 = 0.1;
/// Variance of what noise adds to a jump of the force (`line.rs`), over that of the noise, times 4^2: a jump must
/// exceed four standard deviations.
const NOISE_OF_JUMP: f32 = 20.0 * 16.0;

/// The force's noise.
struct Heard {
    /// Its variance [codes^2]; infinite before it is known.
    variance: f32,
    /// Differences that it was found from.
    differences: u32,
}

impl Heard {
    fn of(noise: &Noise) -> Self {
        let variance = noise_by(noise, 1, QUARTILE).map_or(f32::INFINITY, |rms| {
            // Rounding that is greater than the noise is a noise of its own.
            if rms * rms > STEPS { rms * rms } else { STEPS }
        });
        Self { variance, differences: noise.differences() }
    }
}

/// The result of one memory.
struct Told {
    fit: Fit,
    /// By everything except what breaks the law.
    budgets: [Budget; UNKNOWNS],
    law: Law,
}

/// The result of the recent memory of the published bank.
struct Recent {
    bank: Bank,
    told: Told,
    assessment: Assessment,
    band: Band,
}

impl Active {
    /// The estimate and what is published with it as they stand, at any time.
    pub fn publish(&self, state: &State) -> Published {
        self.publish_and_feed_back(state).0
    }

    /// The budgets of the intervals of [`Self::publish`].
    pub fn budgets(&self, state: &State) -> Budgets {
        let found = self.backlash.found(&state.backlash, state.repeats());
        let noise = Heard::of(&state.noise);
        let recent = self.recent(state, &found, &noise);
        let whole_run = self.whole_run(state, &found, &noise, &recent);
        Budgets {
            recent: recent.told.all_budgets(),
            whole_run: whole_run.all_budgets(),
            contact: self.backlash.budgets(&state.backlash, state.repeats()),
        }
    }

    /// The motion on which the intervals of the whole run are based.
    pub fn motion(&self, state: &State) -> Motion {
        let found = self.backlash.found(&state.backlash, state.repeats());
        let recent = self.recent(state, &found, &Heard::of(&state.noise));
        let (bank, knowledge) = self.choose(state, Knowledge::whole_run, AMONG_STEPS);
        self.motion_of_all(state, &found, &recent, bank, &knowledge)
    }

    /// The same, with the feedback to the next samples. The feedback uses the fit whether the law holds or not:
    /// friction that is nearly right removes more error than it adds.
    pub(crate) fn publish_and_feed_back(&self, state: &State) -> (Published, Feedback) {
        let found = self.backlash.found(&state.backlash, state.repeats());
        let noise = Heard::of(&state.noise);
        let recent = self.recent(state, &found, &noise);
        let whole_run = self.whole_run(state, &found, &noise, &recent);
        let Recent { bank, assessment, band, told, .. } = recent;
        let (config, bank_state) = self.bank(state, bank);
        let moving = bank_state.idle_samples < config.hold_samples && bank_state.recent.updates() > 0;
        let fitted = self.parameters(&told.fit, &told.budgets);
        let feedback = if moving { self.feedback(&fitted, &noise, state.feedback) } else { state.feedback };
        let is_judged = told.law.misfit.is_some() && told.fit.observations >= regime::LEAST_OBSERVATIONS;
        let suspected = state.trial == Trial::Open && !is_judged;
        let published = |told: &Told, fitted: Parameters| {
            let mut parameters = match told.broken_by() {
                Some(budgets) => self.parameters(&told.fit, &budgets),
                None => fitted,
            };
            if suspected || fitted.are_backwards() {
                parameters.refuse();
            } else if told.law.status == LawStatus::Broken || !assessment.judged {
                parameters.refuse_what_is_wide();
            }
            parameters
        };
        let mut parameters = published(&told, fitted);
        if !moving {
            parameters.hold();
        }
        let status = match told.law.status {
            _ if fitted.are_backwards() => LawStatus::Broken,
            // A reversal that was placed before friction was known may look the same.
            LawStatus::Broken if state.trial != Trial::Over => LawStatus::Unknown,
            status => status,
        };
        let law = Law { status, ..told.law };
        let index = state.last_index();
        let estimate = Estimate {
            index,
            elapsed_samples: state.counters().samples + state.counters().lost_samples,
            bank,
            moving,
            recent: parameters,
            whole_run: published(&whole_run, self.parameters(&whole_run.fit, &whole_run.budgets)),
            residual_rms_n: sqrt(told.fit.variance),
            updates: bank_state.whole.updates(),
        };
        let detail = Detail {
            index,
            band,
            backlash: found.backlash,
            contact: found.contact,
            stiffness_n_per_m: found.stiffness,
            contact_damping_n_s_per_m: found.damping,
            friction: Friction { reversal_ratio: state.reversal_ratio(), regime: assessment.regime },
            changes: state.watch.count,
        };
        (Published { estimate, detail, law: Law { index, ..law } }, feedback)
    }

    /// What bends the position: steps, and the force over the inertance; `None` unless the inertance is known, whether
    /// the law holds or not.
    pub(crate) fn bend(&self, parameters: &Parameters) -> Option<(u32, Term)> {
        let Interval { value, u95 } = parameters.inertance_kg.fitted();
        let (steps, per_code) = self.signal.bend;
        (u95 < WIDEST_INTERVAL * value).then(|| (steps, term(per_code / f64::from(value))))
    }

    /// The force's noise [codes, rms] apart from clipped samples, which have none.
    pub(crate) fn noise_beside_clipped(&self, noise: &Noise) -> Option<f32> {
        let rms = |(quarters, per_rms)| noise_by(noise, quarters, per_rms);
        QUARTILES.into_iter().filter_map(rms).find(|rms| *rms >= constants::LEAST_NOISE as f32)
    }

    /// The part of the residual that force noise, encoder steps, and a skew and a stiffness within their intervals
    /// explain.
    fn explained(&self, noise: &Heard, fit: &Fit, scales: &Scales, repeats: f32) -> Explained {
        let [inertance, ..] = fit.values;
        let steps = self.steps_variance(inertance, scales);
        let variance = noise.variance * scales.noise + steps + self.systematic.forgiven(fit.late, fit.curved);
        Explained { variance, scatter: 1.0 + square(steps / variance) * (repeats - 1.0) }
    }

    /// Variance that the encoder's steps leave in the residual \[N^2\].
    fn steps_variance(&self, inertance_kg: f32, scales: &Scales) -> f32 {
        let [acceleration, ..] = scales.units;
        let per_unit = inertance_kg * acceleration as f32;
        per_unit * per_unit * scales.quantisation
    }

    /// Results of the recent memory of the published bank, and how far its law can be trusted.
    fn recent(&self, state: &State, found: &Backlash, noise: &Heard) -> Recent {
        let (bank, knowledge) = self.choose(state, Knowledge::recent, CLEAR_OF_STEPS);
        let (config, bank_state) = self.bank(state, bank);
        let scales = &config.scales;
        let [a, v, ..] = scales.units;
        let mean_square = |averages: f32, steps: f32, unit: f32| (averages - steps) * unit * unit;
        let acceleration = mean_square_acceleration(&knowledge, scales);
        let jerk = mean_square(single(bank_state.jerk), scales.jerk_quantisation, scales.jerk);
        let velocity = mean_square(knowledge.mean_square(1), 0.0, v as f32);
        let squares = [mean_square(knowledge.mean_square(0), 0.0, a as f32), velocity];
        let band = band(velocity, acceleration, jerk);
        let fitted = fit(&knowledge, scales).unwrap_or(Fit::UNKNOWN);
        let away = fit(&Knowledge::away(bank_state), scales).unwrap_or(Fit::UNKNOWN);
        // The memory holds a part of the strokes of the whole run.
        let held = knowledge.updates() / bank_state.whole.updates().max(1) as f32;
        let held = if held < 1.0 { held } else { 1.0 };
        let repeats = 1.0 + (state.repeats() - 1.0) * held;
        let within = Motion::within(&band, repeats, fitted.friction_in_curvature);
        let motion = Motion {
            apart: apart(found.gap_m(), within.frequency_squared, acceleration),
            acceleration_squared: acceleration,
            readings: self.readings(bank, knowledge.updates()),
            steady: state.steadiness(),
            reversals_again: state.reversals_again() * square(held),
            ..within
        };
        let explained = self.explained(noise, &fitted, scales, repeats);
        let spread = self.scatter(&fitted, scales, &motion).in_motion(&motion);
        let budgets = self.budgets_of(&fitted, &spread, &motion);
        let viscous = Interval { value: fitted.values[1], u95: budgets[1].u95() };
        let moved = spread.moved(&motion);
        let assessment = Assessment::of(&fitted, &away, squares, viscous, &explained, found.contact, moved);
        let force = || knowledge.mean_square(UNKNOWNS) * square(scales.force);
        let law = regime::law(&fitted, &explained, noise.differences, found.contact, force);
        let told = Told { fit: fitted, budgets: assessment.widen(budgets), law };
        Recent { bank, told, assessment, band }
    }

    /// The same for all data since the reset, with what the recent memory shows of friction.
    fn whole_run(&self, state: &State, found: &Backlash, noise: &Heard, recent: &Recent) -> Told {
        let (bank, knowledge) = self.choose(state, Knowledge::whole_run, AMONG_STEPS);
        let scales = &self.bank(state, bank).0.scales;
        let fit = fit(&knowledge, scales).unwrap_or(Fit::UNKNOWN);
        // Known for the recent memory only.
        let Fit { friction_in_curvature, curved, .. } = recent.told.fit;
        let fit = Fit { friction_in_curvature, curved, ..fit };
        let explained = self.explained(noise, &fit, scales, state.repeats());
        let motion = self.motion_of_all(state, found, recent, bank, &knowledge);
        let spread = self.scatter(&fit, scales, &motion).in_motion(&motion);
        let budgets = recent.assessment.widen(self.budgets_of(&fit, &spread, &motion));
        let force = || knowledge.mean_square(UNKNOWNS) * square(scales.force);
        let law = regime::law(&fit, &explained, noise.differences, found.contact, force);
        Told { fit, budgets, law }
    }

    /// The motion of the whole run as a bank has seen it; what is known for the recent memory only is taken from there.
    fn motion_of_all(
        &self,
        state: &State,
        found: &Backlash,
        recent: &Recent,
        bank: Bank,
        knowledge: &Knowledge,
    ) -> Motion {
        let scales = &self.bank(state, bank).0.scales;
        let acceleration = mean_square_acceleration(knowledge, scales);
        let [_, v, ..] = scales.units;
        let own = acceleration / (knowledge.mean_square(1) * square(v as f32));
        let within = Motion::within(&recent.band, state.repeats(), recent.told.fit.friction_in_curvature);
        Motion {
            // The band is known for the recent memory only.
            apart: apart(found.gap_m(), greater(own, within.frequency_squared), acceleration),
            acceleration_squared: acceleration,
            readings: self.readings(bank, knowledge.updates()),
            steady: state.steadiness(),
            reversals_again: state.reversals_again(),
            ..within
        }
    }

    /// Readings of the position in this many updates of a bank.
    fn readings(&self, bank: Bank, updates: f32) -> f32 {
        let spacing = match bank {
            Bank::Fast => self.fast.spacing,
            Bank::Slow => self.slow.spacing,
        };
        updates * spacing as f32 * self.settings.oversampling as f32
    }

    /// The fast bank if its acceleration is clear of the encoder's steps, or is `among` times them and the slow bank's
    /// kernel smooths nearly all of it away; else the slow bank.
    fn choose(&self, state: &State, knowledge: impl Fn(&BankState) -> Knowledge, among: f32) -> (Bank, Knowledge) {
        let fast = knowledge(&state.fast);
        let times = |least: f32| fast.mean_square(0) > least * self.fast.scales.quantisation;
        let seen = |knowledge: &Knowledge, scales: &Scales| {
            let unit = scales.units[0] as f32;
            knowledge.mean_square(0) * unit * unit
        };
        let smoothed = || seen(&knowledge(&state.slow), &self.slow.scales) < SMOOTHED * seen(&fast, &self.fast.scales);
        if times(CLEAR_OF_STEPS) || state.slow.whole.updates() == 0 || (times(among) && smoothed()) {
            (Bank::Fast, fast)
        } else {
            (Bank::Slow, knowledge(&state.slow))
        }
    }

    /// The feedback to the next samples: friction's kink at a reversal, the offset, and the limit of a weak force.
    fn feedback(&self, parameters: &Parameters, noise: &Heard, before: Feedback) -> Feedback {
        let Parameters { inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n } = *parameters;
        let codes = |newtons: f32| (newtons / self.signal.newtons_per_code) as i32;
        let mut feedback = before;
        // An offset near zero is as good a result as any other.
        let offset = offset_n.ok();
        let [inertance, viscous, coulomb] = [inertance_kg, viscous_n_s_per_m, coulomb_n]
            .map(|parameter| parameter.ok().filter(|found| found.u95 < WIDEST_INTERVAL * magnitude(found.value)));
        let Some(coulomb) = coulomb else { return feedback };
        if let Some(inertance) = inertance {
            let (kink, per_force, per_viscous) = self.sign_effects;
            let viscous_term = |viscous: Interval| term(per_viscous * f64::from(viscous.value));
            feedback.viscous = viscous.map(viscous_term).unwrap_or_default();
            let fraction = f64::from((1_u32 << VELOCITY_BITS) as f32 / inertance.value);
            feedback.kink = term(kink * fraction * f64::from(coulomb.value));
            // The load cell also feels the structure, which moves with the screw.
            let structure = self.settings.structure_mass_kg as f32 / inertance.value;
            feedback.velocity_per_force = term(per_force * fraction / f64::from(1.0 + structure));
        }
        if let Some(offset) = offset {
            feedback.offset_code = codes(offset.value);
            feedback.friction_known = coulomb.u95 < FRICTION_KNOWN * coulomb.value;
            let weak = codes(3.0 * coulomb.value).max(0);
            feedback.weak_force_code = weak as u32;
            feedback.jumps_are_clear = square(weak as f32) > NOISE_OF_JUMP * noise.variance;
        }
        feedback
    }

    /// What scatters in a fit.
    fn scatter(&self, fit: &Fit, scales: &Scales, motion: &Motion) -> Scatter {
        let [inertance, ..] = fit.values;
        if fit.is_exact {
            return Scatter::white(inertance, fit.freedom());
        }
        let steps = self.steps_variance(inertance, scales);
        let share = if steps < fit.variance { steps / fit.variance } else { 1.0 };
        let [_, _, coulomb, _] = fit.values;
        let places = self.systematic.places(
            [inertance, coulomb],
            fit.inertance_error,
            fit.variance,
            scales.box_squared,
            motion.acceleration_squared,
        );
        Scatter {
            inertance_kg: inertance,
            freedom: fit.freedom(),
            steps_share: [share, share * scales.quantisation_kept],
            frequency_squared: fit.frequency_squared,
            places,
        }
    }

    /// The budgets: the scatter, and what averaging does not remove.
    fn budgets_of(&self, fit: &Fit, spread: &Spread, motion: &Motion) -> [Budget; UNKNOWNS] {
        let found = |i: usize| Found {
            value: fit.values[i],
            error: fit.errors[i],
            per_skew: fit.per_skew[i],
            steps: fit.steps[i],
        };
        let systematic = &self.systematic;
        [
            systematic.inertance(&found(0), spread, motion),
            systematic.viscous(&found(1), spread, motion),
            systematic.coulomb(&found(2), spread, motion),
            systematic.offset(&found(3), spread),
        ]
    }

    fn parameters(&self, fit: &Fit, budgets: &[Budget; UNKNOWNS]) -> Parameters {
        let [inertance, viscous, coulomb, offset] = fit.values;
        let without_structure = inertance - self.settings.structure_mass_kg as f32;
        let mut values = [without_structure, viscous, coulomb, offset].into_iter().zip(budgets);
        let mut next = || {
            let (value, budget) = values.next()?;
            Some(Parameter::new(Interval { value, u95: budget.u95() }, Status::Ok))
        };
        let mut next = || next().unwrap_or_default();
        Parameters { inertance_kg: next(), viscous_n_s_per_m: next(), coulomb_n: next(), offset_n: next() }
    }
}

impl Told {
    /// The budgets, including how far what breaks the law may have moved each parameter.
    fn all_budgets(&self) -> [Budget; UNKNOWNS] {
        self.broken_by().unwrap_or(self.budgets)
    }

    /// The same; `None` if the law is not broken.
    fn broken_by(&self) -> Option<[Budget; UNKNOWNS]> {
        let reach = regime::reach(&self.law, &self.fit);
        let with = |(budget, error): (&Budget, f32)| budget.and(Source::Model, reach * error);
        let mut all = self.budgets.iter().zip(self.fit.errors).map(with);
        (reach > 0.0).then(|| core::array::from_fn(|_| all.next().unwrap_or(Budget::UNKNOWN)))
    }
}

impl State {
    /// How often each stroke of the motion has come, sample by sample, on average over all strokes: 1 if none recurred.
    /// The variance of what the strokes share is this many times what it would be.
    pub fn repeats(&self) -> f32 {
        let (strokes, squares) = self.repeats.strokes_and_squares();
        if strokes == 0 { 1.0 } else { squares as f32 / strokes as f32 }
    }

    /// Number of reversals, each weighted by how often its stroke has recurred.
    fn reversals_again(&self) -> f32 {
        let (strokes, squares) = self.repeats.strokes_and_squares();
        (squares - u64::from(strokes)) as f32
    }

    /// Fraction of the strokes that were as long as the one before.
    fn steadiness(&self) -> f32 {
        let (strokes, _) = self.repeats.strokes_and_squares();
        self.repeats.steady() as f32 / strokes.max(1) as f32
    }
}

/// Mean square of the acceleration less that of the encoder's steps [m^2/s^4].
fn mean_square_acceleration(knowledge: &Knowledge, scales: &Scales) -> f32 {
    (knowledge.mean_square(0) - scales.quantisation) * square(scales.units[0] as f32)
}

/// Frequencies at which a motion with these mean squares of velocity, acceleration and jerk showed the inertance.
fn band(velocity: f32, acceleration: f32, jerk: f32) -> Band {
    if acceleration <= 0.0 || velocity <= 0.0 {
        return Band::default();
    }
    let low_hz = sqrt(acceleration / velocity) / core::f32::consts::TAU;
    // Where the encoder's steps drown the third derivative, what is left of it may be less than any motion's.
    let high_hz = sqrt(jerk / acceleration) / core::f32::consts::TAU;
    Band { low_hz, high_hz: if high_hz > low_hz { high_hz } else { low_hz } }
}

/// The force's noise [codes, rms] from a quantile of its differences; `None` if it is unknown.
fn noise_by(noise: &Noise, quarters: u32, per_rms: f32) -> Option<f32> {
    noise.quantile(quarters).map(|quantile| quantile as f32 / (per_rms * (1 << Noise::FRACTION) as f32))
}

impl State {
    /// How much of the kink that Coulomb friction would cause in the velocity the reversals have shown: 1 is all of it,
    /// less where friction reverses over a presliding distance. `None` before the first reversal under known friction.
    fn reversal_ratio(&self) -> Option<f32> {
        let (seen, predicted) = self.velocity_reversals.seen_and_predicted()?;
        Some(seen as f32 / predicted as f32)
    }
}

impl Parameters {
    /// Whether the inertance is negative beyond its interval, whatever its status.
    pub(crate) fn are_backwards(&self) -> bool {
        let Interval { value, u95 } = self.inertance_kg.fitted();
        value + u95 < 0.0
    }

    fn each(&mut self) -> [&mut Parameter; UNKNOWNS] {
        [&mut self.inertance_kg, &mut self.viscous_n_s_per_m, &mut self.coulomb_n, &mut self.offset_n]
    }

    /// Withholds every value: none of them can be trusted.
    fn refuse(&mut self) {
        for parameter in self.each() {
            *parameter = Parameter::new(parameter.fitted(), Status::NotIdentifiable);
        }
    }

    /// Withholds each value whose interval is more than half of it.
    fn refuse_what_is_wide(&mut self) {
        for parameter in self.each() {
            let Interval { value, u95 } = parameter.fitted();
            if u95 > WIDEST_INTERVAL * magnitude(value) {
                *parameter = Parameter::new(parameter.fitted(), Status::NotIdentifiable);
            }
        }
    }

    fn hold(&mut self) {
        for parameter in self.each() {
            if let Parameter::Ok(interval) = *parameter {
                *parameter = Parameter::Held(interval);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::boxed::Box;

    use super::*;
    use crate::detail::Misfit;
    use crate::rls::{PRODUCTS, place};
    use crate::sample::RawSample;
    use crate::settings::Settings;
    use inerter_needs::Random;

    fn ok(value: f32, u95: f32) -> Parameter {
        Parameter::Ok(Interval { value, u95 })
    }

    fn factor(term: Term) -> f64 {
        f64::from(term.coefficient) * 2_f64.powi(-32 - i32::from(term.shift))
    }

    #[track_caller]
    fn is_near(found: f64, wanted: f64, part: f64) {
        assert!((found - wanted).abs() <= part * wanted.abs(), "{found} for {wanted}");
    }

    /// Fourth differences of 384 codes, except for this many of ten, which are 0.
    fn noise(zeros: u32) -> Noise {
        let mut noise = Noise::new();
        (0..1000_u32).for_each(|n| noise.push(if n % 10 < zeros { [5; 5] } else { [0, 0, 64, 0, 0] }));
        noise
    }

    /// By hand: 384 lies in the octave from 255.5 to 511.5 codes, where a quarter of the differences ends at 319.5.
    #[test]
    fn noise_is_the_least_quartile_that_is_clear_of_rounding() {
        let variance = |noise: &Noise| f64::from(Heard::of(noise).variance);
        assert_eq!(variance(&Noise::new()), f64::INFINITY);
        is_near(variance(&noise(0)), (319.5_f64 / 2.666).powi(2), 1e-3);
        // Rounding to codes is a noise of its own.
        is_near(variance(&noise(10)), 1.0 / 12.0, 1e-6);
        let active = Settings::default().validate().unwrap();
        let beside = |noise: &Noise| active.noise_beside_clipped(noise).map(f64::from);
        is_near(beside(&noise(0)).unwrap(), 319.5 / 2.666, 1e-3);
        // Of ten differences three are 0: half of all end after two of the other seven.
        is_near(beside(&noise(3)).unwrap(), (255.5 + 256.0 * 2.0 / 7.0) / 5.643, 0.01);
        // Of ten differences six are 0: three quarters of all end after one and a half of the other four.
        is_near(beside(&noise(6)).unwrap(), (255.5 + 256.0 * 1.5 / 4.0) / 9.624, 0.01);
        assert_eq!(beside(&noise(10)), None);
        // Differences of 2 lie from 1.5 to 3.5: a quarter ends at 2, to 1/256, which is a noise of 0.75. Those
        // of 1 are rounding.
        let mut two = Noise::new();
        (0..100).for_each(|_| two.push([1, 0, 0, 0, 1]));
        is_near(beside(&two).unwrap(), 2.0 / 2.666, 0.003);
        let mut one = Noise::new();
        (0..100).for_each(|_| one.push([1, 0, 0, 0, 0]));
        assert_eq!(beside(&one), None);
    }

    /// A force of one code on 300 kg, doubled, for 1 ms at 409600 counts a metre.
    #[test]
    fn a_position_bends_by_the_force_over_an_inertance_that_is_known() {
        let active = Settings::default().validate().unwrap();
        let bend = |inertance_kg| active.bend(&Parameters { inertance_kg, ..Parameters::default() });
        let (steps, per_code) = bend(ok(300.0, 149.0)).unwrap();
        assert_eq!(steps, 3);
        is_near(factor(per_code), 2.0 * 0.002 * 409_600.0 * 1e-6 / 300.0, 1e-6);
        assert_eq!(bend(ok(300.0, 151.0)), None);
        assert_eq!(bend(ok(-300.0, 1.0)), None);
        assert_eq!(bend(Parameter::default()), None);
        // Whether the law holds or not.
        let refused = Parameter::new(Interval { value: 300.0, u95: 1.0 }, Status::NotIdentifiable);
        assert!(bend(refused).is_some());
    }

    #[test]
    fn readings_are_counts_in_all_samples_of_the_updates() {
        let active = Settings { oversampling: 4.0, ..Settings::default() }.validate().unwrap();
        // 8 and 32 ms from update to update.
        assert_eq!([Bank::Fast, Bank::Slow].map(|bank| active.readings(bank, 10.0)), [320.0, 1280.0]);
    }

    /// For an acceleration with so many times the mean square of the fast bank's steps, of which the slow bank sees
    /// this part.
    fn chosen(times: f64, part: f64, among: f32, slow_updates: u32) -> Bank {
        // At 1.1 kHz, the units of the banks differ.
        let active = Settings { sample_rate_hz: 1100.0, ..Settings::default() }.validate().unwrap();
        let mut state = Box::new(State::new(&active));
        (0..slow_updates).for_each(|_| state.slow.whole.update(&[0; PRODUCTS]));
        let fast = &active.fast.scales;
        let square_si = times * f64::from(fast.quantisation) * fast.units[0] * fast.units[0];
        let knowledge = |bank: &BankState| {
            let (scales, seen) =
                if core::ptr::eq(bank, &state.slow) { (&active.slow.scales, part) } else { (fast, 1.0) };
            let mut sums = [0_i128; PRODUCTS];
            sums[place(0, 0)] = (1000.0 * seen * square_si / (scales.units[0] * scales.units[0])) as i128;
            Knowledge::between(&[0; PRODUCTS], &sums, 1000)
        };
        active.choose(&state, knowledge, among).0
    }

    #[test]
    fn the_fast_bank_is_published_where_its_steps_are_small() {
        for (times, part, among, bank) in [
            (2100.0, 0.5, CLEAR_OF_STEPS, Bank::Fast),
            (1900.0, 0.05, CLEAR_OF_STEPS, Bank::Slow),
            (2100.0, 0.5, AMONG_STEPS, Bank::Fast),
            // Or small enough, where the slow one smooths nearly all away.
            (1900.0, 0.09, AMONG_STEPS, Bank::Fast),
            (1900.0, 0.11, AMONG_STEPS, Bank::Slow),
            (550.0, 0.09, AMONG_STEPS, Bank::Fast),
            (450.0, 0.09, AMONG_STEPS, Bank::Slow),
        ] {
            assert_eq!(chosen(times, part, among, 1), bank, "{times} {part} {among}");
            assert_eq!(chosen(times, part, among, 0), Bank::Fast, "{times} {part} {among}");
        }
    }

    /// By hand, for 300 kg with 30 kg of structure, 30 N s/m, 50 N and 3 N, in codes of 1/512 N: a newton on a kilogram
    /// moves the encoder by 0.4096 counts in a sample more.
    #[test]
    fn friction_is_fed_back_in_counts_and_codes() {
        let settings = Settings { newtons_per_code: 1.0 / 512.0, structure_mass_kg: 30.0, ..Settings::default() };
        let active = settings.validate().unwrap();
        let before = Feedback {
            offset_code: 7,
            weak_force_code: 9,
            viscous: Term { coefficient: 1, shift: 0 },
            ..Feedback::NONE
        };
        let (inertance, viscous, coulomb, offset) = (ok(300.0, 1.0), ok(30.0, 1.0), ok(50.0, 4.9), ok(3.0, 9.0));
        let fed_back = |[inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n]: [Parameter; 4], variance: f32| {
            let parameters = Parameters { inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n };
            active.feedback(&parameters, &Heard { variance, differences: 0 }, before)
        };
        // Thrice the friction, 76800 codes, is clear of four standard deviations of the jump up to 76800^2 / 320.
        let all = fed_back([inertance, viscous, coulomb, offset], 1.84e7);
        is_near(factor(all.kink), 256.0 * 0.4096 / 3.0 * 50.0 / 300.0, 1e-5);
        is_near(factor(all.velocity_per_force), 256.0 * 0.4096 / 512.0 / 330.0, 1e-5);
        // A count in a millisecond is 1/409.6 m/s.
        is_near(factor(all.viscous), 30.0 / 409.6 * 512.0, 1e-5);
        assert_eq!((all.offset_code, all.weak_force_code), (1536, 76_800));
        assert!(all.friction_known && all.jumps_are_clear);
        assert!(!fed_back([inertance, viscous, coulomb, offset], 1.85e7).jumps_are_clear);
        assert!(!fed_back([inertance, viscous, ok(50.0, 5.1), offset], 1e7).friction_known);
        // Without friction nothing is fed back; without another parameter, only what does not need it.
        for coulomb in [ok(50.0, 25.1), Parameter::Held(Interval { value: 50.0, u95: 1.0 }), Parameter::default()] {
            let none = fed_back([inertance, viscous, coulomb, offset], 1e7);
            assert_eq!((none.offset_code, none.weak_force_code, none.viscous), (7, 9, before.viscous));
            assert_eq!((none.kink, none.velocity_per_force), (Term::default(), Term::default()));
        }
        let unknown = fed_back([ok(300.0, 151.0), viscous, coulomb, offset], 1e7);
        assert_eq!((unknown.kink, unknown.offset_code), (Term::default(), 1536));
        let smooth = fed_back([inertance, ok(30.0, 15.1), coulomb, offset], 1e7);
        assert_eq!((smooth.kink, smooth.viscous), (all.kink, Term::default()));
        let drifts = fed_back([inertance, viscous, coulomb, Parameter::default()], 1e7);
        assert_eq!((drifts.kink, drifts.offset_code, drifts.weak_force_code), (all.kink, 7, 9));
        // No force is below a negative friction.
        let negative = fed_back([inertance, viscous, ok(-50.0, 1.0), offset], 1e7);
        assert_eq!((negative.weak_force_code, negative.friction_known, negative.jumps_are_clear), (0, false, false));
    }

    /// At three times the residual that is explained, eight ninths of 450 observations may count 3.1 times: 62 standard
    /// errors.
    #[test]
    fn what_breaks_the_law_widens_every_budget() {
        let errors = [0.1, 2.0, 0.5, 0.05];
        let of = |status| {
            let fit = Fit { values: [300.0, 30.0, 50.0, 3.0], errors, variance: 9.0, observations: 450.0, ..Fit::NONE };
            let law = Law { status, misfit: Some(Misfit { ratio: 3.0, limit: 1.4 }), ..Law::default() };
            Told { fit, budgets: errors.map(|error| Budget::of_scatter(error, 446.0)), law }
        };
        for status in [LawStatus::Holds, LawStatus::Unknown] {
            let told = of(status);
            assert!(told.broken_by().is_none());
            assert_eq!(told.all_budgets(), told.budgets);
        }
        let told = of(LawStatus::Broken);
        for ((after, before), error) in told.all_budgets().into_iter().zip(told.budgets).zip(errors) {
            let wanted = f64::from(before.u95()).hypot(62.0 * f64::from(error));
            is_near(f64::from(after.u95()), wanted, 5e-3);
        }
    }

    #[test]
    fn a_band_is_between_two_mean_frequencies() {
        use core::f32::consts::TAU;
        let near = |found: Band, wanted: [f32; 2]| {
            is_near(f64::from(found.low_hz), f64::from(wanted[0]), 1e-5);
            is_near(f64::from(found.high_hz), f64::from(wanted[1]), 1e-5);
        };
        near(band(0.25, 9.0, 5184.0), [6.0 / TAU, 24.0 / TAU]);
        // Steps may leave less of the third derivative than any motion has.
        near(band(0.25, 9.0, 100.0), [6.0 / TAU, 6.0 / TAU]);
        for (velocity, acceleration) in [(0.0, 1.0), (-1.0, 1.0), (1.0, 0.0), (1.0, -1.0)] {
            assert_eq!(band(velocity, acceleration, 1.0), Band::default());
        }
    }

    #[test]
    fn parameters_are_withheld_as_their_intervals_demand() {
        for (value, u95, backwards) in [(-300.0, 299.0, true), (-300.0, 301.0, false), (300.0, 1.0, false)] {
            for status in [Status::Ok, Status::NotIdentifiable] {
                let inertance_kg = Parameter::new(Interval { value, u95 }, status);
                assert_eq!(Parameters { inertance_kg, ..Parameters::default() }.are_backwards(), backwards);
            }
        }
        assert!(!Parameters::default().are_backwards());
        let statuses = |parameters: &Parameters| {
            let Parameters { inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n } = parameters;
            [inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n].map(|parameter| parameter.status())
        };
        let all = Parameters {
            inertance_kg: ok(10.0, 5.0),
            viscous_n_s_per_m: ok(-10.0, 4.9),
            coulomb_n: ok(-10.0, 5.1),
            offset_n: ok(10.0, 5.1),
        };
        let mut wide = all;
        wide.refuse_what_is_wide();
        let none = Status::NotIdentifiable;
        assert_eq!(statuses(&wide), [Status::Ok, Status::Ok, none, none]);
        assert_eq!(wide.coulomb_n.fitted(), all.coulomb_n.fitted());
        let mut held = wide;
        held.hold();
        assert_eq!(statuses(&held), [Status::Held, Status::Held, none, none]);
        let mut refused = held;
        refused.refuse();
        assert_eq!(statuses(&refused), [none; 4]);
        assert_eq!(refused.inertance_kg.fitted(), all.inertance_kg.fitted());
    }

    /// After a restart, values come again once the law is judged; at rest, those of the recent memory are held.
    #[test]
    fn values_wait_for_the_law_after_a_restart_and_are_held_at_rest() {
        let active = Settings::default().validate().unwrap();
        let mut state = Box::new(State::new(&active));
        let mut random = Random(3);
        // 300 kg and 50 N, moved by 3000 counts at 5 Hz, with 1 N of noise.
        let amplitude_m = 3000.0 * 2.44140625e-6;
        let mut advance = |state: &mut State, until: u32| {
            for index in state.counters().samples as u32..until {
                let (sine, cosine) = (core::f64::consts::TAU * f64::from(index) / 200.0).sin_cos();
                let acceleration = -amplitude_m * (core::f64::consts::TAU * 5.0).powi(2) * sine;
                let force_n = 300.0 * acceleration + 50.0 * cosine.signum() + random.normal();
                let (position_count, force_code) = ((3000.0 * sine).round() as i32, (force_n / 0.002).round() as i32);
                active.step(state, &RawSample { index, position_count, force_code, terminal_code: 0 });
            }
        };
        let inertances = |published: &Published| {
            let Estimate { recent, whole_run, .. } = published.estimate;
            [recent, whole_run].map(|parameters| parameters.inertance_kg)
        };
        // Some 50 updates are 12 observations: enough for a fit, too few for a verdict.
        advance(&mut state, 500);
        let ahead = active.publish(&state);
        assert_eq!(ahead.law.misfit, None);
        assert_eq!(inertances(&ahead).map(|inertance| inertance.status()), [Status::Ok; 2]);
        state.trial = Trial::Open;
        let open = active.publish(&state);
        assert_eq!(inertances(&open).map(|inertance| inertance.status()), [Status::NotIdentifiable; 2]);
        assert_eq!(inertances(&open).map(|inertance| inertance.fitted()), inertances(&ahead).map(|one| one.fitted()));
        // Judged, it is trusted.
        state.trial = Trial::Ahead;
        advance(&mut state, 1500);
        state.trial = Trial::Open;
        let judged = active.publish(&state);
        assert!(judged.law.misfit.is_some());
        assert_eq!(inertances(&judged).map(|inertance| inertance.status()), [Status::Ok; 2]);
        for inertance in inertances(&judged) {
            is_near(f64::from(inertance.fitted().value), 300.0, 0.01);
        }
        // 24 boxes of 16 ms without an update are rest; the whole run is not held.
        for (idle_samples, status) in [(383, Status::Ok), (384, Status::Held)] {
            state.fast.idle_samples = idle_samples;
            let published = active.publish(&state);
            assert_eq!(inertances(&published).map(|inertance| inertance.status()), [status, Status::Ok]);
            assert_eq!(published.estimate.moving, status == Status::Ok);
        }
    }
}
