//! What could be added to the law.

use std::f64::consts::TAU;

use inerter_core::Settings;

use super::kind::Kind;
use crate::{
    law::{FALLS, Law, MOST_LOAD, TURNS},
    reversals::Moment,
};

/// Encoder counts per turn that are in use; each has its own lead.
const COUNTS_PER_TURN: [f64; 22] = [
    400.0, 800.0, 1000.0, 1024.0, 1440.0, 1600.0, 2000.0, 2048.0, 2400.0, 4000.0, 4096.0, 5000.0, 7200.0, 8000.0,
    8192.0, 10_000.0, 14_400.0, 16_384.0, 20_000.0, 32_768.0, 65_536.0, 131_072.0,
];
/// Turns that the screw must make at least.
const LEAST_TURNS: f64 = 0.3;
/// Counts in a period of the encoder's lines, where nothing is said.
const COUNTS_PER_LINE: f64 = 4.0;
/// Friction at rest beyond that in motion, in parts of it.
const MOST_SURPLUS: f64 = 2.0;
/// What turns over a distance, in parts of what the law found of Coulomb friction, which may be little.
const MOST_TURN: f64 = 4.0;
/// Times in which a force lets go, in parts of the one that the motion needs for its stroke.
const RELAXES: [f64; 3] = [0.1, 0.3, 1.0];
/// Force over which a loose cell turns, and width of a hysteresis, in parts of the greatest.
const DEAD: f64 = 0.02;
pub(super) const HYSTERESIS: f64 = 0.02;
/// Forces from which on an amplifier may have another range, likewise.
const RANGES: [f64; 3] = [0.35, 0.5, 0.7];
/// Part by which a force may be told wrong: what is nearly the force itself would explain all.
const MOST_WRONG: f64 = 0.25;
/// A mass on the terminal and the contact that it hangs on resonate at this frequency at least \[Hz\].
const LEAST_RESONANCE_HZ: f64 = 30.0;
/// Times of the contact: its damping over its stiffness \[s\].
const LETS_GO_S: [f64; 3] = [1e-4, 5e-4, 2e-3];
/// Skew that is worth a word \[s\].
const LEAST_SKEW_S: f64 = 20e-6;

/// What is known of the encoder beside the settings.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Encoder {
    /// Counts per turn of the screw; where they are not known, those that are usual are tried.
    pub counts_per_turn: Option<f64>,
    /// Counts in a period of its lines; 4 where they are not known.
    pub counts_per_line: Option<f64>,
}

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
    /// `z - s`, with `z' = |v| (s - z) / x0`: Dahl's.
    Turning(f64),
    /// `z - s`, with `z' = 2 (1 - 1/e) v / x0` up to `|z| = 1`: a spring that slips.
    Bending(f64),
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
    /// `v |v|`.
    Square,
    /// `x` from this place on.
    Spring(f64),
    /// The same where it lets go with this time \[s\], as a damper behind a spring.
    Relaxing(f64),
    /// A position that is too far by the force.
    Bent,
    /// `F'' - t0 F'''`: what a mass on the terminal takes more than on the screw, as the contact gives way with this
    /// time \[s\].
    Structure(f64),
    /// What a force of this size at most \[N\] is told wrong by, of unit size at most.
    Told(Shape, f64),
}

/// How a force is told wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    /// By its square.
    Bow,
    /// By its third power, as where it saturates.
    Cube,
    /// By as much either way, as of a cell that sits loose.
    Dead,
    /// In proportion from this part of the greatest on, as of an amplifier that switches its range.
    Range(f64),
    /// By which way it goes.
    Hysteresis,
}

impl Term {
    /// What it adds to dry friction and offset at a moment, of unit size; `time` is that of the run, -0.5 to 0.5,
    /// `turned` what has turned at the last reversal. A skew and an error of the encoder are no force.
    pub fn at(self, moment: &Moment, law: &Law, time: f64, turned: f64) -> [f64; 2] {
        let Moment { sign, velocity, gone_m, force_n, position_m, .. } = *moment;
        let turns = |lead_m: f64| (TAU * position_m / lead_m).sin_cos();
        match self {
            Self::Load => [(force_n - law.offset_n).abs() * sign, 0.0],
            Self::Ripple(lead_m) => turns(lead_m).into(),
            Self::Uneven(lead_m) => {
                let (sin, cos) = turns(lead_m);
                [sign * sin, sign * cos]
            }
            Self::Falling(fall) => [sign * (-velocity.abs() / fall).exp(), 0.0],
            Self::Bell(fall) => [sign * (-(velocity / fall).powi(2)).exp(), 0.0],
            Self::Turning(_) | Self::Bending(_) => [self.turned(sign, turned, gone_m) - sign, 0.0],
            Self::Drift => [time, 0.0],
            Self::Warming => [sign * time, 0.0],
            Self::Thinning => [velocity * time, 0.0],
            Self::Speed => [velocity.abs(), 0.0],
            Self::Square => [velocity * velocity.abs(), 0.0],
            Self::Spring(middle_m) => [position_m - middle_m, 0.0],
            Self::Told(shape, most_n) => [most_n * shape.of((force_n - law.offset_n) / most_n), 0.0],
            // What lets go depends on all that was before.
            Self::Skew | Self::Wobble(_) | Self::Bent | Self::Structure(_) | Self::Relaxing(_) => [0.0; 2],
        }
    }

