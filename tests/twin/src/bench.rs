//! The test rig around the board: the simulated inerter, its sensors, and the amplifiers up to the pins.
//!
//! [`Rig`] describes the rig; [`Bench`] runs it and connects it to the chip through [`World`]. The encoder count is the
//! plant's screw position, quantised. The load cell's force passes an amplifier with a first-order anti-alias filter,
//! limited to the converter's supply range. The terminal's displacement is a voltage. The same numbers give the
//! settings of a device calibrated without error on this rig ([`Rig::settings`]), and the instruments with which the
//! plant's own simulation takes the same samples without a chip ([`Rig::sensors`]). [`replay`] feeds samples to core.

use std::collections::VecDeque;

use ads131m04::{Gain, Osr};
use inerter_app::boxcar::{UPPER_RAIL, WEIGHT};
use inerter_core::{Active, Counters, Estimate, FrontEnd, RawSample, Settings, SettingsError, State};
use inerter_plant::{Excitation, Inerter, Plant, PlantError, Segment, Sensors, Truth};

use crate::World;
use crate::chip::adc::{CODES, Quality, REFERENCE_V};

/// From the update event of the sampling clock to the converters' aperture \[s\]: trigger latency of 1.5 to 2.5 clocks
/// plus sampling time of 24.5 clocks at 42 MHz (DS12288, tLATR; firmware/stm32g474, SMP).
pub const APERTURE_S: f64 = (2.0 + 24.5) / 42e6;
/// Rate of the conversions that are summed to samples \[Hz\].
pub const TRIGGER_HZ: f64 = 64e3;
/// Clock of the digital front end (ADS131M04) \[Hz\].
pub const CLKIN_HZ: u32 = 8_000_000;
/// Full scale of the digital front end at gain 1 \[V\].
const DIGITAL_FULL_SCALE_V: f64 = 1.2;
/// Codes of the digital front end from zero to full scale.
const DIGITAL_CODES: f64 = 8_388_608.0;
/// How far into the past a signal can be read \[s\]: three conversions of the digital front end at its lowest rate.
const LOOK_BACK_S: f64 = 0.02;

/// The rig and its faults.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// The inerter.
    pub device: Inerter,
    /// Excitation of its terminal, from `start_s` on.
    pub motion: Excitation,
    /// Start of the motion \[s since power was applied\].
    pub start_s: f64,
    /// Displacement per encoder count; negative reverses the direction \[m\].
    pub metres_per_count: f64,
    /// Position within an encoder count at the start.
    pub encoder_phase_count: f64,
    /// Load cell and amplifier: force per volt; negative reverses the direction \[N/V\].
    pub newtons_per_volt: f64,
    /// Offset of the load cell, which the estimator must find \[N\].
    pub force_offset_n: f64,
    /// Time constant of the anti-alias filter, 0 for none \[s\].
    pub filter_s: f64,
    /// Terminal sensor: displacement per volt \[m/V\].
    pub metres_per_volt: f64,
    /// The bridge without an amplifier: force per volt at its outputs \[N/V\].
    pub newtons_per_bridge_volt: f64,
    /// Bridge excitation voltage at the digital front end, after the divider \[V\].
    pub excitation_v: f64,
    /// Temperature of the chip \[degree Celsius\].
    pub temperature_c: f64,
    /// Faults with their times.
    pub faults: Vec<Fault>,
}

/// A fault. Times are seconds since power was applied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// The encoder count jumps: someone turned the screw while nothing counted, or the counter is close to its wrap.
    Jump {
        /// Time of the jump \[s\].
        at_s: f64,
        /// Size of the jump, wrapping.
        counts: u32,
    },
    /// A sensor's cable is unplugged: the force or terminal pin falls to 0 V, or the encoder count stops.
    Unplugged {
        /// The sensor.
        sensor: Sensor,
        /// Start \[s\].
        from_s: f64,
        /// End \[s\].
        until_s: f64,
    },
    /// An additional force on the load cell, for example when somebody leans on it.
    Push {
        /// Start \[s\].
        from_s: f64,
        /// End \[s\].
        until_s: f64,
        /// Force \[N\].
        newtons: f64,
    },
}

/// A sensor with a cable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensor {
    /// Screw position.
    Encoder,
    /// Force.
    Force,
    /// Terminal displacement.
    Terminal,
}

impl Rig {
    /// Output of the amplifier and of the terminal sensor at zero: the middle of the converter's range \[V\].
    pub const ZERO_V: f64 = REFERENCE_V / 2.0;

