//! The rows of a run: force, law and candidate terms, all through the same kernels.

use std::f64::consts::TAU;

use inerter_core::{
    Repeats, Settings,
    constants::{CORRELATION_BOXES, FAST_BOX_S, REST_WINDOW_S},
};
use inerter_data::series::{Series, Stretch};

use super::{
    candidate::{Found, HYSTERESIS, Kind, Shape, Span, Term},
    filter::Filter,
};
use crate::{
    law::{Law, around, ends, mark, mean, stands},
    reversals::{Moment, Reversal, Turns, velocity_noise},
};

/// Travel across a window \[counts\], and force relative to the Coulomb friction, below which a reversal is grazing.
const GRAZING_COUNTS: f64 = 4.0;
const WEAK: f64 = 3.0;
/// Velocities below this count as zero, in standard deviations of their noise.
const SLOW: f64 = 3.0;
/// Maximum number of rows: of more, evenly spaced ones are taken.
pub(super) const MOST_ROWS: usize = 20_000;

/// A stretch with the data that every term needs.
struct Piece<'a> {
    stretch: &'a Stretch,
    turns: Turns,
    /// Samples at the centres of the kernels, evenly spaced.
    grid: Vec<usize>,
    /// Those of the grid that become rows.
    rows: Vec<usize>,
}

impl Piece<'_> {
    /// Samples at the centres of the rows.
    fn middles(&self) -> impl Iterator<Item = usize> {
        self.rows.iter().map(|row| self.grid[*row])
    }
}

/// The rows of a run.
pub(super) struct Rows<'a> {
    pub filter: Filter,
    /// The law that locates the reversals.
    pub law: Law,
    period_s: f64,
    pieces: Vec<Piece<'a>>,
    pub span: Span,
    /// Force that the law must explain \[N\].
    pub force: Vec<f64>,
    /// Acceleration, velocity, its sign, one.
    pub base: [Vec<f64>; 4],
    /// Rows per independent observation.
    pub per_observation: f64,
    /// Fraction of the rows left after excluding rest.
    pub kept: f64,
}

impl<'a> Rows<'a> {
    /// Rows for all samples in motion, with reversals located by this law and the causes found; the filter may depend
    /// on how often each stroke has repeated.
    pub fn of(
        series: &'a Series,
        law: Law,
        found: &[Found],
        settings: &Settings,
        filter: impl FnOnce(f64) -> Filter,
    ) -> Self {
        let period_s = series.period_s;
        let from_s = series.stretches.first().map_or(0.0, |stretch| stretch.start_s);
        let end = |stretch: &Stretch| stretch.start_s + stretch.force_n.len() as f64 * period_s;
        let to_s = series.stretches.last().map_or(from_s, end);
        let mut span = Span { from_s, duration_s: to_s - from_s, ..Span::default() };
        let located = series.stretches.iter().map(|stretch| {
            let friction = |moment: &Moment| {
                let time = span.time(stretch.start_s + moment.at * period_s);
                let beside = found.iter().map(|Found { term, sizes, .. }| {
                    let [first, second] = term.at(moment, &law, time, -moment.sign);
                    sizes[0] * first + sizes[1] * second
                });
                law.coulomb_n * moment.sign + beside.sum::<f64>()
            };
            (stretch, Turns::with(stretch, period_s, &law, &friction))
        });
        let located: Vec<(&Stretch, Turns)> = located.collect();
        // Friction that may hold the screw at rest.
        let surplus = found.iter().filter(|one| one.term.kind() == Kind::Stribeck).map(|one| one.sizes[0]);
        let rest_n = (law.coulomb_n + surplus.sum::<f64>()).abs();
        let filter = filter(repeats(&located, settings));
        let kernels = &filter.kernels;
        let middle_reach = kernels.reach() + kernels.box_samples;
        let wide = filter.whitening.len() / 2;
        let reach = middle_reach + wide * filter.spacing;
        let thinned = series.len().div_ceil(filter.spacing * MOST_ROWS).max(1);
        let mut could = 0_usize;
        let pieces = located.into_iter().map(|(stretch, turns)| {
            let mut still = still(stretch, &turns, period_s, settings, law.offset_n, rest_n);
            if kernels.box_samples as f64 * period_s > FAST_BOX_S {
                keep_step(stretch, kernels.box_samples, settings.metres_per_count.abs(), &mut still);
            }
            let rests: Vec<usize> = still.iter().enumerate().filter(|(_, still)| **still).map(|(at, _)| at).collect();
            let length = stretch.force_n.len();
            let grid: Vec<usize> =
                (middle_reach..length.saturating_sub(middle_reach)).step_by(filter.spacing).collect();
            let mut rows: Vec<usize> = (wide..grid.len().saturating_sub(wide)).step_by(thinned).collect();
            could += rows.len();
            rows.retain(|row| {
                let ends = [grid[*row].saturating_sub(reach), grid[*row] + reach];
                let [before, within] = ends.map(|end| rests.partition_point(|at| *at < end));
                before == within
            });
            Piece { stretch, turns, grid, rows }
        });
        let pieces: Vec<Piece> = pieces.collect();
        let moving = pieces.iter().flat_map(|piece| piece.middles().map(|middle| &piece.turns.moments[middle]));
        let moving: Vec<&Moment> = moving.collect();
        let count = moving.len().max(1) as f64;
        let (low, high) = ends(moving.iter().map(|moment| moment.position_m));
        span.stroke_m = (high - low).max(0.0);
        span.middle_m = 0.5 * (high + low);
        span.velocity_rms = (moving.iter().map(|moment| moment.velocity * moment.velocity).sum::<f64>() / count).sqrt();
        span.force_n = moving.iter().map(|moment| (moment.force_n - law.offset_n).abs()).fold(0.0, f64::max);
        let rows_apart = (filter.spacing * thinned) as f64;
        let per_observation = (CORRELATION_BOXES * kernels.box_samples as f64 / rows_apart).max(1.0);
        let kept = moving.len() as f64 / could.max(1) as f64;
        let empty = [const { Vec::new() }; 4];
        let mut rows =
            Self { filter, law, period_s, pieces, span, force: Vec::new(), base: empty, per_observation, kept };
        let kernels = &rows.filter.kernels;
        let force =
            rows.filtered(|_, piece, middle| kernels.measured(piece.stretch, settings, middle).on_screw_n(settings));
        let position = |taps| rows.filtered(|_, piece, middle| around(taps, &piece.stretch.position_m, middle));
        let (acceleration, velocity) = (position(&kernels.second), position(&kernels.rate));
        let sign = rows.filtered(|_, piece, middle| around(&kernels.sign, &piece.turns.signs, middle));
        let one = vec![1.0; force.len()];
        rows.force = force;
        rows.base = [acceleration, velocity, sign, one];
        rows
    }

