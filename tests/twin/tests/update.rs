//! The ROM boot loader installs another firmware over USB and starts it.
//!
//! The host here sends what `inerter update` sends: it erases the page of the vectors first and writes it last, with
//! the vectors themselves after the rest of that page.

use crate::common::{another, carried_by, configured, press, rig, run, serial};
use inerter_app::wear::SAVES;
use inerter_twin::Width;
use inerter_twin::bench::Bench;
use inerter_twin::chip::flash::{PAGE, START, Torn};
use inerter_twin::chip::rom::Left;
use inerter_twin::cpu::Stop;
use inerter_twin::elf::Elf;
use inerter_twin::machine::{Machine, image, shipping_image};
use inerter_twin::usb_host::{Setup, UsbError, UsbHost};
use inerter_twin::usb_link::UsbLink;
use inerter_twin::world::Still;
use inerter_wire::{Command, Measure, Quantity, Record, SettingsValues, Streams};
use std::collections::BTreeMap;
use unicorn_engine::RegisterARM;

const DNLOAD: u8 = 1;
const UPLOAD: u8 = 2;
const GETSTATUS: u8 = 3;
const ABORT: u8 = 6;
const DOWNLOAD_IDLE: u8 = 5;

/// Content of the flash, page by page.
fn pages(image: &[u8]) -> BTreeMap<u32, Vec<u8>> {
    let elf = Elf::parse(image).expect("an ELF");
    let mut pages = BTreeMap::new();
    for (address, bytes) in &elf.segments {
        for (place, byte) in (*address..).zip(bytes) {
            let page = pages.entry(place - (place - START) % PAGE as u32).or_insert_with(|| vec![0xff; PAGE]);
            page[(place - START) as usize % PAGE] = *byte;
        }
    }
    pages
}

/// The host side of DfuSe.
struct Loader<'a> {
    host: UsbHost,
    machine: &'a mut Machine,
}

impl<'a> Loader<'a> {
    fn connect(machine: &'a mut Machine) -> Self {
        let mut host = UsbHost::default();
        let seen = host.connect(machine).expect("a device");
        assert_eq!((seen.vendor, seen.product_number), (0x0483, 0xdf11));
        assert_eq!(seen.serial, serial());
        Self { host, machine }
    }

    fn out(&mut self, request: u8, block: u16, data: &[u8]) -> Result<(), UsbError> {
        let setup = Setup { kind: 0x21, request, value: block, index: 0, length: data.len() as u16 };
        self.host.control(self.machine, setup, data).map(|_| ())
    }

    fn back(&mut self, request: u8, block: u16, length: u16) -> Result<Vec<u8>, UsbError> {
        let setup = Setup { kind: 0xa1, request, value: block, index: 0, length };
        self.host.control(self.machine, setup, &[])
    }

    fn carry_out(&mut self, block: u16, data: &[u8]) -> Result<(), UsbError> {
        self.out(DNLOAD, block, data)?;
        for _ in 0..100 {
            let answer = self.back(GETSTATUS, 0, 6)?;
            assert_eq!(answer[0], 0, "refused: {answer:?}");
            if answer[4] == DOWNLOAD_IDLE {
                return Ok(());
            }
            self.machine.run_for(f64::from(answer[1]) * 1e-3).map_err(|ended| UsbError::Stopped(ended.to_string()))?;
        }
        panic!("the update timed out");
    }

    fn command(&mut self, command: u8, address: u32) -> Result<(), UsbError> {
        let [a, b, c, d] = address.to_le_bytes();
        self.carry_out(0, &[command, a, b, c, d])
    }

    fn write(&mut self, address: u32, page: &[u8]) -> Result<(), UsbError> {
        self.command(0x21, address)?;
        self.carry_out(2, page)?;
        self.command(0x21, address)?;
        self.out(ABORT, 0, &[])?;
        assert_eq!(self.back(UPLOAD, 2, page.len() as u16)?, page, "read back at {address:#x}");
        self.out(ABORT, 0, &[])
    }

    /// Starts the firmware in flash without writing anything.
    fn leave(&mut self) -> Result<(), UsbError> {
        self.command(0x21, START)?;
        self.out(DNLOAD, 0, &[])?;
        // The device may disconnect before it answers.
        let _ = self.back(GETSTATUS, 0, 6);
        self.host.unplug(self.machine);
        Ok(())
    }

