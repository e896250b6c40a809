//! The shipping binary on its board, without USB: start, restart, power, flash, watchdog, processor.
//!
//! The host uses the serial link. Images come from `cargo xtask build-firmware` or from the environment:
//! `INERTER_STM32_ELF`, `INERTER_STM32_HANG_ELF` for the image whose task hangs, `INERTER_STM32_WEACT_ELF` for the
//! image of the other board.

use crate::common::{carried_by, causes, enters_update_mode, last_reset, press, run};
use inerter_core::{Settings, Status};
use inerter_plant::Excitation;
use inerter_twin::{
    Board, Width,
    bench::{APERTURE_S, Bench, Rig},
    chip::adc::{Broken, Unit},
    chip::flash::{Contents, Torn},
    chip::rcc::Reset,
    chip::rom::Left,
    cpu::{Faults, SRAM_CUTS, Stop},
    cycles::timing::halves,
    elf::Elf,
    machine::{Machine, Options, Usage, image, shipping_image},
    serial_link::{SerialError, SerialLink},
    world::{Still, World},
};
use inerter_wire::{
    ClockSource, Command, Event, EventKind, Fault, Health, Hello, Record, ResetCause, SettingsValues, Streams,
};
use std::collections::BTreeSet;
use unicorn_engine::RegisterARM;

/// From power-on until the firmware answers.
const START_S: f64 = 0.1;
/// Time limit for a reply.
const REPLY_S: f64 = 0.5;
/// Time limit for a reply after erasing pages.
const SAVE_S: f64 = 2.0;

fn machine(options: Options, world: impl World + 'static) -> Option<Machine> {
    Some(Machine::with(&shipping_image()?, options, world).expect("the image"))
}

/// The board after its first start, in which it sets the brown-out level and restarts.
fn board_with(options: Options, world: impl World + 'static) -> Option<SerialLink> {
    let mut machine = machine(options, world)?;
    run(&mut machine, START_S);
    Some(SerialLink::new(machine))
}

fn board(world: impl World + 'static) -> Option<SerialLink> {
    board_with(Options::default(), world)
}

/// A board at rest that has answered Hello.
fn greeted() -> Option<SerialLink> {
    let mut link = board(Still)?;
    greet(&mut link);
    Some(link)
}

fn done(link: &mut SerialLink, command: Command, within_s: f64) {
    link.order(command, within_s).unwrap_or_else(|error| panic!("{error}"));
}

fn listen(link: &mut SerialLink, length_s: f64) {
    link.listen_until(link.machine.time_s() + length_s).unwrap_or_else(|ended| panic!("{ended}"));
}

/// Listens until a record matches, and drops the records before it.
fn wait_for<T>(link: &mut SerialLink, limit_s: f64, mut wanted: impl FnMut(Record) -> Option<T>) -> T {
    let end_s = link.machine.time_s() + limit_s;
    loop {
        if let Some(found) = link.talk.records().into_iter().find_map(&mut wanted) {
            return found;
        }
        assert!(link.machine.time_s() < end_s, "it did not come within {limit_s} s");
        listen(link, 1e-3);
    }
}

/// Sends Hello, and returns the device's description and the events of its start.
fn greet(link: &mut SerialLink) -> (Hello, Vec<EventKind>) {
    done(link, Command::Hello, REPLY_S);
    listen(link, 0.05);
    let records = link.talk.records();
    let hello = records.iter().find_map(carried_by!(Record::Hello));
    let hello = hello.unwrap_or_else(|| panic!("no Hello among {records:?}")).clone();
    (hello, events(records).collect())
}

fn events(records: Vec<Record>) -> impl Iterator<Item = EventKind> {
    records.into_iter().filter_map(carried_by!(Record::Event)).map(|event: Event| event.kind)
}

/// After a restart: the host starts anew too, and returns the events of the start.
fn greet_anew(link: &mut SerialLink) -> Vec<EventKind> {
    link.talk = Default::default();
    greet(link).1
}

/// The message of the reported panic.
fn panicked(events: &[EventKind]) -> Option<&str> {
    events.iter().find_map(carried_by!(EventKind::Panicked)).map(|text| text.as_str())
}

fn cause(events: &[EventKind]) -> ResetCause {
    let causes: Vec<_> = events.iter().filter_map(carried_by!(EventKind::ResetBy)).collect();
    assert_eq!(causes.len(), 1, "{events:?}");
    *causes[0]
}

fn settings(link: &mut SerialLink) -> Settings {
    done(link, Command::ReadSettings, REPLY_S);
    let values = link.talk.records().into_iter().find_map(carried_by!(Record::Settings));
    let reading = values.expect("settings").read(&Settings::default());
    assert_eq!((reading.unknown, reading.impossible, reading.missing), (0, 0, 0));
    reading.settings
}

/// The saved settings, which may differ from those in use.
fn saved(link: &mut SerialLink) -> Settings {
    done(link, Command::ReadSaved, REPLY_S);
    let values = link.talk.records().into_iter().find_map(carried_by!(Record::Saved));
    values.expect("what is saved").read(&Settings::default()).settings
}

fn health(link: &mut SerialLink) -> Health {
    done(link, Command::Streams(Streams { health: true, ..Streams::NONE }), REPLY_S);
    wait_for(link, 3.0, carried_by!(Record::Health))
}

/// A rig whose motion excites all parameters.
fn moving() -> Rig {
    Rig::new(Excitation::random(0.5, 15.0, 0.02, 3), 0.0)
}