    /// What has turned of a friction that turns, so far from a reversal at which it was `turned`.
    pub fn turned(self, sign: f64, turned: f64, gone_m: f64) -> f64 {
        match self {
            Self::Turning(distance_m) => sign + (turned - sign) * (-gone_m / distance_m).exp(),
            Self::Bending(distance_m) => {
                let way = 2.0 * (1.0 - (-1.0_f64).exp()) * gone_m / distance_m;
                (turned + sign * way).clamp(-1.0, 1.0)
            }
            _ => sign,
        }
    }

    /// Columns that it has.
    pub fn width(self) -> usize {
        if self.period_m().is_some() { 2 } else { 1 }
    }

    /// The length of a turn, or of an encoder's line, that it repeats with \[m\].
    pub fn period_m(self) -> Option<f64> {
        match self {
            Self::Ripple(period_m) | Self::Uneven(period_m) | Self::Wobble(period_m) => Some(period_m),
            _ => None,
        }
    }

    /// Its velocity or distance where that is sought.
    pub fn scale(self) -> Option<f64> {
        match self {
            Self::Falling(scale) | Self::Bell(scale) | Self::Turning(scale) | Self::Bending(scale) => Some(scale),
            Self::Structure(time_s) => Some(time_s),
            _ => None,
        }
    }

    /// The same with another velocity or distance.
    pub fn with_scale(self, scale: f64) -> Self {
        match self {
            Self::Falling(_) => Self::Falling(scale),
            Self::Bell(_) => Self::Bell(scale),
            Self::Turning(_) => Self::Turning(scale),
            Self::Bending(_) => Self::Bending(scale),
            Self::Structure(_) => Self::Structure(scale),
            other => other,
        }
    }

    /// The other law by which the same may go.
    pub fn other_shape(self) -> Option<Self> {
        match self {
            Self::Falling(velocity) => Some(Self::Bell(1.5 * velocity)),
            Self::Bell(velocity) => Some(Self::Falling(velocity / 1.5)),
            Self::Turning(distance) => Some(Self::Bending(distance)),
            Self::Bending(distance) => Some(Self::Turning(distance)),
            _ => None,
        }
    }
}

impl Shape {
    /// What is told too much, of a force of unit size at most.
    pub fn of(self, force: f64) -> f64 {
        match self {
            Self::Bow => force * force,
            Self::Cube => force.powi(3),
            Self::Dead => (force / DEAD).clamp(-1.0, 1.0),
            Self::Range(from) if force.abs() > from => force,
            // Which way it goes is not told by one moment.
            Self::Range(_) | Self::Hysteresis => 0.0,
        }
    }
}

impl Candidate {
    /// Whether its size can be that of a machine, in the term's own unit.
    pub fn can_be(self, size: f64, law: &Law) -> bool {
        let coulomb_n = law.coulomb_n.max(0.0);
        match self.term {
            Term::Load => (0.0..MOST_LOAD).contains(&size),
            Term::Falling(_) | Term::Bell(_) => (0.0..MOST_SURPLUS * coulomb_n).contains(&size),
            Term::Turning(_) | Term::Bending(_) => (0.0..MOST_TURN * coulomb_n).contains(&size),
            Term::Square | Term::Bent => size > 0.0,
            Term::Structure(_) => (0.0..(TAU * LEAST_RESONANCE_HZ).powi(-2)).contains(&size),
            Term::Told(..) => size.abs() < MOST_WRONG,
            // Friction at the reversals looks like a skew of some microseconds (docs/THEORY.md, 14).
            Term::Skew => size.abs() >= LEAST_SKEW_S,
            _ => true,
        }
    }

    /// Everything that is tried in this run, and a force once a turn where the screw makes too small a part of one for
    /// that.
    pub fn all_for(span: &Span, settings: &Settings) -> Vec<Self> {
        let mut all = Self::all(span, settings, Encoder::default());
        // The budget has a part for it.
        all.retain(|candidate| candidate.kind != Kind::Structure);
        let leads = COUNTS_PER_TURN.iter().map(|counts| counts * settings.metres_per_count.abs());
        let hidden = leads.filter(|lead| span.stroke_m <= LEAST_TURNS * lead).min_by(f64::total_cmp);
        all.extend(hidden.map(|lead_m| Self { kind: Kind::PositionPeriodic, term: Term::Ripple(lead_m) }));
        // Not sought to be named: it explains too much of a short run (docs/THEORY.md, 14).
        all.push(Self { kind: Kind::Compliance, term: Term::Bent });
        all
    }

