//! Terms that could be added to the law, and those that were found.

use std::f64::consts::TAU;

use inerter_core::Settings;
pub use inerter_data::causes::Kind;

use crate::{
    law::{FALLS, Law, MOST_LOAD, TURNS},
    reversals::Moment,
};

/// F statistic from which a cause is named: a run without a fault does not reach it (docs/tables/diagnose.md).
pub const LIMIT: f64 = 30.0;
/// Common encoder counts per revolution; each implies a lead.
const COUNTS_PER_TURN: [f64; 22] = [
    400.0, 800.0, 1000.0, 1024.0, 1440.0, 1600.0, 2000.0, 2048.0, 2400.0, 4000.0, 4096.0, 5000.0, 7200.0, 8000.0,
    8192.0, 10_000.0, 14_400.0, 16_384.0, 20_000.0, 32_768.0, 65_536.0, 131_072.0,
];
/// Minimum revolutions of the screw.
const LEAST_TURNS: f64 = 0.3;
/// Default encoder counts per line period.
const COUNTS_PER_LINE: f64 = 4.0;
/// Maximum excess of static over kinetic friction, as a fraction of it.
const MOST_SURPLUS: f64 = 2.0;
/// Maximum of a friction that reverses gradually, relative to the Coulomb friction of the law, which may be small.
const MOST_TURN: f64 = 4.0;
/// Relaxation times of a force, relative to the time that the motion needs for its stroke.
const RELAXES: [f64; 3] = [0.1, 0.3, 1.0];
/// Force range over which a loose cell reverses, and width of a hysteresis, relative to the largest force.
const DEAD: f64 = 0.02;
pub(super) const HYSTERESIS: f64 = 0.02;
/// Forces above which an amplifier may have another range, likewise relative.
const RANGES: [f64; 3] = [0.35, 0.5, 0.7];
/// Maximum relative error of a measured force: a term close to the force itself would explain everything.
const MOST_WRONG: f64 = 0.25;
/// A mass on the terminal and its contact resonate at this frequency or above \[Hz\].
const LEAST_RESONANCE_HZ: f64 = 30.0;
/// Time constants of the contact: its damping over its stiffness \[s\].
const LETS_GO_S: [f64; 3] = [1e-4, 5e-4, 2e-3];
/// Smallest skew worth reporting \[s\].
const LEAST_SKEW_S: f64 = 20e-6;

/// Encoder data beyond the settings.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Encoder {
    /// Counts per revolution of the screw; if unknown, common values are tried.
    pub counts_per_turn: Option<f64>,
    /// Counts per line period; 4 if unknown.
    pub counts_per_line: Option<f64>,
}

/// A term added to the law, of one column or two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Term {
    /// `|F - F0| s`.
    Load,
    /// `sin, cos 2 pi x / L`.
    Ripple(f64),
    /// The same times `s`.
    Uneven(f64),
    /// A position error `sin, cos 2 pi x / L`.
    Wobble(f64),
    /// `s exp(-|v| / v0)`.
    Falling(f64),
    /// `s exp(-(v / v0)^2)`.
    Bell(f64),
    /// `z - s`, with `z' = |v| (s - z) / x0`: the Dahl model.
    Turning(f64),
    /// `z - s`, with `z' = 2 (1 - 1/e) v / x0` up to `|z| = 1`: a spring that slips (elastoplastic).
    Bending(f64),
    /// `t` over the run.
    Drift,
    /// `s t`, with the same `t`.
    Warming,
    /// `v t`, with the same `t`.
    Thinning,
    /// `-F'`.
    Skew,
    /// `|v|`.
    Speed,
    /// `v |v|`.
    Square,
    /// `x` beyond this position.
    Spring(f64),
    /// The same, relaxing with this time constant \[s\], like a spring in series with a damper.
    Relaxing(f64),
    /// A position error proportional to the force.
    Bent,
    /// `F'' - t0 F'''`: the extra force of a mass on the terminal compared with one on the screw, because the contact
    /// yields with this time constant \[s\].
    Structure(f64),
    /// The error of a measured force whose maximum is this \[N\], scaled to unit size.
    Told(Shape, f64),
}

/// Shape of a force measurement error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    /// Quadratic.
    Bow,
    /// Cubic, as near saturation.
    Cube,
    /// A constant error with the sign of the force, as from a loose cell.
    Dead,
    /// Proportional above this fraction of the largest force, as from an amplifier that switches its range.
    Range(f64),
    /// Dependent on the direction of change.
    Hysteresis,
}