#[test]
fn from_power_to_the_first_estimate() {
    let rig = moving();
    let wanted = rig.settings(1000.0);
    let Some(mut link) = board(Bench::new(rig).expect("a rig that can be")) else { return };
    assert_eq!(link.machine.chip().clocks.hclk_hz, 168e6);
    assert_eq!(link.machine.serial_take(), [0_u8; 0], "nobody has asked for anything");
    let (hello, events) = greet(&mut link);
    assert_eq!((hello.clock, hello.sample_rate_hz), (ClockSource::Crystal, 1000.0));
    assert_eq!(events.first(), Some(&EventKind::Started));
    assert_eq!(cause(&events), ResetCause::OptionBytes, "the first start of a new chip ends in one more");
    assert_eq!(link.machine.chip().flash.brown_out_level(), 4);
    done(&mut link, Command::WriteSettings(SettingsValues::from(&wanted)), REPLY_S);
    done(&mut link, Command::Streams(Streams { estimates: true, ..Streams::NONE }), REPLY_S);
    let start_s = link.machine.time_s();
    let estimate = wait_for(&mut link, 10.0, |record| match record {
        Record::Estimate(estimate) if estimate.recent.inertance_kg.status() == Status::Ok => Some(estimate),
        _ => None,
    });
    let after_s = link.machine.time_s() - start_s;
    assert!((0.1..3.0).contains(&after_s), "the first estimate came after {after_s} s");
    let inertance_kg = f64::from(estimate.recent.inertance_kg.fitted().value);
    assert!((inertance_kg / 299.4906 - 1.0).abs() < 0.02, "{inertance_kg} kg");
    assert_eq!(link.talk.lost, 0);
    assert_eq!(link.machine.chip_mut().unwritten_reads(), Vec::<String>::new());
    // Once set, the option bytes are not written again.
    link.machine.power_cut().expect("starts");
    run(&mut link.machine, 0.2);
    assert_eq!(causes(&link.machine), [Reset::Power, Reset::OptionBytes, Reset::Power]);
    let (_, events) = greet(&mut link);
    assert_eq!(cause(&events), ResetCause::PowerOn);
}

#[test]
fn the_first_write_to_each_memory_may_be_lost() {
    let Some(mut link) = greeted() else { return };
    done(&mut link, Command::Reboot, REPLY_S);
    run(&mut link.machine, 0.3);
    assert_eq!(link.machine.resets.len(), 3);
    let core = link.machine.cpu.core();
    // No lost write matters: the first location is written again later, and the other writes repeat what the memory
    // already contains.
    assert_eq!(core.first_writes, SRAM_CUTS.repeat(3));
    assert!(core.lost_writes.iter().all(|place| *place == SRAM_CUTS[0]), "{:x?}", core.lost_writes);
}

#[test]
fn the_default_skew_is_what_the_board_takes() {
    let Some(mut link) = greeted() else { return };
    // The encoder's filter: 6 samples at 84 MHz, 5 clocks of 168 MHz, less 8 until the fetch
    // (firmware/stm32g474/src/defaults.rs).
    let filter_s = 6.0 / 84e6 + (5.0 - 8.0) / 168e6;
    let off_s = settings(&mut link).skew_s + APERTURE_S + filter_s;
    assert!(off_s.abs() < 1e-9, "{off_s} s");
}

#[test]
fn the_same_run_twice_is_the_same_to_the_bit() {
    let record = || {
        let mut link = board(Bench::new(moving()).expect("a rig that can be"))?;
        done(&mut link, Command::Hello, REPLY_S);
        done(&mut link, Command::Streams(Streams::ALL), REPLY_S);
        listen(&mut link, 0.5);
        Some((link.talk.records(), link.machine.usage().instructions, link.machine.usage().slept))
    };
    let Some(first) = record() else { return };
    assert!(first.0.len() > 15, "{} records", first.0.len());
    assert_eq!(Some(first), record());
}

#[test]
fn a_board_without_its_crystal_says_so() {
    let board = Board { hse_hz: 0.0, ..Board::NUCLEO };
    let Some(mut machine) = machine(Options { board, ..Options::default() }, Still) else { return };
    run(&mut machine, 0.5);
    assert_eq!(machine.chip().clocks.hclk_hz, 168e6);
    let (hello, _) = greet(&mut SerialLink::new(machine));
    assert_eq!(hello.clock, ClockSource::Internal);
}

fn break_crystal(machine: &mut Machine) {
    let now = machine.now();
    machine.chip_mut().break_crystal(now);
}

#[test]
fn a_crystal_that_breaks_is_a_restart_without_it() {
    let Some(mut link) = board(Still) else { return };
    assert_eq!(greet(&mut link).0.clock, ClockSource::Crystal);
    break_crystal(&mut link.machine);
    run(&mut link.machine, 0.5);
    let (hello, events) = greet(&mut link);
    assert_eq!((hello.clock, cause(&events)), (ClockSource::Internal, ResetCause::Panic));
    assert!(panicked(&events).is_some_and(|text| text.ends_with("the crystal has stopped")), "{events:?}");
}

