//! The estimator.
//!
//! Input: a byte (the property), a byte (the base settings), a number of changed settings (u8), and for each its number
//! and its place within its range. Then the samples: a series of operations (u8), each with its arguments.
//!
//! Properties, for any samples and any valid settings: nothing panics. Every published value is finite and its interval
//! is not negative. The sums form a Gram matrix. A reset state behaves like a new one. Inverted wiring with settings
//! that say so, and counters with another origin, change no bit. The mirrored motion gives the mirrored device, within
//! the intervals: a value that both publish, and, where both have used the same bank and as many updates, a value that
//! one publishes and the fit that the other withholds. An inertance with a narrow interval has a fit on the other side,
//! too. Not to the bit, because averages and the force round half up, also below zero.

use std::sync::{
    OnceLock,
    atomic::{AtomicU64, Ordering},
};

use inerter_core::{Active, Bank, Estimate, Kind, Output, Parameter, Published, RawSample, Settings, State, Status};
use inerter_plant::{Excitation, Inerter, Sensors, Simulation};
use inerter_tests::grid::{self, four};
use inerter_wire::{Health, Record, Samples};

use crate::input::Input;

/// Maximum number of samples per input.
const MOST: usize = 6_000;
/// Number of samples of each plant motion.
const MOTION: usize = 4_096;
/// Maximum number of settings that differ from the base.
const MOST_SETTINGS: u8 = 12;
/// Interval at which the number of samples is printed.
const TELL: u64 = 1 << 20;
/// The same for the number of mirrored values.
const TELL_MIRRORED: u64 = 1 << 16;
/// Relative interval below which an inertance is not at the margin of what its motion can identify: a tenth of what the
/// estimator itself accepts. Where the encoder's steps are nearly too much of the acceleration, the interval is as
/// large as the value.
const NARROW: f32 = 0.05;

/// Motions of the plant at 1 kHz: name, start [s] and backlash [m]. The last two have backlash and a terminal sensor.
const MOTIONS: [(&str, f64, f64); 8] = [
    ("slow", 1.0, 0.0),
    ("mid", 1.0, 0.0),
    ("fast", 1.0, 0.0),
    ("multi", 0.3, 0.0),
    ("random", 3.0, 0.0),
    ("two", 0.0, 0.0),
    ("mid", 1.0, 50e-6),
    ("random", 0.3, 20e-6),
];

/// Checks an input.
pub fn check(mut input: Input) {
    let property = input.byte();
    let settings = settings(&mut input);
    let samples = samples(&mut input, &settings);
    let run = Run::new(settings, samples);
    let [turn, position, force] = [0, 1, 2].map(|bit| property >> bit & 1 == 1);
    match (turn, position || force) {
        (false, false) => run.check_again(),
        (false, true) => run.check_elsewhere(u32::from(property)),
        (true, true) => run.check_turned(position, force),
        (true, false) => run.check_mirrored(),
    }
}

/// A run and its results.
struct Run {
    settings: Settings,
    samples: Vec<RawSample>,
    outputs: Vec<Output>,
    last: Published,
    state: Box<State>,
    active: Active,
}

impl Run {
    fn new(settings: Settings, samples: Vec<RawSample>) -> Self {
        let active = settings.validate().expect("settings that are valid");
        let mut state = Box::new(State::new(&active));
        let outputs = steps(&active, &mut state, &samples);
        let last = active.publish(&state);
        check_published(&last);
        assert_eq!(state.counters().samples, samples.len() as u64);
        for bank in [Bank::Fast, Bank::Slow] {
            check_sums(&active, &state, bank);
        }
        Self { settings, samples, outputs, last, state, active }
    }

    /// The run with each sample changed.
    fn changed(&self, settings: Settings, change: impl Fn(&RawSample) -> RawSample) -> Self {
        Self::new(settings, self.samples.iter().map(change).collect())
    }

    /// A reset state must behave like a new one.
    fn check_again(&self) {
        let mut state = self.state.clone();
        state.reset(&self.active);
        assert_eq!(steps(&self.active, &mut state, &self.samples), self.outputs, "{:?}", self.settings);
        assert_eq!(self.active.publish(&state), self.last);
    }