    fn update(&mut self, image: &[u8]) -> Result<(), UsbError> {
        let pages = pages(image);
        self.command(0x41, START)?;
        for (address, page) in pages.iter().filter(|(address, _)| **address != START) {
            self.command(0x41, *address)?;
            self.write(*address, page)?;
        }
        let (vectors, code) = pages[&START].split_at(8);
        self.write(START + 8, code)?;
        self.write(START, vectors)?;
        self.leave()
    }
}

/// The firmware version that the device reports.
fn firmware(link: &mut UsbLink<Machine>) -> String {
    link.plug_in().expect("a port");
    link.request(Command::Hello, 1.0).expect("a reply").result.expect("done");
    link.listen(0.05).expect("listens");
    let hello = link.talk.records().into_iter().find_map(carried_by!(Record::Hello)).expect("a Hello");
    hello.firmware.to_string()
}

/// A configured board on its rig, in update mode by command.
fn in_update_mode(image: &[u8], left: Left) -> Machine {
    let rig = rig();
    let settings = rig.settings(1000.0);
    let link = configured(image, left, Bench::new(rig).expect("a rig that can be"), &settings);
    into_update_mode(link)
}

/// Our firmware enters update mode by command.
fn into_update_mode(mut link: UsbLink<Machine>) -> Machine {
    assert!(firmware(&mut link).starts_with("inerter 0."));
    go(&mut link, Way::Command);
    link.socket
}

/// Installs an image and starts it; `what` names the case.
fn install(machine: &mut Machine, image: &[u8], what: &str) {
    Loader::connect(machine).update(image).unwrap_or_else(|error| panic!("{what}: {error}"));
    machine.run_for(0.5).unwrap_or_else(|ended| panic!("{what}: {ended}"));
}

/// The other firmware runs, with the saved settings.
fn measures(machine: Machine, what: &str) {
    let mut link = UsbLink::new(machine);
    assert!(firmware(&mut link).starts_with("inerter 9."), "{what}");
    link.request(Command::Streams(Streams { estimates: true, ..Streams::NONE }), 1.0).expect("a reply");
    link.listen(3.0).expect("listens");
    let estimate = link.talk.records().into_iter().rev().find_map(carried_by!(Record::Estimate));
    let fitted = estimate.expect("an estimate").whole_run.inertance_kg.fitted();
    let off = (fitted.value / 299.4906 - 1.0).abs();
    assert!(off < 0.02, "{what}: {} kg, so the settings were lost", fitted.value);
}

#[test]
fn another_firmware_measures_after_its_update_with_the_settings_kept() {
    let Some(image) = shipping_image() else { return };
    for left in Left::ALL {
        let mut machine = in_update_mode(&image, left);
        install(&mut machine, &another(&image, b'9'), &format!("{left:?}"));
        assert!(!machine.is_in_rom());
        measures(machine, &format!("{left:?}"));
    }
}

/// Not the same bytes under another name, but another program: the image whose task hangs five seconds after its start.
#[test]
fn a_really_different_build_goes_there_and_back() {
    let (Some(ours), Some(other)) =
        (shipping_image(), image("INERTER_STM32_HANG_ELF", "release/inerter-stm32g474-hang"))
    else {
        return;
    };
    let differing = pages(&ours).iter().filter(|(address, page)| pages(&other).get(address) != Some(page)).count();
    assert!(differing > pages(&ours).len() / 2, "{differing} pages differ");
    let mut machine = in_update_mode(&ours, Left::Running);
    install(&mut machine, &other, "there");
    let mut machine = into_update_mode(UsbLink::new(machine));
    install(&mut machine, &another(&ours, b'9'), "back");
    measures(machine, "there and back");
}

