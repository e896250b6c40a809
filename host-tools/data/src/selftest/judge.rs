//! Judges the raw figures and samples of a board.
//!
//! Each function takes what the board reported and returns its checks in a fixed order. A missing figure fails its
//! check, unless there is a good reason for it.

use inerter_core::{RawSample, Settings};
use inerter_wire::{
    ClockSource, Health, Hello, Measured,
    Quantity::{self, *},
    ResetCause,
};

use super::Check;
use crate::{backup, words::three_digits};

/// Device ID of category 3 of the STM32G4: DBGMCU_IDCODE.DEV_ID (RM0440 47.6.1).
const DEVICE: u32 = 0x469;
/// Flash that the firmware needs (KB).
const FLASH_KB: f64 = 512.0;
/// RCC_CSR (RM0440 7.4.30).
const POWER_RESET: u32 = 1 << 27;
const SOFTWARE_RESET: u32 = 1 << 28;
const WATCHDOG_RESET: u32 = 1 << 29;
/// By the window watchdog or an illegal low-power mode: the firmware uses neither.
const FOREIGN_RESET: u32 = 1 << 30 | 1 << 31;
/// RCC_CR (RM0440 7.4.1).
const CRYSTAL_READY: u32 = 1 << 17;
const PLL_READY: u32 = 1 << 25;
/// CRS_ISR (RM0440 8.7.3): error flags, and trimming at its limit.
const TRIM_ENDED: u32 = 1 << 10;
/// Supply voltage of the chip's factory calibration (V).
const FACTORY_V: f64 = 3.0;
/// Conversions to which a sample is scaled, and the codes of one conversion.
const WEIGHT: f64 = 64.0;
const RAIL: f64 = 64.0 * 4095.0;
/// Trigger rate (Hz).
const TRIGGER_HZ: f64 = 64e3;

/// Share of the stack that must never have been used.
const FREE_STACK: f64 = 0.25;
/// Allowed difference between a crystal and the USB clock: 500 ppm by USB 2.0 7.1.11, 100 ppm for the crystal.
const CRYSTAL_PPM: f64 = 600.0;
/// Allowed error of the chip's internal oscillator (DS12288, table 43).
const INTERNAL_PPM: f64 = 20_000.0;
/// Noise of one conversion, rms: a signal-to-noise ratio of 66 dB is 0.7 codes (DS12288, table 67); the rest is for an
/// amplifier.
const NOISE_CODES: f64 = 2.0;
/// A working converter is never quieter than this (codes).
const LEAST_NOISE_CODES: f64 = 0.05;
/// Allowed deviation of the first sample after a start from the others, in their standard deviations.
const FIRST_SIGMA: f64 = 8.0;

fn ratio(above: Option<u32>, below: Option<u32>) -> Option<f64> {
    let (above, below) = above.zip(below).filter(|(_, below)| *below != 0)?;
    Some(f64::from(above) / f64::from(below))
}

/// Letter of a revision: DBGMCU_IDCODE.REV_ID (RM0440 47.6.1).
fn revision(id: u32) -> String {
    let letter = match id >> 16 {
        0x1000 => "A",
        0x2000 => "B",
        0x2001 => "Z",
        0x2002 => "Y",
        0x2003 => "X",
        other => return format!("0x{other:04X}"),
    };
    letter.into()
}

/// What the board reported, as text.
fn reported<T>(value: Option<T>, text: impl FnOnce(T) -> String) -> String {
    value.map_or("not reported".into(), text)
}

