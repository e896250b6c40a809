//! What could be added to the law: signals, sample by sample, brought through the estimator's kernels.

use std::f64::consts::TAU;

use inerter_core::{
    Settings,
    constants::{CORRELATION_BOXES, REST_WINDOW_S},
};
use inerter_data::series::{Series, Stretch};

use super::kind::Kind;
use crate::law::{Kernels, Law, around, signs, stands, velocities};

/// Encoder counts per turn that are in use; each has its own lead.
const COUNTS_PER_TURN: [f64; 22] = [
    400.0, 800.0, 1000.0, 1024.0, 1440.0, 1600.0, 2000.0, 2048.0, 2400.0, 4000.0, 4096.0, 5000.0, 7200.0, 8000.0,
    8192.0, 10_000.0, 14_400.0, 16_384.0, 20_000.0, 32_768.0, 65_536.0, 131_072.0,
];
/// Turns that the screw must make at least.
const LEAST_TURNS: f64 = 0.3;
/// Counts in a period of the encoder's lines.
const COUNTS_PER_LINE: f64 = 4.0;
/// Velocities over which friction falls, in parts of the motion's rms.
const FALLS: [f64; 7] = [0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0];
/// Distances over which friction turns, in parts of the motion's stroke.
const TURNS: [f64; 8] = [0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1];
/// Friction per force beyond which a screw locks itself.
const MOST_LOAD: f64 = 0.5;
/// Travel across a window \[counts\] and force per Coulomb friction under which a reversal is grazing.
const GRAZING_COUNTS: f64 = 4.0;
const WEAK: f64 = 3.0;
/// Friction at rest beyond that in motion, in parts of it.
const MOST_SURPLUS: f64 = 2.0;
/// What friction changes by at a reversal, in parts of what the law found of it, which may be little.
const MOST_TURN: f64 = 8.0;
/// Skew that is worth a word \[s\].
const LEAST_SKEW_S: f64 = 20e-6;
/// Rows at most: further ones are taken from evenly spaced places.
const MOST_ROWS: usize = 20_000;
/// Rows of a box.
const PER_BOX: usize = 2;

/// A group of columns that come together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Candidate {
    pub kind: Kind,
    pub term: Term,
}

/// What is added to the law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Term {
    /// `|F - F0| s`.
    Load,
    /// `sin, cos 2 pi x / L`.
    Ripple(f64),
    /// The same times `s`.
    Uneven(f64),
    /// A position that is wrong by `sin, cos 2 pi x / L`.
    Wobble(f64),
    /// `s exp(-|v| / v0)`.
    Falling(f64),
    /// `s exp(-(v / v0)^2)`.
    Bell(f64),
    /// `s exp(-|x - x at the last reversal| / x0)`.
    Turning(f64),
    /// `t` over the run.
    Drift,
    /// `s t`, likewise.
    Warming,
    /// `v t`, likewise.
    Thinning,
    /// `-F'`.
    Skew,
    /// `|v|`.
    Speed,
}

impl Candidate {
    /// The same with another length or velocity.
    pub fn scaled(self, factor: f64) -> Option<Self> {
        let term = match self.term {
            Term::Falling(velocity) => Term::Falling(velocity * factor),
            Term::Bell(velocity) => Term::Bell(velocity * factor),
            Term::Turning(distance) => Term::Turning(distance * factor),
            _ => return None,
        };
        Some(Self { term, ..self })
    }

    /// Whether its size can be that of a machine, in the term's own unit.
    pub fn can_be(self, size: f64, law: &Law) -> bool {
        let coulomb_n = law.coulomb_n.abs();
        match self.term {
            Term::Load => (0.0..MOST_LOAD).contains(&size),
            Term::Falling(_) | Term::Bell(_) => (0.0..MOST_SURPLUS * coulomb_n).contains(&size),
            // Friction comes late.
            Term::Turning(_) => (-MOST_TURN * coulomb_n..0.0).contains(&size),
            // Friction at the reversals looks like a skew of some microseconds (docs/THEORY.md, 7).
            Term::Skew => size.abs() >= LEAST_SKEW_S,
            _ => true,
        }
    }

