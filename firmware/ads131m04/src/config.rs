//! The chip's configuration, and what is possible.

use crate::filter::Osr;
use crate::frame::CHANNELS;
use crate::registers::{Channel, Gain, Register, cfg, clock, mode};

/// Power mode: a higher one allows a faster clock and less noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[repr(u8)]
pub enum Power {
    /// CLKIN up to 2.08 MHz.
    VeryLow = 0,
    /// CLKIN up to 4.15 MHz.
    Low = 1,
    /// CLKIN up to 8.2 MHz at every gain.
    #[default]
    High = 2,
}

impl Power {
    /// Fastest CLKIN \[Hz\]. SBAS890, "Recommended Operating Conditions"; the 8.4 MHz there applies to the low gains
    /// only in the eight-channel sister chip (SBAS950), so 8.2 MHz for all.
    const fn clkin_max_hz(self) -> u32 {
        match self {
            Self::VeryLow => 2_080_000,
            Self::Low => 4_150_000,
            Self::High => 8_200_000,
        }
    }
}

/// Everything that is written into the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Config {
    /// Frequency at CLKIN \[Hz\].
    pub clkin_hz: u32,
    /// Oversampling ratio, the same for all channels.
    pub osr: Osr,
    /// Power mode.
    pub power: Power,
    /// Gain of each channel.
    pub gains: [Gain; CHANNELS],
    /// Delay of each channel \[tMOD\], relative to the others; negative is earlier. Within half an OSR and -512 to 511.
    pub phases: [i16; CHANNELS],
    /// Subtracted from each conversion \[codes\], 24 bits.
    pub offsets: [i32; CHANNELS],
    /// Each conversion is multiplied by this / 2^23, 24 bits: 0x80_0000 is one.
    pub trims: [u32; CHANNELS],
}

impl Default for Config {
    fn default() -> Self {
        Self {
            clkin_hz: 8_000_000,
            osr: Osr::X4096,
            power: Power::High,
            gains: [Gain::X1; CHANNELS],
            phases: [0; CHANNELS],
            offsets: [0; CHANNELS],
            trims: [0x80_0000; CHANNELS],
        }
    }
}

/// Why a [`Config`] is impossible, naming the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConfigError {
    /// `clkin_hz` is outside what the power mode allows.
    Clkin {
        /// Least \[Hz\].
        min: u32,
        /// Greatest \[Hz\].
        max: u32,
    },
    /// A phase is longer than half an OSR or than its ten bits.
    Phase {
        /// The channel.
        channel: usize,
    },
    /// An offset does not fit 24 bits.
    Offset {
        /// The channel.
        channel: usize,
    },
    /// A trim does not fit 24 bits.
    Trim {
        /// The channel.
        channel: usize,
    },
}

impl core::fmt::Display for ConfigError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Self::Clkin { min, max } => write!(f, "clkin_hz: this power mode takes {min} to {max} Hz"),
            Self::Phase { channel } => write!(f, "phases[{channel}]: at most half an OSR, and -512 to 511"),
            Self::Offset { channel } => write!(f, "offsets[{channel}]: must fit 24 bits with sign"),
            Self::Trim { channel } => write!(f, "trims[{channel}]: must fit 24 bits"),
        }
    }
}

impl core::error::Error for ConfigError {}

/// Registers that set-up writes before MODE: five of the chip, five of each channel.
pub(crate) const SETUP_REGISTERS: usize = 5 + 5 * CHANNELS;

/// MODE once set up: 24-bit words, CCITT, both CRCs, DRDY a level driven at all times, reset flag cleared.
pub(crate) const MODE: u16 = mode::REGCRC_EN | mode::RX_CRC_EN | mode::WLENGTH_24 | mode::TIMEOUT;

impl Config {
    /// Whether the chip supports it.
    pub fn check(&self) -> Result<(), ConfigError> {
        let (min, max) = (300_000, self.power.clkin_max_hz());
        if !(min..=max).contains(&self.clkin_hz) {
            return Err(ConfigError::Clkin { min, max });
        }
        let phase_limit = (self.osr.ratio() / 2).min(512) as i16;
        for channel in 0..CHANNELS {
            if !(-phase_limit..phase_limit).contains(&self.phases[channel]) {
                return Err(ConfigError::Phase { channel });
            }
            if !(-0x80_0000..0x80_0000).contains(&self.offsets[channel]) {
                return Err(ConfigError::Offset { channel });
            }
            if self.trims[channel] > 0xFF_FFFF {
                return Err(ConfigError::Trim { channel });
            }
        }
        Ok(())
    }

