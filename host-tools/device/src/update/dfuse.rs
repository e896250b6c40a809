//! The chip's ROM in update mode: ST's extension of USB DFU, over [`dfu_core::DfuIo`].
//!
//! - *block*: the data of one transfer, at most [`FunctionalDescriptor::transfer_size`] bytes; block `n` goes to the
//!   address pointer + (n - 2) x transfer size, and n = 0 carries a command.
//! - The ROM executes a command or block when the host requests the status after it; the answer says how long to wait.
//!
//! The first page holds the vectors. It is erased before all others and written after them, and the vectors are written
//! last, in a separate transfer. So a partial image never runs, whenever power is lost. After any interruption the same
//! sequence starts over. Sources: USB DFU 1.1; UM0424 (DfuSe); AN3156 (the protocol of the ROM).
//!
//! [`FunctionalDescriptor::transfer_size`]: dfu_core::functional_descriptor::FunctionalDescriptor::transfer_size

use std::{fmt::Display, time::Duration};

use dfu_core::{DfuIo, DfuProtocol, State, Status};

use super::error::UpdateError;
use crate::{
    board::{CODE, DBANK, FLASH_KB, FLASH_KB_ADDRESS, OPTION_BYTES, PAGE},
    error::DeviceError,
    image::Image,
};

/// Whether to continue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Going {
    /// Continue.
    On,
    /// The user wants to stop.
    Stop,
}

/// Longest description of a flash that is read \[bytes\], and largest number in its list of pages.
const MOST: (usize, u16) = (128, 2048);

/// Whether dfu-core can read a ROM's description of its flash, such as `@Internal Flash   /0x08000000/256*02Kg`: it
/// panics where the text is not ASCII or a size overflows, and allocates as many pages as the text says.
pub fn is_readable(description: &str) -> bool {
    let pages = description.rsplit('/').next().unwrap_or_default();
    let mut numbers = pages.split(|letter: char| !letter.is_ascii_digit()).filter(|number| !number.is_empty());
    let is_small = |number: &str| number.parse::<u16>().is_ok_and(|number| number <= MOST.1);
    description.is_ascii() && description.len() <= MOST.0 && numbers.all(is_small)
}

/// Class request to an interface, host to device (USB 2.0, 9.3).
const OUT: u8 = 0x21;
/// Class request to an interface, device to host.
const IN: u8 = 0xA1;
const DNLOAD: u8 = 1;
const UPLOAD: u8 = 2;
const GETSTATUS: u8 = 3;
const CLRSTATUS: u8 = 4;
const ABORT: u8 = 6;
/// Commands in block 0 (AN3156, 5).
const SET_ADDRESS: u8 = 0x21;
const ERASE: u8 = 0x41;
/// The bytes without which nothing boots: initial stack pointer and reset vector, one double word, which is programmed
/// whole or not at all (RM0440 3.3.7).
const VECTORS: usize = 8;
/// Number of the block that goes to the address pointer itself.
const FIRST_BLOCK: u16 = 2;
/// Longest time for one page: the data sheet allows 25 ms to erase or to program one.
const PATIENCE: Duration = Duration::from_secs(5);
/// Wait between two status requests if the ROM asks for 0, so that a stuck ROM is noticed in time.
const LEAST_WAIT: Duration = Duration::from_millis(1);
/// Longest wait between two checks for an interrupt.
const SLICE: Duration = Duration::from_millis(200);
/// Attempts to reach the idle state from any other.
const ATTEMPTS: usize = 10;

/// Progress of an update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Pages erased and written.
    Writing,
    /// Pages read back.
    Checking,
}

/// A ROM bootloader in update mode.
pub struct Rom<'a, Io> {
    io: &'a Io,
    sleep: &'a mut dyn FnMut(Duration) -> Going,
    /// The vectors have been erased and not yet rewritten: the flash holds no complete firmware.
    broken: bool,
}

/// An answer to GETSTATUS.
struct Answer {
    status: Status,
    wait: Duration,
    state: State,
}

