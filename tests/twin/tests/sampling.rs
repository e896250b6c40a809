//! The shipping image measures a simulated inerter, and reports when something is wrong.
//!
//! Every run exercises the whole chain: sampling clock, converters, DMA, sums, estimator, telemetry, USB. The estimates
//! must equal, bit for bit, those that core computes on this computer from the streamed samples. They must also be as
//! close to the true values as `docs/tables/accuracy.md` states for core alone.

use std::error::Error;

use ads131m04::{Gain, Osr};
use inerter_core::{Estimate, Parameter, RawSample, Settings, Status};
use inerter_plant::{Excitation, Simulation};
use inerter_twin::{
    Registers, Width,
    bench::{Bench, Fault, Replay, Rig, Sensor, replay},
    chip::{adc::Quality, ads131m04::Ads131m04, dma::Dma},
    machine::{Machine, shipping_image},
    serial_link::SerialLink,
    usb_link::{LinkError, UsbLink},
};
use inerter_wire::{
    Command, EventKind, Fault as Broken, Health, MAX_FRAME, Record, Refusal, SettingsValues, Streams, encode_record,
};

type Outcome = Result<(), Box<dyn Error>>;

/// The firmware has started by this time \[s\].
const BOOTED_S: f64 = 0.2;
/// The plant starts to move at this time, after the port is opened and the settings are written \[s\].
const MOTION_S: f64 = 1.5;
/// Time limit for a reply \[s\].
const REPLY_S: f64 = 0.5;

/// A configured board with its sampler stopped.
struct Lab {
    link: UsbLink<Machine>,
    settings: Settings,
}

/// The outcome of a run.
struct Run {
    settings: Settings,
    samples: Vec<RawSample>,
    estimates: Vec<Estimate>,
    events: Vec<EventKind>,
    health: Vec<Health>,
    /// Frames that the device dropped.
    lost: u64,
}

impl Lab {
    /// Boots the image on this rig, plugs it in and writes the settings.
    fn new(
        image: &[u8],
        rig: Rig,
        settings: Settings,
        prepare: impl FnOnce(&mut Machine),
    ) -> Result<Self, Box<dyn Error>> {
        let mut machine = Machine::new(image, Bench::new(rig)?)?;
        prepare(&mut machine);
        machine.run_until(BOOTED_S)?;
        let mut lab = Self { link: UsbLink::new(machine), settings };
        lab.link.plug_in()?;
        for command in set_up(&settings) {
            lab.order(command)?;
        }
        lab.link.talk.records();
        Ok(lab)
    }

    fn order(&mut self, command: Command) -> Result<(), LinkError> {
        self.link.request(command, REPLY_S)?.result.map(|_| ()).map_err(LinkError::Refused)
    }

    /// Samples from now until `end_s`. `disturb` may act on the machine every 10 ms.
    fn run(&mut self, end_s: f64, mut disturb: impl FnMut(&mut Machine)) -> Result<Run, Box<dyn Error>> {
        self.order(Command::Start)?;
        while self.link.socket.time_s() < end_s {
            disturb(&mut self.link.socket);
            self.link.listen(0.01)?;
        }
        self.order(Command::Stop)?;
        // Receive what is still in transit.
        self.link.listen(0.2)?;
        let lost = self.link.talk.lost;
        Run::of(self.settings, self.link.talk.records(), lost)
    }
}

fn left_alone(_: &mut Machine) {}

/// Settings with a memory as long as the runs, and ten estimates a second.
fn long(settings: Settings) -> Settings {
    Settings { memory_s: 100.0, publish_rate_hz: 10.0, ..settings }
}

/// The commands sent to a board before a run. The sampler stays stopped until the run begins.
fn set_up(settings: &Settings) -> [Command; 5] {
    let streams = Streams { sums: false, ..Streams::ALL };
    let values = SettingsValues::from(settings);
    [Command::Hello, Command::Stop, Command::WriteSettings(values), Command::ResetEstimator, Command::Streams(streams)]
}

/// The exact encoding of an estimate, including the sign of a zero.
fn bytes(estimate: &Estimate) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let length = encode_record(&Record::Estimate(*estimate), 0, &mut out).expect("fits");
    out[..length].to_vec()
}

impl Run {
    /// Sorts the records received since the set-up.
    fn of(settings: Settings, records: Vec<Record>, lost: u64) -> Result<Self, Box<dyn Error>> {
        let mut run =
            Run { settings, samples: Vec::new(), estimates: Vec::new(), events: Vec::new(), health: Vec::new(), lost };
        for record in records {
            match record {
                Record::Samples(batch) => {
                    for sample in &batch {
                        run.samples.push(sample.map_err(|error| format!("{error:?}"))?);
                    }
                }
                Record::Estimate(estimate) => run.estimates.push(estimate),
                Record::Event(event) => run.events.push(event.kind),
                Record::Health(health) => run.health.push(health),
                _ => {}
            }
        }
        Ok(run)
    }

