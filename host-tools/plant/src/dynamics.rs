//! The device's motion, solved segment by segment with every change of mode located.
//!
//! Between changes of mode the device is linear: `mt x2'' + cf x2' + fc sgn(x2') = F + W`, `W` the constant force. The
//! prescribed `x1` is interpolated over each step by the quintic through displacement, velocity and acceleration at
//! both ends, and `x2` is the Taylor series of degree 10 that solves the equation for that quintic. So displacement,
//! velocity and force are polynomials in time, and a change of mode is the first root of one of them, found by
//! subdivision, with none missed and to the last bit. Global error: sixth order in the step; nothing is smoothed.
//!
//! Contact: `F = ks (d - chi eps/2) + cs d'`, `chi = sgn d`, while `abs(d) > eps/2`, otherwise `F = 0`, implemented
//! literally. So the force jumps by `cs d'` where the flanks meet, and just before they part it pulls for a
//! moment (`cs d'` outweighs the spring), as a linear spring and damper do. The spring is relaxed at both jumps, so
//! energy is conserved; the damper's dissipation is counted while the flanks touch. `d'` is continuous, so the flanks
//! cannot part and meet again at once. Without backlash contact never ends and can pull as well as push.
//!
//! Unilateral contact can only push: when the force would begin to pull, it becomes zero and the flanks part; they meet
//! again when it would push. The energy left in the spring when they part is dissipated in the flank. Without backlash
//! one flank meets where the other parts.
//!
//! At rest the screw is stuck while `abs(F + W) <= fc`, exactly: `x2` stays the same number. A force that jumps beyond
//! `fc` when the flanks meet frees it at once. If `fc` is zero, the screw never sticks.
//!
//! Stribeck: `fc (1 + (r - 1) exp(-(v / vs)^2))` in place of `fc`, the breakaway force `r fc`. Dahl: friction is a
//! state `f` with `f' = abs(v) (fc sgn(v) - f) / presliding`, and nothing sticks. Both series follow from the same
//! recursion as `x2`, with no approximation except the degree. Their radius of convergence is smaller than for a linear
//! device, so the segment ends where the last coefficients exceed `TAIL_M` and `TAIL`.

use crate::excitation::nodes::{Node, Nodes};
use crate::polynomial::{LENGTH, Polynomial, curvature, first_fall, rebase, slope, value};
use crate::{Excitation, Inerter, PlantError};

/// Default limit of the step \[s\].
const LONGEST_STEP_S: f64 = 1e-3;
/// Minimum step, well below what the stiffest device and the fastest motion need \[s\].
const SHORTEST_STEP_S: f64 = 1e-6;
/// Step times fastest rate: the Taylor series of degree 10 is then exact to 1e-14.
const STEP_RAD: f64 = 0.25;
/// Limit for the last two coefficients of a displacement with Stribeck or Dahl friction: above it the segment is
/// shortened \[m\].
const TAIL_M: f64 = 1e-16;
/// The same for the friction, as a fraction of the Coulomb friction.
const TAIL: f64 = 1e-12;
/// Changes of mode within one step after which time is advanced forcibly, by this fraction of the step.
const MOST_CHANGES: u32 = 1000;

/// State of the screw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Motion {
    /// Turns with `x2' > 0`.
    Forward,
    /// Turns with `x2' < 0`.
    Backward,
    /// At rest, held by friction.
    #[default]
    Stuck,
}

impl Motion {
    /// -1 backward, otherwise 1.
    fn sign(self) -> f64 {
        if self == Self::Backward { -1.0 } else { 1.0 }
    }
}

/// State of the flanks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Flank {
    /// They touch with `x1 - x2 > eps/2`: the terminal pushes the screw forward.
    Positive,
    /// They touch with `x1 - x2 < -eps/2`.
    Negative,
    /// They do not touch; the force is zero.
    #[default]
    Flight,
    /// There is no backlash, and the flanks can pull as well as push: they always touch.
    Closed,
}

