//! System memory: ST's factory contents (RM0440 table 3 and section 48, DS12288 section 3.18).
//!
//! The boot loader consists of two vectors and an endless loop. A jump there ends the run, or [`crate::boot_rom`] takes
//! over. The real one starts the program by a jump, not by a reset, and the state in which it leaves the chip is
//! uncertain ([`Left`]): AN2606 says that its "go" command does not restore registers, AN3155 says that it does.

use super::adc::{TS_CAL1, TS_CAL2, VREFINT_CAL};

/// First address.
pub const START: u32 = 0x1fff_0000;
/// Size \[bytes\].
pub const LEN: usize = 64 << 10;
/// End address of the boot loader's code.
pub const CODE_END: u32 = 0x1fff_7000;

/// Initial stack pointer and entry point of the boot loader.
pub const VECTORS: [u32; 2] = [0x2000_3000, START + 0x101];

/// Unique device ID: position on the wafer, wafer number and lot number, with the values of a real chip.
pub const UID: [u32; 3] = [0x0039_0025, 0x5836_500a, 0x2034_3356];

/// Address of the flash size register, in kilobytes (RM0440 48.2).
pub const FLASH_KB_AT: u32 = 0x1fff_75e0;
/// Flash size of the chip on both boards \[KB\].
pub const FLASH_KB: u16 = 512;

/// Package register: LQFP64 (RM0440 48.3).
const PACKAGE: (u32, u32) = (0x1fff_7500, 0);

/// RAM that the boot loader uses (AN2606, STM32G47xxx: 16 KB from 0x2000_0000).
const WORK: usize = 16 << 10;

/// Contents of that RAM after the boot loader has run.
pub fn noise() -> Vec<u8> {
    (0..WORK as u32).map(|n| (n.wrapping_mul(0x9e37_79b9) >> 24) as u8).collect()
}

/// State in which the boot loader leaves the chip. The MPU is unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Left {
    /// HSI48 on, the ROM mapped at address 0, VTOR at the ROM (candleLight 319 quotes AN3156 rev. 18 for this).
    Running,
    /// The same, with flash and option bytes unlocked, as the boot loader writes both, and with an error flag set.
    Unlocked,
    /// As `Running`, with the core at 72 MHz from the PLL.
    Fast,
    /// Clocks as after a reset, the ROM mapped at address 0, VTOR at the ROM.
    Slow,
    /// The same with VTOR at 0.
    Mapped,
    /// Everything as after a reset.
    Restored,
    /// The same except for the MPU: older firmware entered the ROM with its stack guard region enabled, which only a
    /// reset removes. The guard is at the end of the firmware's stack.
    Guarded,
    /// As `Restored`, but with interrupts masked, one interrupt enabled and pending, and the process stack in use.
    Masked,
}

impl Left {
    /// All eight.
    pub const ALL: [Self; 8] = [
        Self::Running,
        Self::Unlocked,
        Self::Fast,
        Self::Slow,
        Self::Mapped,
        Self::Restored,
        Self::Guarded,
        Self::Masked,
    ];

