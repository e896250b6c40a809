//! Shared by the tests of the twin: the board on the bench and its links.

use inerter_core::Settings;
use inerter_plant::Excitation;
use inerter_twin::World;
use inerter_twin::bench::Rig;
use inerter_twin::chip::{
    errata::Errata,
    rcc::Reset,
    rom::{Left, UID},
    rules::Rules,
};
use inerter_twin::cpu::Stop;
use inerter_twin::machine::{Machine, Options, image_in, shipping_image};
use inerter_twin::talk::Talk;
use inerter_twin::usb_link::UsbLink;
use inerter_wire::{Command, DELIMITER, Frame, FrameReader, Request};
use std::path::Path;

/// From power-on until the firmware runs.
const START_S: f64 = 0.3;

/// What a record or an event carries, if it is of this kind.
macro_rules! carried_by {
    ($kind:path) => {
        |it| if let $kind(carried) = it { Some(carried) } else { None }
    };
}
pub(crate) use carried_by;

/// The board, powered and started, with nothing plugged in. `None` if there is no image, after reporting the skip.
pub fn board(world: impl World + 'static) -> Option<UsbLink<Machine>> {
    let mut machine = Machine::new(&shipping_image()?, world).expect("the image");
    run(&mut machine, START_S);
    Some(UsbLink::new(machine))
}

/// The paper's inerter under a random motion.
pub fn rig() -> Rig {
    Rig::new(Excitation::random(0.5, 15.0, 0.02, 1), 0.5)
}

/// A board that has saved these settings and whose boot loader leaves in this way.
pub fn configured(image: &[u8], left: Left, world: impl World + 'static, settings: &Settings) -> UsbLink<Machine> {
    let mut machine = Machine::new(image, world).expect("the image");
    machine.rom_leaves = Some(left);
    run(&mut machine, 0.5);
    let mut link = UsbLink::new(machine);
    link.set_up(settings).expect("takes its settings");
    link
}

/// The same as [`board`], plugged in and with its port open.
pub fn opened(world: impl World + 'static) -> Option<UsbLink<Machine>> {
    let mut link = board(world)?;
    link.plug_in().expect("a serial port");
    Some(link)
}

/// Lets the board run.
#[track_caller]
pub fn run(machine: &mut Machine, length_s: f64) {
    if let Err(ended) = machine.run_for(length_s) {
        panic!("{ended}");
    }
}

/// Presses the reset button and lets the board run.
#[track_caller]
pub fn press(machine: &mut Machine, then_s: f64) {
    machine.reset().expect("starts");
    run(machine, then_s);
}

/// The machine ends up in the boot loader within this time.
#[track_caller]
pub fn enters_update_mode(machine: &mut Machine, within_s: f64) {
    let ended = machine.run_for(within_s).expect_err("the boot loader");
    assert_eq!(ended.stop, Stop::Bootloader, "{ended}");
}

/// The causes of all starts so far.
pub fn causes(machine: &Machine) -> Vec<Reset> {
    machine.resets.iter().map(|&(_, cause)| cause).collect()
}

/// The cause of the last start.
pub fn last_reset(machine: &Machine) -> Reset {
    machine.resets.last().expect("power-on").1
}

/// The serial number that the ROM boot loader derives from the chip's unique ID.
pub fn serial() -> String {
    format!("{:08X}{:04X}", UID[0].wrapping_add(UID[2]), UID[1] >> 16)
}

/// The same program under another version: `digit` replaces the 0 of every `inerter 0.`.
pub fn another(image: &[u8], digit: u8) -> Vec<u8> {
    const NAME: &[u8] = b"inerter 0.";
    let mut image = image.to_vec();
    let places: Vec<usize> = (0..image.len() - NAME.len()).filter(|at| image[*at..].starts_with(NAME)).collect();
    // One in the reply to Hello, one for the program that reads the version from the image.
    assert!(places.len() >= 2, "{places:?}");
    for at in places {
        image[at + NAME.len() - 2] = digit;
    }
    image
}

/// A program of the folder `foreign`. `None` if it is not built, after reporting the skip.
pub fn image_of_others(name: &str) -> Option<Vec<u8>> {
    image_in("INERTER_FOREIGN", &format!("release/foreign-{name}"))
}

/// The chip running such a program.
pub fn chip_with(image: &[u8], world: impl World + 'static) -> Machine {
    // No errata: the twin models each one at its worst, and no real chip is that bad.
    let options = Options { errata: Errata::NONE, rules: Rules::AsOnTheChip, ..Options::default() };
    Machine::with(image, options, world).expect("the image")
}

/// The host program at the other end of the serial link.
#[derive(Default)]
pub struct SerialLink {
    talk: Talk,
}

impl SerialLink {
    /// Whether the device answers Hello within 0.1 s.
    pub fn hello(&mut self, machine: &mut Machine) -> bool {
        let (id, bytes) = self.talk.request(Command::Hello);
        machine.serial_take();
        machine.serial_send(&bytes);
        machine.run_for(0.1).expect("runs");
        self.talk.take(&machine.serial_take());
        self.talk.reply(id).is_some()
    }
}

/// A byte stream sent to a device, and its expected outcome.
pub struct Item {
    /// Name of the stream.
    pub name: String,
    /// The bytes.
    pub bytes: Vec<u8>,
    /// Expected outcome, as written in the corpus: the number of bad frames, then the ID and outcome of each reply.
    pub expected: String,
}

impl Item {
    /// Whether it contains a request to restart.
    pub fn restarts(&self) -> bool {
        let (mut reader, mut rest) = (FrameReader::<Request>::new(), self.bytes.as_slice());
        std::iter::from_fn(|| reader.read(&mut rest)).any(|frame| {
            let restart = |request: &Request| matches!(request.command, Command::Reboot | Command::EnterDfu);
            matches!(&frame, Frame::Message { message, .. } if restart(message))
        })
    }

    /// The bytes in portions, followed by the delimiter that ends the last frame.
    pub fn portions(&self, size: usize) -> impl Iterator<Item = &[u8]> {
        self.bytes.chunks(size).chain([[DELIMITER].as_slice()])
    }
}

/// The corpus of streams made to break the device. `tests/src/fuzz/corpus.rs` describes its format.
pub fn corpus() -> Vec<Item> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../corpus");
    let mut items = Vec::new();
    for entry in std::fs::read_dir(&folder).expect("tests/corpus") {
        let path = entry.expect("tests/corpus").path();
        if path.extension().is_some_and(|extension| extension == "bin") {
            items.push(Item {
                name: path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
                bytes: std::fs::read(&path).expect("a stream"),
                expected: std::fs::read_to_string(path.with_extension("txt")).expect("what must come of it"),
            });
        }
    }
    items.sort_by(|one, other| one.name.cmp(&other.name));
    items
}