impl Flank {
    /// The flank that touches, 1 or -1; otherwise 0.
    fn side(self) -> f64 {
        match self {
            Self::Positive => 1.0,
            Self::Negative => -1.0,
            Self::Flight | Self::Closed => 0.0,
        }
    }
}

/// The true state at one time; by default at rest, with the flanks apart.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// Time \[s\].
    pub t_s: f64,
    /// Terminal displacement \[m\].
    pub x1_m: f64,
    /// Terminal velocity \[m/s\].
    pub v1_m_per_s: f64,
    /// Terminal acceleration \[m/s^2\].
    pub a1_m_per_s2: f64,
    /// Screw displacement referred to the terminal \[m\].
    pub x2_m: f64,
    /// Screw velocity \[m/s\].
    pub v2_m_per_s: f64,
    /// Screw acceleration \[m/s^2\].
    pub a2_m_per_s2: f64,
    /// Contact force on the screw; the load cell adds `mr x1''` \[N\].
    pub force_n: f64,
    /// Dry friction on the screw, without the viscous friction; at rest the force that holds it \[N\].
    pub friction_n: f64,
    /// State of the screw.
    pub motion: Motion,
    /// State of the flanks.
    pub contact: Flank,
}

/// An interval within one mode, on which the motion is one polynomial.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    start_s: f64,
    /// Time that corresponds to 1 in the polynomials \[s\].
    unit_s: f64,
    /// End of the segment, in units.
    end: f64,
    x1: [f64; 6],
    x2: Polynomial,
    /// `x1 - x2` at which the spring is relaxed \[m\].
    relaxed_m: f64,
    /// Dry friction as a polynomial while the screw moves; only the first coefficient for Coulomb friction.
    friction: Polynomial,
    is_curved: bool,
    motion: Motion,
    contact: Flank,
    device: Inerter,
}

impl Segment {
    /// Start \[s\].
    pub fn start_s(&self) -> f64 {
        self.start_s
    }

    /// End \[s\].
    pub fn end_s(&self) -> f64 {
        self.start_s + self.duration_s()
    }

    /// Length \[s\], free of the rounding of `end - start`.
    pub fn duration_s(&self) -> f64 {
        self.unit_s * self.end
    }

    /// State at `t_s`, clamped to the segment.
    pub fn at(&self, t_s: f64) -> Truth {
        Truth { t_s, ..self.at_unit(self.unit_at(t_s)) }
    }

    /// State at a fraction of the segment, 0 at its start and 1 at its end.
    pub fn at_fraction(&self, fraction: f64) -> Truth {
        self.at_unit(self.end * fraction.clamp(0.0, 1.0))
    }

    /// The time in units, clamped to the segment.
    fn unit_at(&self, t_s: f64) -> f64 {
        ((t_s - self.start_s) / self.unit_s).clamp(0.0, self.end)
    }

    fn at_unit(&self, u: f64) -> Truth {
        let h = self.unit_s;
        let v2 = slope(&self.x2, u) / h;
        let motion = match self.motion {
            moves if self.device.sticks() => moves,
            // Rest means zero velocity.
            Motion::Forward | Motion::Backward if v2 > 0.0 => Motion::Forward,
            Motion::Forward | Motion::Backward if v2 < 0.0 => Motion::Backward,
            _ => Motion::Stuck,
        };
        let force_n = self.force_n(u);
        let friction_n = match self.motion {
            Motion::Stuck => force_n + self.device.constant_force_n,
            _ if self.is_curved => value(&self.friction, u),
            _ => self.friction[0],
        };
        Truth {
            t_s: self.start_s + u * h,
            x1_m: value(&self.x1, u),
            v1_m_per_s: slope(&self.x1, u) / h,
            a1_m_per_s2: curvature(&self.x1, u) / (h * h),
            x2_m: value(&self.x2, u),
            v2_m_per_s: v2,
            a2_m_per_s2: curvature(&self.x2, u) / (h * h),
            force_n,
            friction_n,
            motion,
            contact: self.contact,
        }
    }

