//! The driver against the model of the chip.

use core::cell::RefCell;
use core::convert::Infallible;
use core::future::Future;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::rc::Rc;
use std::string::{String, ToString};

use embedded_hal::digital::OutputPin;
use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::spi::{Operation, SpiDevice};
use inerter_needs::Random;

use crate::frame::{Command, FRAME_BYTES};
use crate::mock::Chip;
use crate::registers::{Channel, Register};
use crate::{Ads131m04, Config, Conversion, Error, Gain, Osr, Recovery};

type AnyError = Error<Infallible, Infallible>;

/// The wires, and their faults.
struct Wires {
    chip: Chip,
    /// Level of a line that nothing drives.
    stuck: Option<bool>,
    /// CLKIN periods.
    now: u64,
    clkin_hz: u64,
    frames: usize,
    /// Bit to flip, counted from the beginning of the next frame.
    flip_mosi: Option<usize>,
    flip_miso: Option<usize>,
    /// The next transfer never completes: it stops after this many bytes.
    stall_after: Option<usize>,
    /// Conversions that are done while each of the next frames is on the wire.
    convert_in_frame: usize,
    sample: i32,
}

impl Wires {
    /// The chip converts: channel 0 counts up.
    fn convert(&mut self) -> i32 {
        self.sample += 1;
        self.chip.convert([self.sample, -self.sample, 5, -5]);
        self.sample
    }

    /// One frame, from somebody else than the driver.
    fn send(&mut self, bytes: impl IntoIterator<Item = u8>) {
        self.chip.cs(true);
        for byte in bytes {
            self.chip.shift(byte);
        }
        self.chip.cs(false);
    }
}

#[derive(Clone)]
struct Bus(Rc<RefCell<Wires>>);

impl Bus {
    fn new() -> Self {
        Self(Rc::new(RefCell::new(Wires {
            chip: Chip::new(),
            stuck: None,
            now: 0,
            clkin_hz: 8_000_000,
            frames: 0,
            flip_mosi: None,
            flip_miso: None,
            stall_after: None,
            convert_in_frame: 0,
            sample: 0,
        })))
    }

    fn driver(&self, config: Config) -> Ads131m04<Bus, Bus> {
        Ads131m04::new(self.clone(), self.clone(), config)
    }

    fn convert(&self) -> i32 {
        self.with(Wires::convert)
    }

    /// Channel 0 of the latest conversion.
    fn latest(&self) -> i32 {
        self.with(|wires| wires.sample)
    }

    fn with<T>(&self, change: impl FnOnce(&mut Wires) -> T) -> T {
        change(&mut self.0.borrow_mut())
    }
}

impl embedded_hal::spi::ErrorType for Bus {
    type Error = Infallible;
}

impl embedded_hal::digital::ErrorType for Bus {
    type Error = Infallible;
}

impl SpiDevice for Bus {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let [Operation::TransferInPlace(bytes)] = operations else { panic!("one transfer in place") };
        let stall = self.with(|wires| {
            wires.frames += 1;
            let (mosi, miso) = (wires.flip_mosi.take(), wires.flip_miso.take());
            let stall = wires.stall_after.take();
            let flipped = |flip: Option<usize>, index: usize| match flip {
                Some(bit) if bit / 8 == index => 0x80 >> (bit % 8),
                _ => 0,
            };
            wires.chip.cs(true);
            for (index, byte) in bytes.iter_mut().enumerate().take(stall.unwrap_or(usize::MAX)) {
                let answer = wires.chip.shift(*byte ^ flipped(mosi, index));
                *byte = match wires.stuck {
                    None => answer ^ flipped(miso, index),
                    Some(high) => 0xFF * u8::from(high),
                };
            }
            wires.chip.cs(false);
            for _ in 0..wires.convert_in_frame {
                wires.convert();
            }
            stall.is_some()
        });
        if stall {
            core::future::pending::<()>().await;
        }
        Ok(())
    }
}

impl OutputPin for Bus {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.with(|wires| wires.chip.sync_reset(false, wires.now));
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.with(|wires| wires.chip.sync_reset(true, wires.now));
        Ok(())
    }
}

