//! The device's motion, solved segment by segment with every change of mode located.
//!
//! Between changes of mode the device is linear: `mt x2'' + cf x2' + fc sgn(x2') = F`. The prescribed `x1` is
//! interpolated over each step by the quintic through displacement, velocity and acceleration at both ends, and `x2` is
//! the Taylor series of degree 10 that solves the equation for that quintic. So displacement, velocity and force are
//! polynomials in time, and a change of mode is the first root of one of them, found by subdivision without omission to
//! the last bit. Global error: sixth order in the step; nothing is smoothed.
//!
//! Contact: `F = ks (d - s eps/2) + cs d'` while `abs(d) > eps/2`, otherwise `F = 0`, taken to the letter. So the force
//! jumps by `cs d'` where the flanks meet, and just before they part it pulls for a moment (`cs d'` outweighs the
//! spring), as a linear spring and damper do. The spring is relaxed at both jumps, hence no energy appears or vanishes;
//! what the damper takes is counted while the flanks touch. `d'` is continuous, so parting and meeting again at once is
//! impossible. Without backlash contact never ends and pulls as it pushes.
//!
//! At rest the screw is stuck while `abs(F) <= fc`, exactly: `x2` stays the same number. A force that jumps past `fc`
//! at a meeting of the flanks frees it at once. Where `fc` is zero there is nothing to be stuck by.

use crate::excitation::{Node, Nodes};
use crate::polynomial::{LENGTH, Polynomial, curvature, first_fall, rebase, slope, value};
use crate::{Excitation, Parameters, PlantError};

/// Longest step when nothing is said \[s\].
const LONGEST_STEP_S: f64 = 1e-3;
/// Shortest step, well below what the stiffest device and the fastest motion ask for \[s\].
const SHORTEST_STEP_S: f64 = 1e-6;
/// Step times fastest rate: the Taylor series of degree 10 is then exact to 1e-14.
const STEP_RAD: f64 = 0.25;
/// Changes of mode within one step after which time is moved on by force, by this fraction of the step.
const MOST_CHANGES: u32 = 1000;

/// What the screw does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Turns with `x2' > 0`.
    Forward,
    /// Turns with `x2' < 0`.
    Backward,
    /// Stands, held by friction.
    Stuck,
}

/// What the flanks do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contact {
    /// They touch with `x1 - x2 > eps/2`: the terminal pushes the screw forward.
    Positive,
    /// They touch with `x1 - x2 < -eps/2`.
    Negative,
    /// They do not touch; the force is zero.
    Flight,
    /// There is no backlash: they always touch.
    Closed,
}

/// The true state at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
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
    /// What the screw does.
    pub motion: Motion,
    /// What the flanks do.
    pub contact: Contact,
}

impl Truth {
    /// At rest in the middle of the backlash.
    fn rest(t_s: f64, contact: Contact) -> Self {
        Self {
            t_s,
            x1_m: 0.0,
            v1_m_per_s: 0.0,
            a1_m_per_s2: 0.0,
            x2_m: 0.0,
            v2_m_per_s: 0.0,
            a2_m_per_s2: 0.0,
            force_n: 0.0,
            motion: Motion::Stuck,
            contact,
        }
    }
}

/// A stretch of time within one mode, on which the motion is one polynomial.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    start_s: f64,
    /// Time that corresponds to 1 in the polynomials \[s\].
    unit_s: f64,
    /// Where the segment ends, in units.
    end: f64,
    x1: [f64; 6],
    x2: Polynomial,
    stiffness_n_per_m: f64,
    damping_n_s_per_m: f64,
    /// `x1 - x2` at which the spring is relaxed \[m\].
    relaxed_m: f64,
    motion: Motion,
    contact: Contact,
    frictionless: bool,
}

impl Segment {
    /// Start \[s\].
    pub fn start_s(&self) -> f64 {
        self.start_s
    }

    /// End \[s\].
    pub fn end_s(&self) -> f64 {
        self.start_s + self.unit_s * self.end
    }

    /// Length \[s\], free of the rounding of `end - start`.
    pub fn duration_s(&self) -> f64 {
        self.unit_s * self.end
    }

    /// State at `t_s`, which is held to the segment.
    pub fn at(&self, t_s: f64) -> Truth {
        Truth { t_s, ..self.at_unit(((t_s - self.start_s) / self.unit_s).clamp(0.0, self.end)) }
    }

    /// State at a fraction of the segment, 0 at its start and 1 at its end.
    pub fn at_fraction(&self, fraction: f64) -> Truth {
        self.at_unit(self.end * fraction.clamp(0.0, 1.0))
    }

