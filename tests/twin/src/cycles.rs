//! The number of cycles that a program takes on the chip: two bounds, kept separately from the twin's own time.
//!
//! The twin's clock counts one cycle per instruction. If enabled ([`crate::cpu::Cpu::count_cycles`]), this model sums
//! the cycles that the same blocks of instructions take on the chip while the core is awake. Where no document gives a
//! figure, each bound uses its own assumption, so the result is a range.
//!
//! | item | optimistic | pessimistic | source |
//! |---|---|---|---|
//! | instructions | [`timing`] | [`timing`] | DDI 0439, 3.3 |
//! | refill after a taken branch | 1 | 3 | DDI 0439, 3.3.1: "P is between 1 and 3" |
//! | flash read | wait states + 1 per 64 bits (128 in single-bank mode) | the same | RM0440, 3.3.3 and 3.3.4 |
//! | instruction cache | 1 KB, 32 bytes a line, least recently used | the same | RM0440, 3.3.5 |
//! | cache miss | stall for a double word, the rest loads during execution | stall for a line | not documented |
//! | prefetch by the core | none wasted | three words after each block | DDI 0439, 3.1 (three words); effect assumed |
//! | flash data | 256-byte cache, else wait states | whole lines, 1 for contention | RM0440, 3.3.5; DDI 0439, 3.3.3 |
//! | unaligned access | 1 more | 2 more | not documented |
//! | peripheral access | 0 more | 8 more | not documented |
//! | DMA transfer | no delay | 2 cycles | AN4031, 2.1: round robin: another access before the read and the write |
//! | exception: entry | 12, after another one 6 in all | 29 and a line of flash for the vector | DDI 0439, 3.9 |
//! | exception: return | 10 | 29 | as above, with the FPU frame |
//!
//! SRAM and CCM SRAM have no wait states (RM0440, 2.4). Not modelled: the flash interface's prefetch
//! (FLASH_ACR.PRFTEN), which our image leaves off, and reads of bank 2 while it is busy, which the twin counts itself.
//! Order and time of interrupts are the twin's.

pub mod timing;

use crate::chip::flash::{self, Access};
use std::collections::HashMap;
pub use timing::Range;

/// Peripherals of the chip, which are on AHB and APB buses.
const REGISTERS: std::ops::Range<u32> = 0x4000_0000..0x6000_0000;
/// Size of a cache line, in single-bank and dual-bank mode \[bytes\].
const LINE: u32 = 32;
const INSTRUCTION_LINES: usize = 32;
const DATA_LINES: usize = 8;
const REFILL: Range = Range::new(1, 3);
const UNALIGNED: Range = Range::new(1, 2);
const PERIPHERAL: Range = Range::new(0, 8);
const TRANSFER: Range = Range::new(0, 2);
const ENTRY: Range = Range::new(12, 29);
const RETURN: Range = Range::new(10, 29);
/// Least cycles for the return from one exception and the entry of another that follows at once.
const TAIL_CHAIN: u64 = 6;
/// Bytes that the core prefetches.
const FETCHED_AHEAD: u32 = 12;

/// Stall while the core waits for a whole line; without a cache, for one read.
fn line_stall(access: &Access, cached: bool) -> u64 {
    let reads = if cached { u64::from(LINE / access.width) } else { 1 };
    reads * (access.wait_states + 1) - 1
}

/// Cached lines of flash, the most recently used last.
#[derive(Clone, Debug)]
struct Cache {
    lines: Vec<u32>,
    capacity: usize,
}

impl Cache {
    fn new(capacity: usize) -> Self {
        Self { lines: Vec::with_capacity(capacity), capacity }
    }

    /// Uses the line of this address; returns whether it was cached.
    fn hit(&mut self, address: u32) -> bool {
        let line = address / LINE;
        // Usually the most recently used line.
        let found = self.lines.iter().rposition(|&held| held == line);
        match found {
            Some(at) => self.lines[at..].rotate_left(1),
            None => {
                if self.lines.len() == self.capacity {
                    self.lines.remove(0);
                }
                self.lines.push(line);
            }
        }
        found.is_some()
    }
}

/// What the core executed before the next block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Before {
    /// A block that ends at this address.
    Block(u32),
    /// An exception return.
    Return,
    /// An exception entry, or nothing.
    Entry,
}

/// The running total.
#[derive(Clone, Debug)]
pub struct Model {
    total: Range,
    /// The instruction cache under each bound's assumptions, and the data cache, which is the same under both.
    least: Cache,
    most: Cache,
    data: Cache,
    before: Before,
    /// DMA transfers before the count.
    transfers: u64,
    costs: HashMap<(u32, u32), Range>,
}

