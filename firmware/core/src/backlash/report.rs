//! The backlash in SI, with its interval or the reason there is none.

use crate::backlash::active::BacklashActive;
use crate::backlash::law::{Freed, Solved};
use crate::backlash::pool::Sums;
use crate::backlash::state::BacklashState;
use crate::backlash::terminal::ONE;
use crate::budget::{Budget, ContactBudgets, Source};
use crate::detail::{Backlash, BacklashSize, Contact, Reason, Route};
use crate::estimate::{Interval, Parameter};
use crate::ldl::UNKNOWNS;
use crate::math::{greater, single_of_wide, sqrt, square};
use crate::rls::place;

/// Fewest reversals from which a scatter is estimated.
const FEWEST: u32 = 5;
/// The same, in reversals of equal weight.
const LEAST_EQUAL: f32 = 3.0;
/// Fraction of an encoder count that remains however many reversals there are: the encoder's steps along a flank are
/// not white.
const COUNT_PART: f32 = 0.4;
/// Errors by one pattern of the encoder's steps, in counts: of the backlash with the sensor, where whole flanks are
/// averaged; of what correlates with the stretch; of what correlates with its rate.
const SENSED_COUNT_PART: f32 = 0.3;
const STIFFNESS_COUNT_PART: f32 = 0.07;
const DAMPING_COUNT_PART: f32 = 0.07;
/// Relative half width for taking the stretch's rate from a block's ends: twice the error at 16 Hz and 1 kHz, 0.25 %.
const DAMPING_MODEL_U95: f32 = 0.005;
/// Greatest number of patterns of the encoder's steps that flanks are assumed to have, with the sensor.
const PATTERNS: f32 = 8.0;
/// Ratio of the reversals' variance to that of their flanks' own noise above which they contradict each other.
const CONTRADICTION: f32 = 25.0;

/// Half widths by which a value may lie below zero by chance: without backlash, one in 2000 lies further away. To
/// refuse every interval below zero would hide those that miss, and the flanks of a sound device would count as ones
/// that may part.
const BY_CHANCE: f32 = 1.7;

/// What is published of the contact.
pub(crate) struct Found {
    pub backlash: Backlash,
    /// How the flanks behave.
    pub contact: Contact,
    /// Stiffness \[N/m\] and damping \[N s/m\] by the terminal's sensor.
    pub stiffness: Parameter,
    pub damping: Parameter,
}

impl Found {
    /// Gap that the flanks cross \[m\], as [`Contact::gap_m`].
    pub fn gap_m(&self) -> f32 {
        self.contact.gap_m(&self.backlash)
    }
}

/// A value and its budget.
type Budgeted = (f32, Budget);

impl BacklashActive {
    /// Backlash and contact as they stand; `repeats` is how often each stroke has come, sample by sample.
    pub fn found(&self, state: &BacklashState, repeats: f32) -> Found {
        let by_force = match self.unable() {
            Some(reason) => Backlash::none(reason, Route::Force, 0),
            None => {
                let sums = state.pool.sums();
                Backlash::of(self.by_force(state, &sums, repeats).as_ref(), Route::Force, sums.accepted)
            }
        };
        if !self.terminal.present {
            let contact = state.contact(self, &by_force);
            return Found {
                backlash: by_force,
                contact,
                stiffness: Parameter::default(),
                damping: Parameter::default(),
            };
        }
        let sensed = self.by_terminal(state, repeats);
        let by_terminal = sensed.as_ref().map(|sensed| &sensed.backlash);
        let by_terminal = Backlash::of(by_terminal, Route::Terminal, state.counts.reversals);
        let narrower = match (by_force.known(), by_terminal.known()) {
            (_, None) => false,
            (None, Some(_)) => true,
            (Some(by_force), Some(by_terminal)) => by_terminal.u95 <= by_force.u95,
        };
        // Where the force alone cannot give a value, the sensor's own reason counts.
        let backlash = if narrower || !self.stiffness_known { by_terminal } else { by_force };
        Found {
            backlash,
            contact: state.contact(self, &backlash),
            stiffness: sensed.as_ref().map_or_else(|_| Parameter::default(), |sensed| parameter(&sensed.stiffness)),
            damping: sensed.ok().and_then(|sensed| sensed.damping).as_ref().map_or_else(Parameter::default, parameter),
        }
    }