    /// Force on the load cell at `t_s`: contact and structure mass \[N\].
    pub(crate) fn cell_at_n(&self, t_s: f64) -> f64 {
        let u = self.unit_at(t_s);
        self.force_n(u) + self.device.structure_mass_kg * (curvature(&self.x1, u) / (self.unit_s * self.unit_s))
    }

    /// Terminal displacement at `t_s` \[m\].
    pub(crate) fn x1_at_m(&self, t_s: f64) -> f64 {
        value(&self.x1, self.unit_at(t_s))
    }

    /// Screw displacement at `t_s` \[m\].
    pub(crate) fn x2_at_m(&self, t_s: f64) -> f64 {
        value(&self.x2, self.unit_at(t_s))
    }

    fn force_n(&self, u: f64) -> f64 {
        if self.contact == Flank::Flight {
            return 0.0;
        }
        let stretch = value(&self.x1, u) - value(&self.x2, u) - self.relaxed_m;
        let rate = (slope(&self.x1, u) - slope(&self.x2, u)) / self.unit_s;
        self.device.stiffness_n_per_m * stretch + self.device.contact_damping_n_s_per_m * rate
    }
}

/// The event that ends a segment.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Change {
    /// The screw comes to rest.
    Rest,
    /// The force overcomes friction in this direction.
    Free(Motion),
    /// The flanks part.
    Part,
    /// A flank that was still compressed when it parted is now relaxed.
    Relax,
    /// The flanks meet.
    Meet(Flank),
}

/// The device driven by a motion: an endless sequence of [`Segment`]s.
///
/// Starts at time zero, at rest in the middle of the backlash.
#[derive(Clone, Debug)]
pub struct Plant {
    device: Inerter,
    nodes: Nodes,
    node: Node,
    /// `x1` over the step, as a polynomial with the step as unit.
    x1: [f64; 6],
    /// Completed fraction of the step.
    done: f64,
    /// Changes of mode within the step.
    changes: u32,
    forced: u64,
    x2_m: f64,
    v2_m_per_s: f64,
    /// State of the Dahl friction \[N\].
    friction_n: f64,
    motion: Motion,
    contact: Flank,
    /// Which flank is still compressed while in flight, 1 or -1; otherwise 0.
    squeezed: f64,
    /// The screw has just broken free: any acceleration in the opposite direction is rounding.
    just_free: bool,
    /// The later devices and their times; the next one is last.
    later: Vec<(f64, Inerter)>,
}

impl Plant {
    /// Checks the device and the motion.
    pub fn new(device: Inerter, excitation: Excitation) -> Result<Self, PlantError> {
        Self::changing(device, Vec::new(), excitation)
    }

    /// A device that changes at times \[s\], in any order: a flywheel swapped, a lubricant failing.
    ///
    /// Displacement and velocity continue; contact and friction follow from them and the new device at once.
    pub fn changing(device: Inerter, later: Vec<(f64, Inerter)>, excitation: Excitation) -> Result<Self, PlantError> {
        let mut fastest_rad_per_s: f64 = 0.0;
        for one in later.iter().map(|(_, one)| one).chain([&device]) {
            one.validate()?;
            fastest_rad_per_s = fastest_rad_per_s.max(one.fastest_rad_per_s());
        }
        let longest_s = LONGEST_STEP_S.min(STEP_RAD / fastest_rad_per_s);
        let step_s = longest_s.min(excitation.longest_step_s());
        let mut plant = Self::with_step(device, excitation, step_s)?;
        if let Some(&(value, _)) = later.iter().find(|(at_s, _)| !(0.0..=1e9).contains(at_s)) {
            return Err(PlantError::OutOfRange { field: "change_at_s", value, min: 0.0, max: 1e9 });
        }
        plant.later = later;
        plant.later.sort_by(|a, b| b.0.total_cmp(&a.0));
        Ok(plant)
    }