/// The chip: identity, flash, option bytes, stack, and the cause of its last start.
pub fn chip(measured: &Measured, hello: &Hello) -> Vec<Check> {
    let get = |quantity| measured.get(quantity);
    let id = get(DeviceId);
    let device = Check::words(
        "chip",
        "Chip",
        "an STM32G471/473/474/483/484 (0x469)",
        reported(id, |id| format!("0x{:03X}, revision {}", id & 0xFFF, revision(id))),
        id.is_none_or(|id| id & 0xFFF != DEVICE).then_some("another chip, or a clone: its errata are not known"),
    );
    let told_kb = hello.capabilities.flash_kb().map(f64::from);
    let kb = get(FlashKb).map(f64::from);
    let flash = Check::range(
        "flash",
        "Flash",
        "KB",
        FLASH_KB..=f64::INFINITY,
        kb,
        |_| "the settings lie in the last of 512 KB: this chip has less",
    );
    let agree = Check::words(
        "flash_told",
        "Flash as reported in Hello",
        reported(kb, |kb| kb.to_string()),
        reported(told_kb, |kb| kb.to_string()),
        (kb.is_none() || kb != told_kb).then_some("the firmware contradicts itself"),
    );
    let (options, wanted) = (get(OptionBytes), get(OptionBytesWanted));
    let hex = |value: u32| format!("0x{value:08X}");
    let options = Check::words(
        "option_bytes",
        "Option bytes",
        reported(wanted, hex),
        reported(options, hex),
        (options.is_none() || options != wanted)
            .then_some("they could not be set and may be protected; a restart tries again"),
    );
    let stack = get(StackBytes).filter(|bytes| *bytes > 0).map(f64::from);
    let free = ratio(get(StackFreeBytes), get(StackBytes)).map(|part| part * 100.0);
    let range = FREE_STACK * 100.0..=100.0;
    let stack = Check::range(
        "stack",
        "Stack never used",
        "%",
        range,
        free.filter(|_| stack.is_some()),
        |_| "the stack has been nearly full: please report it",
    );
    // Power clears the other flags. What is set beside it came before the firmware ran.
    let doubtful = get(ResetFlags)
        .map(|flags| if flags & POWER_RESET != 0 { 0 } else { flags & (WATCHDOG_RESET | FOREIGN_RESET) });
    let (name, label) = ("start", "Last start before the test");
    let start = if doubtful == Some(WATCHDOG_RESET) {
        let why = "not judged: the watchdog reset the board, as some self-tests do; otherwise the firmware hung";
        Check::skipped(name, label, why)
    } else {
        let cause = match doubtful {
            None => Some("the board did not report it"),
            Some(0) => None,
            Some(_) => Some("the firmware causes no such reset: please report it"),
        };
        Check::words(name, label, "by power, pin, command or option bytes", reported(get(ResetFlags), hex), cause)
    };
    vec![device, flash, agree, options, stack, start]
}

/// By how much the reported time since the start must fall short of the time without a restart (s): the report has
/// whole seconds, and arrives late.
const YOUNGER_S: f64 = 2.0;

/// Evidence of a board's start after it was told to restart.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Start {
    /// The cause it reports; it reports once, possibly on a connection that failed.
    pub told: Option<ResetCause>,
    /// The chip's reset flags, which stay until the next start, so those of an earlier start may remain.
    pub flags: Option<u32>,
    /// Time since its start, and the value it would have without a restart (s).
    pub uptime_s: Option<(u32, f64)>,
}

/// Checks the cause of a start: by the device's report, or else by the time since the start, and by the chip's own
/// flags.
pub fn restart(name: &'static str, label: &'static str, expected: ResetCause, start: &Start) -> Check {
    let Start { told, flags, uptime_s } = *start;
    let wanted = if expected == ResetCause::Watchdog { WATCHDOG_RESET } else { SOFTWARE_RESET };
    let flags_words = flags.map_or("no flags".into(), |flags| format!("flags 0x{flags:08X}"));
    let mut found = format!("{}, {flags_words}", reported(told, |told| told.to_string()));
    if told.is_none() {
        found += &uptime_s.map_or(", up for an unknown time".into(), |(up_s, _)| format!(", up for {up_s} s"));
    }
    let is_younger = uptime_s.is_some_and(|(up_s, without_s)| f64::from(up_s) + YOUNGER_S <= without_s);
    let cause = if told.is_some_and(|told| told != expected) {
        Some("it started for another reason: check its supply and its reset pin")
    } else if flags.is_none_or(|flags| flags & wanted != wanted) {
        Some("the chip's reset flags say otherwise")
    } else if told.is_none() && !is_younger {
        Some("nothing shows that it restarted: its flags may be of an earlier start")
    } else {
        None
    };
    Check::words(name, label, expected.to_string(), found, cause)
}

