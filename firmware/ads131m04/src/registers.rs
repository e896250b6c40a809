//! The register map.
//!
//! Source: SBAS890, "Register Map". All are 16 bits; addresses left out are reserved.

/// A register that the driver reads or writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Register {
    /// Number of channels and revision.
    Id,
    /// See [`Status`].
    Status,
    /// CRC, word length, DRDY.
    Mode,
    /// Channels, OSR, power.
    Clock,
    /// Gain of each channel.
    Gain,
    /// Global chop and current detection.
    Cfg,
    /// Current detection threshold, bits 23 to 8.
    ThresholdHigh,
    /// Current detection threshold, bits 7 to 0, and the DC block filter.
    ThresholdLow,
    /// Phase and input of a channel.
    ChannelCfg(Channel),
    /// Offset, bits 23 to 8.
    OffsetHigh(Channel),
    /// Offset, bits 7 to 0.
    OffsetLow(Channel),
    /// Gain trim, bits 23 to 8.
    TrimHigh(Channel),
    /// Gain trim, bits 7 to 0.
    TrimLow(Channel),
}

/// One of the four channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Channel {
    /// AIN0.
    Zero = 0,
    /// AIN1.
    One = 1,
    /// AIN2.
    Two = 2,
    /// AIN3.
    Three = 3,
}

impl Channel {
    /// All, in order.
    pub const ALL: [Self; 4] = [Self::Zero, Self::One, Self::Two, Self::Three];
}

impl Register {
    /// Its address.
    pub const fn address(self) -> u8 {
        match self {
            Self::Id => 0x00,
            Self::Status => 0x01,
            Self::Mode => 0x02,
            Self::Clock => 0x03,
            Self::Gain => 0x04,
            Self::Cfg => 0x06,
            Self::ThresholdHigh => 0x07,
            Self::ThresholdLow => 0x08,
            Self::ChannelCfg(channel) => 0x09 + 5 * channel as u8,
            Self::OffsetHigh(channel) => 0x0A + 5 * channel as u8,
            Self::OffsetLow(channel) => 0x0B + 5 * channel as u8,
            Self::TrimHigh(channel) => 0x0C + 5 * channel as u8,
            Self::TrimLow(channel) => 0x0D + 5 * channel as u8,
        }
    }
}

/// High byte of ID, masked: four channels of this family.
pub const ID: u16 = 0x2400;
/// Bits of ID that are the same in every revision.
pub const ID_MASK: u16 = 0xFF00;

/// Bits of MODE.
pub mod mode {
    /// Watch the register map by a CRC; a change sets REG_MAP in STATUS.
    pub const REGCRC_EN: u16 = 1 << 13;
    /// Check the CRC of frames to the chip.
    pub const RX_CRC_EN: u16 = 1 << 12;
    /// Reset happened; write zero to clear it.
    pub const RESET: u16 = 1 << 10;
    /// Words of 24 bits.
    pub const WLENGTH_24: u16 = 1 << 8;
    /// A frame that takes longer than 2^15 CLKIN periods ends.
    pub const TIMEOUT: u16 = 1 << 4;
}

/// Bits of CLOCK.
pub mod clock {
    /// All four channels convert.
    pub const ALL_CHANNELS: u16 = 0x0F00;
    /// Position of OSR\[2:0\].
    pub const OSR_SHIFT: u32 = 2;
}

/// Bits of CFG.
pub mod cfg {
    /// Global chop delay after reset, 16 tMOD. Chop itself stays off: it changes the group delay that positions are
    /// matched to.
    pub const GC_DLY_16: u16 = 0x0600;
    /// Global chop.
    pub const GC_EN: u16 = 1 << 8;
    /// Current detection.
    pub const CD_EN: u16 = 1 << 0;
}

/// Gain of a channel's amplifier: full scale is 1.2 V divided by it.
///
/// From 8 on both inputs must stay between AGND - 1.3 V and AVDD - 1.8 V, below that they may reach AVDD
/// (SBAS890, "Recommended Operating Conditions").
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[repr(u8)]
pub enum Gain {
    /// +-1.2 V.
    #[default]
    X1 = 0,
    /// +-600 mV.
    X2 = 1,
    /// +-300 mV.
    X4 = 2,
    /// +-150 mV.
    X8 = 3,
    /// +-75 mV.
    X16 = 4,
    /// +-37.5 mV.
    X32 = 5,
    /// +-18.75 mV.
    X64 = 6,
    /// +-9.375 mV.
    X128 = 7,
}

impl Gain {
    /// The factor.
    pub const fn factor(self) -> u32 {
        1 << self as u32
    }
}

/// The STATUS register, which is also the response to a NULL command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Status(pub u16);

impl Status {
    /// Interface locked: writes are ignored.
    pub const LOCK: u16 = 1 << 15;
    /// The conversions were restarted.
    pub const F_RESYNC: u16 = 1 << 14;
    /// The register map changed.
    pub const REG_MAP: u16 = 1 << 13;
    /// The chip refused the previous frame: CRC.
    pub const CRC_ERR: u16 = 1 << 12;
    /// Which CRC: 0 CCITT.
    pub const CRC_TYPE: u16 = 1 << 11;
    /// A reset happened and was not cleared in MODE.
    pub const RESET: u16 = 1 << 10;
    /// Word length; 1 is 24 bits.
    pub const WLENGTH: u16 = 3 << 8;
    /// New conversion on each channel.
    pub const DRDY: u16 = 0x000F;

    /// Whether the interface is locked.
    pub const fn locked(self) -> bool {
        self.0 & Self::LOCK != 0
    }

    /// Whether the conversions were restarted since STATUS was last read.
    pub const fn resynchronised(self) -> bool {
        self.0 & Self::F_RESYNC != 0
    }

    /// Whether the register map changed since STATUS was last read.
    pub const fn registers_changed(self) -> bool {
        self.0 & Self::REG_MAP != 0
    }

    /// Whether the chip refused the previous frame.
    pub const fn input_crc_error(self) -> bool {
        self.0 & Self::CRC_ERR != 0
    }

    /// Whether the chip was reset and not set up since.
    pub const fn was_reset(self) -> bool {
        self.0 & Self::RESET != 0
    }

    /// Whether every channel has a conversion that was not read yet.
    pub const fn all_ready(self) -> bool {
        self.0 & Self::DRDY == Self::DRDY
    }

    /// Whether any channel has a conversion that was not read yet.
    pub const fn any_ready(self) -> bool {
        self.0 & Self::DRDY != 0
    }

    /// Whether CRC type and word length are ours, and the reserved bits zero.
    pub const fn is_plausible(self) -> bool {
        self.0 & (Self::CRC_TYPE | Self::WLENGTH | 0x00F0) == 0x0100
    }
}
