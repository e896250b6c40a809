//! A second plant, which shares only the law with the first. No constant of the estimator was tuned on it.
//!
//! Fourth-order Runge-Kutta in steps of 1/16 ms. Coulomb friction changes its sign with the velocity, at a moment
//! located within the step. Presliding friction follows Iwan and Masing: four elastoplastic elements in parallel, which
//! slip one after the other. The flanks meet softly (their damping increases over the first micrometre), and never pull
//! if there is backlash. Everything that breaks the law acts on the screw itself ([`Body`]).
//! Source: Iwan, "A distributed-element model for hysteresis", J. Appl. Mech. 33 (1966); Al-Bender, Lampaert and
//! Swevers, "The generalized Maxwell-slip model", IEEE Trans. Automatic Control 50 (2005).

use inerter_plant::{Excitation, Inerter, PlantError, Point, Sensors, Simulation};
use std::f64::consts::TAU;

/// Step \[s\].
const STEP_S: f64 = 1.0 / 16_000.0;
/// Steps between two stored values.
const KEPT: usize = 2;
/// Steps between the times at which the terminal's motion is computed; a quintic interpolates between them.
const NODE_STEPS: usize = 8;
/// Distances at which the elements of dry friction slip, relative to the total, and their shares of the force.
const ELEMENTS: [(f64, f64); 4] = [(0.25, 0.4), (0.5, 0.3), (0.75, 0.2), (1.0, 0.1)];
/// Iterations for the moment of zero velocity: each gains one or two digits.
const TRIES: u32 = 6;
/// Depth over which the damping of the flanks sets in \[m\].
const SOFT_M: f64 = 1e-6;

/// Position and force at equal time steps, as input of the instruments.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    /// Time between two values \[s\].
    pub step_s: f64,
    /// Displacement of the screw \[m\].
    pub position_m: Vec<f64>,
    /// Force on the load cell \[N\].
    pub force_n: Vec<f64>,
}

impl Trace {
    /// A signal at any time, by cubic interpolation through four neighbours; constant beyond the ends.
    pub fn at(&self, signal: &[f64], t_s: f64) -> f64 {
        let place = (t_s / self.step_s).max(0.0);
        let (whole, part) = (place.floor() as usize, place.fract());
        let of =
            |offset: usize| signal.get((whole + offset).saturating_sub(1)).or(signal.last()).copied().unwrap_or(0.0);
        let [a, b, c, d] = [0, 1, 2, 3].map(of);
        let (linear, square) = (0.5 * (c - a), a - 2.5 * b + 2.0 * c - 0.5 * d);
        let cube = 0.5 * (d - a) + 1.5 * (b - c);
        b + part * (linear + part * (square + part * cube))
    }
}

/// Forces on the screw besides the law; none by default.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Friction per force.
    pub load: f64,
    /// Travel per turn \[m\]. The two ripples vary once per turn.
    pub turn_m: f64,
    /// Amplitude of the force once per turn \[N\].
    pub ripple_n: f64,
    /// Amplitude of the variation of friction once per turn, as a fraction of the friction.
    pub ripple_friction: f64,
    /// Stribeck friction: excess at rest as a fraction of the Coulomb friction, the velocity over which it decays
    /// \[m/s\], and the exponent of the decay.
    pub stribeck: (f64, f64, f64),
    /// Presliding distance \[m\]; 0 for Coulomb friction.
    pub presliding_m: f64,
    /// Fractions by which dry and viscous friction change over the run, and the time constant of the change as a
    /// fraction of the run.
    pub warming: (f64, f64, f64),
    /// Friction proportional to the square of the velocity \[N s^2/m^2\].
    pub quadratic: f64,
    /// Fraction by which the inertance grows per metre.
    pub inertance_by_place: f64,
    /// Fraction by which the inertance grows per square of the velocity \[s^2/m^2\].
    pub inertance_by_speed: f64,
    /// Spring in parallel \[N/m\].
    pub spring_n_per_m: f64,
    /// A force that changes its sign with the position \[N\], and the distance over which it does so \[m\].
    pub hose: (f64, f64),
    /// Distance of two bumpers from the centre \[m\], and their stiffness \[N/m\].
    pub stop: (f64, f64),
    /// Force at which the flywheel slips on its shaft, as felt at the terminal \[N\]; infinite if it never slips.
    pub slip_n: f64,
    /// Stiffness of the shaft to the flywheel, as felt at the terminal \[N/m\]; infinite if it is rigid.
    pub shaft_n_per_m: f64,
    /// A damper behind a spring: damping \[N s/m\] and time constant \[s\].
    pub relaxing: (f64, f64),
}