impl DelayNs for Bus {
    async fn delay_ns(&mut self, ns: u32) {
        self.with(|wires| wires.now += u64::from(ns) * wires.clkin_hz / 1_000_000_000);
    }
}

fn poll<T>(future: impl Future<Output = T>) -> Poll<T> {
    pin!(future).as_mut().poll(&mut Context::from_waker(Waker::noop()))
}

#[track_caller]
fn run<T>(future: impl Future<Output = T>) -> T {
    match poll(future) {
        Poll::Ready(value) => value,
        Poll::Pending => panic!("waits for what does not come"),
    }
}

fn config() -> Config {
    Config {
        gains: [Gain::X32, Gain::X1, Gain::X2, Gain::X128],
        phases: [0, 0, -3, 0],
        offsets: [0; 4],
        ..Config::default()
    }
}

/// A running converter whose filter has settled.
fn running() -> (Bus, Ads131m04<Bus, Bus>) {
    let (bus, mut adc) = set_up(config());
    for _ in 0..Osr::SETTLING {
        bus.convert();
        assert!(!run(adc.read()).expect("sound").settled);
    }
    (bus, adc)
}

fn next(bus: &Bus, adc: &mut Ads131m04<Bus, Bus>) -> Result<Conversion, AnyError> {
    bus.convert();
    run(adc.read())
}

/// The next conversion, which must be sound and of its own DRDY edge.
#[track_caller]
fn sound<S: SpiDevice<Error = Infallible>>(bus: &Bus, adc: &mut Ads131m04<S, Bus>) -> Conversion {
    let sample = bus.convert();
    let conversion = run(adc.read()).expect("sound");
    assert_eq!(conversion.channels[0], sample);
    conversion
}

/// A driver whose set-up is done.
fn set_up(config: Config) -> (Bus, Ads131m04<Bus, Bus>) {
    let bus = Bus::new();
    let mut adc = bus.driver(config);
    run(adc.init(&mut bus.clone())).expect("starts");
    (bus, adc)
}

#[test]
fn set_up_writes_every_register_and_locks() {
    let (bus, adc) = running();
    bus.with(|wires| {
        assert!(wires.chip.status().locked());
        assert!(!wires.chip.status().was_reset());
        for (register, value) in config().registers() {
            assert_eq!(wires.chip.register(register.address()), value, "{register:?}");
        }
        assert_eq!(wires.chip.register(0x02), 0x3110);
        assert_eq!(wires.chip.osr(), Osr::X4096);
        assert_eq!(wires.chip.period_clkin(), Some(8192));
        assert_eq!(wires.chip.full_scale_v(0), 1.2 / 32.0);
        assert_eq!(wires.chip.full_scale_v(3), 1.2 / 128.0);
    });
    assert_eq!(adc.config().data_rate_hz(), 976.5625);
}

#[test]
fn conversions_come_in_order_and_settled() {
    let (bus, mut adc) = running();
    for _ in 0..10 {
        let conversion = sound(&bus, &mut adc);
        let sample = conversion.channels[0];
        assert_eq!(conversion.channels, [sample, -sample, 5, -5]);
        assert!(conversion.settled && conversion.status.all_ready());
        assert!(bus.with(|wires| wires.chip.drdy()));
    }
}

#[test]
fn offset_and_trim_act_in_the_chip() {
    let (bus, mut adc) =
        set_up(Config { offsets: [-7, 0, 0, 0], trims: [0x40_0000, 0x80_0000, 0, 0x80_0000], ..config() });
    bus.with(|wires| wires.chip.convert([1001, 8_388_607, 9, -8_388_608]));
    assert_eq!(run(adc.read()).expect("sound").channels, [504, 8_388_607, 0, -8_388_608]);
}

