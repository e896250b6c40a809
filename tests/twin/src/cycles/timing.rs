//! Execution cycles of instructions (ARM DDI 0439, 3.3 and 7.2.3), without instruction fetch.
//!
//! Where the manual gives a range or a conditional stall, the bounds are its ends: a division takes 2 to 12 cycles, a
//! store 1 or 2 (if its buffer is full), an `IT` 0 or 1, an FPU division or square root 1 (if other instructions
//! overlap it) to 14. A load takes 2 cycles, or 1 after another load whose result is not its address. The pessimistic
//! bound assumes no such pairs, and adds 1 if the previous instruction wrote the address. An instruction under an `IT`
//! may be skipped in 1 cycle. In a run of 32-bit instructions on odd halfwords, every third may cost 1 more
//! (<https://compendium.i-0.nl/docs/instruction-alignment/rules>, measured: one for a group of three, sometimes more).

/// A number of cycles between two bounds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Range {
    /// Optimistic bound.
    pub least: u64,
    /// Pessimistic bound.
    pub most: u64,
}

impl Range {
    /// A range from its bounds.
    pub const fn new(least: u64, most: u64) -> Self {
        Self { least, most }
    }

    /// The same number as both bounds.
    pub const fn exactly(cycles: u64) -> Self {
        Self::new(cycles, cycles)
    }

    /// The difference to an earlier count.
    pub fn since(self, earlier: Self) -> Self {
        Self::new(self.least - earlier.least, self.most - earlier.most)
    }
}

impl std::ops::AddAssign for Range {
    fn add_assign(&mut self, other: Self) {
        self.least += other.least;
        self.most += other.most;
    }
}

/// An instruction's own time, and what affects the next one's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Instruction {
    cost: Range,
    /// A load, which takes a cycle less after another one whose result is not its address.
    loads: bool,
    /// Number of following instructions that it makes conditional.
    conditional: u32,
    /// Registers written, as a bit mask.
    writes: u16,
    /// Registers that form the address, as a bit mask.
    address: u16,
}

fn plain(least: u64, most: u64) -> Instruction {
    Instruction { cost: Range::new(least, most), ..Instruction::default() }
}

fn one(register: u16) -> Instruction {
    Instruction { writes: 1 << register, ..plain(1, 1) }
}

fn access(load: bool, register: u16, address: u16) -> Instruction {
    match load {
        true => Instruction { loads: true, writes: 1 << register, address, ..plain(2, 2) },
        false => Instruction { address, ..plain(1, 2) },
    }
}

/// A load or store of several words: one cycle plus one per word.
fn several(words: u32, base: u16) -> Instruction {
    Instruction { cost: Range::exactly(1 + u64::from(words)), address: 1 << base, ..Instruction::default() }
}

const SP: u16 = 13;
const PC: u16 = 15;

fn narrow(half: u16) -> Instruction {
    let low = |at: u32| half >> at & 7;
    match half >> 12 {
        0x2 | 0x3 | 0xa => one(low(8)),
        0x4 if half & 0x0800 != 0 => access(true, low(8), 0),
        0x4 if half & 0x0400 != 0 => one(half >> 4 & 8 | low(0)),
        0x5 => access(half >> 9 & 7 >= 3, low(0), 1 << low(3) | 1 << low(6)),
        0x6..=0x8 => access(half & 0x0800 != 0, low(0), 1 << low(3)),
        0x9 => access(half & 0x0800 != 0, low(8), 1 << SP),
        0xb => match half & 0x0f00 {
            0x0000 => one(SP),
            0x0400 | 0x0500 | 0x0c00 | 0x0d00 => several((half & 0x1ff).count_ones(), SP),
            0x0600 => plain(1, 2),
            0x0f00 if half & 0xf != 0 => Instruction { conditional: 4 - (half & 0xf).trailing_zeros(), ..plain(0, 1) },
            0x0200 | 0x0a00 => one(low(0)),
            _ => plain(1, 1),
        },
        0xc => several((half & 0xff).count_ones(), low(8)),
        0xd | 0xe => plain(1, 1),
        _ => one(low(0)),
    }
}

