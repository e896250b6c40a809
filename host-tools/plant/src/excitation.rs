//! The rig's motion of terminal 1, in closed form at any time.
//!
//! A motion is a sequence of segments. Within each the displacement is `w(t) (u(t) - u(0))`: `u` a sum of tones, a
//! chirp or moves, `w` a window that ramps up from rest and down to rest with three continuous derivatives. So the
//! device starts, and passes from segment to segment, without a shock. Before the start and after the end the terminal
//! rests at zero. A motion given point by point has no window.

mod moves;
pub(crate) mod nodes;
mod parse;
mod point;
mod table;

pub use moves::Moves;

use std::f64::consts::{PI, SQRT_2, TAU};

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};

use crate::{PlantError, table::check};
pub use point::Point;
use table::Table;

/// Default length of the ramp from rest \[s\]: shorter than the fastest convergence that is measured.
const RAMP_S: f64 = 0.2;
/// Number of tones that approximate a random band: enough for a nearly Gaussian sum that does not repeat within a run.
const RANDOM_TONES: u32 = 60;
/// Maximum number of tones of a multisine.
const MULTISINE_TONES: u32 = 64;

const FREQUENCY_HZ: (f64, f64) = (1e-4, 1000.0);
// For a rotary machine these are radians: 160 turns, and 95 000 rpm.
const AMPLITUDE_M: (f64, f64) = (0.0, 1e3);
const VELOCITY_M_PER_S: (f64, f64) = (0.0, 1e4);
const ACCELERATION_M_PER_S2: (f64, f64) = (1e-6, 1e6);
const DURATION_S: (f64, f64) = (0.01, 1e7);
const RAMP_RANGE_S: (f64, f64) = (1e-3, 1e3);

/// One tone: `amplitude * sin(2 pi frequency t + phase)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    /// Frequency \[Hz\], 1e-4 to 1000.
    pub frequency_hz: f64,
    /// Amplitude \[m\], at most 1000.
    pub amplitude_m: f64,
    /// Phase at the start \[rad\].
    pub phase_rad: f64,
}

impl Tone {
    /// A tone that starts at zero.
    pub const fn new(frequency_hz: f64, amplitude_m: f64) -> Self {
        Self { frequency_hz, amplitude_m, phase_rad: 0.0 }
    }

    fn at(&self, t_s: f64) -> Point {
        let w = TAU * self.frequency_hz;
        let (sin, cos) = (w * t_s + self.phase_rad).sin_cos();
        let a = self.amplitude_m;
        Point { x_m: a * sin, v_m_per_s: a * w * cos, a_m_per_s2: -a * w * w * sin }
    }
}

/// A motion of terminal 1: the command of the rig.
#[derive(Clone, Debug, PartialEq)]
pub struct Excitation {
    segments: Vec<Segment>,
}

/// One part of a motion.
#[derive(Clone, Debug, PartialEq)]
struct Segment {
    start_s: f64,
    /// Infinite for a motion without an end, which is then the last one.
    duration_s: f64,
    ramp_s: f64,
    shape: Shape,
    /// The value of the tones or the chirp at the start, which is subtracted.
    origin_m: f64,
}

#[derive(Clone, Debug, PartialEq)]
enum Shape {
    /// Stays where it is.
    Hold,
    Tones(Vec<Tone>),
    /// Frequency grows by a constant factor per second; the velocity amplitude stays the same.
    Chirp {
        low_rad_per_s: f64,
        growth_per_s: f64,
        velocity_m_per_s: f64,
    },
    /// Point by point, without a window.
    Table(Table),
    Moves(Moves),
}

