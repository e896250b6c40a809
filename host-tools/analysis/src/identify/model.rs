//! The complete model: the response of screw and load cell to a known motion of the terminal.
//!
//! `x1` is the quintic through displacement, velocity and acceleration at the ends of each cell; within a mode of
//! stick, slip and contact the device is linear, and `x2` is the Taylor series that solves it for that quintic; a cell
//! is short enough that the series is exact to 1e-9. A change of mode is the root of a polynomial, found to the last
//! bits, so the force is a smooth function of the parameters. Only a change that begins and ends within one cell is
//! missed.
//!
//! Source: docs/THEORY.md, *The device*.

use std::f64::consts::TAU;

use super::parameters::Parameters;

/// Coefficients of a series, constant first.
const LENGTH: usize = 8;
type Series = [f64; LENGTH];
/// Maximum product of cell length and fastest rate: `0.25^8 / 8!` is 4e-10.
const CELL_RAD: f64 = 0.25;
/// Maximum cells per sample; a stiffer device cannot be resolved by its samples.
const MOST_CELLS: usize = 32;
/// Maximum changes of mode in a cell; the rest of the cell then passes without any.
const MOST_CHANGES: usize = 16;

/// Displacement, velocity and acceleration of the terminal at one time.
pub type Node = [f64; 3];

/// The terminal's motion as input of the simulation.
#[derive(Clone, Debug)]
pub struct Input {
    cell_s: f64,
    cells_per_sample: usize,
    cells: Vec<[f64; 6]>,
    /// Acceleration at each sample \[m/s^2\].
    pub acceleration: Vec<f64>,
}

impl Input {
    /// From the motion at each sample, for devices about as fast as this one.
    pub fn new(nodes: &[Node], period_s: f64, device: &Parameters) -> Self {
        let rate = (device.stiffness_n_per_m / device.inertance_kg)
            .sqrt()
            .max((device.contact_damping_n_s_per_m + device.viscous_n_s_per_m) / device.inertance_kg);
        let cells_per_sample = ((period_s * rate / CELL_RAD).ceil() as usize).clamp(1, MOST_CELLS);
        let part = 1.0 / cells_per_sample as f64;
        let mut cells = Vec::with_capacity(nodes.len() * cells_per_sample);
        for (first, last) in nodes.iter().zip(nodes.iter().skip(1)) {
            let whole = quintic(first, last, period_s);
            cells.extend((0..cells_per_sample).map(|number| rebased(&whole, number as f64 * part, part)));
        }
        // The last sample begins a cell too: the terminal continues as before.
        if let Some([x, v, a]) = nodes.last() {
            let cell_s = period_s * part;
            cells.push([*x, v * cell_s, a * cell_s * cell_s / 2.0, 0.0, 0.0, 0.0]);
        }
        let acceleration = nodes.iter().map(|[_, _, a]| *a).collect();
        Self { cell_s: period_s * part, cells_per_sample, cells, acceleration }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.acceleration.len()
    }
}

/// The model's prediction at each sample.
#[derive(Clone, Debug, Default)]
pub struct Response {
    /// Displacement of the screw \[m\].
    pub position_m: Vec<f64>,
    /// Force of the contact as a channel delayed by the skew samples it \[N\].
    pub force_n: Vec<f64>,
    /// The force's mean, without the skew, from one sample before to one after: where the flanks meet, the force jumps,
    /// and a sample is on one side of the jump or the other; the mean changes gradually, and so is a smooth function of
    /// the parameters. [`simpson`] computes the same from samples.
    pub mean_n: Vec<f64>,
}

/// State of the screw at the first sample.
#[derive(Clone, Copy, Debug, Default)]
pub struct Start {
    /// Displacement \[m\].
    pub position_m: f64,
    /// Velocity; 0 means at rest \[m/s\].
    pub velocity_m_per_s: f64,
}

/// State of the flanks.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Touch {
    /// There is no backlash.
    Closed,
    /// On this side, 1 or -1.
    Flank(f64),
    Flight,
}

/// The event that ends a mode.
#[derive(Clone, Copy, Debug)]
enum Change {
    Rest,
    Free(f64),
    Part,
    Meet(f64),
}

struct Screw<'a> {
    device: &'a Parameters,
    half_backlash: f64,
    x2: f64,
    v2: f64,
    /// Direction of slip; 0 means stuck.
    direction: f64,
    contact: Touch,
}