    /// The paper's device, 20 kN over the converter's range (`fast` needs 16), 33 mm of terminal displacement, a filter
    /// of 10 us. For the digital front end: a load cell of 10 kN at 2 mV/V, and the divided bridge excitation of 2.5 V
    /// (docs/HARDWARE.md).
    pub fn new(motion: Excitation, start_s: f64) -> Self {
        Self {
            device: Inerter::paper(),
            motion,
            start_s,
            metres_per_count: 2.44140625e-6,
            encoder_phase_count: 0.37,
            newtons_per_volt: 20_000.0 / REFERENCE_V,
            force_offset_n: 3.0,
            filter_s: 10e-6,
            metres_per_volt: 0.033 / REFERENCE_V,
            newtons_per_bridge_volt: 10_000.0 / 5e-3,
            excitation_v: 2.5 / 2.8,
            temperature_c: 25.0,
            faults: Vec::new(),
        }
    }

    /// Force per code of one conversion \[N\].
    pub fn newtons_per_conversion(&self) -> f64 {
        self.newtons_per_volt * REFERENCE_V / CODES
    }

    /// Settings of a device calibrated without error on this rig, for one of the sample rates of the analogue front end
    /// \[Hz\].
    pub fn settings(&self, sample_rate_hz: f64) -> Settings {
        let weight = f64::from(WEIGHT);
        Settings {
            sample_rate_hz,
            metres_per_count: self.metres_per_count,
            oversampling: weight,
            newtons_per_code: self.newtons_per_conversion() / weight,
            force_zero_code: Self::ZERO_V / REFERENCE_V * CODES * weight,
            force_min_code: 0.0,
            force_max_code: f64::from(UPPER_RAIL),
            metres_per_terminal_code: self.metres_per_volt * REFERENCE_V / CODES / weight,
            structure_mass_kg: self.device.structure_mass_kg,
            stiffness_n_per_m: self.device.stiffness_n_per_m,
            contact_damping_n_s_per_m: self.device.contact_damping_n_s_per_m,
            skew_s: self.filter_s - APERTURE_S,
            force_gain_u95: 0.0,
            lead_u95: 0.0,
            timebase_u95: 0.0,
            ..Settings::default()
        }
    }

    /// The same for the digital front end (ADS131M04) at this oversampling ratio, with the bridge channel at this gain.
    ///
    /// Its filter ends one modulator sample earlier than the position's filter taps assume: 0.25 us
    /// ([`Filter`](crate::chip::ads131m04::Filter)).
    pub fn digital_settings(&self, osr: Osr, gain: Gain) -> Settings {
        let full_scale_v = DIGITAL_FULL_SCALE_V / f64::from(1_u32 << gain as u32);
        Settings {
            sample_rate_hz: osr.data_rate_hz(CLKIN_HZ),
            newtons_per_code: self.newtons_per_bridge_volt * full_scale_v / DIGITAL_CODES,
            force_zero_code: 0.0,
            force_min_code: -DIGITAL_CODES,
            force_max_code: DIGITAL_CODES - 1.0,
            metres_per_terminal_code: self.metres_per_volt * DIGITAL_FULL_SCALE_V / DIGITAL_CODES,
            skew_s: -2.0 / f64::from(CLKIN_HZ),
            front_end: FrontEnd::Ads131m04,
            ..self.settings(1000.0)
        }
    }

    /// Instruments with which [`inerter_plant::Simulation`] takes the same samples as the analogue front end, without a
    /// chip.
    pub fn sensors(&self, sample_rate_hz: f64, quality: &Quality) -> Sensors {
        let oversampling = TRIGGER_HZ / sample_rate_hz;
        Sensors {
            sample_rate_hz,
            oversampling,
            metres_per_count: self.metres_per_count,
            encoder_phase_count: self.encoder_phase_count,
            newtons_per_code: self.newtons_per_conversion(),
            force_zero_code: CODES / 2.0,
            force_min_code: 0.0,
            force_max_code: CODES - 1.0,
            force_offset_n: self.force_offset_n,
            force_noise_n: quality.noise_lsb * self.newtons_per_conversion() / oversampling.sqrt(),
            delay_s: self.filter_s - APERTURE_S,
            metres_per_terminal_code: self.metres_per_volt * REFERENCE_V / CODES,
            seed: quality.seed,
            ..Sensors::default()
        }
    }
}