    /// The same with a fixed step, from 1 us to 0.1 s, however fast device and motion are.
    ///
    /// Only for showing how the error depends on the step: [`new`](Self::new) chooses a step for an error below 1e-9.
    pub fn with_step(device: Inerter, excitation: Excitation, step_s: f64) -> Result<Self, PlantError> {
        device.validate()?;
        excitation.validate()?;
        if !(SHORTEST_STEP_S..=0.1).contains(&step_s) {
            return Err(PlantError::OutOfRange { field: "step_s", value: step_s, min: SHORTEST_STEP_S, max: 0.1 });
        }
        let mut nodes = Nodes::new(excitation, step_s);
        let node = nodes.next_node();
        let mut plant = Self {
            device,
            nodes,
            node,
            x1: quintic(&node),
            done: 0.0,
            changes: 0,
            forced: 0,
            x2_m: 0.0,
            v2_m_per_s: 0.0,
            friction_n: 0.0,
            motion: Motion::Forward,
            contact: Flank::Flight,
            squeezed: 0.0,
            just_free: false,
            later: Vec::new(),
        };
        plant.settle();
        Ok(plant)
    }

    /// The present device.
    pub fn device(&self) -> &Inerter {
        &self.device
    }

    /// How often time was advanced forcibly because too many changes of mode occurred in a step; 0 in every known run.
    pub fn forced_steps(&self) -> u64 {
        self.forced
    }

    /// The state before time zero: at rest in the middle of the backlash.
    pub(crate) fn rest_at(&self, t_s: f64) -> Truth {
        let contact = if self.device.is_closed() { Flank::Closed } else { Flank::Flight };
        Truth { t_s, contact, ..Truth::default() }
    }

    /// The next segment.
    pub fn next_segment(&mut self) -> Segment {
        if self.done >= 1.0 {
            self.node = self.nodes.next_node();
            self.x1 = quintic(&self.node);
            self.done = 0.0;
            self.changes = 0;
        }
        self.become_later();
        let (mut segment, part) = self.solve();
        let mut last = self.units_until_later(&segment);
        let found = self.first_change(&segment).filter(|(u, _)| *u <= last);
        self.just_free = false;
        if self.changes >= MOST_CHANGES {
            self.forced += 1;
            last = last.min(1.0 / f64::from(MOST_CHANGES) / (1.0 - self.done));
            segment.end = last;
            self.advance(&segment, part);
            self.settle();
            return segment;
        }
        segment.end = found.map_or(last, |(u, _)| u);
        self.advance(&segment, part);
        if let Some((_, change)) = found {
            self.changes += 1;
            self.apply(change, &segment);
        }
        segment
    }

    /// Switches to the next device when it is time.
    fn become_later(&mut self) {
        let now_s = self.node.start_s + self.node.step_s * self.done;
        let mut changed = false;
        while let Some((_, device)) = self.later.pop_if(|(at_s, _)| *at_s <= now_s + 1e-9 * self.node.step_s) {
            self.device = device;
            changed = true;
        }
        if changed {
            self.settle();
        }
    }

    /// The end of the present device within the segment, in units.
    fn units_until_later(&self, segment: &Segment) -> f64 {
        let left = |at_s: f64| ((at_s - segment.start_s) / segment.unit_s).clamp(0.0, 1.0);
        self.later.last().map_or(1.0, |(at_s, _)| left(*at_s))
    }

