//! The ROM in update mode, as AN3156 and USB DFU 1.1 describe it, with simulated faults.

use std::{cell::RefCell, ops::Range, rc::Rc, sync::LazyLock, time::Duration};

use dfu_core::{DfuIo, DfuProtocol, functional_descriptor::FunctionalDescriptor, memory_layout::MemoryLayout};

use crate::board::{FLASH_KB_ADDRESS, OPTION_BYTES};

/// The ROM's description of the flash of the board's chip.
pub const LAYOUT: &str = "@Internal Flash   /0x08000000/256*02Kg";
const FLASH: u32 = 0x0800_0000;
const SIZE: usize = 512 * 1024;

const ERR_TARGET: u8 = 1;
const ERR_PROG: u8 = 6;
const ERR_VENDOR: u8 = 11;
const ERR_STALLED: u8 = 15;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Idle = 2,
    DownloadSync = 3,
    Busy = 4,
    DownloadIdle = 5,
    ManifestSync = 6,
    Manifest = 7,
    UploadIdle = 9,
    Error = 10,
}

/// Old firmware and settings: made once, because fuzzing creates thousands of chips.
static OLD: LazyLock<Vec<u8>> =
    LazyLock::new(|| (0..SIZE as u32).map(|place| (place.wrapping_mul(0x85EB_CA6B) >> 24) as u8).collect());

enum Job {
    SetAddress(u32),
    Erase(u32),
    Write(u32, Vec<u8>),
}

/// The chip: its flash outlives a connection.
pub struct Chip {
    pub flash: Vec<u8>,
    /// Pages erased, in order.
    pub erased: Vec<u32>,
    /// Whether the ROM was told to start the firmware.
    pub left: bool,
    /// Time that has passed.
    pub clock: Duration,
    /// Time at which the user wants to end.
    pub interrupted_at: Duration,
    /// Duration of an erase; everything else takes a tenth of it.
    pub busy: Duration,
    /// Transfers until the cable is pulled.
    pub transfers_left: usize,
    /// Double words until power fails.
    pub words_left: usize,
    /// The flash size (KB) in system memory, and the option bytes; `None` if the ROM does not allow reading them.
    pub told: Option<(u16, u32)>,
    /// Write-protected range of flash.
    pub protected: Range<u32>,
    /// A cell with a bit stuck at 0.
    pub worn: Option<u32>,
    /// Never finishes an operation.
    pub hangs: bool,
    /// Gone before it can answer the request to leave.
    pub leaves_at_once: bool,
    pub transfer_size: u16,
    state: State,
    status: u8,
    job: Option<Job>,
    ready: Duration,
    pointer: u32,
}

impl Chip {
    /// A chip whose flash holds old firmware and settings.
    pub fn new() -> Rc<RefCell<Self>> {
        Rc::new(RefCell::new(Self {
            flash: OLD.clone(),
            erased: Vec::new(),
            left: false,
            clock: Duration::ZERO,
            interrupted_at: Duration::MAX,
            busy: Duration::from_millis(22),
            transfers_left: usize::MAX,
            words_left: usize::MAX,
            told: Some((512, 0xFFEF_F8AA)),
            protected: 0..0,
            worn: None,
            hangs: false,
            leaves_at_once: false,
            transfer_size: 2048,
            state: State::Idle,
            status: 0,
            job: None,
            ready: Duration::ZERO,
            pointer: 0,
        }))
    }

    pub fn bytes(&self, address: u32, length: usize) -> &[u8] {
        let start = (address - FLASH) as usize;
        self.flash.get(start..start + length).unwrap()
    }

    /// A restart into the ROM: the flash is unchanged.
    pub fn restart(&mut self) {
        (self.state, self.status, self.job, self.pointer) = (State::Idle, 0, None, 0);
        (self.left, self.transfers_left, self.words_left) = (false, usize::MAX, usize::MAX);
        self.erased.clear();
    }