#[test]
fn an_update_whose_power_fails_at_any_stage_is_completed_by_the_next() {
    let Some(image) = shipping_image() else { return };
    let new = another(&image, b'9');
    let operations = pages(&image).len() as u32 * (1 + PAGE as u32 / 8);
    // The first erase, among the pages, and the last words.
    for (number, cut) in
        [0, 1, 2, operations / 3, operations / 2, operations - 200, operations - 1].into_iter().enumerate()
    {
        let mut machine = in_update_mode(&image, Left::Running);
        machine.chip_mut().flash.cut_power_after(cut, Torn::ALL[number % 3]);
        let result = Loader::connect(&mut machine).update(&new);
        let Err(UsbError::Stopped(why)) = result else { panic!("cut after {cut}: {result:?}") };
        assert!(why.contains("power failed"), "{why}");
        if (1..operations - 1).contains(&cut) {
            let vectors = machine.chip_mut().flash.rom_read(START, 8);
            assert_eq!(vectors, Some(vec![0xff; 8]), "cut after {cut} half an image would run");
        }
        // Without vectors the chip cannot start from flash. The BOOT0 pin brings it back into the ROM.
        machine.boot0 = true;
        machine.power_cut().expect("starts");
        run(&mut machine, 0.01);
        assert!(machine.is_in_rom(), "cut after {cut}");
        machine.boot0 = false;
        install(&mut machine, &new, &format!("after a cut at {cut}"));
        measures(machine, &format!("cut after {cut}"));
    }
}

/// The settings in use, and the number of saves that the flash may still take.
fn settings_and_saves(link: &mut UsbLink<Machine>) -> (SettingsValues, u32) {
    for command in [Command::ReadSettings, Command::Measure(Measure::Chip)] {
        link.request(command, 1.0).expect("a reply").result.expect("done");
    }
    link.listen(0.05).expect("listens");
    let (mut settings, mut saves) = (None, None);
    for record in link.talk.records() {
        match record {
            Record::Settings(values) => settings = Some(values),
            Record::Measured(measured) => saves = measured.get(Quantity::SavesLeft),
            _ => {}
        }
    }
    (settings.expect("settings"), saves.expect("a number of saves"))
}

/// The ways into update mode from a running device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    Command,
    TwoPresses,
}

/// Enters update mode; the cable is unplugged afterwards.
fn go(link: &mut UsbLink<Machine>, way: Way) {
    match way {
        Way::Command => {
            // The device may disconnect before it replies.
            let _ = link.request(Command::EnterDfu, 0.2);
            link.unplug();
        }
        Way::TwoPresses => {
            link.unplug();
            press(&mut link.socket, 0.2);
            assert!(!link.socket.is_in_rom(), "one press");
            link.socket.reset().expect("starts");
        }
    }
    run(&mut link.socket, 0.2);
    assert!(link.socket.is_in_rom(), "{way:?}");
}

/// A visit as in `inerter selftest`: by command or by the button, and back without writing anything.
#[test]
fn a_visit_to_update_mode_leaves_flash_and_settings_alone() {
    let Some(image) = shipping_image() else { return };
    let settings = rig().settings(1000.0);
    for (left, way) in Left::ALL.into_iter().flat_map(|left| [(left, Way::Command), (left, Way::TwoPresses)]) {
        let mut link = configured(&image, left, Still, &settings);
        let running = firmware(&mut link);
        let (before, saves_before) = settings_and_saves(&mut link);
        let flash = link.socket.chip().flash.contents();
        go(&mut link, way);
        Loader::connect(&mut link.socket).leave().unwrap_or_else(|error| panic!("{left:?}, {way:?}: {error}"));
        link.socket.run_for(0.5).unwrap_or_else(|ended| panic!("{left:?}, {way:?}: {ended}"));
        assert!(!link.socket.is_in_rom(), "{left:?}, {way:?}");
        assert_eq!(firmware(&mut link), running, "{left:?}, {way:?}");
        let (after, saves) = settings_and_saves(&mut link);
        assert_eq!(after, before, "{left:?}, {way:?}");
        // A host could repeat the command at will, so it must not renew the saves.
        let expected = if way == Way::Command { saves_before } else { SAVES.into() };
        assert_eq!(saves, expected, "{left:?}, {way:?}");
        assert!(link.socket.chip().flash.contents() == flash, "{left:?}, {way:?}: flash was written");
    }
}

/// RCC: clocks of APB2. SYSCFG: memory mapped at address 0.
const APB2ENR: u32 = 0x4002_1060;
const MEMRMP: u32 = 0x4001_0000;

