//! The chip's ROM in update mode, as seen by the host.
//!
//! Input: a byte (bit 0: the ROM's answers come from the input instead of a chip; the other bits: properties of the
//! chip), then the ROM's description of itself, then the answers, or faults: the number of transfers before it (u8) and
//! its kind (u8).
//!
//! As text, the input is also a ROM's description of its flash, which is refused or read without a panic.
//!
//! Properties, whatever the ROM answers: the update ends. It erases and writes only pages of the image, and erases the
//! vectors first. An update of a chip without faults that succeeds leaves the image in flash, and nothing else has
//! changed. An interrupted update leaves no vectors in front of an incomplete image.

use std::{
    cell::{Cell, RefCell},
    collections::HashMap,
    rc::Rc,
    time::Duration,
};

use dfu_core::{DfuIo, DfuProtocol, functional_descriptor::FunctionalDescriptor};
use inerter_device::{
    board::{CODE, PAGE},
    image::Image,
    update::dfuse::{Going, Rom, is_readable},
};

use crate::{csv::show, image, input::Input};

#[allow(dead_code, reason = "this test uses its part")]
#[path = "../../../host-tools/device/src/update/mock.rs"]
mod mock;

use mock::{Chip, LAYOUT, MockError, MockIo};

/// An update of so few pages must end within this number of transfers: each command may wait for 5 s in steps of 1 ms.
const MOST_TRANSFERS: u32 = 200_000;

/// A connection with injected faults, and a log of the requests on it.
struct Line<'a> {
    chip: MockIo,
    protocol: DfuProtocol<Vec<u32>>,
    descriptor: FunctionalDescriptor,
    /// The input provides the answers instead of the chip.
    scripted: bool,
    script: RefCell<Input<'a>>,
    /// Transfers until the next fault.
    left: Cell<u8>,
    transfers: Cell<u32>,
    erased: RefCell<Vec<u32>>,
    written: RefCell<Vec<u32>>,
}

impl Line<'_> {
    fn transfer(&self) -> Option<u8> {
        self.transfers.set(self.transfers.get() + 1);
        assert!(self.transfers.get() < MOST_TRANSFERS, "it does not end");
        let mut script = self.script.borrow_mut();
        if self.scripted || (script.is_empty() && self.left.get() == 0) {
            return None;
        }
        match self.left.get().checked_sub(1) {
            Some(left) => {
                self.left.set(left);
                None
            }
            None => {
                let fault = script.byte();
                self.left.set(script.byte());
                Some(fault)
            }
        }
    }

    fn gone(&self) -> MockError {
        dfu_core::Error::OutOfCapabilities.into()
    }
}

impl DfuIo for Line<'_> {
    type Read = usize;
    type Write = usize;
    type Reset = ();
    type Error = MockError;
    type MemoryLayout = Vec<u32>;

    fn read_control(&self, kind: u8, request: u8, value: u16, into: &mut [u8]) -> Result<usize, MockError> {
        let fault = self.transfer();
        if self.scripted {
            let mut script = self.script.borrow_mut();
            if script.is_empty() {
                return Err(self.gone());
            }
            let count = usize::from(script.byte()).min(into.len());
            // Make a complete answer more likely.
            let count = if count > 8 { into.len() } else { count };
            let bytes = script.take(count);
            into[..bytes.len()].copy_from_slice(bytes);
            return Ok(count);
        }
        let count = self.chip.read_control(kind, request, value, into)?;
        match fault {
            None => Ok(count),
            Some(0..16) => Err(self.gone()),
            Some(16..32) => Ok(count.saturating_sub(1)),
            Some(fault) => {
                let place = usize::from(fault) % count.max(1);
                into[place] ^= fault;
                Ok(count)
            }
        }
    }

    fn write_control(&self, kind: u8, request: u8, value: u16, bytes: &[u8]) -> Result<usize, MockError> {
        match (request, value, bytes) {
            (1, 0, &[0x41, a, b, c, d]) => self.erased.borrow_mut().push(u32::from_le_bytes([a, b, c, d])),
            (1, 0, &[0x21, a, b, c, d]) => self.written.borrow_mut().push(u32::from_le_bytes([a, b, c, d])),
            _ => {}
        }
        let fault = self.transfer();
        if self.scripted {
            return if self.script.borrow().is_empty() { Err(self.gone()) } else { Ok(bytes.len()) };
        }
        match fault {
            Some(0..128) => Err(self.gone()),
            _ => self.chip.write_control(kind, request, value, bytes),
        }
    }

    fn usb_reset(self) -> Result<(), MockError> {
        Ok(())
    }

    fn protocol(&self) -> &DfuProtocol<Vec<u32>> {
        &self.protocol
    }

    fn functional_descriptor(&self) -> &FunctionalDescriptor {
        &self.descriptor
    }
}