    /// Everything that is tried in this run, and a force once a turn where the screw makes too small a part of one for that.
    pub fn all_for(span: &Span, settings: &Settings) -> Vec<Self> {
        let mut all = Self::all(span, settings, None);
        let leads = COUNTS_PER_TURN.iter().map(|counts| counts * settings.metres_per_count.abs());
        let hidden = leads.filter(|lead| span.stroke_m <= LEAST_TURNS * lead).min_by(f64::total_cmp);
        all.extend(hidden.map(|lead_m| Self { kind: Kind::PositionPeriodic, term: Term::Ripple(lead_m) }));
        all
    }

    /// Everything that is tried in this run.
    pub fn all(span: &Span, settings: &Settings, counts_per_turn: Option<f64>) -> Vec<Self> {
        let one = |kind, term| Self { kind, term };
        let mut all = vec![
            one(Kind::LoadDependent, Term::Load),
            one(Kind::Drift, Term::Drift),
            one(Kind::Drift, Term::Warming),
            one(Kind::Drift, Term::Thinning),
            one(Kind::Skew, Term::Skew),
            one(Kind::Direction, Term::Speed),
        ];
        let count_m = settings.metres_per_count.abs();
        let known = counts_per_turn.as_ref().map_or(&COUNTS_PER_TURN[..], std::slice::from_ref);
        for lead_m in known.iter().map(|counts| counts * count_m).filter(|lead| span.stroke_m > LEAST_TURNS * lead) {
            all.push(one(Kind::PositionPeriodic, Term::Ripple(lead_m)));
            all.push(one(Kind::PositionPeriodic, Term::Uneven(lead_m)));
            all.push(one(Kind::EncoderError, Term::Wobble(lead_m)));
        }
        all.push(one(Kind::EncoderError, Term::Wobble(COUNTS_PER_LINE * count_m)));
        for velocity in FALLS.map(|part| part * span.velocity_rms) {
            all.push(one(Kind::Stribeck, Term::Falling(velocity)));
            all.push(one(Kind::Stribeck, Term::Bell(velocity)));
        }
        all.extend(TURNS.map(|part| one(Kind::Presliding, Term::Turning(part * span.stroke_m))));
        all
    }
}

/// What the whole run covers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub from_s: f64,
    pub duration_s: f64,
    pub stroke_m: f64,
    pub velocity_rms: f64,
}

/// A stretch with what is needed of it for every term.
struct Piece<'a> {
    stretch: &'a Stretch,
    signs: Vec<f64>,
    /// Samples in the middle of the rows.
    middles: Vec<usize>,
}

/// The rows of a run.
pub(super) struct Rows<'a> {
    kernels: Kernels,
    /// The law that signs are placed by.
    pub law: Law,
    period_s: f64,
    pieces: Vec<Piece<'a>>,
    pub span: Span,
    /// Force that the law must explain \[N\].
    pub force: Vec<f64>,
    /// Acceleration, velocity, its sign, one.
    pub base: [Vec<f64>; 4],
    /// Rows that one independent observation has.
    pub per_observation: f64,
}

impl<'a> Rows<'a> {
    /// Of all samples in motion, with signs placed by this law.
    pub fn of(series: &'a Series, settings: &Settings, kernels: Kernels, law: Law) -> Self {
        let period_s = series.period_s;
        let reach = kernels.reach() + kernels.box_samples;
        let spacing = (kernels.box_samples / PER_BOX).max(1).max(series.len() / MOST_ROWS);
        let (mut force, mut base) = (Vec::new(), [const { Vec::new() }; 4]);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut pieces = Vec::new();
        for stretch in &series.stretches {
            let signs = signs(stretch, period_s, &law);
            let still = still(stretch, &signs, period_s, settings, &law);
            let mut middles = Vec::new();
            for middle in (reach..stretch.force_n.len().saturating_sub(reach)).step_by(spacing) {
                if still.iter().skip(middle - reach).take(2 * reach).any(|still| *still) {
                    continue;
                }
                let measured = kernels.measured(stretch, settings, middle);
                let sign = around(&kernels.sign, &signs, middle);
                middles.push(middle);
                force.push(measured.force_n - settings.structure_mass_kg * measured.stretch);
                let row = [measured.acceleration, measured.velocity, sign, 1.0];
                base.iter_mut().zip(row).for_each(|(column, value)| column.push(value));
                let position = stretch.position_m.get(middle).copied().unwrap_or(0.0);
                (low, high) = (low.min(position), high.max(position));
            }
            pieces.push(Piece { stretch, signs, middles });
        }
        let [_, velocity, ..] = &base;
        let square = velocity.iter().map(|v| v * v).sum::<f64>() / velocity.len().max(1) as f64;
        let from_s = series.stretches.first().map_or(0.0, |stretch| stretch.start_s);
        let end = |stretch: &Stretch| stretch.start_s + stretch.force_n.len() as f64 * period_s;
        let to_s = series.stretches.last().map_or(from_s, end);
        let span =
            Span { from_s, duration_s: to_s - from_s, stroke_m: (high - low).max(0.0), velocity_rms: square.sqrt() };
        let per_observation = (CORRELATION_BOXES * kernels.box_samples as f64 / spacing as f64).max(1.0);
        Self { kernels, law, period_s, pieces, span, force, base, per_observation }
    }

