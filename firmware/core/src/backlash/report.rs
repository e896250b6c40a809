//! The backlash in SI, with its interval or the reason there is none.

use crate::backlash::active::BacklashActive;
use crate::backlash::law::{Freed, Solved};
use crate::backlash::state::BacklashState;
use crate::backlash::terminal::ONE;
use crate::constants;
use crate::detail::{Backlash, BacklashSize, Contact, Reason, Route};
use crate::estimate::{Interval, Parameter, Unresolved};
use crate::math::{greater, single, sqrt, square};
use crate::rls::place;

const COVERAGE: f32 = constants::COVERAGE as f32;
const WIDEST_INTERVAL: f32 = constants::WIDEST_INTERVAL as f32;
/// Fewest reversals that a scatter is read from.
const FEWEST: u32 = 5;
/// The same in reversals of equal weight.
const LEAST_EQUAL: f32 = 3.0;
/// Part of an encoder count that stays however many reversals there are: the encoder's steps along a flank are not
/// white.
const COUNT_PART: f32 = 0.5;
/// The same of the backlash with the sensor, where whole flanks are averaged.
const SENSED_COUNT_PART: f32 = 0.25;
/// Part of an encoder count that correlates with the stretch, and with its rate.
const STIFFNESS_COUNT_PART: f32 = 0.06;
const DAMPING_COUNT_PART: f32 = 0.03;
/// The stretch's rate is the difference of a block's ends: 0.25 % at 16 Hz.
const DAMPING_MODEL_U95: f32 = 0.005;
/// Patterns of the encoder's steps that a motion is taken to have at most.
const PATTERNS: f32 = 16.0;
/// Variance over that of the flanks' own noise beyond which reversals contradict each other.
const CONTRADICTION: f32 = 25.0;

/// What is published of the contact.
pub(crate) struct Found {
    pub backlash: Backlash,
    /// How the flanks behave.
    pub contact: Contact,
    /// Stiffness \[N/m\] and damping \[N s/m\] by the terminal's sensor.
    pub stiffness: Parameter,
    pub damping: Parameter,
}

impl BacklashActive {
    /// Backlash and contact as they stand.
    pub fn found(&self, state: &BacklashState) -> Found {
        let by_force = self.by_force(state);
        let sensed = if self.terminal.present { self.by_terminal(state) } else { Sensed::default() };
        let narrower = match (by_force.known(), sensed.backlash.known()) {
            (_, None) => false,
            (None, Some(_)) => true,
            (Some(by_force), Some(sensed)) => sensed.u95 <= by_force.u95,
        };
        // Where the force alone cannot, the sensor's own reason counts.
        let only = self.terminal.present && !self.stiffness_known;
        let backlash = if narrower || only { sensed.backlash } else { by_force };
        let Sensed { stiffness, damping, .. } = sensed;
        Found { backlash, contact: state.contact(self, &backlash), stiffness, damping }
    }
}

impl Backlash {
    fn none(reason: Reason, route: Route, reversals: u32) -> Self {
        Self { size: BacklashSize::NotIdentifiable(reason), route, reversals }
    }

