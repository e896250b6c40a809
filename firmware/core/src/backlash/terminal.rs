//! Backlash, stiffness and damping of the contact, where the terminal has a displacement sensor of its own.
//!
//! While a flank is firm, `F = ks z + cs z' - chi ks eps / 2 + c`, `z = x1 - x2`. Means over blocks of 4 ms enter the
//! estimator's own least squares, in the order `[z', z, chi, 1, F]`; a block counts when all its samples are firm on
//! one flank. The load cell also carries the structure mass; its share follows from the terminal's own second
//! difference. Beside the products, those of the encoder's travel with the same regressors are summed. They show what a
//! scale error between the two displacements would do.
//!
//! Each flank's blocks are also summed separately. Where one flank follows the other, their means and the contact's law
//! from all blocks so far give the backlash of that one reversal; neighbouring reversals share a flank.

use crate::backlash::flanks::{Newest, Touch};
use crate::qformat::Term;
use crate::rls::{Totals, products};

/// Blocks kept: classification may come two blocks late, and a second difference needs one on either side.
const BLOCKS: usize = 4;
/// The constant regressor, and the magnitude of the side.
pub(crate) const ONE: i32 = 1 << 20;

/// Settings of the sensor.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TerminalActive {
    /// Whether there is one.
    pub present: bool,
    /// Units per code of the sensor.
    pub units: Term,
    /// Samples in a block.
    pub block: u16,
    /// Force [codes] on the structure mass per second difference of blocks [units].
    pub structure: Term,
    /// The guard of the flanks [samples].
    pub guard: u8,
}

/// Sums over a block as it fills: codes of the terminal, travel [units], force [codes].
#[derive(Clone, Copy, Debug)]
struct Sums {
    terminal: i64,
    travel: i64,
    force: i64,
}

impl Sums {
    const NONE: Self = Self { terminal: 0, travel: 0, force: 0 };
}

/// Sums over a whole block, displacements in units.
#[derive(Clone, Copy, Debug)]
struct Block {
    stretch: i64,
    /// Change of the stretch from its first sample to its last.
    stretched: i32,
    force: i64,
    terminal: i64,
}

impl Block {
    const NONE: Self = Self { stretch: 0, stretched: 0, force: 0, terminal: 0 };
}

/// The blocks of one flank, from its first touch to the other flank's.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Flank {
    pub side: i8,
    pub blocks: u32,
    /// Sums of `[z', z, F]`, the structure's share subtracted.
    pub sums: [i64; 3],
    /// Indices of its first and last sample.
    pub first: u32,
    pub last: u32,
}

impl Flank {
    const NONE: Self = Self { side: 0, blocks: 0, sums: [0; 3], first: 0, last: 0 };
}

/// Two flanks, one after the other.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Crossing {
    pub before: Flank,
    pub after: Flank,
}

/// State of the sensor's route.
#[derive(Clone, Debug)]
pub(crate) struct Terminal {
    started: bool,
    /// Zero of the displacements: code of the terminal, position [units].
    origin: (i32, i32),
    blocks: [Block; BLOCKS],
    /// Number of blocks completed.
    ended: u8,
    sums: Sums,
    /// Terminal and travel of the first sample in the present block.
    first: (i32, i32),
    filled: u16,
    /// Samples until the first of a block is classified, then the number of its samples that are.
    classified: i16,
    side: i8,
    pub totals: Totals,
    /// Sums of the encoder's travel with `[z', z, s, 1]` and with itself.
    pub travel: [i128; 5],
    /// Blocks on the negative and on the positive flank.
    pub sides: [u32; 2],
    /// The present flank, and the one before it.
    flank: Flank,
    before: Flank,
    /// A completed reversal, and whether it waits to be returned: checked at every sample, an option would be copied.
    crossing: Crossing,
    pub waits: bool,
}

impl Terminal {
    /// Nothing seen.
    pub const fn new() -> Self {
        Self {
            started: false,
            origin: (0, 0),
            blocks: [Block::NONE; BLOCKS],
            ended: 0,
            sums: Sums::NONE,
            first: (0, 0),
            filled: 0,
            classified: 0,
            side: 0,
            totals: Totals::new(),
            travel: [0; 5],
            sides: [0; 2],
            flank: Flank::NONE,
            before: Flank::NONE,
            crossing: Crossing { before: Flank::NONE, after: Flank::NONE },
            waits: false,
        }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        *self = Self::new();
    }

    /// Samples are missing: blocks start again. The zero of the displacements stays.
    pub fn interrupt(&mut self) {
        (self.filled, self.sums, self.side) = (0, Sums::NONE, 0);
        self.classified = i16::MIN;
        self.part();
        self.before = Flank::NONE;
    }

    /// The reversal that waited.
    pub fn take(&mut self) -> Crossing {
        self.waits = false;
        self.crossing
    }