    /// Columns that a term has.
    pub fn width(term: Term) -> usize {
        if matches!(term, Term::Ripple(_) | Term::Uneven(_) | Term::Wobble(_)) { 2 } else { 1 }
    }

    /// The columns of a term, one value a row.
    pub fn columns(&self, term: Term) -> Vec<Vec<f64>> {
        let law = &self.law;
        let Span { from_s, duration_s, .. } = self.span;
        match term {
            Term::Ripple(lead_m) => self.both(lead_m, |kernels, wave, _, middle| around(&kernels.force, wave, middle)),
            Term::Uneven(lead_m) => self.both(lead_m, |kernels, wave, signs, middle| {
                let product: Vec<f64> = taken(&kernels.sign, wave, middle)
                    .zip(taken(&kernels.sign, signs, middle))
                    .map(|(wave, sign)| wave * sign)
                    .collect();
                kernels.sign.iter().zip(product).map(|(tap, value)| tap * value).sum()
            }),
            Term::Wobble(lead_m) => self.both(lead_m, |kernels, wave, _, middle| {
                let inertia = law.inertance_kg * around(&kernels.second, wave, middle);
                -inertia - law.viscous_n_s_per_m * around(&kernels.rate, wave, middle)
            }),
            Term::Load => {
                let offset_n = self.law.offset_n;
                self.signed(|piece| piece.stretch.force_n.iter().map(|force| (force - offset_n).abs()).collect())
            }
            Term::Falling(velocity) => self.by_speed(|speed| (-speed / velocity).exp()),
            Term::Bell(velocity) => self.by_speed(|speed| (-(speed / velocity).powi(2)).exp()),
            Term::Turning(distance) => self.signed(|piece| turned(piece, distance)),
            Term::Drift => self.one(|_, t_s, _| (t_s - from_s) / duration_s - 0.5),
            Term::Warming => self.one(|[_, _, sign], t_s, _| sign * ((t_s - from_s) / duration_s - 0.5)),
            Term::Thinning => self.one(|[_, velocity, _], t_s, _| velocity * ((t_s - from_s) / duration_s - 0.5)),
            Term::Skew => {
                self.one(|_, _, (kernels, piece, middle)| -around(&kernels.rate, &piece.stretch.force_n, middle))
            }
            Term::Speed => {
                let path = |piece: &Piece| {
                    let positions = &piece.stretch.position_m;
                    let mut path = 0.0;
                    let steps = positions.iter().zip(positions.iter().skip(1)).zip(&piece.signs);
                    let further = steps.map(|((a, b), sign)| {
                        path += (b - a) * sign;
                        path
                    });
                    std::iter::once(0.0).chain(further).collect()
                };
                vec![self.through(path, |kernels, path, _, middle| around(&kernels.rate, path, middle))]
            }
        }
    }

    /// A signal of each stretch through a kernel.
    fn through(
        &self,
        signal: impl Fn(&Piece) -> Vec<f64>,
        kernel: impl Fn(&Kernels, &[f64], &[f64], usize) -> f64,
    ) -> Vec<f64> {
        let each = self.pieces.iter().flat_map(|piece| {
            let signal = signal(piece);
            let rows: Vec<f64> =
                piece.middles.iter().map(|middle| kernel(&self.kernels, &signal, &piece.signs, *middle)).collect();
            rows
        });
        each.collect()
    }