    /// The whitened values, one per row, of a quantity on the grid; pieces are numbered.
    fn filtered(&self, at: impl Fn(usize, &Piece, usize) -> f64) -> Vec<f64> {
        let whitening = &self.filter.whitening;
        let mut column = Vec::new();
        for (number, piece) in self.pieces.iter().enumerate() {
            if whitening.len() == 1 {
                column.extend(piece.middles().map(|middle| at(number, piece, middle)));
            } else {
                let along: Vec<f64> = piece.grid.iter().map(|middle| at(number, piece, *middle)).collect();
                column.extend(piece.rows.iter().map(|row| around(whitening, &along, *row)));
            }
        }
        column
    }

    /// The force's second derivative.
    pub fn curvature(&self) -> Vec<f64> {
        self.filtered(|_, piece, middle| around(&self.filter.kernels.second, &piece.stretch.force_n, middle))
    }

    /// Mean square of the noise in a column of this term, and its mean product with the noise of the row's force.
    pub fn noise(&self, term: Term) -> [f64; 2] {
        let inertance_kg = self.law.inertance_kg;
        match term {
            Term::Load => [self.filter.noise_square, 0.0],
            Term::Skew => [self.filter.rate_square, 0.0],
            Term::Bent => [inertance_kg.powi(2) * self.filter.bend_square, -inertance_kg * self.filter.bend_with_force],
            Term::Structure(time_s) => {
                let Filter { bend_square, third_square, bend_with_force, .. } = self.filter;
                [bend_square + time_s * time_s * third_square, bend_with_force]
            }
            Term::Told(shape, most_n) => [self.filter.noise_square * self.slope_square(shape, most_n), 0.0],
            _ => [0.0; 2],
        }
    }

    /// Mean square of the factor by which a measurement error scales the force's noise.
    fn slope_square(&self, shape: Shape, most_n: f64) -> f64 {
        if shape == Shape::Hysteresis {
            return HYSTERESIS.powi(-2);
        }
        let part = self.filter.noise_n / most_n;
        let squares = self.pieces.iter().flat_map(|piece| {
            piece.middles().filter_map(|middle| {
                let force = (piece.stretch.force_n.get(middle)? - self.law.offset_n) / most_n;
                Some(((shape.of(force + part) - shape.of(force - part)) / (2.0 * part)).powi(2))
            })
        });
        squares.sum::<f64>() / self.force.len().max(1) as f64
    }

