//! The gap in SI, with its interval or the reason there is none.

use crate::active::Active;
use crate::backlash::step::Fit;
use crate::backlash::terminal::{Crossing, ONE, Terminal};
use crate::backlash::{BacklashActive, Gaps};
use crate::detail::{Backlash, BacklashStatus, Contact, Gap, Reason, Route};
use crate::estimate::{Parameter, Status};
use crate::ldl::{FACTOR_BITS, UNKNOWNS, solve};
use crate::math::{power, sqrt};
use crate::report::{pivot, standard_errors};
use crate::rls::{place, scaled};

/// Standard errors in the interval, as everywhere.
const COVERAGE: f32 = 3.0;
/// Fewest reversals that a scatter is read from.
const FEWEST: u32 = 5;
/// The same in reversals of equal weight.
const LEAST_EQUAL: f32 = 3.0;
/// Part of an encoder count that stays however many reversals there are: the encoder's steps along a flank are not
/// white.
const COUNT_PART: f32 = 0.5;
/// The same of the gap with the sensor, where whole flanks are averaged.
const SENSED_COUNT_PART: f32 = 0.25;
/// The same of a single reversal with the sensor, as a standard error: a fifth of the steps' own rms on either
/// flank.
const RECORD_COUNT_PART: f32 = 0.08;
/// Part of an encoder count that correlates with the stretch, and with its rate.
const STIFFNESS_COUNT_PART: f32 = 0.06;
const DAMPING_COUNT_PART: f32 = 0.03;
/// Part of the residual that may be taken for the stretch's noise and is not, or the other way.
const MODEL_OF_NOISE: f32 = 0.2;
/// Noise in a regressor, as a part of what it says for itself, beyond which no compensation is trusted.
const DROWNED: f32 = 0.5;
/// The stretch's rate is the difference of a block's ends: 0.25 % at 16 Hz.
const DAMPING_MODEL_U95: f32 = 0.005;
/// Patterns of the encoder's steps that a motion is taken to have at most.
const PATTERNS: f32 = 16.0;
/// Variance over that of the flanks' own noise beyond which reversals contradict each other.
const CONTRADICTION: f32 = 25.0;
/// Fewest blocks on either flank for the terminal's route.
const FEWEST_BLOCKS: u32 = 16;
/// Part of the blocks by which they grow until the contact's law is solved anew.
const LAW_GROWTH: u32 = 4;
/// Widest interval of a stiffness or a damping, as a part of it.
const WIDEST: f32 = 0.5;

impl BacklashActive {
    /// A reversal in SI.
    pub(super) fn gap(&self, fit: &Fit, rising: bool, index: u32) -> Gap {
        Gap {
            index,
            value_m: fit.value as f32 * self.unit_m,
            error_m: sqrt(fit.variance as f32) * self.unit_m,
            route: Route::Force,
            rising,
        }
    }
}

impl Active {
    /// Backlash, how the flanks behave, and the contact's stiffness \[N/m\] and damping \[N s/m\].
    pub(crate) fn backlash_of(&self, gaps: &Gaps) -> (Backlash, Contact, Parameter, Parameter) {
        let active = &self.backlash;
        let by_force = active.by_force(gaps);
        let sensed = if active.terminal.present { active.by_terminal(gaps) } else { Sensed::default() };
        let given = |backlash: &Backlash| backlash.status.is_given();
        let narrower = given(&sensed.backlash) && !(given(&by_force) && by_force.u95_m < sensed.backlash.u95_m);
        // Where the force alone cannot, the sensor's own reason counts.
        let only = active.terminal.present && !active.stiffness_known;
        let backlash = if narrower || only { sensed.backlash } else { by_force };
        (backlash, gaps.contact(active, &backlash), sensed.stiffness, sensed.damping)
    }

    /// How the flanks behave.
    pub(crate) fn contact_of(&self, gaps: &Gaps) -> Contact {
        self.backlash_of(gaps).1
    }
}

impl BacklashStatus {
    /// Whether there is a value.
    fn is_given(self) -> bool {
        !matches!(self, Self::NotIdentifiable(_))
    }
}