#[test]
fn a_new_configuration_reaches_a_locked_chip() {
    let (bus, mut adc) = running();
    let other = Config { osr: Osr::X1024, gains: [Gain::X64; 4], ..config() };
    run(adc.configure(other)).expect("taken");
    assert_eq!(bus.with(|wires| (wires.chip.osr(), wires.chip.register(0x04))), (Osr::X1024, 0x6666));
    assert!(bus.with(|wires| wires.chip.status().locked()));
    for index in 0..=Osr::SETTLING {
        assert_eq!(next(&bus, &mut adc).expect("sound").settled, index == Osr::SETTLING);
    }
    let impossible = Config { clkin_hz: 50_000_000, ..other };
    assert!(matches!(run(adc.configure(impossible)), Err(Error::Config(_))));
    assert!(next(&bus, &mut adc).is_ok(), "a refused configuration leaves the chip running");
}

#[test]
fn nobody_there() {
    for high in [false, true] {
        let bus = Bus::new();
        bus.with(|wires| wires.stuck = Some(high));
        let error = run(bus.driver(config()).init(&mut bus.clone())).expect_err("nobody");
        assert_eq!(error, Error::NoChip { high });
        assert_eq!(error.recovery(), Recovery::Person);
        assert!(error.to_string().contains(if high { "stays high" } else { "stays low" }));
    }
}

#[test]
fn a_chip_that_falls_off_is_noticed() {
    let (bus, mut adc) = running();
    bus.with(|wires| wires.stuck = Some(true));
    assert_eq!(next(&bus, &mut adc), Err(Error::NoChip { high: true }));
    assert_eq!(run(adc.resynchronise(&mut bus.clone())), Err(Error::NoChip { high: true }));
    bus.with(|wires| wires.stuck = None);
    assert!(run(adc.init(&mut bus.clone())).is_ok(), "and when it is back, it starts");
}

#[test]
fn another_chip_is_refused() {
    let bus = Bus::new();
    bus.with(|wires| wires.chip.disturb_register(0x00, 0x2801));
    let mut adc = bus.driver(config());
    // The pin's reset would restore the model's own ID: with the clock stopped, the chip stays as it is.
    bus.with(|wires| wires.clkin_hz = 0);
    assert_eq!(run(adc.init(&mut bus.clone())), Err(Error::WrongChip { response: 0x2801 }));
    assert_eq!(run(adc.read()), Err(Error::NotRunning));
}

#[test]
fn without_a_clock_the_pin_resets_nothing() {
    let (bus, mut adc) = running();
    bus.with(|wires| wires.clkin_hz = 0);
    let error = run(adc.init(&mut bus.clone())).expect_err("not reset");
    assert!(matches!(error, Error::NotReset { .. }), "{error:?}");
    assert!(error.to_string().contains("CLKIN"));
}

#[test]
fn each_bit_flipped_on_the_way_in_is_found() {
    let (bus, mut adc) = running();
    for bit in 0..FRAME_BYTES * 8 {
        bus.with(|wires| wires.flip_miso = Some(bit));
        let result = next(&bus, &mut adc);
        assert!(matches!(result, Err(Error::FrameCrc { .. })), "bit {bit}: {result:?}");
        let conversion = next(&bus, &mut adc).expect("the next is sound");
        assert_eq!(conversion.channels[0], bus.latest(), "bit {bit}");
    }
}

#[test]
fn each_bit_flipped_on_the_way_out_is_found() {
    let (bus, mut adc) = running();
    // The command's word with its padding, and the CRC: the chip checks no more.
    for bit in 0..40 {
        bus.with(|wires| wires.flip_mosi = Some(bit));
        assert!(next(&bus, &mut adc).is_ok(), "the damaged frame itself brings a good conversion");
        let result = next(&bus, &mut adc);
        assert_eq!(result, Err(Error::CommandCrc), "bit {bit}");
        assert_eq!(Error::<(), ()>::CommandCrc.recovery(), Recovery::Continue);
        let conversion = next(&bus, &mut adc).expect("the one after is sound");
        assert_eq!(conversion.channels[0], bus.latest(), "bit {bit}");
    }
    bus.with(|wires| assert!(wires.chip.status().locked()));
}