fn in_flash(address: u32) -> bool {
    (flash::START..flash::START + flash::LEN as u32).contains(&address)
}

impl Model {
    /// A count of zero with empty caches; `transfers` is the number of DMA transfers so far.
    pub fn new(transfers: u64) -> Self {
        Self {
            total: Range::default(),
            least: Cache::new(INSTRUCTION_LINES),
            most: Cache::new(INSTRUCTION_LINES),
            data: Cache::new(DATA_LINES),
            before: Before::Entry,
            transfers,
            costs: HashMap::new(),
        }
    }

    /// Cycles so far; `transfers` is the total number of DMA transfers.
    pub fn total(&self, transfers: u64) -> Range {
        let new = transfers - self.transfers;
        let mut total = self.total;
        total += Range::new(TRANSFER.least * new, TRANSFER.most * new);
        total
    }

    /// Discards cached costs after the program has changed.
    pub fn forget_code(&mut self) {
        self.costs.clear();
    }

    /// Adds the execution of a block of instructions.
    pub fn block(&mut self, address: u32, code: &[u8], access: &Access) {
        let end = address + code.len() as u32;
        let execution = *self.costs.entry((address, end)).or_insert_with(|| timing::cost(address, code));
        let follows = self.before == Before::Block(address);
        if !follows && matches!(self.before, Before::Block(_)) {
            self.total += REFILL;
        }
        self.before = Before::Block(end);
        if in_flash(address) {
            self.total.least += self.fetch(address..end, execution.least, follows, access);
            self.total.most += execution.most + self.wait_for_lines(address..end + FETCHED_AHEAD, access);
        } else {
            self.total += execution;
        }
    }

    /// Cycles of a block whose missing double words are read while it executes. Only the first read after a branch
    /// cannot be done in advance.
    fn fetch(&mut self, code: std::ops::Range<u32>, execution: u64, follows: bool, access: &Access) -> u64 {
        let mut missing = 0;
        for line in code.start / LINE..=(code.end - 1) / LINE {
            if !self.least.hit(line * LINE) || !access.instruction_cache {
                let read = code.start.max(line * LINE)..code.end.min((line + 1) * LINE);
                missing += u64::from((read.end - 1) / access.width - read.start / access.width + 1);
            }
        }
        let unhidden = if follows || missing == 0 { 0 } else { access.wait_states };
        (execution + unhidden).max(missing * (access.wait_states + 1))
    }

    fn wait_for_lines(&mut self, code: std::ops::Range<u32>, access: &Access) -> u64 {
        if !access.instruction_cache {
            let reads = (code.end - 1) / access.width - code.start / access.width + 1;
            return u64::from(reads) * line_stall(access, false);
        }
        let lines = code.start / LINE..=(code.end - 1) / LINE;
        let missed = lines.filter(|line| !self.most.hit(line * LINE)).count();
        missed as u64 * line_stall(access, true)
    }

    /// Adds a data access to memory.
    pub fn data(&mut self, address: u32, len: usize, access: &Access) {
        if !(address as usize).is_multiple_of(len.clamp(1, 4)) {
            self.total += UNALIGNED;
        }
        if !in_flash(address) {
            return;
        }
        self.total.most += 1;
        if !self.data.hit(address) || !access.data_cache {
            self.total += Range::new(access.wait_states, line_stall(access, access.data_cache));
        }
    }

    /// Adds a peripheral register access. The core's own registers have no delay.
    pub fn register(&mut self, address: u32) {
        if REGISTERS.contains(&address) {
            self.total += PERIPHERAL;
        }
    }

    /// Adds an exception entry.
    pub fn enter(&mut self, access: &Access) {
        self.total.most += ENTRY.most + line_stall(access, true);
        if self.before == Before::Return {
            self.total.least -= RETURN.least - TAIL_CHAIN;
        } else {
            self.total.least += ENTRY.least;
        }
        self.before = Before::Entry;
    }

