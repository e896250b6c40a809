//! Devices whose ROM bootloader waits for firmware over USB.

use nusb::{ErrorKind, MaybeFuture};

use crate::{
    board::{DFU_PID, ST_VID},
    update::UpdateError,
};

/// A device in update mode.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct DfuDevice {
    /// Its USB product name.
    pub product: Option<String>,
    /// Its serial number, the same as that of the firmware.
    pub serial: String,
    /// USB vendor ID.
    pub vid: u16,
    /// USB product ID.
    pub pid: u16,
}

/// Devices in update mode; other STM32 chips look the same.
pub fn list() -> Result<Vec<DfuDevice>, UpdateError> {
    let mut devices: Vec<DfuDevice> = found()?.iter().map(DfuDevice::from).collect();
    devices.sort_by(|a, b| a.serial.cmp(&b.serial));
    Ok(devices)
}

fn found() -> Result<Vec<nusb::DeviceInfo>, UpdateError> {
    let devices = nusb::list_devices().wait().map_err(|error| UpdateError::Usb { reason: error.to_string() })?;
    Ok(devices.filter(|device| (device.vendor_id(), device.product_id()) == (ST_VID, DFU_PID)).collect())
}

/// Whether a device in update mode may be opened; nothing is sent to it.
pub fn may_open(device: &DfuDevice) -> Result<(), UpdateError> {
    opened(device).map(drop)
}

pub(crate) fn opened(device: &DfuDevice) -> Result<nusb::Device, UpdateError> {
    let info = found()?.into_iter().find(|info| info.serial_number().unwrap_or_default() == device.serial);
    let gone = || UpdateError::Open { serial: device.serial.clone(), reason: "it went away".into() };
    info.ok_or_else(gone)?.open().wait().map_err(|error| refused(device, &error))
}

pub(crate) fn refused(device: &DfuDevice, error: &nusb::Error) -> UpdateError {
    let serial = device.serial.clone();
    match error.kind() {
        ErrorKind::PermissionDenied => UpdateError::Permission { serial },
        _ => UpdateError::Open { serial, reason: error.to_string() },
    }
}

impl From<&nusb::DeviceInfo> for DfuDevice {
    fn from(info: &nusb::DeviceInfo) -> Self {
        Self {
            product: info.product_string().map(|product| product.trim().to_string()),
            serial: info.serial_number().unwrap_or_default().to_string(),
            vid: info.vendor_id(),
            pid: info.product_id(),
        }
    }
}