    /// The estimates must be equal bit for bit, whatever their index.
    fn compare(&self, changed: &Self) {
        let estimates = |run: &Self| -> Vec<Estimate> {
            run.outputs.iter().filter_map(Output::estimate).map(|estimate| Estimate { index: 0, ..estimate }).collect()
        };
        let (one, other) = (estimates(changed), estimates(self));
        assert_eq!(one.len(), other.len());
        if let Some((one, other)) = one.iter().zip(&other).find(|(one, other)| one != other) {
            panic!("{one:#?}\ninstead of\n{other:#?}\nwith {:?}", self.settings);
        }
    }

    /// Counters with another origin must change nothing but the index.
    fn check_elsewhere(&self, seed: u32) {
        let (index, position) = (seed.wrapping_mul(0x9E37_79B9), seed.wrapping_mul(0x85EB_CA6B) as i32);
        let moved = self.changed(self.settings, |sample| RawSample {
            index: sample.index.wrapping_add(index),
            position_count: sample.position_count.wrapping_add(position),
            ..*sample
        });
        self.compare(&moved);
        assert_eq!(moved.state.counters(), self.state.counters());
    }

    /// Inverted wiring, with settings that say so.
    fn check_turned(&self, position: bool, force: bool) {
        let Some((turned, code)) = turned_force(&self.settings) else { return };
        let mut other = if force { turned } else { self.settings };
        if position {
            other.metres_per_count = -other.metres_per_count;
        }
        if force {
            other.newtons_per_code = -other.newtons_per_code;
        }
        let turned = self.changed(other, |sample| RawSample {
            position_count: if position { sample.position_count.wrapping_neg() } else { sample.position_count },
            force_code: if force { code(sample.force_code) } else { sample.force_code },
            ..*sample
        });
        self.compare(&turned);
    }

    /// The same device, moved in the opposite direction.
    fn check_mirrored(&self) {
        let Some((settings, code)) = turned_force(&self.settings) else { return };
        let turned = self.changed(settings, |sample| RawSample {
            position_count: sample.position_count.wrapping_neg(),
            force_code: code(sample.force_code),
            terminal_code: sample.terminal_code.wrapping_neg(),
            ..*sample
        });
        let (here, there) = (self.last.estimate, turned.last.estimate);
        // Otherwise a rounding has decided which bank is clear of steps, which samples are good, or whether the
        // memories restart: the two know different data.
        let is_alike = (here.bank, here.updates) == (there.bank, there.updates);
        for (here, there, is_recent) in [(here.recent, there.recent, true), (here.whole_run, there.whole_run, false)] {
            for (place, sign) in [1.0, 1.0, 1.0, -1.0].into_iter().enumerate() {
                let (here, there) = (four(&here)[place], four(&there)[place]);
                // The bank of the whole run is not published.
                let must_fit = is_alike && is_recent && place == 0;
                let judged = judge_mirrored(here, there, sign, is_alike, must_fit);
                let judged = judged.unwrap_or_else(|wrong| panic!("{place}: {wrong}: {here:?} and {there:?}"));
                judged.into_iter().for_each(tell_mirrored);
            }
        }
    }
}

/// Runs the samples; returns the outputs that contain something.
fn steps(active: &Active, state: &mut State, samples: &[RawSample]) -> Vec<Output> {
    let mut outputs = Vec::new();
    for sample in samples {
        let output = active.step(state, sample);
        if output != Output::default() {
            check_output(&output);
            outputs.push(output);
        }
    }
    tell(samples.len() as u64);
    outputs
}

/// Prints the number of samples processed so far, now and then.
fn tell(samples: u64) {
    static TAKEN: AtomicU64 = AtomicU64::new(0);
    let before = TAKEN.fetch_add(samples, Ordering::Relaxed);
    if before / TELL < (before + samples) / TELL {
        eprintln!("samples: {}", before + samples);
    }
}