    fn at_unit(&self, u: f64) -> Truth {
        let h = self.unit_s;
        let v2 = slope(&self.x2, u) / h;
        let motion = match self.motion {
            Motion::Stuck => Motion::Stuck,
            _ if self.frictionless && v2 > 0.0 => Motion::Forward,
            _ if self.frictionless && v2 < 0.0 => Motion::Backward,
            _ if self.frictionless => Motion::Stuck,
            other => other,
        };
        Truth {
            t_s: self.start_s + u * h,
            x1_m: value(&self.x1, u),
            v1_m_per_s: slope(&self.x1, u) / h,
            a1_m_per_s2: curvature(&self.x1, u) / (h * h),
            x2_m: value(&self.x2, u),
            v2_m_per_s: v2,
            a2_m_per_s2: curvature(&self.x2, u) / (h * h),
            force_n: self.force_n(u),
            motion,
            contact: self.contact,
        }
    }

    /// Contact force at `t_s` \[N\].
    pub(crate) fn force_at_n(&self, t_s: f64) -> f64 {
        self.force_n(((t_s - self.start_s) / self.unit_s).clamp(0.0, self.end))
    }

    /// Terminal displacement at `t_s` \[m\].
    pub(crate) fn x1_at_m(&self, t_s: f64) -> f64 {
        value(&self.x1, ((t_s - self.start_s) / self.unit_s).clamp(0.0, self.end))
    }

    /// Terminal acceleration at `t_s` \[m/s^2\].
    pub(crate) fn a1_at_m_per_s2(&self, t_s: f64) -> f64 {
        let u = ((t_s - self.start_s) / self.unit_s).clamp(0.0, self.end);
        curvature(&self.x1, u) / (self.unit_s * self.unit_s)
    }

    /// Screw displacement at `t_s` \[m\].
    pub(crate) fn x2_at_m(&self, t_s: f64) -> f64 {
        value(&self.x2, ((t_s - self.start_s) / self.unit_s).clamp(0.0, self.end))
    }

    fn force_n(&self, u: f64) -> f64 {
        if self.contact == Contact::Flight {
            return 0.0;
        }
        let stretch = value(&self.x1, u) - value(&self.x2, u) - self.relaxed_m;
        let rate = (slope(&self.x1, u) - slope(&self.x2, u)) / self.unit_s;
        self.stiffness_n_per_m * stretch + self.damping_n_s_per_m * rate
    }
}

/// What ends a segment.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Change {
    /// The screw comes to rest.
    Rest,
    /// The force overcomes friction in this direction.
    Free(Motion),
    /// The flanks part.
    Part,
    /// The flanks meet.
    Meet(Contact),
}

/// The device driven by a motion: an endless row of [`Segment`]s.
///
/// Starts at time zero, at rest in the middle of the backlash.
#[derive(Clone, Debug)]
pub struct Plant {
    parameters: Parameters,
    nodes: Nodes,
    node: Node,
    /// `x1` over the step, as a polynomial with the step as unit.
    x1: [f64; 6],
    /// Part of the step that is done.
    done: f64,
    /// Changes of mode within the step.
    changes: u32,
    forced: u64,
    x2_m: f64,
    v2_m_per_s: f64,
    motion: Motion,
    contact: Contact,
    /// The screw has just come free: any acceleration the other way is rounding.
    just_free: bool,
}

impl Plant {
    /// Checks the device and the motion.
    pub fn new(parameters: Parameters, excitation: Excitation) -> Result<Self, PlantError> {
        parameters.validate()?;
        let longest_s = LONGEST_STEP_S.min(STEP_RAD / parameters.fastest_rad_per_s());
        let step_s = longest_s.min(excitation.longest_step_s());
        Self::with_step(parameters, excitation, step_s)
    }

    /// The same with this step, from 1 us to 0.1 s, however fast device and motion are.
    ///
    /// Only to show how the error falls with the step: [`new`](Self::new) chooses one with which it is below 1e-9.
    pub fn with_step(parameters: Parameters, excitation: Excitation, step_s: f64) -> Result<Self, PlantError> {
        parameters.validate()?;
        excitation.validate()?;
        if !(SHORTEST_STEP_S..=0.1).contains(&step_s) {
            return Err(PlantError::OutOfRange { field: "step_s", value: step_s, min: SHORTEST_STEP_S, max: 0.1 });
        }
        let mut nodes = Nodes::new(excitation, step_s);
        let node = nodes.next_node();
        Ok(Self {
            parameters,
            nodes,
            node,
            x1: quintic(&node),
            done: 0.0,
            changes: 0,
            forced: 0,
            x2_m: 0.0,
            v2_m_per_s: 0.0,
            motion: if parameters.coulomb_n > 0.0 { Motion::Stuck } else { Motion::Forward },
            contact: if parameters.backlash_m > 0.0 { Contact::Flight } else { Contact::Closed },
            just_free: false,
        })
    }

