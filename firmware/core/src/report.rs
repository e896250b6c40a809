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

    /// What the recent memory of the bank that is published knows, and how far its law can be trusted.
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