fn check_output(output: &Output) {
    output.published.iter().for_each(check_published);
    if let Some(reversal) = output.reversal {
        assert!(
            reversal.value_m.is_finite() && reversal.error_m.is_finite() && reversal.error_m >= 0.0,
            "{reversal:?}"
        );
    }
    if let Some(change) = output.change {
        assert!(change.before.is_finite() && change.after.is_finite(), "{change:?}");
    }
}

fn check_published(published: &Published) {
    let Published { estimate, detail, law } = published;
    let contact = [detail.stiffness_n_per_m, detail.contact_damping_n_s_per_m];
    for parameter in four(&estimate.recent).into_iter().chain(four(&estimate.whole_run)).chain(contact) {
        let fitted = parameter.fitted();
        assert!(fitted.value.is_finite() && fitted.u95 >= 0.0, "{parameter:?}");
        assert!(fitted.u95.is_finite() || parameter.status() == Status::NotIdentifiable, "{parameter:?}");
    }
    assert!(four(&estimate.whole_run).iter().all(|parameter| parameter.status() != Status::Held));
    if let Some(backlash) = detail.backlash.known() {
        assert!(backlash.value.is_finite() && backlash.u95.is_finite() && backlash.u95 >= 0.0, "{backlash:?}");
    }
    assert!(estimate.residual_rms_n >= 0.0 && estimate.residual_rms_n.is_finite(), "{estimate:?}");
    let band = detail.band;
    assert!(0.0 <= band.low_hz && band.low_hz <= band.high_hz * 1.000_1 && band.high_hz.is_finite(), "{band:?}");
    assert!(detail.friction.reversal_ratio.is_none_or(f32::is_finite), "{detail:?}");
    if let Some(misfit) = law.misfit {
        assert!(misfit.ratio >= 0.0 && misfit.ratio.is_finite() && misfit.limit >= 0.0, "{law:?}");
    }
}

fn check_sums(active: &Active, state: &State, bank: Bank) {
    let (sums, more) = (active.sums(state, bank), active.more_sums(state, bank));
    assert_eq!(sums.updates, more.updates);
    let all: Vec<i128> = sums.sums.into_iter().chain(more.sums).collect();
    let at = |row: usize, column: usize| all[row * (row + 1) / 2 + column] as f64;
    let rows = (0..).take_while(|row| row * (row + 1) / 2 < all.len()).count();
    for row in 0..rows {
        for column in 0..=row {
            let (square, product) = (at(row, column).powi(2), at(row, row) * at(column, column));
            assert!(at(row, row) >= 0.0 && square <= product * (1.0 + 1e-9), "{bank:?}, {row}, {column}: {all:?}");
        }
    }
    let ones = at(3, 3) * sums.units[3].powi(2);
    assert!((ones - f64::from(sums.updates)).abs() <= 1e-9 * ones, "{ones} of {}", sums.updates);
}

/// Mirrors the force code about zero, with matching settings. `None` if the mirrored limits are not valid.
fn turned_force(settings: &Settings) -> Option<(Settings, impl Fn(i32) -> i32)> {
    let zero = settings.force_zero_code as i64;
    let turned = |code: f64| 2.0 * settings.force_zero_code - code;
    let turned_settings = Settings {
        force_min_code: turned(settings.force_max_code),
        force_max_code: turned(settings.force_min_code),
        ..*settings
    };
    turned_settings.validate().ok()?;
    // A code beyond 32 bits saturates on both sides.
    let turn = move |code: i32| (2 * zero - i64::from(code)).clamp(i32::MIN.into(), i32::MAX.into()) as i32;
    Some((turned_settings, turn))
}

/// By what a value in the mirror was judged.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Mirrored {
    /// By the other side's value.
    ByValue,
    /// By the fit that the other side withholds.
    ByFit,
    /// By nothing: the other side knows different data, or has no fit.
    Left,
}