    /// Core's own estimates for the streamed samples. The board's must equal them bit for bit.
    #[track_caller]
    fn agrees_with_core(&self) -> Replay {
        assert_eq!(self.lost, 0, "frames lost on the link");
        let here = replay(&self.settings, &self.samples).expect("settings that the board took");
        assert_eq!(self.estimates.len(), here.published.len(), "estimates");
        for (there, here) in self.estimates.iter().zip(&here.published) {
            assert_eq!(bytes(there), bytes(here), "{there:?} on the board, {here:?} here");
        }
        // Sensitivity check: changing one ungated sample by one encoder count must change the estimates.
        let changed = |place: usize| {
            let mut other = self.samples.clone();
            other[place].position_count ^= 64;
            let other = replay(&self.settings, &other).expect("the same settings");
            other.published.iter().map(bytes).ne(here.published.iter().map(bytes))
        };
        assert!((3..9).any(|part| changed(self.samples.len() * part / 9)));
        here
    }

    /// Each sample's position equals that of the undisturbed run, to within one sampling period by which the sampling
    /// instants may have shifted: 0.084 m/s is 34 counts per millisecond.
    #[track_caller]
    fn is_where(&self, plain: &Self) {
        let first = plain.samples.first().expect("samples").index;
        let apart = self.samples.iter().filter_map(|sample| {
            let same = plain.samples.get(sample.index.wrapping_sub(first) as usize)?;
            assert_eq!(same.index, sample.index);
            Some(same.position_count.wrapping_sub(sample.position_count).abs())
        });
        let apart = apart.max().expect("samples");
        assert!(apart < 36 * 64, "{apart} 64ths of a count apart");
    }

    /// The device reported the source as unreadable, without restarting.
    #[track_caller]
    fn is_given_up(&self, channel: usize) {
        assert!(self.events.contains(&EventKind::Fault(Broken::SourceUnreadable)), "{channel}: {:?}", self.events);
        let restarted = |event: &EventKind| matches!(event, EventKind::Started | EventKind::ResetBy(_));
        assert!(!self.events.iter().any(restarted), "{channel}: {:?}", self.events);
    }

    fn discontinuities(&self) -> usize {
        self.samples.windows(2).filter(|pair| pair[1].index != pair[0].index.wrapping_add(1)).count()
    }
}

fn truth(rig: &Rig) -> [f64; 3] {
    [rig.device.inertance_kg, rig.device.viscous_n_s_per_m, rig.device.coulomb_n]
}

fn three(estimate: &Estimate) -> [Parameter; 3] {
    let all = estimate.whole_run;
    [all.inertance_kg, all.viscous_n_s_per_m, all.coulomb_n]
}

/// The inertance over the whole run is that of the paper's device, to within this \[kg\].
#[track_caller]
fn has_its_mass(estimate: &Estimate, within_kg: f64) {
    let mass = estimate.whole_run.inertance_kg;
    assert!((f64::from(mass.fitted().value) - 299.4906).abs() < within_kg, "{mass:?}");
}

/// Parameter names as written in the table.
const NAMES: [&str; 3] = ["mt kg", "cf N s/m", "fc N"];

/// Bias goal and sigma of each parameter, from the table of core alone.
fn table(rate_hz: f64, motion: &str) -> [[f64; 2]; 3] {
    let table = include_str!("../../../docs/tables/accuracy.md");
    let heading = if rate_hz > 3000.0 { "4 kHz, 1 N" } else { "1 kHz, 1 N" };
    let section = table.split("\n## ").find(|section| section.lines().next() == Some(heading)).expect("a section");
    let rows = section.lines().map(|line| line.split('|').map(str::trim).collect::<Vec<_>>());
    let of_motion: Vec<_> = rows.filter(|cells| cells.get(1) == Some(&motion)).collect();
    NAMES.map(|parameter| {
        let cells = of_motion.iter().find(|cells| cells[2] == parameter).expect("a row");
        let goal = cells[5].split(',').next().expect("a bias");
        [goal, cells[4]].map(|number| number.trim().parse().expect("a number"))
    })
}

/// Allowed ratio of two intervals. An interval covers errors hidden in the noise, so it scatters too: over 16 runs
/// without a chip, the largest was up to 1.81 times the smallest (friction of `slow`, seeds 100 to 115; `mid` 1.21,
/// `random` 1.23). The tests use another seed.
const SCATTER: std::ops::Range<f32> = 0.55..1.81;

