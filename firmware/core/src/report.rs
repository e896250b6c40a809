//! From moments to values in SI with their intervals: the edge of the fixed-point world.
//!
//! Floats are allowed here, as everything is basic arithmetic that gives the same bits on every machine, and nothing
//! flows back but a few rounded integers (see [`Feedback`]).

use crate::active::{Active, Scales};
use crate::backlash::report::Found as Backlash;
use crate::bank::BankState;
use crate::constants;
use crate::detail::{Band, Contact, Detail, Friction, Law, LawStatus};
use crate::estimate::{Bank, Estimate, Interval, Parameter, Parameters, Status};
use crate::feedback::Feedback;
use crate::fit::{Fit, Knowledge, fit};
use crate::line::VELOCITY_BITS;
use crate::math::{magnitude, sqrt, term};
use crate::noise::Noise;
use crate::output::Published;
use crate::plausible;
use crate::qformat::Term;
use crate::regime::{self, Assessment};
use crate::state::{State, Trial};

// Single precision, as everything here.
const COVERAGE: f32 = constants::COVERAGE as f32;
const WIDEST_INTERVAL: f32 = constants::WIDEST_INTERVAL as f32;
const COULOMB_MODEL_U95: f32 = constants::COULOMB_MODEL_U95 as f32;
const SKEW_FACTOR: f32 = constants::SKEW_FACTOR as f32;
/// Acceleration's mean square over that of the encoder's steps above which the fast bank is used.
const CLEAR_OF_STEPS: f32 = 2000.0;
/// Quartile of the force's fourth differences, per rms of its noise: 0.3186 by normal noise, times the root of 70.
const QUARTILE: f32 = 2.666;
/// The same of the median and the upper quartile: 0.6745 and 1.1503 times the root of 70.
const QUARTILES: [(u32, f32); 3] = [(1, QUARTILE), (2, 5.643), (3, 9.624)];
/// Variance of the steps of the force [codes^2].
const STEPS: f32 = constants::ROUNDING as f32;
/// Part of Coulomb friction within which its interval must lie before reversals are placed by it.
const FRICTION_KNOWN: f32 = 0.1;

/// What the recent memory of the published bank says.
struct Recent {
    bank: Bank,
    knowledge: Knowledge,
    parameters: Parameters,
    fit: Fit,
    assessment: Assessment,
    residual_rms_n: f32,
    law: Law,
}

impl Active {
    /// The estimate and what goes with it as they stand, at any time.
    pub fn publish(&self, state: &State) -> Published {
        self.publish_and_feed_back(state).0
    }

    /// The same with what the next samples are told. That rests on the fit whether the law holds or not: what it takes away
    /// with friction that is nearly right is more than what it adds.
    pub(crate) fn publish_and_feed_back(&self, state: &State) -> (Published, Feedback) {
        let Backlash { backlash, contact, stiffness, damping } = self.backlash.found(&state.backlash);
        let recent = self.recent(state, contact);
        let band = self.band(state, &recent);
        let Recent { bank, knowledge: _, mut parameters, fit, assessment, residual_rms_n, law } = recent;
        let (config, bank_state) = self.bank(state, bank);
        let moving = bank_state.idle_samples < config.hold_samples && bank_state.recent.updates() > 0;
        if !moving {
            parameters.hold();
        }
        let feedback = self.feedback(&parameters, state.feedback);
        regime::withdraw(&law, &fit, &mut parameters);
        let suspected = state.trial == Trial::Open && law.misfit.is_none();
        let is_broken = suspected || parameters.are_backwards();
        let law = if is_broken { Law { status: LawStatus::Broken, ..law } } else { law };
        if is_broken {
            parameters.refuse();
        }
        let (whole_bank, whole) = self.choose(state, Knowledge::whole_run);
        let scales = &self.bank(state, whole_bank).0.scales;
        let (mut whole_run, whole_fit) = self.solve_for(&whole, scales);
        assessment.widen(&mut whole_run, WIDEST_INTERVAL);
        let explained = self.explained(&state.noise, &whole_fit, scales);
        let whole_law = regime::law(&whole_fit, explained, state.noise.differences(), contact);
        regime::withdraw(&whole_law, &whole_fit, &mut whole_run);
        if suspected || whole_run.are_backwards() {
            whole_run.refuse();
        }
        let index = state.last_index();
        let estimate = Estimate {
            index,
            elapsed_samples: state.counters().samples + state.counters().lost_samples,
            bank,
            moving,
            recent: parameters,
            whole_run,
            residual_rms_n,
            updates: bank_state.whole.updates(),
        };
        let detail = Detail {
            index,
            band,
            backlash,
            contact,
            stiffness_n_per_m: stiffness,
            contact_damping_n_s_per_m: damping,
            friction: Friction { reversal_ratio: state.reversal_ratio(), regime: assessment.regime },
            changes: state.watch.count,
        };
        (Published { estimate, detail, law: Law { index, ..law } }, feedback)
    }