impl<'a, Io: DfuIo<Read = usize, Write = usize, Error: Display>> Rom<'a, Io> {
    /// The ROM behind `io`; `sleep` waits for the given time and returns whether to continue.
    pub fn new(io: &'a Io, sleep: &'a mut dyn FnMut(Duration) -> Going) -> Self {
        Self { io, sleep, broken: false }
    }

    /// Whether the flash holds complete firmware: none was erased, or all of it is written.
    pub fn is_whole(&self) -> bool {
        !self.broken
    }

    /// Writes the image, verifies it and starts it. `progress` gets the pages done and the total; its return value is
    /// obeyed between pages.
    pub fn program(
        &mut self,
        image: &Image,
        progress: &mut dyn FnMut(Stage, usize, usize) -> Going,
    ) -> Result<(), UpdateError> {
        self.check_flash(image)?;
        self.idle("preparing")?;
        self.check_chip()?;
        let all = image.page_count();
        let mut going = |stage, done| match progress(stage, done, all) {
            Going::On => Ok(()),
            Going::Stop => Err(UpdateError::Interrupted),
        };
        let (first, rest): (Vec<_>, Vec<_>) = image.pages().partition(|(address, _)| *address == CODE.start);
        for (address, _) in &first {
            self.erase(*address)?;
        }
        for (done, (address, bytes)) in rest.iter().enumerate() {
            going(Stage::Writing, done)?;
            self.erase(*address)?;
            self.write(*address, bytes)?;
        }
        let can_check = self.io.functional_descriptor().can_upload;
        if can_check {
            for (done, (address, bytes)) in rest.iter().enumerate() {
                going(Stage::Checking, done)?;
                self.check(*address, bytes)?;
            }
        }
        for (address, bytes) in &first {
            let (vectors, code) = bytes.split_at(VECTORS);
            self.write(*address + VECTORS as u32, code)?;
            self.write(*address, vectors)?;
            if can_check {
                self.check(*address, bytes)?;
            }
        }
        self.broken = false;
        let _ = progress(Stage::Checking, all, all);
        self.leave()
    }

    /// Compares the flash that the ROM describes with what the image needs.
    fn check_flash(&self, image: &Image) -> Result<(), UpdateError> {
        let other = |what: String| UpdateError::OtherChip { what };
        let DfuProtocol::Dfuse { address, memory_layout } = self.io.protocol() else {
            return Err(other("it does not speak ST's form of DFU".into()));
        };
        if *address != CODE.start {
            return Err(other(format!("its flash begins at 0x{address:08X}")));
        }
        let descriptor = self.io.functional_descriptor();
        if !descriptor.can_download || descriptor.transfer_size < 8 || !descriptor.transfer_size.is_multiple_of(8) {
            return Err(other("it does not accept firmware".into()));
        }
        let sizes: &[u32] = memory_layout.as_ref();
        let kb = sizes.iter().fold(0u32, |sum, size| sum.saturating_add(*size)) / 1024;
        let mut page_start = *address;
        let mut sizes = sizes.iter().copied();
        let mut page_after = |start: u32| {
            check_page(sizes.next().unwrap_or(0), start, kb)?;
            Ok::<_, UpdateError>(start.saturating_add(PAGE))
        };
        for (wanted, _) in image.pages() {
            while page_start < wanted {
                page_start = page_after(page_start)?;
            }
            if page_start != wanted {
                return Err(UpdateError::SingleBank { address: wanted, size: page_start - wanted });
            }
            page_start = page_after(page_start)?;
        }
        if kb < FLASH_KB.into() { Err(UpdateError::SmallFlash { kb }) } else { Ok(()) }
    }

    /// Compares what the chip reports about itself with what the image needs, if the ROM allows reading it.
    ///
    /// The ROM's description of the flash may be that of the die, not of this chip.
    fn check_chip(&mut self) -> Result<(), UpdateError> {
        let action = "identifying the chip";
        if let Some([low, high, ..]) = self.peek(FLASH_KB_ADDRESS as u32, action)? {
            let kb = u16::from_le_bytes([low, high]);
            // An address that does not exist reads as zeros or ones.
            if (1..FLASH_KB).contains(&kb) {
                return Err(UpdateError::SmallFlash { kb: kb.into() });
            }
        }
        if let Some([a, b, c, d, inverse @ ..]) = self.peek(OPTION_BYTES, action)? {
            let options = u32::from_le_bytes([a, b, c, d]);
            if options == !u32::from_le_bytes(inverse) && options & DBANK == 0 {
                return Err(UpdateError::SingleBank { address: CODE.start, size: 2 * PAGE });
            }
        }
        Ok(())
    }