#[test]
fn the_crystal_may_break_at_any_moment_of_the_start() {
    let mut restarts = BTreeSet::new();
    // The firmware sets up memory in the first milliseconds, and the crystal needs two more.
    for moment_us in (4_000..14_000).step_by(200) {
        let Some(mut link) = board(Still) else { return };
        press(&mut link.machine, f64::from(moment_us) * 1e-6);
        break_crystal(&mut link.machine);
        run(&mut link.machine, 0.3);
        let hello = greet(&mut link).0;
        assert_eq!(hello.clock, ClockSource::Internal, "broken {moment_us} us after the reset");
        restarts.insert(link.machine.resets.len() - 3);
    }
    assert_eq!(restarts, BTreeSet::from([0, 1]), "before it was ready, and after");
    // The crystal fails after it was seen ready and before it is monitored. The firmware then waits for it until the
    // watchdog resets the chip.
    let Some(mut link) = board(Still) else { return };
    link.machine.reset().expect("starts");
    const READY: u32 = 1 << 17;
    let is_ready = |machine: &mut Machine| {
        let now = machine.now();
        machine.chip_mut().read(0x4002_1000, Width::Word, now).expect("RCC_CR") & READY != 0
    };
    assert!(link.machine.run_until_that(0.02, 1e-7, is_ready).expect("runs"));
    break_crystal(&mut link.machine);
    run(&mut link.machine, 1.0);
    let (hello, events) = greet(&mut link);
    assert_eq!((hello.clock, cause(&events)), (ClockSource::Internal, ResetCause::Watchdog));
}

#[test]
fn a_flash_that_stays_busy_keeps_no_board_from_starting() {
    // At its first start the board writes its option bytes.
    let Some(mut machine) = machine(Options::default(), Still) else { return };
    machine.chip_mut().flash.hangs = true;
    run(&mut machine, 0.5);
    assert_eq!(machine.resets.len(), 1, "{:?}", machine.resets);
    greet(&mut SerialLink::new(machine));
}

#[test]
fn a_converter_that_does_not_start_is_told() {
    for unit in [Unit::One, Unit::Two, Unit::Five] {
        for at in [Broken::Calibration, Broken::Ready] {
            let Some(mut machine) = machine(Options::default(), Still) else { return };
            machine.chip_mut().adc.broken = Some((unit, at));
            run(&mut machine, 0.5);
            assert_eq!(machine.resets.len(), 2, "{unit:?}, {at:?}: {:?}", machine.resets);
            let mut link = SerialLink::new(machine);
            let (_, mut told) = greet(&mut link);
            let health = health(&mut link);
            told.extend(events(link.talk.records()));
            let of_samples = unit != Unit::Five;
            let unreadable = told.contains(&EventKind::Fault(Fault::SourceUnreadable));
            assert_eq!(
                (unreadable, health.temperature_c.is_none()),
                (of_samples, !of_samples),
                "{unit:?}, {at:?}: {told:?}"
            );
        }
    }
}

#[test]
fn the_image_of_one_board_is_stopped_or_mute_on_the_other() {
    let Some(mut machine) = machine(Options { board: Board::WEACT, ..Options::default() }, Still) else { return };
    match machine.run_for(0.2) {
        // The other crystal gives another clock, so the host cannot decode what the board sends.
        Ok(()) => {
            assert_ne!(machine.chip().clocks.hclk_hz, 168e6);
            let answer = SerialLink::new(machine).request(Command::Hello, REPLY_S);
            assert!(answer.is_err(), "{answer:?}");
        }
        Err(ended) => assert!(matches!(ended.stop, Stop::Bus(_)), "{ended}"),
    }
}

#[test]
fn the_other_boards_image_runs_on_its_board() {
    let Some(image) = image("INERTER_STM32_WEACT_ELF", "release/inerter-stm32g474-weact") else { return };
    let options = Options { board: Board::WEACT, ..Options::default() };
    let mut machine = Machine::with(&image, options, Still).expect("the image");
    run(&mut machine, START_S);
    assert_eq!(machine.chip().clocks.hclk_hz, 168e6);
    let (hello, _) = greet(&mut SerialLink::new(machine));
    assert_eq!((hello.clock, hello.board.as_str()), (ClockSource::Crystal, "weact-g474"));
}

#[test]
fn a_command_restarts() {
    let Some(mut link) = greeted() else { return };
    done(&mut link, Command::Reboot, REPLY_S);
    run(&mut link.machine, 0.3);
    assert_eq!(last_reset(&link.machine), Reset::Software);
    let (_, events) = greet(&mut link);
    assert_eq!(cause(&events), ResetCause::Software);
}

#[test]
fn a_command_leads_into_the_roms_update_mode() {
    let Some(mut link) = greeted() else { return };
    done(&mut link, Command::EnterDfu, REPLY_S);
    // It may get there within the same millisecond.
    enters_update_mode(&mut link.machine, 1.0);
    // Press the button.
    press(&mut link.machine, 0.2);
    greet(&mut link);
}

#[test]
fn the_roms_update_mode_starts_new_firmware_by_a_jump() {
    for left in Left::ALL {
        let Some(mut link) = greeted() else { return };
        done(&mut link, Command::EnterDfu, REPLY_S);
        enters_update_mode(&mut link.machine, 1.0);
        link.machine.leave_rom(left).expect("jumps");
        link.machine.run_for(0.3).unwrap_or_else(|ended| panic!("{left:?}: {ended}"));
        let events = greet_anew(&mut link);
        assert_eq!(panicked(&events), None, "{left:?}: {events:?}");
        let health = health(&mut link);
        assert!(health.index > 100, "{left:?}: {} samples", health.index);
    }
}