    /// What bends the position: steps, and the force by the inertance, where that is known whether the law holds or not.
    pub(crate) fn bend(&self, parameters: &Parameters) -> Option<(u32, Term)> {
        let Interval { value, u95 } = parameters.inertance_kg.fitted();
        let (steps, per_code) = self.signal.bend;
        (u95 < WIDEST_INTERVAL * value).then(|| (steps, term(per_code / f64::from(value))))
    }

    /// The force's noise [codes, rms] between the samples that are clipped, if any are: they have none.
    pub(crate) fn noise_beside_clipped(&self, noise: &Noise) -> Option<f32> {
        let rms = |(quarters, per_rms)| noise_by(noise, quarters, per_rms);
        QUARTILES.into_iter().filter_map(rms).find(|rms| *rms >= plausible::LEAST_NOISE)
    }

    /// Variance of the residual that force noise and encoder steps explain [N^2]; infinite before they are known.
    fn explained(&self, noise: &Noise, fit: &Fit, scales: &Scales) -> f32 {
        let Some(rms) = noise_by(noise, 1, QUARTILE) else { return f32::INFINITY };
        // Steps that swallow the noise are noise of their own.
        let variance = if rms * rms > STEPS { rms * rms } else { STEPS };
        let [inertance, ..] = fit.values;
        let [acceleration, ..] = scales.units;
        let per_unit = inertance * acceleration as f32;
        variance * scales.noise + per_unit * per_unit * scales.quantisation
    }

    /// What the recent memory of the bank that is published knows, and how far its law can be trusted.
    fn recent(&self, state: &State, contact: Contact) -> Recent {
        let (bank, knowledge) = self.choose(state, Knowledge::recent);
        let (config, bank_state) = self.bank(state, bank);
        let (mut parameters, all) = self.solve_for(&knowledge, &config.scales);
        let away = fit(&Knowledge::away(bank_state), &config.scales);
        let [a, v, ..] = config.scales.units;
        let rms = [sqrt(knowledge.mean_square(0)) * a as f32, sqrt(knowledge.mean_square(1)) * v as f32];
        let away = away.unwrap_or(Fit::NONE);
        let explained = self.explained(&state.noise, &all, &config.scales);
        let assessment = Assessment::of(&all, &away, rms, parameters.viscous_n_s_per_m.fitted(), explained, contact);
        assessment.widen(&mut parameters, WIDEST_INTERVAL);
        let law = regime::law(&all, explained, state.noise.differences(), contact);
        Recent { bank, knowledge, parameters, fit: all, assessment, residual_rms_n: sqrt(all.variance), law }
    }

    /// Frequencies at which the recent memory of the bank that is published saw the inertance.
    fn band(&self, state: &State, recent: &Recent) -> Band {
        let (config, bank_state) = self.bank(state, recent.bank);
        let knowledge = &recent.knowledge;
        let scales = &config.scales;
        let [a, v, _, _, _] = scales.units.map(|unit| unit as f32);
        let mean_square = |averages: f32, steps: f32, unit: f32| (averages - steps) * unit * unit;
        let acceleration = mean_square(knowledge.mean_square(0), scales.quantisation, a);
        let jerk = mean_square(bank_state.jerk as f32, scales.jerk_quantisation, scales.jerk);
        let velocity = mean_square(knowledge.mean_square(1), 0.0, v);
        if acceleration <= 0.0 || velocity <= 0.0 {
            return Band::default();
        }
        let low_hz = sqrt(acceleration / velocity) / core::f32::consts::TAU;
        // Where the encoder's steps drown the third derivative, its remainder may be less than any motion's.
        let high_hz = sqrt(jerk / acceleration) / core::f32::consts::TAU;
        Band { low_hz, high_hz: if high_hz > low_hz { high_hz } else { low_hz } }
    }

    /// The fast bank when its acceleration stands clear of the encoder's steps, else the slow one.
    fn choose(&self, state: &State, knowledge: impl Fn(&BankState) -> Knowledge) -> (Bank, Knowledge) {
        let fast = knowledge(&state.fast);
        if fast.mean_square(0) > CLEAR_OF_STEPS * self.fast.scales.quantisation || state.slow.whole.updates() == 0 {
            (Bank::Fast, fast)
        } else {
            (Bank::Slow, knowledge(&state.slow))
        }
    }