#[test]
fn each_bit_flipped_in_a_write_is_found() {
    // Frames 0 to 2 are acknowledge and ID; frame 3 writes GAIN. The chip does not check yet: reading back finds it.
    // Bits 24, 28, 32 and 36 are reserved in GAIN.
    for bit in (0..16).chain(24..40).filter(|bit| *bit < 16 || bit % 4 != 0) {
        let bus = Bus::new();
        let fault = |wires: &mut Wires| wires.flip_mosi = Some(bit);
        let mut adc = Ads131m04::new(Faulty { bus: bus.clone(), frame: 3, fault }, bus.clone(), config());
        let result = run(adc.init(&mut bus.clone()));
        assert!(matches!(result, Err(Error::Refused { .. } | Error::NotKept { .. })), "bit {bit}: {result:?}");
    }
}

/// Causes a fault in one frame.
struct Faulty<F> {
    bus: Bus,
    frame: usize,
    fault: F,
}

impl<F> embedded_hal::spi::ErrorType for Faulty<F> {
    type Error = Infallible;
}

impl<F: FnMut(&mut Wires)> SpiDevice for Faulty<F> {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        self.bus.with(|wires| {
            if wires.frames == self.frame {
                (self.fault)(wires);
            }
        });
        self.bus.transaction(operations).await
    }
}

#[test]
fn a_reset_behind_our_back_is_noticed_and_repaired() {
    let (bus, mut adc) = running();
    bus.with(|wires| wires.chip.power_cycle());
    let result = next(&bus, &mut adc);
    assert!(matches!(result, Err(Error::WasReset { .. })), "{result:?}");
    assert_eq!(result.expect_err("reset").recovery(), Recovery::Initialise);
    run(adc.resynchronise(&mut bus.clone())).expect("repaired");
    assert_eq!(bus.with(|wires| wires.chip.osr()), Osr::X4096);
    assert!(!sound(&bus, &mut adc).settled);
}

#[test]
fn a_reset_whose_acknowledge_was_lost_is_noticed() {
    let (bus, mut adc) = running();
    bus.with(|wires| {
        wires.chip.power_cycle();
        wires.flip_miso = Some(20);
    });
    assert!(matches!(next(&bus, &mut adc), Err(Error::FrameCrc { .. })));
    assert!(matches!(next(&bus, &mut adc), Err(Error::WasReset { .. })));
}

#[test]
fn a_changed_register_is_noticed() {
    let (bus, mut adc) = running();
    bus.with(|wires| wires.chip.disturb_register(0x04, 0));
    let result = next(&bus, &mut adc);
    assert!(matches!(result, Err(Error::SetupChanged { .. })), "{result:?}");
    run(adc.resynchronise(&mut bus.clone())).expect("repaired");
    assert_eq!(bus.with(|wires| wires.chip.register(0x04)), 0x7105);
}

#[test]
fn a_register_that_changes_while_a_frame_is_on_the_wire_is_told_by_the_next() {
    let (bus, mut adc) = running();
    bus.with(|wires| {
        wires.chip.cs(true);
        for (place, byte) in Command::Null.frame().into_iter().enumerate() {
            if place == FRAME_BYTES / 2 {
                wires.chip.disturb_register(0x04, 0);
            }
            let _ = wires.chip.shift(byte);
        }
        wires.chip.cs(false);
    });
    let result = next(&bus, &mut adc);
    assert!(matches!(result, Err(Error::SetupChanged { .. })), "{result:?}");
}

#[test]
fn a_lost_lock_is_noticed() {
    let (bus, mut adc) = running();
    bus.with(|wires| wires.send(Command::Unlock.frame()));
    assert!(matches!(next(&bus, &mut adc), Err(Error::SetupChanged { .. })));
}

#[test]
fn a_locked_chip_ignores_writes() {
    let (bus, mut adc) = running();
    bus.with(|wires| {
        wires.send(Command::Write(Register::ChannelCfg(Channel::Zero), 0xFFC0).frame());
        assert_eq!(wires.chip.register(0x09), 0);
    });
    assert!(next(&bus, &mut adc).is_ok());
}