#[test]
fn a_reset_that_leaves_the_rom_at_address_0_is_tried_once() {
    for left in Left::ALL {
        let Some(mut link) = board(Still) else { return };
        link.machine.chip_mut().syscfg.keeps_mem_mode = true;
        greet(&mut link);
        done(&mut link, Command::EnterDfu, REPLY_S);
        enters_update_mode(&mut link.machine, 1.0);
        let resets = link.machine.resets.len();
        link.machine.leave_rom(left).expect("jumps");
        run(&mut link.machine, 0.3);
        let tried = link.machine.resets.len() - resets;
        // These two look like a reset already, so there is nothing to try.
        let expected = usize::from(!matches!(left, Left::Restored | Left::Masked));
        assert_eq!(tried, expected, "{left:?}");
        let events = greet_anew(&mut link);
        assert_eq!(panicked(&events), None, "{left:?}: {events:?}");
    }
}

/// Makes the core execute these instructions, in empty flash.
fn execute(machine: &mut Machine, code: &[u16]) {
    const PLACE: u32 = 0x0803_f000;
    let code: Vec<u8> = code.iter().flat_map(|half| half.to_le_bytes()).collect();
    assert!(machine.chip_mut().flash.load(PLACE, &code));
    machine.cpu.set(RegisterARM::PC, PLACE | 1).expect("a register");
}

#[test]
fn a_stack_that_grows_into_its_guard_is_a_fault_with_a_message() {
    let Some(mut link) = board_with(Options { faults: Faults::Taken, ..Options::default() }, Still) else { return };
    greet(&mut link);
    // push {r0} in an endless loop.
    execute(&mut link.machine, &[0xb401, 0xe7fd]);
    run(&mut link.machine, 0.3);
    let (_, events) = greet(&mut link);
    let text = panicked(&events).expect("the message");
    assert!(text.starts_with("hard fault at ") && text.contains("CFSR 00000082"), "{text}");
}

#[test]
fn two_presses_of_the_button_lead_into_update_mode_and_slow_ones_do_not() {
    let Some(mut link) = board(Still) else { return };
    for pause_s in [1.0, 0.7] {
        press(&mut link.machine, pause_s);
    }
    let (_, events) = greet(&mut link);
    assert_eq!(cause(&events), ResetCause::Pin);
    press(&mut link.machine, 0.3);
    link.machine.reset().expect("starts");
    enters_update_mode(&mut link.machine, 1.0);
    // A third press leads back to the firmware.
    press(&mut link.machine, 0.3);
    greet(&mut link);
}

#[test]
fn power_that_comes_back_at_once_is_no_press_of_the_button() {
    let Some(mut link) = board(Still) else { return };
    for _ in 0..5 {
        link.machine.power_cut().expect("starts");
        run(&mut link.machine, 0.1);
    }
    greet(&mut link);
}

/// Writes a register of the core, which a probe can write as well as the program.
fn write_core(machine: &mut Machine, register: u32, value: u32) {
    machine.cpu.core_mut().nvic.write(register, value, Width::Word, 0).expect("a register");
}

/// Raises an interrupt without a handler: number 0, enabled and pending as if a bit had flipped.
fn disturb(machine: &mut Machine) {
    for register in [0xe000_e100, 0xe000_e200] {
        write_core(machine, register, 1);
    }
}

/// The same, and what follows.
fn crash(machine: &mut Machine, then_s: f64) {
    disturb(machine);
    run(machine, then_s);
}

#[test]
fn a_firmware_that_cannot_start_leaves_the_settings_alone_and_then_wants_another() {
    let Some(mut link) = greeted() else { return };
    let defaults = settings(&mut link);
    keep(&mut link, &numbered(1));
    let kept = link.machine.chip().flash.contents();
    // A run of more than ten seconds after two failures clears the count.
    for failures in [2, 2, 3] {
        for _ in 0..failures {
            crash(&mut link.machine, 0.2);
        }
        let events = greet_anew(&mut link);
        let ignored = failures == 3;
        let faults = events.iter().filter(|event| matches!(event, EventKind::Fault(_)));
        let expected = ignored.then_some(&EventKind::Fault(Fault::SettingsLeft));
        assert_eq!(faults.collect::<Vec<_>>(), expected.into_iter().collect::<Vec<_>>(), "{events:?}");
        assert_eq!(settings(&mut link), if ignored { defaults } else { numbered(1) });
        assert_eq!(saved(&mut link), numbered(1), "kept for a look");
        run(&mut link.machine, if ignored { 0.0 } else { 11.0 });
    }
    assert_eq!(link.machine.chip().flash.contents(), kept);
    for _ in 0..2 {
        crash(&mut link.machine, 0.2);
    }
    disturb(&mut link.machine);
    enters_update_mode(&mut link.machine, 0.2);
    // The button leads back to the firmware, which uses the settings again.
    press(&mut link.machine, 0.3);
    greet_anew(&mut link);
    assert_eq!(settings(&mut link), numbered(1));
}

