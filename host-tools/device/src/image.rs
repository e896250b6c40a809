//! A firmware image: read from a file, and checked for the board before anything is erased.
//!
//! - *identity*: how the firmware identifies itself in `Hello`, stored in the image after [`MAGIC`].
//! - *page*: the unit of erasing flash; bytes of a page that the file does not define are 0xFF, as erased.
//!
//! Accepted: the ELF that `cargo build` makes, by the physical addresses of its segments, and its raw binary (`.bin`),
//! which begins at the start of the chip's bank 1.

mod elf;
mod error;

pub use error::ImageError;

use std::{collections::BTreeSet, fs::File, io::Read, path::Path};

use crate::board::{CODE, PAGE, SETTINGS, STACK};

/// Marks the identity; occurs once in an image.
pub const MAGIC: &[u8] = b"inerter-identity\0";

/// Maximum file size: an ELF with all debug information is less than a tenth of it (bytes).
const LONGEST: u64 = 256 << 20;

/// The identity of a firmware; its `Hello` has the same texts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Name and version.
    pub firmware: String,
    /// Commit.
    pub git: String,
    /// Board.
    pub board: String,
}

impl std::fmt::Display for Identity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({}) for {}", self.firmware, self.git, self.board)
    }
}

/// An image that fits the board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// The file, for a person.
    pub file: String,
    /// Which firmware.
    pub identity: Identity,
    content: Content,
}

impl Image {
    /// Reads an ELF or `.bin` and checks all that can be checked without a device.
    pub fn open(path: &Path) -> Result<Self, ImageError> {
        let name = path.display().to_string();
        let failed = |source| ImageError::Read { file: name.clone(), source };
        let mut bytes = Vec::new();
        let file = File::open(path).map_err(failed)?;
        file.take(LONGEST + 1).read_to_end(&mut bytes).map_err(failed)?;
        if bytes.len() as u64 > LONGEST {
            return Err(ImageError::Kind { file: name, what: "it is larger than 256 MB" });
        }
        Self::parse(name, &bytes)
    }

    /// The image in `bytes`.
    pub fn parse(file: String, bytes: &[u8]) -> Result<Self, ImageError> {
        let mut content = Content { flash: vec![0xFF; CODE.len()], pages: BTreeSet::new(), length: 0 };
        if bytes.starts_with(b"\x7FELF") {
            for segment in elf::segments(&file, bytes)? {
                content.put(&file, segment.address, segment.bytes)?;
            }
        } else {
            if let Some(what) = other_kind(bytes) {
                return Err(ImageError::Kind { file, what });
            }
            content.put(&file, u64::from(CODE.start), bytes)?;
        }
        content.check_vectors(&file)?;
        let identity = content.identity(&file)?;
        Ok(Self { file, identity, content })
    }

    /// The pages to write with their addresses, in order; each is [`PAGE`] bytes long.
    pub fn pages(&self) -> impl Iterator<Item = (u32, &[u8])> {
        self.content.pages.iter().filter_map(|&address| {
            let start = usize::try_from(address - CODE.start).ok()?;
            Some((address, self.content.flash.get(start..start + PAGE as usize)?))
        })
    }

    /// Number of pages.
    pub fn page_count(&self) -> usize {
        self.content.pages.len()
    }

    /// Bytes in the file that go to flash.
    pub fn length(&self) -> usize {
        self.content.length
    }

    /// Pages that follow each other, as address ranges: first byte and last byte.
    pub fn extents(&self) -> Vec<(u32, u32)> {
        let mut extents: Vec<(u32, u32)> = Vec::new();
        for &page in &self.content.pages {
            let last = page + (PAGE - 1);
            match extents.last_mut() {
                Some(extent) if extent.1 + 1 == page => extent.1 = last,
                _ => extents.push((page, last)),
            }
        }
        extents
    }
}

/// The flash contents of an image.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Content {
    /// The whole of bank 1 as it should be.
    flash: Vec<u8>,
    /// Addresses of the pages that hold bytes of the file.
    pages: BTreeSet<u32>,
    /// Bytes in the file's segments.
    length: usize,
}