fn layout(input: &mut Input) -> Vec<u32> {
    let kind = input.byte();
    let odd = [0, 1, 4 * PAGE, u32::MAX, PAGE - 1, 2 * PAGE][usize::from(input.byte()) % 6];
    match kind % 8 {
        0 => Vec::new(),
        1 => vec![2 * PAGE; 128],
        2 => vec![PAGE; usize::from(input.byte())],
        3 => [vec![PAGE; usize::from(input.byte())], vec![odd; 4]].concat(),
        _ => vec![PAGE; 256],
    }
}

/// An image of this many bytes, cached: parsing takes longer than everything else, and another target covers it.
fn image_of(length: usize) -> Rc<Image> {
    thread_local! {
        static READ: RefCell<HashMap<usize, Rc<Image>>> = RefCell::default();
    }
    let read = || {
        let file = image::image(length, "inerter 0.1.0", "c8a2d5a");
        Rc::new(Image::parse("f.elf".into(), &file).expect("an image"))
    };
    READ.with_borrow_mut(|all| all.entry(length).or_insert_with(read).clone())
}

/// Checks an input.
pub fn check(mut input: Input) {
    if let Ok(description) = str::from_utf8(input.0)
        && is_readable(description)
        && let Ok(DfuProtocol::Dfuse { memory_layout, .. }) = DfuProtocol::new(description, (1, 0x1A))
    {
        assert!(memory_layout.len() < 1 << 16, "{description}");
    }
    let kind = input.byte();
    let [scripted, upload, leaves, told, hangs] = [0, 1, 2, 3, 4].map(|bit| kind >> bit & 1 == 1);
    let image = image_of(1 + usize::from(input.half() % 9_000));
    let chip = Chip::new();
    let before = chip.borrow().flash.clone();
    let interrupted_ms = input.half();
    {
        let mut chip = chip.borrow_mut();
        chip.transfer_size = [2_048, 1_024, 64, 8, 2_047, 0, 4_096, 24][usize::from(input.byte()) % 8];
        chip.leaves_at_once = leaves;
        chip.hangs = hangs;
        chip.told = if told { None } else { Some((512, 0xFFEF_F8AA)) };
        chip.busy = Duration::from_millis(22);
        if interrupted_ms != 0 {
            chip.interrupted_at = Duration::from_millis(interrupted_ms.into());
        }
        match input.byte() {
            place @ 1..=8 => {
                let page = CODE.start + (u32::from(place) - 1) * PAGE;
                chip.protected = page..page + PAGE;
            }
            place @ 9..=16 => chip.worn = Some(CODE.start + u32::from(place) * 700),
            17 => chip.told = Some((128, 0xFFEF_F8AA)),
            18 => chip.told = Some((512, 0xFFEF_F8AA & !(1 << 22))),
            _ => {}
        }
    }
    let layout = layout(&mut input);
    let address = if input.byte() == 0xFF { 0x0800_4000 } else { CODE.start };
    let mock = MockIo::new(&chip, LAYOUT);
    let descriptor = FunctionalDescriptor { can_upload: !upload, ..mock.descriptor };
    let faultless = !scripted && input.is_empty();
    let line = Line {
        chip: mock,
        protocol: DfuProtocol::Dfuse { address, memory_layout: layout },
        descriptor,
        scripted,
        left: Cell::new(if scripted { 0 } else { input.byte() }),
        script: RefCell::new(input),
        transfers: Cell::new(0),
        erased: RefCell::default(),
        written: RefCell::default(),
    };
    let slept = Cell::new(Duration::ZERO);
    let mut sleep = |time| {
        slept.set(slept.get() + time);
        let mut chip = chip.borrow_mut();
        chip.clock += time;
        if chip.clock < chip.interrupted_at { Going::On } else { Going::Stop }
    };
    let result = Rom::new(&line, &mut sleep).program(&image, &mut |_, done, all| {
        assert!(done <= all);
        Going::On
    });
    let pages: Vec<u32> = image.pages().map(|(address, _)| address).collect();
    let (erased, written) = (line.erased.into_inner(), line.written.into_inner());
    assert!(erased.iter().all(|page| pages.contains(page)), "{erased:08X?}");
    assert!(erased.first().is_none_or(|first| *first == CODE.start), "the vectors go first");
    // The page of the vectors is first written from behind the vectors.
    let is_place = |address: &u32| pages.contains(address) || *address == CODE.start + 8;
    let mut in_code = written.iter().filter(|address| CODE.contains(address));
    assert!(in_code.all(is_place), "{written:08X?}");
    let chip = chip.borrow();
    for (start, (now, then)) in
        (CODE.start..).step_by(PAGE as usize).zip(chip.flash.chunks(2_048).zip(before.chunks(2_048)))
    {
        let is_worn = chip.worn.is_some_and(|worn| (start..start + PAGE).contains(&worn));
        assert!(pages.contains(&start) || is_worn || now == then, "0x{start:08X} has changed");
    }
    let holds = image.pages().all(|(address, bytes)| chip.bytes(address, bytes.len()) == bytes);
    match result {
        Ok(()) => assert!(!faultless || upload || holds, "it says that the image is there"),
        Err(error) => {
            show(&error);
            let vectors = chip.bytes(CODE.start, 8);
            assert!(
                scripted || holds || vectors == &before[..8] || vectors == [0xFF; 8] || chip.worn.is_some(),
                "half an image would run"
            );
        }
    }
}