    /// What has the sign of the velocity.
    fn signed(&self, size: impl Fn(&Piece) -> Vec<f64>) -> Vec<Vec<f64>> {
        let signal = |piece: &Piece| size(piece).iter().zip(&piece.signs).map(|(size, sign)| size * sign).collect();
        vec![self.through(signal, |kernels, signal, _, middle| around(&kernels.sign, signal, middle))]
    }

    /// What has the sign of the velocity and depends on the speed.
    fn by_speed(&self, size: impl Fn(f64) -> f64) -> Vec<Vec<f64>> {
        self.signed(|piece| {
            let mean = |(before, after): (f64, f64)| size(0.5 * (before + after).abs());
            let sizes = velocities(piece.stretch, self.period_s, &self.law).map(mean);
            sizes.map(|size| if size.is_nan() { 0.0 } else { size }).collect()
        })
    }

    /// Sine and cosine of the position.
    fn both(&self, lead_m: f64, kernel: impl Fn(&Kernels, &[f64], &[f64], usize) -> f64 + Copy) -> Vec<Vec<f64>> {
        let wave = |function: fn(f64) -> f64| {
            move |piece: &Piece| piece.stretch.position_m.iter().map(|x| function(TAU * x / lead_m)).collect()
        };
        vec![self.through(wave(f64::sin), kernel), self.through(wave(f64::cos), kernel)]
    }

    /// By acceleration, velocity and sign, and time.
    fn one(&self, value: impl Fn([f64; 3], f64, (&Kernels, &Piece, usize)) -> f64) -> Vec<Vec<f64>> {
        let [acceleration, velocity, sign, _] = &self.base;
        let mut base = acceleration.iter().zip(velocity).zip(sign);
        let mut column = Vec::with_capacity(self.force.len());
        for piece in &self.pieces {
            for middle in &piece.middles {
                let Some(((a, v), s)) = base.next() else { break };
                let t_s = piece.stretch.start_s + *middle as f64 * self.period_s;
                column.push(value([*a, *v, *s], t_s, (&self.kernels, piece, *middle)));
            }
        }
        vec![column]
    }
}

/// Where the screw stands, or turns so gently that friction may hold it, as the device leaves it out.
fn still(stretch: &Stretch, signs: &[f64], period_s: f64, settings: &Settings, law: &Law) -> Vec<bool> {
    let count_m = settings.metres_per_count.abs();
    let window = (REST_WINDOW_S / period_s).ceil() as usize;
    let positions = &stretch.position_m;
    let mut still = vec![false; positions.len()];
    for (at, seen) in positions.windows(window + 1).enumerate() {
        if stands(seen, settings) {
            still.iter_mut().skip(at.saturating_sub(window / 2)).take(2 * window).for_each(|still| *still = true);
        }
        let travel = seen.last().zip(seen.first()).map_or(0.0, |(last, first)| (last - first).abs());
        let middle = at + window / 2;
        let force = stretch.force_n.get(middle).map_or(0.0, |force| (force - law.offset_n).abs());
        if travel <= GRAZING_COUNTS * count_m && force < WEAK * law.coulomb_n.abs() {
            still.iter_mut().skip(middle).take(1).for_each(|still| *still = true);
        }
    }
    // A reversal that friction can hold is one that may have stuck for a moment.
    for ((still, sign), force) in still.iter_mut().zip(signs).zip(&stretch.force_n) {
        *still |= sign.abs() < 1.0 && (force - law.offset_n).abs() < 0.5 * WEAK * law.coulomb_n.abs();
    }
    still
}

/// The samples that taps lie over.
fn taken<'a>(taps: &[f64], data: &'a [f64], middle: usize) -> impl Iterator<Item = f64> + use<'a> {
    data.iter().skip(middle.saturating_sub(taps.len() / 2)).take(taps.len()).copied()
}

/// How much of the way since the last reversal is still to go, as an exponential.
fn turned(piece: &Piece, distance_m: f64) -> Vec<f64> {
    let (mut from, mut last) = (f64::NAN, 0.0_f64);
    let each = piece.stretch.position_m.iter().zip(&piece.signs).map(|(position, sign)| {
        if sign * last < 0.0 {
            from = *position;
        }
        if *sign != 0.0 {
            last = *sign;
        }
        if from.is_nan() { 0.0 } else { (-(position - from).abs() / distance_m).exp() }
    });
    each.collect()
}
