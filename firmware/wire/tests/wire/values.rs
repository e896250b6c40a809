//! One value of everything that can be sent: every record, every command, every nested variant.

use crate::reference::step;
use inerter_core::{
    Backlash, BacklashSize, Band, Bank, Change, Changed, Contact, Detail, Estimate, Friction, Interval, Law, LawStatus,
    Misfit, MoreSums, Parameter, Parameters, RawSample, Reason, Regime, Reversal, Route, Status, Sums, Warning,
    WarningKind,
};
use inerter_needs::Random;
use inerter_wire::*;

fn parameter(value: f32, u95: f32, status: Status) -> Parameter {
    Parameter::new(Interval { value, u95 }, status)
}

pub fn hello() -> Hello {
    Hello {
        wire_version: WIRE_VERSION,
        firmware: Hello::text("inerter-qemu 0.1.0"),
        git: Hello::text("0123abcd"),
        board: Hello::text("netduinoplus2"),
        serial: Hello::text("SIM-1"),
        sample_rate_hz: 1000.0,
        clock: ClockSource::Simulated,
        capabilities: Capabilities::SAMPLER.with(Capabilities::INJECT).with(Capabilities::STORE),
    }
}

pub fn samples() -> Samples {
    let raw = |index, position_count, force_code, terminal_code| RawSample {
        index,
        position_count,
        force_code,
        terminal_code,
    };
    let (samples, taken) = Samples::from_slice(&[
        raw(1000, -5, 123_456, 0),
        raw(1001, -3, 123_400, 0),
        raw(1002, 0, 123_344, 0),
        raw(1010, i32::MAX, i32::MIN, 1),
        raw(1011, i32::MIN, i32::MAX, 0),
    ]);
    assert_eq!(taken, 5);
    samples
}

/// Three samples at rest except for one step, with one lost in between.
pub fn few_samples() -> Samples {
    let raw = |index, position_count| RawSample { index, position_count, ..RawSample::default() };
    Samples::from_slice(&[raw(3, -1), raw(4, 63), raw(6, 63)]).0
}

pub fn estimate() -> Estimate {
    let recent = Parameters {
        inertance_kg: parameter(299.5, 0.125, Status::Ok),
        viscous_n_s_per_m: parameter(31.25, 2.0, Status::Ok),
        coulomb_n: parameter(50.0, 0.5, Status::Held),
        offset_n: parameter(0.0, f32::INFINITY, Status::NotIdentifiable),
    };
    let whole_run = Parameters { offset_n: parameter(-1.5, 0.25, Status::Ok), ..recent };
    Estimate {
        index: 20_000,
        elapsed_samples: 5_000_000_000,
        bank: Bank::Slow,
        moving: true,
        recent,
        whole_run,
        residual_rms_n: 1.0,
        updates: 300,
    }
}

pub fn health() -> Health {
    Health {
        index: 20_000,
        uptime_s: 20,
        dropped_frames: 3,
        bad_frames: 1,
        lost_samples: 5_000_000_000,
        discontinuities: 2,
        overruns: 1,
        saturated: 7,
        cpu_load_permille: Some(125),
        stack_free_bytes: Some(4096),
        temperature_c: Some(36.5),
    }
}

/// Sums of either sign, some of them wider than 64 bits.
pub fn sums() -> Sums {
    Sums {
        index: 20_000,
        bank: Bank::Fast,
        updates: 4_900,
        units: [2e-6, -5e-8, 2.5e-10, 1.0, 0.002],
        sums: [
            1,
            -1,
            63,
            -64,
            64,
            -65,
            0,
            4_900,
            1 << 40,
            -(1 << 40),
            1 << 63,
            -(1 << 63),
            1 << 64,
            -(1 << 90),
            1 << 94,
        ],
    }
}

/// Sums with the longest encoding.
pub fn longest_sums() -> Sums {
    Sums { index: u32::MAX, bank: Bank::Slow, updates: u32::MAX, units: [f64::MIN; 5], sums: [i128::MIN; 15] }
}

