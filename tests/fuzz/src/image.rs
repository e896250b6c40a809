//! Firmware images.
//!
//! Input: a byte (0: the file itself; 1: the code of an image; 2: the segments of an ELF, each an address (u32) and a
//! counted content), then the data.
//!
//! Properties: the pages of an accepted image lie in bank 1, in order and without repetition. Vectors and identity are
//! valid for the chip and for a Hello. The image's flash as a flat binary parses to the same image. Every error can be
//! displayed.

use inerter_device::{
    board::{CODE, PAGE, STACK},
    image::Image,
};

use crate::{
    csv::shown,
    input::{Input, counted, seed},
};

#[path = "../../../host-tools/device/src/image/elf_file.rs"]
mod elf_file;

pub use elf_file::{ARM, code, elf, image};

/// Checks an input.
pub fn check(mut input: Input) {
    match input.byte() % 3 {
        0 => check_file(input.rest()),
        1 => check_file(&[&code(0, "inerter 0.1.0", "c8a2d5a", "nucleo-g474re"), input.rest()].concat()),
        _ => {
            let mut segments = Vec::new();
            while !input.is_empty() {
                segments.push((input.word(), input.counted()));
            }
            check_file(&elf(ARM, &segments));
        }
    }
}

fn check_file(bytes: &[u8]) {
    let Some(image) = shown(Image::parse("f.elf".into(), bytes)) else { return };
    let pages: Vec<(u32, &[u8])> = image.pages().collect();
    assert!(pages.len() == image.page_count() && pages.windows(2).all(|pair| pair[0].0 < pair[1].0));
    for (address, content) in &pages {
        assert!(CODE.contains(address) && address.is_multiple_of(PAGE) && content.len() == PAGE as usize);
    }
    let covered: u32 = image.extents().iter().map(|(first, last)| last - first + 1).sum();
    assert_eq!(covered as usize, pages.len() * PAGE as usize);
    let (address, vectors) = pages[0];
    let word = |place: usize| u32::from_le_bytes(std::array::from_fn(|byte| vectors[place + byte]));
    assert!(address == CODE.start && STACK.contains(&word(0)) && CODE.contains(&(word(4) - 1)));
    let identity = &image.identity;
    for (text, longest) in [(&identity.firmware, 32), (&identity.git, 16), (&identity.board, 24)] {
        assert!((1..=longest).contains(&text.len()) && !text.chars().any(char::is_control), "{text:?}");
    }
    let mut plain = vec![0xFF; (pages[pages.len() - 1].0 + PAGE - CODE.start) as usize];
    for (address, content) in &pages {
        let start = (address - CODE.start) as usize;
        plain[start..start + content.len()].copy_from_slice(content);
    }
    let again = Image::parse("f.elf".into(), &plain).expect("the same image as plain bytes");
    assert_eq!(again.identity, image.identity);
    let mut others = again.pages().filter(|(address, _)| pages.iter().all(|(page, _)| page != address));
    assert!(pages.iter().all(|page| again.pages().any(|other| other == *page)));
    assert!(others.all(|(_, content)| content.iter().all(|&byte| byte == 0xFF)), "a page out of nothing");
}

/// Minimal images: whole, in parts and damaged.
pub fn seeds() -> Vec<Vec<u8>> {
    let plain = code(300, "inerter 0.1.0", "c8a2d5a", "nucleo-g474re");
    let whole = image(300, "inerter 0.1.0", "c8a2d5a");
    let mut seeds = vec![seed(&[0], &whole), seed(&[0], &plain), vec![1, 7, 7, 7]];
    let segment = |address: u32, bytes: &[u8]| seed(&address.to_le_bytes(), counted(bytes));
    for others in [vec![], segment(0x0802_0004, &[7; 9]), segment(0x0807_C000, &[1]), segment(0x2000_0000, &[1, 2])] {
        seeds.push([vec![2], segment(CODE.start, &plain), others].concat());
    }
    seeds.push(seed(&[0], elf(243, &[(CODE.start, &plain[..])])));
    seeds.push(seed(&[0], &whole[..whole.len() - 9]));
    for other in
        [&b":020000040800F2\n"[..], b"DfuSe\x01", b"UF2\nWQ]\x9e", b"S00600004844521B\n", b"!<arch>\n", b"t_s,x\n"]
    {
        seeds.push(seed(&[0], other));
    }
    seeds
}
