//! DfuSe: the boot loader's class requests (AN3156; UM0424; USB DFU 1.1).
//!
//! A command or block is executed when the host requests the status after it. System memory and option bytes are
//! read-only. Not modelled: programming of option bytes, one-time programmable memory, mass erase, read protection.

use crate::Cycles;
use crate::chip::flash::{self, Flash, PAGE};
use std::collections::VecDeque;

/// Size of a block \[bytes\].
pub const BLOCK: usize = 2048;
/// Requests (USB DFU 1.1, 3).
const DNLOAD: u8 = 1;
const UPLOAD: u8 = 2;
const GETSTATUS: u8 = 3;
const CLRSTATUS: u8 = 4;
const GETSTATE: u8 = 5;
const ABORT: u8 = 6;
/// Commands of block 0 (AN3156 5).
const SET_ADDRESS: u8 = 0x21;
const ERASE: u8 = 0x41;
/// Commands that GET reports: get, set address, erase.
const COMMANDS: [u8; 3] = [0x00, SET_ADDRESS, ERASE];
/// Number of the block at the address pointer.
const FIRST_BLOCK: u16 = 2;

const ERR_TARGET: u8 = 1;
const ERR_PROG: u8 = 6;
const ERR_STALLED: u8 = 15;

/// bwPollTimeout \[ms\], rounded up from DS12288: a page takes 22 ms, a block of 256 double words 22 ms.
const WAIT_MS: u8 = 25;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    #[default]
    Idle = 2,
    DownloadSync = 3,
    Busy = 4,
    DownloadIdle = 5,
    ManifestSync = 6,
    Manifest = 7,
    UploadIdle = 9,
    Error = 10,
}

/// The state between two requests.
#[derive(Clone, Debug)]
pub struct Dfu {
    state: State,
    status: u8,
    pointer: u32,
    /// The block to execute at the next request for the status: its number and data.
    job: Option<(u16, Vec<u8>)>,
    /// Double words still to be programmed, with their addresses.
    writing: VecDeque<(u32, u64)>,
}

impl Default for Dfu {
    /// The address pointer starts at the beginning of flash, as in AN3156.
    fn default() -> Self {
        Self { state: State::Idle, status: 0, pointer: flash::START, job: None, writing: VecDeque::new() }
    }
}

impl Dfu {
    /// Whether the host has been told that the program starts.
    pub fn leaves(&self) -> bool {
        self.state == State::Manifest
    }

    /// A request with its data for the device; returns the data for the host. `None` if it is refused.
    pub fn request(
        &mut self,
        request: u8,
        block: u16,
        data: &[u8],
        length: usize,
        flash: &mut Flash,
        now: Cycles,
    ) -> Option<Vec<u8>> {
        match (request, self.state) {
            (GETSTATUS, _) => Some(self.status(flash, now)),
            (GETSTATE, state) => Some(vec![state as u8]),
            (CLRSTATUS, State::Error) => {
                (self.state, self.status) = (State::Idle, 0);
                Some(Vec::new())
            }
            (ABORT, State::Idle | State::DownloadSync | State::DownloadIdle | State::UploadIdle) => {
                (self.state, self.job) = (State::Idle, None);
                Some(Vec::new())
            }
            (DNLOAD, State::Idle | State::DownloadIdle) => self.download(block, data),
            (UPLOAD, State::Idle | State::UploadIdle) => self.upload(block, length, flash),
            _ => self.refuse(),
        }
    }

    /// Continues the operation in progress.
    pub fn work(&mut self, flash: &mut Flash, now: Cycles) {
        if self.state != State::Busy || flash.is_busy(now) {
            return;
        }
        if let Some((address, word)) = self.writing.pop_front()
            && !flash.rom_program(address, word, now)
        {
            self.fail(ERR_PROG);
        }
    }

    fn refuse(&mut self) -> Option<Vec<u8>> {
        self.fail(ERR_STALLED);
        None
    }

    fn fail(&mut self, status: u8) {
        (self.state, self.status) = (State::Error, status);
        self.writing.clear();
    }

    fn block_address(&self, block: u16) -> u32 {
        self.pointer.wrapping_add(u32::from(block - FIRST_BLOCK) * BLOCK as u32)
    }

    fn download(&mut self, block: u16, data: &[u8]) -> Option<Vec<u8>> {
        self.state = match (block, data) {
            (_, []) => State::ManifestSync,
            (0, [SET_ADDRESS | ERASE, _, _, _, _]) | (FIRST_BLOCK.., _) => State::DownloadSync,
            _ => return self.refuse(),
        };
        self.job = Some((block, data.to_vec()));
        Some(Vec::new())
    }

    fn upload(&mut self, block: u16, length: usize, flash: &Flash) -> Option<Vec<u8>> {
        if block == 0 {
            return Some(COMMANDS.to_vec());
        }
        let address = (block >= FIRST_BLOCK).then(|| self.block_address(block));
        match address.and_then(|address| flash.rom_read(address, length)) {
            Some(bytes) => {
                self.state = State::UploadIdle;
                Some(bytes)
            }
            None => self.refuse(),
        }
    }

    fn status(&mut self, flash: &mut Flash, now: Cycles) -> Vec<u8> {
        let mut wait = 0;
        match self.state {
            State::DownloadSync => {
                self.state = State::Busy;
                self.begin(flash, now);
                wait = WAIT_MS;
            }
            State::Busy if self.writing.is_empty() && !flash.is_busy(now) => self.state = State::DownloadIdle,
            State::Busy => wait = 1,
            State::ManifestSync => self.state = State::Manifest,
            _ => {}
        }
        vec![self.status, wait, 0, 0, self.state as u8, 0]
    }

    fn begin(&mut self, flash: &mut Flash, now: Cycles) {
        let Some((block, data)) = self.job.take() else { return };
        let address = match data[..] {
            [_, a, b, c, d] if block == 0 => u32::from_le_bytes([a, b, c, d]),
            _ => self.block_address(block),
        };
        match (block, data[0]) {
            (0, SET_ADDRESS) if flash.rom_read(address, 1).is_some() => self.pointer = address,
            (0, ERASE) if flash.holds(address, 1) => {
                flash.rom_erase((address - flash::START) as usize / PAGE, now);
            }
            (FIRST_BLOCK.., _) if flash.holds(address, data.len()) => {
                // The rest of the last double word stays erased.
                let words = data.chunks(8).map(|chunk| {
                    let mut bytes = [0xff; 8];
                    bytes[..chunk.len()].copy_from_slice(chunk);
                    u64::from_le_bytes(bytes)
                });
                self.writing = (address..).step_by(8).zip(words).collect();
            }
            _ => self.fail(ERR_TARGET),
        }
    }
}