/// The rig in motion.
#[derive(Clone, Debug)]
pub struct Bench {
    rig: Rig,
    plant: Plant,
    /// Segments of the motion over the last [`LOOK_BACK_S`].
    segments: VecDeque<Segment>,
    /// The last state computed, as several signals are read at the same time.
    last: Truth,
    /// The filter's output, its last input, and the time of that input \[N, N, s\].
    filter: Option<(f64, f64, f64)>,
    /// The last encoder count read, which stays while the encoder is unplugged.
    standing: Option<u32>,
}

impl Bench {
    /// Validates the device and the motion.
    pub fn new(rig: Rig) -> Result<Self, PlantError> {
        let mut plant = Plant::new(rig.device, rig.motion.clone())?;
        let first = plant.next_segment();
        let last = first.at(0.0);
        Ok(Self { rig, plant, segments: VecDeque::from([first]), last, filter: None, standing: None })
    }

    /// The true state at this time since power was applied.
    fn truth(&mut self, time_s: f64) -> Truth {
        let t_s = time_s - self.rig.start_s;
        if t_s == self.last.t_s {
            return self.last;
        }
        while self.segments.back().is_none_or(|segment| segment.end_s() <= t_s) {
            self.segments.push_back(self.plant.next_segment());
            while self.segments.get(1).is_some_and(|second| second.end_s() < t_s - LOOK_BACK_S) {
                self.segments.pop_front();
            }
        }
        // Usually the newest segment, otherwise one shortly before. Before the motion starts it is the beginning of the
        // first segment, at rest.
        let mut candidates = self.segments.iter().rev();
        if let Some(segment) = candidates.find(|segment| segment.start_s() <= t_s).or(self.segments.front()) {
            self.last = segment.at(t_s);
        }
        self.last
    }

    fn is_unplugged(&self, which: Sensor, time_s: f64) -> bool {
        self.rig.faults.iter().any(|fault| {
            matches!(fault, Fault::Unplugged { sensor, from_s, until_s }
                if *sensor == which && (*from_s..*until_s).contains(&time_s))
        })
    }

    /// Force at the load cell.
    fn cell_n(&mut self, time_s: f64) -> f64 {
        let truth = self.truth(time_s);
        let pushes = self.rig.faults.iter().map(|fault| match fault {
            Fault::Push { from_s, until_s, newtons } if (*from_s..*until_s).contains(&time_s) => *newtons,
            _ => 0.0,
        });
        let pushed: f64 = pushes.sum();
        truth.force_n + self.rig.device.structure_mass_kg * truth.a1_m_per_s2 + self.rig.force_offset_n + pushed
    }

    /// Output of the anti-alias filter, exact for an input that is linear between two calls.
    fn filtered_n(&mut self, time_s: f64) -> f64 {
        let (now_n, tau_s) = (self.cell_n(time_s), self.rig.filter_s);
        let Some((output_n, before_n, before_s)) = self.filter.filter(|_| tau_s > 0.0) else {
            self.filter = Some((now_n, now_n, time_s));
            return now_n;
        };
        let step_s = time_s - before_s;
        if step_s <= 0.0 {
            return output_n;
        }
        let lag_n = (now_n - before_n) / step_s * tau_s;
        let output_n = now_n - lag_n + (output_n - before_n + lag_n) * (-step_s / tau_s).exp();
        self.filter = Some((output_n, now_n, time_s));
        output_n
    }
}

impl World for Bench {
    fn encoder(&mut self, time_s: f64) -> u32 {
        if let Some(count) = self.standing.filter(|_| self.is_unplugged(Sensor::Encoder, time_s)) {
            return count;
        }
        let x2_m = self.truth(time_s).x2_m;
        let count = (x2_m / self.rig.metres_per_count + self.rig.encoder_phase_count).floor() as i64 as u32;
        let jumps = self.rig.faults.iter().map(|fault| match fault {
            Fault::Jump { at_s, counts } if *at_s <= time_s => *counts,
            _ => 0,
        });
        let count = jumps.fold(count, u32::wrapping_add);
        self.standing = Some(count);
        count
    }

    fn force_volts(&mut self, time_s: f64) -> f64 {
        let newtons = self.filtered_n(time_s);
        if self.is_unplugged(Sensor::Force, time_s) {
            return 0.0;
        }
        (Rig::ZERO_V + newtons / self.rig.newtons_per_volt).clamp(0.0, REFERENCE_V)
    }