#[test]
fn starts_that_the_watchdog_ends_have_failed() {
    /// CPSID i; 1: WFE; B 1b.
    const HANG: [u16; 3] = [0xb672, 0xbf20, 0xe7fd];
    let Some(mut link) = greeted() else { return };
    keep(&mut link, &numbered(1));
    for bites in 1..6 {
        execute(&mut link.machine, &HANG);
        run(&mut link.machine, 5.0);
        assert_eq!(link.machine.resets.iter().filter(|reset| reset.1 == Reset::Watchdog).count(), bites);
        let events = greet_anew(&mut link);
        assert_eq!(cause(&events), ResetCause::Watchdog);
        let left = bites >= 3;
        assert_eq!(events.contains(&EventKind::Fault(Fault::SettingsLeft)), left, "{bites}: {events:?}");
        assert_eq!(settings(&mut link) == numbered(1), !left);
    }
    execute(&mut link.machine, &HANG);
    enters_update_mode(&mut link.machine, 5.0);
}

#[test]
fn resets_by_a_probe_are_no_failed_starts() {
    let Some(mut link) = greeted() else { return };
    keep(&mut link, &numbered(1));
    for _ in 0..8 {
        // AIRCR.SYSRESETREQ.
        write_core(&mut link.machine, 0xe000_ed0c, 0x05fa_0004);
        run(&mut link.machine, 0.2);
    }
    assert_eq!(link.machine.resets.iter().filter(|reset| reset.1 == Reset::Software).count(), 8);
    let events = greet_anew(&mut link);
    assert!(!events.iter().any(|event| matches!(event, EventKind::Fault(_))), "{events:?}");
    assert_eq!(settings(&mut link), numbered(1));
}

#[test]
fn a_run_of_ten_seconds_has_not_failed_at_its_start() {
    for (length_s, fails) in [(9.8, true), (10.2, false)] {
        let Some(mut link) = board(Still) else { return };
        for _ in 0..2 {
            crash(&mut link.machine, 0.2);
        }
        run(&mut link.machine, length_s - 0.2);
        crash(&mut link.machine, 0.2);
        let (_, events) = greet(&mut link);
        assert_eq!(events.contains(&EventKind::Fault(Fault::SettingsLeft)), fails, "{length_s} s: {events:?}");
    }
}

#[test]
fn two_presses_lead_out_of_an_endless_row_of_restarts() {
    let Some(mut link) = board(Still) else { return };
    run(&mut link.machine, 1.0);
    press(&mut link.machine, 0.1);
    crash(&mut link.machine, 0.1);
    assert_eq!(last_reset(&link.machine), Reset::Software);
    link.machine.reset().expect("starts");
    enters_update_mode(&mut link.machine, 0.2);
}

#[test]
fn a_panic_restarts_and_the_next_host_reads_it() {
    let Some(mut link) = greeted() else { return };
    crash(&mut link.machine, 0.3);
    assert_eq!(last_reset(&link.machine), Reset::Software);
    let (_, events) = greet(&mut link);
    assert_eq!(cause(&events), ResetCause::Panic);
    let text = panicked(&events).expect("the message");
    assert!(text.contains("panic.rs") && text.ends_with("interrupt 0 has no handler"), "{text}");
    // The panic is reported once.
    press(&mut link.machine, 1.0);
    let (_, events) = greet(&mut link);
    assert_eq!(cause(&events), ResetCause::Pin);
    assert_eq!(panicked(&events), None, "{events:?}");
}

#[test]
fn a_fault_restarts_and_the_next_host_reads_where_it_was() {
    let Some(mut link) = board_with(Options { faults: Faults::Taken, ..Options::default() }, Still) else { return };
    greet(&mut link);
    // The program counter jumps to an address without memory.
    link.machine.cpu.set(RegisterARM::PC, 0x0900_0001).expect("a register");
    run(&mut link.machine, 0.3);
    let (_, events) = greet(&mut link);
    assert_eq!(cause(&events), ResetCause::Panic);
    let text = panicked(&events).expect("the message");
    assert!(text.starts_with("hard fault at 09000000"), "{text}");
}

#[test]
fn the_watchdog_is_fed_while_all_goes_well() {
    let Some(mut link) = greeted() else { return };
    run(&mut link.machine, 20.0);
    let timeout_s = link.machine.chip().iwdg.timeout_s().expect("it runs");
    assert!((3.9..4.1).contains(&timeout_s), "{timeout_s} s");
    assert_eq!(link.machine.resets.len(), 2, "{:?}", link.machine.resets);
}

#[test]
fn the_watchdog_restarts_a_processor_that_goes_in_circles() {
    let Some(mut link) = greeted() else { return };
    // Let the firmware feed the watchdog once: the timeout is not in effect before that.
    run(&mut link.machine, 1.0);
    let start_s = link.machine.time_s();
    // 254 NOPs and a branch back. Interrupts are masked, as the core was asleep.
    execute(&mut link.machine, &[&[0xbf00_u16; 254][..], &[0xe700]].concat());
    run(&mut link.machine, 4.5);
    let &(time_s, reset) = link.machine.resets.last().expect("power-on");
    assert_eq!(reset, Reset::Watchdog, "{:?}", link.machine.resets);
    assert!((3.3..4.2).contains(&(time_s - start_s)), "after {} s", time_s - start_s);
    let (_, events) = greet(&mut link);
    assert_eq!(cause(&events), ResetCause::Watchdog);
}

