//! Samples as the device would take them, each with the truth.

use std::collections::VecDeque;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};
use rand_distr::{Distribution, StandardNormal};

use crate::{Excitation, Inerter, Plant, PlantError, Segment, Sensors, Truth};

/// One sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time of the sample, the mean time of its sub-samples \[s\].
    pub t_s: f64,
    /// Number of the sample, wrapping; the number of a lost sample is skipped.
    pub index: u32,
    /// Encoder counts, summed over the sub-samples, wrapping.
    pub position_count: i32,
    /// Force codes, summed over the sub-samples. If any of them was at a limit, the whole sum is.
    pub force_code: i32,
    /// Code of the terminal sensor.
    pub terminal_code: i32,
    /// The true state at `t_s`.
    pub truth: Truth,
}

/// Manual handling of a device at rest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hands {
    /// Load on the load cell that is not a force on the screw, such as a weight hung on it \[N\].
    pub load_n: f64,
    /// Displacement of the screw in addition to its own motion \[m\].
    pub moved_m: f64,
}

/// A sample from which later ones are counted.
#[derive(Clone, Copy, Debug, Default)]
struct Since {
    /// Its sample number.
    number: u64,
    /// The plant's time at this sample \[s\].
    plant_s: f64,
    /// The plant's time zero on the instruments' clock \[s\].
    zero_s: f64,
}

/// Endless samples of a device in motion; the same seeds give the same samples.
#[derive(Clone, Debug)]
pub struct Simulation {
    plant: Plant,
    sensors: Sensors,
    /// Segments from the earliest time still needed to the latest solved.
    history: VecDeque<Segment>,
    number: u64,
    /// The sample since which rate and plant have been the same.
    since: Since,
    /// Load and displacement by hand, from the next sample on.
    pub hands: Hands,
    force_noise: ChaCha8Rng,
    terminal_noise: ChaCha8Rng,
    losses: ChaCha8Rng,
}

impl Simulation {
    /// Checks device, motion and instruments.
    pub fn new(device: Inerter, excitation: Excitation, sensors: Sensors) -> Result<Self, PlantError> {
        Self::of(Plant::new(device, excitation)?, sensors)
    }

    /// Samples a plant that is not yet in motion.
    pub fn of(plant: Plant, sensors: Sensors) -> Result<Self, PlantError> {
        sensors.validate()?;
        // One random stream each, so that enabling one kind of noise does not change the others.
        let stream = |number| {
            let mut rng = ChaCha8Rng::seed_from_u64(sensors.seed);
            rng.set_stream(number);
            rng
        };
        Ok(Self {
            plant,
            sensors,
            history: VecDeque::new(),
            number: 0,
            since: Since::default(),
            hands: Hands::default(),
            force_noise: stream(0),
            terminal_noise: stream(1),
            losses: stream(2),
        })
    }

    /// The instruments.
    pub fn sensors(&self) -> &Sensors {
        &self.sensors
    }

    /// The device and its solver.
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// Switches to another plant at its time zero, from the next sample on; the instruments continue.
    pub fn replace(&mut self, plant: Plant) {
        self.plant = plant;
        self.history.clear();
        self.since = Since { number: self.number, plant_s: 0.0, zero_s: self.since.zero_s + self.next_s() };
    }

    /// Changes the sample rate and the number of conversions per sample, from the next sample on; the motion continues.
    pub fn sample_at(&mut self, sample_rate_hz: f64, oversampling: f64) -> Result<(), PlantError> {
        let sensors = Sensors { sample_rate_hz, oversampling, ..self.sensors };
        sensors.validate()?;
        self.since = Since { number: self.number, plant_s: self.next_s(), ..self.since };
        self.sensors = sensors;
        Ok(())
    }

    /// The plant's time at the start of the next sample \[s\].
    fn next_s(&self) -> f64 {
        self.since.plant_s + (self.number - self.since.number) as f64 / self.sensors.sample_rate_hz
    }

    /// The same samples up to `duration_s` \[s\]; lost ones are not replaced.
    pub fn lasting(self, duration_s: f64) -> impl Iterator<Item = Sample> {
        self.take_while(move |sample| sample.t_s < duration_s)
    }

    /// Solves up to and including `latest_s`, and discards segments that ended before `earliest_s`.
    fn cover(&mut self, earliest_s: f64, latest_s: f64) {
        while self.history.back().is_none_or(|segment| segment.end_s() <= latest_s) {
            let segment = self.plant.next_segment();
            self.history.push_back(segment);
            self.forget(earliest_s);
        }
        self.forget(earliest_s);
    }

    /// Discards segments that ended before. The last such segment is kept: rounding may put a time on either side of a
    /// boundary.
    fn forget(&mut self, earliest_s: f64) {
        while self.history.get(1).is_some_and(|second| second.end_s() < earliest_s) {
            self.history.pop_front();
        }
    }

    /// The segment that contains `t_s`; `None` before the start.
    fn segment(&self, t_s: f64) -> Option<&Segment> {
        if t_s < 0.0 {
            return None;
        }
        let after = self.history.partition_point(|segment| segment.start_s() <= t_s);
        self.history.get(after.saturating_sub(1))
    }