    /// The columns of a term, one value per row.
    pub fn columns(&self, term: Term) -> Vec<Vec<f64>> {
        (0..term.width()).map(|number| self.column(term, number)).collect()
    }

    fn column(&self, term: Term, number: usize) -> Vec<f64> {
        match term {
            Term::Drift => self.timed(&self.base[3]),
            Term::Warming => self.timed(&self.base[2]),
            Term::Thinning => self.timed(&self.base[1]),
            Term::Structure(time_s) => {
                let third = &self.filter.kernels.third;
                let third = self.filtered(|_, piece, middle| around(third, &piece.stretch.force_n, middle));
                self.curvature().into_iter().zip(third).map(|(second, third)| second - time_s * third).collect()
            }
            _ => {
                let signals: Vec<Vec<f64>> = self.pieces.iter().map(|piece| self.signal(term, number, piece)).collect();
                self.filtered(|piece, _, middle| self.through_kernel(term, &signals[piece], middle))
            }
        }
    }

    /// The signal of a term's column in a stretch.
    fn signal(&self, term: Term, number: usize, piece: &Piece) -> Vec<f64> {
        let Piece { stretch: Stretch { position_m, force_n, .. }, turns, .. } = piece;
        match term {
            Term::Ripple(period_m) | Term::Uneven(period_m) | Term::Wobble(period_m) => {
                let wave: fn(f64) -> f64 = if number == 0 { f64::sin } else { f64::cos };
                let waves = position_m.iter().map(|x| wave(TAU * x / period_m));
                match term {
                    Term::Uneven(_) => waves.zip(&turns.signs).map(|(wave, sign)| wave * sign).collect(),
                    _ => waves.collect(),
                }
            }
            Term::Spring(middle_m) => position_m.iter().map(|x| x - middle_m).collect(),
            Term::Relaxing(time_s) => relaxing(position_m, time_s / self.period_s).collect(),
            Term::Told(Shape::Hysteresis, most_n) => {
                lagging(force_n, HYSTERESIS * most_n).map(|lag| lag / HYSTERESIS).collect()
            }
            Term::Told(shape, most_n) => {
                force_n.iter().map(|force| most_n * shape.of((force - self.law.offset_n) / most_n)).collect()
            }
            Term::Bent | Term::Skew => force_n.clone(),
            // The path.
            Term::Speed => {
                let steps = position_m.iter().zip(position_m.iter().skip(1)).zip(turns.signs.windows(2));
                let further = steps.scan(0.0, |path, ((a, b), signs)| {
                    *path += (b - a) * 0.5 * signs.iter().sum::<f64>();
                    Some(*path)
                });
                std::iter::once(0.0).chain(further).collect()
            }
            _ => {
                let turned = turned(&turns.reversals, term);
                turns.means(|moment| {
                    let turned = turned.get(moment.stroke).copied().unwrap_or(moment.sign);
                    term.at(moment, &self.law, 0.0, turned)[0]
                })
            }
        }
    }

    /// What the kernel of a term makes of its signal.
    fn through_kernel(&self, term: Term, signal: &[f64], middle: usize) -> f64 {
        let kernels = &self.filter.kernels;
        let by = |taps: &[f64]| around(taps, signal, middle);
        match term {
            // The effect of a position error through the law.
            Term::Wobble(_) | Term::Bent => {
                let inertia = self.law.inertance_kg * by(&kernels.second);
                -inertia - self.law.viscous_n_s_per_m * by(&kernels.rate)
            }
            Term::Skew => -by(&kernels.rate),
            Term::Speed => by(&kernels.rate),
            Term::Ripple(_) | Term::Spring(_) | Term::Relaxing(_) | Term::Told(..) => by(&kernels.force),
            // A mean over each sample, like the sign.
            _ => by(&kernels.sign),
        }
    }

    /// A column multiplied by the time of each row in the run.
    fn timed(&self, column: &[f64]) -> Vec<f64> {
        let middles = self
            .pieces
            .iter()
            .flat_map(|piece| piece.middles().map(|middle| piece.stretch.start_s + middle as f64 * self.period_s));
        column.iter().zip(middles).map(|(value, t_s)| value * self.span.time(t_s)).collect()
    }
}

/// How often each stroke has repeated sample by sample, as the device counts it.
fn repeats(located: &[(&Stretch, Turns)], settings: &Settings) -> f64 {
    let code_m = settings.metres_per_count / settings.oversampling;
    let mut repeats = Repeats::new();
    for (stretch, turns) in located {
        let mut next = turns.reversals.iter().map(|reversal| reversal.at.round() as usize).peekable();
        let mut sum = 0_i32;
        for (n, position) in stretch.position_m.iter().enumerate() {
            let codes = (position / code_m).round() as i64 as i32;
            sum = sum.wrapping_add(codes);
            if next.next_if_eq(&n).is_some() {
                repeats.push(n as u32, codes, sum, settings.oversampling as u32);
            }
        }
    }
    let (strokes, squares) = repeats.strokes_and_squares();
    if strokes == 0 { 1.0 } else { squares as f64 / f64::from(strokes) }
}

