//! The twin's registers against two independent descriptions: `stm32-metapac` (stm32-data: addresses, fields, clock
//! gates, interrupts, DMA requests, pins) and `stm32g4` (ST's SVD as corrected by stm32-rs: addresses, reset values).
//!
//! The tables below list every difference with its reason. A test also fails if a listed difference no longer exists.

#[path = "../src/metapac.rs"]
mod metapac;

use inerter_twin::chip::{CLOCK_OFF, Chip, NOTHING, TIM2_INPUTS, dmamux::Request};
use inerter_twin::{Board, Unknown, Width, world::Still};
use metapac::peripheral;
use std::collections::{BTreeMap, BTreeSet};
use stm32_metapac::metadata::METADATA;
use stm32g4::{Reg, RegisterSpec, Resettable};

/// Address ranges with registers: APB1 to AHB1, the GPIO ports, the converters, debug support.
const BUSES: [std::ops::Range<u32>; 4] =
    [0x4000_0000..0x4003_0000, 0x4800_0000..0x4800_2000, 0x5000_0000..0x5000_1000, 0xe004_2000..0xe004_2400];
/// The USB packet memory contains no registers.
const PACKET_MEMORY: std::ops::Range<u32> = 0x4000_6000..0x4000_6400;

/// Registers that the twin has and metapac lacks.
const NOT_IN_METAPAC: &[(&str, &str)] = &[
    ("0x48000028", BRR),
    ("0x48000428", BRR),
    ("0x48000828", BRR),
    ("0x48000c28", BRR),
    ("0x48001028", BRR),
    ("0x48001428", BRR),
    ("0x48001828", BRR),
];
const BRR: &str = "metapac leaves GPIO_BRR out, ST's header and stm32g4 have it";

/// Registers that the twin has and stm32g4 lacks.
const NOT_IN_STM32G4: &[(&str, &str)] = &[("0x40005c54", "stm32g4 leaves USB_LPMCSR out, metapac has it")];

/// Reset values that differ from those of stm32g4.
const OTHER_RESET_VALUES: &[(&str, &str)] = &[
    ("DBGMCU.idcode: 0x20036469, not 0x00000000", "the device and its revision, which an SVD does not know"),
    ("EXTI.imr1: 0x1f840000, not 0xff820000", "direct lines are open, and stm32g4 has those of the L4"),
    ("EXTI.imr2: 0xffffff3c, not 0xffffff87", "the same"),
    ("FLASH.acr: 0x00040600, not 0x00000600", "DBG_SWEN is on after reset (RM0440 3.7.1)"),
    ("GPIOA.idr: 0x0000a000, not 0x00000000", "levels at the pins: JTAG's pulls"),
    ("GPIOB.idr: 0x00000010, not 0x00000000", "the same"),
    ("RCC.cr: 0x00000500, not 0x00000063", "HSI on and ready (RM0440 7.4.1); stm32g4 has the MSI of the L4"),
    ("TIM1.af1: 0x00000001, not 0x00000000", BREAK),
    ("TIM1.af2: 0x00000001, not 0x00000000", BREAK),
    ("TIM15.af1: 0x00000001, not 0x00000000", BREAK),
    ("TIM16.af1: 0x00000001, not 0x00000000", BREAK),
    ("TIM17.af1: 0x00000001, not 0x00000000", BREAK),
    ("TIM3.arr: 0x0000ffff, not 0xffffffff", "the counter has 16 bits; stm32g4 took TIM2's registers"),
    ("TIM4.arr: 0x0000ffff, not 0xffffffff", "the same"),
    ("TIM8.af1: 0x00000001, not 0x00000000", BREAK),
    ("TIM8.af2: 0x00000001, not 0x00000000", BREAK),
    ("USB.cntr: 0x00000003, not 0x00000000", "reset and power-down are on after reset (RM0440 45.6.1)"),
];
const BREAK: &str = "the break input at the pin is open after reset (RM0440 28.6, BKINE), which stm32g4 leaves out";

