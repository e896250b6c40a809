//! Programs that we did not write, or that use drivers we did not write: examples of published crates, unchanged, and
//! programs on `stm32-hal2`, `stm32-usbd` and `usbd-serial` (`foreign/`). They have run on real boards. If one behaves
//! differently here, the twin or the program is wrong.

use crate::common::{causes, chip_with, image_of_others, run};
use inerter_twin::World;
use inerter_twin::chip::{Pin, adc, flash, gpio::Mode, rcc::Reset};
use inerter_twin::cpu::Stop;
use inerter_twin::cycles::timing::halves;
use inerter_twin::machine::Machine;
use inerter_twin::usb_link::UsbLink;
use inerter_twin::world::Still;
use inerter_twin::{Registers, Width};

/// A chip running a program of the folder `foreign`. `None` if it is not built, after reporting the skip.
fn foreign(name: &str, world: impl World + 'static) -> Option<Machine> {
    Some(chip_with(&image_of_others(name)?, world))
}

/// Constant inputs of the converters, and a constant speed of the encoder.
#[derive(Clone, Copy)]
struct Steady {
    force_v: f64,
    terminal_v: f64,
    /// Encoder edges per second.
    edges_per_s: f64,
}

impl World for Steady {
    fn encoder(&mut self, time_s: f64) -> u32 {
        (self.edges_per_s * time_s) as i64 as u32
    }

    fn force_volts(&mut self, _: f64) -> f64 {
        self.force_v
    }

    fn terminal_volts(&mut self, _: f64) -> f64 {
        self.terminal_v
    }
}

const STEADY: Steady = Steady { force_v: 1.1, terminal_v: 2.2, edges_per_s: -10_000.0 };

#[test]
fn stm32g4xx_hal_usb_serial_gives_back_in_capitals() {
    let Some(machine) = foreign("usb-serial", Still) else { return };
    let mut link = UsbLink::new(machine);
    let description = link.plug_in().expect("a serial port");
    let texts = [description.manufacturer, description.product, description.serial];
    assert_eq!(texts, ["Fake company", "Serial port", "TEST"]);
    for text in ["hello", "World 42", &"x".repeat(63)] {
        assert_eq!(link.send(text.as_bytes(), 1.0), Ok(text.len()));
        let answer = link.receive(0.05).expect("open");
        assert_eq!(String::from_utf8(answer).expect("text"), text.to_uppercase());
    }
}

#[test]
fn stm32g4xx_hal_adc_dma_fills_its_ring() {
    let Some(mut machine) = foreign("adc-dma", STEADY) else { return };
    run(&mut machine, 0.2);
    // DMA1 channel 1 writes here: PA0, temperature and reference, five times.
    let now = machine.now();
    let ring = machine.chip_mut().dma[0].read(0x14, Width::Word, now).expect("DMA_CMAR1");
    let bytes = machine.chip().bytes(ring, 30).expect("in RAM");
    let codes: Vec<f64> = halves(bytes).map(f64::from).collect();
    let volts = [STEADY.force_v, adc::sensor_volts(25.0), adc::internal_reference_volts()];
    for (n, code) in codes.iter().enumerate() {
        let expected = volts[n % 3] / adc::REFERENCE_V * adc::CODES;
        assert!((code - expected).abs() < 5.0, "entry {n}: {code}, not {expected}");
    }
}

#[test]
fn stm32g4xx_hal_pwm_is_100_hz() {
    let Some(mut machine) = foreign("pwm", Still) else { return };
    run(&mut machine, 0.1);
    assert_eq!(machine.chip().pin_mode(Pin::new('A', 8)), Mode::Alternate(6));
    let now = machine.now();
    machine.chip_mut().tim1.advance(now);
    let pwm = machine.chip().tim1.pwm(1).expect("a running output");
    assert!((pwm.frequency_hz - 100.0).abs() < 0.01 && (pwm.duty - 0.5).abs() < 1e-3, "{pwm:?}");
}

/// It opens SYSCFG's clock gate at the address of a variable on its stack, and asserts that this is a peripheral's
/// address. Pull request 221 of its repository shows the same assertion failing on a board.
#[test]
fn stm32g4xx_hal_button_panics_as_on_a_board() {
    let Some(mut machine) = foreign("button", Still) else { return };
    let ended = machine.run_for(0.05).expect_err("a panic");
    assert_eq!((ended.stop, ended.pc.1.as_deref()), (Stop::Undefined, Some("__rustc::rust_begin_unwind")));
    let now = machine.now();
    let gates = machine.chip_mut().read(0x4002_1060, Width::Word, now).expect("RCC_APB2ENR");
    assert_eq!(gates & 1, 0, "SYSCFG has no clock");
}