/// One run of a preset motion, compared with the table and with core.
#[track_caller]
fn accurate(motion: &str, rate_hz: f64, duration_s: f64) -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    let rig = Rig::new(Excitation::parse(motion, 11)?, MOTION_S);
    let settings = long(rig.settings(rate_hz));
    let started = std::time::Instant::now();
    let mut lab = Lab::new(&image, rig.clone(), settings, left_alone)?;
    let run = lab.run(MOTION_S + duration_s, left_alone)?;
    println!("{motion} {rate_hz} Hz: {duration_s} s in {:?}", started.elapsed());
    let here = run.agrees_with_core();
    assert_eq!((run.discontinuities(), here.counters.saturated), (0, 0), "{:?}", run.events);
    let expected = duration_s * rate_hz;
    assert!(run.samples.len() as f64 > expected, "{} samples", run.samples.len());

    // Core alone, on the same plant without a chip.
    let quality = Quality::default();
    let simulation = Simulation::new(rig.device, rig.motion.clone(), rig.sensors(rate_hz, &quality))?;
    let scale = (rate_hz / 1000.0) as i32;
    let samples: Vec<RawSample> = simulation
        .lasting(duration_s)
        .map(|sample| RawSample {
            index: sample.index,
            position_count: sample.position_count.wrapping_mul(scale),
            force_code: sample.force_code * scale,
            terminal_code: sample.terminal_code,
        })
        .collect();
    let alone = replay(&settings, &samples)?;

    let truth = truth(&rig);
    let (twin, alone) = (three(&here.last), three(&alone.last));
    for (i, [goal, sigma]) in table(rate_hz, motion).into_iter().enumerate() {
        let (error, without_chip) =
            (f64::from(twin[i].fitted().value) - truth[i], f64::from(alone[i].fitted().value) - truth[i]);
        let ratio = twin[i].u95() / alone[i].u95();
        println!("  {}: error {error:.5}, without a chip {without_chip:.5}, sigma {sigma}, interval {ratio}", NAMES[i]);
        assert!(error.abs() < goal.max(sigma) + 4.0 * sigma, "{motion}, {}: {error}", NAMES[i]);
        assert!((error - without_chip).abs() < 6.0 * sigma, "{motion}, {}: {error} and {without_chip}", NAMES[i]);
        assert!(SCATTER.contains(&ratio), "{motion}, {}: an interval {ratio} times that without a chip", NAMES[i]);
    }
    Ok(())
}

#[test]
#[ignore = "long: cargo xtask test --full"]
fn slow() -> Outcome {
    accurate("slow", 1000.0, 80.0)
}

#[test]
fn mid() -> Outcome {
    accurate("mid", 1000.0, 20.0)
}

#[test]
#[ignore = "long: cargo xtask test --full"]
fn fast() -> Outcome {
    accurate("fast", 1000.0, 20.0)
}

#[test]
fn random() -> Outcome {
    accurate("random", 1000.0, 20.0)
}

#[test]
#[ignore = "long: cargo xtask test --full"]
fn random_at_2_khz() -> Outcome {
    accurate("random", 2000.0, 20.0)
}

#[test]
fn random_at_4_khz() -> Outcome {
    accurate("random", 4000.0, 20.0)
}

/// A short run of a rig at 1 kHz.
fn short(image: &[u8], rig: Rig, duration_s: f64, disturb: impl FnMut(&mut Machine)) -> Result<Run, Box<dyn Error>> {
    let settings = long(rig.settings(1000.0));
    Lab::new(image, rig, settings, left_alone)?.run(MOTION_S + duration_s, disturb)
}

fn mid_rig() -> Rig {
    Rig::new(Excitation::preset("mid", 0).expect("a preset"), MOTION_S)
}