/// Bits that the twin stores where metapac has no field.
const OTHER_FIELDS: &[(&str, &str)] = &[
    ("ADC1.difsel: 0x00040000", DIFSEL),
    ("ADC2.difsel: 0x00040000", DIFSEL),
    ("ADC3.difsel: 0x00040000", DIFSEL),
    ("ADC4.difsel: 0x00040000", DIFSEL),
    ("ADC5.difsel: 0x00040000", DIFSEL),
    ("CRS.cr: 0x00004000", "TRIM has 7 bits, as its reset value 64 shows; metapac has 6"),
    ("LPUART1.brr: 0x000f0000", "an LPUART divides by 20 bits; metapac has the 16 of a USART"),
    ("PWR.cr5: 0x00000100", "R1MODE is bit 8 (ST's header, stm32g4); metapac has bit 0"),
    ("TIM15.ccmr_input: 0x0100ff00", "TIM15 has two channels in CCMR1; metapac has one, and a CCMR2"),
    ("TIM15.dier: 0x00000004", "CC2IE; metapac has the flag and leaves its interrupt out"),
];
const DIFSEL: &str = "19 channels; metapac has 18";

/// Fields of metapac that a write does not change, grouped by identical registers (see [`alike`]). Writes that end the
/// run do not count.
const DROPPED: &[(&str, &str)] = &[
    ("ADCx.cr: 0x00000012", ONCE),
    ("ADCx.difsel: 0x00000001", "channel 0 is single-ended (RM0440 21.7.24)"),
    ("ADCx.isr: 0x000007ff", FLAGS),
    ("CRS.icr: 0x0000000f", ONCE),
    ("DAC1, DAC2.dhr12r0: 0x0fff0000", "the second code of two at once, which have no model"),
    ("DAC1, DAC2.sr: 0xf800f800", FLAGS),
    ("DBGMCU.idcode: 0xffffffff", READ_ONLY),
    ("DMAMUX1.ccrx: 0x00000080", "7 bits (RM0440 13.6.1); metapac has 8"),
    ("EXTI.pr0: 0xffffffff", FLAGS),
    ("EXTI.swier0: 0xffffffff", "an event by software has no model: no line that it raises is one of ours"),
    ("FLASH.acr: 0x00040000", "DBG_SWEN is the debugger's"),
    ("FLASH.cr: 0x0c010000", "STRT and OBL_LAUNCH act once; RDERRIE belongs to read protection, which has no model"),
    ("FLASH.eccr: 0xf067ffff", FLAGS),
    ("FLASH.sr: 0x0001c3fb", FLAGS),
    ("GPIOx.bsrr: 0xffffffff", ONCE),
    ("IWDG.kr: 0x0000ffff", ONCE),
    ("IWDG.pr: 0x00000007", LATER),
    ("IWDG.rlr: 0x00000fff", LATER),
    ("IWDG.winr: 0x00000fff", LATER),
    ("LPUART1.icr: 0x00121b5f", ONCE),
    ("LPUART1.rqr: 0x00000018", ONCE),
    ("LPUART1.tdr: 0x00000100", "characters have 8 bits"),
    ("PWR.cr2: 0x0000000f", "the voltage detector has no model"),
    ("PWR.cr3: 0x00002000", "the USB-C controller has no model"),
    ("PWR.cr5: 0x00000001", "metapac's R1MODE, which is bit 8"),
    ("PWR.scr: 0x0000011f", ONCE),
    ("PWR.sr1: 0x0000811f", READ_ONLY),
    ("PWR.sr2: 0x0000ff00", READ_ONLY),
    ("RCC.bdcr: 0x00000002", READ_ONLY),
    ("RCC.cfgr: 0x0000000c", READ_ONLY),
    ("RCC.cicr: 0x0000073b", ONCE),
    ("RCC.cr: 0x02020400", READ_ONLY),
    ("RCC.crrcr: 0x0000ff82", READ_ONLY),
    ("RCC.csr: 0xfe800002", "flags of resets, LSIRDY; RMVF acts once"),
    ("RCC.icscr: 0x00ff0000", READ_ONLY),
    ("SPI2.rxcrcr: 0x0000ffff", READ_ONLY),
    ("SPI2.sr: 0x00001fff", FLAGS),
    ("SPI2.txcrcr: 0x0000ffff", READ_ONLY),
    ("SYSCFG.cfgr2: 0x00000100", FLAGS),
    ("SYSCFG.memrmp: 0x00000100", "FB_MODE: banks that change places have no model"),
    ("TIM1, TIM8.af1: 0x0003fff0", BREAKS),
    ("TIM1, TIM8.af2: 0x00073ff0", BREAKS),
    ("TIM1, TIM8.arr: 0x000f0000", DITHER),
    ("TIM1, TIM8.ccr1: 0x000f0000", DITHER),
    ("TIM1, TIM8.ccr: 0x000f0000", DITHER),
    ("TIM1, TIM8.cnt: 0x80000000", READ_ONLY),
    ("TIM1, TIM8.dier: 0x00f020a0", SIGNALS),
    ("TIM1, TIM8.egr: 0x00000001", ONCE),
    ("TIM1, TIM8.rcr: 0x0000ffff", REPETITION),
    ("TIM1, TIM8.sr: 0x00f33fff", FLAGS),
    ("TIM15.af1: 0x00003ff0", BREAKS),
    ("TIM15.af2: 0x00070000", BREAKS),
    ("TIM15.arr: 0x000f0000", DITHER),
    ("TIM15.ccr1: 0x000f0000", DITHER),
    ("TIM15.ccr: 0x000f0000", DITHER),
    ("TIM15.cnt: 0x80000000", READ_ONLY),
    ("TIM15.dier: 0x000020a0", SIGNALS),
    ("TIM15.egr: 0x00000001", ONCE),
    ("TIM15.rcr: 0x000000ff", REPETITION),
    ("TIM15.sr: 0x000006e7", FLAGS),
    ("TIM16, TIM17.af1: 0x00003ff0", BREAKS),
    ("TIM16, TIM17.af2: 0x00070000", BREAKS),
    ("TIM16, TIM17.arr: 0x000f0000", DITHER),
    ("TIM16, TIM17.ccr: 0x000f0000", DITHER),
    ("TIM16, TIM17.cnt: 0x80000000", READ_ONLY),
    ("TIM16, TIM17.dier: 0x000000a0", SIGNALS),
    ("TIM16, TIM17.egr: 0x00000001", ONCE),
    ("TIM16, TIM17.rcr: 0x000000ff", REPETITION),
    ("TIM16, TIM17.sr: 0x000002a3", FLAGS),
    ("TIM2, TIM5.af1: 0x0003c000", BREAKS),
    ("TIM2, TIM5.af2: 0x00070000", BREAKS),
    ("TIM2, TIM5.dier: 0x00f00000", SIGNALS),
    ("TIM2, TIM5.egr: 0x00000001", ONCE),
    ("TIM2, TIM5.sr: 0x00f01e5f", FLAGS),
    ("TIM3, TIM4.af1: 0x0003c000", BREAKS),
    ("TIM3, TIM4.af2: 0x00070000", BREAKS),
    ("TIM3, TIM4.arr: 0x000f0000", DITHER),
    ("TIM3, TIM4.ccr1: 0x000f0000", DITHER),
    ("TIM3, TIM4.ccr2: 0x000f0000", DITHER),
    ("TIM3, TIM4.ccr3: 0x000f0000", DITHER),
    ("TIM3, TIM4.ccr: 0x000f0000", DITHER),
    ("TIM3, TIM4.cnt: 0x80000000", READ_ONLY),
    ("TIM3, TIM4.dier: 0x00f00000", SIGNALS),
    ("TIM3, TIM4.egr: 0x00000001", ONCE),
    ("TIM3, TIM4.sr: 0x00f01e5f", FLAGS),
    ("TIM6, TIM7.arr: 0x000f0000", DITHER),
    ("TIM6, TIM7.cnt: 0x80000000", READ_ONLY),
    ("TIM6, TIM7.cr2: 0x02000000", "a basic timer's MMS has 3 bits (RM0440 31.4.2); metapac has 4"),
    ("TIM6, TIM7.egr: 0x00000001", ONCE),
    ("TIM6, TIM7.sr: 0x00000001", FLAGS),
    ("USB.bcdr: 0x000000f0", READ_ONLY),
    ("USB.eprx: 0x00008880", FLAGS),
    ("USB.istr: 0x0000ff9f", FLAGS),
    ("USB.lpmcsr: 0x000000f8", READ_ONLY),
];
const ONCE: &str = "acts once, and reads as 0";
const FLAGS: &str = "flags, cleared by a write and set by none";
const READ_ONLY: &str = "is only read";
const LATER: &str = "taken over after some periods of the oscillator";
const BREAKS: &str = "break and clear inputs from elsewhere than the pin have no model";
const DITHER: &str = "dithering has no model";
const SIGNALS: &str = "signals of encoder, break and commutation have no model, so none comes";
const REPETITION: &str = "the repetition counter has no model";