fn some_sums(numbers: &mut Random) -> Sums {
    let mut sums = sums();
    sums.updates = numbers.draw() as u32;
    sums.sums.fill_with(|| some_sum(numbers));
    sums
}

fn some_more_sums(numbers: &mut Random) -> MoreSums {
    let mut sums = more_sums();
    sums.updates = numbers.draw() as u32;
    sums.sums.fill_with(|| some_sum(numbers));
    sums
}

fn some_sum(numbers: &mut Random) -> i128 {
    let wide = (u128::from(numbers.draw()) << 64 | u128::from(numbers.draw())) as i128;
    wide >> numbers.below(128)
}

/// Sums of the other two regressors, matching [`sums`].
pub fn more_sums() -> MoreSums {
    let Sums { index, bank, updates, sums, .. } = sums();
    MoreSums { index, bank, updates, units: [-5e-8, 0.25], sums: core::array::from_fn(|place| sums[place + 2]) }
}

/// Further sums with the longest encoding.
pub fn longest_more_sums() -> MoreSums {
    MoreSums { index: u32::MAX, bank: Bank::Slow, updates: u32::MAX, units: [f64::MIN; 2], sums: [i128::MIN; 13] }
}

pub fn reversal() -> Reversal {
    Reversal { index: 20_000, value_m: 5.25e-5, error_m: 1.5e-6, route: Route::Force, rising: true }
}

/// A law that does not hold, for [`estimate`].
pub fn law() -> Law {
    Law { index: 20_000, status: LawStatus::Broken, misfit: Some(Misfit { ratio: 5.25, limit: 1.5 }) }
}

/// The detail that belongs to [`estimate`], from a device with a terminal displacement sensor.
pub fn detail() -> Detail {
    Detail {
        index: 20_000,
        band: Band { low_hz: 3.0, high_hz: 6.5 },
        backlash: Backlash {
            size: BacklashSize::Ok(Interval { value: 5e-5, u95: 2e-6 }),
            route: Route::Terminal,
            reversals: 130,
        },
        contact: Contact::Backlash,
        stiffness_n_per_m: parameter(2.1e6, 4e3, Status::Ok),
        contact_damping_n_s_per_m: parameter(1200.0, 100.0, Status::Held),
        friction: Friction { reversal_ratio: Some(0.9375), regime: Regime::Coulomb },
        changes: 3,
    }
}

/// A detail with the longest encoding.
pub fn longest_detail() -> Detail {
    Detail {
        index: u32::MAX,
        backlash: Backlash { reversals: u32::MAX, ..without(Reason::Scattered) },
        changes: u32::MAX,
        ..detail()
    }
}

fn without(reason: Reason) -> Backlash {
    Backlash { size: BacklashSize::NotIdentifiable(reason), route: Route::Force, reversals: 2 }
}

fn few_settings() -> SettingsValues {
    let mut values = SettingsValues::default();
    values.push_by_name("structure_mass_kg", 1.515).unwrap();
    values.push_by_name("skew_s", -2e-6).unwrap();
    values
}

pub fn measured(what: Measure) -> Measured {
    let mut measured = Measured::new(what);
    measured.push(Quantity::DeviceId, 0x2003_6469);
    measured.push(Quantity::FlashKb, 512);
    measured
}

/// Measured figures with the longest encoding.
pub fn longest_measured() -> Measured {
    let figure = Figure { quantity: u8::MAX, value: u32::MAX };
    Measured { what: Measure::Work, figures: std::iter::repeat_n(figure, MAX_FIGURES).collect() }
}

fn event(kind: EventKind) -> Record {
    Record::Event(Event { index: 300, kind })
}

fn reply(result: Result<Done, Refusal>) -> Record {
    Record::Reply(Reply { id: 513, result })
}

