use std::{cell::RefCell, rc::Rc};

use inerter_wire::{Capabilities, ClockSource, Hello};

use super::*;
use crate::{
    error::DeviceError,
    image::{MAGIC, sample},
    update::mock::{Chip, LAYOUT, MockIo},
};

const SERIAL: &str = "205735883537";
const OLD: &str = "inerter 0.0.9";
const NEW: &str = "inerter 0.1.0";

/// A bench with a running device, one in update mode, or both, and a clock that only `sleep` moves.
struct FakeMachine {
    chip: Rc<RefCell<Chip>>,
    running: Option<Hello>,
    in_dfu: Vec<String>,
    /// Serial number of the device that was opened.
    opened: Option<String>,
    /// Polls until the device that was told to enter update mode appears there; `None` for never.
    appears_after: Option<u32>,
    entering: Option<u32>,
    /// Initial attempts to open it that are refused.
    forbidden: u32,
    /// Further attempts that fail after that.
    occupied: u32,
    /// Polls until the firmware answers after its start.
    answers_after: u32,
    slept: Duration,
    interrupted_at: Duration,
}

fn hello(serial: &str, firmware: &str) -> Hello {
    Hello {
        wire_version: inerter_wire::WIRE_VERSION,
        firmware: Hello::text(firmware),
        git: Hello::text("c8a2d5a"),
        board: Hello::text("nucleo-g474re"),
        serial: Hello::text(serial),
        sample_rate_hz: 4000.0,
        clock: ClockSource::Crystal,
        capabilities: Capabilities::DFU.with(Capabilities::STORE),
    }
}

fn bench(running: Option<Hello>, in_dfu: &[&str]) -> FakeMachine {
    FakeMachine {
        chip: Chip::new(),
        running,
        in_dfu: in_dfu.iter().map(ToString::to_string).collect(),
        opened: None,
        appears_after: Some(3),
        entering: None,
        forbidden: 2,
        occupied: 0,
        answers_after: 4,
        slept: Duration::ZERO,
        interrupted_at: Duration::MAX,
    }
}

/// A bench whose device runs the old firmware.
fn running(in_dfu: &[&str]) -> FakeMachine {
    bench(Some(hello(SERIAL, OLD)), in_dfu)
}

fn dfu_device(serial: &str) -> DfuDevice {
    DfuDevice { product: None, serial: serial.into(), vid: 0x0483, pid: 0xDF11 }
}

impl FakeMachine {
    /// A device that started its firmware, or lost its cable, is no longer in update mode.
    fn see_it_leave(&mut self) {
        if self.chip.borrow().left || self.chip.borrow().transfers_left == 0 {
            self.in_dfu.retain(|serial| Some(serial) != self.opened.as_ref());
        }
    }
}

impl Machine for FakeMachine {
    type Io = MockIo;

    fn running(&mut self) -> Result<Option<Running>, UpdateError> {
        Ok(self.running.clone().map(|hello| Running { name: "/dev/ttyACM0".into(), hello }))
    }

    fn enter_dfu(&mut self) -> Result<(), UpdateError> {
        self.entering = self.appears_after;
        Ok(())
    }

    fn in_dfu(&mut self) -> Result<Vec<DfuDevice>, UpdateError> {
        if let Some(looks) = &mut self.entering {
            *looks -= 1;
            if *looks == 0 {
                self.entering = None;
                self.in_dfu.extend(self.running.take().map(|hello| hello.serial.to_string()));
            }
        }
        self.see_it_leave();
        Ok(self.in_dfu.iter().map(|serial| dfu_device(serial)).collect())
    }

    fn open(&mut self, device: &DfuDevice) -> Result<MockIo, UpdateError> {
        if self.forbidden > 0 {
            self.forbidden -= 1;
            return Err(UpdateError::Permission { serial: device.serial.clone() });
        }
        if self.occupied > 0 {
            self.occupied -= 1;
            return Err(UpdateError::Open { serial: device.serial.clone(), reason: "busy".into() });
        }
        assert!(self.in_dfu.contains(&device.serial));
        self.opened = Some(device.serial.clone());
        Ok(MockIo::new(&self.chip, LAYOUT))
    }

