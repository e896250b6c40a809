//! A serial port on USB by `stm32-hal2`, `stm32-usbd`, `usb-device` and `usbd-serial`, driven by its interrupt: gives back
//! what it gets, each byte one higher.

#![no_main]
#![no_std]

use core::cell::RefCell;
use cortex_m::interrupt::Mutex;
use cortex_m_rt::entry;
use defmt_rtt as _;
use hal::{
    clocks::{self, Clk48Src, Clocks, CrsSyncSrc, InputSrc, PllSrc, Pllm},
    pac::{self, interrupt},
    usb::{Peripheral, UsbBus},
};
use panic_probe as _;
use stm32_hal2 as hal;
use usb_device::{bus::UsbBusAllocator, prelude::*};
use usbd_serial::{SerialPort, USB_CLASS_CDC};

type Bus = UsbBus<Peripheral>;
type Port = (UsbDevice<'static, Bus>, SerialPort<'static, Bus>);

static PORT: Mutex<RefCell<Option<Port>>> = Mutex::new(RefCell::new(None));

#[entry]
fn main() -> ! {
    let dp = pac::Peripherals::take().unwrap();

    // The driver asks for boost while the clock of PWR is off, and the chip ignores it.
    dp.RCC.apb1enr1().modify(|_, w| w.pwren().bit(true));

    let mut setup = Clocks {
        input_src: InputSrc::Pll(PllSrc::Hse(24_000_000)),
        hsi48_on: true,
        clk48_src: Clk48Src::Hsi48,
        ..Default::default()
    };
    setup.pll.divm = Pllm::Div6;
    setup.setup().unwrap();
    clocks::enable_crs(CrsSyncSrc::Usb);

    let bus = UsbBus::new(Peripheral { regs: dp.USB });
    let bus: &'static UsbBusAllocator<Bus> = cortex_m::singleton!(: UsbBusAllocator<Bus> = bus).unwrap();
    let serial = SerialPort::new(bus);
    let strings = StringDescriptors::default().manufacturer("Others").product("Echo").serial_number("1");
    let device = UsbDeviceBuilder::new(bus, UsbVidPid(0x16c0, 0x27dd))
        .strings(&[strings])
        .unwrap()
        .device_class(USB_CLASS_CDC)
        .build();
    cortex_m::interrupt::free(|cs| PORT.borrow(cs).replace(Some((device, serial))));
    // SAFETY: nothing here relies on the interrupt being masked.
    unsafe { cortex_m::peripheral::NVIC::unmask(pac::Interrupt::USB_LP) };

    loop {
        cortex_m::asm::wfi();
    }
}

#[interrupt]
fn USB_LP() {
    cortex_m::interrupt::free(|cs| {
        let mut port = PORT.borrow(cs).borrow_mut();
        let Some((device, serial)) = port.as_mut() else { return };
        if !device.poll(&mut [serial]) {
            return;
        }
        let mut bytes = [0; 64];
        let Ok(count) = serial.read(&mut bytes) else { return };
        for byte in &mut bytes[..count] {
            *byte = byte.wrapping_add(1);
        }
        let _ = serial.write(&bytes[..count]);
    });
}
