//! The first link: a USB CDC-ACM port.
//!
//! - `driver.rs`: embassy-stm32's driver, with additions: bus power, halts, requests without data, resets and suspends.
//! - `link.rs`: bytes in both directions while a host has the port open.
//!
//! VID and PID are from pid.codes' range for tests. The serial number is the chip's, in the form that the ROM's update
//! mode also uses, so that one number identifies a device in both modes.

mod driver;
mod link;

pub use driver::DisturbanceHandler;
use driver::Driver;
use embassy_futures::select::select;
use embassy_stm32::exti::ExtiInput;
use embassy_stm32::mode::Async;
use embassy_stm32::peripherals;
use embassy_usb::class::cdc_acm::{CdcAcmClass, ControlChanged, State};
use embassy_usb::{Builder, Config, UsbDevice};
pub use link::{Receiver, Transmitter, drain};
use static_cell::{ConstStaticCell, StaticCell};

/// pid.codes, range for tests.
const VENDOR: u16 = 0x1209;
const PRODUCT: u16 = 0x0001;
/// Name of the manufacturer and of the product.
const NAME: &str = "inerter";

static CONFIGURATION: ConstStaticCell<[u8; 96]> = ConstStaticCell::new([0; 96]);
static CAPABILITIES: ConstStaticCell<[u8; 16]> = ConstStaticCell::new([0; 16]);
static CONTROL: ConstStaticCell<[u8; 64]> = ConstStaticCell::new([0; 64]);
static CLASS: StaticCell<State> = StaticCell::new();
static HANDLER: ConstStaticCell<link::Handler> = ConstStaticCell::new(link::Handler);
static LINES: StaticCell<ControlChanged<'static>> = StaticCell::new();

/// The peripheral, not started yet.
pub type Peripheral = embassy_stm32::usb::Driver<'static, peripherals::USB>;

/// The device and the port that it offers.
pub struct Port {
    /// Runs the device; needs its own task.
    pub device: Device,
    /// Bytes from the host.
    pub receiver: Receiver,
    /// Bytes to the host.
    pub transmitter: Transmitter,
}

/// Builds the device. It appears on the bus when it runs and `vbus` is powered.
pub fn start(usb: Peripheral, vbus: Option<ExtiInput<'static, Async>>, serial: &'static str) -> Port {
    let mut config = Config::new(VENDOR, PRODUCT);
    config.manufacturer = Some(NAME);
    config.product = Some(NAME);
    config.serial_number = Some(serial);
    config.max_power = 250;
    let mut builder = Builder::new(
        Driver::new(usb, vbus),
        config,
        CONFIGURATION.take(),
        CAPABILITIES.take(),
        &mut [],
        CONTROL.take(),
    );
    let class = CdcAcmClass::new(&mut builder, CLASS.init(State::new()), link::PACKET as u16);
    builder.handler(HANDLER.take());
    let device = builder.build();
    let (sender, receiver, lines) = class.split_with_control();
    let lines: &'static ControlChanged = LINES.init(lines);
    Port {
        device: Device { device, lines },
        receiver: Receiver::new(receiver, lines),
        transmitter: Transmitter::new(sender, lines),
    }
}

/// The device, to be run.
pub struct Device {
    device: UsbDevice<'static, Driver>,
    lines: &'static ControlChanged<'static>,
}

impl Device {
    /// Serves the bus, and calls `opened` whenever a host opens or closes the port.
    pub async fn run(mut self, opened: impl Fn(bool)) -> ! {
        select(self.device.run(), link::watch(self.lines, opened)).await;
        unreachable!("neither ends")
    }
}