/// Variants of an enum, each with its name after a prefix and as the value that `$of` makes of it.
macro_rules! each {
    ($prefix:literal, $of:expr, $kind:ident: $($variant:ident $(($content:expr))?),+ $(,)?) => {
        [$((concat!($prefix, stringify!($variant)), $of($kind::$variant $(($content))?)),)+]
    };
}

/// Names and records for the goldens.
pub fn records() -> Vec<(&'static str, Record)> {
    let by = |clock| Record::Hello(Hello { clock, ..hello() });
    let source = |source| event(EventKind::SourceChanged(source));
    let fault = |fault| event(EventKind::Fault(fault));
    let reset = |cause| event(EventKind::ResetBy(cause));
    let changed = |parameter| event(EventKind::Changed(Change { index: 290, parameter, before: 300.0, after: 250.5 }));
    let warned = |kind| event(EventKind::Warned(Warning { index: 290, kind }));
    let refused = |refusal| reply(Err(refusal));
    let bad = |fault| refused(Refusal::BadSetting { number: 8, fault });
    let backlash = |backlash, contact| Record::Detail(Detail { backlash, contact, ..detail() });
    let regime = |regime| Record::Detail(Detail { friction: Friction { reversal_ratio: None, regime }, ..detail() });
    let mut all = vec![("Hello", Record::Hello(hello()))];
    all.extend(each!("Hello.", by, ClockSource: Internal, Crystal, External));
    all.extend([
        ("Samples", Record::Samples(samples())),
        ("Samples.empty", Record::Samples(Samples::default())),
        ("Estimate", Record::Estimate(estimate())),
        ("Estimate.default", Record::Estimate(Estimate::default())),
        ("Health", Record::Health(health())),
        ("Health.default", Record::Health(Health::default())),
    ]);
    all.extend(each!("Event.", event, EventKind: Started, SourceEnded, EstimatorReset, SettingsChanged));
    all.extend(each!("Event.SourceChanged.", source, Source: Stopped, Sampler, Link));
    all.extend(each!(
        "Event.Fault.", fault, Fault: SamplerOverrun, SourceUnreadable, Store, SavedSettings, Watchdog, NewerSettings,
        ForeignSettings, SamplerMisaligned, SettingsLeft
    ));
    all.push(("Event.Panicked", event(EventKind::Panicked(Hello::text("at src/main.rs:1")))));
    all.extend(each!(
        "Event.ResetBy.", reset, ResetCause: PowerOn, Pin, Software, Watchdog, WindowWatchdog, LowPower, OptionBytes,
        Panic, Unknown
    ));
    all.extend(each!("Event.Changed.", changed, Changed: Inertance, Viscous, Coulomb, Offset));
    all.extend(each!("Event.Warned.", warned, WarningKind: WrongSign, CountSlip, ClippedForce, DeadForce));
    all.extend([
        ("Reply.Plain", reply(Ok(Done::Plain))),
        ("Reply.Injected", reply(Ok(Done::Injected { accepted: 320, free: 96 }))),
        ("Reply.Played", reply(Ok(Done::Played { answer: 128_000, free: 208 }))),
    ]);
    all.extend(each!("Reply.", refused, Refusal: Unsupported, Busy));
    all.push(("Reply.QueueFull", refused(Refusal::QueueFull { accepted: 320, free: 0 })));
    all.extend(each!(
        "Reply.BadSetting.", bad, SettingFault: Unknown, NotFinite, OutOfRange, NotWhole, Zero, Conflict(9), Repeated,
        NotOffered
    ));
    all.extend(each!(
        "Reply.", refused, Refusal: BadSamples, NotInjecting, Store, NoSamples, Source, NothingSaved, SavedUnreadable
    ));
    all.extend([
        ("Reply.Worn", refused(Refusal::Worn { wait_s: 119 })),
        ("Reply.NotPlaying", refused(Refusal::NotPlaying)),
        ("Settings", Record::Settings(few_settings())),
        ("Saved", Record::Saved(few_settings())),
        ("Measured", Record::Measured(measured(Measure::Chip))),
        ("Measured.clocks", Record::Measured(measured(Measure::Clocks))),
        ("Measured.supply", Record::Measured(measured(Measure::Supply))),
        ("Measured.work", Record::Measured(measured(Measure::Work))),
        ("Measured.nothing", Record::Measured(Measured::new(Measure::Hang))),
        ("Measured.longest", Record::Measured(longest_measured())),
        ("Sums", Record::Sums(sums())),
        ("Sums.slow", Record::Sums(Sums { bank: Bank::Slow, ..sums() })),
        ("Sums.empty", Record::Sums(Sums { updates: 0, units: [1.0; 5], sums: [0; 15], ..sums() })),
        ("Sums.least", Record::Sums(longest_sums())),
        ("Sums.greatest", Record::Sums(Sums { units: [f64::MAX; 5], sums: [i128::MAX; 15], ..longest_sums() })),
        ("Reversal", Record::Reversal(reversal())),
        ("Reversal.terminal", Record::Reversal(Reversal { route: Route::Terminal, rising: false, ..reversal() })),
        ("Reversal.default", Record::Reversal(Reversal::default())),
        ("Detail", Record::Detail(detail())),
        ("Detail.default", Record::Detail(Detail::default())),
        ("Detail.longest", Record::Detail(longest_detail())),
        ("Detail.ForceNeverReverses", backlash(without(Reason::ForceNeverReverses), Contact::OneSided)),
        ("Detail.TooFewReversals", backlash(without(Reason::TooFewReversals), Contact::Unknown)),
        ("Detail.FlankTooShort", backlash(without(Reason::FlankTooShort), Contact::Bouncing)),
        ("Detail.StiffnessUnknown", backlash(without(Reason::StiffnessUnknown), Contact::Backlash)),
        ("Detail.Scattered", backlash(without(Reason::Scattered), Contact::Bouncing)),
        (
            "Detail.BelowU95",
            backlash(
                Backlash { size: BacklashSize::BelowU95(Interval { value: 5e-5, u95: 2e-6 }), ..detail().backlash },
                Contact::Closed,
            ),
        ),
    ]);
    all.extend(each!("Detail.", regime, Regime: Unknown, Presliding, Stribeck));
    all.extend([
        ("Law", Record::Law(law())),
        ("Law.default", Record::Law(Law::default())),
        ("Law.holds", Record::Law(Law { status: LawStatus::Holds, ..law() })),
        ("Law.unknown", Record::Law(Law { status: LawStatus::Unknown, index: u32::MAX, ..law() })),
        ("MoreSums", Record::MoreSums(more_sums())),
        ("MoreSums.slow", Record::MoreSums(MoreSums { bank: Bank::Slow, ..more_sums() })),
        ("MoreSums.empty", Record::MoreSums(MoreSums { updates: 0, units: [1.0; 2], sums: [0; 13], ..more_sums() })),
        ("MoreSums.least", Record::MoreSums(longest_more_sums())),
    ]);
    all
}

