//! Flash memory: 512 KB in two banks of 2 KB pages, its controller, and the option bytes (RM0440 section 3.7).
//!
//! - Programming writes a double word in 85 us. A double word can be programmed once after an erase, and again only to
//!   zero. Erasing a page takes 22 ms (DS12288 table "Flash memory characteristics", typical values rounded up).
//! - One bank can be read while the other is busy. Reading the busy bank stalls the core; the model counts the stalls.
//!   The code runs from bank 1, so an operation there ends the run.
//! - A power failure during an operation leaves a double word that does not match its ECC, or a page of such words.
//!   Reading one sets ECCD and raises the NMI.
//! - The data cache keeps what was read. A read after an operation without a cache reset ends the run. A double word
//!   with an ECC error that the cache already holds raises nothing when it is read again.
//!
//! Not modelled: fast programming, mass erase, write and read protection, single-bank mode, securable areas.

use super::rom;
use crate::registers::{refuse, refuse_if};
use crate::{
    Cycles, Modelled, Registers, Storage, Width,
    chip::{
        clocks::Clocks,
        errata::Errata,
        ram::{Ram, xorshift},
        rules::Rules,
    },
};
use std::collections::BTreeSet;

/// First address.
pub const START: u32 = 0x0800_0000;
/// Size of both banks \[bytes\].
pub const LEN: usize = 512 << 10;
/// Size of a bank \[bytes\].
pub const BANK: usize = LEN / 2;
/// Size of a page \[bytes\].
pub const PAGE: usize = 2048;

/// Flash access settings that determine the core's read timing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Access {
    /// FLASH_ACR.LATENCY.
    pub wait_states: u64,
    /// Bytes per read: 8 in dual-bank mode, 16 in single-bank mode.
    pub width: u32,
    /// FLASH_ACR.ICEN.
    pub instruction_cache: bool,
    /// FLASH_ACR.DCEN.
    pub data_cache: bool,
}

const PROGRAM_S: f64 = 85e-6;
const ERASE_S: f64 = 22e-3;

registers! { u32:
    // Instruction cache enable, data cache enable, data cache reset.
    ACR 0x00 { ICEN 9, DCEN 10, DCRST 12 },
    KEYR 0x08,
    OPTKEYR 0x0c,
    SR 0x10 { EOP 0, OPERR 1, PROGERR 3, PGAERR 5, SIZERR 6, PGSERR 7, BSY 16 },
    CR 0x14 { PG 0, PER 1, BKER 11, STRT 16, OPTSTRT 17, EOPIE 24, ERRIE 25, OBL_LAUNCH 27, OPTLOCK 30, LOCK 31 },
    // The failing double word is in bank 2; interrupt enable; a double-bit error, which cannot be corrected.
    ECCR 0x18 { BK_ECC 21, ECCIE 24, ECCD 31 },
    // Dual-bank mode.
    OPTR 0x20 { DBANK 22 },
}
/// OPTR: reserved bits, which keep their factory value.
const OPTR_RESERVED: u32 = 0x8020_8800;

const KEYS: [u32; 2] = [0x4567_0123, 0xcdef_89ab];
const OPTION_KEYS: [u32; 2] = [0x0819_2a3b, 0x4c5d_6e7f];

/// Flags of SR that block programming and erasing while set.
const ERRORS: u32 = 0x3f8;
/// CR: PG, PER, PNB, BKER and the interrupt enables. The other bits start an operation or have no model.
const CR_KEPT: u32 = PG | PER | 0x7f << 3 | BKER | EOPIE | ERRIE;
const CR_UNKNOWN: u32 = 1 << 2 | 1 << 15 | 1 << 18 | 3 << 28;
/// ECCR: address, bank, system flash.
const ECC_PLACE: u32 = 0x7_ffff | BK_ECC | 1 << 22;

/// Factory option bytes: dual-bank, brown-out level 0, no protection.
pub const OPTIONS_DELIVERED: u32 = 0xffef_f8aa;

/// What a start executes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Boot {
    /// The program in bank 1.
    Flash,
    /// The ROM, which jumps to the program in bank 1 or 2 (AN2606, dual-bank boot). Bank 2 holds none here.
    EitherBank,
    /// The ROM's boot loader.
    Rom,
    /// Whatever is in SRAM1.
    Ram,
}

/// The state in which an operation leaves the flash if power fails during it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Torn {
    /// As before: the cells have not changed yet.
    Before,
    /// Some bits have changed, and the contents do not match the ECC.
    Between,
    /// As after the operation, but its end was not reported.
    After,
}

impl Torn {
    /// All three.
    pub const ALL: [Self; 3] = [Self::Before, Self::Between, Self::After];
}

/// The non-volatile contents of the flash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Contents {
    bytes: Vec<u8>,
    /// Indices of the double words that do not match their ECC.
    torn: BTreeSet<usize>,
    options: u32,
}