    fn terminal_volts(&mut self, time_s: f64) -> f64 {
        if self.is_unplugged(Sensor::Terminal, time_s) {
            return 0.0;
        }
        (Rig::ZERO_V + self.truth(time_s).x1_m / self.rig.metres_per_volt).clamp(0.0, REFERENCE_V)
    }

    fn bridge_volts(&mut self, time_s: f64) -> f64 {
        if self.is_unplugged(Sensor::Force, time_s) {
            return 0.0;
        }
        self.cell_n(time_s) / self.rig.newtons_per_bridge_volt
    }

    fn excitation_volts(&mut self, time_s: f64) -> f64 {
        if self.is_unplugged(Sensor::Force, time_s) { 0.0 } else { self.rig.excitation_v }
    }

    fn digital_terminal_volts(&mut self, time_s: f64) -> f64 {
        if self.is_unplugged(Sensor::Terminal, time_s) {
            return 0.0;
        }
        self.truth(time_s).x1_m / self.rig.metres_per_volt
    }

    fn temperature_c(&mut self, _: f64) -> f64 {
        self.rig.temperature_c
    }
}

/// Core's results for a series of samples.
#[derive(Clone, Debug)]
pub struct Replay {
    /// All estimates that core published.
    pub published: Vec<Estimate>,
    /// The last estimate.
    pub last: Estimate,
    /// Core's counters.
    pub counters: Counters,
}