/// Registers of stm32g4 that the twin lacks or cannot read: an access ends the run.
const NOT_MODELLED: &[(&str, &str)] = &[
    ("ADC12_COMMON: cdr", UNUSED),
    ("ADC345_COMMON: cdr", UNUSED),
    (
        "DAC1: swtrgr dhr12r1 dhr12l0 dhr12l1 dhr8r0 dhr8r1 dhr12rd dhr12ld dhr8rd dor1 ccr shsr0 shsr1 shhr shrr str0 str1 stmodr",
        UNUSED,
    ),
    (
        "DAC2: swtrgr dhr12r1 dhr12l0 dhr12l1 dhr8r0 dhr8r1 dhr12rd dhr12ld dhr8rd dor1 ccr shsr0 shsr1 shhr shrr str0 str1 stmodr",
        UNUSED,
    ),
    ("DMA1: ifcr", WRITTEN),
    ("DMA2: ifcr", WRITTEN),
    ("DMAMUX: cfr rgcfr", UNUSED),
    ("EXTI: rtsr2 ftsr2 swier2 pr2", UNUSED),
    ("FLASH: pdkeyr pcrop1sr pcrop1er wrp1ar wrp1br sec1r", UNUSED),
    ("GPIOA: lckr", UNUSED),
    ("GPIOB: lckr", UNUSED),
    ("GPIOC: lckr", UNUSED),
    ("GPIOD: lckr", UNUSED),
    ("GPIOE: lckr", UNUSED),
    ("GPIOF: lckr", UNUSED),
    ("GPIOG: lckr", UNUSED),
    ("PWR: pucra pdcra pucrb pdcrb pucrc pdcrc pucrd pdcrd pucre pdcre pucrf pdcrf pucrg pdcrg", UNUSED),
    ("RCC: ahb1smenr ahb2smenr ahb3smenr apb1smenr1 apb1smenr2 apb2smenr", UNUSED),
    ("SYSCFG: scsr swpr skr", UNUSED),
    ("TAMP: cr2 fltcr ier sr misr scr", UNUSED),
    ("TIM15: dtr2 dcr dmar", UNUSED),
    ("TIM16: dtr2 or1 dcr dmar", UNUSED),
    ("TIM17: dtr2 or1 dcr dmar", UNUSED),
    ("TIM1: ccr5 ccr6 ccmr3_output dtr2 ecr dcr dmar", UNUSED),
    ("TIM2: rcr bdtr ccr5 ccr6 ccmr3_output dtr2 ecr dcr dmar", GENERAL),
    ("TIM3: rcr bdtr ccr5 ccr6 ccmr3_output dtr2 ecr dcr dmar", GENERAL),
    ("TIM4: rcr bdtr ccr5 ccr6 ccmr3_output dtr2 ecr dcr dmar", GENERAL),
    ("TIM5: rcr bdtr ccr5 ccr6 ccmr3_output dtr2 ecr dcr dmar", GENERAL),
    ("TIM8: ccr5 ccr6 ccmr3_output dtr2 ecr dcr dmar", UNUSED),
];
const UNUSED: &str = "nobody here uses it";
const WRITTEN: &str = "is only written";
const GENERAL: &str =
    "nobody here uses it; a general timer has no RCR, BDTR, CCR5, CCR6 and CCMR3 (metapac), whatever stm32g4 says";