#[test]
fn the_count_may_wrap_and_so_may_the_sum() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    let moved_by = |counts: u32| {
        let rig = Rig { faults: vec![Fault::Jump { at_s: 0.9 * MOTION_S, counts }], ..mid_rig() };
        let settings = long(rig.settings(1000.0));
        let mut lab = Lab::new(&image, rig, settings, left_alone)?;
        lab.link.listen((0.9 * MOTION_S + 0.01 - lab.link.socket.time_s()).max(0.0))?;
        lab.run(MOTION_S + 4.0, left_alone)
    };
    let plain = moved_by(0)?;
    plain.agrees_with_core();
    // 4.16 mm is 1704 counts, so every stroke crosses the wrap of the counter, or of 64 times the counter.
    for counts in [u32::MAX - 500, (1 << 26) - 500, (1 << 31) - 500, (1 << 25) + 500] {
        let run = moved_by(counts)?;
        let sign = |sample: &RawSample| sample.position_count.signum();
        assert!(run.samples.iter().any(|sample| sign(sample) > 0) && run.samples.iter().any(|sample| sign(sample) < 0));
        // The samples equal those of the plain run except for the offset, and the estimates are equal bit for bit. A
        // run may end half a ring earlier, because numbers of other sizes take a different time to send.
        let mut back = run.samples.clone();
        back.iter_mut().for_each(|sample| {
            sample.position_count = sample.position_count.wrapping_sub(counts.wrapping_mul(64) as i32)
        });
        assert!(back.len().abs_diff(plain.samples.len()) <= 16, "{counts:#x}");
        assert!(back.iter().zip(&plain.samples).all(|(one, other)| one == other), "{counts:#x}");
        let mut estimates = run.estimates.iter().zip(&plain.estimates);
        assert!(estimates.len() > 30 && estimates.all(|(one, other)| bytes(one) == bytes(other)), "{counts:#x}");
        run.agrees_with_core();
    }
    Ok(())
}

#[test]
fn an_encoder_that_counts_the_other_way() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    let rig = Rig { metres_per_count: -mid_rig().metres_per_count, ..mid_rig() };
    let run = short(&image, rig, 8.0, left_alone)?;
    let here = run.agrees_with_core();
    assert_eq!(here.last.whole_run.inertance_kg.status(), Status::Ok);
    has_its_mass(&here.last, 0.1);
    // With the direction set wrong, the estimator must not report a positive inertance as ok.
    let settings = Settings { metres_per_count: -run.settings.metres_per_count, ..run.settings };
    let wrong = replay(&settings, &run.samples)?.last.whole_run.inertance_kg;
    assert!(wrong.status() != Status::Ok || wrong.fitted().value < 0.0, "{wrong:?}");
    Ok(())
}

#[test]
fn a_force_beyond_the_range_is_flagged_and_left_out() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    // An amplitude of 545 N on a range of 480 N.
    let rig = Rig { newtons_per_volt: 960.0 / 3.3, ..mid_rig() };
    let run = short(&image, rig, 8.0, left_alone)?;
    let here = run.agrees_with_core();
    let at_rail = |code: f64| run.samples.iter().filter(|sample| f64::from(sample.force_code) == code).count();
    let rails = [at_rail(run.settings.force_min_code), at_rail(run.settings.force_max_code)];
    assert!(rails.iter().all(|samples| *samples > 300), "{rails:?}");
    // A window that touches a rail is reported at the rail: no code lies just inside it.
    let near = |sample: &&RawSample| {
        (1..64).contains(&sample.force_code) || (262_080 - 63..262_080).contains(&sample.force_code)
    };
    assert_eq!(run.samples.iter().filter(near).count(), 0);
    assert!(here.counters.saturated as usize >= rails[0] + rails[1], "{:?}", here.counters);
    assert!(run.health.last().is_some_and(|health| health.saturated > 0));
    has_its_mass(&here.last, 0.5);
    Ok(())
}

#[test]
fn a_cable_that_comes_off_is_no_measurement() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    let off = |sensor| Fault::Unplugged { sensor, from_s: MOTION_S + 3.0, until_s: MOTION_S + 6.0 };
    // Without the force cable the pin falls to the rail. The estimator learns nothing and loses nothing.
    let run = short(&image, Rig { faults: vec![off(Sensor::Force)], ..mid_rig() }, 8.0, left_alone)?;
    let here = run.agrees_with_core();
    assert!((2950..3100).contains(&here.counters.saturated), "{:?}", here.counters);
    has_its_mass(&here.last, 0.1);
    // A stationary encoder looks like rest, so no estimate may claim motion.
    let run = short(&image, Rig { faults: vec![off(Sensor::Encoder)], ..mid_rig() }, 8.0, left_alone)?;
    run.agrees_with_core();
    let during = run.estimates.iter().filter(|estimate| (4500..6700).contains(&estimate.elapsed_samples));
    assert!(during.clone().count() > 15 && during.clone().all(|estimate| !estimate.moving));
    Ok(())
}

/// A disturbance of a DMA channel at one moment.
type Disturb = fn(&mut Dma, usize, u64);