    /// Solves the equation of motion over the rest of the step, or over part of it; returns which fraction.
    fn solve(&mut self) -> (Segment, f64) {
        let left = 1.0 - self.done;
        let h = self.node.step_s * left;
        let x1 = if self.done == 0.0 { self.x1 } else { rebase(&self.x1, self.done, left) };
        if !self.device.presslides() && !self.device.has_stribeck() {
            return (self.series(x1, h), 1.0);
        }
        let undecided = self.device.presslides() && self.v2_m_per_s == 0.0;
        if undecided {
            self.motion = Motion::Forward;
        }
        let mut segment = self.series(x1, h);
        if undecided {
            // Only the motion itself shows the direction of breakaway. A reversal in less time than can be added to the
            // elapsed time is rounding: it would occur again and again.
            self.just_free = true;
            if slope(&segment.x2, 4.0 * f64::EPSILON / left) < 0.0 {
                self.motion = Motion::Backward;
                segment = self.series(x1, h);
            }
        }
        let tail = |series: &Polynomial, last: usize| series[last].abs() + series[last - 1].abs();
        let excess_m = tail(&segment.x2, LENGTH - 1) / TAIL_M;
        let excess_n = tail(&segment.friction, LENGTH - 2) / (TAIL * self.device.coulomb_n);
        let by_tail = 0.9 * excess_m.max(excess_n).powf(-1.0 / (LENGTH - 3) as f64);
        // Never so short that rounding dominates.
        let part = by_tail.min(self.part_by_surplus(&segment)).max(1e-3);
        if part >= 1.0 {
            return (segment, 1.0);
        }
        segment.unit_s *= part;
        segment.x1 = rebase(&segment.x1, 0.0, part);
        segment.x2 = rebase(&segment.x2, 0.0, part);
        segment.friction = rebase(&segment.friction, 0.0, part);
        (segment, part)
    }

    /// Fraction of a segment over which Stribeck's surplus grows by at most `exp(3)`.
    ///
    /// Far from rest the surplus and all its coefficients vanish, and do not predict its value near rest.
    fn part_by_surplus(&self, segment: &Segment) -> f64 {
        let per_velocity = 1.0 / (self.device.stribeck_velocity_m_per_s * segment.unit_s);
        let change = (2..LENGTH).map(|k| (k as f64 * segment.x2[k]).abs()).sum::<f64>() * per_velocity;
        let here = segment.x2[1].abs() * per_velocity;
        let least = here - change;
        // Beyond six times its velocity the surplus is below the rounding of the rest.
        if !self.device.has_stribeck() || least > 6.0 {
            return f64::INFINITY;
        }
        3.0 / (change * (2.0 * here + change))
    }

    /// The Taylor series of the present mode over `h`, for the given `x1`.
    fn series(&self, x1: [f64; 6], h: f64) -> Segment {
        let p = &self.device;
        let (ks, cs) = match self.contact {
            Flank::Flight => (0.0, 0.0),
            _ => (p.stiffness_n_per_m, p.contact_damping_n_s_per_m),
        };
        let relaxed_m = self.contact.side() * 0.5 * p.backlash_m;
        let direction = self.motion.sign();
        let mut friction = [0.0; LENGTH];
        let mut surplus = [0.0; LENGTH];
        let mut x2 = [0.0; LENGTH];
        x2[0] = self.x2_m;
        let is_curved = self.motion != Motion::Stuck && (p.presslides() || p.has_stribeck());
        if self.motion != Motion::Stuck {
            friction[0] = if p.presslides() { self.friction_n } else { direction * p.sliding_n(direction) };
            x2[1] = self.v2_m_per_s * h;
            let per_mass = h * h / p.inertance_kg;
            let spring = ks * per_mass;
            let contact = cs * per_mass / h;
            let viscous = p.viscous(direction) * per_mass / h;
            for k in 0..LENGTH - 2 {
                let n = k as f64;
                let x1_k = x1.get(k).copied().unwrap_or(0.0);
                let x1_next = x1.get(k + 1).copied().unwrap_or(0.0);
                let stretch = x1_k - x2[k] - if k == 0 { relaxed_m } else { 0.0 };
                let mut sum = spring * stretch + contact * (n + 1.0) * (x1_next - x2[k + 1]);
                sum -= viscous * (n + 1.0) * x2[k + 1];
                if is_curved {
                    self.curve(k, h, direction, &x2, &mut surplus, &mut friction);
                    sum -= friction[k] * per_mass;
                } else if k == 0 {
                    sum -= friction[0] * per_mass;
                }
                if k == 0 {
                    sum += p.constant_force_n * per_mass;
                }
                x2[k + 2] = sum / ((n + 1.0) * (n + 2.0));
            }
            if is_curved {
                // One degree more than `x2` needs, because the friction itself is checked.
                self.curve(LENGTH - 2, h, direction, &x2, &mut surplus, &mut friction);
            }
        }
        Segment {
            start_s: self.node.start_s + self.node.step_s * self.done,
            unit_s: h,
            end: 1.0,
            x1,
            x2,
            relaxed_m,
            friction,
            is_curved,
            motion: self.motion,
            contact: self.contact,
            device: *p,
        }
    }