/// A register of stm32g4.
#[derive(Clone, Debug)]
struct Described {
    name: &'static str,
    address: u32,
    reset: u32,
}

/// A zeroed block of registers in its own memory, used to compute the offsets of its registers.
fn block<B>(_: *const B) -> Box<B> {
    // SAFETY: register blocks consist of integers in cells and of padding. All zeros is a valid value.
    unsafe { Box::new(std::mem::MaybeUninit::<B>::zeroed().assume_init()) }
}

fn reset_value<S: Resettable + RegisterSpec<Ux: Into<u64>>>(_: &Reg<S>) -> u32 {
    S::RESET_VALUE.into() as u32
}

macro_rules! described {
    ($($($peripheral:ident)+: $registers:tt;)*) => {{
        let mut list = Vec::new();
        $($(described!(list, $peripheral, $registers);)+)*
        list
    }};
    ($list:ident, $peripheral:ident, [$($($part:ident $(($n:literal))?).+)*]) => {{
        let base = stm32g4::stm32g474::$peripheral::PTR;
        let block = block(base);
        $({
            let register = block.$($part($($n)?)).+;
            let offset = register.as_ptr() as usize - &raw const *block as usize;
            let name = concat!(stringify!($peripheral), $(".", stringify!($part) $(, stringify!($n))?),+);
            $list.push(Described { name, address: (base as usize + offset) as u32, reset: reset_value(register) });
        })*
    }};
}

