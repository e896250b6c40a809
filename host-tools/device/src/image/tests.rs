use super::*;

#[path = "elf_file.rs"]
mod elf_file;

use elf_file::{ARM, code, elf};

/// An image of this many bytes, and some more further on.
pub(crate) fn sample(length: usize, firmware: &str) -> Image {
    Image::parse("sample.elf".into(), &elf_file::image(length, firmware, "c8a2d5a")).unwrap()
}

fn parse(bytes: &[u8]) -> Result<Image, ImageError> {
    Image::parse("f".into(), bytes)
}

fn refused(bytes: &[u8]) -> ImageError {
    parse(bytes).unwrap_err()
}

fn good() -> Vec<u8> {
    code(5000, "inerter 0.1.0", "c8a2d5a", "nucleo-g474re")
}

#[test]
fn an_elf_gives_its_bytes_by_physical_address_in_whole_pages_and_says_who_it_is() {
    let image = parse(&elf(ARM, &[(0x0800_0000, &good()), (0x0802_0004, &[7; 100])])).unwrap();
    assert_eq!(image.identity.to_string(), "inerter 0.1.0 (c8a2d5a) for nucleo-g474re");
    assert_eq!(image.length(), 5100);
    let pages: Vec<u32> = image.pages().map(|(address, _)| address).collect();
    assert_eq!(pages, [0x0800_0000, 0x0800_0800, 0x0800_1000, 0x0802_0000]);
    assert_eq!(image.extents(), [(0x0800_0000, 0x0800_17FF), (0x0802_0000, 0x0802_07FF)]);
    let bytes: Vec<u8> = image.pages().flat_map(|(_, bytes)| bytes.to_vec()).collect();
    assert_eq!(bytes.len(), 4 * 2048);
    assert_eq!(bytes.get(..5000), Some(&good()[..]));
    assert!(bytes.get(5000..6148).unwrap().iter().all(|&byte| byte == 0xFF));
    assert_eq!(bytes.get(6148..6248), Some(&[7; 100][..]));
    assert!(bytes.get(6248..).unwrap().iter().all(|&byte| byte == 0xFF));
}

#[test]
fn plain_bytes_are_the_same_image() {
    let plain = parse(&good()).unwrap();
    assert_eq!(plain, parse(&elf(ARM, &[(0x0800_0000, &good())])).unwrap());
}

#[test]
fn bank_1_can_be_filled_to_its_last_byte_and_no_further() {
    let mut bytes = good();
    bytes.resize(CODE.len(), 0);
    assert_eq!(parse(&bytes).unwrap().page_count(), 128);
    bytes.push(0);
    assert!(refused(&bytes).to_string().contains("0x08000000 to 0x08040001"), "{}", refused(&bytes));
}

#[test]
fn what_is_for_other_places_is_refused_with_the_addresses() {
    for (address, length) in [(0x0803_FFFF, 2), (0x0804_0000, 1), (0x0000_0000, 8), (0x2000_0000, 8)] {
        let file = elf(ARM, &[(0x0800_0000, &good()), (address, &vec![0; length])]);
        let error = refused(&file);
        assert!(matches!(error, ImageError::Outside { .. }), "{error}");
        assert!(error.to_string().contains(&format!("0x{address:08X}")), "{error}");
    }
    for (address, length) in [(0x0807_C000, 1), (0x0807_FFFF, 1), (0x0807_BFFF, 2), (0x0807_0000, 0x20000)] {
        let error = refused(&elf(ARM, &[(0x0800_0000, &good()), (address, &vec![0; length])]));
        assert!(matches!(error, ImageError::OverSettings { .. }), "{error}");
        assert!(error.to_string().contains("over the settings at 0x0807C000 to 0x08080000"), "{error}");
    }
    // The end of the address space.
    assert!(matches!(refused(&elf(ARM, &[(0xFFFF_FFF0, &[0; 100])])), ImageError::Outside { .. }));
}

#[test]
fn programs_for_other_machines_are_named() {
    for (machine, name) in [(62, "a PC"), (243, "RISC-V"), (94, "Xtensa"), (1234, "machine number 1234")] {
        let error = refused(&elf(machine, &[(0x0800_0000, &good())])).to_string();
        assert_eq!(error, format!("f is a program for {name}, not for the board's Arm Cortex-M4"));
    }
    let own = Image::open(&std::env::current_exe().unwrap()).unwrap_err().to_string();
    let name = if cfg!(target_arch = "x86_64") { "is a program for a PC" } else { "is a program for" };
    assert!(!cfg!(target_os = "linux") || own.contains(name), "{own}");
}