/// The clocks, compared with each other and with the host's USB clock.
pub fn clocks(measured: &Measured, hello: &Hello) -> Vec<Check> {
    let get = |quantity| measured.get(quantity);
    let core_hz = get(CoreHz).filter(|hz| *hz > 0);
    let ppm = |cycles_per_s: Option<f64>| Some((cycles_per_s? / f64::from(core_hz?) - 1.0) * 1e6);
    let crystal = hello.clock == ClockSource::Crystal;
    let control = get(ClockControl);
    let runs = |bit: u32| control.is_some_and(|control| control & bit != 0);
    let source = Check::words(
        "crystal",
        "Clock's source",
        "the crystal, and the PLL locked to it",
        match (runs(CRYSTAL_READY), runs(PLL_READY)) {
            (true, true) => "crystal and PLL run",
            (false, true) => "the PLL runs, the crystal does not",
            _ => "the PLL does not run, or nothing was reported",
        },
        (!(crystal && runs(CRYSTAL_READY) && runs(PLL_READY)))
            .then_some("the crystal does not run: the chip's own oscillator is good for 1 % only"),
    );
    let allowed = if crystal { CRYSTAL_PPM } else { INTERNAL_PPM };
    let per_frame = ratio(get(UsbFramesCycles), get(UsbFrames).filter(|frames| *frames >= 100));
    let usb = match get(UsbFrames) {
        None => Check::skipped("clock_usb", "Core's clock against USB", "no USB frames: connect over the board's USB"),
        Some(_) => {
            let found = ppm(per_frame.map(|cycles| cycles * 1e3));
            Check::range("clock_usb", "Core's clock against USB", "ppm", -allowed..=allowed, found, |ppm| {
                let fast = if ppm > 0.0 { "fast" } else { "slow" };
                format!(
                    "the core's clock is {:.2} % {fast}: its crystal is not the one that the firmware was built for, or is off",
                    ppm.abs() / 1e4
                )
            })
        }
    };
    let clock = ppm(ratio(get(ClockUsCycles), get(ClockUs)).map(|cycles| cycles * 1e6));
    let own = Check::range(
        "clock_own",
        "Core's clock against the firmware's time",
        "ppm",
        -10.0..=10.0,
        clock,
        |_| "the timer of the firmware's time has a wrong prescaler",
    );
    let cycles_per_period = ratio(get(LsiPeriodsCycles), get(LsiPeriods));
    let lsi = core_hz.zip(cycles_per_period).map(|(hz, cycles)| f64::from(hz) / cycles / 1e3);
    // DS12288, table 46.
    let lsi = Check::range(
        "clock_lsi",
        "Watchdog's oscillator",
        "kHz",
        29.5..=34.0,
        lsi,
        |_| "the watchdog's oscillator is off frequency, and so is its time limit",
    );
    let recovery = match (get(UsbFrames), get(RecoveryStatus)) {
        (None, _) => Check::skipped("clock_recovery", "USB's oscillator", "no USB frames to follow"),
        (Some(_), status) => {
            // FECAP: the count at the last frame, of 48000.
            let off = status.map(|status| f64::from(status >> 16) / 48e3 * 100.0);
            let ended = status.is_some_and(|status| status & TRIM_ENDED != 0);
            let found = if ended { Some(100.0) } else { off };
            Check::range(
                "clock_recovery",
                "USB's oscillator off the frames",
                "%",
                0.0..=0.25,
                found,
                |_| "the 48 MHz oscillator does not follow the host's frames",
            )
        }
    };
    vec![source, usb, own, lsi, recovery]
}