/// Registers that the ROM may expect at their reset values: clocks and what they feed, the core's interrupts, the
/// memory protection unit, the vectors and the flash interface.
const FOUND_BY_ROM: &[u32] = &[
    // RCC: CR, CFGR, PLLCFGR, CIER, AHB1 to APB2 enable, CCIPR, CRRCR, CCIPR2.
    0x4002_1000,
    0x4002_1008,
    0x4002_100c,
    0x4002_1018,
    0x4002_1048,
    0x4002_104c,
    0x4002_1050,
    0x4002_1058,
    0x4002_105c,
    0x4002_1060,
    0x4002_1088,
    0x4002_1098,
    0x4002_109c,
    // FLASH: ACR, CR.
    0x4002_2000,
    0x4002_2014,
    // SysTick; NVIC enabled and pending; ICSR, VTOR, SCR, MPU_CTRL.
    0xe000_e010,
    0xe000_e100,
    0xe000_e104,
    0xe000_e108,
    0xe000_e10c,
    0xe000_e200,
    0xe000_e204,
    0xe000_e208,
    0xe000_e20c,
    0xe000_ed04,
    0xe000_ed08,
    0xe000_ed10,
    0xe000_ed94,
];

/// The state that the ROM finds: these registers and those of the core.
fn found_by_rom(machine: &mut Machine) -> Vec<(String, u32)> {
    let now = machine.now();
    let mut found: Vec<(String, u32)> = FOUND_BY_ROM
        .iter()
        .map(|&address| {
            let value = match address {
                0xe000_0000.. => machine.cpu.core_mut().nvic.read(address, Width::Word, now).ok(),
                _ => machine.chip_mut().read(address, Width::Word, now).ok(),
            };
            (format!("{address:#010x}"), value.expect("a register"))
        })
        .collect();
    use RegisterARM as R;
    for (name, register) in [
        ("PC", R::PC),
        ("SP", R::SP),
        ("PRIMASK", R::PRIMASK),
        ("BASEPRI", R::BASEPRI),
        ("FAULTMASK", R::FAULTMASK),
        ("CONTROL", R::CONTROL),
    ] {
        found.push((name.to_owned(), machine.cpu.register(register)));
    }
    found
}

/// When the program starts the ROM, the ROM finds the same state as when the BOOT0 pin starts it.
#[test]
fn the_rom_finds_the_chip_as_after_a_start_by_the_boot_pin() {
    let Some(image) = shipping_image() else { return };
    let in_rom = |way: Option<Way>| {
        let mut machine = Machine::new(&image, Still).expect("the image");
        run(&mut machine, 0.5);
        let mut link = UsbLink::new(machine);
        link.plug_in().expect("opens");
        link.request(Command::Streams(Streams::ALL), 1.0).expect("a reply");
        if way == Some(Way::Command) {
            let _ = link.request(Command::EnterDfu, 0.2);
        }
        let mut machine = link.socket;
        match way {
            Some(Way::Command) => {}
            Some(Way::TwoPresses) => {
                press(&mut machine, 0.2);
                machine.reset().expect("starts");
            }
            None => {
                machine.boot0 = true;
                machine.reset().expect("starts");
            }
        }
        let ended = machine.run_for(1.0).expect_err("the boot loader");
        assert_eq!(ended.stop, Stop::Bootloader, "{way:?}: {ended}");
        assert_eq!(machine.chip().iwdg.timeout_s(), None, "{way:?}: nobody would feed the watchdog");
        assert!(!machine.chip().usb.attached(), "{way:?}: the host still sees the device that was");
        assert_eq!(machine.chip().clocks.hclk_hz, 16e6, "{way:?}");
        if way.is_some() {
            let now = machine.now();
            assert_eq!(machine.chip_mut().read(MEMRMP, Width::Word, now).map(|value| value & 7), Ok(1), "{way:?}");
        }
        found_by_rom(&mut machine)
    };
    let mut expected = in_rom(None);
    // Except for the clock of SYSCFG, which the program used to map the ROM at address 0.
    for (_, value) in expected.iter_mut().filter(|(name, _)| *name == format!("{APB2ENR:#010x}")) {
        *value |= 1;
    }
    for way in [Way::Command, Way::TwoPresses] {
        assert_eq!(in_rom(Some(way)), expected, "{way:?}");
    }
}