    /// Takes a sample.
    #[inline]
    pub fn push(&mut self, active: &TerminalActive, touch: &Touch, sample: &Newest) {
        if !self.started {
            self.started = true;
            self.origin = (sample.terminal, touch.position);
            self.classified = i16::MIN;
        }
        if self.classified == i16::MIN {
            self.classified = -i16::from(active.guard);
        }
        let (terminal_origin, travel_origin) = self.origin;
        let terminal = sample.terminal.wrapping_sub(terminal_origin);
        let travel = touch.position.wrapping_sub(travel_origin);
        if self.filled == 0 {
            self.first = (terminal, travel);
        }
        self.filled += 1;
        self.sums.terminal += i64::from(terminal);
        self.sums.travel += i64::from(travel);
        self.sums.force += i64::from(sample.force);
        if self.filled >= active.block {
            self.end(active, terminal, travel);
        }
        if self.classified >= 0 {
            self.side = if self.classified == 0 || self.side == touch.classified { touch.classified } else { 0 };
        }
        self.classified += 1;
        if self.classified >= active.block as i16 {
            self.classified = 0;
            if self.side != 0 {
                self.learn(active, sample.index);
            }
        }
    }

    /// Completes a block with this sample.
    #[inline(never)]
    fn end(&mut self, active: &TerminalActive, terminal: i32, travel: i32) {
        let (first_terminal, first_travel) = self.first;
        let units = |codes: i64| active.units.of(codes << 8);
        let moved = units(i64::from(terminal.wrapping_sub(first_terminal))) as i32;
        let terminal = units(self.sums.terminal);
        self.blocks[usize::from(self.ended) % BLOCKS] = Block {
            stretch: terminal.wrapping_sub(self.sums.travel),
            stretched: moved.wrapping_sub(travel.wrapping_sub(first_travel)),
            force: self.sums.force,
            terminal,
        };
        self.ended = self.ended.wrapping_add(1);
        (self.sums, self.filled) = (Sums::NONE, 0);
    }

    /// Takes the block that has just been classified.
    #[inline(never)]
    fn learn(&mut self, active: &TerminalActive, index: u32) {
        // Blocks completed since the one that was classified: with a guard of one to two blocks, one or two.
        let late = if u16::from(active.guard) >= 2 * active.block { 2 } else { 1 };
        let block = |back: u8| self.blocks[usize::from(self.ended.wrapping_sub(back)) % BLOCKS];
        let (after, here, before) = (block(late), block(late + 1), block(late + 2));
        let bend = after.terminal.wrapping_sub(2 * here.terminal).wrapping_add(before.terminal);
        let by_structure = active.structure.of(bend);
        let force = here.force.wrapping_sub(by_structure);
        // A flank whose force is mostly the structure's is none: the terminal is in flight with the load cell's mass.
        if by_structure.unsigned_abs() > here.force.unsigned_abs() / 2 {
            return;
        }
        // The encoder's travel: the terminal's motion less the stretch.
        let travel = here.terminal.wrapping_sub(here.stretch);
        let [Ok(stretch), Ok(force), Ok(travel)] = [here.stretch, force, travel].map(i32::try_from) else {
            return;
        };
        let [negative, positive] = &mut self.sides;
        let side = if self.side > 0 { positive } else { negative };
        *side = side.saturating_add(1);
        self.follow(active, index, [here.stretched, stretch, force]);
        let regressors = [here.stretched, stretch, i32::from(self.side) * ONE, ONE, force];
        self.totals.update(&products(&regressors));
        let [a, b, c, d, _] = regressors;
        for (sum, other) in self.travel.iter_mut().zip([a, b, c, d, travel]) {
            *sum += i128::from(i64::from(travel) * i64::from(other));
        }
    }

    /// Adds a classified block to its flank, or begins a flank with it.
    fn follow(&mut self, active: &TerminalActive, index: u32, added: [i32; 3]) {
        let last = index.wrapping_sub(u32::from(active.guard));
        if self.flank.side != self.side {
            self.part();
            let first = last.wrapping_sub(u32::from(active.block) - 1);
            self.flank = Flank { side: self.side, first, ..Flank::NONE };
        }
        let Flank { blocks, sums, last: end, .. } = &mut self.flank;
        (*blocks, *end) = (blocks.saturating_add(1), last);
        for (sum, added) in sums.iter_mut().zip(added) {
            *sum = sum.wrapping_add(i64::from(added));
        }
    }

    /// Ends the present flank. With the one before it, it makes a reversal.
    fn part(&mut self) {
        let (before, after) = (self.before, self.flank);
        if before.side != 0 && after.side != 0 {
            (self.crossing, self.waits) = (Crossing { before, after }, true);
        }
        (self.before, self.flank) = (after, Flank::NONE);
    }
}