impl Shape {
    fn at(&self, t_s: f64) -> Point {
        match self {
            Self::Hold => Point::default(),
            Self::Tones(tones) => tones.iter().map(|tone| tone.at(t_s)).fold(Point::default(), |mut sum, p| {
                sum.x_m += p.x_m;
                sum.v_m_per_s += p.v_m_per_s;
                sum.a_m_per_s2 += p.a_m_per_s2;
                sum
            }),
            Self::Moves(moves) => {
                let [x_m, v_m_per_s, a_m_per_s2] = moves.at(t_s);
                Point { x_m, v_m_per_s, a_m_per_s2 }
            }
            &Self::Chirp { low_rad_per_s, growth_per_s: k, velocity_m_per_s: v } => {
                // x = v sin(phi) / w with w = phi' and w' = k w.
                let w = low_rad_per_s * (k * t_s).exp();
                let (sin, cos) = ((w - low_rad_per_s) / k).sin_cos();
                Point {
                    x_m: v * sin / w,
                    v_m_per_s: v * (cos - k * sin / w),
                    a_m_per_s2: v * (k * k * sin / w - w * sin - k * cos),
                }
            }
            Self::Table(table) => table.at(t_s),
        }
    }

    fn highest_rad_per_s(&self, duration_s: f64) -> f64 {
        match self {
            Self::Hold => 0.0,
            Self::Table(table) => PI / table.period_s,
            Self::Tones(tones) => tones.iter().fold(0.0, |top, tone| f64::max(top, TAU * tone.frequency_hz)),
            Self::Chirp { low_rad_per_s, growth_per_s, .. } => low_rad_per_s * (growth_per_s * duration_s).exp(),
            Self::Moves(moves) => moves.highest_rad_per_s(),
        }
    }
}

/// Ramp from 0 to 1 over `z` in 0 to 1, with its first two derivatives with respect to `z`; three vanish at both ends.
fn lead_in(z: f64) -> (f64, f64, f64) {
    if z >= 1.0 {
        return (1.0, 0.0, 0.0);
    }
    let z = z.max(0.0);
    let rest = z * (1.0 - z);
    (
        z.powi(4) * (35.0 + z * (-84.0 + z * (70.0 - 20.0 * z))),
        140.0 * rest.powi(3),
        420.0 * rest * rest * (1.0 - 2.0 * z),
    )
}

impl Segment {
    fn new(shape: Shape, duration_s: f64) -> Self {
        let origin_m = shape.at(0.0).x_m;
        Self { start_s: 0.0, duration_s, ramp_s: RAMP_S, shape, origin_m }
    }

    fn end_s(&self) -> f64 {
        self.start_s + self.duration_s
    }

    /// The segment's motion at a time within it.
    fn at(&self, t_s: f64) -> Point {
        let local_s = t_s - self.start_s;
        self.windowed(local_s, self.shape.at(local_s))
    }

    /// Length of the ramp, shortened if the segment has no room for both.
    fn ramp_length_s(&self) -> f64 {
        self.ramp_s.min(0.5 * self.duration_s)
    }

    /// Applies the window to the motion of the shape at `local_s` after the segment's start.
    fn windowed(&self, local_s: f64, shape: Point) -> Point {
        if matches!(self.shape, Shape::Table(_)) {
            return shape;
        }
        let ramp = self.ramp_length_s();
        let left = self.duration_s - local_s;
        let (sign, z) = if left < ramp { (-1.0, left / ramp) } else { (1.0, local_s / ramp) };
        let (w, dw, ddw) = lead_in(z);
        let (dw, ddw) = (sign * dw / ramp, ddw / (ramp * ramp));
        let u = shape.x_m - self.origin_m;
        Point {
            x_m: w * u,
            v_m_per_s: w * shape.v_m_per_s + dw * u,
            a_m_per_s2: w * shape.a_m_per_s2 + 2.0 * dw * shape.v_m_per_s + ddw * u,
        }
    }