/// The relaxing part of a signal's travel, with this time constant \[samples\].
fn relaxing(signal: &[f64], time: f64) -> impl Iterator<Item = f64> {
    let kept = (-1.0 / time).exp();
    let steps = signal.iter().zip(signal.iter().take(1).chain(signal));
    steps.scan(0.0, move |left, (now, before)| {
        *left = kept * *left + time * (1.0 - kept) * (now - before);
        Some(*left)
    })
}

/// By how much a signal leads one that follows it with this play.
fn lagging(signal: &[f64], play: f64) -> impl Iterator<Item = f64> {
    let follows = move |at: &mut Option<f64>, now: &f64| {
        let follower = at.unwrap_or(*now).clamp(now - 0.5 * play, now + 0.5 * play);
        *at = Some(follower);
        Some(now - follower)
    };
    signal.iter().scan(None, follows)
}

/// State of a gradually reversing friction at the start of each stroke.
fn turned(reversals: &[Reversal], term: Term) -> Vec<f64> {
    let Some(first) = reversals.first() else { return Vec::new() };
    let mut now = -first.sign;
    // Before the first reversal, and after it.
    let mut turned = vec![now; 2];
    for (before, reversal) in reversals.iter().zip(&reversals[1..]) {
        now = term.turned(before.sign, now, (reversal.position_m - before.position_m).abs());
        turned.push(now);
    }
    turned
}

/// Samples that are left out, as by the device: where the screw stands still, where it reverses so slowly that static
/// friction of this size \[N\] may hold it, and where the time of a reversal is unknown.
fn still(
    stretch: &Stretch,
    turns: &Turns,
    period_s: f64,
    settings: &Settings,
    offset_n: f64,
    rest_n: f64,
) -> Vec<bool> {
    let count_m = settings.metres_per_count.abs();
    let window = (REST_WINDOW_S / period_s).ceil() as usize;
    let positions = &stretch.position_m;
    let mut still = vec![false; positions.len()];
    // Friction that has held the screw can do so again.
    let mut rest_n = rest_n;
    for (at, (seen, force)) in positions.windows(window + 1).zip(stretch.force_n.windows(window + 1)).enumerate() {
        if stands(seen, settings) {
            mark(&mut still, at.saturating_sub(window / 2), 2 * window);
            rest_n = rest_n.max((mean(force) - offset_n).abs());
        }
    }
    for (at, seen) in positions.windows(window + 1).enumerate() {
        let middle = at + window / 2;
        let force = (stretch.force_n[middle] - offset_n).abs();
        if (seen[window] - seen[0]).abs() <= GRAZING_COUNTS * count_m && force < WEAK * rest_n {
            still[middle] = true;
        }
    }
    // If friction can hold a screw that reverses, or hardly moves, it may have stuck briefly.
    let slow = SLOW * velocity_noise(count_m, period_s);
    for ((still, sign), moment) in still.iter_mut().zip(&turns.signs).zip(&turns.moments) {
        let may_stick = sign.abs() < 1.0 || moment.velocity.abs() < slow;
        *still |= may_stick && (moment.force_n - offset_n).abs() < 0.5 * WEAK * rest_n;
    }
    for reversal in turns.reversals.iter().filter(|reversal| !reversal.is_located) {
        mark(&mut still, reversal.at.floor().max(0.0) as usize, 2);
    }
    still
}

/// Where the screw moves a whole number of counts, 1 or more, in each sample for the length of a box: there the
/// encoder's error stays constant as at rest, and is not noise. In motion too fast for the slow bank no velocity lasts
/// that long.
fn keep_step(stretch: &Stretch, box_samples: usize, count_m: f64, still: &mut [bool]) {
    for (at, seen) in stretch.position_m.windows(box_samples + 1).enumerate() {
        let (first, last) = (seen[0], seen[box_samples]);
        let each = ((last - first) / (count_m * box_samples as f64)).round();
        let off = |(n, position): (usize, &f64)| (position - first) / count_m - each * n as f64;
        let is_near = |off: f64| off.abs() < 1.5;
        if each != 0.0 && is_near(off((box_samples, &last))) && seen.iter().enumerate().map(off).all(is_near) {
            mark(still, at, box_samples);
        }
    }
}
