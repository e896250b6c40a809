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
            .and(Source::Lead, per_side * false_side + backlash * (false_stiffness / stiffness));

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backlash::law::tests::{blocks, forces, reckoned, seen};
    use crate::settings::Settings;
    use std::vec::Vec;

    fn active(stiffness_n_per_m: f64, contact_damping_n_s_per_m: f64) -> BacklashActive {
        let settings = Settings { stiffness_n_per_m, contact_damping_n_s_per_m, ..Settings::default() };
        settings.validate().unwrap().backlash
    }

    /// So many reversals, half of them so far above and half so far below what they have in common; each by its own
    /// noise.
    fn sums(accepted: u32, apart: i128, own_noise: i128) -> Sums {
        const WEIGHT: i128 = 3000;
        let each = [1, WEIGHT, 0, apart * apart, 0, 0, 0, own_noise];
        let weighted = each.map(|each| WEIGHT * each * i128::from(accepted));
        Sums { accepted, rejected: 0, origin: 5000, weighted }
    }

    fn reason(found: Result<Budgeted, Reason>) -> Option<Reason> {
        found.err()
    }

    #[test]
    fn reversals_that_contradict_each_other_tell_nothing() {
        let active = active(2e6, 1200.0);
        let state = BacklashState::new();
        let of = |sums: Sums| reason(active.by_force(&state, &sums, 1.0));
        // Five standard deviations are 25 variances.
        for (apart, own_noise, scattered) in [
            (49, 100, false),
            (50, 100, false),
            (51, 100, true),
            (4, 1, false),
            (6, 1, true),
            (0, 100, false),
            (499, 10_000, false),
        ] {
            let wanted = scattered.then_some(Reason::Scattered);
            assert_eq!(of(sums(20, apart, own_noise)), wanted, "{apart} {own_noise}");
            // Where reversals are told from the others, half as many.
            for (rejected, contradict) in [(0, false), (9, false), (10, false), (11, true), (300, true)] {
                let sums = Sums { rejected, ..sums(20, apart, own_noise) };
                let wanted = (scattered || contradict).then_some(Reason::Scattered);
                assert_eq!(of(sums), wanted, "{apart} {own_noise} {rejected}");
            }
        }
        // One reversal that outweighs the others is one.
        let mut uneven = sums(20, 10, 100);
        for (equal, wanted) in [(10, None), (4, None), (3, None), (2, Some(Reason::TooFewReversals))] {
            uneven.weighted[1] = uneven.weighted[0] * uneven.weighted[0] / equal;
            assert_eq!(of(uneven), wanted, "{equal}");
        }
    }

    /// Scatter over the number of reversals, 0.4 of a count, and half of the check's own change, by hand.
    #[test]
    fn a_backlash_by_the_force_is_the_mean_with_its_budget() {
        let active = active(2e6, 1200.0);
        let mut sums = sums(26, 30, 400);
        let [weight, .., change, change_square, by_stretch, _] = &mut sums.weighted;
        // Changes of 40, half of them so much more and half so much less by 25.
        (*change, *change_square, *by_stretch) = (40 * *weight, (1600 + 625) * *weight, -100 * *weight);
        let repeats = 6.0;
        let (value, budget) = active.by_force(&BacklashState::new(), &sums, repeats).unwrap();
        let unit = f64::from(active.unit_m);
        let near = |found: f32, wanted: f64| {
            assert!(
                (f64::from(found) - wanted * unit).abs() < 1e-3 * wanted.abs() * unit,
                "{found} for {wanted} units"
            );
        };
        near(value, 5000.0);
        near(budget.standard_error(), 30.0 / 25_f64.sqrt());
        assert!((budget.scatter_freedom() - 25.0).abs() < 1e-3);
        let count = f64::from(active.count_units);
        near(budget.given_u95(Source::Encoder), (1.959_964 * (400.0 * 5.0 / 26.0_f64).sqrt()).hypot(0.4 * count));
        near(budget.given_u95(Source::Model), (1600.0 - 625.0 / 26.0_f64).sqrt());
        let stretch = -100.0 * f64::from(active.scales.stretch);
        near(budget.given_u95(Source::Stiffness), 0.01 * stretch.abs());
        near(budget.given_u95(Source::Gain), 0.005 * stretch.abs());
        near(budget.given_u95(Source::Lead), 0.001 * (5000.0 - stretch));
        // A pattern that comes again more often than there are reversals is all of it.
        let (_, budget) = active.by_force(&BacklashState::new(), &sums, 100.0).unwrap();
        near(budget.given_u95(Source::Encoder), (1.959_964 * 400_f64.sqrt()).hypot(0.4 * count));
    }

    #[test]
    fn what_too_few_reversals_are_missing_is_named() {
        let active = active(2e6, 1200.0);
        let of = |accepted: u32, rejected: u32, change: &dyn Fn(&mut BacklashState)| {
            let mut state = BacklashState::new();
            state.counts.reversals = 4;
            change(&mut state);
            reason(active.by_force(&state, &Sums { rejected, ..sums(accepted, 1, 1) }, 1.0))
        };
        assert_eq!(of(5, 0, &|_| ()), None);
        assert_eq!(of(4, 0, &|_| ()), Some(Reason::TooFewReversals));
        assert_eq!(of(4, 4, &|_| ()), Some(Reason::TooFewReversals));
        assert_eq!(of(4, 5, &|_| ()), Some(Reason::Scattered));
        let bouncing = |count: u32| move |state: &mut BacklashState| state.counts.bouncing = count;
        assert_eq!(of(4, 0, &bouncing(4)), Some(Reason::TooFewReversals));
        assert_eq!(of(4, 0, &bouncing(5)), Some(Reason::Scattered));
        let short =
            |count: u32| move |state: &mut BacklashState| (state.counts.short, state.counts.bouncing) = (count, 9);
        assert_eq!(of(4, 0, &short(4)), Some(Reason::Scattered));
        assert_eq!(of(4, 0, &short(5)), Some(Reason::FlankTooShort));
        // Two seconds on one flank, and less than a flank on the other.
        let one_sided = |firm: [u32; 2], reversals: u32| {
            move |state: &mut BacklashState| {
                (state.counts.short, state.counts.firm, state.counts.reversals) = (9, firm, reversals);
            }
        };
        let least = active.least_flank;
        for (firm, reversals, wanted) in [
            ([0, 2000], 0, Reason::ForceNeverReverses),
            ([2000, least - 1], 0, Reason::ForceNeverReverses),
            ([2000, least], 0, Reason::FlankTooShort),
            ([0, 1999], 0, Reason::FlankTooShort),
            ([0, 2000], 1, Reason::FlankTooShort),
        ] {
            assert_eq!(of(4, 0, &one_sided(firm, reversals)), Some(wanted), "{firm:?} {reversals}");
        }
    }

    #[test]
    fn a_contact_is_what_its_backlash_and_its_landings_say() {
        let active = active(2e6, 1200.0);
        let interval = Interval { value: 3e-5, u95: 1e-5 };
        let of = |size, reversals: u32, bouncing: u32, firm: [u32; 2]| {
            let mut state = BacklashState::new();
            (state.counts.reversals, state.counts.bouncing, state.counts.firm) = (reversals, bouncing, firm);
            state.contact(&active, &Backlash { size, route: Route::Force, reversals })
        };
        let [ok, below] = [BacklashSize::Ok(interval), BacklashSize::BelowU95(interval)];
        let none = BacklashSize::NotIdentifiable(Reason::Scattered);
        for (size, wanted) in [(ok, Contact::Backlash), (below, Contact::Closed), (none, Contact::Unknown)] {
            for (reversals, bouncing, bounces) in
                [(0, 0, false), (7, 4, false), (9, 5, true), (10, 5, false), (10, 6, true), (100, 50, false)]
            {
                let wanted = if bounces { Contact::Bouncing } else { wanted };
                assert_eq!(of(size, reversals, bouncing, [900, 900]), wanted, "{size:?} {reversals} {bouncing}");
            }
            assert_eq!(of(size, 0, 9, [0, 5000]), Contact::OneSided);
        }
    }

    /// Nothing is told whose interval has no end or that lies further below zero than chance takes it.
    #[test]
    fn what_no_spring_or_gap_is_has_no_value() {
        let of = |value: f32, standard_error: f32| (value, Budget::of_scatter(standard_error, 1e9));
        let u95 = of(0.0, 1.0).1.u95();
        let size = |value: f32| Backlash::of(Ok(&of(value, 1.0)), Route::Terminal, 7).size;
        let interval = |value: f32| Interval { value, u95 };
        for (part, above) in [(1.01, true), (0.99, false), (0.0, false), (-1.6, false)] {
            let interval = interval(part * u95);
            let wanted = if above { BacklashSize::Ok(interval) } else { BacklashSize::BelowU95(interval) };
            assert_eq!(size(part * u95), wanted, "{part}");
        }
        let scattered = BacklashSize::NotIdentifiable(Reason::Scattered);
        assert_eq!(size(-1.8 * u95), scattered);
        for (value, error) in [(f32::NAN, 1.0), (f32::INFINITY, 1.0), (1.0, f32::INFINITY), (1.0, f32::NAN)] {
            assert_eq!(Backlash::of(Ok(&of(value, error)), Route::Force, 7).size, scattered, "{value} {error}");
        }
        let missing = Backlash::of(Err(&Reason::FlankTooShort), Route::Force, 7);
        assert_eq!(
            missing,
            Backlash { size: BacklashSize::NotIdentifiable(Reason::FlankTooShort), route: Route::Force, reversals: 7 }
        );
        for (part, told) in [(0.1, true), (-0.99, true), (-1.01, false)] {
            let wanted = if told { Parameter::Ok(interval(part * u95)) } else { Parameter::default() };
            assert_eq!(parameter(&of(part * u95, 1.0)), wanted, "{part}");
        }
        assert_eq!(parameter(&of(1.0, f32::INFINITY)), Parameter::default());
        // No stiffness, and a lag that the guard of 31 samples does not outlast seven times: 4.5 ms at 1 kHz.
        let unable = |stiffness, lag_s: f64| active(stiffness, stiffness * lag_s).unable();
        assert_eq!(unable(0.0, 0.0), Some(Reason::StiffnessUnknown));
        assert_eq!([0.0, 0.0042].map(|lag_s| unable(2e6, lag_s)), [None; 2]);
        assert_eq!(unable(2e6, 0.0047), Some(Reason::FlankTooShort));
    }

    /// Where a stiffness is known, the force's route names what is missing; else the sensor's does.
    #[test]
    fn without_a_stiffness_the_sensor_names_what_is_missing() {
        let state = BacklashState::new();
        for (terminal_sensor, stiffness_n_per_m, route, wanted) in [
            (true, 2e6, Route::Force, Reason::TooFewReversals),
            (true, 0.0, Route::Terminal, Reason::TooFewReversals),
            (false, 0.0, Route::Force, Reason::StiffnessUnknown),
        ] {
            let settings = Settings { terminal_sensor, stiffness_n_per_m, ..Settings::default() };
            let active = settings.validate().unwrap().backlash;
            let found = active.found(&state, 1.0);
            assert_eq!(found.backlash, Backlash::none(wanted, route, 0));
            assert_eq!((found.stiffness, found.damping), (Parameter::default(), Parameter::default()));
            let ContactBudgets { backlash_m, stiffness_n_per_m, damping_n_s_per_m } = active.budgets(&state, 1.0);
            assert_eq!([backlash_m, stiffness_n_per_m, damping_n_s_per_m], [None; 3]);
        }
    }

    /// Values and budgets with the sensor, from the least squares in f64: the jump of the side over the stiffness, in
    /// blocks of four samples.
    #[test]
    fn what_the_sensor_tells_is_the_least_squares_with_its_budget() {
        let settings = Settings {
            terminal_sensor: true,
            skew_s: 2e-4,
            skew_u95_s: 3e-5,
            lead_u95: 0.004,
            force_gain_u95: 0.02,
            ..Settings::default()
        };
        let active = settings.validate().unwrap().backlash;
        let blocks = blocks(2000, 20_000_000);
        let (rows, travel) = &blocks;
        let mut state = std::boxed::Box::new(BacklashState::new());
        state.terminal = seen(&blocks);
        // All of the residual is the force's own noise: 4 samples of it in a block.
        let ([damping, stiffness, side, _], inverse, residual) = reckoned(rows, &forces(rows), [0.0; 2]);
        state.flanks.noise = (1.01 * (residual / 4.0).sqrt() / f64::from(active.scales.noise)) as i32;
        let near = |found: f32, wanted: f64, size: f64, what: &str| {
            assert!((f64::from(found) - wanted).abs() <= 3e-3 * size, "{what}: {found} for {wanted}");
        };
        let errors = inverse.map(|inverse| (residual * inverse).sqrt());
        let travel: Vec<f64> = travel.iter().map(|travel| f64::from(*travel)).collect();
        let ([false_damping, false_stiffness, false_side, _], ..) = reckoned(rows, &travel, [0.0; 2]);
        // A fifth of the residual may yet be noise of the stretch.
        let most = 0.2 * residual / (4.0 * stiffness.powi(2) + 2.0 * damping.powi(2)) * 2000.0;
        let ([more_damping, more_stiffness, more_side, _], ..) =
            reckoned(rows, &forces(rows), [2.0 * most, 4.0 * most]);
        // Of the stretch in code units: newtons per code and metres per unit.
        let unit = f64::from(active.unit_m);
        let si = settings.newtons_per_code / unit;
        let per_side = 2.0 * f64::from(ONE) / (stiffness * 4.0);
        let backlash = -side * per_side;
        // The mean stretch by itself is half of the difference between the flanks, less half of the backlash.
        let of = |wanted: i32| {
            let own: Vec<f64> = rows.iter().filter(|row| row[2] == wanted).map(|row| f64::from(row[1])).collect();
            own.iter().sum::<f64>() / own.len() as f64
        };
        let apart = 0.5 * (of(ONE) - of(-ONE)) - 0.5 * backlash * 4.0;
        for (reversals, repeats, share) in [(100, 1.0, 1.0 / 8.0), (4, 1.0, 0.25), (100, 41.0, 0.4), (100, 500.0, 1.0)]
        {
            state.counts.reversals = reversals;
            let Ok(sensed) = active.by_terminal(&state, repeats) else { panic!("{reversals}") };
            // The encoder's steps, as far as their patterns do not average out, over what is left of the regressor.
            let count = f64::sqrt(share) * 256.0;
            let by_count = |i: usize| stiffness * 4.0 * 0.07 * count * (2000.0 * inverse[i]).sqrt();

            let (value, budget) = &sensed.stiffness;
            near(*value, stiffness * si, stiffness * si, "stiffness");
            near(budget.standard_error(), errors[1] * si, errors[1] * si, "stiffness's error");
            let wanted = [
                (Source::Encoder, by_count(1)),
                (Source::Model, more_stiffness - stiffness),
                (Source::Lead, 0.004 * stiffness * false_stiffness),
                (Source::Gain, 0.02 * stiffness),
            ];
            for (source, wanted) in wanted {
                near(budget.given_u95(source), wanted.abs() * si, wanted.abs() * si, "stiffness");
            }
            assert!((budget.scatter_freedom() - 1996.0).abs() < 0.1);

            let (value, budget) = &sensed.damping.unwrap();
            // A block's ends are three samples apart, its mean is of four; and a late force takes its share.
            let of_rate = si * 3.0 / 4.0 / settings.sample_rate_hz;
            near(*value, damping * of_rate + stiffness * si * 2e-4, damping * of_rate, "damping");
            near(budget.standard_error(), errors[0] * of_rate, errors[0] * of_rate, "damping's error");
            let wanted = [
                (Source::Encoder, by_count(0) * of_rate),
                (Source::Model, (more_damping - damping).hypot(0.005 * damping) * of_rate),
                (Source::Lead, 0.004 * stiffness * false_damping * of_rate),
                (Source::Gain, 0.02 * damping * of_rate),
                (Source::Skew, 3e-5 * stiffness * si),
            ];
            for (source, wanted) in wanted {
                near(budget.given_u95(source), wanted.abs(), wanted.abs(), "damping");
            }

            let (value, budget) = &sensed.backlash;
            near(*value, backlash * unit, backlash.abs() * unit, "backlash");
            let error = (per_side * errors[2]).hypot(errors[1] / stiffness * backlash);
            near(budget.standard_error(), error * unit, error * unit, "backlash's error");
            let by_stiffness = 2.0 * apart / (4.0 * stiffness) * by_count(1);
            let lead = 0.004 * stiffness * (per_side * false_side + backlash * false_stiffness / stiffness);
            let wanted = [
                (Source::Model, per_side * (more_side - side)),
                (Source::Encoder, by_stiffness.hypot(0.3 * count)),
                (Source::Lead, lead),
            ];
            for (source, wanted) in wanted {
                near(budget.given_u95(source), wanted.abs() * unit, 3.0 * wanted.abs() * unit, "backlash");
            }
        }
    }
}