    fn transfer(&mut self) -> Result<(), MockError> {
        self.transfers_left = self.transfers_left.checked_sub(1).ok_or(MockError("no such device".into()))?;
        if self.left { Err(MockError("no such device".into())) } else { Ok(()) }
    }

    fn stall(&mut self) -> MockError {
        (self.state, self.status) = (State::Error, ERR_STALLED);
        MockError("endpoint stalled".into())
    }

    fn block_address(&self, block: u16) -> u32 {
        self.pointer + u32::from(block - 2) * u32::from(self.transfer_size)
    }

    fn download(&mut self, block: u16, bytes: &[u8]) -> Result<(), MockError> {
        if !matches!(self.state, State::Idle | State::DownloadIdle) || bytes.len() > usize::from(self.transfer_size) {
            return Err(self.stall());
        }
        let address = || u32::from_le_bytes(bytes.get(1..5).unwrap().try_into().unwrap());
        self.job = match (block, bytes) {
            (_, []) => {
                self.state = State::ManifestSync;
                return Ok(());
            }
            (0, [0x21, _, _, _, _]) => Some(Job::SetAddress(address())),
            (0, [0x41, _, _, _, _]) => Some(Job::Erase(address())),
            (2.., _) => Some(Job::Write(self.block_address(block), bytes.to_vec())),
            _ => return Err(self.stall()),
        };
        self.state = State::DownloadSync;
        Ok(())
    }

    fn get_status(&mut self) -> Result<[u8; 6], MockError> {
        match self.state {
            State::DownloadSync => {
                let fraction = if matches!(self.job, Some(Job::Erase(_))) { 1 } else { 10 };
                self.ready = self.clock + self.busy / fraction;
                self.state = State::Busy;
            }
            State::Busy if self.clock >= self.ready && !self.hangs => {
                let job = self.job.take();
                self.status = job.map_or(0, |job| self.carry_out(job));
                self.state = if self.status == 0 { State::DownloadIdle } else { State::Error };
            }
            State::ManifestSync => {
                self.left = true;
                if self.leaves_at_once {
                    return Err(MockError("no such device".into()));
                }
                self.state = State::Manifest;
            }
            _ => {}
        }
        let wait = self.ready.saturating_sub(self.clock).as_millis() as u32;
        let [low, middle, high, _] = wait.to_le_bytes();
        Ok([self.status, low, middle, high, self.state as u8, 0])
    }

    fn carry_out(&mut self, job: Job) -> u8 {
        let inside = |address: u32, length: usize| {
            let start = address.checked_sub(FLASH).map(|start| start as usize);
            start.filter(|start| start + length <= SIZE)
        };
        match job {
            Job::SetAddress(address) => {
                self.pointer = address;
                if inside(address, 1).is_some() || self.system_memory(address).is_some() { 0 } else { ERR_TARGET }
            }
            Job::Erase(address) => {
                let page = address - address % 2048;
                let Some(start) = inside(page, 2048) else { return ERR_TARGET };
                if self.protected.contains(&page) {
                    return ERR_VENDOR;
                }
                self.erased.push(page);
                self.flash.get_mut(start..start + 2048).unwrap().fill(0xFF);
                0
            }
            Job::Write(address, bytes) => {
                let Some(start) = inside(address, bytes.len()) else { return ERR_TARGET };
                if self.protected.contains(&address) {
                    return ERR_VENDOR;
                }
                // Only whole, erased double words can be programmed (RM0440 3.3.7).
                let place = self.flash.get_mut(start..start + bytes.len()).unwrap();
                if address % 8 != 0 || bytes.len() % 8 != 0 || place.iter().any(|byte| *byte != 0xFF) {
                    return ERR_PROG;
                }
                let written = self.words_left.min(bytes.len() / 8);
                place.iter_mut().zip(&bytes).take(8 * written).for_each(|(place, byte)| *place = *byte);
                self.words_left -= written;
                if 8 * written < bytes.len() {
                    self.transfers_left = 0;
                }
                if let Some(worn) = self.worn.and_then(|worn| self.flash.get_mut((worn - FLASH) as usize)) {
                    *worn &= 0xFE;
                }
                0
            }
        }
    }