    /// Budgets of the intervals of [`Self::found`].
    pub fn budgets(&self, state: &BacklashState, repeats: f32) -> ContactBudgets {
        let found = self.found(state, repeats);
        let sensed = if self.terminal.present { self.by_terminal(state, repeats).ok() } else { None };
        let of_backlash = match found.backlash.route {
            Route::Force if self.unable().is_none() => self.by_force(state, &state.pool.sums(), repeats).ok(),
            Route::Force => None,
            Route::Terminal => sensed.map(|sensed| sensed.backlash),
        };
        let told =
            |of: Option<Budgeted>, value: Option<Interval>| of.filter(|_| value.is_some()).map(|(_, budget)| budget);
        ContactBudgets {
            backlash_m: told(of_backlash, found.backlash.known()),
            stiffness_n_per_m: told(sensed.map(|sensed| sensed.stiffness), found.stiffness.known()),
            damping_n_s_per_m: told(sensed.and_then(|sensed| sensed.damping), found.damping.known()),
        }
    }
}

/// Refuses a value that no spring or damper has: one below zero by more than its interval.
fn parameter((value, budget): &Budgeted) -> Parameter {
    let interval = Interval { value: *value, u95: budget.u95() };
    if interval.u95.is_finite() && interval.value >= -interval.u95 {
        Parameter::Ok(interval)
    } else {
        Parameter::default()
    }
}

impl Backlash {
    fn none(reason: Reason, route: Route, reversals: u32) -> Self {
        Self { size: BacklashSize::NotIdentifiable(reason), route, reversals }
    }

    /// Refuses what is no backlash: an infinite interval, or a value further below zero than chance explains.
    fn of(found: Result<&Budgeted, &Reason>, route: Route, reversals: u32) -> Self {
        let (value, u95) = match found {
            Ok((value, budget)) => (*value, budget.u95()),
            Err(reason) => return Self::none(*reason, route, reversals),
        };
        if !(u95.is_finite() && value.is_finite()) || value < -BY_CHANCE * u95 {
            return Self::none(Reason::Scattered, route, reversals);
        }
        let interval = Interval { value, u95 };
        let size = if value > u95 { BacklashSize::Ok(interval) } else { BacklashSize::BelowU95(interval) };
        Self { size, route, reversals }
    }
}

impl BacklashState {
    fn contact(&self, active: &BacklashActive, backlash: &Backlash) -> Contact {
        let bouncing = self.counts.bouncing >= FEWEST && 2 * self.counts.bouncing > self.counts.reversals;
        match backlash.size {
            _ if self.one_sided(active) => Contact::OneSided,
            _ if bouncing => Contact::Bouncing,
            BacklashSize::Ok(_) => Contact::Backlash,
            BacklashSize::BelowU95(_) => Contact::Closed,
            BacklashSize::NotIdentifiable(_) => Contact::Unknown,
        }
    }
}

impl BacklashActive {
    /// Why the settings rule out the route by the force.
    fn unable(&self) -> Option<Reason> {
        match () {
            () if !self.stiffness_known => Some(Reason::StiffnessUnknown),
            () if !self.lag_fits => Some(Reason::FlankTooShort),
            () => None,
        }
    }

    /// Value \[m\] and its budget.
    fn by_force(&self, state: &BacklashState, sums: &Sums, repeats: f32) -> Result<Budgeted, Reason> {
        let counts = &state.counts;
        if sums.accepted < FEWEST {
            return Err(match () {
                () if state.one_sided(self) => Reason::ForceNeverReverses,
                () if counts.short >= FEWEST => Reason::FlankTooShort,
                () if counts.bouncing >= FEWEST || sums.rejected >= FEWEST => Reason::Scattered,
                () => Reason::TooFewReversals,
            });
        }
        let [weight, sums_of @ ..] = sums.weighted.map(single_of_wide);
        let [equal, from_origin, square, change, change_square, by_stretch, own_noise] =
            sums_of.map(|sum| sum / weight);
        let equal = weight / equal;
        let value = sums.origin as f32 + from_origin;
        let variance = greater(square - from_origin * from_origin, 0.0);
        if variance > CONTRADICTION * own_noise || 2 * sums.rejected > sums.accepted {
            return Err(Reason::Scattered);
        }
        if equal < LEAST_EQUAL {
            return Err(Reason::TooFewReversals);
        }
        // The change by the check has a scatter of its own, which is subtracted.
        let change_noise = greater(change_square - change * change, 0.0) / equal;
        let truncation = greater(change * change - change_noise, 0.0);
        // A periodic motion repeats the encoder's steps. Their error averages out only over strokes that have not
        // recurred.
        let share = (repeats - 1.0) / sums.accepted as f32;
        let pattern = own_noise * if share < 1.0 { share } else { 1.0 };
        let by_stretch = by_stretch * self.scales.stretch;
        let by_position = value - by_stretch;
        let budget = Budget::of_scatter(sqrt(variance / (equal - 1.0)), equal - 1.0)
            .and_variance(Source::Encoder, pattern)
            .and(Source::Encoder, COUNT_PART * self.count_units as f32)
            .and(Source::Model, sqrt(truncation))
            .and(Source::Stiffness, by_stretch * self.scales.stiffness_u95)
            .and(Source::Gain, by_stretch * self.scales.gain_u95)
            .and(Source::Lead, by_position * self.scales.lead_u95);
        Ok((value * self.unit_m, budget.times(self.unit_m)))
    }
}