#[test]
fn the_watchdog_restarts_a_device_whose_task_hangs() {
    let Some(image) = image("INERTER_STM32_HANG_ELF", "release/inerter-stm32g474-hang") else { return };
    let mut machine = Machine::new(&image, Still).expect("the image");
    // It hangs five seconds after its start, and the watchdog timeout is four seconds.
    run(&mut machine, 12.0);
    let &(time_s, reset) = machine.resets.last().expect("power-on");
    assert_eq!(reset, Reset::Watchdog, "{:?}", machine.resets);
    assert!((8.5..9.7).contains(&time_s), "{time_s} s");
    let (_, events) = greet(&mut SerialLink::new(machine));
    assert_eq!(cause(&events), ResetCause::Watchdog);
}

/// Settings that differ for every number in several fields.
fn numbered(number: u32) -> Settings {
    let number = f64::from(number);
    Settings {
        metres_per_count: 1e-6 * (1.0 + number),
        newtons_per_code: 0.01 * (1.0 + number),
        force_zero_code: 100_000.0 + number,
        structure_mass_kg: number,
        ..Settings::default()
    }
}

fn write(link: &mut SerialLink, settings: &Settings) {
    done(link, Command::WriteSettings(SettingsValues::from(settings)), REPLY_S);
}

fn save(link: &mut SerialLink) -> Result<(), SerialError> {
    link.order(Command::SaveSettings, SAVE_S)
}

/// Writes settings and saves them.
fn keep(link: &mut SerialLink, settings: &Settings) {
    write(link, settings);
    save(link).expect("saved");
}

/// Starts with this content of the flash.
fn start_from(link: &mut SerialLink, contents: &Contents) {
    link.machine.chip_mut().flash.set_contents(contents);
    link.machine.power_cut().expect("starts");
    run(&mut link.machine, START_S);
    link.talk = Default::default();
    done(link, Command::Hello, REPLY_S);
}

#[test]
fn settings_are_kept_without_power_and_forgotten_when_asked() {
    let Some(mut link) = greeted() else { return };
    let defaults = settings(&mut link);
    keep(&mut link, &numbered(1));
    let stalls = link.machine.chip().flash.stalls;
    assert_eq!(stalls, 0, "the core waited for the flash");
    let kept = link.machine.chip().flash.contents();
    start_from(&mut link, &kept);
    assert_eq!(settings(&mut link), numbered(1));
    done(&mut link, Command::FactoryReset, SAVE_S);
    assert_eq!(settings(&mut link), defaults);
    let kept = link.machine.chip().flash.contents();
    start_from(&mut link, &kept);
    assert_eq!(settings(&mut link), defaults);
}

/// Cuts the power at each flash operation of a save, in each of the three ways to leave an operation unfinished.
fn cut_everywhere(link: &mut SerialLink, before: &Contents, old: &Settings, new: &Settings) -> (u32, u32) {
    let (mut cuts, mut kept_old) = (0, 0);
    for operation in 0.. {
        for torn in Torn::ALL {
            start_from(link, before);
            assert_eq!(settings(link), *old);
            write(link, new);
            link.machine.chip_mut().flash.cut_power_after(operation, torn);
            match save(link) {
                Ok(_) => {
                    // All operations have been cut once.
                    link.machine.chip_mut().flash.keep_power();
                    assert_eq!(torn, Torn::Before);
                    return (cuts, kept_old);
                }
                Err(SerialError::Ended(ended)) => assert_eq!(ended.stop, Stop::PowerFailed, "{ended}"),
                Err(error) => panic!("operation {operation}, {torn:?}: {error}"),
            }
            cuts += 1;
            let what = format!("power lost in operation {operation}, {torn:?}");
            link.machine.power_cut().expect("starts");
            link.machine.run_for(START_S).unwrap_or_else(|ended| panic!("{what}: {ended}"));
            let events = greet_anew(link);
            let found = settings(link);
            assert!(found == *old || found == *new, "{what}: {found:?}");
            assert!(!events.iter().any(|event| matches!(event, EventKind::Fault(_))), "{what}: {events:?}");
            kept_old += u32::from(found == *old);
            // The remains do not prevent the next save.
            let next = numbered(77);
            write(link, &next);
            save(link).unwrap_or_else(|error| panic!("{what}, then saved again: {error}"));
            assert_eq!(saved(link), next, "{what}, then saved again");
            // A restart takes long, so it follows only the cut whose remains are the hardest to read.
            if torn == Torn::Between {
                let kept = link.machine.chip().flash.contents();
                start_from(link, &kept);
                assert_eq!(settings(link), next, "{what}, then saved again");
            }
        }
    }
    unreachable!("a save has an end")
}

#[test]
fn power_that_fails_at_any_word_of_a_save_keeps_the_old_or_the_new_settings() {
    let Some(mut link) = greeted() else { return };
    keep(&mut link, &numbered(1));
    let before = link.machine.chip().flash.contents();
    let (cuts, kept_old) = cut_everywhere(&mut link, &before, &numbered(1), &numbered(2));
    assert!((60..400).contains(&cuts), "{cuts} cuts");
    assert!(0 < kept_old && kept_old < cuts, "{kept_old} of {cuts} kept the old settings");
}

#[test]
fn damage_whose_interrupt_is_late_is_still_the_settings() {
    let Some(mut link) = greeted() else { return };
    keep(&mut link, &numbered(1));
    let before = link.machine.chip().flash.contents();
    for delay in [1, 30, 300, 3_000, 30_000] {
        start_from(&mut link, &before);
        write(&mut link, &numbered(2));
        link.machine.chip_mut().flash.cut_power_after(3, Torn::Between);
        let cut = save(&mut link);
        assert!(matches!(cut, Err(SerialError::Ended(_))), "{cut:?}");
        link.machine.chip_mut().flash.nmi_delay = delay;
        link.machine.power_cut().expect("starts");
        link.machine.run_for(START_S).unwrap_or_else(|ended| panic!("{delay} cycles late: {ended}"));
        let events = greet_anew(&mut link);
        assert_eq!((settings(&mut link), cause(&events)), (numbered(1), ResetCause::PowerOn), "{delay} cycles late");
        link.machine.chip_mut().flash.nmi_delay = 0;
    }
}