impl Content {
    fn put(&mut self, file: &str, address: u64, bytes: &[u8]) -> Result<(), ImageError> {
        if bytes.is_empty() {
            return Ok(());
        }
        let end = address.saturating_add(bytes.len() as u64);
        if address < u64::from(SETTINGS.end) && end > u64::from(SETTINGS.start) {
            return Err(ImageError::OverSettings { file: file.into(), start: address, end });
        }
        let outside = || ImageError::Outside { file: file.into(), start: address, end };
        let first = u32::try_from(address).ok().filter(|first| CODE.contains(first)).ok_or_else(outside)?;
        let offset = (first - CODE.start) as usize;
        self.flash.get_mut(offset..offset + bytes.len()).ok_or_else(outside)?.copy_from_slice(bytes);
        self.length += bytes.len();
        let first_page = first - first % PAGE;
        let pages = (first_page..CODE.end).step_by(PAGE as usize).take_while(|&page| u64::from(page) < end);
        self.pages.extend(pages);
        Ok(())
    }

    fn word(&self, offset: usize) -> Option<u32> {
        let bytes = self.flash.get(offset..offset + 4)?;
        Some(u32::from_le_bytes(bytes.try_into().ok()?))
    }

    /// Stack pointer and reset vector come first (Armv7-M, B1.5.3).
    fn check_vectors(&self, file: &str) -> Result<(), ImageError> {
        let failed = |what: String| ImageError::Vectors { file: file.into(), what };
        if !self.pages.contains(&CODE.start) {
            return Err(failed(format!("it has no bytes at 0x{:08X}, where the chip starts", CODE.start)));
        }
        let (stack, reset) = (self.word(0).unwrap_or(0), self.word(4).unwrap_or(0));
        if !STACK.contains(&stack) || !stack.is_multiple_of(4) {
            return Err(failed(format!("its stack would begin at 0x{stack:08X}, which is not the end of RAM")));
        }
        if reset.is_multiple_of(2) || !CODE.contains(&(reset - 1)) {
            return Err(failed(format!("its first instruction would be at 0x{reset:08X}, outside the image")));
        }
        Ok(())
    }

    fn identity(&self, file: &str) -> Result<Identity, ImageError> {
        let mut found = self.flash.windows(MAGIC.len()).enumerate().filter(|(_, window)| *window == MAGIC);
        let (place, _) = found.next().ok_or_else(|| ImageError::NoIdentity { file: file.into() })?;
        let failed = |what| ImageError::BadIdentity { file: file.into(), what };
        if found.next().is_some() {
            return Err(failed("its identity appears twice"));
        }
        let behind = self.flash.get(place + MAGIC.len()..).unwrap_or_default();
        let mut texts = behind.splitn(4, |byte| *byte == 0);
        // The longest texts that fit a Hello.
        let mut text = |what, longest| {
            let bytes = texts.next().filter(|bytes| !bytes.is_empty() && bytes.len() <= longest);
            let text = bytes.and_then(|bytes| std::str::from_utf8(bytes).ok());
            let text = text.filter(|text| !text.chars().any(char::is_control));
            text.map(str::to_string).ok_or_else(|| failed(what))
        };
        Ok(Identity {
            firmware: text("its name and version cannot be read", 32)?,
            git: text("its commit cannot be read", 16)?,
            board: text("its board cannot be read", 24)?,
        })
    }
}

/// The kind of a file that is neither an ELF nor a raw binary beginning with vectors.
fn other_kind(bytes: &[u8]) -> Option<&'static str> {
    match bytes {
        [] => Some("it is empty"),
        [b':', b'0'..=b'9', ..] => Some("it is an Intel HEX file"),
        [b'D', b'f', b'u', b'S', b'e', ..] => Some("it is a DfuSe container"),
        [b'U', b'F', b'2', b'\n', ..] => Some("it is a UF2 file"),
        [b'S', b'0'..=b'3', b'0'..=b'9', ..] => Some("it is a Motorola S-record file"),
        [0x89, b'M', b'C', b'A', b'P', ..] => Some("it is a recording"),
        [b'!', b'<', b'a', b'r', b'c', b'h', ..] => Some("it is a library"),
        _ if bytes.len() < 8 => Some("it has only a few bytes"),
        _ if bytes.iter().take(64).all(|byte| byte.is_ascii_graphic() || byte.is_ascii_whitespace()) => {
            Some("it is text")
        }
        _ => None,
    }
}

#[cfg(test)]
#[path = "image/tests.rs"]
mod tests;

#[cfg(test)]
pub(crate) use tests::sample;
