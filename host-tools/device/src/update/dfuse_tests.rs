use std::{cell::RefCell, rc::Rc};

use super::*;
use crate::{
    board::SETTINGS,
    image::sample,
    update::mock::{Chip, LAYOUT, MockIo},
};

fn image(length: usize) -> Image {
    sample(length, "inerter 0.1.0")
}

fn program(chip: &Rc<RefCell<Chip>>, image: &Image) -> Result<(), UpdateError> {
    program_over(chip, image, &MockIo::new(chip, LAYOUT))
}

fn program_over(chip: &Rc<RefCell<Chip>>, image: &Image, io: &MockIo) -> Result<(), UpdateError> {
    program_told(chip, image, io, &mut |_, _, _| Going::On)
}

fn program_told(
    chip: &Rc<RefCell<Chip>>,
    image: &Image,
    io: &MockIo,
    progress: &mut dyn FnMut(Stage, usize, usize) -> Going,
) -> Result<(), UpdateError> {
    let mut sleep = |time| {
        let mut chip = chip.borrow_mut();
        chip.clock += time;
        if chip.clock < chip.interrupted_at { Going::On } else { Going::Stop }
    };
    Rom::new(io, &mut sleep).program(image, progress)
}

/// Whether the vectors are erased, so that nothing starts.
fn is_blank(chip: &RefCell<Chip>) -> bool {
    chip.borrow().bytes(CODE.start, 8) == [0xFF; 8]
}

fn holds(chip: &Chip, image: &Image) -> bool {
    image.pages().all(|(address, bytes)| chip.bytes(address, bytes.len()) == bytes)
}

/// Everything except the image's pages is unchanged on a fresh chip.
fn rest_untouched(chip: &Chip, image: &Image) -> bool {
    let fresh = Chip::new();
    let fresh = fresh.borrow();
    let pages: Vec<u32> = image.pages().map(|(address, _)| address).collect();
    (CODE.start..SETTINGS.end)
        .step_by(PAGE as usize)
        .filter(|page| !pages.contains(page))
        .all(|page| chip.bytes(page, 2048) == fresh.bytes(page, 2048))
}

#[test]
fn the_image_arrives_bit_for_bit_and_only_its_pages_are_erased() {
    for (transfer_size, length) in [(2048, 70_001), (1024, 5000), (64, 2048), (2048, 100)] {
        let chip = Chip::new();
        chip.borrow_mut().transfer_size = transfer_size;
        let image = image(length);
        program(&chip, &image).unwrap();
        let chip = chip.borrow();
        assert!(chip.left && holds(&chip, &image) && rest_untouched(&chip, &image));
        let mut erased = chip.erased.clone();
        assert_eq!(erased.first(), Some(&CODE.start), "the vectors go first");
        erased.sort_unstable();
        assert_eq!(erased, image.pages().map(|(address, _)| address).collect::<Vec<_>>(), "each once");
    }
}

#[test]
fn what_the_chip_says_of_itself_counts_more_than_what_the_rom_says_of_the_die() {
    let image = image(20_000);
    let outcome = |told: Option<(u16, u32)>, can_upload: bool| {
        let chip = Chip::new();
        chip.borrow_mut().told = told;
        // The layout is that of 512 KB in two banks, whatever the chip is.
        let mut io = MockIo::new(&chip, LAYOUT);
        io.descriptor.can_upload = can_upload;
        let result = program_over(&chip, &image, &io);
        let untouched = chip.borrow().erased.is_empty() && rest_untouched(&chip.borrow(), &image);
        (result, untouched)
    };
    let delivered = 0xFFEF_F8AA;
    for kb in [128, 256] {
        let (result, untouched) = outcome(Some((kb, delivered)), true);
        let found = matches!(result, Err(UpdateError::SmallFlash { kb: said }) if said == u32::from(kb));
        assert!(found && untouched, "{result:?}");
    }
    let (result, untouched) = outcome(Some((512, delivered & !(1 << 22))), true);
    assert!(matches!(result, Err(UpdateError::SingleBank { .. })) && untouched, "{result:?}");
    // If the facts cannot be read, or are invalid, the check relies on the layout.
    let any = (0xFFFF, delivered);
    for (told, can_upload) in [(Some((512, delivered)), true), (None, true), (Some(any), true), (Some((128, 0)), false)]
    {
        let (result, _) = outcome(told, can_upload);
        assert!(result.is_ok(), "{told:?}, {can_upload}: {result:?}");
    }
}

#[test]
fn the_rom_is_given_the_time_that_it_asks_for() {
    let chip = Chip::new();
    let image = image(20_000);
    program(&chip, &image).unwrap();
    let waited = chip.borrow().clock;
    let least = chip.borrow().busy * image.page_count() as u32;
    assert!(waited >= least && waited < least * 3, "{waited:?}, at least {least:?}");
}