fn wide(first: u16, second: u16) -> Instruction {
    let (base, destination, target) = (first & 0xf, second >> 8 & 0xf, second >> 12);
    match first >> 8 & 0x1f {
        0x08 | 0x09 if first & 0x40 == 0 => several(second.count_ones(), base),
        // TBB and TBH: "at least six"; the caller counts one of them as the branch's refill.
        0x08 if first & 0xfff0 == 0xe8d0 && second & 0xffe0 == 0xf000 => plain(5, 5),
        // Exclusive access.
        0x08 if first & 0x01e0 == 0x0040 || first & 0xffe0 == 0xe8c0 => {
            Instruction { address: 1 << base, ..plain(2, 2) }
        }
        0x08 | 0x09 => several(2, base),
        0x0c..=0x0f | 0x1c..=0x1f => floating(first, second),
        0x10..=0x17 if second & 0x8000 == 0 => one(destination),
        0x10..=0x17 if second & 0xd000 == 0x8000 && first & 0x0380 == 0x0380 => match first & 0xfff0 {
            // DSB, DMB, ISB: may wait for writes, or refill the pipeline.
            0xf3b0 => plain(1, 5),
            0xf3a0 => plain(1, 1),
            _ => plain(1, 2),
        },
        0x10..=0x17 => plain(1, 1),
        0x18 | 0x19 => {
            let load = first & 0x10 != 0;
            let index = if first & 0x80 == 0 && second & 0x0fc0 == 0 { 1 << (second & 0xf) } else { 0 };
            let address = if base == PC { 0 } else { 1 << base };
            match (load && target == PC, first >> 5 & 3) {
                // A load to PC: "at least five", counted as above.
                (true, 2) => Instruction { address: address | index, ..plain(4, 4) },
                // A preload hint.
                (true, _) => plain(1, 1),
                (false, _) => access(load, target, address | index),
            }
        }
        0x1b if first & 0x00d0 == 0x0090 => Instruction { writes: 1 << destination, ..plain(2, 12) },
        0x1b if first & 0x0080 != 0 => Instruction { writes: 1 << destination | 1 << target, ..plain(1, 1) },
        _ => one(destination),
    }
}

fn floating(first: u16, second: u16) -> Instruction {
    let base = first & 0xf;
    if first & 0xffe0 == 0xec40 {
        return plain(2, 2);
    }
    if first & 0xfe00 == 0xec00 {
        let words = match first & 0x0120 {
            0x0100 => 1 + u32::from(second >> 8 & 1),
            _ => u32::from(second & 0xff),
        };
        return several(words, base);
    }
    if second & 0x10 != 0 {
        return plain(1, 2);
    }
    // The next instruction may wait a cycle for the result.
    match first >> 4 & 0xb {
        0x0 | 0x1 | 0x9 | 0xa => plain(3, 4),
        0x8 => plain(1, 14),
        0xb if base == 1 && second >> 6 & 3 == 3 => plain(1, 14),
        _ => plain(1, 2),
    }
}

/// The halfwords of a block of instructions.
pub fn halves(code: &[u8]) -> impl Iterator<Item = u16> {
    code.as_chunks().0.iter().copied().map(u16::from_le_bytes)
}

