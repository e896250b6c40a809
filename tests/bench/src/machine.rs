//! The machine of the bench: its motion, its sensors, and the regressors that one matched kernel makes of them.

use crate::kernels::Kernels;
use inerter_core::RawSample;

/// Samples per second.
pub const RATE_HZ: f64 = 1000.0;
/// Encoder step \[m\].
pub const METRES_PER_COUNT: f64 = 50e-9;
/// Force code \[N\].
pub const NEWTONS_PER_CODE: f64 = 0.002;
/// Inertance \[kg\], viscous friction \[N s/m\], Coulomb friction \[N\], offset \[N\].
pub const TRUTH: [f64; 4] = [95.0, 203.0, 20.0, -3.2];
/// Standard deviation of the force's noise \[N\].
pub const FORCE_NOISE_N: f64 = 1.0;
/// Forgetting per update.
pub const FORGETTING: f64 = 0.999;
/// Updates that forgetting remembers.
pub const MEMORY: u32 = 1000;
/// Initial variance of every parameter where a method asks for one.
pub const VARIANCE: f64 = 1e5;
/// Length of the standstill \[s\].
pub const REST_S: f64 = 480.0;
/// Box of the matched kernel \[samples\].
const BOX: usize = 4;
/// Window of the gate at rest \[samples\], and what the encoder may move in it \[counts\].
const REST_WINDOW: usize = 24;
const REST_COUNTS: i32 = 2;

/// Input of a method at one update.
#[derive(Clone, Copy, Debug)]
pub struct Update {
    /// Regressors, e.g. `[a, v, sgn v, 1]` in SI.
    pub phi: [f64; 4],
    /// What they sum up to, e.g. the force \[N\].
    pub target: f64,
    /// Whether the gate passes it; only methods that say so use this.
    pub moving: bool,
}

impl Update {
    /// What these parameters leave over of the target.
    pub fn left(&self, parameters: [f64; 4]) -> f64 {
        self.target - self.phi.iter().zip(parameters).map(|(x, y)| x * y).sum::<f64>()
    }
}

/// The run: motion, then rest.
pub struct Run {
    /// What the sensors gave.
    pub raw: Vec<RawSample>,
    /// Raw samples that belong to the motion.
    pub moving: usize,
    /// What the kernels made of it.
    pub updates: Vec<Update>,
    /// Updates that belong to the motion.
    pub motion: usize,
}

impl Run {
    /// Makes it; always the same.
    pub fn new() -> Self {
        let (raw, moving) = record();
        let updates = regressors(&raw);
        let motion = moving - (raw.len() - updates.len());
        Self { raw, moving, updates, motion }
    }

    /// Updates of the motion.
    pub fn motion(&self) -> &[Update] {
        &self.updates[..self.motion]
    }
}

/// Velocity levels \[m/s\] and their durations \[s\], each half of a stroke; the other half has them negative.
pub const STAGES: [(f64, f64); 4] = [(0.0423, 0.4), (0.0826, 0.8), (0.1247, 1.2), (0.0423, 0.6)];
/// Acceleration between levels \[m/s^2\].
const RAMP: f64 = 2.5;
/// Strokes there and back.
pub const STROKES: usize = 4;

/// Plays the motion by the law, then the rest, through the sensors; also returns the number of samples in the motion.
fn record() -> (Vec<RawSample>, usize) {
    let mut noise = Noise(0x1234_5678_9abc_def1);
    let mut raw = Vec::new();
    let period = 1.0 / RATE_HZ;
    let [mass, viscous, coulomb, offset] = TRUTH;
    let (mut position, mut velocity) = (0.0_f64, 0.0_f64);
    let strokes = (0..2 * STROKES).flat_map(|half| {
        let direction = if half % 2 == 0 { 1.0 } else { -1.0 };
        STAGES
            .into_iter()
            .flat_map(move |(level, seconds)| std::iter::repeat_n(direction * level, (seconds * RATE_HZ) as usize))
    });
    let motion: Vec<f64> = strokes.collect();
    // The braking belongs to the rest: what a method has learnt is read before the stop.
    let moving = motion.len();
    let brake = std::iter::repeat_n(0.0, (STAGES[3].0 / RAMP * RATE_HZ).ceil() as usize);
    for goal in motion.into_iter().chain(brake) {
        let step = (goal - velocity).clamp(-RAMP * period, RAMP * period);
        let acceleration = step / period;
        let friction = if velocity == 0.0 { step.signum() } else { velocity.signum() };
        let force = mass * acceleration + viscous * velocity + coulomb * friction + offset;
        raw.push(sensed(raw.len(), position, force + FORCE_NOISE_N * noise.normal()));
        position += velocity * period + 0.5 * step * period;
        velocity += step;
    }
    for _ in 0..(REST_S * RATE_HZ) as usize {
        let flicker = if noise.next() & 1 == 0 { 0.25 } else { 1.25 };
        let edge = (position / METRES_PER_COUNT).floor();
        let position = (edge + flicker) * METRES_PER_COUNT;
        raw.push(sensed(raw.len(), position, offset + FORCE_NOISE_N * noise.normal()));
    }
    (raw, moving)
}

/// What encoder and load cell make of position and force.
fn sensed(index: usize, position: f64, force: f64) -> RawSample {
    RawSample {
        index: index as u32,
        position_count: (position / METRES_PER_COUNT).floor() as i32,
        force_code: (force / NEWTONS_PER_CODE).round() as i32,
        terminal_code: 0,
    }
}

/// A fixed sequence of random numbers (xorshift).
pub struct Noise(pub u64);

impl Noise {
    /// The next 53 bits.
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 >> 11
    }

    /// Nearly normal: the sum of twelve uniform numbers.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.next() as f64 / (1_u64 << 53) as f64).sum::<f64>() - 6.0
    }
}

/// Regressors and force of every sample that a whole kernel reaches.
fn regressors(raw: &[RawSample]) -> Vec<Update> {
    let positions: Vec<f64> = raw.iter().map(|sample| f64::from(sample.position_count) * METRES_PER_COUNT).collect();
    let forces: Vec<f64> = raw.iter().map(|sample| f64::from(sample.force_code) * NEWTONS_PER_CODE).collect();
    // The sign over one sample, from the velocity over four on either side.
    let signs: Vec<f64> = (0..raw.len())
        .map(|n| {
            let (before, after) = (n.saturating_sub(4), (n + 4).min(raw.len() - 1));
            (positions[after] - positions[before]).partial_cmp(&0.0).map_or(0.0, |order| order as i8 as f64)
        })
        .collect();
    let kernels = Kernels::new(BOX, RATE_HZ);
    (0..=raw.len() - kernels.span)
        .map(|start| {
            let middle = start + kernels.span / 2;
            let from = middle.saturating_sub(REST_WINDOW / 2);
            let window = &raw[from..(from + REST_WINDOW).min(raw.len())];
            let counts = window.iter().map(|sample| sample.position_count);
            let travel = counts.clone().max().unwrap_or(0) - counts.min().unwrap_or(0);
            Update {
                phi: [
                    kernels.curvature.pass(&positions, start),
                    kernels.slope.pass(&positions, start),
                    kernels.value.pass(&signs, start),
                    1.0,
                ],
                target: kernels.value.pass(&forces, start),
                moving: travel > REST_COUNTS,
            }
        })
        .collect()
}