fn svd() -> Vec<Described> {
    described! {
        TIM1 TIM2 TIM3 TIM4 TIM5 TIM8: [cr1 cr2 smcr dier sr egr ccmr1_output ccmr2_output ccer cnt psc arr rcr
            ccr1 ccr2 ccr3 ccr4 bdtr ccr5 ccr6 ccmr3_output dtr2 ecr tisel af1 af2 dcr dmar];
        TIM6 TIM7: [cr1 cr2 dier sr egr cnt psc arr];
        TIM15: [cr1 cr2 smcr dier sr egr ccmr1_output ccer cnt psc arr rcr ccr1 ccr2 bdtr dtr2 tisel af1 af2 dcr
            dmar];
        TIM16 TIM17: [cr1 cr2 dier sr egr ccmr1_output ccer cnt psc arr rcr ccr1 bdtr dtr2 tisel af1 af2 or1 dcr
            dmar];
        DAC1 DAC2: [cr swtrgr dhr12r(0) dhr12r(1) dhr12l(0) dhr12l(1) dhr8r(0) dhr8r(1) dhr12rd dhr12ld dhr8rd
            dor(0) dor(1) sr ccr mcr shsr(0) shsr(1) shhr shrr str(0) str(1) stmodr];
        CRS: [cr cfgr isr icr];
        TAMP: [cr1 cr2 fltcr ier sr misr scr bkp0r bkp1r bkp2r bkp3r bkp4r bkp5r bkp6r bkp7r bkp8r bkp9r bkp10r
            bkp11r bkp12r bkp13r bkp14r bkp15r bkp16r bkp17r bkp18r bkp19r bkp20r bkp21r bkp22r bkp23r bkp24r bkp25r
            bkp26r bkp27r bkp28r bkp29r bkp30r bkp31r];
        IWDG: [kr pr rlr sr winr];
        SPI2: [cr1 cr2 sr dr crcpr rxcrcr txcrcr i2scfgr i2spr];
        USB: [ep0r ep1r ep2r ep3r ep4r ep5r ep6r ep7r cntr istr fnr daddr btable bcdr];
        PWR: [cr1 cr2 cr3 cr4 sr1 sr2 scr pucra pdcra pucrb pdcrb pucrc pdcrc pucrd pdcrd pucre pdcre pucrf pdcrf
            pucrg pdcrg cr5];
        LPUART1: [cr1 cr2 cr3 brr rqr isr icr rdr tdr presc];
        SYSCFG: [memrmp cfgr1 exticr1 exticr2 exticr3 exticr4 scsr cfgr2 swpr skr];
        EXTI: [imr1 emr1 rtsr1 ftsr1 swier1 pr1 imr2 emr2 rtsr2 ftsr2 swier2 pr2];
        DMA1 DMA2: [isr ifcr ch1.cr ch1.ndtr ch1.par ch1.mar ch2.cr ch2.ndtr ch2.par ch2.mar ch3.cr ch3.ndtr
            ch3.par ch3.mar ch4.cr ch4.ndtr ch4.par ch4.mar ch5.cr ch5.ndtr ch5.par ch5.mar ch6.cr ch6.ndtr ch6.par
            ch6.mar ch7.cr ch7.ndtr ch7.par ch7.mar ch8.cr ch8.ndtr ch8.par ch8.mar];
        DMAMUX: [ccr(0) ccr(1) ccr(2) ccr(3) ccr(4) ccr(5) ccr(6) ccr(7) ccr(8) ccr(9) ccr(10) ccr(11) ccr(12)
            ccr(13) ccr(14) ccr(15) csr cfr rgsr rgcfr rgcr(0) rgcr(1) rgcr(2) rgcr(3)];
        RCC: [cr icscr cfgr pllcfgr cier cifr cicr ahb1rstr ahb2rstr ahb3rstr apb1rstr1 apb1rstr2 apb2rstr ahb1enr
            ahb2enr ahb3enr apb1enr1 apb1enr2 apb2enr ahb1smenr ahb2smenr ahb3smenr apb1smenr1 apb1smenr2 apb2smenr
            ccipr bdcr csr crrcr ccipr2];
        FLASH: [acr pdkeyr keyr optkeyr sr cr eccr optr pcrop1sr pcrop1er wrp1ar wrp1br sec1r];
        GPIOA GPIOB GPIOC GPIOD GPIOE GPIOF GPIOG: [moder otyper ospeedr pupdr idr odr bsrr lckr afrl afrh brr];
        ADC1 ADC2 ADC3 ADC4 ADC5: [isr ier cr cfgr cfgr2 smpr1 smpr2 tr1 tr2 tr3 sqr1 sqr2 sqr3 sqr4 dr jsqr ofr1
            ofr2 ofr3 ofr4 jdr1 jdr2 jdr3 jdr4 awd2cr awd3cr difsel calfact gcomp];
        ADC12_COMMON ADC345_COMMON: [csr ccr cdr];
        DBGMCU: [idcode cr apb1l_fz apb1h_fz apb2_fz];
    }
}