/// Successful updates, chips of all kinds, and scripted answers.
pub fn seeds() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    // Kind, length, time of the interruption, transfer size, fault of the chip, layout, address.
    let head =
        |kind: u8, size: u8, chip: u8, layout: [u8; 2]| [&[kind, 0, 20, 0, 0, size, chip][..], &layout, &[0]].concat();
    for size in 0..8 {
        seeds.push(head(0, size, 0, [7, 0]));
    }
    for kind in [2, 4, 8, 16, 30] {
        seeds.push(head(kind, 0, 0, [7, 0]));
    }
    for chip in [1, 3, 9, 12, 17, 18] {
        seeds.push(head(0, 0, chip, [7, 0]));
    }
    for layout in 0..4 {
        seeds.push([head(0, 0, 0, [layout, 2]), vec![90]].concat());
    }
    for faults in [[5, 0, 9, 0], [20, 40, 3, 200], [60, 17, 60, 130], [200, 90, 1, 1]] {
        seeds.push([&head(0, 0, 0, [7, 0])[..], &faults].concat());
    }
    // Complete answers: status, 3 bytes of time, state, string index.
    for states in [&[2u8, 2, 2, 2, 2, 5, 5, 5, 2][..], &[10, 2, 3, 4, 5, 9, 2], &[6, 7, 8, 2, 4, 5], &[0, 1, 11, 2]] {
        let answers: Vec<u8> = states.iter().flat_map(|&state| [255, 0, 1, 0, 0, state, 0]).collect();
        seeds.push([&head(1, 0, 0, [7, 0])[..], &answers.repeat(4)].concat());
    }
    seeds.push(LAYOUT.into());
    seeds
}
