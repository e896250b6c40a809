//! This machine's USB and serial ports.

use std::time::Duration;

use dfu_nusb::DfuNusb;
use inerter_wire::{Command, WIRE_VERSION};
use nusb::MaybeFuture;

use super::{
    dfuse,
    error::UpdateError,
    machine::{Machine, Running},
};
use crate::{
    dfu::{DfuDevice, list, opened, refused},
    error::DeviceError,
    link::Target,
    session::{Clock, Device, Interrupted},
};

/// USB interface of the ROM, and its alternate setting for flash (AN3156).
const INTERFACE: u8 = 0;
const FLASH_SETTING: u8 = 0;
/// Timeout for a text of the ROM.
const TEXT_TIMEOUT: Duration = Duration::from_secs(3);

/// The machine that this program runs on, and the chosen device.
pub struct ThisMachine {
    target: Target,
    interrupted: Interrupted,
    device: Option<Box<Device>>,
}

impl ThisMachine {
    /// Finds devices by `target` at first, and by their serial number afterwards.
    pub fn new(target: Target, interrupted: Interrupted) -> Self {
        Self { target, interrupted, device: None }
    }

    fn reached(&self, target: &Target) -> Result<Device, DeviceError> {
        Device::connect(target, Clock::new(), self.interrupted)
    }
}

/// The ROM's description of its flash; empty if there is none.
fn description(device: &nusb::Device, interface: &nusb::Interface) -> String {
    let mut settings = interface.descriptors().filter(|setting| setting.alternate_setting() == FLASH_SETTING);
    let Some(index) = settings.find_map(|setting| setting.string_index()) else { return String::new() };
    let languages = device.get_string_descriptor_supported_languages(TEXT_TIMEOUT).wait();
    let language = languages.ok().and_then(|mut all| all.next()).unwrap_or_default();
    device.get_string_descriptor(index, language, TEXT_TIMEOUT).wait().unwrap_or_default()
}

impl Machine for ThisMachine {
    type Io = DfuNusb;

    fn running(&mut self) -> Result<Option<Running>, UpdateError> {
        let device = match self.reached(&self.target) {
            Ok(device) => device,
            Err(DeviceError::NoneFound { .. }) => return Ok(None),
            // The given port belongs to a board that is already in update mode, so the port is gone.
            Err(DeviceError::Missing { .. }) if list().is_ok_and(|devices| !devices.is_empty()) => return Ok(None),
            Err(DeviceError::Silent { name, .. }) => {
                return Err(UpdateError::CannotAsk { name, reason: "it does not answer".into() });
            }
            Err(DeviceError::WireVersion { name, theirs }) => {
                let reason = format!("it speaks wire version {theirs}, this program {WIRE_VERSION}");
                return Err(UpdateError::CannotAsk { name, reason });
            }
            Err(error) => return Err(error.into()),
        };
        let running = Running { name: device.name().into(), hello: device.hello().clone() };
        self.device = Some(Box::new(device));
        Ok(Some(running))
    }

    fn enter_dfu(&mut self) -> Result<(), UpdateError> {
        let Some(mut device) = self.device.take() else { return Ok(()) };
        match device.request("to enter update mode", Command::EnterDfu) {
            // The device may be gone before its reply is sent.
            Ok(_) | Err(DeviceError::Vanished { .. } | DeviceError::NoReply { .. }) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    fn in_dfu(&mut self) -> Result<Vec<DfuDevice>, UpdateError> {
        list()
    }

    fn open(&mut self, device: &DfuDevice) -> Result<DfuNusb, UpdateError> {
        let failed = |reason: String| UpdateError::Open { serial: device.serial.clone(), reason };
        let opened = opened(device)?;
        let interface = opened.claim_interface(INTERFACE).wait().map_err(|error| refused(device, &error))?;
        if !dfuse::is_readable(&description(&opened, &interface)) {
            return Err(failed("its description of its flash is not that of an STM32".into()));
        }
        let runtime = tokio::runtime::Builder::new_current_thread().build();
        let runtime = runtime.map_err(|error| failed(error.to_string()))?;
        runtime.block_on(DfuNusb::open(opened, interface, FLASH_SETTING)).map_err(|error| failed(error.to_string()))
    }

    fn hello(&mut self, serial: &str) -> Result<Running, UpdateError> {
        // Over USB on whatever port it now has; otherwise on the same port as before, since a UART's name does not
        // change.
        let device = match self.reached(&Target::Usb { serial: Some(serial.into()) }) {
            Err(DeviceError::NoneFound { .. }) if !matches!(self.target, Target::Usb { .. }) => {
                self.reached(&self.target)?
            }
            result => result?,
        };
        Ok(Running { name: device.name().into(), hello: device.hello().clone() })
    }

    fn sleep(&mut self, time: Duration) {
        std::thread::sleep(time);
    }

    fn check_interrupted(&self) -> Result<(), UpdateError> {
        if (self.interrupted)() { Err(DeviceError::Interrupted.into()) } else { Ok(()) }
    }
}