/// Feeds samples to core, starting from its reset state.
pub fn replay(settings: &Settings, samples: &[RawSample]) -> Result<Replay, SettingsError> {
    let active: Active = settings.validate()?;
    let mut state = Box::new(State::new(&active));
    let published = samples.iter().filter_map(|sample| active.step(&mut state, sample).estimate()).collect();
    Ok(Replay { published, last: active.publish(&state).estimate, counters: state.counters() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use inerter_plant::Simulation;

    const MID: &str = "mid";

    fn rig(text: &str) -> Rig {
        Rig::new(Excitation::parse(text, 5).unwrap(), 0.5)
    }

    #[test]
    fn nothing_moves_before_the_start() {
        let mut bench = Bench::new(Rig { force_offset_n: 0.0, ..rig(MID) }).unwrap();
        for time_s in [0.0, 0.1, 0.4999] {
            let volts = (bench.force_volts(time_s), bench.terminal_volts(time_s), bench.bridge_volts(time_s));
            assert_eq!((bench.encoder(time_s), volts), (0, (1.65, 1.65, 0.0)));
        }
        assert_ne!(bench.encoder(0.7), 0);
    }

    #[test]
    fn signals_are_the_plants_in_the_rigs_scales() {
        let rig = Rig { filter_s: 0.0, ..rig("random") };
        let mut plant = Plant::new(rig.device, rig.motion.clone()).unwrap();
        let mut segment = plant.next_segment();
        let mut bench = Bench::new(rig.clone()).unwrap();
        for k in 0..200_000 {
            let t_s = f64::from(k) / TRIGGER_HZ;
            while segment.end_s() <= t_s {
                segment = plant.next_segment();
            }
            let time_s = 0.5 + t_s;
            let truth = segment.at(time_s - 0.5);
            let count = (truth.x2_m / 2.44140625e-6 + 0.37).floor() as i64 as u32;
            assert_eq!(bench.encoder(time_s), count);
            let newtons = truth.force_n + 1.515 * truth.a1_m_per_s2 + 3.0;
            // A segment ends 1e-11 m from where the next starts; the contact stiffness turns that into 20 uN.
            assert!((bench.force_volts(time_s) - (1.65 + newtons * 3.3 / 20_000.0)).abs() < 1e-7);
            assert!((bench.terminal_volts(time_s) - (1.65 + truth.x1_m * 100.0)).abs() < 1e-9);
            assert!((bench.bridge_volts(time_s) - newtons * 5e-3 / 10_000.0).abs() < 1e-12);
        }
    }

    #[test]
    fn looking_back_gives_what_was_there() {
        let mut ahead = Bench::new(rig("random")).unwrap();
        let mut behind = ahead.clone();
        for k in 0..20_000 {
            let time_s = 0.5 + f64::from(k) * 1e-4;
            ahead.encoder(time_s + 4e-3);
            assert!((ahead.terminal_volts(time_s) - behind.terminal_volts(time_s)).abs() < 1e-12);
        }
    }

    #[test]
    fn the_filter_delays_by_its_time_constant() {
        let tau_s = 10e-6;
        let mut filtered = Bench::new(Rig { filter_s: tau_s, ..rig(MID) }).unwrap();
        let mut plain = Bench::new(Rig { filter_s: 0.0, ..rig(MID) }).unwrap();
        let mut worst = 0.0f64;
        for k in 0..128_000 {
            let time_s = 0.5 + f64::from(k) / TRIGGER_HZ;
            let late = plain.force_volts(time_s - tau_s);
            worst = worst.max((filtered.force_volts(time_s) - late).abs());
        }
        // The filter rounds the corners at reversals and breakaways: 0.2 mV is 0.6 N.
        assert!(worst < 1e-4, "{worst}");
    }

    #[test]
    fn faults_come_and_go() {
        let faults = vec![
            Fault::Jump { at_s: 0.1, counts: 0u32.wrapping_sub(5) },
            Fault::Unplugged { sensor: Sensor::Force, from_s: 0.2, until_s: 0.3 },
            Fault::Unplugged { sensor: Sensor::Terminal, from_s: 0.25, until_s: 0.3 },
            Fault::Unplugged { sensor: Sensor::Encoder, from_s: 0.9, until_s: 1.0 },
            Fault::Push { from_s: 0.3, until_s: 0.4, newtons: 1e5 },
        ];
        let mut bench = Bench::new(Rig { faults, filter_s: 0.0, force_offset_n: 0.0, ..rig(MID) }).unwrap();
        assert_eq!([0.05, 0.1, 0.2].map(|time_s| bench.encoder(time_s)), [0, u32::MAX - 4, u32::MAX - 4]);
        assert_eq!([0.1, 0.2, 0.31, 0.4].map(|time_s| bench.force_volts(time_s)), [1.65, 0.0, REFERENCE_V, 1.65]);
        assert_eq!([0.2, 0.26, 0.31].map(|time_s| bench.terminal_volts(time_s)), [1.65, 0.0, 1.65]);
        let before = bench.encoder(0.899);
        assert_eq!([0.9, 0.95, 0.999].map(|time_s| bench.encoder(time_s)), [before; 3]);
        assert_ne!(bench.encoder(1.0), before);
    }

    #[test]
    fn the_settings_are_those_of_the_instruments() {
        let rig = rig(MID);
        let quality = Quality { noise_lsb: 0.7, reference_noise: 0.0, ..Quality::default() };
        for rate_hz in [1000.0, 2000.0, 4000.0] {
            let sensors = rig.sensors(rate_hz, &quality);
            let settings = rig.settings(rate_hz);
            settings.validate().unwrap();
            // The sum of fewer conversions is scaled to 64 of them.
            let scale = f64::from(WEIGHT) / sensors.oversampling;
            let near = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-12, "{a} {b}");
            near(settings.newtons_per_code * scale, sensors.newtons_per_sample_code());
            near(settings.force_zero_code / scale, sensors.force_zero_code * sensors.oversampling);
            near(settings.force_max_code / scale, sensors.force_max_code * sensors.oversampling);
            near(settings.skew_s, sensors.delay_s);
        }
        rig.digital_settings(Osr::X1024, Gain::X32).validate().unwrap();
    }

    #[test]
    fn core_alone_finds_the_device_with_the_rigs_settings() {
        let rig = rig("random");
        let quality = Quality::default();
        let settings = rig.settings(1000.0);
        let simulation = Simulation::new(rig.device, rig.motion.clone(), rig.sensors(1000.0, &quality)).unwrap();
        let samples: Vec<RawSample> = simulation
            .lasting(10.0)
            .map(|sample| RawSample {
                index: sample.index,
                position_count: sample.position_count,
                force_code: sample.force_code,
                terminal_code: sample.terminal_code,
            })
            .collect();
        let outcome = replay(&settings, &samples).unwrap();
        assert_eq!(
            (outcome.counters.samples, outcome.counters.discontinuities, outcome.published.len()),
            (10_000, 0, 50)
        );
        let mass = outcome.last.whole_run.inertance_kg;
        assert!((f64::from(mass.fitted().value) - rig.device.inertance_kg).abs() < 0.05, "{mass:?}");
        // With a wrong scale the result differs.
        let wrong = Settings { newtons_per_code: settings.newtons_per_code * 1.01, ..settings };
        let mass = replay(&wrong, &samples).unwrap().last.whole_run.inertance_kg;
        assert!((f64::from(mass.fitted().value) - 1.01 * rig.device.inertance_kg).abs() < 0.05, "{mass:?}");
    }
}
