//! The board starts, and can be updated, with any value of the option bits that select where the chip boots.

use crate::common::{carried_by, causes, enters_update_mode, press, run};
use inerter_twin::chip::flash::{Boot, OPTIONS_DELIVERED};
use inerter_twin::chip::rcc::Reset;
use inerter_twin::chip::rom::Left;
use inerter_twin::cpu::Stop;
use inerter_twin::machine::{Machine, Options, shipping_image};
use inerter_twin::serial_link::SerialLink;
use inerter_twin::world::Still;
use inerter_wire::{Capabilities, Command, Hello, Record};

/// Bit positions of the option bytes in FLASH_OPTR (RM0440 3.7.8).
const BFB2: u32 = 1 << 20;
const DBANK: u32 = 1 << 22;
const NBOOT1: u32 = 1 << 23;
const NSWBOOT0: u32 = 1 << 26;
const NBOOT0: u32 = 1 << 27;
/// From power-on, or from the ROM's jump, until the firmware answers.
const START_S: f64 = 0.2;

fn hello(link: &mut SerialLink) -> Hello {
    link.talk = Default::default();
    link.order(Command::Hello, 0.5).unwrap_or_else(|error| panic!("{error}"));
    link.listen_until(link.machine.time_s() + 0.05).unwrap_or_else(|ended| panic!("{ended}"));
    link.talk.records().into_iter().find_map(carried_by!(Record::Hello)).expect("a Hello")
}

/// One value of the option bytes: from a new chip to an update, through each way into update mode.
fn a_life_with(image: &[u8], options: u32) {
    let mut machine = Machine::new(image, Still).expect("the image");
    machine.chip_mut().flash.set_options(options);
    let started = machine.power_cut();
    match machine.chip().flash.boots(false) {
        Boot::Flash | Boot::EitherBank => started.expect("starts"),
        // An update leads out of the ROM.
        Boot::Rom => {
            enters_update_mode(&mut machine, 1.0);
            machine.leave_rom(Left::Unlocked).expect("jumps");
        }
        // Only a debug probe leads out of RAM.
        Boot::Ram => {
            assert!(matches!(started, Err(Stop::Ram)));
            return;
        }
    }
    run(&mut machine, START_S);
    let resets = machine.resets.len();
    let mut link = SerialLink::new(machine);
    let capabilities = hello(&mut link).capabilities;
    assert_eq!(capabilities.contains(Capabilities::STORE), options & DBANK != 0, "pages for the settings");
    assert_eq!(capabilities.flash_kb(), Some(512));
    let kept = link.machine.chip().flash.options();
    assert_eq!(kept & (NBOOT0 | NBOOT1 | BFB2), NBOOT0 | NBOOT1, "from flash, and the pin leads into the ROM");
    assert_eq!((kept ^ options) & (DBANK | NSWBOOT0), 0, "not the firmware's to change");
    // Into update mode by command, and back by the ROM's jump.
    link.order(Command::EnterDfu, 0.5).unwrap_or_else(|error| panic!("{error}"));
    enters_update_mode(&mut link.machine, 1.0);
    link.machine.leave_rom(Left::Running).expect("jumps");
    run(&mut link.machine, START_S);
    hello(&mut link);
    // Into update mode by the button, and back by the button.
    press(&mut link.machine, 0.1);
    link.machine.reset().expect("starts");
    enters_update_mode(&mut link.machine, 1.0);
    press(&mut link.machine, 1.0);
    hello(&mut link);
    // Into update mode by the BOOT0 pin, where the option bytes let it count.
    link.machine.boot0 = true;
    link.machine.reset().expect("starts");
    if options & NSWBOOT0 != 0 {
        enters_update_mode(&mut link.machine, 1.0);
    } else {
        run(&mut link.machine, 1.0);
        hello(&mut link);
    }
    // The firmware set the option bytes exactly once.
    let of_options = causes(&link.machine).into_iter().filter(|cause| *cause == Reset::OptionBytes);
    assert_eq!(of_options.count(), 1, "{resets} resets until the first Hello");
}

/// All values of the bits that select where the chip boots, and of the one that divides the flash into banks.
fn all_options() -> impl Iterator<Item = u32> {
    let bits = [BFB2, DBANK, NBOOT1, NSWBOOT0, NBOOT0];
    (0..1 << bits.len()).map(move |number| {
        let set = bits.iter().enumerate().filter(|(place, _)| number >> place & 1 != 0);
        OPTIONS_DELIVERED & !bits.iter().sum::<u32>() | set.fold(0, |word, (_, bit)| word | bit)
    })
}

#[test]
fn the_board_starts_and_recovers_with_every_value_of_the_option_bytes() {
    let Some(image) = shipping_image() else { return };
    for options in all_options() {
        eprintln!("option bytes {options:#010x}");
        a_life_with(&image, options);
    }
}

#[test]
fn the_roms_jump_starts_a_board_whose_every_reset_leads_into_the_rom() {
    let Some(image) = shipping_image() else { return };
    let into_rom = |options: u32| options & (NSWBOOT0 | NBOOT0) == 0 && options & (NBOOT1 | DBANK) == NBOOT1 | DBANK;
    for options in all_options().filter(|options| into_rom(*options)) {
        for left in Left::ALL {
            // After the last two causes the firmware leaves the option bytes alone until the next start: it may just
            // have set them, or setting them may be what went wrong.
            for cause in [Reset::Power, Reset::Pin, Reset::Software, Reset::OptionBytes, Reset::Watchdog] {
                eprintln!("option bytes {options:#010x}, {left:?}, {cause:?}");
                let mut machine = Machine::new(&image, Still).expect("the image");
                // Let the firmware read the flags of power-on first.
                run(&mut machine, START_S);
                machine.chip_mut().flash.set_options(options);
                machine.reset_by(cause).expect("starts");
                enters_update_mode(&mut machine, 1.0);
                machine.leave_rom(left).expect("jumps");
                run(&mut machine, START_S);
                let are_mended = machine.chip().flash.options() & NBOOT0 != 0;
                assert_eq!(are_mended, !matches!(cause, Reset::OptionBytes | Reset::Watchdog));
                let mut link = SerialLink::new(machine);
                hello(&mut link);
                link.machine.power_cut().expect("starts");
                if !are_mended {
                    enters_update_mode(&mut link.machine, 1.0);
                    link.machine.leave_rom(left).expect("jumps");
                }
                run(&mut link.machine, START_S);
                hello(&mut link);
                assert_ne!(link.machine.chip().flash.options() & NBOOT0, 0);
            }
        }
    }
}

#[test]
fn a_chip_with_less_flash_says_so_and_keeps_no_settings() {
    let Some(image) = shipping_image() else { return };
    for flash_kb in [128, 256, 512] {
        let options = Options { flash_kb, ..Options::default() };
        let mut machine = Machine::with(&image, options, Still).expect("the image");
        run(&mut machine, START_S);
        let mut link = SerialLink::new(machine);
        let capabilities = hello(&mut link).capabilities;
        assert_eq!(capabilities.flash_kb(), Some(flash_kb));
        assert_eq!(capabilities.contains(Capabilities::STORE), flash_kb == 512);
        let saved = link.order(Command::SaveSettings, 0.5);
        assert_eq!(saved.is_ok(), flash_kb == 512, "{saved:?}");
    }
}