impl Contents {
    /// The bytes of both banks.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}

#[derive(Clone, Copy, Debug)]
enum Action {
    Program { at: usize, data: u64 },
    Erase { page: usize },
    Options,
}

#[derive(Clone, Copy, Debug)]
struct Operation {
    action: Action,
    end: Cycles,
}

impl Operation {
    fn bank(&self) -> Option<usize> {
        match self.action {
            Action::Program { at, .. } => Some(at / BANK),
            Action::Erase { page } => Some(page * PAGE / BANK),
            Action::Options => None,
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Cut {
    /// Operations that complete before the one that is cut.
    left: u32,
    torn: Torn,
}

/// The flash memory and its controller.
#[derive(Debug)]
pub struct Flash {
    memory: Ram,
    torn: BTreeSet<usize>,
    /// Option bytes in flash; OPTR shows the values loaded at the last start.
    options: u32,
    storage: Storage,
    status: u32,
    control: u32,
    ecc: u32,
    /// The flash size that the chip reports.
    pub size_kb: u16,
    /// Operations started from now on never end.
    pub hangs: bool,
    /// Delay from a double-bit error to its NMI; 0 for none. A delayed NMI comes even if software has cleared the flag.
    /// We found no document on how soon the NMI comes.
    pub nmi_delay: Cycles,
    nmi_due: Option<Cycles>,
    /// The NMI request of a delayed error is active.
    nmi_late: bool,
    keys: usize,
    option_keys: usize,
    /// A wrong key was written: the registers stay locked until the next reset.
    shut: bool,
    operation: Option<Operation>,
    /// First word of a double word being programmed: its offset and value.
    half: Option<(usize, u32)>,
    /// The data cache may hold outdated contents.
    stale: bool,
    /// Indices of the double words with an ECC error that the data cache holds.
    cached: BTreeSet<usize>,
    /// Errata in force.
    pub errata: Errata,
    /// How strictly the model treats violations.
    pub rules: Rules,
    cut: Option<Cut>,
    cut_at: Option<Cycles>,
    hclk_hz: f64,
    noise: u64,
    /// Cycles that the core must still wait.
    stall: Cycles,
    /// Software requested an option byte load, which resets the chip.
    pub launch: bool,
    /// Double words programmed since the model was created.
    pub programmed: u64,
    /// Pages erased since the model was created.
    pub erased: u64,
    /// Number of times the core waited for a busy bank.
    pub stalls: u64,
    /// Total of those waits \[cycles\].
    pub stalled: Cycles,
}

impl Default for Flash {
    fn default() -> Self {
        Self {
            memory: Ram::new(LEN, 0xff),
            torn: BTreeSet::new(),
            options: OPTIONS_DELIVERED,
            storage: Storage::shared(&[(ACR, 0x4_0600, 0x7f0f), (OPTR, OPTIONS_DELIVERED, !OPTR_RESERVED)]),
            status: 0,
            control: LOCK | OPTLOCK,
            ecc: 0,
            size_kb: rom::FLASH_KB,
            hangs: false,
            nmi_delay: 0,
            nmi_due: None,
            nmi_late: false,
            keys: 0,
            option_keys: 0,
            shut: false,
            operation: None,
            half: None,
            stale: false,
            cached: BTreeSet::new(),
            errata: Errata::NONE,
            rules: Rules::Enforced,
            cut: None,
            cut_at: None,
            hclk_hz: 16e6,
            noise: 0x9e37_79b9_7f4a_7c15,
            stall: 0,
            launch: false,
            programmed: 0,
            erased: 0,
            stalls: 0,
            stalled: 0,
        }
    }
}

impl Flash {
    /// The bytes of both banks.
    pub fn bytes(&self) -> &[u8] {
        self.memory.bytes()
    }

    /// Address of the flash contents in host memory.
    pub fn as_ptr(&self) -> *mut u8 {
        self.memory.as_ptr()
    }

    /// Writes bytes as a debug probe does, into pages that it has erased first.
    ///
    /// Returns false and writes nothing if they do not fit.
    #[must_use]
    pub fn load(&mut self, address: u32, bytes: &[u8]) -> bool {
        let Some(start) = address.checked_sub(START) else { return false };
        let start = start as usize;
        let Some(target) = start.checked_add(bytes.len()).and_then(|end| self.memory.bytes_mut().get_mut(start..end))
        else {
            return false;
        };
        target.copy_from_slice(bytes);
        true
    }

    /// A copy of the non-volatile contents.
    pub fn contents(&self) -> Contents {
        Contents { bytes: self.memory.bytes().to_vec(), torn: self.torn.clone(), options: self.options }
    }

    /// Restores such a copy.
    pub fn set_contents(&mut self, contents: &Contents) {
        self.memory.bytes_mut().copy_from_slice(&contents.bytes);
        self.torn = contents.torn.clone();
        self.options = contents.options;
    }

    /// Makes power fail in the middle of an operation, after `operations` more have completed.
    pub fn cut_power_after(&mut self, operations: u32, torn: Torn) {
        self.cut = Some(Cut { left: operations, torn });
    }

    /// Cancels the power failure.
    pub fn keep_power(&mut self) {
        self.cut = None;
        self.cut_at = None;
    }

    /// Whether the power failure is due.
    pub fn power_fails(&self, now: Cycles) -> bool {
        self.cut_at.is_some_and(|at| at <= now)
    }

    /// The wait states that are set (FLASH_ACR.LATENCY).
    pub fn wait_states(&self) -> u32 {
        self.storage[ACR] & 0xf
    }

    /// How the core reads the flash: 64 bits at a time in dual-bank mode, 128 in single-bank mode (RM0440, 3.3.3).
    pub fn access(&self) -> Access {
        let (acr, two_banks) = (self.storage[ACR], self.options() & DBANK != 0);
        Access {
            wait_states: u64::from(self.wait_states()),
            width: if two_banks { 8 } else { 16 },
            instruction_cache: acr & ICEN != 0,
            data_cache: acr & DCEN != 0,
        }
    }

    /// The option bytes in use, as last loaded.
    pub fn options(&self) -> u32 {
        self.storage[OPTR]
    }

    /// Writes the option bytes as a debug probe does. They take effect at the next restart.
    pub fn set_options(&mut self, options: u32) {
        self.options = options;
    }

    /// What a start executes, by the option bytes in use and the level of BOOT0 (RM0440 2.6).
    pub fn boots(&self, boot0: bool) -> Boot {
        let is_set = |bit: u32| self.options() >> bit & 1 != 0;
        let (nboot1, nswboot0, nboot0, bfb2) = (is_set(23), is_set(26), is_set(27), is_set(20));
        let from_flash = if nswboot0 { !boot0 } else { nboot0 };
        match (from_flash, nboot1) {
            (true, _) if bfb2 => Boot::EitherBank,
            (true, _) => Boot::Flash,
            (false, true) => Boot::Rom,
            (false, false) => Boot::Ram,
        }
    }

    /// Brown-out level in use: 0 is 1.7 V, 4 is 2.8 V.
    pub fn brown_out_level(&self) -> u32 {
        self.storage[OPTR] >> 8 & 7
    }

    /// Whether the `len` bytes from `address` on are within flash.
    pub fn holds(&self, address: u32, len: usize) -> bool {
        let start = address.wrapping_sub(START) as usize;
        start < LEN && len <= LEN - start
    }

    /// Whether an operation is in progress.
    pub fn is_busy(&mut self, now: Cycles) -> bool {
        self.advance(now);
        self.operation.is_some()
    }

    /// The boot loader erases a page. It runs from system memory, so either bank may be erased.
    pub fn rom_erase(&mut self, page: usize, now: Cycles) {
        self.begin(Action::Erase { page }, now);
        self.stale = false;
    }

    /// The boot loader programs a double word. Returns false and does nothing if the double word is not erased.
    #[must_use]
    pub fn rom_program(&mut self, address: u32, data: u64, now: Cycles) -> bool {
        let at = address.wrapping_sub(START) as usize;
        let erased = at.is_multiple_of(8) && self.holds(address, 8) && self.double_word(at) == u64::MAX;
        if erased {
            self.begin(Action::Program { at, data }, now);
            self.stale = false;
        }
        erased
    }

    /// What the ROM reads at an address: flash, the chip's data in system memory, or the option bytes (the word, then
    /// its complement).
    pub fn rom_read(&self, address: u32, length: usize) -> Option<Vec<u8>> {
        const OPTION_BYTES: u32 = 0x1fff_7800;
        if self.holds(address, length) {
            let start = (address - START) as usize;
            return self.bytes().get(start..start + length).map(<[u8]>::to_vec);
        }
        let within = |start: u32, bytes: &[u8]| {
            let start = address.checked_sub(start)? as usize;
            bytes.get(start..start.checked_add(length)?).map(<[u8]>::to_vec)
        };
        let options = self.options();
        let option_bytes = [options.to_le_bytes(), (!options).to_le_bytes()].concat();
        let mut system = rom::bytes();
        let size = (rom::FLASH_KB_AT - rom::START) as usize;
        system[size..size + 2].copy_from_slice(&self.size_kb.to_le_bytes());
        within(OPTION_BYTES, &option_bytes).or_else(|| within(rom::START, &system))
    }

    /// Power fails: an operation in progress is torn.
    pub fn lose_power(&mut self) {
        let torn = match (self.cut_at.take(), self.cut.take()) {
            (Some(_), Some(cut)) => cut.torn,
            _ => Torn::Between,
        };
        let Some(Operation { action, .. }) = self.operation.take() else { return };
        match (torn, action) {
            (Torn::Before, _) => {}
            (Torn::After, action) => self.carry_out(action),
            (Torn::Between, Action::Program { at, data }) => self.tear(at, data),
            (Torn::Between, Action::Erase { page }) => {
                for at in (page * PAGE..(page + 1) * PAGE).step_by(8) {
                    self.tear_erased(at);
                }
            }
            // The old option bytes stay. This is an assumption: we found no document on how the controller stores them.
            (Torn::Between, Action::Options) => {}
        }
    }

    fn double_word(&self, at: usize) -> u64 {
        let mut bytes = [0; 8];
        bytes.copy_from_slice(&self.memory.bytes()[at..at + 8]);
        u64::from_le_bytes(bytes)
    }

    fn set_double_word(&mut self, at: usize, data: u64) {
        self.memory.bytes_mut()[at..at + 8].copy_from_slice(&data.to_le_bytes());
    }

    fn tear(&mut self, at: usize, data: u64) {
        let some = xorshift(&mut self.noise);
        let old = self.double_word(at);
        self.set_double_word(at, old & (data | some));
        self.torn.insert(at / 8);
    }

    /// Clears some bits of a double word, which then no longer matches its ECC.
    #[cfg(test)]
    pub(crate) fn tear_for_test(&mut self, address: u32) {
        self.tear((address - START) as usize, 0);
    }

    fn tear_erased(&mut self, at: usize) {
        let some = xorshift(&mut self.noise);
        match self.double_word(at) {
            u64::MAX => {}
            old => {
                self.set_double_word(at, old | some);
                self.torn.insert(at / 8);
            }
        }
    }

    fn carry_out(&mut self, action: Action) {
        match action {
            Action::Program { at, data } => {
                self.set_double_word(at, data);
                self.torn.remove(&(at / 8));
            }
            Action::Erase { page } => {
                let (start, end) = (page * PAGE, (page + 1) * PAGE);
                self.memory.bytes_mut()[start..end].fill(0xff);
                self.torn.retain(|word| !(start / 8..end / 8).contains(word));
            }
            Action::Options => self.options = self.storage[OPTR],
        }
    }

    /// Refuses an operation while the data cache is on, if the erratum on writing one bank while reading the other
    /// applies.
    fn check_cache(&self) -> Modelled {
        refuse_if(
            self.errata.data_cache && self.storage[ACR] & DCEN != 0,
            "flash operation while the data cache is on, which may corrupt the cache (ES0430 2.2.2)",
        )
    }

    fn begin(&mut self, action: Action, now: Cycles) {
        let length_s = match action {
            Action::Program { .. } => PROGRAM_S,
            Action::Erase { .. } => ERASE_S,
            Action::Options => ERASE_S + PROGRAM_S,
        };
        // An operation that hangs takes about a year.
        let length = (if self.hangs { 3e7 } else { length_s } * self.hclk_hz) as Cycles;
        self.operation = Some(Operation { action, end: now + length });
        self.stale |= self.storage[ACR] & DCEN != 0;
        match &mut self.cut {
            Some(Cut { left: 0, .. }) => self.cut_at = Some(now + length / 2),
            Some(cut) => cut.left -= 1,
            None => {}
        }
    }

    fn fail(&mut self, error: u32) {
        self.status |= error;
        if self.control & ERRIE != 0 {
            self.status |= OPERR;
        }
        self.half = None;
    }

    /// Makes the core wait for the end of an operation in progress; returns the time at which it continues.
    fn wait(&mut self, now: Cycles) -> Cycles {
        let end = match self.operation {
            Some(operation) if operation.end > now => operation.end,
            _ => return now,
        };
        self.stalls += 1;
        self.stalled += end - now;
        self.stall += end - now;
        self.advance(end);
        end
    }

    /// Returns and clears the cycles that the core must wait after its last access.
    pub fn take_stall(&mut self) -> Cycles {
        std::mem::take(&mut self.stall)
    }

    /// Level of the interrupt request.
    pub fn irq(&self) -> bool {
        self.status & EOP != 0 && self.control & EOPIE != 0 || self.status & OPERR != 0 && self.control & ERRIE != 0
    }

    /// Whether a double-bit error requests the NMI.
    pub fn nmi(&self) -> bool {
        if self.nmi_delay == 0 { self.ecc & ECCD != 0 } else { self.nmi_late }
    }

    /// The core reads bank 2.
    pub fn read_memory(&mut self, address: u32, width: Width, now: Cycles) -> Modelled<u32> {
        let at = address.wrapping_sub(START) as usize;
        let now = match self.operation {
            Some(operation) if operation.bank() == Some(at / BANK) => self.wait(now),
            _ => now,
        };
        self.advance(now);
        let bytes = self.memory.bytes().get(at..at + width.bytes() as usize);
        let Some(bytes) = bytes else { return refuse("past the end of flash") };
        let value = bytes.iter().rev().fold(0, |word, &byte| word << 8 | u32::from(byte));
        refuse_if(
            self.stale && self.rules == Rules::Enforced,
            "read through a data cache that was not reset after flash changed",
        )?;
        let hit = self.storage[ACR] & DCEN != 0 && self.torn.contains(&(at / 8)) && !self.cached.insert(at / 8);
        if self.torn.contains(&(at / 8)) && !hit && self.ecc & ECCD == 0 {
            let bank = if at >= BANK { BK_ECC } else { 0 };
            let place = bank | ((at % BANK) & !7) as u32;
            let told = if self.errata.eccr_after_cut { !place & ECC_PLACE } else { place };
            self.ecc = self.ecc & ECCIE | ECCD | told;
            self.nmi_due = Some(now + self.nmi_delay).filter(|_| self.nmi_delay > 0);
        }
        Ok(value)
    }

    /// The core writes to flash.
    pub fn write_memory(&mut self, address: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        let at = address.wrapping_sub(START) as usize;
        refuse_if(at < BANK, "write to bank 1, from which the code runs")?;
        refuse_if(at >= LEN, "past the end of flash")?;
        let now = self.wait(now);
        self.advance(now);
        if width != Width::Word {
            self.fail(SIZERR);
            return Ok(());
        }
        if self.control & PG == 0 || self.status & ERRORS != 0 {
            self.fail(PGSERR);
            return Ok(());
        }
        match self.half.take() {
            None if at.is_multiple_of(8) => self.half = Some((at, value)),
            Some((first, low)) if at == first + 4 => {
                let data = u64::from(value) << 32 | u64::from(low);
                if self.double_word(first) != u64::MAX && data != 0 {
                    self.fail(PROGERR);
                } else {
                    self.check_cache()?;
                    self.begin(Action::Program { at: first, data }, now);
                }
            }
            _ => self.fail(PGAERR),
        }
        Ok(())
    }

    fn unlock(&mut self, key: u32) -> Modelled {
        if self.shut || self.control & LOCK == 0 || key != KEYS[self.keys] {
            self.shut = true;
            return refuse("wrong FLASH_KEYR key: bus fault, locked until reset");
        }
        self.keys = (self.keys + 1) % 2;
        if self.keys == 0 {
            self.control &= !LOCK;
        }
        Ok(())
    }

    fn unlock_options(&mut self, key: u32) -> Modelled {
        refuse_if(
            self.control & (LOCK | OPTLOCK) != OPTLOCK || key != OPTION_KEYS[self.option_keys],
            "wrong FLASH_OPTKEYR key, or FLASH_CR is locked",
        )?;
        self.option_keys = (self.option_keys + 1) % 2;
        if self.option_keys == 0 {
            self.control &= !OPTLOCK;
        }
        Ok(())
    }

    fn write_control(&mut self, word: u32, now: Cycles) -> Modelled {
        let now = self.wait(now);
        if self.control & LOCK != 0 {
            // Setting LOCK again is allowed.
            return if word & LOCK != 0 { Ok(()) } else { refuse("FLASH_CR is locked") };
        }
        refuse_if(word & CR_UNKNOWN != 0, "mass erase, fast programming and securable areas are not modelled")?;
        self.control = word & CR_KEPT | self.control & OPTLOCK;
        if word & PG == 0 {
            self.half = None;
        }
        if word & OPTLOCK != 0 {
            self.control |= OPTLOCK;
        }
        let options = word & (OPTSTRT | OBL_LAUNCH);
        refuse_if(options != 0 && self.control & OPTLOCK != 0, "the option bytes are locked")?;
        if word & STRT != 0 {
            if word & (PG | PER) != PER || self.status & ERRORS != 0 {
                self.fail(PGSERR);
            } else if word & BKER == 0 {
                return refuse("erase of bank 1, from which the code runs");
            } else {
                let page = (BANK / PAGE) + (word >> 3 & 0x7f) as usize;
                self.check_cache()?;
                self.begin(Action::Erase { page }, now);
            }
        }
        if word & OPTSTRT != 0 {
            // The same condition as for programming and erasing; the manual does not specify it.
            if self.status & ERRORS != 0 {
                self.fail(PGSERR);
            } else {
                self.begin(Action::Options, now);
            }
        }
        self.launch |= word & OBL_LAUNCH != 0;
        if word & LOCK != 0 {
            self.control = self.control & CR_KEPT | LOCK | OPTLOCK;
        }
        Ok(())
    }
}

impl Registers for Flash {
    fn word(&mut self, register: u32, _: Cycles) -> Modelled<u32> {
        Ok(match register {
            KEYR | OPTKEYR => 0,
            SR => self.status | if self.operation.is_some() { BSY } else { 0 },
            CR => {
                let started = match self.operation.map(|operation| operation.action) {
                    Some(Action::Erase { .. }) => STRT,
                    Some(Action::Options) => OPTSTRT,
                    _ => 0,
                };
                self.control | started
            }
            ECCR => self.ecc,
            _ => self.storage.load(register)?,
        })
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        self.advance(now);
        let word = width.replace(0, offset, value);
        match offset & !3 {
            KEYR => self.unlock(word)?,
            OPTKEYR => self.unlock_options(word)?,
            // Writing 1 clears a flag.
            SR => self.status &= !word,
            CR => self.write_control(width.replace(self.control, offset, value), now)?,
            ECCR => {
                self.ecc &= !(word & ECCD);
                self.nmi_late &= word & ECCD == 0;
                self.ecc = self.ecc & !ECCIE | word & ECCIE;
            }
            ACR => {
                let before = self.storage.store(offset, value, width)?;
                let after = self.storage[ACR];
                if after & DCRST != 0 {
                    match (before & after & DCEN != 0, self.rules) {
                        (true, Rules::Enforced) => return refuse("data cache reset (DCRST) while the cache is on"),
                        // No effect, as the cache is on.
                        (true, Rules::AsOnTheChip) => {}
                        (false, _) => {
                            self.stale = false;
                            self.cached.clear();
                        }
                    }
                }
            }
            OPTR if self.control & OPTLOCK != 0 => return refuse("the option bytes are locked"),
            _ => return self.storage.write(offset, value, width, now),
        }
        Ok(())
    }

    fn next_event(&self) -> Option<Cycles> {
        let end = self.operation.filter(|_| self.control & EOPIE != 0).map(|operation| operation.end);
        end.into_iter().chain(self.cut_at).chain(self.nmi_due).min()
    }

    fn advance(&mut self, now: Cycles) {
        if self.nmi_due.is_some_and(|due| due <= now) {
            self.nmi_due = None;
            self.nmi_late = true;
        }
        match self.operation {
            Some(Operation { action, end }) if end <= now => {
                self.operation = None;
                self.carry_out(action);
                match action {
                    Action::Program { .. } => self.programmed += 1,
                    Action::Erase { .. } => self.erased += 1,
                    Action::Options => {}
                }
                if self.control & EOPIE != 0 {
                    self.status |= EOP;
                }
            }
            _ => {}
        }
    }

    fn reset(&mut self, now: Cycles) {
        self.advance(now);
        // A reset aborts an operation in progress, which leaves the cells as a power failure does.
        self.lose_power();
        self.storage.reset();
        self.storage[OPTR] = self.options;
        self.status = 0;
        self.control = LOCK | OPTLOCK;
        self.ecc = 0;
        (self.keys, self.option_keys, self.shut) = (0, 0, false);
        self.half = None;
        self.stale = false;
        self.cached.clear();
        self.stall = 0;
        self.launch = false;
        self.hclk_hz = 16e6;
    }

    fn set_clocks(&mut self, clocks: &Clocks) {
        self.hclk_hz = clocks.hclk_hz;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Width::{Half, Word};
    use crate::chip::testing::{read, refuses, write};

    const SETTINGS: u32 = 0x0807_c000;

    fn unlocked() -> Flash {
        let mut flash = Flash::default();
        for key in KEYS {
            write(&mut flash, KEYR, key, 0);
        }
        write(&mut flash, ACR, 0x200, 0);
        flash
    }

    fn program(flash: &mut Flash, address: u32, data: [u32; 2], now: Cycles) {
        write(flash, CR, PG | EOPIE | ERRIE, now);
        flash.write_memory(address, data[0], Word, now).expect("modelled access");
        flash.write_memory(address + 4, data[1], Word, now).expect("modelled access");
    }

    fn word(flash: &mut Flash, address: u32, now: Cycles) -> u32 {
        flash.read_memory(address, Word, now).expect("modelled access")
    }

    /// 85 us and 22 ms at 16 MHz.
    const PROGRAM: Cycles = 1360;
    const ERASE: Cycles = 352_000;

    #[test]
    fn programs_a_double_word_once() {
        let mut flash = unlocked();
        program(&mut flash, SETTINGS, [1, 2], 0);
        assert_eq!(read(&mut flash, SR, PROGRAM - 1), BSY);
        assert_eq!(flash.next_event(), Some(PROGRAM));
        assert_eq!(read(&mut flash, SR, PROGRAM), EOP);
        assert!(flash.irq());
        assert_eq!((word(&mut flash, SETTINGS, PROGRAM), word(&mut flash, SETTINGS + 4, PROGRAM)), (1, 2));
        write(&mut flash, SR, EOP, PROGRAM);
        program(&mut flash, SETTINGS, [1, 1], PROGRAM);
        assert_eq!(read(&mut flash, SR, PROGRAM), PROGERR | OPERR, "not erased");
        program(&mut flash, SETTINGS + 8, [1, 1], PROGRAM);
        assert_eq!(read(&mut flash, SR, PROGRAM) & PGSERR, PGSERR, "an error blocks the next until it is cleared");
        write(&mut flash, SR, u32::MAX, PROGRAM);
        program(&mut flash, SETTINGS, [0, 0], PROGRAM);
        assert_eq!(read(&mut flash, SR, PROGRAM), BSY, "zero is always possible");
    }

    #[test]
    fn wrong_order_and_wrong_size() {
        let mut flash = unlocked();
        flash.write_memory(SETTINGS, 0, Word, 0).expect("modelled access");
        assert_eq!(read(&mut flash, SR, 0), PGSERR, "PG is not set");
        write(&mut flash, SR, PGSERR, 0);
        write(&mut flash, CR, PG, 0);
        flash.write_memory(SETTINGS + 4, 0, Word, 0).expect("modelled access");
        assert_eq!(read(&mut flash, SR, 0), PGAERR);
        write(&mut flash, SR, PGAERR, 0);
        flash.write_memory(SETTINGS, 0, Half, 0).expect("modelled access");
        assert_eq!(read(&mut flash, SR, 0), SIZERR);
        assert!(flash.write_memory(START, 0, Word, 0).is_err(), "bank 1");
    }

    #[test]
    fn locked_until_both_keys() {
        let mut flash = Flash::default();
        assert!(refuses(&mut flash, CR, PG, 0));
        write(&mut flash, KEYR, KEYS[0], 0);
        assert!(refuses(&mut flash, KEYR, KEYS[0], 0));
        assert!(refuses(&mut flash, KEYR, KEYS[1], 0), "locked until the next reset");
        flash.reset(0);
        for key in KEYS {
            write(&mut flash, KEYR, key, 0);
        }
        write(&mut flash, CR, PG, 0);
        write(&mut flash, CR, LOCK, 0);
        assert_eq!(read(&mut flash, CR, 0), LOCK | OPTLOCK);
    }

    #[test]
    fn erases_a_page_of_bank_2_while_bank_1_runs() {
        let mut flash = unlocked();
        program(&mut flash, SETTINGS, [1, 2], 0);
        let now = PROGRAM;
        write(&mut flash, CR, PER | BKER | 120 << 3 | STRT, now);
        assert_eq!(word(&mut flash, START, now), u32::MAX);
        assert_eq!(flash.take_stall(), 0, "bank 1 is free");
        assert_eq!(word(&mut flash, SETTINGS + 4096, now), u32::MAX);
        assert_eq!((flash.take_stall(), flash.stalls, flash.stalled), (ERASE, 1, ERASE));
        assert_eq!(word(&mut flash, SETTINGS, now + ERASE), u32::MAX);
        assert!(refuses(&mut flash, CR, PER | STRT, now + ERASE), "bank 1");
    }

    #[test]
    fn power_that_fails_tears_the_word() {
        for torn in Torn::ALL {
            let mut flash = unlocked();
            flash.cut_power_after(1, torn);
            program(&mut flash, SETTINGS, [1, 2], 0);
            assert!(!flash.power_fails(PROGRAM - 1));
            program(&mut flash, SETTINGS + 8, [3, 4], PROGRAM);
            assert_eq!(flash.next_event(), Some(PROGRAM + PROGRAM / 2));
            assert!(flash.power_fails(PROGRAM + PROGRAM / 2));
            flash.lose_power();
            flash.reset(2 * PROGRAM);
            assert_eq!(word(&mut flash, SETTINGS, 2 * PROGRAM), 1);
            assert!(!flash.nmi());
            let low = word(&mut flash, SETTINGS + 8, 2 * PROGRAM);
            match torn {
                Torn::Before => assert_eq!((low, flash.nmi()), (u32::MAX, false)),
                Torn::After => assert_eq!((low, flash.nmi()), (3, false)),
                Torn::Between => {
                    assert_eq!(low & 3, 3, "bits only fall");
                    assert!(flash.nmi());
                    assert_eq!(read(&mut flash, ECCR, 2 * PROGRAM), ECCD | BK_ECC | 0x3_c008);
                    write(&mut flash, ECCR, ECCD, 2 * PROGRAM);
                    assert!(!flash.nmi());
                }
            }
        }
    }

    #[test]
    fn what_eccr_tells_of_a_torn_double_word_is_wrong_by_an_erratum_only() {
        for (errata, told) in [
            (Errata { eccr_after_cut: true, ..Errata::NONE }, !(BK_ECC | 0x3_c008) & ECC_PLACE),
            (Errata::NONE, BK_ECC | 0x3_c008),
        ] {
            let mut flash = unlocked();
            flash.errata = errata;
            flash.cut_power_after(0, Torn::Between);
            program(&mut flash, SETTINGS + 8, [1, 2], 0);
            flash.lose_power();
            word(&mut flash, SETTINGS + 8, PROGRAM);
            assert_eq!(read(&mut flash, ECCR, PROGRAM), ECCD | told);
        }
    }

    #[test]
    fn a_write_with_the_data_cache_on_is_an_erratum() {
        for (errata, is_refused) in [(Errata { data_cache: true, ..Errata::NONE }, true), (Errata::NONE, false)] {
            let mut flash = unlocked();
            flash.errata = errata;
            let write_word = |flash: &mut Flash| {
                write(flash, CR, PG, 0);
                let low = flash.write_memory(SETTINGS, 1, Word, 0);
                low.and(flash.write_memory(SETTINGS + 4, 2, Word, 0))
            };
            write(&mut flash, ACR, 0x600, 0);
            assert_eq!(write_word(&mut flash).is_err(), is_refused);
            let mut flash = unlocked();
            flash.errata = errata;
            write(&mut flash, ACR, 0x200, 0);
            assert_eq!(write_word(&mut flash), Ok(()));
            let erase = PER | BKER | 120 << 3 | STRT;
            let mut flash = unlocked();
            flash.errata = errata;
            write(&mut flash, ACR, 0x600, 0);
            assert_eq!(refuses(&mut flash, CR, erase, 0), is_refused);
        }
    }

    #[test]
    fn power_that_fails_tears_the_page_until_it_is_erased_anew() {
        let mut flash = unlocked();
        program(&mut flash, SETTINGS, [1, 2], 0);
        flash.advance(PROGRAM);
        flash.cut_power_after(0, Torn::Between);
        write(&mut flash, CR, PER | BKER | 120 << 3 | STRT, PROGRAM);
        flash.lose_power();
        assert_ne!(word(&mut flash, SETTINGS, PROGRAM), u32::MAX);
        assert!(flash.nmi());
        write(&mut flash, ECCR, ECCD, PROGRAM);
        write(&mut flash, CR, PER | BKER | 120 << 3 | STRT, PROGRAM);
        assert_eq!(word(&mut flash, SETTINGS, PROGRAM + ERASE), u32::MAX);
        assert!(!flash.nmi());
    }

    #[test]
    fn a_data_cache_left_on_is_found() {
        let mut flash = unlocked();
        write(&mut flash, ACR, 0x600, 0);
        program(&mut flash, SETTINGS, [1, 2], 0);
        flash.advance(PROGRAM);
        assert!(flash.read_memory(SETTINGS, Word, PROGRAM).is_err());
        assert!(refuses(&mut flash, ACR, 0x1600, PROGRAM), "reset while on");
        write(&mut flash, ACR, 0x200, PROGRAM);
        write(&mut flash, ACR, 0x1200, PROGRAM);
        assert_eq!(word(&mut flash, SETTINGS, PROGRAM), 1);
    }

    #[test]
    fn option_bytes_are_loaded_by_a_restart() {
        let mut flash = unlocked();
        assert!(refuses(&mut flash, OPTR, 0, 0), "locked");
        for key in OPTION_KEYS {
            write(&mut flash, OPTKEYR, key, 0);
        }
        write(&mut flash, OPTR, OPTIONS_DELIVERED | 4 << 8, 0);
        write(&mut flash, CR, OPTSTRT, 0);
        let end = 2 * ERASE;
        assert_eq!(read(&mut flash, SR, end), 0);
        write(&mut flash, CR, OBL_LAUNCH, end);
        assert!(flash.launch);
        flash.reset(end);
        assert_eq!(flash.brown_out_level(), 4);
        assert_eq!(flash.contents().options, OPTIONS_DELIVERED | 4 << 8);
    }

    #[test]
    fn the_core_reads_as_the_registers_say() {
        let mut flash = Flash::default();
        let reset = Access { wait_states: 0, width: 8, instruction_cache: true, data_cache: true };
        assert_eq!(flash.access(), reset);
        write(&mut flash, ACR, 0x4_0004, 0);
        assert_eq!(flash.access(), Access { wait_states: 4, instruction_cache: false, data_cache: false, ..reset });
    }

    #[test]
    fn contents_outlive_the_chip() {
        let mut flash = unlocked();
        program(&mut flash, SETTINGS, [1, 2], 0);
        flash.advance(PROGRAM);
        let mut other = Flash::default();
        other.set_contents(&flash.contents());
        assert_eq!(word(&mut other, SETTINGS, 0), 1);
        assert!(!other.load(START + LEN as u32 - 1, &[0, 0]), "does not fit");
    }

    #[test]
    fn fields_are_metapacs() {
        fields_agree!("FLASH", "ACR", ICEN, DCEN, DCRST);
        fields_agree!("FLASH", "OPTR", DBANK);
        fields_agree!("FLASH", "SR", EOP, OPERR, PROGERR, PGAERR, SIZERR, PGSERR, BSY);
        fields_agree!("FLASH", "CR", PG, PER, BKER, STRT, OPTSTRT, EOPIE, ERRIE, OBL_LAUNCH, OPTLOCK, LOCK);
        fields_agree!("FLASH", "ECCR", BK_ECC, ECCIE, ECCD);
    }
}
