//! Friction beyond the law's, as far as a run shows it: either included beside the law, or counted as a possible shift.

use std::mem::discriminant;

use super::rows::{Friction, Rows};
use crate::law::{FALLS, MOST_LOAD, Squares, TURNS};

/// F statistic from which friction is included. None of about twenty candidates reaches the first value by chance.
/// Friction of another shape may reach it; the interval of friction at the reversals covers that, but the interval of
/// the others does not.
const LIMIT_AT_REVERSALS: f64 = 30.0;
const LIMIT: f64 = 150.0;
/// Fraction of a column's square that the others must leave for the run to identify it.
const LEAST_LEFT: f64 = 0.05;
/// Step factors with which a velocity or a distance is refined, on either side, and their number.
const FINER: [f64; 2] = [1.5, 1.15];
const MOST_STEPS: usize = 3;
/// Standard deviations by which a parameter shifts by chance when one of all candidates is included.
const CHANCE: f64 = 2.0;
/// Weight of the shift beyond chance in the half width of an interval.
const MOVED: f64 = 1.4;

impl Friction {
    /// All candidates, except the kinds already included.
    fn others(rows: &Rows, taken: &[Self]) -> Vec<Self> {
        let falls = FALLS.map(|part| Self::Falling(part * rows.velocity_rms()));
        let turns = TURNS.map(|part| Self::Turning(part * rows.stroke_m));
        let all = [Self::Load, Self::Direction].into_iter().chain(falls).chain(turns);
        all.filter(|one| taken.iter().all(|other| discriminant(one) != discriminant(other))).collect()
    }

    /// Whether it acts at the reversals, with a shape that only approximates the machine's.
    pub fn is_shaped(&self) -> bool {
        matches!(self, Self::Falling(_) | Self::Turning(_))
    }

    /// F statistic from which it is included.
    fn limit(self) -> f64 {
        if self.is_shaped() { LIMIT_AT_REVERSALS } else { LIMIT }
    }

    /// Whether its size is plausible for a machine: it grows with the load, is larger at low speed, and lags.
    fn can_be(self, size: f64) -> bool {
        match self {
            Self::Load => (0.0..MOST_LOAD).contains(&size),
            Self::Falling(_) => size > 0.0,
            Self::Turning(_) => size < 0.0,
            Self::Direction => true,
        }
    }

    fn scaled(self, factor: f64) -> Option<Self> {
        match self {
            Self::Falling(velocity) => Some(Self::Falling(velocity * factor)),
            Self::Turning(distance) => Some(Self::Turning(distance * factor)),
            Self::Load | Self::Direction => None,
        }
    }
}

/// Includes friction beside the columns, the strongest first.
pub(super) fn taken(rows: &Rows, columns: &[Vec<f64>]) -> Option<Vec<Friction>> {
    let mut taken: Vec<Friction> = Vec::new();
    let mut columns = columns.to_vec();
    loop {
        let squares = Squares::of(&rows.force, columns.clone())?;
        let freedom = rows.observations() - columns.len() as f64 - 1.0;
        let strength = |friction: Friction| {
            let more = squares.with(&rows.friction(friction));
            let left = squares.square() * rows.force.len() as f64 - more.explained;
            let is_told = more.left > LEAST_LEFT && friction.can_be(more.size) && freedom > 1.0;
            if is_told { more.explained / left.max(f64::MIN_POSITIVE) * freedom } else { 0.0 }
        };
        let strongest =
            |all: &[Friction]| all.iter().map(|one| (*one, strength(*one))).max_by(|(_, a), (_, b)| a.total_cmp(b));
        let best = strongest(&Friction::others(rows, &taken)).filter(|(best, most)| *most > best.limit());
        let Some((mut best, mut most)) = best else { return Some(taken) };
        for step in FINER {
            for _ in 0..MOST_STEPS {
                let finer: Vec<_> = [step, step.recip()].into_iter().filter_map(|by| best.scaled(by)).collect();
                let Some(better) = strongest(&finer).filter(|(_, strength)| *strength > most) else { break };
                (best, most) = better;
            }
        }
        taken.push(best);
        columns.push(rows.friction(best));
    }
}

/// By how much friction that was not included may have shifted the coefficient at an index, as the half width of an
/// interval: the largest shift beyond chance. `again` is the square of the factor by which a repeating residual
/// increases chance.
pub(super) fn reach(rows: &Rows, squares: &Squares, place: usize, taken: &[Friction], again: f64) -> f64 {
    let error_square = squares.square() * rows.per_observation;
    let of = |friction: Friction| {
        let more = squares.with(&rows.friction(friction));
        let (moved, chance) = more.moves(place);
        // Friction that would drive the screw is impossible.
        let drives = |at: usize| {
            let (moved, chance) = more.moves(at);
            let error = (error_square * (squares.inverse[(at, at)] + chance)).sqrt();
            squares.values[at] + moved < -CHANCE * error
        };
        let is_told = more.left > LEAST_LEFT && friction.can_be(more.size) && !drives(1) && !drives(2);
        let beyond = moved * moved - CHANCE * CHANCE * chance * error_square * again;
        if is_told { MOVED * beyond.max(0.0).sqrt() } else { 0.0 }
    };
    Friction::others(rows, taken).into_iter().map(of).fold(0.0, f64::max)
}