/// Disturbs a channel of DMA1 once the machine has reached this time. Within half a second the three rings must be in
/// step again.
fn disturbed(channel: usize, at_s: f64, disturb: Disturb) -> impl FnMut(&mut Machine) {
    let mut done = false;
    move |machine: &mut Machine| {
        let now = machine.now();
        let in_s = at_s - machine.time_s();
        let dma = &mut machine.chip_mut().dma[0];
        let mut left = |n: u32| dma.read(0x0C + 0x14 * n, Width::Word, now).expect("a register");
        let lefts = [left(0), left(1), left(2)];
        if !done && in_s <= 0.0 {
            done = true;
            disturb(dma, channel, now);
        }
        // For each event the count is fetched before the codes.
        let in_step = (0..3).all(|n| (lefts[n] + 512 - lefts[0]) % 512 <= 1);
        assert!(in_step || (-0.5..0.0).contains(&in_s), "{lefts:?} left {in_s} s before the stall");
    }
}

#[test]
fn rings_that_part_become_a_discontinuity_and_the_counter_stays_right() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    let at_s = MOTION_S + 3.0;
    let plain = short(&image, mid_rig(), 6.0, left_alone)?;
    // The channel gets no bus access for five events.
    let stall: Disturb = |dma, channel, now| dma.channels[channel].stalled_until = Some(now + 5 * 2625);
    let fail: Disturb = |dma, channel, _| dma.channels[channel].fail();
    // Channel 0 loses positions; channel 1 misses a force conversion; channel 2 misses a terminal conversion, and
    // without its ring no interrupt comes. A failed transfer stops its ring at once.
    for (channel, disturb, fault) in [
        (0, stall, Broken::SamplerMisaligned),
        (1, stall, Broken::SamplerOverrun),
        (2, stall, Broken::SamplerOverrun),
        (0, fail, Broken::SamplerMisaligned),
        (1, fail, Broken::SamplerMisaligned),
        (2, fail, Broken::SamplerMisaligned),
    ] {
        let run = short(&image, mid_rig(), 6.0, disturbed(channel, at_s, disturb))?;
        let here = run.agrees_with_core();
        assert_eq!((run.discontinuities(), here.counters.discontinuities), (1, 1), "channel {channel}");
        // The device notices missing ring interrupts after 20 ms.
        assert!((2..40).contains(&here.counters.lost_samples), "channel {channel}: {:?}", here.counters);
        let named = run.events.iter().any(|event| matches!(event, EventKind::Fault(it) if *it == fault));
        assert!(named, "channel {channel}: {:?}", run.events);
        let health = run.health.last().expect("health each second");
        assert_eq!((health.discontinuities, health.overruns), (1, 1), "channel {channel}: {health:?}");
        run.is_where(&plain);
        has_its_mass(&here.last, 0.1);
    }
    Ok(())
}

#[test]
fn a_transfer_may_fail_at_any_moment() -> Outcome {
    const TIMES: u32 = 30;
    let Some(image) = shipping_image() else { return Ok(()) };
    let plain = short(&image, mid_rig(), 6.0, left_alone)?;
    for channel in 0..3 {
        let mut failed = 0;
        let run = short(&image, mid_rig(), 6.0, |machine| {
            if failed < TIMES && machine.time_s() > MOTION_S + 1.0 + f64::from(failed) * 0.1 {
                machine.run_for(f64::from(failed) * 0.08e-3).expect("runs");
                machine.chip_mut().dma[0].channels[channel].fail();
                failed += 1;
            }
        })?;
        let here = run.agrees_with_core();
        let lost = here.counters.lost_samples;
        assert_eq!(run.discontinuities(), TIMES as usize, "channel {channel}");
        assert!(
            run.events.contains(&EventKind::Fault(Broken::SamplerMisaligned)),
            "channel {channel}: {:?}",
            run.events
        );
        assert_eq!(run.health.last().map(|health| health.overruns), Some(TIMES), "channel {channel}");
        println!("channel {channel}: {lost} samples lost in {TIMES} failures");
        // docs/TESTING.md states the mean in whole samples.
        let mean = (lost as f64 / f64::from(TIMES)).round();
        assert!((3.0..=5.0).contains(&mean), "channel {channel}: {lost} samples lost");
        run.is_where(&plain);
    }
    Ok(())
}

/// CCR of the channel whose interrupts report a full half of the ring, and its half-transfer and transfer-complete
/// interrupt enables.
const CCR3: u32 = 0x08 + 2 * 0x14;
const HALVES: u32 = 1 << 2 | 1 << 1;

