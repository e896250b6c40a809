//! The boot loader in ROM takes another firmware over USB, and starts it.
//!
//! The host here sends what `inerter update` sends: the page of the vectors is erased first and written last, the vectors
//! by themselves behind the rest of it.

use inerter_plant::Excitation;
use inerter_twin::bench::{Bench, Rig};
use inerter_twin::chip::flash::{PAGE, START, Torn};
use inerter_twin::chip::rom::{Left, UID};
use inerter_twin::elf::Elf;
use inerter_twin::machine::{Machine, image, shipping_image};
use inerter_twin::usb_host::{Setup, UsbError, UsbHost};
use inerter_twin::usb_link::UsbLink;
use inerter_wire::{Command, Record, Streams};
use std::collections::BTreeMap;

const NAME: &[u8] = b"inerter 0.";
const DNLOAD: u8 = 1;
const UPLOAD: u8 = 2;
const GETSTATUS: u8 = 3;
const ABORT: u8 = 6;
const DOWNLOAD_IDLE: u8 = 5;

/// The same program under another name: as a later version it says 9 wherever it says 0.
fn another(image: &[u8]) -> Vec<u8> {
    let mut image = image.to_vec();
    let places = (0..image.len() - NAME.len()).filter(|at| image[*at..].starts_with(NAME)).collect::<Vec<_>>();
    // What Hello says, and what the program finds that updates it.
    assert!(places.len() >= 2, "{places:?}");
    for at in places {
        image[at + NAME.len() - 2] = b'9';
    }
    image
}

/// What lies in flash, page by page.
fn pages(image: &[u8]) -> BTreeMap<u32, Vec<u8>> {
    let elf = Elf::parse(image).expect("an ELF");
    let mut pages = BTreeMap::new();
    for (address, bytes) in elf.segments() {
        for (place, byte) in (*address..).zip(bytes) {
            let page = pages.entry(place - (place - START) % PAGE as u32).or_insert_with(|| vec![0xff; PAGE]);
            page[(place - START) as usize % PAGE] = *byte;
        }
    }
    pages
}

/// The host's half of DfuSe.
struct Loader<'a> {
    host: UsbHost,
    machine: &'a mut Machine,
}

impl<'a> Loader<'a> {
    fn connect(machine: &'a mut Machine) -> Self {
        let mut host = UsbHost::new();
        let seen = host.connect(machine).expect("a device");
        assert_eq!((seen.vendor, seen.product_number), (0x0483, 0xdf11));
        assert_eq!(seen.serial.text, format!("{:08X}{:04X}", UID[0].wrapping_add(UID[2]), UID[1] >> 16));
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
        panic!("it does not get done");
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
        self.command(0x21, START)?;
        self.out(DNLOAD, 0, &[])?;
        // It may be gone before it can answer.
        let _ = self.back(GETSTATUS, 0, 6);
        self.host.unplug(self.machine);
        Ok(())
    }
}

/// What the device says it runs.
fn firmware(link: &mut UsbLink<Machine>) -> String {
    link.connect().expect("a device");
    link.open().expect("a port");
    link.request(Command::Hello, 1.0).expect("a reply").result.expect("done");
    link.listen(0.05).expect("listens");
    let found = link.records().into_iter().find_map(|record| match record {
        Record::Hello(hello) => Some(hello.firmware.to_string()),
        _ => None,
    });
    found.expect("a Hello")
}

/// A board on its rig that was set up, in update mode by command.
fn in_update_mode(image: &[u8], left: Left) -> Machine {
    let rig = Rig::new(Excitation::random(0.5, 15.0, 0.02, 1), 0.5);
    let settings = rig.settings(1000.0);
    let mut machine = Machine::new(image, Box::new(Bench::new(rig).expect("a rig that can be"))).expect("the image");
    machine.serve_rom(left);
    machine.run_for(0.5).unwrap_or_else(|ended| panic!("{ended}"));
    let mut link = UsbLink::new(machine);
    link.set_up(&settings).expect("takes its settings");
    assert!(firmware(&mut link).starts_with("inerter 0."));
    // It may be gone before its reply is out.
    let _ = link.request(Command::EnterDfu, 0.2);
    link.unplug();
    link.socket.run_for(0.2).unwrap_or_else(|ended| panic!("{ended}"));
    assert!(link.socket.is_in_rom());
    link.socket
}