#[test]
fn an_image_that_cannot_start_is_refused() {
    let with = |offset: usize, word: u32| {
        let mut bytes = good();
        bytes.get_mut(offset..offset + 4).unwrap().copy_from_slice(&word.to_le_bytes());
        refused(&elf(ARM, &[(0x0800_0000, &bytes)]))
    };
    for (offset, word) in [(0, 0xFFFF_FFFF), (0, 0x2000_0000), (0, 0x2001_8004), (0, 0x2001_7FFE), (4, 0x0800_01AC)] {
        assert!(matches!(with(offset, word), ImageError::Vectors { .. }), "{word:08X}");
    }
    for word in [0xFFFF_FFFF, 1, 0x0804_0001, 0] {
        assert!(matches!(with(4, word), ImageError::Vectors { .. }), "{word:08X}");
    }
    let behind = refused(&elf(ARM, &[(0x0800_8000, &good())])).to_string();
    assert!(behind.contains("it has no bytes at 0x08000000, where the chip starts"), "{behind}");
}

#[test]
fn an_image_that_does_not_say_who_it_is_or_says_it_twice_is_refused() {
    let mut bytes = good();
    bytes.extend(good());
    assert!(matches!(refused(&bytes), ImageError::BadIdentity { what: "its identity appears twice", .. }));
    let mut bytes = good();
    *bytes.get_mut(8).unwrap() = b'I';
    assert!(matches!(refused(&bytes), ImageError::NoIdentity { .. }));
    for (firmware, git, board) in [
        ("", "c", "b"),
        ("inerter 0.1.0", "", "b"),
        ("inerter 0.1.0", "c8a2d5a", ""),
        ("inerter 0.1.0", "longer than sixteen", "b"),
        ("inerter\n0.1.0", "c8a2d5a", "b"),
    ] {
        assert!(matches!(refused(&code(500, firmware, git, board)), ImageError::BadIdentity { .. }));
    }
    // It ends with the file.
    let cut = code(0, "inerter 0.1.0", "c8a2d5a", "nucleo-g474re");
    assert!(parse(&cut).is_ok());
    let mut without_end = cut.get(..cut.len() - 1).unwrap().to_vec();
    without_end.resize(CODE.len(), 0xFF);
    assert!(matches!(refused(&without_end), ImageError::BadIdentity { .. }));
}

#[test]
fn other_kinds_of_files_are_named() {
    for (bytes, kind) in [
        (&b""[..], "it is empty"),
        (b":020000040800F2\n", "it is an Intel HEX file"),
        (b"DfuSe\x01", "it is a DfuSe container"),
        (b"UF2\nWQ]\x9e", "it is a UF2 file"),
        (b"S00600004844521B\n", "it is a Motorola S-record file"),
        (b"\x89MCAP0\r\n", "it is a recording"),
        (b"!<arch>\n", "it is a library"),
        (b"t_s,encoder_count,force_n\n0,0,0\n", "it is text"),
        (b"\x00\x80\x01", "it has only a few bytes"),
    ] {
        assert_eq!(refused(bytes).to_string(), format!("f is not a firmware image: {kind}"));
    }
    let mut object = elf(ARM, &[(0x0800_0000, &good())]);
    *object.get_mut(16).unwrap() = 1;
    assert!(refused(&object).to_string().contains("not linked yet"));
    assert!(matches!(refused(&elf(ARM, &[])), ImageError::Damaged { .. }));
}

#[test]
fn a_damaged_elf_is_an_error_or_an_image_but_never_more() {
    let whole = elf_file::image(3000, "inerter 0.1.0", "c8a2d5a");
    for length in 0..whole.len() {
        assert!(parse(whole.get(..length).unwrap()).is_err(), "{length}");
    }
    for place in 0..120 {
        for value in [0, 1, 0x7F, 0x80, 0xFF] {
            let mut bytes = whole.clone();
            *bytes.get_mut(place).unwrap() = value;
            if let Ok(image) = parse(&bytes) {
                assert!(image.pages().all(|(address, bytes)| CODE.contains(&address) && bytes.len() == 2048));
            }
        }
    }
}