impl Backlash {
    fn none(reason: Reason, route: Route, reversals: u32) -> Self {
        Self { value_m: 0.0, u95_m: f32::INFINITY, status: BacklashStatus::NotIdentifiable(reason), route, reversals }
    }

    /// Refuses what is no gap: an interval without end, or one wholly below zero.
    fn of(value_m: f32, u95_m: f32, route: Route, reversals: u32) -> Self {
        if !(u95_m.is_finite() && value_m.is_finite()) || value_m < -u95_m {
            return Self::none(Reason::Scattered, route, reversals);
        }
        let status = if value_m > u95_m { BacklashStatus::Ok } else { BacklashStatus::BelowU95 };
        Self { value_m, u95_m, status, route, reversals }
    }
}

impl Gaps {
    fn one_sided(&self, active: &BacklashActive) -> bool {
        let [negative, positive] = self.counts.firm;
        let (less, more) = (negative.min(positive), negative.max(positive));
        more >= active.scales.one_sided && self.counts.reversals == 0 && less < active.least_flank
    }

    fn contact(&self, active: &BacklashActive, backlash: &Backlash) -> Contact {
        let bouncing = self.counts.bouncing >= FEWEST && 2 * self.counts.bouncing > self.counts.reversals;
        match backlash.status {
            _ if self.one_sided(active) => Contact::OneSided,
            _ if bouncing => Contact::Bouncing,
            BacklashStatus::Ok => Contact::Gap,
            BacklashStatus::BelowU95 => Contact::Closed,
            BacklashStatus::NotIdentifiable(_) => Contact::Unknown,
        }
    }
}

/// `value` as it is, nearly.
fn single(value: i128) -> f32 {
    let magnitude = value.unsigned_abs();
    let unsigned = (magnitude >> 64) as u64 as f32 * power(64) + magnitude as u64 as f32;
    if value < 0 { -unsigned } else { unsigned }
}

fn square(value: f32) -> f32 {
    value * value
}

/// The greater of two.
fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