/// Compares a parameter with that of the mirrored motion; `None` if neither side publishes it. With `is_alike` a value
/// is also compared with a fit that the other side withholds, and with `must_fit` a narrow one must have such a fit.
fn judge_mirrored(
    here: Parameter,
    there: Parameter,
    sign: f32,
    is_alike: bool,
    must_fit: bool,
) -> Result<Option<Mirrored>, &'static str> {
    let judged = match (here.known(), there.known()) {
        (None, None) => return Ok(None),
        (Some(_), Some(_)) => Mirrored::ByValue,
        _ if is_alike => Mirrored::ByFit,
        _ => return Ok(Some(Mirrored::Left)),
    };
    let (one, other) = (here.fitted(), there.fitted());
    if one.u95.is_finite() && other.u95.is_finite() {
        let difference = (one.value - sign * other.value).abs();
        let agrees = difference <= one.u95.max(other.u95);
        return if agrees { Ok(Some(judged)) } else { Err("apart by more than the intervals") };
    }
    // One side has no fit, so the other has the value.
    let known = if one.u95.is_finite() { one } else { other };
    if must_fit && known.u95 < NARROW * known.value.abs() {
        Err("only one has a fit")
    } else {
        Ok(Some(Mirrored::Left))
    }
}

/// Prints how many mirrored values were judged so far, and by what, now and then.
fn tell_mirrored(judged: Mirrored) {
    static JUDGED: [AtomicU64; 3] = [const { AtomicU64::new(0) }; 3];
    JUDGED[judged as usize].fetch_add(1, Ordering::Relaxed);
    let [values, fits, left] = JUDGED.each_ref().map(|count| count.load(Ordering::Relaxed));
    if (values + fits + left).is_multiple_of(TELL_MIRRORED) {
        eprintln!("mirrored values judged: {values} by a value, {fits} by a fit, {left} by neither");
    }
}

fn settings(input: &mut Input) -> Settings {
    let base = input.byte();
    let mut settings = if base & 1 == 0 { calibrated() } else { Settings::default() };
    for _ in 0..input.byte() % (MOST_SETTINGS + 1) {
        let (number, way, share) = (usize::from(input.byte()) % Settings::COUNT, input.byte(), input.half());
        let info = Settings::TABLE[number];
        let share = f64::from(share) / f64::from(u16::MAX);
        let value = match way % 6 {
            0 => info.default,
            1 => info.min,
            2 => info.max,
            3 => info.min + share * (info.max - info.min),
            // Logarithmically, over twelve decades.
            4 => info.max * 10_f64.powf(-12.0 * share),
            _ => info.min * 10_f64.powf(-12.0 * share),
        };
        let value = if info.kind == Kind::Whole { value.round() } else { value };
        let before = settings;
        // Undo a change that contradicts the other settings.
        if settings.set(number, value).and_then(|()| settings.validate()).is_err() {
            settings = before;
        }
    }
    settings
}

fn sensors(backlash_m: f64) -> Sensors {
    Sensors {
        force_noise_n: 1.0,
        force_offset_n: 5.0,
        encoder_phase_count: 0.3,
        seed: 11 + (backlash_m * 1e6) as u64,
        ..Sensors::default()
    }
}

fn calibrated() -> Settings {
    grid::calibrated(&Inerter::paper(), &sensors(0.0))
}

fn motions() -> &'static [Vec<RawSample>] {
    static MADE: OnceLock<Vec<Vec<RawSample>>> = OnceLock::new();
    MADE.get_or_init(|| {
        let made = MOTIONS.iter().map(|&(name, start_s, backlash_m)| {
            let device = Inerter { backlash_m, ..Inerter::paper() };
            let excitation = Excitation::preset(name, 3).expect("a motion of the plant");
            let simulation = Simulation::new(device, excitation, sensors(backlash_m)).expect("a plant");
            let skipped = (start_s * 1e3) as usize;
            simulation.skip(skipped).take(MOTION).map(|sample| grid::raw(&sample)).collect()
        });
        made.collect()
    })
}

