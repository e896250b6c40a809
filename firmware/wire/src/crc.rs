//! CRC-32 of Ethernet and zip (ISO-HDLC: polynomial 0x04C11DB7 reflected, start and end 0xFFFFFFFF).
//!
//! Four bits at a time: the table takes 64 bytes of a device's flash, where the usual one takes 1024.

/// Bits taken at once.
const BITS: u32 = 4;

/// The polynomial, reflected.
const POLYNOMIAL: u32 = 0xEDB8_8320;

static TABLE: [u32; 1 << BITS] = {
    let mut table = [0; 1 << BITS];
    let mut entry = 0;
    while entry < table.len() {
        let mut value = entry as u32;
        let mut bit = 0;
        while bit < BITS {
            value = if value & 1 == 1 { (value >> 1) ^ POLYNOMIAL } else { value >> 1 };
            bit += 1;
        }
        table[entry] = value;
        entry += 1;
    }
    table
};

/// A CRC-32 in progress.
///
/// ```
/// let mut crc = inerter_wire::Crc32::new();
/// crc.update(b"1234");
/// crc.update(b"56789");
/// assert_eq!(crc.value(), 0xCBF4_3926);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crc32(u32);

impl Crc32 {
    /// The CRC of anything that ends with its own CRC, little-endian.
    pub const OF_INTACT: u32 = 0x2144_DF1C;

    /// The CRC of no bytes yet.
    pub const fn new() -> Self {
        Self(u32::MAX)
    }

    /// The CRC of `bytes`.
    pub fn of(bytes: &[u8]) -> u32 {
        let mut crc = Self::new();
        crc.update(bytes);
        crc.value()
    }

    /// Takes more bytes.
    #[inline(never)]
    pub fn update(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 ^= u32::from(*byte);
            for _ in 0..8 / BITS {
                // Never out of bounds: the mask is the table's length less one.
                self.0 = (self.0 >> BITS) ^ TABLE[self.0 as usize % TABLE.len()];
            }
        }
    }

    /// The CRC of all bytes so far.
    pub const fn value(&self) -> u32 {
        !self.0
    }
}

impl Default for Crc32 {
    fn default() -> Self {
        Self::new()
    }
}