    /// Conversions a second: `CLKIN / 2 / OSR`.
    pub const fn data_rate_hz(&self) -> f64 {
        self.osr.data_rate_hz(self.clkin_hz)
    }

    /// Registers that set-up writes before MODE, in this order.
    pub(crate) fn registers(&self) -> [(Register, u16); SETUP_REGISTERS] {
        let gains = (0..CHANNELS).map(|channel| (self.gains[channel] as u16) << (4 * channel)).sum();
        let mut list = [(Register::Gain, gains); SETUP_REGISTERS];
        list[1] = (Register::Cfg, cfg::GC_DLY_16);
        list[2] = (Register::ThresholdHigh, 0);
        list[3] = (Register::ThresholdLow, 0);
        for (index, channel) in Channel::ALL.into_iter().enumerate() {
            let (offset, trim) = (self.offsets[index] as u32 & 0xFF_FFFF, self.trims[index]);
            list[4 + 5 * index..9 + 5 * index].copy_from_slice(&[
                (Register::ChannelCfg(channel), (self.phases[index] as u16) << 6),
                (Register::OffsetHigh(channel), (offset >> 8) as u16),
                (Register::OffsetLow(channel), (offset << 8) as u16),
                (Register::TrimHigh(channel), (trim >> 8) as u16),
                (Register::TrimLow(channel), (trim << 8) as u16),
            ]);
        }
        // Last: it restarts the filter.
        let clock = clock::ALL_CHANNELS | (self.osr as u16) << clock::OSR_SHIFT | self.power as u16;
        list[SETUP_REGISTERS - 1] = (Register::Clock, clock);
        list
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_setting_has_its_register() {
        let config = Config {
            gains: [Gain::X32, Gain::X1, Gain::X2, Gain::X128],
            phases: [-1, 0, 511, 0],
            offsets: [-2, 0, 0x12_3456, 0],
            trims: [0x80_0000, 0x80_0000, 0x80_0000, 0xAB_CDEF],
            ..Config::default()
        };
        let list = config.registers();
        let value = |address| list.iter().find(|(register, _)| register.address() == address).expect("written").1;
        assert_eq!(value(0x03), 0x0F16);
        assert_eq!(value(0x04), 0x7105);
        assert_eq!(value(0x06), 0x0600);
        assert_eq!([value(0x09), value(0x13)], [0xFFC0, 511 << 6]);
        assert_eq!([value(0x0A), value(0x0B)], [0xFFFF, 0xFE00]);
        assert_eq!([value(0x14), value(0x15)], [0x1234, 0x5600]);
        assert_eq!([value(0x0C), value(0x0D)], [0x8000, 0x0000]);
        assert_eq!([value(0x1B), value(0x1C)], [0xABCD, 0xEF00]);
        for (index, (register, _)) in list.iter().enumerate() {
            assert!(list[..index].iter().all(|(other, _)| other != register), "{register:?} twice");
        }
    }

    #[test]
    fn what_cannot_be_is_refused_by_name() {
        let good = Config::default();
        assert_eq!(good.check(), Ok(()));
        assert_eq!(
            Config { clkin_hz: 8_000_000, power: Power::Low, ..good }.check(),
            Err(ConfigError::Clkin { min: 300_000, max: 4_150_000 })
        );
        assert!(Config { clkin_hz: 0, ..good }.check().is_err());
        assert_eq!(Config { phases: [0, 512, 0, 0], ..good }.check(), Err(ConfigError::Phase { channel: 1 }));
        assert_eq!(
            Config { osr: Osr::X128, phases: [0, 0, -65, 0], ..good }.check(),
            Err(ConfigError::Phase { channel: 2 })
        );
        assert_eq!(Config { offsets: [0, 0, 0, 0x80_0000], ..good }.check(), Err(ConfigError::Offset { channel: 3 }));
        assert_eq!(Config { trims: [1 << 24, 0, 0, 0], ..good }.check(), Err(ConfigError::Trim { channel: 0 }));
    }
}