    fn hello(&mut self, serial: &str) -> Result<Running, UpdateError> {
        self.see_it_leave();
        self.answers_after -= 1;
        if self.answers_after > 0 || !self.chip.borrow().left {
            return Err(DeviceError::Silent { name: "/dev/ttyACM1".into(), seconds: 3.0 }.into());
        }
        // The identity comes from the flash.
        let chip = self.chip.borrow();
        let flash = chip.bytes(0x0800_0000, 1000);
        let place = flash.windows(MAGIC.len()).position(|window| window == MAGIC).unwrap() + MAGIC.len();
        let firmware = flash.get(place..).unwrap().split(|byte| *byte == 0).next().unwrap();
        let hello = hello(serial, std::str::from_utf8(firmware).unwrap());
        Ok(Running { name: "/dev/ttyACM1".into(), hello })
    }

    fn sleep(&mut self, time: Duration) {
        self.slept += time;
        self.chip.borrow_mut().clock += time;
    }

    fn check_interrupted(&self) -> Result<(), UpdateError> {
        if self.slept < self.interrupted_at { Ok(()) } else { Err(DeviceError::Interrupted.into()) }
    }
}

fn run(bench: &mut FakeMachine, serial: Option<&str>) -> Result<Running, UpdateError> {
    run_told(bench, serial, &mut Vec::new())
}

fn run_told(bench: &mut FakeMachine, serial: Option<&str>, told: &mut Vec<String>) -> Result<Running, UpdateError> {
    let mut tell = |event: UpdateEvent| {
        match event {
            UpdateEvent::Pages(..) => {}
            UpdateEvent::Found(running) => told.push(format!("found {}", running.hello.firmware)),
            UpdateEvent::InDfu(device) => told.push(format!("in dfu {}", device.serial)),
            other => told.push(format!("{other:?}").to_lowercase()),
        }
        Going::On
    };
    update(bench, &sample(9000, NEW), serial, false, &mut tell)
}