#[test]
fn a_reader_that_comes_late_loses_whole_halves_and_knows_how_many() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    let plain = short(&image, mid_rig(), 6.0, left_alone)?;
    // Interrupts are held back for 20 ms, longer than the 8 ms of a ring. A delay of 10 ms may or may not lose samples,
    // depending on its phase: the reader also looks after it has taken the previous samples.
    let held_s = MOTION_S + 3.0..MOTION_S + 3.02 - 1e-6;
    let mut held = false;
    let run = short(&image, mid_rig(), 6.0, |machine| {
        let hold = held_s.contains(&machine.time_s());
        if hold == held {
            return;
        }
        let now = machine.now();
        let dma = &mut machine.chip_mut().dma[0];
        let ccr = dma.read(CCR3, Width::Word, now).expect("a register") & !HALVES;
        dma.write(CCR3, if hold { ccr } else { ccr | HALVES }, Width::Word, now).expect("a register");
        held = hold;
    })?;
    let here = run.agrees_with_core();
    let (discontinuities, lost) = (here.counters.discontinuities, here.counters.lost_samples);
    assert!(discontinuities == 1 && (4..=28).contains(&lost), "{:?}", here.counters);
    assert!(run.events.contains(&EventKind::Fault(Broken::SamplerOverrun)), "{:?}", run.events);
    // The rings kept running: samples read afterwards equal those of the undisturbed run at the same index.
    let first = plain.samples.first().expect("samples").index;
    let same = |sample: &&RawSample| plain.samples.get(sample.index.wrapping_sub(first) as usize) == Some(sample);
    assert_eq!(run.samples.iter().filter(same).count(), run.samples.len());
    Ok(())
}

/// Fits the digital front end, with this noise in each channel \[V\].
fn fitted(noise_v: [f64; 4]) -> impl FnOnce(&mut Machine) {
    move |machine| machine.chip_mut().ads131m04 = Some(Ads131m04::new(noise_v, 3))
}

/// The digital front end with one motion at one of its rates.
fn digital(motion: &str, osr: Osr, duration_s: f64) -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    let rig = Rig::new(Excitation::parse(motion, 11)?, MOTION_S);
    let settings = long(rig.digital_settings(osr, Gain::X64));
    // 0.4 uV at the bridge is 0.8 N.
    let noise_v = [0.4e-6, 3e-6, 3e-6, 0.0];
    let mut lab = Lab::new(&image, rig.clone(), settings, fitted(noise_v))?;
    let run = lab.run(MOTION_S + duration_s, left_alone)?;
    let here = run.agrees_with_core();
    assert_eq!(run.discontinuities(), 0, "{:?}", run.events);
    assert!(run.samples.len() as f64 > duration_s * settings.sample_rate_hz);
    let truth = truth(&rig);
    for (i, parameter) in three(&here.last).into_iter().enumerate() {
        let error = f64::from(parameter.fitted().value) - truth[i];
        let [goal, sigma] = table(1000.0, motion)[i];
        println!("  digital {motion} {osr:?} {}: error {error:.5}, interval {}", NAMES[i], parameter.u95());
        assert!(error.abs() < goal.max(sigma) + 4.0 * sigma, "{motion} {osr:?}, {}: {error}", NAMES[i]);
    }
    Ok(())
}

/// A short run of the digital front end at 976.5625 Hz, connected and working until `disturb` acts.
fn short_digital(image: &[u8], rig: Rig, disturb: impl FnMut(&mut Machine)) -> Result<Run, Box<dyn Error>> {
    let settings = long(rig.digital_settings(Osr::X4096, Gain::X64));
    Lab::new(image, rig, settings, fitted([0.0; 4]))?.run(MOTION_S + 6.0, disturb)
}

#[test]
fn a_converter_that_forgets_is_set_up_again() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    let plain = short_digital(&image, mid_rig(), left_alone)?;
    plain.agrees_with_core();
    assert_eq!(plain.discontinuities(), 0);
    type Disturbance = fn(&mut Ads131m04, u64);
    let disturbances: [(&str, Disturbance); 2] =
        [("a register", |ads, _| ads.chip.disturb_register(0x04, 0)), ("its supply", Ads131m04::power_cycle)];
    for (what, disturb) in disturbances {
        let mut done = false;
        let run = short_digital(&image, mid_rig(), |machine| {
            if !done && machine.time_s() > MOTION_S + 3.0 {
                done = true;
                let now = machine.now();
                disturb(machine.chip_mut().ads131m04.as_mut().expect("fitted"), now);
            }
        })?;
        let here = run.agrees_with_core();
        assert!(
            (1..=2).contains(&run.discontinuities()) && here.counters.lost_samples < 60,
            "{what}: {:?}",
            here.counters
        );
        assert!(run.samples.len() + 70 > plain.samples.len(), "{what}: it goes on");
        run.is_where(&plain);
        let mass = here.last.whole_run.inertance_kg;
        assert!((f64::from(mass.fitted().value) - 299.4906).abs() < 0.1, "{what}: {mass:?}");
    }
    Ok(())
}

