//! The image: its segments and symbols.

use object::{Object, ObjectSymbol, SymbolKind, read::elf::ElfFile32};
use std::collections::BTreeMap;

/// The image is not usable.
#[derive(Debug, thiserror::Error)]
#[error("the image is not an ARM ELF file: {0}")]
pub struct ElfError(String);

/// The parts of an ELF file that the twin needs.
#[derive(Clone, Debug, Default)]
pub struct Elf {
    /// Flash addresses and contents.
    pub segments: Vec<(u32, Vec<u8>)>,
    symbols: BTreeMap<String, u32>,
    /// Start and end of each function, by start.
    functions: Vec<(u32, u32, String)>,
}

impl Elf {
    /// Reads an image.
    pub fn parse(bytes: &[u8]) -> Result<Self, ElfError> {
        let bad = |error: object::Error| ElfError(error.to_string());
        let file: ElfFile32 = ElfFile32::parse(bytes).map_err(bad)?;
        let mut elf = Self::default();
        let endian = file.endian();
        for header in file.elf_program_headers() {
            // Loaded segments only; they go to flash, at their physical address.
            if header.p_type.get(endian) == object::elf::PT_LOAD && header.p_filesz.get(endian) > 0 {
                let start = header.p_offset.get(endian) as usize;
                let data = bytes.get(start..start.saturating_add(header.p_filesz.get(endian) as usize));
                let data = data.ok_or_else(|| ElfError("a segment extends past the end of the file".into()))?;
                elf.segments.push((header.p_paddr.get(endian), data.to_vec()));
            }
        }
        for symbol in file.symbols() {
            let Ok(name) = symbol.name() else { continue };
            let (address, size) = (symbol.address() as u32, symbol.size() as u32);
            elf.symbols.insert(name.to_owned(), address);
            if symbol.kind() == SymbolKind::Text && size > 0 {
                elf.functions.push((address & !1, (address & !1).saturating_add(size), name.to_owned()));
            }
        }
        elf.functions.sort();
        Ok(elf)
    }

    /// The address of a symbol.
    pub fn symbol(&self, name: &str) -> Option<u32> {
        self.symbols.get(name).copied()
    }

    /// Names of all symbols.
    pub fn symbols(&self) -> impl Iterator<Item = &str> {
        self.symbols.keys().map(String::as_str)
    }

    /// Code of the function that starts at an address.
    pub fn function(&self, address: u32) -> Option<&[u8]> {
        let &(start, end, _) = self.functions.iter().find(|function| function.0 == address & !1)?;
        self.code(start, end)
    }

    /// Code of each function, with its symbol name.
    pub fn functions(&self) -> impl Iterator<Item = (&str, &[u8])> {
        self.functions.iter().filter_map(|(start, end, name)| Some((name.as_str(), self.code(*start, *end)?)))
    }

    fn code(&self, start: u32, end: u32) -> Option<&[u8]> {
        let within = |(segment, bytes): &(u32, Vec<u8>)| (*segment..*segment + bytes.len() as u32).contains(&start);
        let (segment, bytes) = self.segments.iter().find(|segment| within(segment))?;
        bytes.get((start - segment) as usize..(end - segment) as usize)
    }

    /// Demangled name of the function at an address.
    pub fn function_at(&self, address: u32) -> Option<String> {
        let behind = self.functions.partition_point(|&(start, ..)| start <= address);
        let (_, end, name) = self.functions[..behind].last()?;
        (address < *end).then(|| format!("{:#}", rustc_demangle::demangle(name)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_image_is_refused() {
        assert!(Elf::parse(b"").is_err());
        assert!(Elf::parse(&[0x7f; 100]).is_err());
        // The executable of this test, which is for another architecture.
        let own = std::fs::read(std::env::current_exe().expect("own path")).expect("own file");
        assert!(Elf::parse(&own).is_err());
    }
}