impl BacklashActive {
    fn by_force(&self, gaps: &Gaps) -> Backlash {
        let counts = &gaps.counts;
        let sums = gaps.pool.sums();
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
                () if gaps.one_sided(self) => none(Reason::ForceNeverReverses),
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
        // What the judge would change is known with its own scatter.
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

/// What the contact's stretch and force have to do with each other, by the terminal's sensor, in its least squares' units.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Law {
    /// Blocks at which it is solved anew.
    next: u32,
    /// Damping by stiffness, 1 over the stiffness; 0 while nothing is known.
    lag: f32,
    compliance: f32,
    /// Variance of a block's stretch by what the law leaves, and of the compliance as a part of it.
    variance: f32,
    relative: f32,
}

impl Law {
    /// Nothing is known.
    pub const UNKNOWN: Self = Self { next: 0, lag: 0.0, compliance: 0.0, variance: 0.0, relative: 0.0 };
}

impl Gaps {
    /// The reversal that waited, by the terminal's sensor: the jump of `z + (cs / ks) z' - F / ks` from flank to flank.
    #[inline(never)]
    pub(super) fn sensed(&mut self, active: &BacklashActive) -> Option<Gap> {
        let Crossing { before: first, after: second } = self.terminal.take();
        let blocks = self.terminal.totals.updates();
        if blocks >= self.law.next {
            let solved = active.solved(self).ok();
            self.law = solved.map_or(Law::UNKNOWN, |solved| solved.law());
            self.law.next = blocks.saturating_add(blocks / LAW_GROWTH + 1);
        }
        let Law { lag, compliance, variance, relative, .. } = self.law;
        if compliance <= 0.0 {
            return None;
        }
        let [before, after] = [first, second].map(|flank| {
            let [rate, stretch, force] = flank.sums.map(|sum| sum as f32 / flank.blocks as f32);
            (stretch + lag * rate, compliance * force)
        });
        let rising = second.side > 0;
        let towards = if rising { 1.0 } else { -1.0 };
        let by_force = towards * (after.1 - before.1);
        let jump = towards * (after.0 - before.0) - by_force;
        let count = RECORD_COUNT_PART * active.count_units as f32 * active.scales.block;
        let fewer = 1.0 / first.blocks as f32 + 1.0 / second.blocks as f32;
        let unit_m = active.unit_m / active.scales.block;
        let flight = second.first.wrapping_sub(first.last);
        Some(Gap {
            index: first.last.wrapping_add(flight / 2),
            value_m: jump * unit_m,
            error_m: sqrt(variance * fewer + square(by_force) * relative + square(count)) * unit_m,
            route: Route::Terminal,
            rising,
        })
    }
}

/// What the terminal's sensor shows.
#[derive(Clone, Copy, Default)]
struct Sensed {
    backlash: Backlash,
    stiffness: Parameter,
    damping: Parameter,
}

/// The terminal's least squares, solved: coefficients of `[z', z, s, 1]` in their own units, with their errors.
struct Solved {
    unknowns: [f32; UNKNOWNS],
    errors: [Option<f32>; UNKNOWNS],
    /// Variance of what is left of a block's force [codes^2].
    residual: f32,
}

impl Solved {
    /// Of the sums less this much of the squares of `z'` and `z`; for the force, or for the encoder's travel in its
    /// place.
    fn of(terminal: &Terminal, less: [f32; 2], travel: bool) -> Self {
        let (mut matrix, shift) = scaled(terminal.totals.sums());
        let down = power(-(shift as i32));
        for (i, less) in [place(0, 0), place(1, 1)].into_iter().zip(less) {
            if let Some(entry) = matrix.get_mut(i) {
                *entry -= (less * down) as i64;
            }
        }
        if travel {
            let row = matrix.iter_mut().skip(place(UNKNOWNS, 0));
            row.zip(&terminal.travel).for_each(|(entry, sum)| *entry = (*sum >> shift) as i64);
        }
        let solution = solve(&matrix);
        let freedom = terminal.totals.updates().saturating_sub(UNKNOWNS as u32).max(1) as f32;
        let last = i32::from(solution.shifts[UNKNOWNS]);
        let left = pivot(&solution, UNKNOWNS) / freedom;
        let errors = standard_errors(&solution, left);
        let unit = |i: usize| power(i32::from(solution.shifts[i]) - last);
        Self {
            unknowns: core::array::from_fn(|i| solution.unknowns[i] as f32 * power(-(FACTOR_BITS as i32)) * unit(i)),
            errors: core::array::from_fn(|i| errors[i].map(|error| error * unit(i))),
            // The matrix in Q62 is of sums shifted right.
            residual: left * power(62 - last) * power(shift as i32 - last),
        }
    }
}

/// The terminal's least squares without the noise of the stretch.
struct Freed {
    solved: Solved,
    /// Taken off the squares of `z'` and `z`, and the most that it may be.
    noise: [f32; 2],
    most: [f32; 2],
    /// What the squares of `z'` and `z` hold that the others do not explain.
    own_rate: f32,
    own_stretch: f32,
    /// Whether the noise leaves nothing of `z'`.
    damping_drowned: bool,
}

impl Freed {
    fn law(&self) -> Law {
        let [damping, stiffness, ..] = self.solved.unknowns;
        let compliance = 1.0 / stiffness;
        let variance = self.solved.residual * square(compliance);
        // The noise of the stretch weakens the stiffness by its part of what the stretch says for itself.
        let ([_, least], [_, most]) = (self.noise, self.most);
        let weakened = (most - least) / (COVERAGE * self.own_stretch);
        let error = self.solved.errors[1].map_or(0.0, |error| error * compliance);
        let relative = square(error) + square(weakened);
        Law { lag: damping * compliance, compliance, variance, relative, ..Law::UNKNOWN }
    }
}

impl BacklashActive {
    /// The terminal's least squares, freed of the stretch's noise, or the reason there is no gap by them.
    fn solved(&self, gaps: &Gaps) -> Result<Freed, Reason> {
        let terminal = &gaps.terminal;
        let blocks = terminal.totals.updates();
        let [negative, positive] = terminal.sides;
        if negative.max(positive) < FEWEST_BLOCKS {
            return Err(Reason::TooFewReversals);
        }
        if negative.min(positive) < FEWEST_BLOCKS {
            return Err(Reason::ForceNeverReverses);
        }
        let plain = Solved::of(terminal, [0.0; 2], false);
        let [damping, stiffness, ..] = plain.unknowns;
        if stiffness <= 0.0 {
            return Err(Reason::FlankTooShort);
        }
        // Noise of the stretch weakens what it is multiplied by. Its variance in a sample is what the residual holds
        // beside the force's own noise.
        let block = self.scales.block;
        let force_noise = block * square(gaps.flanks.noise as f32 * self.scales.noise);
        let excess = greater(plain.residual - force_noise, 0.0);
        let noise_by = |excess: f32| excess / (block * square(stiffness) + 2.0 * square(damping)) * blocks as f32;
        let most = noise_by(MODEL_OF_NOISE * plain.residual + excess);
        // What of a regressor the others do not explain is the residual over the square of its error.
        let own = plain.errors.map(|error| error.map_or(0.0, |error| plain.residual / square(error)));
        let [own_rate, own_stretch, ..] = own;
        let drowned = |part: f32, own: f32| part * most >= DROWNED * own;
        let damping_drowned = drowned(2.0, own_rate);
        if drowned(block, own_stretch) {
            return Err(Reason::FlankTooShort);
        }
        let parts = |noise: f32| [if damping_drowned { 0.0 } else { 2.0 * noise }, block * noise];
        let noise = parts(noise_by(excess));
        let solved = Solved::of(terminal, noise, false);
        let [_, stiffness, ..] = solved.unknowns;
        if stiffness <= 0.0 {
            return Err(Reason::FlankTooShort);
        }
        Ok(Freed { solved, noise, most: parts(most), own_rate, own_stretch, damping_drowned })
    }

