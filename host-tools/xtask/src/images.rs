//! Formats of a firmware image for third-party tools: Intel HEX and DfuSe.
//!
//! *Part*: contiguous bytes in flash, with their address. Sources: Intel, Hexadecimal Object File Format Specification,
//! revision A (1988); ST UM0391, DfuSe file format; USB DFU 1.1, appendix B, for its suffix.

use anyhow::{Context, Result, bail, ensure};
use object::{
    Endianness,
    elf::{FileHeader32, PT_LOAD},
    read::elf::{FileHeader, ProgramHeader},
};

/// Size of a flash page, which is erased as a whole \[bytes\].
const PAGE: u64 = 2048;
/// Value of an erased byte.
const ERASED: u8 = 0xFF;
/// Data bytes per line of Intel HEX.
const LINE: usize = 16;
/// The chip's update mode: vendor, product, and the release that matches any.
const DFU_DEVICE: [u16; 3] = [0xFFFF, 0xDF11, 0x0483];
/// The version of DfuSe in the suffix.
const DFUSE: u16 = 0x011A;
/// Size of a target's name field \[bytes\].
const NAME: usize = 255;

/// Contiguous bytes in flash.
#[derive(Debug, PartialEq)]
pub struct Part {
    /// Address of the first byte.
    pub address: u32,
    /// All of them.
    pub bytes: Vec<u8>,
}

/// The parts of flash that an ELF file defines.
pub fn parts(elf: &[u8]) -> Result<Vec<Part>> {
    let header = FileHeader32::<Endianness>::parse(elf).context("the image is not a 32-bit ELF file")?;
    let endian = header.endian().context("the image has no valid byte order")?;
    let mut found = Vec::new();
    for segment in header.program_headers(endian, elf).context("the image has no segments")? {
        let bytes = segment.data(endian, elf).map_err(|()| anyhow::anyhow!("a segment lies outside the image"))?;
        if segment.p_type(endian) == PT_LOAD && !bytes.is_empty() {
            found.push(Part { address: segment.p_paddr(endian), bytes: bytes.to_vec() });
        }
    }
    joined(found)
}

/// Sorts by address and joins what lies in the same page into one part, because a tool may erase the pages of each part
/// before it writes it.
fn joined(mut found: Vec<Part>) -> Result<Vec<Part>> {
    found.sort_by_key(|part| part.address);
    let mut joined: Vec<Part> = Vec::new();
    for part in found {
        let start = u64::from(part.address);
        match joined.last_mut() {
            Some(last) if end(last) > start => bail!("segments of the image overlap at 0x{start:08X}"),
            Some(last) if (end(last) - 1) / PAGE == start / PAGE || end(last) == start => {
                last.bytes.resize((start - u64::from(last.address)) as usize, ERASED);
                last.bytes.extend(part.bytes);
            }
            _ => joined.push(part),
        }
    }
    ensure!(!joined.is_empty(), "the image has nothing for flash");
    Ok(joined)
}

fn end(part: &Part) -> u64 {
    u64::from(part.address) + part.bytes.len() as u64
}

/// Intel HEX: 16 bytes per line, the upper half of the address on separate lines.
pub fn hex(parts: &[Part]) -> String {
    let mut text = String::new();
    let mut upper = None;
    for part in parts {
        let (mut address, mut rest) = (part.address, part.bytes.as_slice());
        while !rest.is_empty() {
            if upper != Some(address >> 16) {
                upper = Some(address >> 16);
                line(&mut text, 0, 4, &((address >> 16) as u16).to_be_bytes());
            }
            // No line crosses a 64 KB boundary, where the upper half of the address changes.
            let room = 0x1_0000 - (address & 0xFFFF) as usize;
            let (now, later) = rest.split_at(rest.len().min(LINE).min(room));
            line(&mut text, address as u16, 0, now);
            address = address.wrapping_add(now.len() as u32);
            rest = later;
        }
    }
    line(&mut text, 0, 1, &[]);
    text
}

/// Length, address, kind and bytes, then a checksum that makes their sum 0.
fn line(text: &mut String, address: u16, kind: u8, bytes: &[u8]) {
    let [high, low] = address.to_be_bytes();
    let mut all = vec![bytes.len() as u8, high, low, kind];
    all.extend(bytes);
    all.push(all.iter().fold(0_u8, |sum, byte| sum.wrapping_sub(*byte)));
    text.push(':');
    all.iter().for_each(|byte| text.push_str(&format!("{byte:02X}")));
    text.push('\n');
}