fn chip() -> Chip {
    Chip::new(Board::NUCLEO, Box::new(Still))
}

/// A chip with every clock gate open.
fn awake() -> Chip {
    let mut chip = chip();
    for (register, gate) in [
        ("AHB1ENR", "DMA1EN"),
        ("AHB2ENR", "GPIOAEN"),
        ("AHB3ENR", "FMCEN"),
        ("APB1ENR1", "TIM2EN"),
        ("APB1ENR2", "LPUART1EN"),
        ("APB2ENR", "SYSCFGEN"),
    ] {
        let (address, _) = metapac::field("RCC", register, gate);
        chip.write(address, u32::MAX, Width::Word, 0).expect("a gate");
    }
    chip
}

/// The twin's answer to a read. `None` if it has no such register.
fn read(chip: &mut Chip, address: u32) -> Option<Result<u32, &'static str>> {
    let known = |what| what != Unknown::REGISTER.what && what != NOTHING.what;
    match chip.read(address, Width::Word, 0) {
        Ok(value) => Some(Ok(value)),
        Err(bad) => known(bad.what).then_some(Err(bad.what)),
    }
}

/// Addresses of all registers that the twin models.
fn modelled() -> BTreeSet<u32> {
    let mut chip = awake();
    let addresses = BUSES.into_iter().flatten().step_by(4).filter(|address| !PACKET_MEMORY.contains(address));
    addresses.filter(|&address| read(&mut chip, address).is_some()).collect()
}

/// A chip with every clock gate and every lock open.
fn unlocked() -> Chip {
    let mut chip = awake();
    let base = |name: &str| peripheral(name).address as u32;
    for (address, value) in [
        // PWR_CR1.DBP opens the backup domain.
        (base("PWR"), 0x300),
        // FLASH_KEYR, FLASH_OPTKEYR.
        (base("FLASH") + 0x08, 0x4567_0123),
        (base("FLASH") + 0x08, 0xCDEF_89AB),
        (base("FLASH") + 0x0c, 0x0819_2A3B),
        (base("FLASH") + 0x0c, 0x4C5D_6E7F),
        // IWDG_KR.
        (base("IWDG"), 0x5555),
    ] {
        chip.write(address, value, Width::Word, 0).unwrap_or_else(|bad| panic!("{address:#010x}: {bad:?}"));
    }
    chip
}

/// What happens to a bit that is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    /// It reads as written, whether the write sets or clears it.
    Kept,
    /// The run ends, because the model does not know what would follow.
    Refused,
    /// The write is accepted, and the bit reads as before.
    Dropped,
}

fn fate(address: u32, bit: u32) -> Fate {
    let mut chip = unlocked();
    let Some(Ok(before)) = read(&mut chip, address) else { return Fate::Refused };
    match chip.write(address, before ^ bit, Width::Word, 0) {
        Err(_) => Fate::Refused,
        Ok(()) if matches!(read(&mut chip, address), Some(Ok(after)) if (after ^ before) & bit != 0) => Fate::Kept,
        Ok(()) => Fate::Dropped,
    }
}