#[test]
fn stm32g4xx_hal_watchdog_bites_after_its_32_seconds() {
    let Some(mut machine) = foreign("watchdog", Still) else { return };
    run(&mut machine, 33.0);
    assert_eq!(causes(&machine), [Reset::Power, Reset::Watchdog]);
    let at_s = machine.resets[1].0;
    assert!((32.7..32.8).contains(&at_s), "{at_s} s");
}

/// The instrument on `stm32-hal2`, started.
fn hal2() -> Option<Machine> {
    let mut machine = foreign("hal2", STEADY)?;
    machine.chip_mut().lpuart1.far_baud = 115_200.0;
    run(&mut machine, 0.05);
    Some(machine)
}

/// The program's answer to a one-letter command.
fn ask(machine: &mut Machine, letter: u8) -> String {
    machine.serial_send(&[letter]);
    run(machine, 0.1);
    String::from_utf8(machine.serial_take()).expect("text")
}

#[test]
fn stm32_hal2_measures_counts_and_keeps() {
    let Some(mut machine) = hal2() else { return };
    assert_eq!(machine.chip().clocks.hclk_hz, 170e6);
    assert_eq!(ask(&mut machine, b'c'), "170000000\n");
    let volts = ask(&mut machine, b'a');
    let volts: Vec<f64> = volts.split_whitespace().map(|word| word.parse::<f64>().expect("a number") / 1e4).collect();
    assert!((volts[0] - 1.1).abs() < 5e-3 && (volts[1] - 2.2).abs() < 5e-3, "{volts:?}");
    let count = |machine: &mut Machine| ask(machine, b'e').trim().parse::<i32>().expect("a number");
    let (before, at_s) = (count(&mut machine), machine.time_s());
    let moved = count(&mut machine) - before;
    let expected = STEADY.edges_per_s * (machine.time_s() - at_s);
    assert!((f64::from(moved) - expected).abs() < 3.0, "{moved} of {expected}");
    assert_eq!(ask(&mut machine, b'f'), "written by others\n");
    let contents = machine.chip().flash.contents();
    let page = flash::BANK + 100 * flash::PAGE;
    assert_eq!(&contents.bytes()[page..page + 17], b"written by others");
}

/// The driver's `erase_page` omits the bank selection ("PAC error" in its source), so it would erase its own program.
#[test]
fn stm32_hal2_erases_the_first_bank_where_it_is_asked_for_the_second() {
    let Some(mut machine) = hal2() else { return };
    machine.serial_send(b"F");
    let ended = machine.run_for(0.1).expect_err("an end");
    assert!(matches!(&ended.stop, Stop::Bus(bad) if bad.what.contains("bank 1")), "{ended}");
}

#[test]
fn stm32_hal2_usb_gives_back_one_higher() {
    let Some(machine) = foreign("hal2-usb", Still) else { return };
    let mut link = UsbLink::new(machine);
    let description = link.plug_in().expect("a serial port");
    assert_eq!((description.manufacturer.as_str(), description.product.as_str()), ("Others", "Echo"));
    assert_eq!(link.send(b"HAL-9000", 1.0), Ok(8));
    assert_eq!(link.receive(0.05).expect("open"), b"IBM.:111");
    assert!(link.socket.chip().clocks.hclk_hz == 170e6);
}

/// The README gives these figures for an STM32WL, whose flash has the same caches at the same wait states.
#[test]
fn p256_cm4_takes_as_many_cycles_as_published() {
    let Some(mut image) = image_of_others("p256") else { return };
    // `ldm r4, {r6}`: GNU as, which the authors used, encodes it as `ldr r6, [r4]`. LLVM encodes a load-multiple of one
    // register, which is UNPREDICTABLE by the manual (DDI 0403, A7.7.41) and undefined in the emulator.
    let (many, one) = ([0x94, 0xe8, 0x40, 0x00], [0xd4, 0xf8, 0x00, 0x60]);
    let places: Vec<usize> = (0..image.len() - 3).filter(|&at| image[at..at + 4] == many).collect();
    assert_eq!(places.len(), 1, "in `mul288x288`");
    image[places[0]..places[0] + 4].copy_from_slice(&one);
    let mut machine = chip_with(&image, Still);
    // Ticks are half a second apart. After each one the core does its work and sleeps.
    run(&mut machine, 0.25);
    machine.cpu.count_cycles().expect("hooks");
    for (name, published) in [("sign", 442_754), ("verify", 1_225_746)] {
        let before = machine.usage();
        run(&mut machine, 0.5);
        let after = machine.usage();
        let cycles = after.awake.expect("counted").since(before.awake.expect("counted"));
        let instructions = after.instructions - before.instructions;
        println!(
            "{name}: {instructions} instructions, {} to {} cycles, published {published}",
            cycles.least, cycles.most
        );
        assert!((cycles.least..=cycles.most).contains(&published), "{name}: {cycles:?}, published {published}");
    }
}
