//! Frames of six 24-bit words and their CRC.
//!
//! Commands, responses, registers and the CRC are 16 bits, at the top of their word, the low byte zero; conversions use
//! all 24. The CRC is CCITT: polynomial 0x1021, start 0xFFFF, most significant bit first, over all bytes of the words
//! before it. Source: SBAS890, "SPI Communication Frames", "Communication Cyclic Redundancy Check (CRC)".

use crate::registers::Register;

/// Channels of the chip.
pub const CHANNELS: usize = 4;
/// Bytes of one word.
pub(crate) const WORD_BYTES: usize = 3;
/// Bytes of one frame: command or response, four channels, CRC.
pub const FRAME_BYTES: usize = (CHANNELS + 2) * WORD_BYTES;
/// Where the CRC of the chip's frame lies.
pub(crate) const CRC_OFFSET: usize = FRAME_BYTES - WORD_BYTES;

/// One frame as it is on the wire.
pub(crate) type Frame = [u8; FRAME_BYTES];

/// A command from the host. The chip answers in the next frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Command {
    Null,
    Standby,
    Wakeup,
    Lock,
    Unlock,
    Read(Register),
    Write(Register, u16),
}

/// SBAS890, "Commands", command definitions.
pub(crate) mod word {
    pub const NULL: u16 = 0x0000;
    #[cfg(any(test, feature = "mock"))]
    pub const RESET: u16 = 0x0011;
    pub const STANDBY: u16 = 0x0022;
    pub const WAKEUP: u16 = 0x0033;
    pub const LOCK: u16 = 0x0555;
    pub const UNLOCK: u16 = 0x0655;
    pub const READ: u16 = 0xA000;
    pub const WRITE: u16 = 0x6000;
    /// Acknowledge of a write; the address and the number of registers less one follow.
    pub const WRITTEN: u16 = 0x4000;
    /// First response after a reset; the low digit is the number of channels.
    pub const RESET_DONE: u16 = 0xFF20;
}

impl Command {
    pub(crate) const fn word(self) -> u16 {
        match self {
            Self::Null => word::NULL,
            Self::Standby => word::STANDBY,
            Self::Wakeup => word::WAKEUP,
            Self::Lock => word::LOCK,
            Self::Unlock => word::UNLOCK,
            Self::Read(register) => word::READ | (register.address() as u16) << 7,
            Self::Write(register, _) => word::WRITE | (register.address() as u16) << 7,
        }
    }

    /// What the chip must answer, if that is known beforehand.
    pub(crate) const fn acknowledge(self) -> Option<u16> {
        match self {
            Self::Null | Self::Read(_) => None,
            Self::Write(register, _) => Some(word::WRITTEN | (register.address() as u16) << 7),
            _ => Some(self.word()),
        }
    }

    /// The frame that carries it. The CRC is always included: a chip that does not check ignores the word.
    pub(crate) const fn frame(self) -> Frame {
        let mut bytes = [0; FRAME_BYTES];
        let mut end = 0;
        let command = self.word().to_be_bytes();
        [bytes[end], bytes[end + 1]] = command;
        end += WORD_BYTES;
        if let Self::Write(_, value) = self {
            let value = value.to_be_bytes();
            [bytes[end], bytes[end + 1]] = value;
            end += WORD_BYTES;
        }
        let check = crc(bytes.split_at(end).0).to_be_bytes();
        [bytes[end], bytes[end + 1]] = check;
        bytes
    }
}

/// The chip's reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Reply {
    /// Response to the command of the previous frame.
    pub response: u16,
    /// Conversions, sign extended.
    pub channels: [i32; CHANNELS],
}

/// Why a frame from the chip cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Damage {
    /// Every bit the same.
    Silent { high: bool },
    /// The last word is not the CRC of the others.
    Crc { received: u32, computed: u32 },
}

/// Decodes a frame from the chip.
///
/// The last word is compared whole, so that each of the 144 bits is covered (test `each_flipped_bit_is_found`).
pub(crate) fn decode(frame: &Frame) -> Result<Reply, Damage> {
    if frame.iter().all(|&byte| byte == 0x00) || frame.iter().all(|&byte| byte == 0xFF) {
        return Err(Damage::Silent { high: frame[0] != 0 });
    }
    let (body, last) = frame.split_at(CRC_OFFSET);
    let computed = (crc(body) as u32) << 8;
    let received = u32::from_be_bytes([0, last[0], last[1], last[2]]);
    if received != computed {
        return Err(Damage::Crc { received, computed });
    }
    let mut channels = [0; CHANNELS];
    for (channel, bytes) in channels.iter_mut().zip(body[WORD_BYTES..].chunks_exact(WORD_BYTES)) {
        *channel = i32::from_be_bytes([bytes[0], bytes[1], bytes[2], 0]) >> 8;
    }
    Ok(Reply { response: u16::from_be_bytes([frame[0], frame[1]]), channels })
}

