//! Serial ports of this machine, and which of them are ours.

use serde::Serialize;
use serialport::{SerialPortInfo, SerialPortType};

use crate::error::DeviceError;
use crate::{
    board::{PRODUCT, ST_LINK_PIDS, ST_VID, USB_PID, USB_VID},
    dfu,
};

/// A serial port.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Port {
    /// Name to open it with.
    pub port: String,
    /// True for an instrumented inerter.
    pub inerter: bool,
    /// True for the serial port of an ST-Link, to which a NUCLEO's UART is wired.
    pub stlink: bool,
    /// Its product name.
    pub product: Option<String>,
    /// Its serial number.
    pub serial: Option<String>,
    /// USB vendor ID.
    pub vid: Option<u16>,
    /// USB product ID.
    pub pid: Option<u16>,
}

impl From<SerialPortInfo> for Port {
    fn from(info: SerialPortInfo) -> Self {
        let plain = Self { port: info.port_name, ..Self::default() };
        let SerialPortType::UsbPort(usb) = info.port_type else { return plain };
        // Linux writes the product with underscores if it comes from a file name.
        let named = usb.product.as_deref().is_some_and(|product| product.replace('_', " ").trim() == PRODUCT);
        Self {
            inerter: usb.vid == USB_VID && usb.pid == USB_PID && named,
            stlink: usb.vid == ST_VID && ST_LINK_PIDS.contains(&usb.pid),
            product: usb.product,
            serial: usb.serial_number,
            vid: Some(usb.vid),
            pid: Some(usb.pid),
            ..plain
        }
    }
}

/// All ports, ours first, then those of ST-Links, then by name.
pub fn list() -> Vec<Port> {
    // A machine that cannot list its ports is treated as one without ports.
    let mut ports: Vec<Port> = serialport::available_ports().unwrap_or_default().into_iter().map(Port::from).collect();
    ports.sort_by_key(|port| (!port.inerter, !port.stlink, port.port.clone()));
    ports
}

/// The port of the only inerter, or of the one with this serial number.
pub fn find(serial: Option<&str>) -> Result<String, DeviceError> {
    choose(list(), serial).map_err(|error| match error {
        DeviceError::NoneFound { serial: wanted, stlinks, .. } => {
            let in_dfu = |device: &dfu::DfuDevice| serial.is_none_or(|serial| device.serial == serial);
            let in_dfu = dfu::list().is_ok_and(|devices| devices.iter().any(in_dfu));
            DeviceError::NoneFound { serial: wanted, stlinks, in_dfu }
        }
        error => error,
    })
}

/// The serial number of the inerter at this port, if the system knows it.
pub fn serial_of(port: &str) -> Option<String> {
    list().into_iter().find(|other| other.inerter && other.port == port)?.serial
}

/// The serial port of the ST-Link with this serial number.
pub fn stlink_port(serial: &str) -> Option<String> {
    list().into_iter().find(|port| port.stlink && port.serial.as_deref() == Some(serial)).map(|port| port.port)
}

fn choose(ports: Vec<Port>, serial: Option<&str>) -> Result<String, DeviceError> {
    let stlinks = ports.iter().filter(|port| port.stlink).map(|port| port.port.clone()).collect();
    let mut ours = ports
        .into_iter()
        .filter(|port| port.inerter && serial.is_none_or(|serial| port.serial.as_deref() == Some(serial)));
    let first = ours.next().ok_or_else(|| DeviceError::NoneFound {
        serial: serial.map(str::to_string),
        stlinks,
        in_dfu: false,
    })?;
    let more: Vec<Port> = ours.collect();
    if more.is_empty() {
        return Ok(first.port);
    }
    let word = |port: &Port| format!("{} (serial {})", port.port, port.serial.as_deref().unwrap_or("unknown"));
    Err(DeviceError::SeveralFound {
        ports: std::iter::once(&first).chain(&more).map(word).collect::<Vec<_>>().join(", "),
    })
}

#[cfg(test)]
mod tests {
    use serialport::UsbPortInfo;

    use super::*;

    fn usb(name: &str, vid: u16, pid: u16, product: &str, serial: &str) -> Port {
        let usb = UsbPortInfo {
            vid,
            pid,
            serial_number: Some(serial.into()),
            manufacturer: None,
            product: Some(product.into()),
            interface: None,
        };
        SerialPortInfo { port_name: name.into(), port_type: SerialPortType::UsbPort(usb) }.into()
    }

    #[test]
    fn ours_are_told_from_other_test_devices_and_from_each_other() {
        let ports = || {
            vec![
                usb("/dev/ttyACM0", USB_VID, USB_PID, "Somebody's lamp", "1"),
                usb("/dev/ttyACM1", USB_VID, USB_PID, "inerter", "A"),
                SerialPortInfo { port_name: "/dev/ttyS0".into(), port_type: SerialPortType::Unknown }.into(),
            ]
        };
        assert_eq!(choose(ports(), None).unwrap(), "/dev/ttyACM1");
        let link = usb("/dev/ttyACM7", 0x0483, 0x374E, "STLINK-V3", "0031");
        assert!(link.stlink && !link.inerter);
        let none = choose(vec![link], None).unwrap_err();
        assert!(none.to_string().ends_with("; an ST-Link is at /dev/ttyACM7"), "{none}");
        assert!(miette::Diagnostic::help(&none).unwrap().to_string().contains("--port /dev/ttyACM7"));
        assert!(!usb("/dev/ttyACM7", 0x0483, 0x5740, "another CDC device", "1").stlink);
        assert!(matches!(choose(ports(), Some("B")), Err(DeviceError::NoneFound { .. })));
        let mut two = ports();
        two.push(usb("/dev/ttyACM2", USB_VID, USB_PID, PRODUCT, "B"));
        assert_eq!(choose(two.clone(), Some("B")).unwrap(), "/dev/ttyACM2");
        let error = choose(two, None).unwrap_err().to_string();
        assert!(error.contains("/dev/ttyACM1 (serial A), /dev/ttyACM2 (serial B)"), "{error}");
    }
}