    /// Coefficient `k` of the dry friction, from the coefficients of `x2` up to `k + 1` and its own previous ones.
    ///
    /// `surplus` is `exp(w)` with `w = -(v / vs)^2`, hence `surplus' = w' surplus`, coefficient by coefficient.
    fn curve(
        &self,
        k: usize,
        h: f64,
        direction: f64,
        x2: &Polynomial,
        surplus: &mut Polynomial,
        friction: &mut Polynomial,
    ) {
        let p = &self.device;
        // Velocity, unit per unit of time.
        let v = |j: usize| (j + 1) as f64 * x2[j + 1];
        if p.has_stribeck() {
            let scale = -1.0 / (p.stribeck_velocity_m_per_s * h).powi(2);
            let w = |j: usize| scale * (0..=j).map(|i| v(i) * v(j - i)).sum::<f64>();
            surplus[k] = match k {
                0 => w(0).exp(),
                _ => (1..=k).map(|j| j as f64 * w(j) * surplus[k - j]).sum::<f64>() / k as f64,
            };
        }
        let sliding_n = direction * p.sliding_n(direction);
        let constant = |j: usize| if j == 0 { 1.0 } else { 0.0 };
        let level = |j: usize| sliding_n * (constant(j) + (p.stribeck_ratio - 1.0) * surplus[j]);
        if !p.presslides() {
            friction[k] = level(k);
        } else if k > 0 {
            let turned: f64 = (0..k).map(|j| v(j) * (level(k - 1 - j) - friction[k - 1 - j])).sum();
            friction[k] = direction * turned / (p.presliding_m * k as f64);
        }
    }