impl Term {
    /// The cause that it describes.
    pub fn kind(self) -> Kind {
        match self {
            Self::Load => Kind::LoadDependent,
            Self::Ripple(_) | Self::Uneven(_) => Kind::PositionPeriodic,
            Self::Wobble(_) => Kind::EncoderError,
            Self::Falling(_) | Self::Bell(_) => Kind::Stribeck,
            Self::Turning(_) | Self::Bending(_) => Kind::Presliding,
            Self::Drift | Self::Warming | Self::Thinning => Kind::Drift,
            Self::Skew => Kind::Skew,
            Self::Speed => Kind::Direction,
            Self::Square => Kind::QuadraticFriction,
            Self::Spring(_) | Self::Relaxing(_) => Kind::Spring,
            Self::Bent => Kind::Compliance,
            Self::Structure(_) => Kind::Structure,
            Self::Told(..) => Kind::ForceNonlinear,
        }
    }

    /// The unit of its size, or of its distance, for a linear machine.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Load | Self::Told(..) => "1",
            Self::Square => "N s2/m2",
            Self::Spring(_) | Self::Relaxing(_) => "N/m",
            Self::Bent => "m/N",
            Self::Structure(_) => "s2",
            Self::Wobble(_) | Self::Turning(_) | Self::Bending(_) => "m",
            Self::Thinning | Self::Speed => "N s/m",
            Self::Skew => "s",
            Self::Ripple(_) | Self::Uneven(_) | Self::Falling(_) | Self::Bell(_) | Self::Drift | Self::Warming => "N",
        }
    }

    /// Contribution to dry friction and offset at a moment, for unit size; `time` is that of the run, -0.5 to 0.5, and
    /// `turned` the state of a gradually reversing friction at the last reversal. A skew and an encoder error are not
    /// forces.
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
            // A relaxing force depends on the whole past.
            Self::Skew | Self::Wobble(_) | Self::Bent | Self::Structure(_) | Self::Relaxing(_) => [0.0; 2],
        }
    }

    /// State of a gradually reversing friction at this distance from a reversal where it was `turned`.
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

    /// Number of columns.
    pub fn width(self) -> usize {
        if self.period_m().is_some() { 2 } else { 1 }
    }

    /// The period over which it repeats, that of a revolution or an encoder line \[m\].
    pub fn period_m(self) -> Option<f64> {
        match self {
            Self::Ripple(period_m) | Self::Uneven(period_m) | Self::Wobble(period_m) => Some(period_m),
            _ => None,
        }
    }

    fn scale_mut(&mut self) -> Option<&mut f64> {
        match self {
            Self::Falling(velocity) | Self::Bell(velocity) => Some(velocity),
            Self::Turning(distance) | Self::Bending(distance) => Some(distance),
            Self::Structure(time_s) => Some(time_s),
            _ => None,
        }
    }

    /// Its characteristic velocity, distance or time, if that is searched for.
    pub fn scale(mut self) -> Option<f64> {
        self.scale_mut().copied()
    }

    /// The same term with another velocity, distance or time.
    pub fn with_scale(mut self, scale: f64) -> Self {
        if let Some(own) = self.scale_mut() {
            *own = scale;
        }
        self
    }

    /// The alternative shape for the same cause.
    pub fn other_shape(self) -> Option<Self> {
        match self {
            Self::Falling(velocity) => Some(Self::Bell(1.5 * velocity)),
            Self::Bell(velocity) => Some(Self::Falling(velocity / 1.5)),
            Self::Turning(distance) => Some(Self::Bending(distance)),
            Self::Bending(distance) => Some(Self::Turning(distance)),
            _ => None,
        }
    }

    /// Whether its size is plausible for a machine with this Coulomb friction \[N\], in the term's own unit.
    pub fn can_be(self, size: f64, coulomb_n: f64) -> bool {
        let coulomb_n = coulomb_n.max(0.0);
        match self.kind() {
            Kind::LoadDependent => (0.0..MOST_LOAD).contains(&size),
            Kind::Stribeck => (0.0..MOST_SURPLUS * coulomb_n).contains(&size),
            Kind::Presliding => (0.0..MOST_TURN * coulomb_n).contains(&size),
            Kind::QuadraticFriction | Kind::Compliance => size > 0.0,
            Kind::Structure => (0.0..(TAU * LEAST_RESONANCE_HZ).powi(-2)).contains(&size),
            Kind::ForceNonlinear => size.abs() < MOST_WRONG,
            // Friction at the reversals resembles a skew of some microseconds (docs/THEORY.md, 14).
            Kind::Skew => size.abs() >= LEAST_SKEW_S,
            _ => true,
        }
    }

    /// Everything that is tried in this run, and a once-per-revolution force even if the screw covers too little of a
    /// revolution for that.
    pub fn all_for(span: &Span, settings: &Settings) -> Vec<Self> {
        let mut all = Self::all(span, settings, Encoder::default());
        // The budget has a component for it.
        all.retain(|term| term.kind() != Kind::Structure);
        let leads = COUNTS_PER_TURN.iter().map(|counts| counts * settings.metres_per_count.abs());
        let hidden = leads.filter(|lead| span.stroke_m <= LEAST_TURNS * lead).min_by(f64::total_cmp);
        all.extend(hidden.map(Self::Ripple));
        // Not used to name a cause: it explains too much of a short run (docs/THEORY.md, 14).
        all.push(Self::Bent);
        all
    }

    /// Everything that is tried in this run.
    pub fn all(span: &Span, settings: &Settings, encoder: Encoder) -> Vec<Self> {
        let mut all = vec![Self::Load, Self::Drift, Self::Warming, Self::Thinning, Self::Skew, Self::Speed];
        let count_m = settings.metres_per_count.abs();
        let known = encoder.counts_per_turn.as_ref().map_or(&COUNTS_PER_TURN[..], std::slice::from_ref);
        for lead_m in known.iter().map(|counts| counts * count_m).filter(|lead| span.stroke_m > LEAST_TURNS * lead) {
            all.extend([Self::Ripple(lead_m), Self::Uneven(lead_m), Self::Wobble(lead_m)]);
        }
        all.push(Self::Wobble(encoder.counts_per_line.unwrap_or(COUNTS_PER_LINE) * count_m));
        for velocity in FALLS.map(|part| part * span.velocity_rms) {
            all.extend([Self::Falling(velocity), Self::Bell(velocity)]);
        }
        for distance in TURNS.map(|part| part * span.stroke_m) {
            all.extend([Self::Turning(distance), Self::Bending(distance)]);
        }
        all.extend([Self::Square, Self::Spring(span.middle_m)]);
        all.extend(RELAXES.map(|part| Self::Relaxing(part * span.stroke_m / span.velocity_rms)));
        let told =
            [Shape::Bow, Shape::Cube, Shape::Dead, Shape::Hysteresis].into_iter().chain(RANGES.map(Shape::Range));
        all.extend(told.map(|shape| Self::Told(shape, span.force_n)));
        // With a known stiffness its motion is known.
        if settings.stiffness_n_per_m == 0.0 {
            all.extend(LETS_GO_S.map(Self::Structure));
        }
        all
    }
}