/// The other firmware runs, and with the settings that were kept.
fn measures(machine: Machine, what: &str) {
    let mut link = UsbLink::new(machine);
    assert!(firmware(&mut link).starts_with("inerter 9."), "{what}");
    link.request(Command::Streams(Streams { estimates: true, ..Streams::NONE }), 1.0).expect("a reply");
    link.listen(3.0).expect("listens");
    let estimate = link.records().into_iter().rev().find_map(|record| match record {
        Record::Estimate(estimate) => Some(estimate),
        _ => None,
    });
    let fitted = estimate.expect("an estimate").whole_run.inertance_kg.fitted();
    let off = (fitted.value / 299.4906 - 1.0).abs();
    assert!(off < 0.02, "{what}: {} kg, so the settings were lost", fitted.value);
}

#[test]
fn another_firmware_measures_after_its_update_with_the_settings_kept() {
    let Some(image) = shipping_image() else { return };
    for left in Left::ALL {
        let mut machine = in_update_mode(&image, left);
        Loader::connect(&mut machine).update(&another(&image)).unwrap_or_else(|error| panic!("{left:?}: {error}"));
        machine.run_for(0.5).unwrap_or_else(|ended| panic!("{left:?}: {ended}"));
        assert!(!machine.is_in_rom());
        measures(machine, &format!("{left:?}"));
    }
}

/// Not the same bytes under another name, but another program: that whose task hangs five seconds after its start.
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
    Loader::connect(&mut machine).update(&other).unwrap_or_else(|error| panic!("there: {error}"));
    machine.run_for(0.5).unwrap_or_else(|ended| panic!("{ended}"));
    let mut link = UsbLink::new(machine);
    assert!(firmware(&mut link).starts_with("inerter 0."));
    let _ = link.request(Command::EnterDfu, 0.2);
    link.unplug();
    let mut machine = link.socket;
    machine.run_for(0.2).unwrap_or_else(|ended| panic!("{ended}"));
    assert!(machine.is_in_rom());
    Loader::connect(&mut machine).update(&another(&ours)).unwrap_or_else(|error| panic!("back: {error}"));
    machine.run_for(0.5).unwrap_or_else(|ended| panic!("{ended}"));
    measures(machine, "there and back");
}

#[test]
fn an_update_whose_power_fails_at_any_stage_is_completed_by_the_next() {
    let Some(image) = shipping_image() else { return };
    let new = another(&image);
    let operations = pages(&image).len() as u32 * (1 + PAGE as u32 / 8);
    // The first erase, among the pages, the last words.
    for (number, cut) in
        [0, 1, 2, operations / 3, operations / 2, operations - 200, operations - 1].into_iter().enumerate()
    {
        let mut machine = in_update_mode(&image, Left::Running);
        machine.chip_mut().flash.cut_power_after(cut, Torn::ALL[number % 3]);
        let result = Loader::connect(&mut machine).update(&new);
        let Err(UsbError::Stopped(why)) = result else { panic!("cut after {cut}: {result:?}") };
        assert!(why.contains("the supply failed"), "{why}");
        if (1..operations - 1).contains(&cut) {
            let vectors = machine.chip_mut().flash.rom_read(START, 8);
            assert_eq!(vectors, Some(vec![0xff; 8]), "cut after {cut} half an image would run");
        }
        // There are no vectors to start from: the boot pin leads back.
        machine.set_boot0(true);
        machine.power_cut().expect("starts");
        machine.run_for(0.01).unwrap_or_else(|ended| panic!("{ended}"));
        assert!(machine.is_in_rom(), "cut after {cut}");
        machine.set_boot0(false);
        Loader::connect(&mut machine).update(&new).unwrap_or_else(|error| panic!("after a cut at {cut}: {error}"));
        machine.run_for(0.5).unwrap_or_else(|ended| panic!("{ended}"));
        measures(machine, &format!("cut after {cut}"));
    }
}