    /// The first change of mode within the segment, if any.
    fn first_change(&self, segment: &Segment) -> Option<(f64, Change)> {
        let mut first: Option<(f64, Change)> = None;
        let mut offer = |falling: &Polynomial, change| {
            if let Some(u) = first_fall(falling)
                && first.is_none_or(|(earliest, _)| u < earliest)
            {
                first = Some((u, change));
            }
        };
        let p = &self.device;
        let half_backlash = 0.5 * p.backlash_m;
        let force = if self.motion == Motion::Stuck || p.unilateral > 0.0 {
            force_polynomial(segment, segment.relaxed_m)
        } else {
            [0.0; LENGTH]
        };
        if self.motion == Motion::Stuck {
            if self.contact != Flank::Flight {
                for motion in [Motion::Backward, Motion::Forward] {
                    let sign = motion.sign();
                    let mut room = force.map(|c| -sign * c);
                    room[0] += p.breakaway_n(sign) - sign * p.constant_force_n;
                    offer(&room, Change::Free(motion));
                }
            }
        } else if p.has_directions() {
            let sign = self.motion.sign();
            let mut speed = [0.0; LENGTH];
            for (k, slot) in speed.iter_mut().enumerate().take(LENGTH - 1) {
                *slot = sign * (k + 1) as f64 * segment.x2[k + 1];
            }
            if self.just_free {
                speed[1] = speed[1].max(0.0);
            }
            offer(&speed, Change::Rest);
        }
        if self.contact != Flank::Closed {
            let d = apart(segment);
            let room = |side: f64| {
                let mut room = d.map(|c| -side * c);
                room[0] += half_backlash;
                room
            };
            let would_push = |side: f64| force_polynomial(segment, side * half_backlash).map(|c| -side * c);
            match self.contact {
                Flank::Flight if self.squeezed != 0.0 => {
                    let flank = if self.squeezed > 0.0 { Flank::Positive } else { Flank::Negative };
                    offer(&room(self.squeezed).map(|c| -c), Change::Relax);
                    offer(&would_push(self.squeezed), Change::Meet(flank));
                }
                Flank::Flight => {
                    offer(&room(1.0), Change::Meet(Flank::Positive));
                    offer(&room(-1.0), Change::Meet(Flank::Negative));
                }
                flank if p.unilateral > 0.0 => offer(&force.map(|c| flank.side() * c), Change::Part),
                flank => offer(&room(flank.side()).map(|c| -c), Change::Part),
            }
        }
        first
    }

    /// Moves the state to the end of the segment, whose unit is a fraction of what was left of the step.
    fn advance(&mut self, segment: &Segment, part: f64) {
        if self.motion != Motion::Stuck {
            self.x2_m = value(&segment.x2, segment.end);
            self.v2_m_per_s = slope(&segment.x2, segment.end) / segment.unit_s;
            if segment.is_curved {
                self.friction_n = value(&segment.friction, segment.end);
            }
        }
        let whole = segment.end >= 1.0 && part >= 1.0;
        self.done = if whole { 1.0 } else { self.done + (1.0 - self.done) * segment.end * part };
    }

    /// Enters the mode that a change leads to.
    fn apply(&mut self, change: Change, segment: &Segment) {
        match change {
            Change::Free(direction) => {
                self.motion = direction;
                self.just_free = true;
            }
            Change::Rest => {
                self.v2_m_per_s = 0.0;
                self.hold_or_free(segment.force_n(segment.end));
            }
            Change::Part => {
                self.squeezed = if self.device.unilateral == 0.0 { 0.0 } else { self.contact.side() };
                self.contact = Flank::Flight;
                if self.motion == Motion::Stuck {
                    self.hold_or_free(0.0);
                }
            }
            Change::Relax => self.squeezed = 0.0,
            Change::Meet(side) => {
                self.contact = side;
                let was_squeezed = core::mem::replace(&mut self.squeezed, 0.0) != 0.0;
                if self.motion == Motion::Stuck {
                    // The spring is relaxed here, so the force is the damper's; or the flank follows and there is none.
                    let rate = slope(&segment.x1, segment.end) / segment.unit_s;
                    let force_n = if was_squeezed { 0.0 } else { self.device.contact_damping_n_s_per_m * rate };
                    self.hold_or_free(force_n);
                }
            }
        }
    }

    /// At rest: friction holds the screw, or the contact's force frees it.
    fn hold_or_free(&mut self, force_n: f64) {
        let p = &self.device;
        let total_n = force_n + p.constant_force_n;
        (self.motion, self.just_free) = match total_n {
            _ if p.presslides() => (Motion::Forward, false),
            f if f > 0.0 && f > p.breakaway_n(1.0) => (Motion::Forward, true),
            f if f < 0.0 && f < -p.breakaway_n(-1.0) => (Motion::Backward, true),
            _ => (Motion::Stuck, false),
        };
    }