impl Default for Body {
    fn default() -> Self {
        Self {
            load: 0.0,
            turn_m: 0.01,
            ripple_n: 0.0,
            ripple_friction: 0.0,
            stribeck: (0.0, 1.0, 1.0),
            presliding_m: 0.0,
            warming: (0.0, 0.0, 1.0),
            quadratic: 0.0,
            inertance_by_place: 0.0,
            inertance_by_speed: 0.0,
            spring_n_per_m: 0.0,
            hose: (0.0, 1.0),
            stop: (f64::INFINITY, 0.0),
            slip_n: f64::INFINITY,
            shaft_n_per_m: f64::INFINITY,
            relaxing: (0.0, 1.0),
        }
    }
}

/// Fraction of the inertance that turns with the screw if the flywheel is not rigidly attached.
const SCREW_PART: f64 = 0.05;

/// The moving parts: screw, flywheel, and the spring of the relaxing damper.
#[derive(Clone, Copy, Debug, Default)]
struct State {
    x: f64,
    v: f64,
    wheel_x: f64,
    wheel_v: f64,
    relaxing_n: f64,
}

impl State {
    fn plus(self, rate: Self, h: f64) -> Self {
        Self {
            x: self.x + h * rate.x,
            v: self.v + h * rate.v,
            wheel_x: self.wheel_x + h * rate.wheel_x,
            wheel_v: self.wheel_v + h * rate.wheel_v,
            relaxing_n: self.relaxing_n + h * rate.relaxing_n,
        }
    }
}

/// The running plant.
struct Plant {
    device: Inerter,
    body: Body,
    duration_s: f64,
    /// Deflection of each element of dry friction \[m\], and the position of the screw at that deflection \[m\].
    elements: [f64; 4],
    since_m: f64,
    /// Direction in which Coulomb friction acts: 1 against forward motion, 0 if the screw is stuck.
    way: f64,
}

impl Plant {
    fn elements_at(&self, x: f64) -> [f64; 4] {
        std::array::from_fn(|i| {
            let reach = ELEMENTS[i].0 * self.body.presliding_m;
            (self.elements[i] + x - self.since_m).clamp(-reach, reach)
        })
    }

    fn is_coulomb(&self) -> bool {
        self.body.presliding_m == 0.0
    }

    /// Dry friction relative to its level, from -1 to 1: by the direction of motion, or by the deflection of its
    /// elements.
    fn turned(&self, x: f64) -> f64 {
        if self.is_coulomb() {
            return self.way;
        }
        let parts = self.elements_at(x).into_iter().zip(ELEMENTS);
        parts.map(|(at, (reach, share))| share * at / (reach * self.body.presliding_m)).sum()
    }

    fn contact_n(&self, state: &State, terminal: &Point) -> f64 {
        let device = &self.device;
        let (d, rate) = (terminal.x_m - state.x, terminal.v_m_per_s - state.v);
        if device.backlash_m == 0.0 && device.unilateral == 0.0 {
            return device.stiffness_n_per_m * d + device.contact_damping_n_s_per_m * rate;
        }
        let depth = d.abs() - 0.5 * device.backlash_m;
        if depth <= 0.0 {
            return 0.0;
        }
        let soft = (depth / SOFT_M).min(1.0);
        let push = device.stiffness_n_per_m * depth + soft * device.contact_damping_n_s_per_m * rate * d.signum();
        push.max(0.0) * d.signum()
    }