    /// The device.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Times that time was moved on by force because changes of mode piled up; 0 in every run known.
    pub fn forced_steps(&self) -> u64 {
        self.forced
    }

    /// The state before time zero.
    pub(crate) fn rest_at(&self, t_s: f64) -> Truth {
        Truth::rest(t_s, if self.parameters.backlash_m > 0.0 { Contact::Flight } else { Contact::Closed })
    }

    /// The next stretch of time within one mode.
    pub fn next_segment(&mut self) -> Segment {
        if self.done >= 1.0 {
            self.node = self.nodes.next_node();
            self.x1 = quintic(&self.node);
            self.done = 0.0;
            self.changes = 0;
        }
        let mut segment = self.solve();
        let found = self.first_change(&segment);
        self.just_free = false;
        if self.changes >= MOST_CHANGES {
            self.forced += 1;
            segment.end = (1.0 / f64::from(MOST_CHANGES) / (1.0 - self.done)).min(1.0);
            self.advance(&segment);
            self.settle(&segment);
            return segment;
        }
        segment.end = found.map_or(1.0, |(u, _)| u);
        self.advance(&segment);
        if let Some((_, change)) = found {
            self.changes += 1;
            self.apply(change, &segment);
        }
        segment
    }

    /// Solves the equation of motion over what is left of the step.
    fn solve(&self) -> Segment {
        let p = &self.parameters;
        let left = 1.0 - self.done;
        let h = self.node.step_s * left;
        let x1 = if self.done == 0.0 { self.x1 } else { rebase(&self.x1, self.done, left) };
        let (ks, cs, side) = match self.contact {
            Contact::Flight => (0.0, 0.0, 0.0),
            Contact::Positive => (p.stiffness_n_per_m, p.contact_damping_n_s_per_m, 1.0),
            Contact::Negative => (p.stiffness_n_per_m, p.contact_damping_n_s_per_m, -1.0),
            Contact::Closed => (p.stiffness_n_per_m, p.contact_damping_n_s_per_m, 0.0),
        };
        let relaxed_m = side * 0.5 * p.backlash_m;
        let friction = match self.motion {
            Motion::Forward => p.coulomb_n,
            Motion::Backward => -p.coulomb_n,
            Motion::Stuck => 0.0,
        };
        let mut x2 = [0.0; LENGTH];
        x2[0] = self.x2_m;
        if self.motion != Motion::Stuck {
            x2[1] = self.v2_m_per_s * h;
            let per_mass = h * h / p.inertance_kg;
            let spring = ks * per_mass;
            let contact = cs * per_mass / h;
            let viscous = p.viscous_n_s_per_m * per_mass / h;
            for k in 0..LENGTH - 2 {
                let n = k as f64;
                let x1_k = x1.get(k).copied().unwrap_or(0.0);
                let x1_next = x1.get(k + 1).copied().unwrap_or(0.0);
                let stretch = x1_k - x2[k] - if k == 0 { relaxed_m } else { 0.0 };
                let mut sum = spring * stretch + contact * (n + 1.0) * (x1_next - x2[k + 1]);
                sum -= viscous * (n + 1.0) * x2[k + 1];
                if k == 0 {
                    sum -= friction * per_mass;
                }
                x2[k + 2] = sum / ((n + 1.0) * (n + 2.0));
            }
        }
        Segment {
            start_s: self.node.start_s + self.node.step_s * self.done,
            unit_s: h,
            end: 1.0,
            x1,
            x2,
            stiffness_n_per_m: ks,
            damping_n_s_per_m: cs,
            relaxed_m,
            motion: self.motion,
            contact: self.contact,
            frictionless: p.coulomb_n == 0.0,
        }
    }