    /// What the next samples are told: friction's kink at a reversal, the offset, and what a weak force is.
    fn feedback(&self, parameters: &Parameters, before: Feedback) -> Feedback {
        let Parameters { inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n } = *parameters;
        let codes = |newtons: f32| (newtons / self.signal.newtons_per_code) as i32;
        let mut feedback = before;
        let [inertance, viscous, coulomb, offset] =
            [inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n].map(|parameter| parameter.ok());
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
            feedback.weak_force_code = codes(3.0 * coulomb.value).max(0) as u32;
        }
        feedback
    }

    fn solve_for(&self, knowledge: &Knowledge, scales: &Scales) -> (Parameters, Fit) {
        match fit(knowledge, scales) {
            Some(fit) => (self.with_systematic(&fit, knowledge, scales), fit),
            None => (Parameters::default(), Fit::NONE),
        }
    }

    /// Adds what no averaging removes, and gives each parameter its interval.
    fn with_systematic(&self, fit: &Fit, knowledge: &Knowledge, scales: &Scales) -> Parameters {
        let systematic = &self.systematic;
        let found = |i: usize| Found { value: fit.values[i], error: fit.errors[i] };
        let [inertance, viscous, coulomb, offset] = [found(0), found(1), found(2), found(3)];
        let square = |value: f32| value * value;
        // Divisions by zero give what nothing is known of: an infinite interval.
        let acceleration = knowledge.mean_square(0);
        let velocity = knowledge.mean_square(1);
        let per_skew = SKEW_FACTOR * inertance.value * (acceleration / velocity) * scales.rate_squared;
        let steps = inertance.value * (scales.quantisation / acceleration);
        let without_structure = inertance.value - self.settings.structure_mass_kg as f32;
        let relative = |found: &Found, part: f32| square(found.value) * part;
        let inertance_u95 =
            inertance.u95(relative(&inertance, systematic.inertance) + systematic.structure_mass + square(steps));
        let viscous_u95 = viscous.u95(relative(&viscous, systematic.viscous) + square(per_skew * systematic.skew_s));
        let coulomb_u95 = coulomb.u95(relative(&coulomb, systematic.force + square(COULOMB_MODEL_U95)));
        let offset_u95 = offset.u95(relative(&offset, systematic.force));
        Parameters {
            inertance_kg: parameter(without_structure, inertance_u95, true),
            viscous_n_s_per_m: parameter(viscous.value, viscous_u95, true),
            coulomb_n: parameter(coulomb.value, coulomb_u95, true),
            // An offset near zero is as good a finding as any other.
            offset_n: parameter(offset.value, offset_u95, false),
        }
    }
}

/// The force's noise [codes, rms] by a quantile of its differences, where it is known.
fn noise_by(noise: &Noise, quarters: u32, per_rms: f32) -> Option<f32> {
    noise.quantile(quarters).map(|quantile| quantile as f32 / (per_rms * (1 << Noise::FRACTION) as f32))
}

impl State {
    /// How much of the kink that Coulomb friction would give the velocity the reversals have shown: 1 is all of it,
    /// less where friction turns over a presliding distance. Nothing before the first reversal under known friction.
    fn reversal_ratio(&self) -> Option<f32> {
        let (seen, predicted) = self.velocity_reversals.seen_and_predicted()?;
        Some(seen as f32 / predicted as f32)
    }
}

/// One unknown in SI with its standard error; infinite where the motion cannot show it.
struct Found {
    value: f32,
    error: f32,
}

impl Found {
    /// Half width of the 95 % interval with the square of what no averaging removes.
    fn u95(&self, systematic_squared: f32) -> f32 {
        let random = COVERAGE * self.error;
        sqrt(random * random + systematic_squared)
    }
}

/// With `relative`, refuses what is known to less than the widest interval.
fn parameter(value: f32, u95: f32, relative: bool) -> Parameter {
    let too_wide = relative && u95 > WIDEST_INTERVAL * magnitude(value);
    Parameter::new(Interval { value, u95 }, if too_wide { Status::NotIdentifiable } else { Status::Ok })
}

impl Parameters {
    /// Whether the inertance is negative beyond its interval, whatever its status.
    pub(crate) fn are_backwards(&self) -> bool {
        let Interval { value, u95 } = self.inertance_kg.fitted();
        value < 0.0 && u95 < -WIDEST_INTERVAL * value
    }

    /// Nothing of it is true, or may be.
    fn refuse(&mut self) {
        for parameter in [&mut self.inertance_kg, &mut self.viscous_n_s_per_m, &mut self.coulomb_n, &mut self.offset_n]
        {
            *parameter = Parameter::new(parameter.fitted(), Status::NotIdentifiable);
        }
    }

    fn hold(&mut self) {
        for parameter in [&mut self.inertance_kg, &mut self.viscous_n_s_per_m, &mut self.coulomb_n, &mut self.offset_n]
        {
            if let Parameter::Ok(interval) = *parameter {
                *parameter = Parameter::Held(interval);
            }
        }
    }
}
