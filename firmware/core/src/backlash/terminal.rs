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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::term;
    use crate::rls::PRODUCTS;
    use inerter_needs::Random;
    use std::{format, vec::Vec};

    /// One sample: terminal, travel, force, and the flank that it turns out to touch.
    type Sample = (i32, i32, i32, i8);

    /// Blocks and structure, with a code of the terminal for a unit.
    fn active(block: u16, guard: u8, structure: f64) -> TerminalActive {
        TerminalActive { present: true, units: term(1.0 / 256.0), block, structure: term(structure), guard }
    }

    /// Flanks of 3 to 40 samples with flights between, and random displacements and forces.
    fn samples(random: &mut Random, count: usize) -> Vec<Sample> {
        let (mut side, mut left) = (0_i8, 0);
        (0..count)
            .map(|_| {
                if left == 0 {
                    (side, left) = (random.pick(&[-1, 1, 1, 0]), 3 + random.below(38_u32));
                }
                left -= 1;
                let [terminal, travel] = [(); 2].map(|()| random.below(20_001_i32) - 10_000);
                (terminal, travel, random.below(60_001_i32) - 30_000, side)
            })
            .collect()
    }

    /// What is learned of the samples: products, products of the travel, blocks on either side, the flanks, and the
    /// number of blocks whose force is mostly the structure's.
    #[derive(Default)]
    struct Learned {
        sums: [i128; PRODUCTS],
        travel: [i128; 5],
        sides: [u32; 2],
        flanks: Vec<Flank>,
        heavy: u32,
    }

    impl Learned {
        fn of(samples: &[Sample], block: usize, structure: f64) -> Self {
            let mut learned = Self::default();
            let (first_terminal, first_travel, ..) = samples[0];
            let blocks: Vec<&[Sample]> = samples.chunks_exact(block).collect();
            let terminal =
                |block: &[Sample]| block.iter().map(|sample| i64::from(sample.0 - first_terminal)).sum::<i64>();
            let travel = |block: &[Sample]| block.iter().map(|sample| i64::from(sample.1 - first_travel)).sum::<i64>();
            for (n, three) in blocks.windows(3).enumerate() {
                let [before, here, after] = [three[0], three[1], three[2]];
                let (first, last) = (here[0], here[block - 1]);
                let side = first.3;
                if side == 0 || here.iter().any(|sample| sample.3 != side) {
                    continue;
                }
                let bend = terminal(after) - 2 * terminal(here) + terminal(before);
                let by_structure = (bend as f64 * structure).floor() as i64;
                let all_force = here.iter().map(|sample| i64::from(sample.2)).sum::<i64>();
                if 2 * by_structure.abs() > all_force.abs() {
                    learned.heavy += 1;
                    continue;
                }
                let stretched = i64::from(last.0 - first.0) - i64::from(last.1 - first.1);
                let stretch = terminal(here) - travel(here);
                let force = all_force - by_structure;
                let one = 1 << 20;
                let row = [stretched, stretch, i64::from(side) * one, one, force];
                let mut place = 0;
                for (i, a) in row.iter().enumerate() {
                    for b in &row[..=i] {
                        learned.sums[place] += i128::from(*a) * i128::from(*b);
                        place += 1;
                    }
                }
                let [a, b, c, d, _] = row;
                for (sum, other) in learned.travel.iter_mut().zip([a, b, c, d, travel(here)]) {
                    *sum += i128::from(travel(here)) * i128::from(other);
                }
                learned.sides[usize::from(side > 0)] += 1;
                // The first of the three is block `n`.
                let first = ((n + 1) * block) as u32;
                if learned.flanks.last().is_none_or(|flank| flank.side != side) {
                    learned.flanks.push(Flank { side, first, ..Flank::NONE });
                }
                let flank = learned.flanks.last_mut().unwrap();
                flank.blocks += 1;
                flank.last = first + block as u32 - 1;
                for (sum, added) in flank.sums.iter_mut().zip([stretched, stretch, force]) {
                    *sum += added;
                }
            }
            learned
        }
    }

    /// Takes the samples, each with the flank of the one `guard` ago; returns the reversals in order.
    fn taken(terminal: &mut Terminal, active: &TerminalActive, samples: &[Sample]) -> Vec<Crossing> {
        let mut crossings = Vec::new();
        for (n, (code, travel, force, _)) in samples.iter().enumerate() {
            let classified = n.checked_sub(usize::from(active.guard)).map_or(0, |at| samples[at].3);
            let touch = Touch { position: *travel, classified, ..Touch::default() };
            let sample = Newest {
                index: n as u32,
                position: 0,
                force: *force,
                terminal: *code,
                good: true,
                broken: false,
                offset: 0,
            };
            terminal.push(active, &touch, &sample);
            if terminal.waits {
                crossings.push(terminal.take());
                assert!(!terminal.waits);
            }
        }
        crossings
    }

    /// Every block whose samples all touch one flank is learned with its own force less the structure's, and two flanks
    /// are a reversal once the second has ended.
    #[test]
    fn blocks_of_one_flank_are_learned_and_flanks_are_joined() {
        let mut random = Random(3);
        for (block, guard, structure) in
            [(4, 4, 0.0), (4, 5, 0.25), (4, 7, 0.25), (4, 8, 0.25), (9, 17, 0.25), (2, 3, 0.25)]
        {
            let active = active(block, guard, structure);
            let mut samples = samples(&mut random, 4000);
            // The first block has no neighbour before it, and the last one none after it.
            let many = samples.len() - 50;
            samples[..20].iter_mut().for_each(|sample| sample.3 = 0);
            samples[many..].iter_mut().for_each(|sample| sample.3 = 0);
            let mut terminal = Terminal::new();
            let crossings = taken(&mut terminal, &active, &samples);
            let wanted = Learned::of(&samples, usize::from(block), structure);
            let what = format!("{block} {guard} {structure}");
            assert!(wanted.sides.iter().all(|count| *count > 20), "{what}: {:?}", wanted.sides);
            assert_eq!(structure > 0.0, wanted.heavy > 10, "{what}: {}", wanted.heavy);
            assert_eq!(terminal.totals.sums(), &wanted.sums, "{what}");
            assert_eq!(terminal.totals.updates(), wanted.sides.iter().sum::<u32>(), "{what}");
            assert_eq!(terminal.travel, wanted.travel, "{what}");
            assert_eq!(terminal.sides, wanted.sides, "{what}");
            // The last flank has not ended.
            let (_, ended) = wanted.flanks.split_last().unwrap();
            let pairs = ended.windows(2).map(|pair| Crossing { before: pair[0], after: pair[1] });
            assert_eq!(format!("{crossings:?}"), format!("{:?}", pairs.collect::<Vec<_>>()), "{what}");
            assert!(crossings.len() > 10, "{what}: {}", crossings.len());
            terminal.reset();
            assert_eq!(format!("{terminal:?}"), format!("{:?}", Terminal::new()));
        }
    }

    /// Missing samples end the present flank: it is a reversal with the one before it, and none with the one after it.
    /// The block in progress is lost, and none is learned until the guard has passed again.
    #[test]
    fn no_flank_reaches_across_missing_samples() {
        let active = active(4, 5, 0.0);
        let run = |sides: &[(usize, i8)]| -> Vec<Sample> {
            let each = sides.iter().flat_map(|(count, side)| core::iter::repeat_n(*side, *count));
            each.map(|side| (100, 40, 1000 * i32::from(side), side)).collect()
        };
        let mut terminal = Terminal::new();
        assert_eq!(taken(&mut terminal, &active, &run(&[(20, -1), (23, 1)])).len(), 0);
        // Of the 43 samples, the last five are not classified: five blocks on the one and four on the other flank.
        assert_eq!(terminal.sides, [5, 4]);
        terminal.interrupt();
        assert!(terminal.waits);
        let crossing = terminal.take();
        assert_eq!((crossing.before.side, crossing.before.blocks), (-1, 5));
        assert_eq!((crossing.after.side, crossing.after.blocks), (1, 4));
        // Two more flanks: they are a reversal with each other only, once a third one begins.
        let crossings = taken(&mut terminal, &active, &run(&[(16, -1), (16, 1), (16, -1)]));
        assert_eq!(terminal.sides, [5 + 4 + 2, 4 + 4]);
        assert_eq!(crossings.len(), 1);
        let Crossing { before, after } = crossings[0];
        assert_eq!((before.side, before.blocks, before.first, before.last), (-1, 4, 0, 15));
        assert_eq!((after.side, after.blocks, after.first, after.last), (1, 4, 16, 31));
    }
}