#[test]
fn an_update_that_is_cut_off_anywhere_never_leaves_half_an_image_and_is_completed_by_the_next() {
    let image = image(7000);
    let all = {
        let chip = Chip::new();
        chip.borrow_mut().transfers_left = 100_000;
        program(&chip, &image).unwrap();
        100_000 - chip.borrow().transfers_left
    };
    assert!(all > 50, "{all}");
    for transfers in 0..all {
        let chip = Chip::new();
        chip.borrow_mut().transfers_left = transfers;
        let result = program(&chip, &image);
        let (old, whole, begun) = {
            let chip = chip.borrow();
            let vectors = chip.bytes(CODE.start, 8);
            let fresh = Chip::new();
            assert!(rest_untouched(&chip, &image));
            (vectors == fresh.borrow().bytes(CODE.start, 8), holds(&chip, &image), !chip.erased.is_empty())
        };
        let blank = is_blank(&chip);
        assert!(blank || whole || (old && !begun), "after {transfers} transfers half an image would run");
        match result {
            // A failure after the last byte does no harm.
            Ok(()) => assert!(whole && transfers == all - 1, "{transfers}"),
            Err(error) => {
                assert!(matches!(error, UpdateError::Lost { .. }), "{error}");
                assert!(error.to_string().contains("no such device"), "{error}");
            }
        }
        // The same ROM session continues, or power was lost.
        if transfers % 2 == 0 {
            chip.borrow_mut().restart();
        }
        chip.borrow_mut().left = false;
        chip.borrow_mut().transfers_left = usize::MAX;
        program(&chip, &image).unwrap();
        assert!(holds(&chip.borrow(), &image) && chip.borrow().left);
    }
}

/// Power fails after any double word, also within a transfer; a ROM may accept less than a page at once.
#[test]
fn an_update_that_loses_power_within_a_transfer_leaves_no_half_an_image() {
    for transfer_size in [256, 2048] {
        let image = image(3000);
        let words = image.page_count() * 2048 / 8;
        for words_left in 0..words {
            let chip = Chip::new();
            (chip.borrow_mut().transfer_size, chip.borrow_mut().words_left) = (transfer_size, words_left);
            let result = program(&chip, &image);
            assert!(matches!(result, Err(UpdateError::Lost { .. })), "{result:?}");
            let blank = is_blank(&chip);
            assert!(blank, "after {words_left} of {words} double words half an image would run");
            chip.borrow_mut().restart();
            program(&chip, &image).unwrap();
            assert!(holds(&chip.borrow(), &image));
        }
    }
}

#[test]
fn ctrl_c_ends_between_two_pages_and_the_next_run_completes() {
    let chip = Chip::new();
    let image = image(20_000);
    let mut heard = 0;
    let mut progress = |_, _, all| {
        assert_eq!(all, image.page_count());
        heard += 1;
        if heard == 5 { Going::Stop } else { Going::On }
    };
    let result = program_told(&chip, &image, &MockIo::new(&chip, LAYOUT), &mut progress);
    assert!(matches!(result, Err(UpdateError::Interrupted)));
    assert!(is_blank(&chip));
    program(&chip, &image).unwrap();
    assert!(holds(&chip.borrow(), &image));
}

#[test]
fn progress_counts_every_page_of_either_stage_once() {
    let chip = Chip::new();
    let image = image(20_000);
    let mut heard = Vec::new();
    let mut progress = |stage, done, _| {
        heard.push((stage, done));
        Going::On
    };
    program_told(&chip, &image, &MockIo::new(&chip, LAYOUT), &mut progress).unwrap();
    let count = image.page_count() - 1;
    let expected = (0..count).map(|done| (Stage::Writing, done)).chain((0..count).map(|done| (Stage::Checking, done)));
    assert_eq!(heard, expected.chain([(Stage::Checking, count + 1)]).collect::<Vec<_>>());
}

#[test]
fn protected_flash_is_named() {
    let chip = Chip::new();
    chip.borrow_mut().protected = 0x0800_1000..0x0800_1800;
    let error = program(&chip, &image(20_000)).unwrap_err();
    assert_eq!(error.to_string(), "the chip refuses erasing 0x08001000: the address is protected (errVENDOR)");
    let help = miette::Diagnostic::help(&error).unwrap().to_string();
    assert!(help.contains("remove read and write protection with STM32CubeProgrammer"), "{help}");
    // The error state is cleared by the next run.
    chip.borrow_mut().protected = 0..0;
    program(&chip, &image(20_000)).unwrap();
}