    /// Adds an exception return.
    pub fn leave(&mut self) {
        self.total += RETURN;
        self.before = Before::Return;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO_BANKS: Access = Access { wait_states: 4, width: 8, instruction_cache: true, data_cache: true };
    const ONE_BANK: Access = Access { width: 16, ..TWO_BANKS };
    const NOP: [u8; 2] = [0x00, 0xbf];

    /// Cycles of blocks with these addresses and numbers of NOPs.
    fn cycles(access: &Access, blocks: &[(u32, usize)]) -> Range {
        let mut model = Model::new(0);
        for &(address, instructions) in blocks {
            model.block(address, &NOP.repeat(instructions), access);
        }
        model.total(0)
    }

    #[test]
    fn the_least_recently_used_line_goes() {
        let mut cache = Cache::new(3);
        for line in [1, 2, 3] {
            assert!(!cache.hit(line * LINE));
        }
        assert!(cache.hit(LINE + 31), "the same line");
        assert!(!cache.hit(4 * LINE));
        assert!(cache.hit(LINE), "used after the second");
        assert!(!cache.hit(2 * LINE));
    }

    #[test]
    fn a_loop_of_1_kb_stays_in_the_cache_and_a_longer_one_does_not() {
        let laps = |bytes: u32| {
            let blocks: Vec<(u32, usize)> =
                (0..2).flat_map(|_| (0..bytes / LINE).map(|line| (flash::START + line * LINE, 10))).collect();
            let mut model = Model::new(0);
            let mut after = Vec::new();
            for (address, instructions) in blocks {
                model.block(address, &NOP.repeat(instructions), &TWO_BANKS);
                after.push(model.total(0));
            }
            after[after.len() - 1].since(after[after.len() / 2])
        };
        // 31 blocks of 10 NOPs, and the refills between them.
        assert_eq!(laps(1024), Range::new(31 * 11, 31 * 13));
        // Each line is evicted before it is used again.
        let long = laps(1056);
        assert_eq!((long.least, long.most), (32 * (1 + 15), 32 * (10 + 3 + 19)));
    }

    #[test]
    fn straight_code_is_bound_by_the_width_of_flash() {
        // Sixteen 2-byte instructions, then the prefetched words: four reads of 64 bits or two of 128.
        assert_eq!(cycles(&TWO_BANKS, &[(flash::START, 16)]), Range::new(20, 16 + 19 + 19));
        assert_eq!(cycles(&ONE_BANK, &[(flash::START, 16)]), Range::new(20, 16 + 9 + 9));
        let slow = Access { wait_states: 8, ..ONE_BANK };
        assert_eq!(cycles(&slow, &[(flash::START, 16)]).least, 24);
        let slow = Access { wait_states: 8, ..TWO_BANKS };
        assert_eq!(cycles(&slow, &[(flash::START, 16)]).least, 36);
        let none = Access { wait_states: 0, ..TWO_BANKS };
        assert_eq!(cycles(&none, &[(flash::START, 16)]).least, 16);
    }

    #[test]
    fn only_a_taken_branch_refills_the_pipeline() {
        let ram = 0x2000_0000;
        assert_eq!(cycles(&TWO_BANKS, &[(ram, 4), (ram + 8, 4)]), Range::exactly(8));
        assert_eq!(cycles(&TWO_BANKS, &[(ram, 4), (ram + 10, 4)]), Range::new(9, 11));
    }

    #[test]
    fn ccm_has_neither_wait_states_nor_misses() {
        assert_eq!(cycles(&TWO_BANKS, &[(0x1000_0000, 500)]), Range::exactly(500));
    }

    #[test]
    fn data_from_flash_is_cached() {
        let read = |addresses: &[u32], access: &Access| {
            let mut model = Model::new(0);
            for &address in addresses {
                model.data(address, 4, access);
            }
            model.total(0)
        };
        let start = flash::START;
        assert_eq!(read(&[start, start + 28, start], &TWO_BANKS), Range::new(4, 20 + 1 + 1));
        let off = Access { data_cache: false, ..TWO_BANKS };
        assert_eq!(read(&[start, start], &off), Range::new(8, 10));
        let nine: Vec<u32> = (0..9).chain([0]).map(|line| start + line * LINE).collect();
        assert_eq!(read(&nine, &TWO_BANKS).least, 40, "the first of nine lines is gone");
        assert_eq!(read(&[0x2000_0000], &TWO_BANKS), Range::default());
        assert_eq!(read(&[0x2000_0002], &TWO_BANKS), UNALIGNED);
    }

    #[test]
    fn exceptions_cost_their_frames_and_chain() {
        let mut model = Model::new(0);
        model.enter(&TWO_BANKS);
        assert_eq!(model.total(0), Range::new(12, 48));
        model.leave();
        assert_eq!(model.total(0), Range::new(22, 77));
        model.enter(&TWO_BANKS);
        assert_eq!(model.total(0), Range::new(18, 125), "6 for return and entry");
    }

    #[test]
    fn only_the_chips_registers_may_be_slow() {
        let mut model = Model::new(0);
        model.register(0xe000_e100);
        assert_eq!(model.total(0), Range::default());
        model.register(0x4000_6000);
        assert_eq!(model.total(0), PERIPHERAL);
    }

    #[test]
    fn transfers_since_the_start_may_delay_the_core() {
        assert_eq!(Model::new(10).total(13), Range::new(0, 6));
    }
}