/// One name for all registers of the same kind.
fn alike(name: &str) -> String {
    let (peripheral, register) = name.split_once('.').expect("a register's name");
    let peripheral = match peripheral {
        "ADC1" | "ADC2" | "ADC3" | "ADC4" | "ADC5" => "ADCx",
        "TIM1" | "TIM8" => "TIM1, TIM8",
        "TIM2" | "TIM5" => "TIM2, TIM5",
        "TIM3" | "TIM4" => "TIM3, TIM4",
        "TIM16" | "TIM17" => "TIM16, TIM17",
        "TIM6" | "TIM7" => "TIM6, TIM7",
        "DAC1" | "DAC2" => "DAC1, DAC2",
        port if port.starts_with("GPIO") => "GPIOx",
        other => other,
    };
    let numbered = matches!(
        (peripheral, register.trim_end_matches(|c: char| c.is_ascii_digit())),
        ("DMAMUX1", "ccr") | ("USB", "epr")
    );
    let register = if numbered {
        format!("{}x", register.trim_end_matches(|c: char| c.is_ascii_digit()))
    } else {
        register.to_owned()
    };
    format!("{peripheral}.{register}")
}

/// Compares the differences found with the known ones.
fn compare(found: BTreeSet<String>, known: &[(&str, &str)]) {
    let known: BTreeSet<String> = known.iter().map(|(difference, _)| (*difference).to_owned()).collect();
    let new: Vec<_> = found.difference(&known).collect();
    let gone: Vec<_> = known.difference(&found).collect();
    assert!(new.is_empty() && gone.is_empty(), "differences not explained: {new:#?}\nexplained, and gone: {gone:#?}");
}

#[test]
fn every_register_is_where_metapac_has_it() {
    let metapac = metapac::registers();
    let differences = modelled().into_iter().filter(|address| !metapac.contains_key(address));
    compare(differences.map(|address| format!("{address:#010x}")).collect(), NOT_IN_METAPAC);
}

#[test]
fn a_register_keeps_no_bit_that_metapac_does_not_know() {
    let metapac = metapac::registers();
    let mut differences = BTreeSet::new();
    for address in modelled() {
        let Some(register) = metapac.get(&address) else { continue };
        let kept = (0..32)
            .map(|bit| 1 << bit)
            .filter(|bit| register.fields & bit == 0)
            .filter(|bit| fate(address, *bit) == Fate::Kept);
        let kept: u32 = kept.sum();
        if kept != 0 {
            differences.insert(format!("{}: {kept:#010x}", register.name));
        }
    }
    compare(differences, OTHER_FIELDS);
}

#[test]
fn a_field_that_metapac_knows_is_kept_or_explained() {
    let metapac = metapac::registers();
    let mut dropped = BTreeSet::new();
    let mut kept = 0;
    for address in modelled() {
        let Some(register) = metapac.get(&address) else { continue };
        let fates: Vec<_> = (0..32)
            .map(|bit| 1 << bit)
            .filter(|bit| register.fields & bit != 0)
            .map(|bit| (bit, fate(address, bit)))
            .collect();
        kept += fates.iter().filter(|(_, fate)| *fate == Fate::Kept).count();
        let bits: u32 = fates.iter().filter(|(_, fate)| *fate == Fate::Dropped).map(|(bit, _)| bit).sum();
        if bits != 0 {
            dropped.insert(format!("{}: {bits:#010x}", alike(&register.name)));
        }
    }
    assert!(kept > 9_000, "{kept} bits are kept");
    compare(dropped, DROPPED);
}

#[test]
fn every_register_starts_as_stm32g4_has_it() {
    let mut differences = BTreeSet::new();
    let mut missing: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for Described { name, address, reset } in svd() {
        // Read the chip asleep first: opening the gates and the backup domain changes some registers.
        let asleep = read(&mut chip(), address);
        match if asleep == Some(Err(CLOCK_OFF.what)) { read(&mut awake(), address) } else { asleep } {
            None => {
                let (peripheral, register) = name.split_once('.').expect("a register's name");
                missing.entry(peripheral).or_default().push(register);
            }
            Some(Ok(value)) if value == reset => {}
            Some(Ok(value)) => {
                differences.insert(format!("{name}: {value:#010x}, not {reset:#010x}"));
            }
            Some(Err(what)) => {
                differences.insert(format!("{name}: {what}"));
            }
        }
    }
    compare(differences, OTHER_RESET_VALUES);
    let grouped = missing.into_iter().map(|(peripheral, registers)| format!("{peripheral}: {}", registers.join(" ")));
    compare(grouped.collect(), NOT_MODELLED);
}

#[test]
fn every_modelled_register_has_a_reset_value_to_be_held_against() {
    let described: BTreeSet<u32> = svd().iter().map(|one| one.address).collect();
    let missing = modelled().difference(&described).map(|address| format!("{address:#010x}")).collect();
    compare(missing, NOT_IN_STM32G4);
}

