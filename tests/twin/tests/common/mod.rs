//! What the tests of the twin share: the board on the bench and its links.

use inerter_twin::World;
use inerter_twin::chip::{errata::Errata, rules::Rules};
use inerter_twin::machine::{Machine, Options, image_in, shipping_image};
use inerter_twin::talk::Talk;
use inerter_twin::usb_link::UsbLink;
use inerter_wire::{Command, DELIMITER, Frame, FrameReader, Request};
use std::path::Path;

/// From power-on until the firmware runs.
const START_S: f64 = 0.3;

/// The board, powered and started, with nothing plugged in; nothing where there is no image, after saying so.
pub fn board(world: impl World + 'static) -> Option<UsbLink<Machine>> {
    let mut machine = Machine::new(&shipping_image()?, Box::new(world)).expect("the image");
    machine.run_for(START_S).unwrap_or_else(|ended| panic!("{ended}"));
    Some(UsbLink::new(machine))
}

/// A program of the folder `foreign`; nothing where it is not built, after saying so.
pub fn image_of_others(name: &str) -> Option<Vec<u8>> {
    image_in("INERTER_FOREIGN", &format!("release/foreign-{name}"))
}

/// The chip with such a program.
pub fn chip_with(image: &[u8], world: impl World + 'static) -> Machine {
    // Errata are at their worst here, which no real chip is.
    let options = Options { errata: Errata::NONE, rules: Rules::AsOnTheChip, ..Options::default() };
    Machine::with(image, options, Box::new(world)).expect("the image")
}

/// A host's program at the other end of the serial link.
#[derive(Default)]
pub struct SerialLink {
    talk: Talk,
}

impl SerialLink {
    /// Whether the device answers to Hello within a tenth of a second.
    pub fn hello(&mut self, machine: &mut Machine) -> bool {
        let (id, bytes) = self.talk.request(Command::Hello);
        machine.serial_take();
        machine.serial_send(&bytes);
        machine.run_for(0.1).expect("runs");
        self.talk.take(&machine.serial_take());
        self.talk.reply(id).is_some()
    }
}

/// A stream of bytes for a device, and what must come of it.
pub struct Item {
    /// What it is.
    pub name: String,
    /// The bytes.
    pub bytes: Vec<u8>,
    /// What must come of it, as it is written in the corpus: bad frames, then id and outcome of each reply.
    pub expected: String,
}

impl Item {
    /// Whether it holds a request to restart.
    pub fn restarts(&self) -> bool {
        let (mut reader, mut rest) = (FrameReader::<Request>::new(), self.bytes.as_slice());
        std::iter::from_fn(|| reader.read(&mut rest)).any(|frame| {
            let restart = |request: &Request| matches!(request.command, Command::Reboot | Command::EnterDfu);
            matches!(&frame, Frame::Message { message, .. } if restart(message))
        })
    }

    /// The bytes in portions, with the delimiter that ends the last frame.
    pub fn portions(&self, size: usize) -> impl Iterator<Item = &[u8]> {
        self.bytes.chunks(size).chain([[DELIMITER].as_slice()])
    }
}

/// The corpus of streams that were made to break the device; its form is told in `tests/src/fuzz/corpus.rs`.
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
