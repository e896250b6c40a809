//! The gap, the stiffness and the damping of the contact, where the terminal has a displacement sensor of its own.
//!
//! While a flank is firm, `F = ks z + cs z' - s ks eps / 2 + c`, `z = x1 - x2`. Means over blocks of 4 ms enter the
//! estimator's own least squares, in the order `[z', z, s, 1, F]`; a block counts when all its samples are firm on
//! one flank. The load cell also carries the structure mass, whose share is the terminal's own second difference.
//! Beside the products goes what a wrong scale of one displacement against the other would do: the encoder's travel
//! against the same regressors.

use crate::backlash::Newest;
use crate::backlash::flanks::Touch;
use crate::kernel::Term;
use crate::rls::{Totals, products};

/// Blocks kept: judgement may come two blocks late, and a second difference needs one on either side.
const BLOCKS: usize = 4;
/// The side and the constant.
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
    /// Force [codes] on the structure mass by the second difference of blocks [units].
    pub structure: Term,
    /// As of the flanks.
    pub guard: u8,
}

/// Sums over a block.
#[derive(Clone, Copy, Debug)]
struct Block {
    stretch: i64,
    /// From its first sample to its last.
    stretched: i32,
    force: i64,
    terminal: i64,
    travel: i64,
}

impl Block {
    const NONE: Self = Self { stretch: 0, stretched: 0, force: 0, terminal: 0, travel: 0 };
}

/// State of the sensor's route.
#[derive(Clone, Debug)]
pub(crate) struct Terminal {
    started: bool,
    /// Where displacements count from: code of the terminal, position [units].
    origin: (i32, i32),
    blocks: [Block; BLOCKS],
    /// Blocks ended.
    ended: u8,
    current: Block,
    first_stretch: i32,
    filled: u16,
    /// Samples until the first of a block is judged, then how many of it are.
    judged: i16,
    side: i8,
    pub totals: Totals,
    /// Sums of the encoder's travel with `[z', z, s, 1]` and with itself.
    pub travel: [i128; 5],
    /// Blocks on the negative and on the positive flank.
    pub sides: [u32; 2],
}

impl Terminal {
    /// Nothing seen.
    pub const fn new() -> Self {
        Self {
            started: false,
            origin: (0, 0),
            blocks: [Block::NONE; BLOCKS],
            ended: 0,
            current: Block::NONE,
            first_stretch: 0,
            filled: 0,
            judged: 0,
            side: 0,
            totals: Totals::new(),
            travel: [0; 5],
            sides: [0; 2],
        }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        *self = Self::new();
    }

    /// Samples are missing: blocks begin anew. Displacements go on from where they count.
    pub fn interrupt(&mut self) {
        (self.filled, self.current, self.side) = (0, Block::NONE, 0);
        self.judged = i16::MIN;
    }

    /// Takes a sample.
    #[inline]
    pub fn push(&mut self, active: &TerminalActive, touch: &Touch, sample: &Newest) {
        if !self.started {
            self.started = true;
            self.origin = (sample.terminal, touch.position);
            self.judged = i16::MIN;
        }
        if self.judged == i16::MIN {
            self.judged = -i16::from(active.guard);
        }
        let (terminal_origin, travel_origin) = self.origin;
        let terminal = active.units.of(i64::from(sample.terminal.wrapping_sub(terminal_origin)) << 8) as i32;
        let travel = touch.position.wrapping_sub(travel_origin);
        let stretch = terminal.wrapping_sub(travel);
        if self.filled == 0 {
            self.first_stretch = stretch;
        }
        self.filled += 1;
        self.current.stretch += i64::from(stretch);
        self.current.force += i64::from(sample.force);
        self.current.terminal += i64::from(terminal);
        self.current.travel += i64::from(travel);
        if self.filled >= active.block {
            self.current.stretched = stretch.wrapping_sub(self.first_stretch);
            self.blocks[usize::from(self.ended) % BLOCKS] = self.current;
            self.ended = self.ended.wrapping_add(1);
            (self.current, self.filled) = (Block::NONE, 0);
        }
        if self.judged >= 0 {
            self.side = if self.judged == 0 || self.side == touch.judged { touch.judged } else { 0 };
        }
        self.judged += 1;
        if self.judged >= active.block as i16 {
            self.judged = 0;
            if self.side != 0 {
                self.learn(active);
            }
        }
    }

    /// Takes the block that has just been judged.
    fn learn(&mut self, active: &TerminalActive) {
        // Ended since the one that was judged: with a guard of one to two blocks, one or two.
        let late = if u16::from(active.guard) >= 2 * active.block { 2 } else { 1 };
        let block = |back: u8| self.blocks[usize::from(self.ended.wrapping_sub(back)) % BLOCKS];
        let (after, here, before) = (block(late), block(late + 1), block(late + 2));
        let bend = after.terminal.wrapping_sub(2 * here.terminal).wrapping_add(before.terminal);
        let force = here.force.wrapping_sub(active.structure.of(bend));
        let [Ok(stretch), Ok(force), Ok(travel)] = [here.stretch, force, here.travel].map(i32::try_from) else {
            return;
        };
        let [negative, positive] = &mut self.sides;
        let side = if self.side > 0 { positive } else { negative };
        *side = side.saturating_add(1);
        let regressors = [here.stretched, stretch, i32::from(self.side) * ONE, ONE, force];
        self.totals.update(&products(&regressors));
        let [a, b, c, d, _] = regressors;
        for (sum, other) in self.travel.iter_mut().zip([a, b, c, d, travel]) {
            *sum += i128::from(i64::from(travel) * i64::from(other));
        }
    }
}