#[test]
fn a_peripheral_answers_while_metapacs_bit_opens_its_gate() {
    let modelled = modelled();
    let mut compared = 0;
    for peripheral in METADATA.peripherals {
        let Some(enable) = peripheral.rcc.as_ref().and_then(|rcc| rcc.enable.as_ref()) else { continue };
        let base = peripheral.address as u32;
        let Some(&address) = modelled.range(base..base + 0x400).next() else { continue };
        let (register, bit) = metapac::field("RCC", enable.register, enable.field);
        let mut chip = chip();
        let mut set = |value: u32| {
            chip.write(register, value, Width::Word, 0).expect("a gate");
            read(&mut chip, address)
        };
        let name = peripheral.name;
        assert!(set(bit).is_some_and(|answer| answer != Err(CLOCK_OFF.what)), "{name} with {}", enable.field);
        // These share SYSCFG's gate and addresses, and are not modelled.
        if name.starts_with("COMP") || name.starts_with("OPAMP") || name == "VREFBUF" {
            continue;
        }
        assert_eq!(set(!bit), Some(Err(CLOCK_OFF.what)), "{name} without {}", enable.field);
        compared += 1;
    }
    assert!(compared >= 30, "{compared}");
}

#[test]
fn dma_requests_have_metapacs_numbers() {
    for (request, number) in Request::ALL {
        let (name, signal) = match request {
            Request::Adc(unit) => {
                let name = ["ADC1", "ADC2", "ADC3", "ADC4", "ADC5"][unit as usize];
                (name, name)
            }
            Request::Tim6Update => ("TIM6", "UP"),
            Request::Tim7Update => ("TIM7", "UP"),
            Request::Dac1 => ("DAC1", "CH1"),
            Request::Dac2 => ("DAC2", "CH1"),
            Request::Spi2Receive => ("SPI2", "RX"),
            Request::Spi2Transmit => ("SPI2", "TX"),
        };
        let channel = peripheral(name).dma_channels.iter().find(|channel| channel.signal == signal);
        assert_eq!(channel.and_then(|channel| channel.request), Some(u32::from(number)), "{name} {signal}");
    }
}

#[test]
fn inputs_of_the_encoders_counter_are_metapacs() {
    let pins = peripheral("TIM2").pins.iter();
    let expected: BTreeSet<_> = pins
        .filter(|pin| matches!(pin.signal, "CH1" | "CH2" | "CH3" | "CH4"))
        .map(|pin| (pin.pin.to_owned(), pin.af, pin.signal.to_owned()))
        .collect();
    let ours = TIM2_INPUTS.iter().map(|(pin, function, channel)| {
        let name = format!("P{}{}", char::from(b'A' + pin.port as u8), pin.number);
        (name, Some(*function), format!("CH{channel}"))
    });
    assert_eq!(ours.collect::<BTreeSet<_>>(), expected);
}

#[test]
fn timers_raise_metapacs_interrupts() {
    let word =
        |chip: &mut Chip, address: u32, value: u32| chip.write(address, value, Width::Word, 0).expect("a timer's");
    for name in ["TIM1", "TIM2", "TIM3", "TIM4", "TIM5", "TIM6", "TIM7", "TIM8", "TIM15", "TIM16", "TIM17"] {
        let timer = peripheral(name);
        let base = timer.address as u32;
        let line = |signal: &str| {
            let interrupt = timer.interrupts.iter().find(|one| one.signal == signal).expect(signal).interrupt;
            METADATA.interrupts.iter().find(|one| one.name == interrupt).expect(interrupt).number
        };
        let mut chip = awake();
        // DIER.UIE, EGR.UG.
        word(&mut chip, base + 0x0c, 1);
        word(&mut chip, base + 0x14, 1);
        assert_eq!(chip.irq_lines(), 1 << line("UP"), "{name}: update");
        if matches!(name, "TIM6" | "TIM7") {
            continue;
        }
        word(&mut chip, base + 0x10, 0);
        // DIER.CC1IE, CCR1, CR1.CEN.
        word(&mut chip, base + 0x0c, 2);
        word(&mut chip, base + 0x34, 5);
        word(&mut chip, base, 1);
        chip.advance(10);
        assert_eq!(chip.irq_lines(), 1 << line("CC"), "{name}: compare");
    }
}