    /// Level of dry friction \[N\], and viscous friction \[N s/m\].
    fn friction(&self, state: &State, t_s: f64, contact_n: f64) -> (f64, f64) {
        let (device, body) = (&self.device, &self.body);
        let (fc_part, cf_part, settles) = body.warming;
        let warmth = 1.0 - (-t_s / (settles * self.duration_s)).exp();
        let direction = if self.is_coulomb() { self.way } else { (state.v / 1e-4).tanh() };
        let (surplus, fall, power) = body.stribeck;
        let slow = if surplus > 0.0 { surplus * (-(state.v.abs() / fall).powf(power)).exp() } else { 0.0 };
        let turn = (TAU * state.x / body.turn_m + 1.0).sin();
        let level = device.coulomb_n
            * (1.0 + slow)
            * (1.0 + fc_part * warmth)
            * (1.0 + body.ripple_friction * turn)
            * (1.0 + device.coulomb_asymmetry * direction)
            + body.load * contact_n.abs();
        let viscous =
            device.viscous_n_s_per_m * (1.0 + cf_part * warmth) * (1.0 + device.viscous_asymmetry * direction);
        (level, viscous)
    }

    /// Sum of all forces on the screw except dry friction \[N\], and the level of dry friction \[N\].
    fn acting(&self, state: &State, t_s: f64, terminal: &Point) -> (f64, f64) {
        let (device, body) = (&self.device, &self.body);
        let contact_n = self.contact_n(state, terminal);
        let (stop_m, stop_n_per_m) = body.stop;
        let (hose_n, hose_m) = body.hose;
        let beyond = if state.x.abs() > stop_m { state.x - stop_m * state.x.signum() } else { 0.0 };
        let beside = body.ripple_n * (TAU * state.x / body.turn_m + 0.3).sin()
            + body.spring_n_per_m * state.x
            + hose_n * (state.x / hose_m).tanh()
            + stop_n_per_m * beyond
            + state.relaxing_n;
        let (level, viscous) = self.friction(state, t_s, contact_n);
        let moving = viscous * state.v + body.quadratic * state.v.abs() * state.v;
        (contact_n + device.constant_force_n - moving - beside - self.wheel_n(state), level)
    }

    /// Force that the shaft transmits to a flywheel that is not rigidly attached \[N\].
    fn wheel_n(&self, state: &State) -> f64 {
        let (body, screw) = (&self.body, SCREW_PART * self.device.inertance_kg);
        if body.shaft_n_per_m.is_finite() {
            let damping = 0.02 * (body.shaft_n_per_m * screw).sqrt();
            body.shaft_n_per_m * (state.x - state.wheel_x) + damping * (state.v - state.wheel_v)
        } else if body.slip_n.is_finite() {
            // Held by friction: a steep damper up to the slip limit.
            (screw * 4000.0 * (state.v - state.wheel_v)).clamp(-body.slip_n, body.slip_n)
        } else {
            0.0
        }
    }

    fn rate(&self, state: &State, t_s: f64, terminal: &Point) -> State {
        let body = &self.body;
        let (acting, level) = self.acting(state, t_s, terminal);
        let force = acting - level * self.turned(state.x);
        let whole = self.device.inertance_kg;
        let (damping, time_s) = body.relaxing;
        let mut rate = State {
            x: state.v,
            relaxing_n: if damping > 0.0 { (damping * state.v - state.relaxing_n) / time_s } else { 0.0 },
            ..State::default()
        };
        let is_rigid = body.slip_n.is_infinite() && body.shaft_n_per_m.is_infinite();
        if is_rigid {
            // From the energy m(x) v^2 / 2, and from a momentum that depends on the speed.
            let by_speed = body.inertance_by_speed * state.v * state.v;
            let mass = whole * (1.0 + body.inertance_by_place * state.x + 3.0 * by_speed);
            rate.v = (force - 0.5 * whole * body.inertance_by_place * state.v * state.v) / mass;
            return rate;
        }
        let (screw, wheel) = (SCREW_PART * whole, (1.0 - SCREW_PART) * whole);
        rate.v = force / screw;
        (rate.wheel_x, rate.wheel_v) = (state.wheel_v, self.wheel_n(state) / wheel);
        rate
    }

    /// Advances from the fraction `from` of a step to the fraction `to`, with the terminal's motion within the step.
    fn advanced(&self, state: State, t_s: f64, [from, to]: [f64; 2], terminal: &impl Fn(f64) -> Point) -> State {
        let (h, middle) = ((to - from) * STEP_S, 0.5 * (from + to));
        let at = |state: State, part: f64| self.rate(&state, t_s + part * STEP_S, &terminal(part));
        let a = at(state, from);
        let b = at(state.plus(a, 0.5 * h), middle);
        let c = at(state.plus(b, 0.5 * h), middle);
        let d = at(state.plus(c, h), to);
        state.plus(a, h / 6.0).plus(b, h / 3.0).plus(c, h / 3.0).plus(d, h / 6.0)
    }