/// Execution cycles of a block of instructions at this address.
pub fn cost(address: u32, code: &[u8]) -> Range {
    let mut total = Range::default();
    let (mut at, mut across_words) = (address, 0);
    let mut before = Instruction::default();
    let mut conditional = 0;
    let mut halves = halves(code);
    while let Some(half) = halves.next() {
        // A halfword of 0xe800 or more starts a 32-bit instruction (DDI 0403, A5.1).
        let is_narrow = half < 0xe800;
        let instruction = if is_narrow { narrow(half) } else { wide(half, halves.next().unwrap_or(0)) };
        across_words = if is_narrow || at & 2 == 0 { 0 } else { across_words + 1 };
        at += if is_narrow { 2 } else { 4 };
        let depends = before.writes & instruction.address != 0;
        let mut range = instruction.cost;
        range.least -= u64::from(before.loads && instruction.loads && !depends);
        range.most += u64::from(depends) + u64::from(across_words > 0 && across_words % 3 == 0);
        if conditional > 0 {
            conditional -= 1;
            range.least = range.least.min(1);
        }
        if instruction.conditional > 0 {
            conditional = instruction.conditional;
        }
        total += range;
        before = instruction;
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(halves: &[u16]) -> (u64, u64) {
        let code: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
        let Range { least, most } = cost(0, &code);
        (least, most)
    }

    #[test]
    fn three_wide_instructions_on_odd_halfwords_may_cost_one_more() {
        // This many times: add.w r0, r1, r2
        let most = |address, instructions| cost(address, &[0x01, 0xeb, 0x02, 0x00].repeat(instructions)).most;
        assert_eq!([0, 2, 3, 6].map(|instructions| most(0x2000_0000, instructions)), [0, 2, 3, 6]);
        assert_eq!([0, 2, 3, 5, 6].map(|instructions| most(0x2000_0002, instructions)), [0, 2, 4, 6, 8]);
    }

    #[test]
    fn single_instructions_take_what_the_manual_says() {
        let table: [(&str, &[u16], (u64, u64)); 33] = [
            ("adds r0, r1, r2", &[0x1888], (1, 1)),
            ("movs r0, #1", &[0x2001], (1, 1)),
            ("muls r0, r1", &[0x4348], (1, 1)),
            ("mov r8, r0", &[0x4680], (1, 1)),
            ("bx lr", &[0x4770], (1, 1)),
            ("ldr r0, [pc, #4]", &[0x4801], (2, 2)),
            ("ldr r0, [r1, r2]", &[0x5888], (2, 2)),
            ("str r0, [r1]", &[0x6008], (1, 2)),
            ("push {r4-r6, lr}", &[0xb570], (5, 5)),
            ("pop {r4-r6, pc}", &[0xbd70], (5, 5)),
            ("ldmia r0!, {r1-r3}", &[0xc80e], (4, 4)),
            ("cpsid i", &[0xb672], (1, 2)),
            ("nop", &[0xbf00], (1, 1)),
            ("beq", &[0xd000], (1, 1)),
            ("bl", &[0xf000, 0xf800], (1, 1)),
            ("smull r0, r1, r2, r3", &[0xfb82, 0x0103], (1, 1)),
            ("umlal r0, r1, r2, r3", &[0xfbe2, 0x0103], (1, 1)),
            ("mla r0, r1, r2, r3", &[0xfb01, 0x3002], (1, 1)),
            ("sdiv r0, r1, r2", &[0xfb91, 0xf0f2], (2, 12)),
            ("udiv r0, r1, r2", &[0xfbb1, 0xf0f2], (2, 12)),
            ("ldrd r0, r1, [r2]", &[0xe9d2, 0x0100], (3, 3)),
            ("stmdb sp!, {r4-r8, lr}", &[0xe92d, 0x41f0], (7, 7)),
            ("tbb [pc, r0]", &[0xe8df, 0xf000], (5, 5)),
            ("ldr pc, [r0]", &[0xf8d0, 0xf000], (4, 4)),
            ("ldrex r0, [r1]", &[0xe851, 0x0f00], (2, 2)),
            ("dsb", &[0xf3bf, 0x8f4f], (1, 5)),
            ("mrs r0, primask", &[0xf3ef, 0x8010], (1, 2)),
            ("add.w r0, r1, r2", &[0xeb01, 0x0002], (1, 1)),
            ("vadd.f32 s0, s0, s1", &[0xee30, 0x0a20], (1, 2)),
            ("vfma.f32 s0, s1, s2", &[0xeea0, 0x0a81], (3, 4)),
            ("vdiv.f32 s0, s1, s2", &[0xee80, 0x0a81], (1, 14)),
            ("vldr s0, [r0]", &[0xed90, 0x0a00], (2, 2)),
            ("vpush {d8-d9}", &[0xed2d, 0x8b04], (5, 5)),
        ];
        for (name, halves, expected) in table {
            assert_eq!(of(halves), expected, "{name}");
        }
    }

    #[test]
    fn loads_follow_each_other_in_a_cycle_unless_one_is_the_others_address() {
        // ldr r0, [r1]; ldr r2, [r3]
        assert_eq!(of(&[0x6808, 0x681a]), (3, 4));
        // ldr r0, [r1]; ldr r2, [r0]
        assert_eq!(of(&[0x6808, 0x6802]), (4, 5));
        // str r0, [r1]; ldr r2, [r3]: no pairing after a store
        assert_eq!(of(&[0x6008, 0x681a]), (3, 4));
        // adds r1, #4; ldr r0, [r1]
        assert_eq!(of(&[0x3104, 0x6808]), (3, 4));
        // adds r2, #4; ldr r0, [r1]
        assert_eq!(of(&[0x3204, 0x6808]), (3, 3));
    }

    /// DDI 0439, 3.3.3: "normally three cycles total" each. A branch's refill of 1 to 3 is counted separately.
    #[test]
    fn what_arm_publishes_lies_within_the_bounds() {
        let published: [(&str, &[u16], u64); 5] = [
            ("ldr r0, [r1]; ldr r1, [r2]", &[0x6808, 0x6811], 3),
            ("ldr r0, [r1, r2]; str r0, [r3, #20]", &[0x5888, 0x6158], 3),
            ("ldr r0, [r1, r2]; str r1, [r3, r2]", &[0x5888, 0x5099], 3),
            ("ldr pc, [r0]", &[0xf8d0, 0xf000], 5),
            ("tbb [pc, r0]", &[0xe8df, 0xf000], 6),
        ];
        for (name, halves, cycles) in published {
            let (mut least, mut most) = of(halves);
            if halves[0] >= 0xe800 {
                (least, most) = (least + 1, most + 3);
            }
            assert_eq!(least, cycles, "{name}");
            assert!(most <= cycles + 2, "{name}: {most}");
        }
    }

    #[test]
    fn what_stands_under_it_may_be_skipped() {
        // itt eq; ldreq r0, [r1]; pusheq {r4-r6, lr}; nop
        assert_eq!(of(&[0xbf04, 0x6808, 0xb570, 0xbf00]), (3, 9));
    }
}
