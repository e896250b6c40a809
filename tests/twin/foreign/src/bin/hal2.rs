//! A small instrument on `stm32-hal2`: clock tree, converter with DMA, encoder, LPUART1, flash.
//!
//! Answers each letter at the serial port with a line: `a` the voltages at PA0 and PA1, `c` the clock, `e` the encoder's
//! count, `f` what flash keeps after an erase and a write, `F` the same without choosing the second bank.

#![no_main]
#![no_std]

use core::fmt::Write;
use cortex_m_rt::entry;
use defmt_rtt as _;
use hal::{
    adc::{Adc, AdcConfig, ClockMode, SampleTime},
    clocks::{Clocks, InputSrc, PllSrc, Pllm},
    dma::{self, Dma, DmaChannel, DmaInput, DmaPeriph},
    flash::{Bank, DualBank, Flash},
    gpio::{Pin, PinMode, Port},
    lpuart::LpUart,
    pac,
    timer::{InputSlaveMode, InputTrigger, Timer},
    usart::UsartConfig,
};
use panic_probe as _;
use stm32_hal2 as hal;

const CHANNELS: [u8; 2] = [1, 2];
const PAGE: usize = 100;

/// A line of text.
struct Line([u8; 64], usize);

impl Write for Line {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        let end = self.1 + text.len();
        self.0.get_mut(self.1..end).ok_or(core::fmt::Error)?.copy_from_slice(text.as_bytes());
        self.1 = end;
        Ok(())
    }
}

#[entry]
fn main() -> ! {
    let dp = pac::Peripherals::take().unwrap();

    // The driver asks for boost while the clock of PWR is off, and the chip ignores it.
    dp.RCC.apb1enr1().modify(|_, w| w.pwren().bit(true));

    let mut clocks = Clocks { input_src: InputSrc::Pll(PllSrc::Hse(24_000_000)), ..Default::default() };
    clocks.pll.divm = Pllm::Div6;
    clocks.setup().unwrap();

    let _tx = Pin::new(Port::A, 2, PinMode::Alt(12));
    let _rx = Pin::new(Port::A, 3, PinMode::Alt(12));
    let mut serial = LpUart::new(dp.LPUART1, 115_200, UsartConfig::default(), &clocks).unwrap();

    let _a = Pin::new(Port::A, 15, PinMode::Alt(1));
    let _b = Pin::new(Port::B, 3, PinMode::Alt(1));
    let mut encoder = Timer::new_tim2_manual(dp.TIM2, 0, u32::MAX, Default::default(), &clocks);
    encoder.set_input_slave_mode(InputSlaveMode::Encoder3, InputTrigger::Internal0);
    encoder.enable();

    let _force = Pin::new(Port::A, 0, PinMode::Analog);
    let _terminal = Pin::new(Port::A, 1, PinMode::Analog);
    // The driver's default would be 85 MHz.
    let config = AdcConfig { clock_mode: ClockMode::SyncDiv4, sample_time: SampleTime::T181, ..Default::default() };
    let mut adc = Adc::new_adc1(dp.ADC1, config, clocks.systick()).unwrap();
    let mut dma = Dma::new(dp.DMA1);
    dma::enable_mux1();
    dma::mux(DmaPeriph::Dma1, DmaChannel::C1, DmaInput::Adc1);

    let mut flash = Flash::new(dp.FLASH, DualBank::Dual);

    loop {
        let mut letter = [0];
        if serial.read(&mut letter).is_err() {
            continue;
        }
        let mut line = Line([0; 64], 0);
        let written = match letter[0] {
            b'a' => {
                let mut codes = [0u16; 2];
                // SAFETY: the buffer lives until the transfer is complete.
                let begun =
                    unsafe { adc.read_dma(&mut codes, &CHANNELS, DmaChannel::C1, Default::default(), DmaPeriph::Dma1) };
                begun.unwrap();
                while !dma.transfer_is_complete(DmaChannel::C1) {}
                dma.stop(DmaChannel::C1).unwrap();
                dma.clear_interrupt(DmaChannel::C1, dma::DmaInterrupt::TransferComplete).unwrap();
                let [force, terminal] = codes.map(|code| (adc.reading_to_voltage(code) * 1e4 + 0.5) as u32);
                writeln!(line, "{force} {terminal}")
            }
            b'c' => writeln!(line, "{}", clocks.systick()),
            b'e' => writeln!(line, "{}", encoder.read_count() as i32),
            choice @ (b'f' | b'F') => {
                if choice == b'f' {
                    // The driver leaves the bank's choice out ("PAC error").
                    flash.unlock().unwrap();
                    flash.regs.cr().modify(|_, w| w.bker().bit(true));
                }
                flash.erase_page(Bank::B2, PAGE).unwrap();
                flash.write_page(Bank::B2, PAGE, b"written by others").unwrap();
                let mut back = [0; 20];
                flash.read(Bank::B2, PAGE, 0, &mut back);
                let text = back.iter().take_while(|byte| **byte != 0xff).count();
                writeln!(line, "{}", core::str::from_utf8(&back[..text]).unwrap())
            }
            _ => writeln!(line, "?"),
        };
        written.unwrap();
        serial.write(&line.0[..line.1]).unwrap();
    }
}