/// As many knots as one command can hold, the longest first.
fn knots() -> heapless::Vec<Knot, { Knot::MAX_KNOTS }> {
    let longest = Knot { force: u16::MAX, terminal: u16::MAX - 1, advance: -Knot::MAX_ADVANCE };
    (0..Knot::MAX_KNOTS).map(|place| Knot { force: longest.force - place as u16, ..longest }).collect()
}

/// Names and requests for the goldens.
pub fn requests() -> Vec<(&'static str, Request)> {
    let request = |command| Request { id: 513, command };
    let streams =
        |samples, estimates, sums, health| request(Command::Streams(Streams { samples, estimates, sums, health }));
    let measure = |what| request(Command::Measure(what));
    let play = |play| request(Command::Play(play));
    let mut all = Vec::from(each!(
        "", request, Command: Hello, ReadSettings, WriteSettings(few_settings()), SaveSettings, Tare, ResetEstimator,
        Start, Stop, Inject(samples()), InjectEnd, EnterDfu, Reboot, FactoryReset, ReadSaved
    ));
    all.extend([
        ("Streams.samples", streams(true, false, false, false)),
        ("Streams.estimates", streams(false, true, false, false)),
        ("Streams.sums", streams(false, false, true, false)),
        ("Streams.health", streams(false, false, false, true)),
        ("Measure.chip", measure(Measure::Chip)),
        ("Measure.clocks", measure(Measure::Clocks)),
        ("Measure.supply", measure(Measure::Supply)),
        ("Measure.work", measure(Measure::Work)),
        ("Measure.hang", measure(Measure::Hang)),
        ("Play.Begin", play(Play::Begin { phase_ticks: 1312 })),
        ("Play.Knots", play(Play::Knots(knots().iter().take(3).copied().collect()))),
        ("Play.Knots.longest", play(Play::Knots(knots()))),
        ("Play.Burst", play(Play::Burst { edge_ticks: 28, blocks: 1000 })),
        ("Play.End", play(Play::End)),
        ("Play.Progress", play(Play::Progress)),
    ]);
    all
}