/// Supply voltage and temperature from the chip's own references.
pub fn supply(measured: &Measured) -> Vec<Check> {
    let get = |quantity| measured.get(quantity).filter(|code| (1..4095).contains(code)).map(f64::from);
    let factory = get(ReferenceFactoryCode);
    // 1.182 to 1.232 V (DS12288, table 20) at 3.0 V.
    let range = 1600.0..=1700.0;
    let reference = Check::range(
        "reference",
        "Voltage reference at the factory",
        "codes",
        range,
        factory,
        |_| "the chip's factory values are missing or not credible",
    );
    let supply = factory.zip(get(ReferenceCode)).map(|(at_factory, code)| FACTORY_V * at_factory / code);
    let volts = Check::range("supply", "Analogue supply", "V", 3.13..=3.47, supply, |volts| {
        let low = if volts < 3.3 { "low" } else { "high" };
        format!("the supply is too {low}: check the USB cable, the regulator and the jumpers of VDDA")
    });
    let (at_30, at_130) = (get(TemperatureFactory30Code), get(TemperatureFactory130Code));
    let slope = at_30.zip(at_130).map(|(cold, hot)| (hot - cold) / 100.0).filter(|slope| *slope > 0.0);
    let code = get(TemperatureCode).zip(supply).map(|(code, volts)| code * volts / FACTORY_V);
    let celsius = code.zip(at_30).zip(slope).map(|((code, cold), slope)| 30.0 + (code - cold) / slope);
    let warm = Check::range(
        "temperature",
        "Chip's temperature",
        "°C",
        5.0..=70.0,
        celsius,
        |_| "the chip is too hot or too cold, or its sensor is not right",
    );
    vec![reference, volts, warm]
}

/// Cycles of each task per second, as a quantity, a name and a label, and the instructions that the twin executed in
/// the same second, at its minimum: sampling at 1 kHz with every stream on and nothing moving; its test `selftest`
/// compares them. Two tasks have no work then, because nothing is requested, and the USB task only answers the host's
/// control requests.
const PREDICTIONS: [(Quantity, &str, &str, f64); 6] = [
    (SamplingCycles, "work_sampling", "Cycles of sampling", 1.73e6),
    (EstimatingCycles, "work_estimating", "Cycles of estimating", 2.32e6),
    (TelemetryCycles, "work_telemetry", "Cycles of sending", 0.966e6),
    (CommandsCycles, "work_commands", "Cycles of requests", 0.0),
    (UsbCycles, "work_usb", "Cycles of the USB", 0.0),
    (SupervisingCycles, "work_supervising", "Cycles of health, LED and watchdog", 0.0106e6),
];

/// Maximum cycles per instruction on the chip: the pessimistic bound of the twin's model plus 50 %.
const MOST_PER_INSTRUCTION: f64 = 4.5;
/// Minimum share of the twin's instructions: motion and streams differ.
const LEAST_PER_INSTRUCTION: f64 = 0.4;
/// Allowed counting times (us): a board counts for a second, and its counters are valid for less than 25 s.
const WORK_US: std::ops::RangeInclusive<u32> = 100_000..=20_000_000;
/// What any task may take in addition (cycles/s).
const SPARE: f64 = 1e6;

/// Cycles of each task compared with the twin's prediction, and the load.
pub fn work(measured: &Measured) -> Vec<Check> {
    let get = |quantity| measured.get(quantity);
    let window_us = get(WorkUs).filter(|us| WORK_US.contains(us));
    let window_s = window_us.map(|us| f64::from(us) / 1e6);
    let mut checks: Vec<Check> = PREDICTIONS
        .into_iter()
        .map(|(quantity, name, label, instructions)| {
            let per_s = get(quantity).zip(window_s).map(|(cycles, s)| f64::from(cycles) / s / 1e6);
            let least = (instructions * LEAST_PER_INSTRUCTION) / 1e6;
            let most = (instructions * MOST_PER_INSTRUCTION + SPARE) / 1e6;
            let check = Check::range(name, label, "million/s", least..=most, per_s, |found| {
                if found < least {
                    "less than the twin needs for the same work: the work was not done, or the counter stands still"
                } else {
                    "more than the model of the chip allows: check wait states, caches and the build"
                }
            });
            let predicted = match instructions {
                0.0 => "no work".into(),
                _ => format!("twin {}", three_digits(instructions / 1e6)),
            };
            Check { expected: format!("{predicted}: {}", check.expected), ..check }
        })
        .collect();
    let idle = ratio(get(IdleUs), window_us);
    let load = idle.filter(|idle| *idle <= 1.0).map(|idle| (1.0 - idle) * 100.0);
    checks.push(Check::range(
        "load",
        "Processor load at 1 kHz",
        "%",
        0.5..=35.0,
        load,
        |_| "the processor load does not match its tasks",
    ));
    checks
}