    /// Registers that differ from their state before: address and value, in order.
    ///
    /// PRIMASK and CONTROL of [`Left::Masked`] have no address; [`Left::is_masked`] stands for them.
    pub fn writes(self) -> &'static [(u32, u32)] {
        const SYSCFG_ON: (u32, u32) = (0x4002_1060, 1);
        const ROM_AT_0: (u32, u32) = (0x4001_0000, 1);
        const FLASH_AT_0: (u32, u32) = (0x4001_0000, 0);
        const ROM_VECTORS: (u32, u32) = (0xe000_ed08, START);
        const FIRST_VECTORS: (u32, u32) = (0xe000_ed08, 0);
        match self {
            // HSI48 on.
            Self::Running => &[SYSCFG_ON, ROM_AT_0, ROM_VECTORS, (0x4002_1098, 1)],
            // The keys of FLASH_KEYR and FLASH_OPTKEYR; then FLASH_CR.STRT with no operation selected, which sets
            // PGSERR.
            Self::Unlocked => &[
                SYSCFG_ON,
                ROM_AT_0,
                ROM_VECTORS,
                (0x4002_1098, 1),
                (0x4002_2008, 0x4567_0123),
                (0x4002_2008, 0xcdef_89ab),
                (0x4002_200c, 0x0819_2a3b),
                (0x4002_200c, 0x4c5d_6e7f),
                (0x4002_2014, 1 << 16),
            ],
            // Two wait states; PLL = HSI / 4 * 36 / 2; PLL on, and selected.
            Self::Fast => &[
                (0x4002_2000, 0x4_0602),
                (0x4002_100c, 2 | 3 << 4 | 36 << 8 | 1 << 24),
                (0x4002_1000, 1 << 8 | 1 << 24),
                (0x4002_1008, 3),
                SYSCFG_ON,
                ROM_AT_0,
                ROM_VECTORS,
                (0x4002_1098, 1),
            ],
            Self::Slow => &[SYSCFG_ON, ROM_AT_0, ROM_VECTORS],
            Self::Mapped => &[SYSCFG_ON, ROM_AT_0, FIRST_VECTORS, (0x4002_1060, 0)],
            Self::Restored => &[SYSCFG_ON, FLASH_AT_0, FIRST_VECTORS, (0x4002_1060, 0)],
            // MPU_RNR, RBAR, RASR (no access to 1 KB), CTRL (enabled, default memory map elsewhere).
            Self::Guarded => &[
                SYSCFG_ON,
                FLASH_AT_0,
                FIRST_VECTORS,
                (0x4002_1060, 0),
                (0xe000_ed98, 0),
                (0xe000_ed9c, 0x2000_c000),
                (0xe000_eda0, 1 << 28 | 9 << 1 | 1),
                (0xe000_ed94, 1 << 2 | 1),
            ],
            // SysTick, and interrupt 0.
            Self::Masked => &[
                SYSCFG_ON,
                FLASH_AT_0,
                FIRST_VECTORS,
                (0x4002_1060, 0),
                (0xe000_e014, 0xff_ffff),
                (0xe000_e010, 7),
                (0xe000_e100, 1),
                (0xe000_e200, 1),
            ],
        }
    }
}

impl Left {
    /// Whether PRIMASK and CONTROL.SPSEL are 1.
    pub fn is_masked(self) -> bool {
        self == Self::Masked
    }
}

/// The contents of system memory.
pub fn bytes() -> Vec<u8> {
    let mut bytes = vec![0xff; LEN];
    let mut put = |address: u32, data: &[u8]| {
        let at = (address - START) as usize;
        bytes[at..at + data.len()].copy_from_slice(data);
    };
    // Initial stack pointer and entry point of the boot loader; at the entry point, a branch to itself.
    put(START, &VECTORS[0].to_le_bytes());
    put(START + 4, &VECTORS[1].to_le_bytes());
    put(START + 0x100, &0xe7feu16.to_le_bytes());
    for (address, word) in (0x1fff_7590..).step_by(4).zip(UID) {
        put(address, &word.to_le_bytes());
    }
    put(0x1fff_75a8, &TS_CAL1.to_le_bytes());
    put(0x1fff_75aa, &VREFINT_CAL.to_le_bytes());
    put(0x1fff_75ca, &TS_CAL2.to_le_bytes());
    put(FLASH_KB_AT, &FLASH_KB.to_le_bytes());
    put(PACKAGE.0, &PACKAGE.1.to_le_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holds_what_firmware_asks_for() {
        let bytes = bytes();
        assert_eq!(bytes.len(), LEN);
        assert_eq!(bytes[0x7594..0x7598], UID[1].to_le_bytes());
        assert_eq!(bytes[0x75e0..0x75e2], [0x00, 0x02]);
        assert_eq!(bytes[0x7000..0x7400], [0xff; 0x400], "one-time programmable area is empty");
    }
}