    /// Derives the mode from displacement and velocity: at the start, after a change of device, or after a forced step.
    fn settle(&mut self) {
        let p = &self.device;
        let half_backlash = 0.5 * p.backlash_m;
        let d = value(&self.x1, self.done) - self.x2_m;
        let rate = slope(&self.x1, self.done) / self.node.step_s - self.v2_m_per_s;
        let (contact, relaxed_m) = match d {
            _ if p.is_closed() => (Flank::Closed, 0.0),
            d if d > half_backlash => (Flank::Positive, half_backlash),
            d if d < -half_backlash => (Flank::Negative, -half_backlash),
            _ => (Flank::Flight, d),
        };
        let mut force_n = p.stiffness_n_per_m * (d - relaxed_m) + p.contact_damping_n_s_per_m * rate;
        (self.contact, self.squeezed) = (contact, 0.0);
        let pulls = (contact == Flank::Positive && force_n < 0.0) || (contact == Flank::Negative && force_n > 0.0);
        if p.unilateral > 0.0 && pulls {
            (self.contact, self.squeezed) = (Flank::Flight, d.signum());
        }
        if self.contact == Flank::Flight {
            force_n = 0.0;
        }
        let sliding_n = p.breakaway_n(1.0).max(p.breakaway_n(-1.0));
        self.friction_n = self.friction_n.clamp(-sliding_n, sliding_n);
        if !p.has_directions() {
            (self.motion, self.just_free) = (Motion::Forward, false);
        } else if self.v2_m_per_s == 0.0 {
            self.hold_or_free(force_n);
        } else {
            self.motion = if self.v2_m_per_s > 0.0 { Motion::Forward } else { Motion::Backward };
        }
    }
}

/// `x1 - x2` over a segment.
fn apart(segment: &Segment) -> Polynomial {
    let mut d = segment.x2.map(|c| -c);
    d.iter_mut().zip(segment.x1).for_each(|(d, x1)| *d += x1);
    d
}

/// Contact force over a segment, whose unit is the segment's, of flanks that touch.
fn force_polynomial(segment: &Segment, relaxed_m: f64) -> Polynomial {
    let (d, ks) = (apart(segment), segment.device.stiffness_n_per_m);
    let damping = segment.device.contact_damping_n_s_per_m / segment.unit_s;
    let mut force = [0.0; LENGTH];
    for (k, slot) in force.iter_mut().enumerate() {
        let next = d.get(k + 1).copied().unwrap_or(0.0);
        let relaxed = if k == 0 { relaxed_m } else { 0.0 };
        *slot = ks * (d[k] - relaxed) + damping * (k + 1) as f64 * next;
    }
    force
}

/// The quintic through displacement, velocity and acceleration at both ends of a step.
fn quintic(node: &Node) -> [f64; 6] {
    let (h, hh) = (node.step_s, node.step_s * node.step_s);
    let (a, b) = (node.first, node.last);
    let rise = b.x_m - a.x_m;
    let (v0, v1) = (h * a.v_m_per_s, h * b.v_m_per_s);
    let (a0, a1) = (hh * a.a_m_per_s2, hh * b.a_m_per_s2);
    [
        a.x_m,
        v0,
        0.5 * a0,
        10.0 * rise - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1,
        -15.0 * rise + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1,
        6.0 * rise - 3.0 * v0 - 3.0 * v1 - 0.5 * a0 + 0.5 * a1,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_that_pile_up_cannot_stop_time() {
        let mut plant = Plant::new(Inerter::worn(), Excitation::sine(15.9, 0.8e-3)).unwrap();
        let mut end_s = 0.0;
        for _ in 0..50_000 {
            // As if a thousand changes had already occurred.
            plant.changes = MOST_CHANGES;
            let segment = plant.next_segment();
            assert!(segment.end_s() > end_s);
            end_s = segment.end_s();
            let state = segment.at_fraction(1.0);
            assert!(state.force_n.abs() < 1e5 && state.x2_m.abs() < 0.1);
        }
        assert!(plant.forced_steps() > 40_000 && end_s > 1.0);
    }
}