/// An analogue input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// The force.
    Force,
    /// The terminal's displacement.
    Terminal,
}

impl Input {
    fn code(self, sample: &RawSample) -> f64 {
        f64::from(match self {
            Self::Force => sample.force_code,
            Self::Terminal => sample.terminal_code,
        })
    }

    fn names(self) -> [(&'static str, &'static str); 2] {
        match self {
            Self::Force => [("noise_force", "Noise of the force input"), ("first_force", "First force sample")],
            Self::Terminal => {
                [("noise_terminal", "Noise of the terminal input"), ("first_terminal", "First terminal sample")]
            }
        }
    }
}

/// Noise floor of an input at rest, in codes of one conversion, and whether the first sample after a start agrees with
/// the others.
///
/// The noise comes from the differences of adjacent samples, so a slow drift has no effect. An input at its rail shows
/// no noise: it is not judged, as a converter that does not run may read the same.
pub fn noise(input: Input, samples: &[RawSample], sample_rate_hz: f64) -> Vec<Check> {
    let [(noise, noise_label), (first, first_label)] = input.names();
    let codes: Vec<f64> = samples.iter().map(|sample| input.code(sample)).collect();
    let Some((first_code, rest)) = codes.split_first().filter(|(_, rest)| rest.len() >= 100) else {
        return vec![Check::range(noise, noise_label, "codes", 0.0..=NOISE_CODES, None, |_| "")];
    };
    let at_rail = rest.iter().filter(|code| **code <= 0.0 || **code >= RAIL).count();
    if at_rail * 2 > rest.len() {
        let reason = if rest.windows(2).all(|pair| pair[0] == pair[1]) {
            "not judged: constant at the end of its range, and a converter that does not run reads the same; to test it, \
             use the jumpers or connect a voltage within the range"
        } else {
            "the input is at the end of its range: nothing is connected, or its sensor is off"
        };
        return vec![Check::skipped(noise, noise_label, reason), Check::skipped(first, first_label, reason)];
    }
    let squares: f64 = rest.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum();
    let sample_codes = (squares / 2.0 / (rest.len() - 1) as f64).sqrt();
    // A sample is scaled to 64 conversions however many it sums; the noise of their sum grows with the square root of
    // their number.
    let summed = TRIGGER_HZ / sample_rate_hz;
    let found = sample_codes / WEIGHT * summed.sqrt();
    let floor = Check::range(noise, noise_label, "codes", LEAST_NOISE_CODES..=NOISE_CODES, Some(found), |found| {
        if found > NOISE_CODES {
            "the noise is too high: check the supply, the ground, the amplifier and the input's connection"
        } else {
            "the code never changes: the converter may not run"
        }
    });
    let mean = rest.iter().sum::<f64>() / rest.len() as f64;
    let sigma = (rest.iter().map(|code| (code - mean).powi(2)).sum::<f64>() / rest.len() as f64).sqrt();
    let off = (first_code - mean).abs() / sigma.max(1.0);
    let first = Check::range(
        first,
        first_label,
        "standard deviations off",
        0.0..=FIRST_SIGMA,
        Some(off),
        |_| "the first conversions after a start are wrong",
    );
    vec![floor, first]
}

/// Highest sample rate, at which the streams are judged (Hz).
pub const FULL_HZ: f64 = 4000.0;

/// Allowed difference between the sample rate and [`FULL_HZ`] by the firmware's time. The index of a report lags by the
/// samples that the estimator has not taken yet: some milliseconds of the second between two reports.
const RATE_PART: f64 = 0.03;