    /// Direction in which the acting force sets a stuck screw in motion; 0 if it stays stuck.
    fn freed(&self, state: &State, t_s: f64, terminal: &Point) -> f64 {
        let (acting, level) = self.acting(state, t_s, terminal);
        if acting.abs() > level { acting.signum() } else { 0.0 }
    }

    fn step(&mut self, state: State, t_s: f64, terminal: impl Fn(f64) -> Point) -> State {
        if !self.is_coulomb() {
            let next = self.advanced(state, t_s, [0.0, 1.0], &terminal);
            self.elements = self.elements_at(next.x);
            self.since_m = next.x;
            return next;
        }
        if self.way == 0.0 {
            self.way = self.freed(&state, t_s, &terminal(0.0));
            if self.way == 0.0 {
                return State { v: 0.0, ..state };
            }
        }
        let next = self.advanced(state, t_s, [0.0, 1.0], &terminal);
        if next.v * self.way >= 0.0 {
            return next;
        }
        // The velocity crosses zero within the step: regula falsi, with the weight of the retained end halved (Illinois
        // method).
        let (mut low, mut high) = ((0.0, state.v), (1.0, next.v));
        let (mut part, mut at) = (0.0, state);
        for _ in 0..TRIES {
            part = low.0 + (high.0 - low.0) * low.1 / (low.1 - high.1);
            at = self.advanced(state, t_s, [0.0, part], &terminal);
            if at.v * self.way >= 0.0 {
                (low, high.1) = ((part, at.v), 0.5 * high.1);
            } else {
                (high, low.1) = ((part, at.v), 0.5 * low.1);
            }
        }
        let still = State { v: 0.0, ..at };
        self.way = 0.0;
        self.way = self.freed(&still, t_s + part * STEP_S, &terminal(part));
        if self.way == 0.0 { still } else { self.advanced(still, t_s, [part, 1.0], &terminal) }
    }
}

/// The terminal's motion between two nodes, `length_s` apart: the quintic through displacement, velocity and
/// acceleration.
fn between(a: &Point, b: &Point, length_s: f64, part: f64) -> Point {
    let (z, l) = (part, length_s);
    let (p0, v0, a0) = (a.x_m, a.v_m_per_s * l, a.a_m_per_s2 * l * l);
    let (p1, v1, a1) = (b.x_m, b.v_m_per_s * l, b.a_m_per_s2 * l * l);
    let rise = p1 - p0;
    let c3 = 10.0 * rise - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1;
    let c4 = -15.0 * rise + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1;
    let c5 = 6.0 * rise - 3.0 * (v0 + v1) - 0.5 * (a0 - a1);
    Point {
        x_m: p0 + z * (v0 + z * (0.5 * a0 + z * (c3 + z * (c4 + z * c5)))),
        v_m_per_s: (v0 + z * (a0 + z * (3.0 * c3 + z * (4.0 * c4 + z * 5.0 * c5)))) / l,
        a_m_per_s2: (a0 + z * (6.0 * c3 + z * (12.0 * c4 + z * 20.0 * c5))) / (l * l),
    }
}

/// Position and force of this device in this motion, before the instruments.
pub fn trace(device: &Inerter, body: &Body, excitation: &Excitation, duration_s: f64) -> Trace {
    let mut plant = Plant { device: *device, body: *body, duration_s, elements: [0.0; 4], since_m: 0.0, way: 0.0 };
    let node_s = STEP_S * NODE_STEPS as f64;
    let count = (duration_s / node_s).ceil() as usize;
    let mut trace = Trace { step_s: STEP_S * KEPT as f64, ..Trace::default() };
    let mut state = State::default();
    let mut next = excitation.at(0.0);
    for node in 0..count {
        let here = next;
        next = excitation.at((node + 1) as f64 * node_s);
        for step in 0..NODE_STEPS {
            let terminal = |part: f64| between(&here, &next, node_s, (step as f64 + part) / NODE_STEPS as f64);
            if step % KEPT == 0 {
                let now = terminal(0.0);
                trace.position_m.push(state.x);
                trace.force_n.push(plant.contact_n(&state, &now) + device.structure_mass_kg * now.a_m_per_s2);
            }
            state = plant.step(state, node as f64 * node_s + step as f64 * STEP_S, terminal);
        }
    }
    trace
}