impl Shape {
    /// The measurement error of a force of at most unit size.
    pub fn of(self, force: f64) -> f64 {
        match self {
            Self::Bow => force * force,
            Self::Cube => force.powi(3),
            Self::Dead => (force / DEAD).clamp(-1.0, 1.0),
            Self::Range(from) if force.abs() > from => force,
            // One moment does not show the direction.
            Self::Range(_) | Self::Hysteresis => 0.0,
        }
    }
}

/// One cause that was found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    pub term: Term,
    pub sizes: [f64; 2],
    /// Square that it explains in addition to all others, relative to the noise of one observation.
    pub strength: f64,
    /// Another kind that explains as much.
    pub rival: Option<Kind>,
    /// All of the Coulomb friction reverses gradually, so that it has no size of its own.
    pub is_whole: bool,
}

impl Found {
    /// Number of coefficients of its own in a fit.
    pub fn width(&self) -> usize {
        if self.is_whole { 0 } else { self.term.width() }
    }

    /// F statistic: what it explains per column.
    pub fn f(&self) -> f64 {
        self.strength / self.term.width() as f64
    }
}

/// Ranges covered by the whole run.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Span {
    pub from_s: f64,
    pub duration_s: f64,
    pub stroke_m: f64,
    pub middle_m: f64,
    pub velocity_rms: f64,
    /// The largest force, relative to the offset.
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

    /// By hand: after its characteristic distance a friction has completed `1 - 1/e` of its reversal, with either law.
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
        assert!(Term::Load.can_be(0.04, 50.0) && !Term::Load.can_be(-0.04, 50.0));
        let falling = Term::Falling(1e-3);
        assert!(falling.can_be(15.0, 50.0) && !falling.can_be(101.0, 50.0));
        assert!(Term::Skew.can_be(-1e-3, 50.0) && !Term::Skew.can_be(10e-6, 50.0));
        assert!(Term::Drift.can_be(-5.0, 50.0));
    }

    /// Revolutions of which the motion covers too little are not searched, and a given one is the only one.
    #[test]
    fn a_turn_is_sought_where_the_motion_makes_enough_of_it() {
        let span = Span { duration_s: 20.0, stroke_m: 4e-3, velocity_rms: 0.05, ..Span::default() };
        let settings = Settings { metres_per_count: 2.5e-6, ..Settings::default() };
        let leads = |encoder| -> Vec<f64> {
            let all = Term::all(&span, &settings, encoder).into_iter();
            all.filter_map(|term| if let Term::Ripple(lead_m) = term { Some(lead_m) } else { None }).collect()
        };
        let usual = leads(Encoder::default());
        assert!(usual.len() > 10 && usual.iter().all(|lead_m| LEAST_TURNS * lead_m < 4e-3), "{usual:?}");
        assert_eq!(leads(Encoder { counts_per_turn: Some(777.0), ..Encoder::default() }), [777.0 * 2.5e-6]);
    }
}