fn failure(bench: &mut FakeMachine, serial: Option<&str>) -> UpdateError {
    match run(bench, serial) {
        Err(error) => error,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_running_device_is_updated_and_says_so_under_its_new_port() {
    let mut bench = running(&["0000"]);
    let mut told = Vec::new();
    let back = run_told(&mut bench, None, &mut told).unwrap();
    assert_eq!((back.hello.firmware.as_str(), back.name.as_str()), (NEW, "/dev/ttyACM1"));
    assert_eq!(told, ["found inerter 0.0.9", "entering", &format!("in dfu {SERIAL}"), "returning"]);
    assert_eq!(bench.in_dfu, ["0000"], "the other one is left alone");
}

#[test]
fn a_visit_to_update_mode_writes_nothing_and_comes_back() {
    let mut bench = before_visit();
    let flash = bench.chip.borrow().flash.clone();
    let back = visit(&mut bench, &hello(SERIAL, NEW), true).unwrap();
    assert_eq!((back.hello.serial.as_str(), back.hello.firmware.as_str()), (SERIAL, NEW));
    assert!(bench.chip.borrow().left && bench.chip.borrow().erased.is_empty());
    assert!(bench.chip.borrow().flash == flash);
    // By hand: the program does not send it there.
    bench.appears_after = None;
    let never = visit(&mut bench, &hello("1", NEW), false);
    assert!(matches!(never, Err(UpdateError::DidNotAppear { .. })), "{never:?}");
}

/// A bench for a visit, whose device runs the firmware in its flash.
fn before_visit() -> FakeMachine {
    let mut bench = running(&[]);
    run(&mut bench, None).unwrap();
    bench.chip.borrow_mut().restart();
    bench.in_dfu.clear();
    (bench.running, bench.answers_after, bench.forbidden) = (Some(hello(SERIAL, NEW)), 4, 2);
    bench
}

#[test]
fn an_interrupted_visit_leads_the_device_back() {
    let mut bench = before_visit();
    bench.interrupted_at = Duration::ZERO;
    let visited = visit(&mut bench, &hello(SERIAL, NEW), true);
    assert!(matches!(visited, Err(UpdateError::Device(DeviceError::Interrupted))), "{visited:?}");
    assert!(bench.chip.borrow().left);
    // Until somebody puts it into update mode by hand there is nothing to bring back.
    let mut bench = before_visit();
    (bench.interrupted_at, bench.appears_after) = (bench.slept, None);
    let visited = visit(&mut bench, &hello(SERIAL, NEW), false);
    assert!(matches!(visited, Err(UpdateError::Device(DeviceError::Interrupted))), "{visited:?}");
    assert!(!bench.chip.borrow().left);
}

#[test]
fn a_device_that_stays_in_update_mode_after_a_visit_is_told_of() {
    // Another program holds it for a moment.
    let mut bench = before_visit();
    bench.occupied = 2;
    visit(&mut bench, &hello(SERIAL, NEW), true).unwrap();
    assert!(bench.chip.borrow().left);
    let failing: [fn(&mut FakeMachine); 4] = [
        |bench| bench.occupied = u32::MAX,
        |bench| bench.forbidden = u32::MAX,
        |bench| bench.appears_after = None,
        |bench| bench.chip.borrow_mut().transfers_left = 1,
    ];
    for fail in failing {
        let mut bench = before_visit();
        bench.answers_after = u32::MAX;
        fail(&mut bench);
        let error = visit(&mut bench, &hello(SERIAL, NEW), true).unwrap_err();
        assert!(matches!(error, UpdateError::StaysInDfu { .. }), "{error:?}");
        let help = miette::Diagnostic::help(&error).unwrap().to_string();
        assert!(help.contains("press the board's reset button once"), "{help}");
        assert!(!error.to_string().contains("is written"), "{error}");
    }
}

#[test]
fn a_device_in_update_mode_needs_no_first_step() {
    let mut bench = bench(None, &[SERIAL]);
    let mut told = Vec::new();
    run_told(&mut bench, None, &mut told).unwrap();
    assert_eq!(told, [&format!("in dfu {SERIAL}"), "returning"]);
}

#[test]
fn one_of_several_in_update_mode_is_chosen_by_its_serial_number() {
    let error = failure(&mut bench(None, &["1", "2"]), None);
    assert_eq!(error.to_string(), "several devices are in update mode: serial 1, 2");
    let error = failure(&mut bench(None, &["1", "2"]), Some("3"));
    assert!(error.to_string().starts_with("no instrumented inerter was found with serial 3"), "{error}");
    let back = run(&mut bench(None, &["1", "2"]), Some("2")).unwrap();
    assert_eq!(back.hello.serial.as_str(), "2");
    assert!(matches!(failure(&mut bench(None, &[]), None), UpdateError::NoDevice { serial: None }));
}

#[test]
fn a_device_that_does_not_appear_in_update_mode_is_told_apart_from_others_that_do() {
    let mut bench = running(&["0000"]);
    bench.appears_after = None;
    let error = failure(&mut bench, None);
    let words =
        format!("the device (serial {SERIAL}) did not appear in update mode within 15 s; another one did: serial 0000");
    assert_eq!(error.to_string(), words);
    assert_eq!(bench.slept, Duration::from_secs(15));
    assert!(bench.chip.borrow().erased.is_empty());
}

#[test]
fn an_image_of_another_board_and_firmware_without_dfu_are_refused_before_anything_happens() {
    let mut other = hello(SERIAL, OLD);
    other.board = Hello::text("weact-g474");
    let mut first = bench(Some(other.clone()), &[]);
    let words = "the image is for the board nucleo-g474re, the device is a weact-g474";
    assert_eq!(failure(&mut first, None).to_string(), words);
    assert!(first.entering.is_none());
    let forced = update(&mut bench(Some(other), &[]), &sample(9000, NEW), None, true, &mut |_| Going::On);
    assert!(forced.is_ok());

    let mut without = hello(SERIAL, "inerter-virtual 0.1.0");
    without.capabilities = Capabilities::REBOOT;
    let error = failure(&mut bench(Some(without), &[]), None);
    assert!(matches!(error, UpdateError::CannotEnter { .. }), "{error}");
}

#[test]
fn a_chip_that_says_it_has_less_flash_is_left_alone() {
    let mut small = hello(SERIAL, OLD);
    small.capabilities = small.capabilities.with_flash_kb(128);
    let mut bench = bench(Some(small.clone()), &[]);
    let error = failure(&mut bench, None);
    assert!(error.to_string().contains("the chip has 128 KB of flash"), "{error}");
    assert!(bench.entering.is_none() && bench.chip.borrow().erased.is_empty());
    // One with enough flash, and older firmware that does not report it.
    for capabilities in [small.capabilities.with_flash_kb(512), hello(SERIAL, OLD).capabilities] {
        let mut bench = self::bench(Some(inerter_wire::Hello { capabilities, ..small.clone() }), &[]);
        run(&mut bench, None).unwrap();
    }
}

#[test]
fn what_runs_afterwards_is_compared_with_what_was_written() {
    let mut silent = bench(None, &[SERIAL]);
    silent.answers_after = 1000;
    let error = failure(&mut silent, None);
    assert!(error.to_string().contains("did not come back within 15 s: /dev/ttyACM1 does not answer"), "{error}");
    let mut bench = bench(None, &[SERIAL]);
    run(&mut bench, None).unwrap();
    let other = Identity { firmware: "inerter 0.2.0".into(), git: "1".into(), board: "b".into() };
    bench.answers_after = 1;
    let error = confirm(&mut bench, &other, SERIAL).unwrap_err();
    assert!(matches!(error, UpdateError::OtherVersion { .. }), "{error}");
}

#[test]
fn an_update_whose_cable_was_pulled_is_completed_by_the_same_command() {
    let mut bench = running(&[]);
    bench.chip.borrow_mut().transfers_left = 60;
    assert!(matches!(failure(&mut bench, None), UpdateError::Lost { .. }));
    bench.chip.borrow_mut().restart();
    assert_eq!(run(&mut bench, None).unwrap().hello.firmware, NEW);
}

#[test]
fn a_device_that_may_not_be_opened_is_untouched_and_the_user_told_how_to_allow_it() {
    let mut bench = bench(None, &[SERIAL]);
    bench.forbidden = 100;
    let error = failure(&mut bench, None);
    assert_eq!(
        error.to_string(),
        format!("the device in update mode (serial {SERIAL}) cannot be opened: permission denied")
    );
    assert_eq!(bench.slept, Duration::from_secs(2));
    let help = miette::Diagnostic::help(&error).unwrap().to_string();
    assert!(!cfg!(target_os = "linux") || help.contains("/etc/udev/rules.d/70-inerter.rules"), "{help}");
}

#[test]
fn ctrl_c_ends_every_wait_of_an_update_and_leaves_no_whole_firmware_in_update_mode() {
    type HoldUp = fn(&mut FakeMachine);
    let told = Duration::from_secs(2);
    let waits: [(&str, HoldUp); 4] = [
        ("for update mode", |bench| bench.appears_after = Some(u32::MAX)),
        ("to be let in", |bench| bench.forbidden = u32::MAX),
        ("for the ROM", |bench| bench.chip.borrow_mut().hangs = true),
        ("for the firmware", |bench| bench.answers_after = u32::MAX),
    ];
    for (what, hold_up) in waits {
        let mut bench = running(&[]);
        hold_up(&mut bench);
        bench.interrupted_at = told;
        let error = failure(&mut bench, None);
        // If it stays there after all, the error says so; the time that every command has to end is respected.
        let interrupted = matches!(error, UpdateError::Interrupted | UpdateError::Device(DeviceError::Interrupted));
        let is_told = interrupted || matches!(error, UpdateError::StaysInDfu { .. });
        assert!(is_told && bench.slept < told + Duration::from_secs(4), "{what}: {error:?}, {:?}", bench.slept);
    }
    // Nothing delays it: interrupted while it enters update mode, and before the first page is erased.
    for interrupted_at in [0, 250, 750, 1250] {
        let mut bench = before_visit();
        let (flash, sofar) = (bench.chip.borrow().flash.clone(), bench.slept);
        bench.interrupted_at = sofar + Duration::from_millis(interrupted_at);
        let error = failure(&mut bench, None);
        assert!(matches!(error, UpdateError::Device(DeviceError::Interrupted)), "{interrupted_at}: {error:?}");
        assert!(bench.chip.borrow().left && bench.chip.borrow().flash == flash, "{interrupted_at}");
    }
}

/// The running firmware may not know how much flash its chip has.
#[test]
fn a_chip_that_turns_out_to_be_another_is_led_back() {
    let mut bench = before_visit();
    bench.chip.borrow_mut().told = Some((128, 0));
    let error = failure(&mut bench, None);
    assert!(matches!(error, UpdateError::SmallFlash { kb: 128 }), "{error:?}");
    assert!(bench.chip.borrow().left && bench.chip.borrow().erased.is_empty());
}