#[test]
fn power_that_fails_while_pages_are_erased_keeps_the_old_or_the_new_settings() {
    let Some(mut link) = greeted() else { return };
    // Save until a save has to erase a page.
    let (mut number, mut before) = (0, link.machine.chip().flash.contents());
    let erased = link.machine.chip().flash.erased;
    while link.machine.chip().flash.erased == erased {
        before = link.machine.chip().flash.contents();
        number += 1;
        assert!(number < 100, "no page is ever erased");
        keep(&mut link, &numbered(number));
    }
    let (cuts, _) = cut_everywhere(&mut link, &before, &numbered(number - 1), &numbered(number));
    assert!((60..400).contains(&cuts), "{cuts} cuts");
}

#[test]
fn power_that_fails_while_the_brown_out_level_is_set_does_no_harm() {
    for torn in Torn::ALL {
        let Some(mut machine) = machine(Options::default(), Still) else { return };
        machine.chip_mut().flash.cut_power_after(0, torn);
        let ended = machine.run_for(0.2).expect_err("the supply fails");
        assert_eq!(ended.stop, Stop::PowerFailed, "{ended}");
        machine.power_cut().expect("starts");
        run(&mut machine, 0.2);
        assert_eq!(machine.chip().flash.brown_out_level(), 4);
        greet(&mut SerialLink::new(machine));
    }
}

#[test]
fn flash_that_holds_anything_else_gives_defaults_and_says_so() {
    let Some(mut link) = greeted() else { return };
    let defaults = settings(&mut link);
    keep(&mut link, &numbered(1));
    // All pages of settings contain something else, as if they were being programmed with it.
    let flash = &mut link.machine.chip_mut().flash;
    assert!(flash.load(0x0807_c000, &[0x5a; 16 << 10]));
    link.machine.power_cut().expect("starts");
    run(&mut link.machine, START_S);
    let events = greet_anew(&mut link);
    assert!(events.contains(&EventKind::Fault(Fault::ForeignSettings)), "{events:?}");
    assert_eq!(settings(&mut link), defaults);
    let kept = link.machine.chip().flash.contents();
    assert!(kept.bytes()[0x7_c000..].iter().all(|&byte| byte == 0x5a), "the old bytes are kept until the user saves");
}

#[test]
fn sampling_goes_on_while_the_settings_are_saved() {
    let Some(mut link) = greeted() else { return };
    let erased = link.machine.chip().flash.erased;
    for number in 1.. {
        keep(&mut link, &numbered(number));
        if link.machine.chip().flash.erased > erased {
            break;
        }
    }
    let health = health(&mut link);
    assert_eq!((health.lost_samples, health.overruns), (0, 0));
    assert!(health.index > 500, "{} samples", health.index);
    let flash = &link.machine.chip().flash;
    assert_eq!((flash.stalls, flash.stalled), (0, 0));
}

/// The core's usage in five seconds at this rate and motion, after one second to settle.
fn usage(rate_hz: f64, motion: Excitation) -> Option<(Usage, SerialLink)> {
    let rig = Rig::new(motion, 0.0);
    let wanted = rig.settings(rate_hz);
    let mut link = board(Bench::new(rig).expect("a rig that can be"))?;
    greet(&mut link);
    write(&mut link, &wanted);
    done(&mut link, Command::Streams(Streams { estimates: true, sums: true, ..Streams::NONE }), REPLY_S);
    listen(&mut link, 1.0);
    let before = link.machine.usage();
    listen(&mut link, 5.0);
    Some((link.machine.usage().since(&before), link))
}

#[test]
fn the_processor_has_time_left() {
    // A motion with fast and slow parts, so that both banks have work.
    let motion = Excitation::random(0.5, 15.0, 0.02, 3);
    let mut loads = Vec::new();
    for rate_hz in [1000.0, 4000.0] {
        let Some((usage, mut link)) = usage(rate_hz, motion.clone()) else { return };
        let per_s = usage.instructions_per_s();
        eprintln!(
            "{rate_hz} Hz: {:.2} million instructions per second, awake {:.2} %",
            per_s / 1e6,
            100.0 * usage.load()
        );
        // The goal is a quarter of 168 MHz. Here an instruction takes one cycle; on the chip some take more.
        assert!((1e6..30e6).contains(&per_s), "{rate_hz} Hz: {per_s} instructions per second");
        let health = health(&mut link);
        let told = f64::from(health.cpu_load_permille.expect("known")) / 1000.0;
        assert!((told - usage.load()).abs() < 0.01 + 0.2 * usage.load(), "it says {told}, is {}", usage.load());
        assert_eq!((health.lost_samples, health.overruns, health.dropped_frames), (0, 0, 0));
        loads.push(usage.load());
    }
    assert!(loads[1] > 1.5 * loads[0], "{loads:?}: four times as many samples");
}