#[test]
fn a_bus_whose_transfers_do_not_end_is_told() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    // Longer than the watchdog timeout.
    let stall: Disturb = |dma, channel, now| dma.channels[channel].stalled_until = Some(now + 168_000_000 * 60);
    // Channels of DMA1 that transmit to the converter and receive from it.
    for (channel, disturb) in [(3, stall), (4, stall), (3, BROKEN), (4, BROKEN)] {
        let run = short_digital(&image, mid_rig(), once(channel, disturb))?;
        run.is_given_up(channel);
    }
    Ok(())
}

/// All later transfers of the channel fail.
const BROKEN: Disturb = |dma, channel, _| dma.channels[channel].broken = true;

/// Disturbs a channel of DMA1 once, a second after the motion begins.
fn once(channel: usize, disturb: Disturb) -> impl FnMut(&mut Machine) {
    let mut done = false;
    move |machine| {
        if !done && machine.time_s() > MOTION_S + 1.0 {
            done = true;
            let now = machine.now();
            disturb(&mut machine.chip_mut().dma[0], channel, now);
        }
    }
}

#[test]
fn rings_whose_transfers_fail_again_and_again_are_given_up_and_it_is_told() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    for channel in 0..3 {
        let run = short(&image, mid_rig(), 4.0, once(channel, BROKEN))?;
        run.is_given_up(channel);
        // Nothing follows: the last estimate covers the last sample.
        assert!(run.events.ends_with(&[EventKind::SourceEnded]), "channel {channel}: {:?}", run.events);
        let last = run.estimates.last().map(|estimate| estimate.elapsed_samples as usize);
        assert_eq!(last, Some(run.samples.len()), "channel {channel}");
        assert_eq!(run.discontinuities(), 0, "channel {channel}");
        assert!(run.health.last().is_some_and(|health| health.overruns > 0), "channel {channel}");
    }
    Ok(())
}

#[test]
fn a_transfer_that_is_cut_off_ends_before_the_bus_is_switched_off() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    let settings = Settings { memory_s: 100.0, ..mid_rig().digital_settings(Osr::X4096, Gain::X64) };
    let mut lab = Lab::new(&image, mid_rig(), settings, fitted([0.0; 4]))?;
    lab.order(Command::Start)?;
    lab.link.listen(0.1)?;
    for sent in [1, 3, 6] {
        let machine = &mut lab.link.socket;
        // In the middle of a frame, with more bytes in the SPI's buffer.
        let limit_s = machine.time_s() + 0.1;
        let left = |machine: &mut Machine| {
            let now = machine.now();
            machine.chip_mut().dma[0].read(0x0C + 0x14 * 4, Width::Word, now).expect("CNDTR5")
        };
        while left(machine) != 18 - sent || machine.chip().spi2.frame.is_none() {
            assert!(machine.time_s() < limit_s, "no transfer");
            machine.run_for(0.2e-6)?;
        }
        // After the receive channel fails, the firmware must stop the SPI at once.
        machine.chip_mut().dma[0].channels[4].fail();
        machine.run_for(1e-3)?;
        assert!(!machine.chip().spi2.busy_stays, "{sent} bytes received");
        lab.link.listen(0.5)?;
    }
    let samples = |record: &Record| matches!(record, Record::Samples(_));
    lab.link.talk.records();
    lab.link.listen(0.5)?;
    assert!(lab.link.talk.records().iter().any(samples), "it goes on");
    Ok(())
}

#[test]
fn a_bridge_without_excitation_is_no_measurement() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    let off = Fault::Unplugged { sensor: Sensor::Force, from_s: MOTION_S + 3.0, until_s: MOTION_S + 5.0 };
    let run = short_digital(&image, Rig { faults: vec![off], ..mid_rig() }, left_alone)?;
    let here = run.agrees_with_core();
    assert_eq!(run.discontinuities(), 0);
    assert!((1900..2100).contains(&here.counters.saturated), "{:?}", here.counters);
    has_its_mass(&here.last, 0.1);
    Ok(())
}

#[test]
fn a_front_end_that_is_not_there_is_refused_and_the_other_goes_on() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    let rig = mid_rig();
    let analogue = rig.settings(1000.0);
    let digital = rig.digital_settings(Osr::X4096, Gain::X64);
    let mut lab = Lab::new(&image, rig, analogue, left_alone)?;
    let refused = lab.order(Command::WriteSettings(SettingsValues::from(&digital)));
    assert!(matches!(refused, Err(LinkError::Refused(Refusal::Source))), "{refused:?}");
    // The device refuses a rate that the front end does not support, and names the setting.
    let values = SettingsValues::from(&Settings { sample_rate_hz: 1500.0, ..analogue });
    let refused = lab.order(Command::WriteSettings(values));
    assert!(matches!(refused, Err(LinkError::Refused(Refusal::BadSetting { number: 0, .. }))), "{refused:?}");
    let run = lab.run(MOTION_S + 3.0, left_alone)?;
    assert_eq!(run.discontinuities(), 0);
    run.agrees_with_core();
    Ok(())
}