#[test]
fn not_ready_is_said() {
    let (_bus, mut adc) = running();
    let result = run(adc.read());
    assert!(matches!(result, Err(Error::NotReady { .. })), "{result:?}");
    assert_eq!(result.expect_err("none").recovery(), Recovery::Resynchronise);
}

#[test]
fn after_a_pause_frames_are_late_until_drained() {
    let (bus, mut adc) = running();
    bus.convert();
    bus.convert();
    // The trap: this frame's conversion is one period old, and so would be each after it.
    let sample = bus.convert();
    assert_eq!(run(adc.read()).expect("sound").channels[0], sample - 1);
    assert_eq!(run(adc.drain()).expect("sound"), 1);
    sound(&bus, &mut adc);
    assert_eq!(run(adc.drain()).expect("sound"), 0);
}

#[test]
fn resynchronise_throws_away_what_lay_there() {
    let (bus, mut adc) = running();
    for _ in 0..5 {
        bus.convert();
    }
    assert_eq!(run(adc.resynchronise(&mut bus.clone())).expect("sound"), 2);
    assert!(sound(&bus, &mut adc).settled, "the filter was never disturbed");
}

#[test]
fn resynchronise_survives_damage() {
    let (bus, mut adc) = running();
    for bit in [5, 70, 140] {
        bus.convert();
        bus.with(|wires| wires.flip_miso = Some(bit));
        assert_eq!(run(adc.resynchronise(&mut bus.clone())).expect("sound"), 1);
        sound(&bus, &mut adc);
    }
}

#[test]
fn a_pulse_on_sync_is_noticed_and_settles_again() {
    let (bus, mut adc) = running();
    bus.with(|wires| {
        wires.chip.sync_reset(false, wires.now);
        wires.now += 100;
        wires.chip.sync_reset(true, wires.now);
    });
    let result = next(&bus, &mut adc);
    assert!(matches!(result, Err(Error::Resynchronised { .. })), "{result:?}");
    for index in 0..=Osr::SETTLING {
        assert_eq!(next(&bus, &mut adc).expect("sound").settled, index == Osr::SETTLING);
    }
}

#[test]
fn conversions_faster_than_frames_are_said() {
    let (bus, mut adc) = running();
    bus.convert();
    bus.with(|wires| wires.convert_in_frame = 1);
    assert_eq!(run(adc.drain()), Err(Error::TooSlow));
}

#[test]
fn a_dropped_read_costs_one_conversion() {
    let (bus, mut adc) = running();
    for bytes in 0..=FRAME_BYTES {
        bus.convert();
        bus.with(|wires| wires.stall_after = Some(bytes));
        assert!(poll(adc.read()).is_pending());
        run(adc.drain()).expect("sound");
        let conversion = next(&bus, &mut adc).expect("sound");
        assert_eq!(conversion.channels[0], bus.latest(), "dropped after {bytes} bytes");
    }
}

#[test]
fn a_dropped_set_up_can_be_repeated() {
    for frame in 0..60 {
        let bus = Bus::new();
        let fault = |wires: &mut Wires| wires.stall_after = Some(9);
        let mut adc = Ads131m04::new(Faulty { bus: bus.clone(), frame, fault }, bus.clone(), config());
        assert!(poll(adc.init(&mut bus.clone())).is_pending(), "frame {frame}");
        assert_eq!(run(adc.read()), Err(Error::NotRunning));
        run(adc.init(&mut bus.clone())).expect("starts");
        sound(&bus, &mut adc);
    }
}

#[test]
fn standby_and_back() {
    let (bus, mut adc) = running();
    run(adc.standby()).expect("sleeps");
    assert_eq!(bus.with(|wires| wires.chip.period_clkin()), None);
    assert_eq!(run(adc.read()), Err(Error::NotRunning));
    assert_eq!(run(adc.resynchronise(&mut bus.clone())), Err(Error::NotRunning));
    run(adc.wake_up()).expect("wakes");
    assert!(bus.with(|wires| wires.chip.status().locked()));
    assert!(!sound(&bus, &mut adc).settled);
    assert_eq!(run(adc.wake_up()), Err(Error::NotRunning));
}