#[test]
fn the_stack_keeps_its_bound() {
    let Some((_, mut link)) = usage(4000.0, Excitation::random(0.5, 15.0, 0.02, 3)) else { return };
    for number in 1..20 {
        keep(&mut link, &numbered(number));
    }
    done(&mut link, Command::FactoryReset, SAVE_S);
    let health = health(&mut link);
    let stack = link.machine.stack_high_water().expect("painted");
    eprintln!("stack: {} of {} bytes", stack.used, stack.available);
    assert!((2_000..24_000).contains(&stack.used), "{stack:?}");
    // The device does not count the guard and the space below it as free.
    let told = health.stack_free_bytes.expect("known") as usize;
    let free = stack.available - stack.used;
    assert!((free.saturating_sub(2048)..=free).contains(&told), "it says {told} bytes are free, {free} are");
}

#[test]
fn every_handler_ends_with_a_barrier() {
    /// DSB SY.
    const BARRIER: [u8; 4] = [0xbf, 0xf3, 0x4f, 0x8f];
    const EXCEPTIONS: usize = 16;
    let Some(image) = shipping_image() else { return };
    let elf = Elf::parse(&image).expect("an ELF");
    let (start, vectors) = elf.segments.first().expect("the vectors");
    assert_eq!(*start, 0x0800_0000);
    let vector = |place: usize| u32::from_le_bytes(vectors[4 * place..][..4].try_into().expect("a word"));
    let unused = elf.symbol("DefaultHandler").expect("a handler") | 1;
    let mut without = Vec::new();
    let mut handlers = 0;
    for place in (EXCEPTIONS..EXCEPTIONS + 102).filter(|place| vector(*place) | 1 != unused) {
        let Some(code) = elf.function(vector(place)) else { continue };
        handlers += 1;
        // At least three instructions before the return, or a division may be lost (erratum 776924).
        assert!(code.len() > 2 * 4 + 2, "{:?}", elf.function_at(vector(place)));
        // The barrier may be followed by the return and by constants.
        if !code.windows(4).any(|bytes| bytes == BARRIER) {
            without.extend(elf.function_at(vector(place)));
        }
    }
    assert!(handlers >= 8, "{handlers} handlers");
    // The handler of embassy-time, which only that crate can bind.
    assert_eq!(without, ["TIM1_BRK_TIM15"]);
}

/// An interrupted load to SP may give a wrong value (erratum 752770).
#[test]
fn nothing_loads_the_stack_pointer_from_memory() {
    let Some(image) = shipping_image() else { return };
    let elf = Elf::parse(&image).expect("an ELF");
    let mut functions = 0;
    for (name, code) in elf.functions() {
        functions += 1;
        assert!(!loads_the_stack_pointer(&halves(code).collect::<Vec<_>>()), "{name}");
    }
    assert!(functions > 300, "{functions}");
    // LDR SP, [R0]; NOP, LDR SP, [R0], #4. Not LDR R12, [R0] or STR SP, [R0].
    assert!(loads_the_stack_pointer(&[0xf8d0, 0xd000]) && loads_the_stack_pointer(&[0xbf00, 0xf850, 0xdb04]));
    assert!(!loads_the_stack_pointer(&[0xf8d0, 0xc000]) && !loads_the_stack_pointer(&[0xf8c0, 0xd000]));
}

/// LDR.W to R13, in any form. Other loads cannot target it.
fn loads_the_stack_pointer(halves: &[u16]) -> bool {
    let mut at = 0;
    while let Some(&first) = halves.get(at) {
        // A 32-bit instruction starts with 0b11101, 0b11110 or 0b11111.
        let wide = first >> 11 > 0b11100;
        if wide && first & 0xff70 == 0xf850 && halves.get(at + 1).is_some_and(|second| second >> 12 == 13) {
            return true;
        }
        at += if wide { 2 } else { 1 };
    }
    false
}

/// Simulates a core that vectors to the wrong interrupt and runs another handler.
#[test]
fn a_handler_that_is_run_for_nothing_does_no_harm() {
    const ISPR: u32 = 0xe000_e200;
    let Some(mut link) = board(Bench::new(moving()).expect("a rig that can be")) else { return };
    greet(&mut link);
    for pause in 1..200u32 {
        // DMA1_CHANNEL3, DMA1_CHANNEL5, USB_LP, EXTI9_5, TIM15, TIM2, UART4, LPUART1.
        for interrupt in [13, 15, 20, 23, 24, 28, 52, 91] {
            write_core(&mut link.machine, ISPR + interrupt / 32 * 4, 1 << (interrupt % 32));
            run(&mut link.machine, f64::from(pause) * 3.7e-6);
        }
    }
    let health = health(&mut link);
    assert_eq!((health.lost_samples, health.overruns, health.bad_frames, health.dropped_frames), (0, 0, 0, 0));
    assert_eq!(link.machine.resets.len(), 2);
}

#[test]
fn nothing_is_allocated() {
    let Some(link) = board(Still) else { return };
    let allocates = |name: &&str| {
        let name = rustc_demangle::demangle(name).to_string();
        ["__rust_alloc", "__rg_alloc", "__rdl_alloc", "alloc::alloc::", "malloc"].iter().any(|part| name.contains(part))
    };
    let found: BTreeSet<&str> = link.machine.elf.symbols().filter(allocates).collect();
    assert_eq!(found, BTreeSet::new());
    assert!(link.machine.elf.symbols().count() > 500, "the image has its symbols");
}