    /// The double word at an address, or `None` if the ROM does not allow reading there.
    fn peek(&mut self, address: u32, action: &str) -> Result<Option<[u8; 8]>, UpdateError> {
        if !self.io.functional_descriptor().can_upload {
            return Ok(None);
        }
        match self.command(SET_ADDRESS, address, action) {
            Err(UpdateError::Refused { .. }) => return self.idle(action).map(|()| None),
            result => result?,
        }
        self.idle(action)?;
        let mut bytes = [0; 8];
        let read = self.io.read_control(IN, UPLOAD, FIRST_BLOCK, &mut bytes);
        // If the ROM is gone, this call reports it.
        self.idle(action)?;
        Ok(read.ok().filter(|count| *count == bytes.len()).map(|_| bytes))
    }

    fn erase(&mut self, address: u32) -> Result<(), UpdateError> {
        self.broken = true;
        self.command(ERASE, address, &format!("erasing 0x{address:08X}"))
    }

    fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), UpdateError> {
        let action = format!("writing 0x{address:08X}");
        self.command(SET_ADDRESS, address, &action)?;
        let size = usize::from(self.io.functional_descriptor().transfer_size);
        for (block, portion) in (FIRST_BLOCK..).zip(bytes.chunks(size)) {
            self.out(DNLOAD, block, portion, &action)?;
            self.finish(State::DfuDnloadIdle, &action)?;
        }
        Ok(())
    }

    fn check(&mut self, address: u32, bytes: &[u8]) -> Result<(), UpdateError> {
        let action = format!("reading 0x{address:08X}");
        self.command(SET_ADDRESS, address, &action)?;
        // Reading is possible only from the idle state.
        self.idle(&action)?;
        let size = usize::from(self.io.functional_descriptor().transfer_size);
        let mut place = address;
        for (block, portion) in (FIRST_BLOCK..).zip(bytes.chunks(size)) {
            let mut read = vec![0; portion.len()];
            let count = self.io.read_control(IN, UPLOAD, block, &mut read).map_err(|error| lost(&action, &error))?;
            if count != portion.len() {
                return Err(lost(&action, &format!("{count} bytes came instead of {}", portion.len())));
            }
            for ((wanted, got), address) in portion.iter().zip(&read).zip(place..) {
                if wanted != got {
                    return Err(UpdateError::Verify { address, wanted: *wanted, got: *got });
                }
            }
            place += portion.len() as u32;
        }
        self.idle(&action)
    }

    /// Starts the firmware in flash, without writing anything.
    pub fn start(&mut self) -> Result<(), UpdateError> {
        self.idle("preparing")?;
        self.leave()
    }

    /// Makes the ROM start the firmware in flash. The ROM may be gone before it can answer, which is not an error.
    fn leave(&mut self) -> Result<(), UpdateError> {
        let action = "starting the firmware";
        self.command(SET_ADDRESS, CODE.start, action)?;
        self.out(DNLOAD, 0, &[], action)?;
        let _ = self.status(action);
        Ok(())
    }

    fn command(&mut self, command: u8, address: u32, action: &str) -> Result<(), UpdateError> {
        let [a, b, c, d] = address.to_le_bytes();
        self.out(DNLOAD, 0, &[command, a, b, c, d], action)?;
        self.finish(State::DfuDnloadIdle, action)
    }

    /// Makes the ROM execute the pending operation, until it reaches the state `end`.
    fn finish(&mut self, end: State, action: &str) -> Result<(), UpdateError> {
        let mut waited = Duration::ZERO;
        loop {
            let answer = self.status(action)?;
            if answer.status != Status::Ok || answer.state == State::DfuError {
                return Err(UpdateError::Refused {
                    action: action.into(),
                    status: status_words(answer.status),
                    // The ROM's answer if flash is protected (AN3156, 4.2).
                    protected: answer.status == Status::ErrVendor,
                });
            }
            if answer.state == end {
                return Ok(());
            }
            if waited >= PATIENCE || !matches!(answer.state, State::DfuDnbusy | State::DfuDnloadSync) {
                return Err(stuck(action, answer.state));
            }
            waited += self.wait(answer.wait)?;
        }
    }

    /// Waits as long as the ROM asks for, within limits, or less if the user wants to stop; returns how long.
    fn wait(&mut self, asked: Duration) -> Result<Duration, UpdateError> {
        let all = asked.clamp(LEAST_WAIT, PATIENCE);
        let mut left = all;
        while !left.is_zero() {
            let slice = left.min(SLICE);
            if (self.sleep)(slice) == Going::Stop {
                return Err(if self.broken { UpdateError::Interrupted } else { DeviceError::Interrupted.into() });
            }
            left -= slice;
        }
        Ok(all)
    }

    /// Brings the ROM into the idle state, whatever it was left in.
    fn idle(&mut self, action: &str) -> Result<(), UpdateError> {
        let mut state = State::DfuIdle;
        for _ in 0..ATTEMPTS {
            let answer = self.status(action)?;
            state = answer.state;
            match state {
                State::DfuIdle => return Ok(()),
                State::DfuError => self.out(CLRSTATUS, 0, &[], action)?,
                State::DfuDnbusy | State::DfuDnloadSync | State::DfuManifestSync | State::DfuManifest => {
                    self.wait(answer.wait)?;
                }
                _ => self.out(ABORT, 0, &[], action)?,
            }
        }
        Err(stuck(action, state))
    }

    fn status(&mut self, action: &str) -> Result<Answer, UpdateError> {
        let mut bytes = [0; 6];
        let count = self.io.read_control(IN, GETSTATUS, 0, &mut bytes).map_err(|error| lost(action, &error))?;
        let [status, low, middle, high, state, _] = bytes;
        if count != bytes.len() {
            return Err(lost(action, &"its status is cut off"));
        }
        let wait = Duration::from_millis(u32::from_le_bytes([low, middle, high, 0]).into());
        Ok(Answer { status: status.into(), wait, state: state.into() })
    }

    fn out(&mut self, request: u8, value: u16, bytes: &[u8], action: &str) -> Result<(), UpdateError> {
        self.io.write_control(OUT, request, value, bytes).map(drop).map_err(|error| lost(action, &error))
    }
}