/// Simulates the response to the terminal's motion.
pub fn simulate(device: &Parameters, input: &Input, start: Start) -> Response {
    let mut response = Response::default();
    let Some(first) = input.cells.first() else { return response };
    response.position_m.reserve(input.len());
    let mut screw = Screw::new(device, first, input.cell_s, start);
    let sample_s = input.cell_s * input.cells_per_sample as f64;
    let late = device.skew_s / sample_s;
    // The sample is taken this many periods earlier, at this time within the period.
    let periods = late.ceil();
    let within_s = (periods - late) * sample_s;
    let mut forces = Vec::with_capacity(input.len());
    let mut before = None;
    for cells in input.cells.chunks(input.cells_per_sample) {
        response.position_m.push(screw.x2);
        let mut impulse = 0.0;
        let mut left_s = within_s;
        for cell in cells {
            let (passed, force) = screw.pass(cell, input.cell_s, left_s);
            impulse += passed;
            left_s -= input.cell_s;
            forces.extend(force);
        }
        // The last sample has no complete period after it.
        let after = if cells.len() == input.cells_per_sample { impulse / sample_s } else { before.unwrap_or_default() };
        response.mean_n.push(0.5 * (before.unwrap_or(after) + after));
        before = Some(after);
    }
    let last = forces.len().saturating_sub(1) as f64;
    response.force_n = (0..input.len())
        .map(|place| forces.get((place as f64 - periods).clamp(0.0, last) as usize).copied().unwrap_or_default())
        .collect();
    response
}

/// The mean of a signal that is smooth between samples, from one sample before to one after, by Simpson's rule:
/// accurate to 3 (f T)^4.
pub fn simpson(samples: &[f64]) -> Vec<f64> {
    let at = |place: usize| samples.get(place).copied();
    (0..samples.len())
        .map(|place| {
            let here = at(place).unwrap_or_default();
            let before = place.checked_sub(1).and_then(at).unwrap_or(here);
            (before + 4.0 * here + at(place + 1).unwrap_or(here)) / 6.0
        })
        .collect()
}

/// Gain of [`simpson`] at a frequency.
pub fn simpson_gain(frequency_hz: f64, period_s: f64) -> f64 {
    (2.0 + (TAU * frequency_hz * period_s).cos()) / 3.0
}

impl<'a> Screw<'a> {
    fn new(device: &'a Parameters, first: &[f64; 6], cell_s: f64, start: Start) -> Self {
        let half_backlash = 0.5 * device.backlash_m.max(0.0);
        let apart = first[0] - start.position_m;
        let contact = match apart {
            _ if half_backlash == 0.0 => Touch::Closed,
            apart if apart.abs() > half_backlash => Touch::Flank(apart.signum()),
            _ => Touch::Flight,
        };
        let (x2, v2) = (start.position_m, start.velocity_m_per_s);
        let mut screw = Self { device, half_backlash, x2, v2, direction: sign(v2), contact };
        if v2 == 0.0 {
            screw.hold_or_free(screw.force(first[0], first[1] / cell_s));
        }
        screw
    }

    /// Stiffness, damping, and the distance at which the spring is relaxed.
    fn spring(&self) -> (f64, f64, f64) {
        let (ks, cs) = (self.device.stiffness_n_per_m, self.device.contact_damping_n_s_per_m);
        match self.contact {
            Touch::Closed => (ks, cs, 0.0),
            Touch::Flank(side) => (ks, cs, side * self.half_backlash),
            Touch::Flight => (0.0, 0.0, 0.0),
        }
    }

    fn force(&self, x1: f64, v1: f64) -> f64 {
        let (ks, cs, relaxed) = self.spring();
        ks * (x1 - self.x2 - relaxed) + cs * (v1 - self.v2)
    }

    /// At rest: friction holds the screw, or the force frees it.
    fn hold_or_free(&mut self, force_n: f64) {
        self.v2 = 0.0;
        self.direction = if force_n.abs() > self.device.coulomb_n { sign(force_n) } else { 0.0 };
    }