/// The samples that an input describes.
fn samples(input: &mut Input, settings: &Settings) -> Vec<RawSample> {
    let mut samples: Vec<RawSample> = Vec::new();
    let mut last = RawSample::default();
    while !input.is_empty() && samples.len() < MOST {
        let operation = input.byte();
        let from = samples.len();
        match operation & 7 {
            // The plant: which motion, from where and for how long. Positions continue from the previous sample.
            0 | 1 => {
                let motion = &motions()[usize::from(operation >> 3) % MOTIONS.len()];
                let (start, length) = (usize::from(input.byte()) * 16, 64 + usize::from(input.byte()) * 16);
                let motion = motion.get(start..).unwrap_or_default();
                let mut before = motion.first().copied().unwrap_or_default();
                for here in motion.iter().take(length) {
                    last = RawSample {
                        index: last.index.wrapping_add(1),
                        position_count: last.position_count.wrapping_add(here.position_count - before.position_count),
                        force_code: here.force_code.saturating_add(settings.force_zero_code as i32),
                        terminal_code: here.terminal_code,
                    };
                    before = *here;
                    samples.push(last);
                }
            }
            // Constant steps.
            2 => {
                let [position, force, terminal] = [0; 3].map(|_| i32::from(input.half() as i16));
                for _ in 0..=input.byte() {
                    last.index = last.index.wrapping_add(1);
                    last.position_count = last.position_count.wrapping_add(position);
                    last.force_code = last.force_code.wrapping_add(force);
                    last.terminal_code = last.terminal_code.wrapping_add(terminal);
                    samples.push(last);
                }
            }
            // One arbitrary sample.
            3 => {
                last.index = last.index.wrapping_add(input.word());
                last.position_count = input.word() as i32;
                last.force_code = input.word() as i32;
                last.terminal_code = input.word() as i32;
                samples.push(last);
            }
            // A tone, with a force that follows its acceleration, velocity and sign.
            4 | 5 => {
                let (amplitude, period) = (f64::from(input.half()), 4.0 + f64::from(input.byte()) * 4.0);
                let [inertia, viscous, coulomb] = [0; 3].map(|_| f64::from(input.half() as i16));
                let (start, force) = (last.position_count, last.force_code);
                for n in 0..64 * (1 + u32::from(operation >> 3)) {
                    let (sine, cosine) = (f64::from(n) * std::f64::consts::TAU / period).sin_cos();
                    let code = -inertia * sine + viscous * cosine + coulomb * cosine.signum();
                    last.index = last.index.wrapping_add(1);
                    last.position_count = start.wrapping_add((amplitude * sine) as i32);
                    last.force_code = force.saturating_add(code as i32);
                    samples.push(last);
                }
            }
            // Repeats the last samples, scaled, or with their original index.
            6 => {
                let (count, scale) = (4 * (1 + usize::from(input.byte())), i32::from(input.byte() as i8));
                let again: Vec<RawSample> = samples[samples.len().saturating_sub(count)..].to_vec();
                let first = again.first().copied().unwrap_or_default();
                let start = last;
                for (n, here) in (1..).zip(again) {
                    let moved = here.position_count.wrapping_sub(first.position_count).wrapping_mul(scale);
                    last = RawSample {
                        index: if operation & 8 == 0 { start.index.wrapping_add(n) } else { here.index },
                        position_count: start.position_count.wrapping_add(moved >> 3),
                        force_code: here.force_code.wrapping_mul(scale),
                        terminal_code: here.terminal_code.wrapping_mul(scale),
                    };
                    samples.push(last);
                }
            }
            // A force at its limit or at zero, a constant code, then lost samples.
            _ => {
                let (count, lost) = (1 + u32::from(input.byte()), u32::from(input.byte()));
                for _ in 0..count {
                    last.index = last.index.wrapping_add(1);
                    last.force_code = match operation >> 3 & 3 {
                        0 => settings.force_min_code as i32,
                        1 => settings.force_max_code as i32,
                        2 => settings.force_zero_code as i32,
                        _ => last.force_code,
                    };
                    samples.push(last);
                }
                last.index = last.index.wrapping_add(lost);
            }
        }
        debug_assert!(samples.len() > from || operation & 7 <= 1 || operation & 7 == 6);
    }
    samples.truncate(MOST);
    samples
}