/// Checks the size of the page at an address; 0 beyond the end of the flash, which has this many KB.
fn check_page(size: u32, start: u32, kb: u32) -> Result<(), UpdateError> {
    match size {
        PAGE => Ok(()),
        0 => Err(UpdateError::SmallFlash { kb }),
        // Our chip in single-bank mode has pages of 4 KB.
        _ if size == 2 * PAGE => Err(UpdateError::SingleBank { address: start, size }),
        _ => Err(UpdateError::OtherChip { what: format!("it erases {size} bytes at 0x{start:08X} at once") }),
    }
}

fn lost(action: &str, error: &dyn Display) -> UpdateError {
    UpdateError::Lost { action: action.into(), reason: error.to_string() }
}

fn stuck(action: &str, state: State) -> UpdateError {
    UpdateError::Stuck { action: action.into(), seconds: PATIENCE.as_secs(), state: format!("{state:?}") }
}

fn status_words(status: Status) -> String {
    match status {
        Status::ErrVendor => "the address is protected (errVENDOR)".into(),
        Status::ErrTarget | Status::ErrAddress => format!("it knows no such address ({status:?})"),
        Status::ErrWrite | Status::ErrProg => format!("it cannot write there ({status:?})"),
        Status::ErrErase | Status::ErrCheckErased => format!("it cannot erase there ({status:?})"),
        other => other.to_string().trim_end_matches('.').to_string(),
    }
}

#[cfg(test)]
#[path = "dfuse_tests.rs"]
mod tests;
