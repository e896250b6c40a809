//! Minimal firmware images.
#![allow(dead_code, reason = "each test file uses its part")]

/// ELF machine number of Arm.
pub const ARM: u16 = 40;

/// A 32-bit executable with these segments: physical address, bytes.
pub fn elf(machine: u16, segments: &[(u32, &[u8])]) -> Vec<u8> {
    let half = |value: u16| value.to_le_bytes().to_vec();
    let word = |value: u32| value.to_le_bytes().to_vec();
    let (header, entry) = (52u32, 32u32);
    let mut file = b"\x7FELF\x01\x01\x01".to_vec();
    file.resize(16, 0);
    file.extend([half(2), half(machine), word(1), word(0), word(header), word(0), word(0)].concat());
    file.extend([half(52), half(32), half(segments.len() as u16), half(40), half(0), half(0)].concat());
    let mut place = header + entry * segments.len() as u32;
    for (address, bytes) in segments {
        let length = bytes.len() as u32;
        // The run address differs from the load address, as for `.data`.
        let fields = [1, place, 0x2000_0000, *address, length, length + 8, 5, 4];
        file.extend(fields.iter().flat_map(|&field| word(field)));
        place += length;
    }
    file.extend(segments.iter().flat_map(|(_, bytes)| bytes.to_vec()));
    file
}

/// The contents at the beginning of flash: vectors, identity, and code that differs at each address.
pub fn code(length: usize, firmware: &str, git: &str, board: &str) -> Vec<u8> {
    let mut bytes = [0x2001_8000u32.to_le_bytes(), 0x0800_01ADu32.to_le_bytes()].concat();
    bytes.extend(format!("inerter-identity\0{firmware}\0{git}\0{board}\0").into_bytes());
    let noise = (0u32..).map(|index| (index.wrapping_mul(0x9E37_79B9) >> 24) as u8);
    bytes.extend(noise.take(length.saturating_sub(bytes.len())));
    bytes
}

/// An image for the board in two segments with a gap between them, `length` bytes in the first.
pub fn image(length: usize, firmware: &str, git: &str) -> Vec<u8> {
    elf(ARM, &[(0x0800_0000, &code(length, firmware, git, "nucleo-g474re")), (0x0802_0004, &[0xA5; 100])])
}