    /// Simulates a cell; returns the impulse of the contact \[N s\], and its force after `at_s`, if that lies in the
    /// cell.
    fn pass(&mut self, cell: &[f64; 6], cell_s: f64, mut at_s: f64) -> (f64, Option<f64>) {
        let (mut x1, mut h) = (*cell, cell_s);
        let (mut impulse, mut force) = (0.0, None);
        for change_number in 0..=MOST_CHANGES {
            let x2 = self.series(&x1, h);
            let change = self.first_change(&x1, &x2, h).filter(|_| change_number < MOST_CHANGES);
            let u = change.map_or(1.0, |(u, _)| u);
            impulse += self.impulse(&x1, &x2, u, h);
            if at_s >= 0.0 && at_s < u * h {
                let (ks, cs, relaxed) = self.spring();
                let u = at_s / h;
                let rate = slope(&x1, u) - slope(&x2, u);
                force = Some(ks * (value(&x1, u) - value(&x2, u) - relaxed) + cs * rate / h);
            }
            at_s -= u * h;
            self.advance(&x2, u, h);
            let Some((_, change)) = change else { break };
            self.apply(change, value(&x1, u), slope(&x1, u) / h);
            let left = 1.0 - u;
            if left < 1e-9 {
                break;
            }
            x1 = rebased(&x1, u, left);
            h *= left;
        }
        // Rounding must not lose a sample at the very end.
        let at_end = || self.force(value(cell, 1.0), slope(cell, 1.0) / cell_s);
        (impulse, force.or_else(|| (-1e-12..=0.0).contains(&at_s).then(at_end)))
    }

    /// Impulse of the contact over part of a cell \[N s\].
    fn impulse(&self, x1: &[f64; 6], x2: &Series, u: f64, h: f64) -> f64 {
        let (ks, cs, relaxed) = self.spring();
        let spring = ks * h * (area(x1, u) - area(x2, u) - relaxed * u);
        spring + cs * (value(x1, u) - x1[0] - value(x2, u) + x2[0])
    }

    fn advance(&mut self, x2: &Series, u: f64, h: f64) {
        if self.direction != 0.0 {
            self.x2 = value(x2, u);
            self.v2 = slope(x2, u) / h;
        }
    }

    fn series(&self, x1: &[f64; 6], h: f64) -> Series {
        let mut x2 = [0.0; LENGTH];
        x2[0] = self.x2;
        if self.direction == 0.0 {
            return x2;
        }
        let (ks, cs, relaxed) = self.spring();
        let per_mass = h / self.device.inertance_kg;
        let (spring, damper, viscous) = (ks * per_mass * h, cs * per_mass, self.device.viscous_n_s_per_m * per_mass);
        let dry = self.direction * self.device.coulomb_n * per_mass * h;
        x2[1] = self.v2 * h;
        let terminal = |k: usize| x1.get(k).copied().unwrap_or(0.0);
        for k in 0..LENGTH - 2 {
            let next = (k + 1) as f64;
            let mut sum = spring * (terminal(k) - x2[k]) + damper * next * (terminal(k + 1) - x2[k + 1])
                - viscous * next * x2[k + 1];
            if k == 0 {
                sum -= spring * relaxed + dry;
            }
            x2[k + 2] = sum / (next * (next + 1.0));
        }
        x2
    }

    /// The first change of mode within the cell that is detected at its end.
    fn first_change(&self, x1: &[f64; 6], x2: &Series, h: f64) -> Option<(f64, Change)> {
        let mut first: Option<(f64, Change)> = None;
        let mut offer = |falling: &dyn Fn(f64) -> f64, change: Change| {
            if falling(1.0) < 0.0 {
                let u = root(falling);
                if first.is_none_or(|(earliest, _)| u < earliest) {
                    first = Some((u, change));
                }
            }
        };
        let (ks, cs, relaxed) = self.spring();
        if self.direction == 0.0 {
            if self.contact != Touch::Flight {
                let force = |u: f64| ks * (value(x1, u) - self.x2 - relaxed) + cs * slope(x1, u) / h;
                offer(&|u| self.device.coulomb_n - force(u), Change::Free(1.0));
                offer(&|u| self.device.coulomb_n + force(u), Change::Free(-1.0));
            }
        } else if self.device.coulomb_n > 0.0 {
            offer(&|u| self.direction * slope(x2, u), Change::Rest);
        }
        let apart = |u: f64| value(x1, u) - value(x2, u);
        match self.contact {
            Touch::Closed => {}
            Touch::Flank(side) => offer(&|u| side * apart(u) - self.half_backlash, Change::Part),
            Touch::Flight => {
                offer(&|u| self.half_backlash - apart(u), Change::Meet(1.0));
                offer(&|u| self.half_backlash + apart(u), Change::Meet(-1.0));
            }
        }
        first
    }

