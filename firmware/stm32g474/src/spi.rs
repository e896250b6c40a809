//! The converter's bus: SPI by DMA, with its chip select.

use embassy_stm32::gpio::Output;
use embassy_stm32::mode::Async;
use embassy_stm32::spi::mode::Master;
use embassy_stm32::spi::{BitOrder, Config, Error, MODE_1, Spi};
use embassy_stm32::time::Hertz;
use embassy_time::Timer;
use embedded_hal_async::spi::{ErrorType, Operation, SpiDevice};

/// A frame of 18 bytes takes 14 us; the converter takes up to 25 MHz.
const CLOCK: Hertz = Hertz(10_500_000);

/// How the converter wants it.
pub fn config() -> Config {
    let mut config = Config::default();
    config.mode = MODE_1;
    config.bit_order = BitOrder::MsbFirst;
    config.frequency = CLOCK;
    config
}

/// One device on the bus.
pub struct Device {
    bus: Spi<'static, Async, Master>,
    select: Output<'static>,
}

impl Device {
    /// `select` is high at rest.
    pub fn new(bus: Spi<'static, Async, Master>, select: Output<'static>) -> Self {
        Self { bus, select }
    }
}

/// Deselects, also when the future is dropped.
struct Selected<'a>(&'a mut Output<'static>);

impl<'a> Selected<'a> {
    fn new(select: &'a mut Output<'static>) -> Self {
        select.set_low();
        Self(select)
    }
}

impl Drop for Selected<'_> {
    fn drop(&mut self) {
        self.0.set_high();
    }
}

impl ErrorType for Device {
    type Error = Error;
}

impl SpiDevice for Device {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Error> {
        let _selected = Selected::new(&mut self.select);
        for operation in operations {
            match operation {
                Operation::Read(bytes) => self.bus.read(bytes).await?,
                Operation::Write(bytes) => self.bus.write(bytes).await?,
                Operation::Transfer(into, from) => self.bus.transfer(into, from).await?,
                Operation::TransferInPlace(bytes) => self.bus.transfer_in_place(bytes).await?,
                Operation::DelayNs(time) => Timer::after_nanos(u64::from(*time)).await,
            }
        }
        Ok(())
    }
}