/// A batch with the longest encoding.
pub fn longest_samples() -> Samples {
    let mut builder = Samples::builder();
    let mut numbers = Random(1);
    loop {
        let sample = RawSample {
            index: numbers.draw() as u32,
            position_count: numbers.draw() as i32,
            force_code: numbers.draw() as i32,
            terminal_code: numbers.draw() as i32,
        };
        if builder.push(&sample).is_err() {
            return builder.take();
        }
    }
}

/// As many settings as one message can carry.
pub fn most_settings() -> SettingsValues {
    SettingsValues((0..MAX_SETTINGS).map(|number| SettingValue { number: number as u8, value: f64::MIN }).collect())
}

fn some_samples(numbers: &mut Random) -> Samples {
    let mut builder = Samples::builder();
    let mut sample = RawSample { index: numbers.draw() as u32, position_count: step(numbers), ..RawSample::default() };
    for _ in 0..numbers.below(40) {
        sample.index = sample.index.wrapping_add(if numbers.below(20) == 0 { step(numbers) as u32 } else { 1 });
        sample.position_count = sample.position_count.wrapping_add(step(numbers) >> (numbers.below(2) * 16));
        sample.force_code = sample.force_code.wrapping_add(step(numbers) >> (numbers.below(2) * 16));
        sample.terminal_code = sample.terminal_code.wrapping_add(step(numbers) >> (numbers.below(2) * 16));
        if builder.push(&sample).is_err() {
            break;
        }
    }
    builder.take()
}

fn some_settings(numbers: &mut Random) -> SettingsValues {
    let count = numbers.below(MAX_SETTINGS + 1);
    SettingsValues(
        (0..count).map(|_| SettingValue { number: numbers.draw() as u8, value: f64::from(step(numbers)) }).collect(),
    )
}

/// Any record, with random numbers where they matter.
pub fn some_record(numbers: &mut Random) -> Record {
    match numbers.below(7) {
        0 => Record::Samples(some_samples(numbers)),
        1 => Record::Settings(some_settings(numbers)),
        2 => Record::Estimate(Estimate {
            index: numbers.draw() as u32,
            elapsed_samples: numbers.draw() >> numbers.below(64),
            residual_rms_n: step(numbers) as f32,
            ..estimate()
        }),
        3 => Record::Sums(some_sums(numbers)),
        4 => Record::MoreSums(some_more_sums(numbers)),
        5 => Record::Detail(Detail {
            index: numbers.draw() as u32,
            band: Band { low_hz: step(numbers) as f32, high_hz: step(numbers) as f32 },
            changes: numbers.draw() as u32 >> numbers.below(32),
            ..detail()
        }),
        _ => {
            let mut all = records();
            // Restarts have their own tests.
            all.retain(|(name, _)| *name != "Event.Started" && !name.starts_with("Hello"));
            all.swap_remove(numbers.below(all.len())).1
        }
    }
}