#[test]
fn every_error_says_what_to_do() {
    let status = crate::Status(0x0500);
    let errors: [AnyError; 14] = [
        Error::Config(crate::ConfigError::Phase { channel: 2 }),
        Error::NoChip { high: true },
        Error::NoChip { high: false },
        Error::WrongChip { response: 0xFF28 },
        Error::NotReset { response: 0 },
        Error::FrameCrc { received: 1, computed: 2 },
        Error::CommandCrc,
        Error::Refused { command: 0x555, response: 0x500 },
        Error::NotKept { register: Register::Gain, wrote: 1, read: 0 },
        Error::WasReset { status },
        Error::SetupChanged { status },
        Error::Resynchronised { status },
        Error::NotReady { status },
        Error::TooSlow,
    ];
    for error in errors {
        let text: String = error.to_string();
        assert!(
            ["check", "initialise", "resynchronise", "shorten", "choose", "at most"]
                .iter()
                .any(|word| text.contains(word)),
            "{text}"
        );
    }
}

#[test]
fn the_chip_answers_a_list_of_registers() {
    let mut chip = Chip::new();
    let mut exchange = |words: [u16; 2]| {
        chip.cs(true);
        let mut out = [0; 4 * 3];
        for (index, byte) in out.iter_mut().enumerate() {
            let word = words.get(index / 3).copied().unwrap_or(0).to_be_bytes();
            *byte = chip.shift(word.get(index % 3).copied().unwrap_or(0));
        }
        chip.cs(false);
        out
    };
    exchange([0xA000 | 2 << 7 | 1, 0]);
    let listed = exchange([0, 0]);
    assert_eq!(listed[..9], [0xE1, 0x01, 0, 0x05, 0x10, 0, 0x0F, 0x0E, 0]);
    assert_eq!(listed[9..11], crate::crc(&listed[..9]).to_be_bytes());
}

#[test]
fn an_acknowledge_that_somebody_else_took_is_not_missed() {
    let bus = Bus::new();
    bus.with(|wires| {
        // The clock is stopped, so that the pin does not cause a new acknowledge.
        wires.clkin_hz = 0;
        wires.send(Command::Null.frame());
    });
    run(bus.driver(config()).init(&mut bus.clone())).expect("starts");
}

/// Answers random bytes; one frame in four with a matching CRC.
struct Babble(Random);

impl embedded_hal::spi::ErrorType for Babble {
    type Error = Infallible;
}

impl SpiDevice for Babble {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let [Operation::TransferInPlace(bytes)] = operations else { panic!("one transfer in place") };
        bytes.copy_from_slice(&self.0.bytes(bytes.len()));
        if self.0.percent(25) {
            let check = crate::crc(&bytes[..15]).to_be_bytes();
            bytes[15..].copy_from_slice(&[check[0], check[1], 0]);
        }
        Ok(())
    }
}

#[test]
fn garbage_is_never_taken_for_a_chip() {
    let bus = Bus::new();
    let mut adc = Ads131m04::new(Babble(Random(1)), bus.clone(), config());
    for _ in 0..20_000 {
        assert!(run(adc.init(&mut bus.clone())).is_err());
        assert_eq!(run(adc.read()), Err(Error::NotRunning));
        assert!(run(adc.resynchronise(&mut bus.clone())).is_err());
    }
}

#[test]
fn garbage_on_the_wire_leaves_the_chip_usable() {
    let mut noise = Random(2);
    let bus = Bus::new();
    for round in 0..2_000 {
        bus.with(|wires| {
            for _ in 0..4 {
                let count = 3 + noise.below(256);
                wires.send(noise.bytes(count));
                wires.chip.convert([0x7F_FFFF, -0x80_0000, i32::MAX, i32::MIN]);
            }
        });
        let mut adc = bus.driver(config());
        run(adc.init(&mut bus.clone())).unwrap_or_else(|error| panic!("round {round}: {error}"));
        sound(&bus, &mut adc);
    }
}