#[test]
fn the_digital_front_end_at_4_khz() -> Outcome {
    digital("random", Osr::X1024, 20.0)
}

#[test]
#[ignore = "long: cargo xtask test --full"]
fn the_digital_front_end_at_2_khz() -> Outcome {
    digital("random", Osr::X2048, 20.0)
}

#[test]
fn the_digital_front_end_at_1_khz() -> Outcome {
    digital("fast", Osr::X4096, 20.0)
}

#[test]
fn no_sample_after_a_start_holds_anything_else() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    let rig = mid_rig();
    // Everything at rest, with 16 conversions per sample.
    let settings = rig.settings(4000.0);
    let mut lab = Lab::new(&image, rig, settings, left_alone)?;
    for end_s in [0.8, 1.1, 1.4] {
        let run = lab.run(end_s, left_alone)?;
        let last = *run.samples.last().ok_or("no samples")?;
        for sample in run.samples.iter().take(32) {
            let off = [sample.force_code - last.force_code, sample.terminal_code - last.terminal_code];
            assert!(off.iter().all(|codes| codes.abs() < 500), "until {end_s} s: {sample:?}, at last {last:?}");
        }
    }
    Ok(())
}

/// A board at rest whose converters add nothing, with 16 conversions per sample.
fn at_rest(image: &[u8]) -> Result<Lab, Box<dyn Error>> {
    let rig = Rig { start_s: 100.0, ..mid_rig() };
    let settings = rig.settings(4000.0);
    Lab::new(image, rig, settings, |machine| machine.chip_mut().adc.set_quality(Quality::IDEAL))
}

#[test]
fn the_two_converters_do_not_disturb_each_other() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    // Both codes are known.
    let mut lab = at_rest(&image)?;
    let run = lab.run(1.0, left_alone)?;
    assert!(run.samples.len() > 1000, "{} samples", run.samples.len());
    for sample in &run.samples {
        let codes = [sample.force_code, sample.terminal_code].map(f64::from);
        assert!(codes.iter().all(|code| (code - run.settings.force_zero_code).abs() < 500.0), "{sample:?}");
    }
    Ok(())
}

#[test]
fn converting_the_temperature_disturbs_no_sample() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    // The chip converts the temperature once a second.
    let mut lab = at_rest(&image)?;
    // The sampling clock and the health report share a crystal, so their phase stays constant within a run. Each start
    // gives another phase.
    for second in 1..=25 {
        let run = lab.run(1.02 * f64::from(second), left_alone)?;
        assert!(run.health.iter().all(|health| health.temperature_c.is_some_and(|told| (told - 25.0).abs() < 5.0)));
        let last = *run.samples.last().ok_or("no samples")?;
        for sample in &run.samples {
            let off = [sample.force_code - last.force_code, sample.terminal_code - last.terminal_code];
            assert!(off.iter().all(|codes| codes.abs() < 50), "{sample:?}, at last {last:?}");
        }
    }
    Ok(())
}

#[test]
fn the_chips_temperature_is_told() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    for temperature_c in [-20.0, 25.0, 95.0] {
        let run = short(&image, Rig { temperature_c, ..mid_rig() }, 1.5, left_alone)?;
        let told = run.health.last().and_then(|health| health.temperature_c).expect("a temperature");
        assert!((f64::from(told) - temperature_c).abs() < 1.0, "{told} at {temperature_c}");
    }
    Ok(())
}

#[test]
fn the_serial_link_brings_the_same() -> Outcome {
    let Some(image) = shipping_image() else { return Ok(()) };
    let rig = mid_rig();
    let settings = rig.settings(4000.0);
    let mut link = SerialLink::new(Machine::new(&image, Bench::new(rig)?)?);
    link.listen_until(BOOTED_S)?;
    for command in set_up(&settings) {
        link.order(command, REPLY_S)?;
    }
    link.talk.records();
    link.order(Command::Start, REPLY_S)?;
    link.listen_until(MOTION_S + 3.0)?;
    link.order(Command::Stop, REPLY_S)?;
    link.listen_until(MOTION_S + 3.2)?;
    let run = Run::of(settings, link.talk.records(), link.talk.lost)?;
    assert_eq!(run.discontinuities(), 0);
    assert!(run.samples.len() > 12_000 && run.agrees_with_core().counters.discontinuities == 0);
    Ok(())
}