/// What arrived with all streams on at [`FULL_HZ`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Streamed<'a> {
    /// Samples in their order.
    pub samples: &'a [RawSample],
    /// Bytes of all frames.
    pub bytes: usize,
    /// Frames that were lost, damaged or undecodable.
    pub bad_frames: u64,
    /// Health reports in their order.
    pub reports: &'a [Health],
}

/// Whether everything arrived, at the expected rate.
///
/// Rates refer to the board's own clocks: a slow link loses frames but does not lower their rate. The sampling timer is
/// compared with the firmware's time, which [`clocks`] compares with the host's USB clock.
pub fn throughput(heard: &Streamed) -> [Check; 5] {
    let Streamed { samples, bytes, bad_frames, reports } = *heard;
    let steps = samples.windows(2).map(|pair| pair[1].index.wrapping_sub(pair[0].index));
    let missing: u64 = steps.map(|step| u64::from(step.saturating_sub(1))).sum();
    let span_s = samples.len() as f64 / FULL_HZ;
    let bytes_rate = (samples.len() > 1000).then(|| bytes as f64 / span_s / 1e3);
    let overruns = reports.last().map(|last| f64::from(last.overruns));
    let sample_rate = reports.first().zip(reports.last()).and_then(|(first, last)| {
        let time_s = last.uptime_s.checked_sub(first.uptime_s).filter(|s| *s > 0)?;
        Some(f64::from(last.index.wrapping_sub(first.index)) / f64::from(time_s))
    });
    let allowed = FULL_HZ * (1.0 - RATE_PART)..=FULL_HZ * (1.0 + RATE_PART);
    [
        Check::range(
            "sample_rate",
            "Sample rate by the firmware's time",
            "Hz",
            allowed,
            sample_rate,
            |_| "the sampling timer runs at a wrong rate: please report it",
        ),
        Check::range(
            "frames_lost",
            "Frames lost or damaged at 4 kHz",
            "",
            0.0..=0.0,
            Some(bad_frames as f64),
            |_| "the link or the host does not keep up: try another port, cable or hub",
        ),
        Check::range(
            "samples_lost",
            "Samples lost at 4 kHz",
            "",
            0.0..=0.0,
            Some(missing as f64),
            // A frame that is lost on the way leaves a gap in the sequence of frames.
            |_| match (bad_frames, overruns) {
                (0, Some(overruns)) if overruns > 0.0 => "the sampler itself lost them: see its overruns",
                (0, _) => "the sampler itself lost them, after its last report",
                _ => "the sampler or the link does not keep up",
            },
        ),
        // The board counts them together, and says which kind it was once only, possibly long ago.
        Check::range("overruns", "Sampler overruns since the start", "", 0.0..=0.0, overruns, |_| {
            "a DMA transfer was lost, samples were overwritten before they were read, or a trigger other than the \
             sampling clock starts the converters (the test with jumpers shows whether): please report it"
        }),
        Check::range(
            "throughput",
            "Stream at 4 kHz, per second of the device",
            "KB",
            10.0..=1000.0,
            bytes_rate,
            |_| "the number of bytes does not match 4000 samples per second",
        ),
    ]
}

/// Whether the settings are the saved ones.
pub fn same(name: &'static str, label: &'static str, expected: &str, saved: &Settings, found: &Settings) -> Check {
    let differ = backup::changes(saved, found).len();
    let cause = (differ > 0).then(|| format!("{differ} settings differ from those saved"));
    Check::words(name, label, expected, if differ == 0 { expected } else { "others" }, cause)
}

/// Whether the board has its previous settings again, as read back from it.
pub fn restored(outcome: Result<bool, String>) -> Check {
    let cause = match outcome {
        Ok(true) => None,
        Ok(false) => Some("the board accepted them, but its settings now differ".to_owned()),
        Err(error) => Some(error),
    };
    let found = if cause.is_none() { "as before" } else { "others" };
    Check::words("restored", "Settings restored", "as before", found, cause)
}