    fn validate(&self) -> Result<(), PlantError> {
        if self.duration_s != f64::INFINITY {
            check("duration_s", self.duration_s, DURATION_S)?;
        }
        check("ramp_s", self.ramp_s, RAMP_RANGE_S)?;
        match &self.shape {
            // A table is checked on construction.
            Shape::Hold | Shape::Table(_) => Ok(()),
            Shape::Tones(tones) => tones.iter().try_for_each(|tone| {
                check("frequency_hz", tone.frequency_hz, FREQUENCY_HZ)?;
                check("amplitude_m", tone.amplitude_m, AMPLITUDE_M)?;
                check("phase_rad", tone.phase_rad, (-1e3, 1e3))
            }),
            Shape::Chirp { low_rad_per_s, growth_per_s, velocity_m_per_s } => {
                check("low_hz", low_rad_per_s / TAU, FREQUENCY_HZ)?;
                if !(growth_per_s.is_finite() && *growth_per_s > 0.0) {
                    return Err(PlantError::Conflict {
                        field: "high_hz",
                        other: "low_hz",
                        rule: "a chirp rises: the second frequency must be the higher one",
                    });
                }
                check("high_hz", self.shape.highest_rad_per_s(self.duration_s) / TAU, (FREQUENCY_HZ.0, 1.001e3))?;
                check("velocity_m_per_s", *velocity_m_per_s, VELOCITY_M_PER_S)
            }
            Shape::Moves(moves) => {
                check("stroke_m", moves.stroke_m, (1e-9, AMPLITUDE_M.1))?;
                check("velocity_m_per_s", moves.velocity_m_per_s, (1e-9, VELOCITY_M_PER_S.1))?;
                check("acceleration_m_per_s2", moves.acceleration_m_per_s2, ACCELERATION_M_PER_S2)?;
                check("rest_s", moves.rest_s, (0.0, DURATION_S.1))
            }
        }
    }
}

/// Uniform between 0 and 1, both ends excluded.
fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    ((rng.next_u64() >> 11) as f64 + 0.5) / (1u64 << 53) as f64
}