/// DfuSe: one target, the chip's flash, with an element for each part; the DFU suffix ends the file.
pub fn dfuse(parts: &[Part], name: &str) -> Result<Vec<u8>> {
    let mut elements = Vec::new();
    for part in parts {
        elements.extend(part.address.to_le_bytes());
        elements.extend(u32::try_from(part.bytes.len())?.to_le_bytes());
        elements.extend(&part.bytes);
    }
    // The last byte stays 0.
    let mut named: Vec<u8> = name.bytes().take(NAME - 1).collect();
    named.resize(NAME, 0);
    // Alternate setting 0 is the flash; 1: the target has a name.
    let mut target = [&b"Target"[..], &[0], &1_u32.to_le_bytes(), &named].concat();
    target.extend(u32::try_from(elements.len())?.to_le_bytes());
    target.extend(u32::try_from(parts.len())?.to_le_bytes());
    target.extend(elements);
    const PREFIX: usize = 11;
    let mut file = [&b"DfuSe"[..], &[1], &u32::try_from(PREFIX + target.len())?.to_le_bytes(), &[1]].concat();
    file.extend(target);
    DFU_DEVICE.into_iter().chain([DFUSE]).for_each(|word| file.extend(word.to_le_bytes()));
    file.extend(b"UFD\x10");
    file.extend(crc(&file).to_le_bytes());
    Ok(file)
}

/// The CRC-32 of Ethernet, without its final inversion.
fn crc(bytes: &[u8]) -> u32 {
    bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hex_has_the_lines_of_its_specification() {
        let part = Part { address: 0x0800_FFF8, bytes: (0..20).collect() };
        let lines = [
            ":020000040800F2",
            ":08FFF8000001020304050607E5",
            ":020000040801F1",
            ":0C00000008090A0B0C0D0E0F1011121352",
            ":00000001FF",
        ];
        assert_eq!(hex(&[part]).lines().collect::<Vec<_>>(), lines);
    }

    #[test]
    fn a_dfuse_file_says_its_own_lengths() {
        let parts =
            [Part { address: 0x0800_0000, bytes: vec![1; 5] }, Part { address: 0x0802_0000, bytes: vec![2; 3] }];
        let file = dfuse(&parts, "a board").unwrap();
        let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(&file[..6], b"DfuSe\x01");
        assert_eq!((word(6), file[10]), (file.len() - 16, 1));
        assert_eq!((&file[11..17], file[17], word(18), &file[22..30]), (&b"Target"[..], 0, 1, &b"a board\0"[..]));
        // Size and number of the elements.
        assert_eq!((word(277), word(281)), (8 + 5 + 8 + 3, 2));
        assert_eq!((word(285), word(289), file[293]), (0x0800_0000, 5, 1));
        let suffix = &file[file.len() - 16..];
        assert_eq!(suffix[..12], *b"\xFF\xFF\x11\xDF\x83\x04\x1A\x01UFD\x10");
        // Over all bytes of a file including its CRC, the CRC is a constant.
        assert_eq!(crc(&file), 0);
    }

    #[test]
    fn the_crc_is_the_known_one() {
        assert_eq!(!crc(b"123456789"), 0xCBF4_3926);
    }

    #[test]
    fn no_page_lies_in_two_parts() {
        let part = |address, length| Part { address, bytes: vec![1; length] };
        let parts = joined(vec![part(0x0802_0000, 1), part(0x0800_0004, 4), part(0x0800_0000, 2)]).unwrap();
        assert_eq!(parts[0], Part { address: 0x0800_0000, bytes: vec![1, 1, ERASED, ERASED, 1, 1, 1, 1] });
        assert_eq!(parts[1..], [part(0x0802_0000, 1)]);
        assert!(joined(vec![part(0x0800_0000, 5), part(0x0800_0004, 4)]).is_err());
    }

    #[test]
    fn what_is_no_image_is_refused() {
        assert!(parts(b"no ELF").is_err());
        assert!(joined(Vec::new()).is_err());
    }
}