    /// Refuses what is no backlash: an interval without end, or one wholly below zero.
    fn of(value: f32, u95: f32, route: Route, reversals: u32) -> Self {
        if !(u95.is_finite() && value.is_finite()) || value < -u95 {
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
    fn by_force(&self, state: &BacklashState) -> Backlash {
        let counts = &state.counts;
        let sums = state.pool.sums();
        let route = Route::Force;
        let none = |reason| Backlash::none(reason, route, sums.accepted);
        if !self.stiffness_known {
            return none(Reason::StiffnessUnknown);
        }
        if !self.lag_fits {
            return none(Reason::FlankTooShort);
        }
        if sums.accepted < FEWEST {
            return match () {
                () if state.one_sided(self) => none(Reason::ForceNeverReverses),
                () if counts.short >= FEWEST => none(Reason::FlankTooShort),
                () if counts.bouncing >= FEWEST || sums.rejected >= FEWEST => none(Reason::Scattered),
                () => none(Reason::TooFewReversals),
            };
        }
        let [weight, sums_of @ ..] = sums.weighted.map(single);
        let [equal, from_origin, square, change, change_square, by_stretch, own_noise] =
            sums_of.map(|sum| sum / weight);
        let equal = weight / equal;
        let value = sums.origin as f32 + from_origin;
        let variance = greater(square - from_origin * from_origin, 0.0);
        if variance > CONTRADICTION * own_noise || 2 * sums.rejected > sums.accepted {
            return none(Reason::Scattered);
        }
        if equal < LEAST_EQUAL {
            return none(Reason::TooFewReversals);
        }
        // Of few, the scatter is itself uncertain.
        let coverage = COVERAGE * (1.0 + 2.0 / (equal - 1.0));
        let spread = coverage * coverage * variance / (equal - 1.0);
        // What the check would change is known with its own scatter.
        let change_noise = greater(change_square - change * change, 0.0) / equal;
        let truncation = greater(change * change - change_noise, 0.0);
        // A periodic motion repeats the encoder's steps, and their error does not average. What the values scatter
        // less than by the noise of their own flanks is shared by all; and no motion is trusted to have more than 16
        // patterns.
        let count = sums.accepted as f32;
        let few = if count < PATTERNS { count } else { PATTERNS };
        let pattern = greater(own_noise / few, own_noise - variance * (1.0 + sqrt(2.0 / count)));
        let by_stretch = by_stretch * self.scales.stretch;
        let by_position = value - by_stretch;
        let scale = by_stretch * by_stretch * self.scales.compliance + by_position * by_position * self.scales.lead;
        let count = COUNT_PART * self.count_units as f32;
        let u95 = sqrt(spread + truncation + 4.0 * pattern + scale + count * count);
        Backlash::of(value * self.unit_m, u95 * self.unit_m, route, sums.accepted)
    }
}

/// What the terminal's sensor shows.
#[derive(Clone, Copy, Default)]
struct Sensed {
    backlash: Backlash,
    stiffness: Parameter,
    damping: Parameter,
}

impl BacklashActive {
    fn by_terminal(&self, state: &BacklashState) -> Sensed {
        let terminal = &state.terminal;
        let blocks = terminal.totals.updates();
        let reversals = state.counts.reversals;
        let none =
            |reason| Sensed { backlash: Backlash::none(reason, Route::Terminal, reversals), ..Sensed::default() };
        let Freed { solved, noise, most, own_rate, own_stretch, damping_drowned } =
            match self.solved(&state.terminal, state.flanks.noise) {
                Ok(freed) => freed,
                Err(reason) => return none(reason),
            };
        let block = self.scales.block;
        let [more_damping, more_stiffness, more_side, _] = Solved::of(terminal, most, false).unknowns;
        let [damping, stiffness, side, _] = solved.unknowns;
        let [Some(damping_error), Some(stiffness_error), Some(side_error), _] = solved.errors else {
            return none(Reason::FlankTooShort);
        };
        // A wrong scale of one displacement against the other is a false stretch.
        let lead = sqrt(self.scales.lead) * stiffness;
        let [false_damping, false_stiffness, false_side, _] =
            Solved::of(terminal, noise, true).unknowns.map(|unknown| square(lead * unknown));
        // The encoder's steps are one as well, against the regressor's own rms.
        let by_count =
            |own: f32, part: f32| square(stiffness * block * part * self.count_units as f32) * (blocks as f32 / own);
        let stiffness_by_count = by_count(own_stretch, STIFFNESS_COUNT_PART);
        let damping_u95_squared = square(COVERAGE * damping_error)
            + square(more_damping - damping)
            + false_damping
            + by_count(own_rate, DAMPING_COUNT_PART);
        let stiffness_u95_squared = square(COVERAGE * stiffness_error)
            + square(more_stiffness - stiffness)
            + false_stiffness
            + stiffness_by_count;
        let side_u95_squared = square(COVERAGE * side_error) + square(more_side - side) + false_side;

        let backlash = -2.0 * side * ONE as f32 / (stiffness * block);
        let per_side = 2.0 * ONE as f32 / (stiffness * block);
        let relative = square(COVERAGE * stiffness_error / stiffness * backlash);
        // A stiffness that is wrong moves each flank by its mean stretch.
        let mean = |row: usize, column: usize| {
            terminal.totals.sums().get(place(row, column)).map_or(0.0, |sum| single(*sum) / blocks as f32)
        };
        let apart = (mean(2, 1) - mean(3, 1) * (mean(3, 2) / mean(3, 3))) / ONE as f32 - 0.5 * backlash * block;
        let by_stiffness = square(2.0 * apart / (block * stiffness)) * stiffness_by_count;
        let count = SENSED_COUNT_PART * self.count_units as f32;
        let backlash_u95 = sqrt(square(per_side) * side_u95_squared + relative + by_stiffness + count * count);
        let stiffness_si = stiffness * self.scales.stiffness;
        let gain = square(stiffness) * self.scales.gain;
        let stiffness_u95 = self.scales.stiffness * sqrt(stiffness_u95_squared + gain);
        let gain = square(damping) * (self.scales.gain + square(DAMPING_MODEL_U95));
        let damping_u95 = self.scales.damping * sqrt(damping_u95_squared + gain);
        let skew_u95 = stiffness_si * self.scales.skew_u95_s;
        Sensed {
            backlash: Backlash::of(backlash * self.unit_m, backlash_u95 * self.unit_m, Route::Terminal, reversals),
            stiffness: parameter(stiffness_si, stiffness_u95),
            damping: if damping_drowned {
                Parameter::NotIdentifiable(Unresolved::NOTHING)
            } else {
                let skewed = stiffness_si * self.scales.skew_s;
                parameter(damping * self.scales.damping + skewed, sqrt(square(damping_u95) + square(skew_u95)))
            },
        }
    }
}

fn parameter(value: f32, u95: f32) -> Parameter {
    // Not a number is not within.
    if u95 <= WIDEST_INTERVAL * value {
        return Parameter::Ok(Interval { value, u95 });
    }
    Parameter::NotIdentifiable(Unresolved::NOTHING)
}