impl Excitation {
    /// Names accepted by [`preset`](Self::preset).
    pub const PRESETS: &'static [&'static str] = &["slow", "mid", "fast", "multi", "random", "two"];

    /// The preset of this name: the paper's tests `slow`, `mid` and `fast`, and `multi`, `random`, `two`.
    ///
    /// `seed` sets the phases of `multi` and the tones of `random`; the others do not depend on it.
    pub fn preset(name: &str, seed: u64) -> Option<Self> {
        Some(match name {
            "slow" => Self::sine(0.053, 15.1e-3),
            "mid" => Self::sine(3.2, 4.16e-3),
            "fast" => Self::sine(15.9, 0.806e-3),
            "multi" => Self::multisine(0.5, 15.0, 20e-3, seed),
            "random" => Self::random(0.5, 15.0, 20e-3, seed),
            "two" => Self::tones(vec![Tone::new(0.8, 8e-3), Tone::new(6.4, 0.8e-3)]),
            _ => return None,
        })
    }

    /// Rest.
    pub fn hold() -> Self {
        Self::single(Shape::Hold, f64::INFINITY)
    }

    /// One sine of this frequency \[Hz\] and amplitude \[m\].
    pub fn sine(frequency_hz: f64, amplitude_m: f64) -> Self {
        Self::tones(vec![Tone::new(frequency_hz, amplitude_m)])
    }

    /// A sum of tones.
    pub fn tones(tones: Vec<Tone>) -> Self {
        Self::single(Shape::Tones(tones), f64::INFINITY)
    }

    /// Equally spaced tones of equal velocity and random phase.
    ///
    /// The spacing is the lowest frequency, so the motion repeats after its period; it is wider if that would need more
    /// than 64 tones. `rms_m_per_s` is the rms velocity of the sum \[m/s\].
    pub fn multisine(low_hz: f64, high_hz: f64, rms_m_per_s: f64, seed: u64) -> Self {
        let spacing = low_hz.max((high_hz - low_hz) / f64::from(MULTISINE_TONES - 1));
        let count =
            ((high_hz - low_hz) / spacing * (1.0 + 1e-9)).floor().clamp(0.0, f64::from(MULTISINE_TONES)) as u32 + 1;
        let velocity = rms_m_per_s * SQRT_2 / f64::from(count).sqrt();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let tone = |k| {
            let frequency_hz = low_hz + spacing * f64::from(k);
            Tone { frequency_hz, amplitude_m: velocity / (TAU * frequency_hz), phase_rad: TAU * uniform(&mut rng) }
        };
        Self::tones((0..count).map(tone).collect())
    }

    /// Band-limited random motion with a flat velocity spectrum between two frequencies \[Hz\].
    ///
    /// 60 tones, one at a random frequency in each sixtieth of the band, with random phase and Rayleigh-distributed
    /// amplitude, scaled so that the rms velocity of the sum is `rms_m_per_s` \[m/s\]. Does not repeat within hours.
    pub fn random(low_hz: f64, high_hz: f64, rms_m_per_s: f64, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let spacing = (high_hz - low_hz) / f64::from(RANDOM_TONES);
        let mut tones: Vec<Tone> = (0..RANDOM_TONES)
            .map(|k| {
                let frequency_hz = low_hz + spacing * (f64::from(k) + uniform(&mut rng));
                let rayleigh = (-2.0 * uniform(&mut rng).ln()).sqrt();
                Tone { frequency_hz, amplitude_m: rayleigh / (TAU * frequency_hz), phase_rad: TAU * uniform(&mut rng) }
            })
            .collect();
        let squares: f64 = tones.iter().map(|tone| 0.5 * (TAU * tone.frequency_hz * tone.amplitude_m).powi(2)).sum();
        tones.iter_mut().for_each(|tone| tone.amplitude_m *= rms_m_per_s / squares.sqrt());
        Self::tones(tones)
    }

    /// A sine that rises from one frequency \[Hz\] to another within `duration_s`, then rest.
    ///
    /// The frequency grows by a constant factor per second and the velocity amplitude is `sqrt(2) rms_m_per_s`
    /// throughout, so the amplitude falls as the frequency rises.
    pub fn chirp(low_hz: f64, high_hz: f64, rms_m_per_s: f64, duration_s: f64) -> Self {
        let shape = Shape::Chirp {
            low_rad_per_s: TAU * low_hz,
            growth_per_s: (high_hz / low_hz).ln() / duration_s,
            velocity_m_per_s: SQRT_2 * rms_m_per_s,
        };
        Self::single(shape, duration_s)
    }

    /// Point-to-point moves, there and back.
    pub fn moves(moves: Moves) -> Self {
        Self::single(Shape::Moves(moves), f64::INFINITY)
    }

    /// The curve through displacements \[m\] with this time step \[s\], as a shaker controller receives them; it ends
    /// with the last one.
    ///
    /// The terminal rests before and after, so the last displacement must be the first.
    pub fn table(period_s: f64, displacements_m: &[f64]) -> Result<Self, PlantError> {
        let table = Table::new(period_s, displacements_m)?;
        let duration_s = table.duration_s();
        Ok(Self::single(Shape::Table(table), duration_s))
    }

    /// The same motion with its displacement multiplied by a factor.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        for segment in &mut self.segments {
            segment.origin_m *= factor;
            match &mut segment.shape {
                Shape::Hold => {}
                Shape::Tones(tones) => tones.iter_mut().for_each(|tone| tone.amplitude_m *= factor),
                Shape::Chirp { velocity_m_per_s, .. } => *velocity_m_per_s *= factor,
                Shape::Table(table) => table.scale(factor),
                Shape::Moves(moves) => moves.scale(factor),
            }
        }
        self
    }

    /// One motion after the other; each except the last should have an end ([`lasting`](Self::lasting)), or none
    /// follows.
    pub fn sequence(parts: impl IntoIterator<Item = Self>) -> Self {
        let mut segments: Vec<Segment> = Vec::new();
        for part in parts {
            let start_s = segments.last().map_or(0.0, Segment::end_s);
            if start_s == f64::INFINITY {
                break;
            }
            segments.extend(part.segments.into_iter().map(|s| Segment { start_s: start_s + s.start_s, ..s }));
        }
        Self { segments }
    }

    /// The same motion, ramped down to rest so that it ends after `duration_s`; later parts of a sequence are left out.
    #[must_use]
    pub fn lasting(mut self, duration_s: f64) -> Self {
        // The first one stays in any case, so that validate() sees an invalid duration.
        let keep = self.segments.iter().skip(1).take_while(|segment| segment.start_s < duration_s).count() + 1;
        self.segments.truncate(keep);
        let end = self.duration_s();
        if end < duration_s {
            let rest = Segment { start_s: end, ..Segment::new(Shape::Hold, duration_s - end) };
            self.segments.push(rest);
        } else if let Some(last) = self.segments.last_mut() {
            last.duration_s = duration_s - last.start_s;
        }
        self
    }

    /// The same motion with another length of the ramps from rest and to rest \[s\]; the default is 0.2 s.
    #[must_use]
    pub fn with_ramp(mut self, ramp_s: f64) -> Self {
        self.segments.iter_mut().for_each(|segment| segment.ramp_s = ramp_s);
        self
    }

    /// End of the motion \[s\]; infinite if it has none.
    pub fn duration_s(&self) -> f64 {
        self.segments.last().map_or(0.0, Segment::end_s)
    }

    /// Highest frequency in the motion \[Hz\], without the ramps.
    pub fn highest_hz(&self) -> f64 {
        self.segments.iter().map(|s| s.shape.highest_rad_per_s(s.duration_s) / TAU).fold(0.0, f64::max)
    }

    /// Displacement, velocity and acceleration at `t_s`.
    pub fn at(&self, t_s: f64) -> Point {
        match self.segments.iter().find(|segment| t_s < segment.end_s()) {
            Some(segment) if t_s >= segment.start_s => segment.at(t_s),
            _ => Point::default(),
        }
    }

    /// Longest step over which a quintic follows the motion within 1e-11 of it \[s\]: a tenth of a radian of the
    /// highest frequency, a hundredth of the shortest ramp; for a table the time between its points.
    pub(crate) fn longest_step_s(&self) -> f64 {
        let longest_s = |segment: &Segment| match &segment.shape {
            Shape::Table(table) => table.period_s,
            shape => {
                let highest_hz = shape.highest_rad_per_s(segment.duration_s) / TAU;
                (0.1 / (TAU * highest_hz)).min(0.01 * segment.ramp_length_s())
            }
        };
        self.segments.iter().map(longest_s).fold(f64::INFINITY, f64::min)
    }

    /// Checks every frequency, amplitude and time.
    pub fn validate(&self) -> Result<(), PlantError> {
        self.segments.iter().try_for_each(Segment::validate)
    }

    fn single(shape: Shape, duration_s: f64) -> Self {
        Self { segments: vec![Segment::new(shape, duration_s)] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all() -> Vec<Excitation> {
        let presets = Excitation::PRESETS.iter().map(|name| Excitation::preset(name, 3).unwrap());
        let sequence = Excitation::parse("mid@2s;hold@0.5s;random@2s;chirp:1-10Hz:5mm/s:3s", 5).unwrap();
        presets.chain([Excitation::chirp(0.1, 20.0, 5e-3, 60.0), sequence]).collect()
    }

    #[test]
    fn velocity_and_acceleration_are_the_derivatives() {
        for motion in all() {
            for k in 0..4000 {
                let (t, h) = (0.0013 + f64::from(k) * 0.0021, 1e-5);
                let (before, here, after) = (motion.at(t - h), motion.at(t), motion.at(t + h));
                let v = (after.x_m - before.x_m) / (2.0 * h);
                let a = (after.v_m_per_s - before.v_m_per_s) / (2.0 * h);
                assert!((v - here.v_m_per_s).abs() < 1e-7, "{t} {v} {here:?}");
                assert!((a - here.a_m_per_s2).abs() < 1e-4, "{t} {a} {here:?}");
            }
        }
    }

    #[test]
    fn starts_from_rest() {
        for motion in all() {
            assert_eq!(motion.at(0.0), Point::default());
            assert_eq!(motion.at(-1.0), Point::default());
            assert!(motion.at(1e-3).a_m_per_s2.abs() < 1e-2);
        }
    }

    #[test]
    fn rms_velocity_is_as_told() {
        for name in ["multi", "random"] {
            for seed in 0..4 {
                let motion = Excitation::preset(name, seed).unwrap();
                let count = 40_000;
                let mean = (0..count).map(|k| motion.at(1.0 + f64::from(k) * 0.01).v_m_per_s.powi(2)).sum::<f64>()
                    / f64::from(count);
                assert!((mean.sqrt() - 20e-3).abs() < 0.2e-3, "{name} {seed} {}", mean.sqrt());
                assert!(motion.highest_hz() <= 15.0);
            }
        }
        let Shape::Tones(tones) = &Excitation::preset("multi", 0).unwrap().segments[0].shape else { panic!() };
        assert_eq!(tones.len(), 30);
    }

    #[test]
    fn seeds_change_random_motion_and_nothing_else() {
        for name in Excitation::PRESETS {
            let make = |seed| Excitation::preset(name, seed).unwrap();
            assert_eq!(make(1), make(1));
            assert_eq!(make(1) == make(2), !["multi", "random"].contains(name), "{name}");
        }
    }

    #[test]
    fn a_scaled_motion_is_so_many_times_as_large() {
        let table = Excitation::table(0.01, &[0.0, 1e-3, -2e-3, 0.0]).unwrap();
        for motion in all().into_iter().chain([table]) {
            let scaled = motion.clone().scaled(0.3);
            for t in [0.001, 0.0123, 0.7, 2.31, 6.0] {
                let (one, other) = (motion.at(t), scaled.at(t));
                assert!((0.3 * one.x_m - other.x_m).abs() < 1e-12, "{t}: {one:?} {other:?}");
                assert!((0.3 * one.a_m_per_s2 - other.a_m_per_s2).abs() < 1e-9, "{t}: {one:?} {other:?}");
            }
        }
    }

    #[test]
    fn a_shortened_motion_ends_at_rest() {
        let motion = Excitation::sine(3.2, 4e-3).lasting(5.0);
        assert_eq!(motion.duration_s(), 5.0);
        assert!(motion.at(4.9).x_m.abs() > 0.0);
        assert!(motion.at(4.9999).v_m_per_s.abs() < 1e-6);
        assert_eq!(motion.at(5.0), Point::default());
        assert_eq!(Excitation::chirp(1.0, 2.0, 1e-3, 3.0).lasting(9.0).duration_s(), 9.0);
    }

    #[test]
    fn refusals_name_the_field() {
        let refused = |motion: Excitation| motion.validate().unwrap_err().to_string();
        assert!(refused(Excitation::sine(f64::NAN, 1.0)).contains("frequency_hz"));
        assert!(refused(Excitation::sine(1.0, -1.0)).contains("amplitude_m"));
        assert!(refused(Excitation::chirp(2.0, 1.0, 1e-3, 3.0)).contains("high_hz"));
        assert!(refused(Excitation::random(f64::NAN, 1.0, 1e-3, 3)).contains("frequency_hz"));
        assert!(refused(Excitation::hold().lasting(f64::NAN)).contains("duration_s"));
        assert!(refused(Excitation::hold().with_ramp(0.0)).contains("ramp_s"));
    }
}