    fn apply(&mut self, change: Change, x1: f64, v1: f64) {
        match change {
            Change::Free(direction) => self.direction = direction,
            Change::Rest => {
                self.v2 = 0.0;
                self.hold_or_free(self.force(x1, v1));
            }
            Change::Part => self.contact = Touch::Flight,
            Change::Meet(side) => {
                self.contact = Touch::Flank(side);
                if self.direction == 0.0 {
                    self.hold_or_free(self.force(x1, v1));
                }
            }
        }
    }
}

fn sign(value: f64) -> f64 {
    if value == 0.0 { 0.0 } else { value.signum() }
}

/// Where a function that ends below zero crosses it, by regula falsi (Illinois variant).
fn root(falling: &dyn Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    let (mut at_low, mut at_high) = (falling(low), falling(high));
    if at_low < 0.0 {
        // It has just changed and is on the wrong side by rounding, or it comes back within the cell.
        low = 0.5;
        at_low = falling(low);
        if at_low < 0.0 {
            return 0.0;
        }
    }
    let mut below_before = None;
    for _ in 0..60 {
        let middle = low + (high - low) * at_low / (at_low - at_high);
        let at_middle = falling(middle);
        let below = at_middle < 0.0;
        if below {
            (high, at_high) = (middle, at_middle);
        } else {
            (low, at_low) = (middle, at_middle);
        }
        if at_middle == 0.0 || high - low < 1e-14 {
            return middle;
        }
        // The retained end counts half, so that both ends move.
        match below_before.replace(below) {
            Some(true) if below => at_low *= 0.5,
            Some(false) if !below => at_high *= 0.5,
            _ => {}
        }
    }
    high
}

fn value(c: &[f64], u: f64) -> f64 {
    c.iter().rev().fold(0.0, |sum, c| sum * u + c)
}

fn slope(c: &[f64], u: f64) -> f64 {
    c.iter().enumerate().skip(1).rev().fold(0.0, |sum, (k, c)| sum * u + k as f64 * c)
}

/// Integral from 0.
fn area(c: &[f64], u: f64) -> f64 {
    c.iter().enumerate().rev().fold(0.0, |sum, (k, c)| sum * u + c / (k + 1) as f64) * u
}

/// The same polynomial with its origin at `from`, and `part` of the unit as the new unit.
fn rebased(c: &[f64; 6], from: f64, part: f64) -> [f64; 6] {
    if from == 0.0 && part == 1.0 {
        return *c;
    }
    let mut shifted = *c;
    for round in 0..5 {
        for k in (round..5).rev() {
            shifted[k] += from * shifted[k + 1];
        }
    }
    let mut scale = 1.0;
    for c in &mut shifted {
        *c *= scale;
        scale *= part;
    }
    shifted
}

fn quintic(first: &Node, last: &Node, h: f64) -> [f64; 6] {
    let ([x0, v0, a0], [x1, v1, a1]) = (*first, *last);
    let (v0, v1, a0, a1, rise) = (h * v0, h * v1, h * h * a0, h * h * a1, x1 - x0);
    [
        x0,
        v0,
        0.5 * a0,
        10.0 * rise - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1,
        -15.0 * rise + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1,
        6.0 * rise - 3.0 * v0 - 3.0 * v1 - 0.5 * a0 + 0.5 * a1,
    ]
}

/// The load cell's reading of a contact force at each sample, with structure mass and offset \[N\].
pub fn load_cell(device: &Parameters, contact_n: &[f64], late_acceleration: &[f64]) -> Vec<f64> {
    contact_n
        .iter()
        .zip(late_acceleration)
        .map(|(force, acceleration)| force + device.structure_mass_kg * acceleration + device.offset_n)
        .collect()
}

/// The samples delayed by `late` periods, by the cubic through the four neighbours; the ends are held constant.
pub fn delayed(samples: &[f64], late: f64) -> Vec<f64> {
    if late == 0.0 {
        return samples.to_vec();
    }
    let whole = late.ceil();
    let u = whole - late;
    let weights = [
        -u * (u - 1.0) * (u - 2.0) / 6.0,
        (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
        -(u + 1.0) * u * (u - 2.0) / 2.0,
        (u + 1.0) * u * (u - 1.0) / 6.0,
    ];
    let last = samples.len() as i64 - 1;
    let at = |place: i64| samples.get(place.clamp(0, last.max(0)) as usize).copied().unwrap_or(0.0);
    (0..samples.len() as i64)
        .map(|place| {
            let base = place - whole as i64;
            (-1..=2).zip(weights).map(|(step, weight)| weight * at(base + step)).sum()
        })
        .collect()
}

#[cfg(test)]
#[path = "model_tests.rs"]
mod tests;