/// The records that a simulated device sends.
pub fn records() -> Vec<Record> {
    let Run { samples, outputs, last, state, active, .. } = Run::new(calibrated(), motions()[4].clone());
    let mut records: Vec<Record> =
        samples.chunks(32).step_by(40).map(|samples| Record::Samples(Samples::from_slice(samples).0)).collect();
    for Published { estimate, law, detail } in
        outputs.iter().filter_map(|output| output.published).take(2).chain([last])
    {
        records.extend([Record::Estimate(estimate), Record::Law(law), Record::Detail(detail)]);
    }
    records.extend(outputs.iter().filter_map(|output| output.reversal).take(2).map(Record::Reversal));
    for bank in [Bank::Fast, Bank::Slow] {
        records.extend([Record::Sums(active.sums(&state, bank)), Record::MoreSums(active.more_sums(&state, bank))]);
    }
    records.push(Record::Health(Health { index: state.last_index(), ..Health::default() }));
    records
}

/// Motions of the plant, each with each property, and typical faults of a rig.
pub fn seeds() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for motion in 0..MOTIONS.len() as u8 {
        for property in [0, 1, 2, 3, 5, 7] {
            seeds.push(vec![property, 0, 0, motion << 3, 20, 100]);
        }
        // A terminal sensor, a high publication rate, a short memory.
        let sensor = [24, 2, 0, 0, 19, 2, 0, 0, 17, 1, 0, 0];
        seeds.push([&[motion, 0, 3][..], &sensor, &[motion << 3, 0, 200]].concat());
        // Lost samples, saturation, a jump, and a repetition.
        let rig = [motion << 3, 0, 100, 7, 3, 9, motion << 3, 20, 60, 15, 2, 0, 6, 100, 8, 0, 9, 100];
        seeds.push([&[motion, 0, 0][..], &rig].concat());
    }
    for (number, info) in (0u8..).zip(Settings::TABLE) {
        for way in [1, 2, 4] {
            let share = if info.kind == Kind::Whole { 0 } else { 5 };
            seeds.push(vec![number, 0, 1, number, way, 0, share, 32, 20, 150]);
        }
    }
    for property in [0, 1, 3, 7] {
        let tone = [4 | 31 << 3, 0, 100, 50, 0, 20, 0, 4, 0, 1];
        seeds.push([&[property, 1, 0][..], &tone].concat());
        seeds.push([&[property, 0, 0][..], &[2, 9, 0, 3, 0, 0, 0, 255, 3, 1, 0, 0, 0, 7, 7, 7, 7], &tone].concat());
    }
    seeds
}

#[cfg(test)]
mod tests {
    use inerter_core::Interval;

    use super::*;

    #[test]
    fn a_value_that_only_one_side_has_is_judged() {
        let of = |value: f32, u95: f32, status: Status| Parameter::new(Interval { value, u95 }, status);
        let judge = |here, there| judge_mirrored(here, there, 1.0, true, true);
        let value = of(100.0, 1.0, Status::Ok);
        for status in [Status::Ok, Status::Held] {
            assert_eq!(judge(value, of(100.5, 1.0, status)), Ok(Some(Mirrored::ByValue)));
            assert!(judge(value, of(102.0, 1.0, status)).is_err());
        }
        let withheld = |value: f32| of(value, 1.0, Status::NotIdentifiable);
        assert_eq!(judge(value, withheld(100.5)), Ok(Some(Mirrored::ByFit)));
        assert!(judge(withheld(102.0), value).is_err());
        // Nothing is known on the other side.
        assert!(judge(value, Parameter::default()).is_err() && judge(Parameter::default(), value).is_err());
        let wide = of(100.0, 20.0, Status::Ok);
        assert_eq!(judge(wide, Parameter::default()), Ok(Some(Mirrored::Left)));
        assert_eq!(judge(Parameter::default(), withheld(100.0)), Ok(None));
        // From other data.
        assert_eq!(judge_mirrored(value, withheld(102.0), 1.0, false, false), Ok(Some(Mirrored::Left)));
    }
}