/// The same trace from the first plant, which has its own ways to break the law.
pub fn first_trace(device: &Inerter, excitation: &Excitation, duration_s: f64) -> Result<Trace, PlantError> {
    let step_s = STEP_S * KEPT as f64;
    let sensors = Sensors { sample_rate_hz: step_s.recip(), ..Sensors::default() };
    let mut trace = Trace { step_s, ..Trace::default() };
    for sample in Simulation::new(*device, excitation.clone(), sensors)?.lasting(duration_s) {
        trace.position_m.push(sample.truth.x2_m);
        trace.force_n.push(sample.truth.force_n + device.structure_mass_kg * sample.truth.a1_m_per_s2);
    }
    Ok(trace)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::rms;

    /// Both plants, written independently, agree on the same device.
    #[test]
    fn both_plants_move_alike() {
        for (name, device, limit) in [
            ("random", Inerter::paper(), 0.005),
            ("mid", Inerter::paper(), 0.005),
            ("mid", Inerter { viscous_asymmetry: 0.4, coulomb_asymmetry: 0.3, ..Inerter::paper() }, 0.005),
        ] {
            let excitation = Excitation::parse(name, 5).unwrap();
            let (first, second) =
                (first_trace(&device, &excitation, 3.0).unwrap(), trace(&device, &Body::default(), &excitation, 3.0));
            let off = |a: &[f64], b: &[f64]| rms(a.iter().zip(b).map(|(a, b)| a - b)) / rms(a.iter().copied());
            assert!(first.force_n.len().abs_diff(second.force_n.len()) <= 4);
            assert!(off(&first.force_n, &second.force_n) < limit, "{name}: {}", off(&first.force_n, &second.force_n));
            assert!(off(&first.position_m, &second.position_m) < limit, "{name}");
        }
    }

    /// Each way to break the law changes the force noticeably.
    #[test]
    fn every_part_of_the_body_is_felt() {
        let whole = Body::default();
        let excitation = Excitation::parse("random", 6).unwrap();
        let device = Inerter::paper();
        let clean = trace(&device, &whole, &excitation, 3.0);
        for (name, body) in [
            ("load", Body { load: 0.02, ..whole }),
            ("ripple", Body { ripple_n: 10.0, ..whole }),
            ("ripple of friction", Body { ripple_friction: 0.3, ..whole }),
            ("stribeck", Body { stribeck: (0.3, 5e-3, 2.0), ..whole }),
            ("presliding", Body { presliding_m: 50e-6, ..whole }),
            ("warming", Body { warming: (-0.3, -0.3, 0.5), ..whole }),
            ("quadratic", Body { quadratic: 1000.0, ..whole }),
            ("by place", Body { inertance_by_place: 20.0, ..whole }),
            ("by speed", Body { inertance_by_speed: 30.0, ..whole }),
            ("spring", Body { spring_n_per_m: 2000.0, ..whole }),
            ("hose", Body { hose: (10.0, 2e-3), ..whole }),
            ("stop", Body { stop: (1e-3, 1e5), ..whole }),
            ("slip", Body { slip_n: 300.0, ..whole }),
            ("shaft", Body { shaft_n_per_m: 3e7, ..whole }),
            ("relaxing", Body { relaxing: (300.0, 0.02), ..whole }),
        ] {
            let other = trace(&device, &body, &excitation, 3.0);
            let off = rms(clean.force_n.iter().zip(&other.force_n).map(|(a, b)| a - b));
            assert!(off.is_finite() && off > 0.5, "{name}: {off} N");
        }
    }

    #[test]
    fn a_signal_is_read_between_its_values() {
        let step_s = 1.0 / 8000.0;
        let signal: Vec<f64> = (0..800).map(|n| (n as f64 * step_s * 100.0).sin()).collect();
        let trace = Trace { step_s, ..Trace::default() };
        for k in 0..500 {
            let t_s = 1e-3 + f64::from(k) * 0.183e-3;
            assert!((trace.at(&signal, t_s) - (100.0 * t_s).sin()).abs() < 1e-6);
        }
    }
}
