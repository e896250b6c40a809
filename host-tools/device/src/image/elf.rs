//! The segments of an ELF that go into flash.

use object::{
    Endianness, FileKind, elf,
    read::elf::{FileHeader, ProgramHeader},
};

use super::ImageError;

/// Bytes and where they go.
pub struct Segment<'a> {
    /// Physical address.
    pub address: u64,
    /// The bytes, without those that the startup code zeroes.
    pub bytes: &'a [u8],
}

/// The segments of a 32-bit Arm executable.
pub fn segments<'a>(file: &str, bytes: &'a [u8]) -> Result<Vec<Segment<'a>>, ImageError> {
    let damaged = |what: &dyn std::fmt::Display| ImageError::Damaged { file: file.into(), what: what.to_string() };
    let foreign = |machine: String| ImageError::Machine { file: file.into(), machine };
    match FileKind::parse(bytes).map_err(|error| damaged(&error))? {
        FileKind::Elf32 => {}
        FileKind::Elf64 => {
            let header = elf::FileHeader64::<Endianness>::parse(bytes).map_err(|error| damaged(&error))?;
            return Err(foreign(machine(header.e_machine(header.endian().unwrap_or_default()))));
        }
        _ => return Err(damaged(&"its class is unknown")),
    }
    let header = elf::FileHeader32::<Endianness>::parse(bytes).map_err(|error| damaged(&error))?;
    let endian = header.endian().map_err(|error| damaged(&error))?;
    if header.e_machine(endian) != elf::EM_ARM {
        return Err(foreign(machine(header.e_machine(endian))));
    }
    if endian != Endianness::Little {
        return Err(foreign("a big-endian Arm".into()));
    }
    if header.e_type(endian) != elf::ET_EXEC {
        return Err(ImageError::Kind { file: file.into(), what: "it is an object or a library, not linked yet" });
    }
    let mut segments = Vec::new();
    for segment in header.program_headers(endian, bytes).map_err(|error| damaged(&error))? {
        if segment.p_type(endian) != elf::PT_LOAD || segment.p_filesz(endian) == 0 {
            continue;
        }
        let content = segment.data(endian, bytes).map_err(|()| damaged(&"a segment lies beyond its end"))?;
        segments.push(Segment { address: segment.p_paddr(endian).into(), bytes: content });
    }
    if segments.is_empty() {
        return Err(damaged(&"it has no segment with bytes for the chip"));
    }
    Ok(segments)
}

fn machine(number: elf::Machine) -> String {
    match number {
        elf::EM_386 | elf::EM_X86_64 => "a PC".into(),
        elf::EM_AARCH64 => "a 64-bit Arm".into(),
        elf::EM_RISCV => "RISC-V".into(),
        elf::EM_XTENSA => "Xtensa".into(),
        other => format!("machine number {}", other.0),
    }
}