    fn measure(&mut self) -> Sample {
        let sensors = self.sensors;
        let count = sensors.oversampling as u32;
        let index = self.number as u32;
        let (start_s, begun_s) = (self.next_s(), self.since.zero_s);
        let spacing_s = 1.0 / (sensors.sample_rate_hz * f64::from(count));
        let t_s = start_s + 0.5 * f64::from(count - 1) * spacing_s;
        let last_s = start_s + f64::from(count - 1) * spacing_s;
        self.number += 1;
        self.cover(start_s - sensors.delay_s.max(0.0), last_s - sensors.delay_s.min(0.0));

        let noise_n = sensors.force_noise_n * f64::from(count).sqrt();
        let (mut position, mut force, mut limit) = (0i64, 0i32, None);
        for k in 0..count {
            let now_s = start_s + f64::from(k) * spacing_s;
            let x2_m = self.hands.moved_m + self.segment(now_s).map_or(0.0, |segment| segment.x2_at_m(now_s));
            position = position.wrapping_add(sensors.count(x2_m));

            let then_s = now_s - sensors.delay_s;
            let cell_n = self.hands.load_n + self.segment(then_s).map_or(0.0, |segment| segment.cell_at_n(then_s));
            let noise = noise(noise_n, &mut self.force_noise);
            let (code, is_at_limit) = sensors.code(cell_n, begun_s + now_s, noise);
            // At most 64 codes of 24 bits: the sum fits.
            force += code;
            if is_at_limit {
                limit = Some(code);
            }
        }
        let force_code = limit.map_or(force, |code| code * count as i32);
        let truth = self.segment(t_s).map_or_else(|| self.plant.rest_at(t_s), |segment| segment.at(t_s));
        let noise_m = noise(sensors.terminal_noise_m, &mut self.terminal_noise);
        let x1_m = self.hands.moved_m + self.segment(t_s).map_or(0.0, |segment| segment.x1_at_m(t_s));
        let terminal_code = sensors.terminal_code(x1_m, noise_m);
        Sample { t_s: begun_s + t_s, index, position_count: position as i32, force_code, terminal_code, truth }
    }

    /// Whether the next sample is lost.
    fn loses(&mut self) -> bool {
        let p = self.sensors.lost_probability;
        p > 0.0 && ((self.losses.next_u64() >> 11) as f64 / (1u64 << 53) as f64) < p
    }
}

/// Gaussian noise with this rms; draws nothing if it is zero.
fn noise(rms: f64, rng: &mut ChaCha8Rng) -> f64 {
    if rms > 0.0 {
        let normal: f64 = StandardNormal.sample(rng);
        rms * normal
    } else {
        0.0
    }
}

impl Iterator for Simulation {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        loop {
            let sample = self.measure();
            if !self.loses() {
                return Some(sample);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hands_add_a_load_and_a_displacement_and_another_plant_goes_on_in_time() {
        let sensors =
            Sensors { newtons_per_code: 0.01, metres_per_count: 1e-6, force_gain: 1.01, ..Sensors::default() };
        let rest = || Plant::new(Inerter::paper(), Excitation::hold());
        let mut simulation = Simulation::of(rest().unwrap(), sensors).unwrap();
        let before = simulation.next().unwrap();
        simulation.hands = Hands { load_n: 20.0, moved_m: -3e-3 };
        let after = simulation.next().unwrap();
        assert_eq!((before.force_code, before.position_count), (0, 0));
        assert_eq!((after.force_code, after.position_count), (2020, -3000));
        let shaken = Excitation::parse("mid@1s", 1).unwrap();
        simulation.replace(Plant::new(Inerter::paper(), shaken).unwrap());
        let moving: Vec<Sample> = simulation.by_ref().take(1000).collect();
        assert!((moving[0].t_s - 2e-3).abs() < 1e-12 && moving[0].index == 2);
        let range =
            |of: fn(&Sample) -> i32| moving.iter().map(of).max().unwrap() - moving.iter().map(of).min().unwrap();
        assert!(range(|sample| sample.position_count) > 6000 && range(|sample| sample.force_code) > 50_000);
    }

    #[test]
    fn another_rate_takes_its_samples_from_the_same_motion() {
        let sensors = Sensors { sample_rate_hz: 1000.0, ..Sensors::default() };
        let of = |sensors| Simulation::new(Inerter::paper(), Excitation::parse("mid", 1).unwrap(), sensors).unwrap();
        let mut simulation = of(sensors);
        let before: Vec<Sample> = simulation.by_ref().take(500).collect();
        simulation.sample_at(4000.0, 1.0).unwrap();
        let after: Vec<Sample> = simulation.by_ref().take(2000).collect();
        let faster: Vec<Sample> = of(Sensors { sample_rate_hz: 4000.0, ..sensors }).take(4000).collect();
        assert_eq!(before.last().map(|sample| sample.position_count), Some(faster[4 * 499].position_count));
        for (mine, other) in after.iter().zip(&faster[2000..]) {
            assert!((mine.t_s - other.t_s).abs() < 1e-12, "{} {}", mine.t_s, other.t_s);
            assert!(
                (mine.position_count - other.position_count).abs() <= 1
                    && (mine.force_code - other.force_code).abs() <= 1
            );
        }
        assert_eq!((after[0].index, after[1999].index), (500, 2499));
        simulation.sample_at(1000.0, 4.0).unwrap();
        let sum = simulation.next().unwrap();
        assert!((sum.position_count - 4 * after[1999].position_count).abs() < 100, "{sum:?}");
        assert!(simulation.sample_at(0.0, 1.0).is_err() && simulation.sensors().sample_rate_hz == 1000.0);
    }
}