    fn upload(&mut self, block: u16, into: &mut [u8]) -> Result<usize, MockError> {
        if !matches!(self.state, State::Idle | State::UploadIdle) || block < 2 {
            return Err(self.stall());
        }
        self.state = State::UploadIdle;
        let address = self.block_address(block);
        match self.system_memory(address) {
            Some(bytes) => into.copy_from_slice(&bytes),
            None => into.copy_from_slice(self.bytes(address, into.len())),
        }
        Ok(into.len())
    }

    /// The double word at an address of system memory, if the ROM allows reading there.
    fn system_memory(&self, address: u32) -> Option<[u8; 8]> {
        let (kb, options) = self.told?;
        match u64::from(address) {
            FLASH_KB_ADDRESS => Some((0xFFFF_FFFF_FFFF_0000 | u64::from(kb)).to_le_bytes()),
            _ if address == OPTION_BYTES => Some((u64::from(!options) << 32 | u64::from(options)).to_le_bytes()),
            _ => None,
        }
    }
}

#[derive(Debug)]
pub struct MockError(String);

impl std::fmt::Display for MockError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl From<dfu_core::Error> for MockError {
    fn from(error: dfu_core::Error) -> Self {
        Self(error.to_string())
    }
}

/// A connection to the chip.
pub struct MockIo {
    pub chip: Rc<RefCell<Chip>>,
    pub protocol: DfuProtocol<MemoryLayout>,
    pub descriptor: FunctionalDescriptor,
}

impl MockIo {
    pub fn new(chip: &Rc<RefCell<Chip>>, layout: &str) -> Self {
        let descriptor = FunctionalDescriptor {
            can_download: true,
            can_upload: true,
            manifestation_tolerant: false,
            will_detach: true,
            detach_timeout: 255,
            transfer_size: chip.borrow().transfer_size,
            dfu_version: (1, 0x1A),
        };
        Self { chip: chip.clone(), protocol: DfuProtocol::new(layout, (1, 0x1A)).unwrap(), descriptor }
    }
}

impl DfuIo for MockIo {
    type Read = usize;
    type Write = usize;
    type Reset = ();
    type Error = MockError;
    type MemoryLayout = MemoryLayout;

    fn read_control(&self, kind: u8, request: u8, value: u16, into: &mut [u8]) -> Result<usize, MockError> {
        let mut chip = self.chip.borrow_mut();
        chip.transfer()?;
        match (kind, request) {
            (0xA1, 2) => chip.upload(value, into),
            (0xA1, 3) => {
                let answer = chip.get_status()?;
                into.get_mut(..6).unwrap().copy_from_slice(&answer);
                Ok(6)
            }
            _ => Err(chip.stall()),
        }
    }

    fn write_control(&self, kind: u8, request: u8, value: u16, bytes: &[u8]) -> Result<usize, MockError> {
        let mut chip = self.chip.borrow_mut();
        chip.transfer()?;
        match (kind, request, chip.state) {
            (0x21, 1, _) => chip.download(value, bytes)?,
            (0x21, 4, State::Error) => (chip.state, chip.status) = (State::Idle, 0),
            (0x21, 6, State::Idle | State::DownloadSync | State::DownloadIdle | State::UploadIdle) => {
                (chip.state, chip.job) = (State::Idle, None);
            }
            _ => return Err(chip.stall()),
        }
        Ok(bytes.len())
    }

    fn usb_reset(self) -> Result<(), MockError> {
        Ok(())
    }

    fn protocol(&self) -> &DfuProtocol<MemoryLayout> {
        &self.protocol
    }

    fn functional_descriptor(&self) -> &FunctionalDescriptor {
        &self.descriptor
    }
}