/// Results of the sensor's route: backlash \[m\], stiffness \[N/m\] and, unless too noisy, damping \[N s/m\].
#[derive(Clone, Copy)]
struct Sensed {
    backlash: Budgeted,
    stiffness: Budgeted,
    damping: Option<Budgeted>,
}

impl BacklashActive {
    fn by_terminal(&self, state: &BacklashState, repeats: f32) -> Result<Sensed, Reason> {
        let terminal = &state.terminal;
        let blocks = terminal.totals.updates();
        let reversals = state.counts.reversals;
        let Freed { solved, noise, most, own_rate, own_stretch, damping_drowned } =
            self.solved(&state.terminal, state.flanks.noise)?;
        let block = self.scales.block;
        let [more_damping, more_stiffness, more_side, _] = Solved::of(terminal, most, false).unknowns;
        let [damping, stiffness, side, _] = solved.unknowns;
        let [Some(damping_error), Some(stiffness_error), Some(side_error), _] = solved.errors else {
            return Err(Reason::FlankTooShort);
        };
        let freedom = blocks as f32 - UNKNOWNS as f32;
        // A scale error between the two displacements is a false stretch.
        let lead = self.scales.lead_u95 * stiffness;
        let [false_damping, false_stiffness, false_side, _] =
            Solved::of(terminal, noise, true).unknowns.map(|unknown| lead * unknown);
        // So are the encoder's steps, over the regressor's own rms, as far as their patterns do not average out.
        let patterns = (reversals as f32).clamp(1.0, PATTERNS);
        let share = greater((repeats - 1.0) / reversals as f32, 1.0 / patterns);
        let count = sqrt(if share < 1.0 { share } else { 1.0 }) * self.count_units as f32;
        let by_count = |own: f32, part: f32| stiffness * block * part * count * sqrt(blocks as f32 / own);
        let stiffness_by_count = by_count(own_stretch, STIFFNESS_COUNT_PART);
        let gain = self.scales.gain_u95;
        let of_stiffness = Budget::of_scatter(stiffness_error, freedom)
            .and(Source::Encoder, stiffness_by_count)
            .and(Source::Model, more_stiffness - stiffness)
            .and(Source::Lead, false_stiffness)
            .and(Source::Gain, stiffness * gain);
        let of_damping = Budget::of_scatter(damping_error, freedom)
            .and(Source::Encoder, by_count(own_rate, DAMPING_COUNT_PART))
            .and(Source::Model, more_damping - damping)
            .and(Source::Lead, false_damping)
            .and(Source::Gain, damping * gain)
            .and(Source::Model, damping * DAMPING_MODEL_U95);

        let per_side = 2.0 * ONE as f32 / (stiffness * block);
        let backlash = -side * per_side;
        // A wrong stiffness moves each flank by its mean stretch.
        let mean = |row: usize, column: usize| {
            terminal.totals.sums().get(place(row, column)).map_or(0.0, |sum| single_of_wide(*sum) / blocks as f32)
        };
        let apart = (mean(2, 1) - mean(3, 1) * (mean(3, 2) / mean(3, 3))) / ONE as f32 - 0.5 * backlash * block;
        let scatter = square(per_side * side_error) + square(stiffness_error / stiffness * backlash);
        let of_backlash = Budget::of_scatter(sqrt(scatter), freedom)
            .and(Source::Model, per_side * (more_side - side))
            .and(Source::Encoder, 2.0 * apart / (block * stiffness) * stiffness_by_count)
            .and(Source::Encoder, SENSED_COUNT_PART * count)
            .and(Source::Lead, per_side * false_side);

        let stiffness_si = stiffness * self.scales.stiffness;
        let damping_si = damping * self.scales.damping + stiffness_si * self.scales.skew_s;
        let of_damping = of_damping.times(self.scales.damping);
        let of_damping = of_damping.and(Source::Skew, stiffness_si * self.scales.skew_u95_s);
        Ok(Sensed {
            backlash: (backlash * self.unit_m, of_backlash.times(self.unit_m)),
            stiffness: (stiffness_si, of_stiffness.times(self.scales.stiffness)),
            damping: (!damping_drowned).then_some((damping_si, of_damping)),
        })
    }
}