    /// The first change of mode within the segment, where there is one.
    fn first_change(&self, segment: &Segment) -> Option<(f64, Change)> {
        let mut first: Option<(f64, Change)> = None;
        let mut offer = |falling: &Polynomial, change| {
            if let Some(u) = first_fall(falling)
                && first.is_none_or(|(earliest, _)| u < earliest)
            {
                first = Some((u, change));
            }
        };
        let fc = self.parameters.coulomb_n;
        let half_gap = 0.5 * self.parameters.backlash_m;
        if self.motion == Motion::Stuck {
            if self.contact != Contact::Flight {
                let force = force_polynomial(segment);
                let mut room = force;
                room[0] = fc + force[0];
                offer(&room, Change::Free(Motion::Backward));
                let mut room = force.map(|c| -c);
                room[0] += fc;
                offer(&room, Change::Free(Motion::Forward));
            }
        } else if fc > 0.0 {
            let sign = if self.motion == Motion::Forward { 1.0 } else { -1.0 };
            let mut speed = [0.0; LENGTH];
            for (k, slot) in speed.iter_mut().enumerate().take(LENGTH - 1) {
                *slot = sign * (k + 1) as f64 * segment.x2[k + 1];
            }
            if self.just_free {
                speed[1] = speed[1].max(0.0);
            }
            offer(&speed, Change::Rest);
        }
        if self.contact != Contact::Closed {
            let mut d = segment.x2.map(|c| -c);
            d.iter_mut().zip(segment.x1).for_each(|(d, x1)| *d += x1);
            let mut below = d.map(|c| -c);
            below[0] += half_gap;
            let mut above = d;
            above[0] += half_gap;
            match self.contact {
                Contact::Flight => {
                    offer(&below, Change::Meet(Contact::Positive));
                    offer(&above, Change::Meet(Contact::Negative));
                }
                Contact::Positive => offer(&below.map(|c| -c), Change::Part),
                _ => offer(&above.map(|c| -c), Change::Part),
            }
        }
        first
    }

    /// Moves the state to the segment's end.
    fn advance(&mut self, segment: &Segment) {
        if self.motion != Motion::Stuck {
            self.x2_m = value(&segment.x2, segment.end);
            self.v2_m_per_s = slope(&segment.x2, segment.end) / segment.unit_s;
        }
        self.done = if segment.end >= 1.0 { 1.0 } else { self.done + (1.0 - self.done) * segment.end };
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
                self.contact = Contact::Flight;
            }
            Change::Meet(side) => {
                self.contact = side;
                if self.motion == Motion::Stuck {
                    // The spring is relaxed here: the force is the damper's.
                    let rate = slope(&segment.x1, segment.end) / segment.unit_s;
                    self.hold_or_free(self.parameters.contact_damping_n_s_per_m * rate);
                }
            }
        }
    }

    /// At rest: friction holds the screw or the force sets it free.
    fn hold_or_free(&mut self, force_n: f64) {
        self.just_free = force_n.abs() > self.parameters.coulomb_n;
        self.motion = match force_n {
            f if !self.just_free || f == 0.0 => Motion::Stuck,
            f if f > 0.0 => Motion::Forward,
            _ => Motion::Backward,
        };
    }

    /// After a forced step: takes the mode from the state.
    fn settle(&mut self, segment: &Segment) {
        let d = value(&segment.x1, segment.end) - self.x2_m;
        let half_gap = 0.5 * self.parameters.backlash_m;
        if self.contact != Contact::Closed {
            self.contact = match d {
                d if d > half_gap => Contact::Positive,
                d if d < -half_gap => Contact::Negative,
                _ => Contact::Flight,
            };
        }
        if self.parameters.coulomb_n > 0.0 {
            if self.v2_m_per_s == 0.0 {
                self.hold_or_free(if self.contact == Contact::Flight { 0.0 } else { segment.force_n(segment.end) });
            } else {
                self.motion = if self.v2_m_per_s > 0.0 { Motion::Forward } else { Motion::Backward };
            }
        }
    }
}

/// Contact force over a segment, whose unit is the segment's.
fn force_polynomial(segment: &Segment) -> Polynomial {
    let mut d = segment.x2.map(|c| -c);
    d.iter_mut().zip(segment.x1).for_each(|(d, x1)| *d += x1);
    let damping = segment.damping_n_s_per_m / segment.unit_s;
    let mut force = [0.0; LENGTH];
    for (k, slot) in force.iter_mut().enumerate() {
        let next = d.get(k + 1).copied().unwrap_or(0.0);
        let relaxed = if k == 0 { segment.relaxed_m } else { 0.0 };
        *slot = segment.stiffness_n_per_m * (d[k] - relaxed) + damping * (k + 1) as f64 * next;
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
        let mut plant = Plant::new(Parameters::worn(), Excitation::sine(15.9, 0.8e-3)).unwrap();
        let mut end_s = 0.0;
        for _ in 0..50_000 {
            // As if a thousand changes had been met already.
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