    fn by_terminal(&self, gaps: &Gaps) -> Sensed {
        let terminal = &gaps.terminal;
        let blocks = terminal.totals.updates();
        let reversals = gaps.counts.reversals;
        let none =
            |reason| Sensed { backlash: Backlash::none(reason, Route::Terminal, reversals), ..Sensed::default() };
        let Freed { solved, noise, most, own_rate, own_stretch, damping_drowned } = match self.solved(gaps) {
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

        let gap = -2.0 * side * ONE as f32 / (stiffness * block);
        let per_side = 2.0 * ONE as f32 / (stiffness * block);
        let relative = square(COVERAGE * stiffness_error / stiffness * gap);
        // A stiffness that is wrong moves each flank by its mean stretch.
        let mean = |row: usize, column: usize| {
            terminal.totals.sums().get(place(row, column)).map_or(0.0, |sum| single(*sum) / blocks as f32)
        };
        let apart = (mean(2, 1) - mean(3, 1) * (mean(3, 2) / mean(3, 3))) / ONE as f32 - 0.5 * gap * block;
        let by_stiffness = square(2.0 * apart / (block * stiffness)) * stiffness_by_count;
        let count = SENSED_COUNT_PART * self.count_units as f32;
        let gap_u95 = sqrt(square(per_side) * side_u95_squared + relative + by_stiffness + count * count);
        let stiffness_si = stiffness * self.scales.stiffness;
        let gain = square(stiffness) * self.scales.gain;
        let stiffness_u95 = self.scales.stiffness * sqrt(stiffness_u95_squared + gain);
        let gain = square(damping) * (self.scales.gain + square(DAMPING_MODEL_U95));
        let damping_u95 = self.scales.damping * sqrt(damping_u95_squared + gain);
        let skew_u95 = stiffness_si * self.scales.skew_u95_s;
        Sensed {
            backlash: Backlash::of(gap * self.unit_m, gap_u95 * self.unit_m, Route::Terminal, reversals),
            stiffness: parameter(stiffness_si, stiffness_u95),
            damping: if damping_drowned {
                Parameter { u95: f32::INFINITY, ..Parameter::default() }
            } else {
                let skewed = stiffness_si * self.scales.skew_s;
                parameter(damping * self.scales.damping + skewed, sqrt(square(damping_u95) + square(skew_u95)))
            },
        }
    }
}

fn parameter(value: f32, u95: f32) -> Parameter {
    // Not a number is not within.
    if u95 <= WIDEST * value {
        return Parameter { value, u95, status: Status::Ok };
    }
    Parameter { value: 0.0, u95: f32::INFINITY, status: Status::NotIdentifiable }
}