    /// Everything that is tried in this run.
    pub fn all(span: &Span, settings: &Settings, encoder: Encoder) -> Vec<Self> {
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
        let known = encoder.counts_per_turn.as_ref().map_or(&COUNTS_PER_TURN[..], std::slice::from_ref);
        for lead_m in known.iter().map(|counts| counts * count_m).filter(|lead| span.stroke_m > LEAST_TURNS * lead) {
            let periodic = [Term::Ripple(lead_m), Term::Uneven(lead_m)];
            all.extend(periodic.map(|term| one(Kind::PositionPeriodic, term)));
            all.push(one(Kind::EncoderError, Term::Wobble(lead_m)));
        }
        let line_m = encoder.counts_per_line.unwrap_or(COUNTS_PER_LINE) * count_m;
        all.push(one(Kind::EncoderError, Term::Wobble(line_m)));
        for velocity in FALLS.map(|part| part * span.velocity_rms) {
            all.extend([Term::Falling(velocity), Term::Bell(velocity)].map(|term| one(Kind::Stribeck, term)));
        }
        for distance in TURNS.map(|part| part * span.stroke_m) {
            all.extend([Term::Turning(distance), Term::Bending(distance)].map(|term| one(Kind::Presliding, term)));
        }
        all.extend([one(Kind::QuadraticFriction, Term::Square), one(Kind::Spring, Term::Spring(span.middle_m))]);
        let relaxes = RELAXES.map(|part| Term::Relaxing(part * span.stroke_m / span.velocity_rms));
        all.extend(relaxes.map(|term| one(Kind::Spring, term)));
        let told =
            [Shape::Bow, Shape::Cube, Shape::Dead, Shape::Hysteresis].into_iter().chain(RANGES.map(Shape::Range));
        all.extend(told.map(|shape| one(Kind::ForceNonlinear, Term::Told(shape, span.force_n))));
        // With the stiffness it is known how it moves.
        if settings.stiffness_n_per_m == 0.0 {
            all.extend(LETS_GO_S.map(|time_s| one(Kind::Structure, Term::Structure(time_s))));
        }
        all
    }
}

/// What the whole run covers.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Span {
    pub from_s: f64,
    pub duration_s: f64,
    pub stroke_m: f64,
    pub middle_m: f64,
    pub velocity_rms: f64,
    /// The greatest, from the offset on.
    pub force_n: f64,
}

impl Span {
    /// A time of the run, -0.5 to 0.5.
    pub fn time(&self, t_s: f64) -> f64 {
        (t_s - self.from_s) / self.duration_s - 0.5
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: after its distance `1 - 1/e` of the way from one side to the other has gone, by either law.
    #[test]
    fn friction_turns_by_as_much_over_its_distance_by_either_law() {
        let after = 1.0 - 2.0 / std::f64::consts::E;
        for sign in [1.0, -1.0] {
            for term in [Term::Turning(1e-4), Term::Bending(1e-4)] {
                assert!((term.turned(sign, -sign, 1e-4) - sign * after).abs() < 1e-12, "{term:?}");
                assert!((term.turned(sign, -sign, 0.0) + sign).abs() < 1e-12, "{term:?}");
                assert!((term.turned(sign, -sign, 1e-2) - sign).abs() < 1e-12, "{term:?}");
            }
        }
    }

    #[test]
    fn what_no_machine_has_is_no_cause() {
        let law = Law { coulomb_n: 50.0, ..Law::default() };
        let can_be = |kind, term, size| Candidate { kind, term }.can_be(size, &law);
        assert!(can_be(Kind::LoadDependent, Term::Load, 0.04) && !can_be(Kind::LoadDependent, Term::Load, -0.04));
        let falling = Term::Falling(1e-3);
        assert!(can_be(Kind::Stribeck, falling, 15.0) && !can_be(Kind::Stribeck, falling, 101.0));
        assert!(can_be(Kind::Skew, Term::Skew, -1e-3) && !can_be(Kind::Skew, Term::Skew, 10e-6));
        assert!(can_be(Kind::Drift, Term::Drift, -5.0));
    }

    /// Turns of which the motion makes too small a part are not sought, and one that is given is the only one.
    #[test]
    fn a_turn_is_sought_where_the_motion_makes_enough_of_it() {
        let span = Span { duration_s: 20.0, stroke_m: 4e-3, velocity_rms: 0.05, ..Span::default() };
        let settings = Settings { metres_per_count: 2.5e-6, ..Settings::default() };
        let leads = |encoder| -> Vec<f64> {
            let all = Candidate::all(&span, &settings, encoder);
            all.iter().filter_map(|one| if let Term::Ripple(lead_m) = one.term { Some(lead_m) } else { None }).collect()
        };
        let usual = leads(Encoder::default());
        assert!(usual.len() > 10 && usual.iter().all(|lead_m| LEAST_TURNS * lead_m < 4e-3), "{usual:?}");
        assert_eq!(leads(Encoder { counts_per_turn: Some(777.0), ..Encoder::default() }), [777.0 * 2.5e-6]);
    }
}