/// CRC-16 CCITT, start 0xFFFF. Two table steps a byte: 32 bytes of table in place of 512.
pub const fn crc(bytes: &[u8]) -> u16 {
    const TABLE: [u16; 16] = {
        let mut table = [0; 16];
        let mut index = 0;
        while index < table.len() {
            let mut remainder = (index as u16) << 12;
            let mut bit = 0;
            while bit < 4 {
                let carry = remainder & 0x8000 != 0;
                remainder <<= 1;
                if carry {
                    remainder ^= 0x1021;
                }
                bit += 1;
            }
            table[index] = remainder;
            index += 1;
        }
        table
    };
    let mut remainder: u16 = 0xFFFF;
    let mut index = 0;
    while index < bytes.len() {
        let byte = bytes[index] as u16;
        remainder = remainder << 4 ^ TABLE[(remainder >> 12 ^ byte >> 4) as usize & 15];
        remainder = remainder << 4 ^ TABLE[(remainder >> 12 ^ byte) as usize & 15];
        index += 1;
    }
    remainder
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The check value that catalogues give for CRC-16/IBM-3740, which is this one.
    #[test]
    fn crc_has_the_published_check_value() {
        assert_eq!(crc(b"123456789"), 0x29B1);
    }

    /// A frame of a real, locked chip without a clock: TI's E2E forum, thread 1011774.
    #[test]
    fn a_frame_of_a_real_chip_decodes() {
        let mut frame = [0; FRAME_BYTES];
        frame[0] = 0x81;
        frame[CRC_OFFSET..].copy_from_slice(&[0xB4, 0x2D, 0x00]);
        assert_eq!(decode(&frame), Ok(Reply { response: 0x8100, channels: [0; 4] }));
    }

    #[test]
    fn conversions_keep_their_sign() {
        let mut frame = [0; FRAME_BYTES];
        frame[..2].copy_from_slice(&0x050F_u16.to_be_bytes());
        frame[3..15].copy_from_slice(&[0x7F, 0xFF, 0xFF, 0x80, 0, 0, 0xFF, 0xFF, 0xFF, 0, 0, 1]);
        let check = crc(&frame[..CRC_OFFSET]).to_be_bytes();
        frame[CRC_OFFSET..CRC_OFFSET + 2].copy_from_slice(&check);
        let reply = decode(&frame).expect("sound");
        assert_eq!(reply.channels, [0x7F_FFFF, -0x80_0000, -1, 1]);
        assert_eq!(reply.response, 0x050F);
    }

    #[test]
    fn each_flipped_bit_is_found() {
        let mut frame = [0x5A; FRAME_BYTES];
        let check = crc(&frame[..CRC_OFFSET]).to_be_bytes();
        frame[CRC_OFFSET..].copy_from_slice(&[check[0], check[1], 0]);
        assert!(decode(&frame).is_ok());
        for bit in 0..FRAME_BYTES * 8 {
            let mut damaged = frame;
            damaged[bit / 8] ^= 0x80 >> (bit % 8);
            assert!(matches!(decode(&damaged), Err(Damage::Crc { .. })), "bit {bit}");
        }
    }

    #[test]
    fn nobody_there_is_silence() {
        assert_eq!(decode(&[0; FRAME_BYTES]), Err(Damage::Silent { high: false }));
        assert_eq!(decode(&[0xFF; FRAME_BYTES]), Err(Damage::Silent { high: true }));
    }

    #[test]
    fn commands_have_the_words_of_the_data_sheet() {
        let gain = Register::Gain;
        assert_eq!(Command::Read(gain).word(), 0b1010_0010_0000_0000);
        assert_eq!(Command::Write(gain, 0).word(), 0b0110_0010_0000_0000);
        assert_eq!(Command::Write(gain, 0).acknowledge(), Some(0b0100_0010_0000_0000));
        let frame = Command::Write(gain, 0x1234).frame();
        assert_eq!(frame[..6], [0x62, 0x00, 0, 0x12, 0x34, 0]);
        assert_eq!(frame[6..8], crc(&frame[..6]).to_be_bytes());
        assert_eq!(frame[8..], [0; 10]);
    }
}