#[test]
fn worn_out_flash_is_found_before_the_vectors_are_written() {
    let chip = Chip::new();
    let image = image(20_000);
    let (address, wanted) = image
        .pages()
        .flat_map(|(page, bytes)| (page..).zip(bytes.iter().copied()))
        .find(|(address, byte)| *address > 0x0800_1000 && byte % 2 == 1)
        .unwrap();
    chip.borrow_mut().worn = Some(address);
    match program(&chip, &image).unwrap_err() {
        UpdateError::Verify { address: at, wanted: byte, got } => {
            assert_eq!((at, byte, got), (address, wanted, wanted & 0xFE));
        }
        // A worn cell that is programmed twice is refused earlier.
        error => assert!(matches!(error, UpdateError::Refused { .. }), "{error}"),
    }
    assert!(is_blank(&chip));
}

#[test]
fn a_rom_that_hangs_is_given_up_after_a_while() {
    let chip = Chip::new();
    chip.borrow_mut().hangs = true;
    let error = program(&chip, &image(3000)).unwrap_err();
    assert!(matches!(error, UpdateError::Stuck { .. }), "{error}");
    let waited = chip.borrow().clock;
    assert!(waited >= PATIENCE && waited < PATIENCE * 2, "{waited:?}");
}

#[test]
fn ctrl_c_ends_the_wait_for_a_rom_that_hangs() {
    let chip = Chip::new();
    let image = image(3000);
    let told = Duration::from_millis(900);
    chip.borrow_mut().hangs = true;
    chip.borrow_mut().busy = Duration::from_secs(60);
    chip.borrow_mut().interrupted_at = told;
    // If nothing can be read, it hangs at the first erase.
    let mut io = MockIo::new(&chip, LAYOUT);
    io.descriptor.can_upload = false;
    let error = program_over(&chip, &image, &io).unwrap_err();
    assert!(matches!(error, UpdateError::Interrupted), "{error}");
    let clock = chip.borrow().clock;
    assert!(clock >= told && clock < told + SLICE * 2, "{clock:?}");
    // This time it hangs before anything is erased, and the error says nothing about the firmware.
    chip.borrow_mut().interrupted_at = clock + told;
    let error = program(&chip, &image).unwrap_err();
    assert!(matches!(error, UpdateError::Device(DeviceError::Interrupted)), "{error}");
    assert!(chip.borrow().clock < clock + told + SLICE * 2);
}

#[test]
fn a_rom_that_leaves_without_an_answer_has_left() {
    let chip = Chip::new();
    chip.borrow_mut().leaves_at_once = true;
    program(&chip, &image(3000)).unwrap();
    assert!(chip.borrow().left);
}

#[test]
fn other_chips_are_refused_before_anything_is_erased() {
    for (layout, words) in [
        ("@Internal Flash  /0x08000000/04*016Kg,01*064Kg,03*128Kg", "it erases 16384 bytes at 0x08000000 at once"),
        ("@Internal Flash  /0x08000000/0008*0002Kg", "the chip has 16 KB of flash; image and settings need 512 KB"),
        ("@Internal Flash  /0x08000000/064*0002Kg", "the chip has 128 KB of flash"),
        ("@Internal Flash  /0x08000000/128*0002Kg", "the chip has 256 KB of flash"),
        ("@Internal Flash  /0x08008000/256*02Kg", "its flash begins at 0x08008000"),
        ("@Internal Flash  /0x08000000/128*04Kg", "its flash is set to a single bank"),
    ] {
        let chip = Chip::new();
        let image = image(20_000);
        let error = program_over(&chip, &image, &MockIo::new(&chip, layout)).unwrap_err();
        assert!(error.to_string().contains(words), "{error}");
        assert!(chip.borrow().erased.is_empty());
    }
    let chip = Chip::new();
    let mut io = MockIo::new(&chip, LAYOUT);
    io.protocol = DfuProtocol::Dfu;
    let image = image(3000);
    let error = program_over(&chip, &image, &io).unwrap_err();
    assert!(error.to_string().contains("does not speak ST's form of DFU"), "{error}");
    assert!(chip.borrow().erased.is_empty());
}

#[test]
fn a_description_that_would_harm_is_not_read() {
    for description in
        [LAYOUT, "@Flash/0x08000000/04*016Kg,01*064Kg,07*128Kg", "@x/0x08000000/2048*2048Ma", "", "/", "*"]
    {
        assert!(is_readable(description), "{description}");
        // Whatever comes of it, it ends.
        let _ = DfuProtocol::new(description, (1, 0x1A));
    }
    let long = format!("@{}/0x08000000/256*02Kg", "x".repeat(128));
    for description in [
        "@x/0x08000000/4294967295*02Kg",
        "@x/0x08000000/1*4194304Kg",
        "@x/0x08000000/1*2\u{e9}",
        "@x/0x08000000/1*\u{20ac}",
        "@x/0x08000000/1*65537Kg",
        long.as_str(),
    ] {
        assert!(!is_readable(description), "{description}");
    }
}
