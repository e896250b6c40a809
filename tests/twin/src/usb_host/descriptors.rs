//! USB descriptors of the device.
//!
//! Source: USB 2.0 9.6; CDC 1.2 5.2.

/// Transfer types of an endpoint besides control.
const ISOCHRONOUS: u8 = 1;
const BULK: u8 = 2;
const INTERRUPT: u8 = 3;

/// Errors in descriptors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DescriptorError {
    /// A descriptor is truncated, or its length is impossible.
    #[error("descriptor is truncated")]
    Short,
    /// Not the requested descriptor type.
    #[error("unexpected descriptor type")]
    Kind,
    /// A string descriptor is not UTF-16.
    #[error("string descriptor is not valid UTF-16")]
    Text,
    /// The number of interfaces differs from bNumInterfaces.
    #[error("number of interfaces differs from bNumInterfaces")]
    Interfaces,
    /// A packet size that is not allowed at full speed.
    #[error("endpoint packet size is not allowed at full speed")]
    PacketSize,
    /// There is no CDC data interface with a pair of bulk endpoints.
    #[error("not a serial port: no pair of bulk endpoints in a CDC data interface")]
    NotSerial,
}

/// An endpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// bEndpointAddress: number, with the top bit set for IN.
    pub address: u8,
    /// Whether its transfer type is bulk: packets in the remaining bus time.
    pub is_bulk: bool,
    /// Maximum packet size \[bytes\].
    pub packet: u16,
    /// Class of the interface.
    pub class: u8,
}

/// The contents of a device's descriptors.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Description {
    /// Vendor ID.
    pub vendor: u16,
    /// Product ID.
    pub product_number: u16,
    /// Device version, BCD.
    pub version: u16,
    /// Class, subclass, protocol.
    pub class: [u8; 3],
    /// Maximum packet size of endpoint 0.
    pub control_packet: u8,
    /// Manufacturer.
    pub manufacturer: String,
    /// Product name.
    pub product: String,
    /// Serial number.
    pub serial: String,
    /// Value of the first configuration.
    pub configuration: u8,
    /// Maximum bus current \[mA\].
    pub current_ma: u16,
    /// Number, class, subclass and protocol of each interface.
    pub interfaces: Vec<[u8; 4]>,
    /// All endpoints.
    pub endpoints: Vec<Endpoint>,
}

impl Description {
    /// Parses the device and configuration descriptors; strings stay empty.
    pub fn parse(device: &[u8], configuration: &[u8]) -> Result<Self, DescriptorError> {
        let device: &[u8; 18] = device.try_into().map_err(|_| DescriptorError::Short)?;
        if device[0] != 18 || device[1] != 1 {
            return Err(DescriptorError::Kind);
        }
        let word = |at: usize| u16::from_le_bytes([device[at], device[at + 1]]);
        let mut description = Self {
            class: [device[4], device[5], device[6]],
            control_packet: device[7],
            vendor: word(8),
            product_number: word(10),
            version: word(12),
            ..Self::default()
        };
        if !matches!(description.control_packet, 8 | 16 | 32 | 64) {
            return Err(DescriptorError::PacketSize);
        }
        description.read_configuration(configuration)?;
        Ok(description)
    }

    fn read_configuration(&mut self, bytes: &[u8]) -> Result<(), DescriptorError> {
        if usize::from(total_length(bytes)?) != bytes.len() {
            return Err(DescriptorError::Short);
        }
        let mut rest = bytes;
        let mut promised = 0;
        while !rest.is_empty() {
            let length = usize::from(rest[0]);
            let one = rest.get(..length).filter(|_| length >= 2).ok_or(DescriptorError::Short)?;
            rest = &rest[length..];
            match *one {
                [9, 2, _, _, interfaces, number, _, _, current] => {
                    promised = usize::from(interfaces);
                    self.configuration = number;
                    self.current_ma = u16::from(current) * 2;
                }
                [9, 4, number, _, _, class, subclass, protocol, _] => {
                    self.interfaces.push([number, class, subclass, protocol]);
                }
                [7, 5, address, attributes, low, high, _] => {
                    let (kind, packet) = (attributes & 3, u16::from_le_bytes([low, high]));
                    let allowed = match kind {
                        ISOCHRONOUS => packet <= 1023,
                        INTERRUPT => packet <= 64,
                        _ => matches!(packet, 8 | 16 | 32 | 64),
                    };
                    if !allowed {
                        return Err(DescriptorError::PacketSize);
                    }
                    let class = self.interfaces.last().map_or(0, |interface| interface[1]);
                    self.endpoints.push(Endpoint { address, is_bulk: kind == BULK, packet, class });
                }
                [_, 2 | 4 | 5, ..] => return Err(DescriptorError::Short),
                _ => {}
            }
        }
        if self.interfaces.len() == promised { Ok(()) } else { Err(DescriptorError::Interfaces) }
    }

    /// The serial port's pair of bulk endpoints: OUT, IN.
    pub fn serial_endpoints(&self) -> Result<(u8, u8), DescriptorError> {
        const CDC_DATA: u8 = 10;
        let bulk = |to_host: bool| {
            let mut data = self.endpoints.iter().filter(|end| end.class == CDC_DATA && end.is_bulk);
            data.find(|end| (end.address & 0x80 != 0) == to_host).map(|end| end.address & 0xF)
        };
        bulk(false).zip(bulk(true)).ok_or(DescriptorError::NotSerial)
    }
}

/// Total length of a configuration with all its descriptors, from its first bytes.
pub fn total_length(head: &[u8]) -> Result<u16, DescriptorError> {
    match *head {
        [9, 2, low, high, ..] => Ok(u16::from_le_bytes([low, high])),
        [_, _, _, _, ..] => Err(DescriptorError::Kind),
        _ => Err(DescriptorError::Short),
    }
}

/// Maximum packet size of endpoint 0, from the device descriptor (USB 2.0 9.6.1, bMaxPacketSize0).
pub fn control_packet(device: &[u8]) -> Result<usize, DescriptorError> {
    match *device {
        [18, 1, _, _, _, _, _, size @ (8 | 16 | 32 | 64), ..] => Ok(size.into()),
        [_, _, _, _, _, _, _, _, ..] => Err(DescriptorError::Kind),
        _ => Err(DescriptorError::Short),
    }
}

/// The first language of the device's strings.
pub fn first_language(bytes: &[u8]) -> Result<u16, DescriptorError> {
    match *bytes {
        [length, 3, low, high, ..] if usize::from(length) == bytes.len() => Ok(u16::from_le_bytes([low, high])),
        _ => Err(DescriptorError::Short),
    }
}

/// The text of a string descriptor.
pub fn string(bytes: &[u8]) -> Result<String, DescriptorError> {
    let [length, 3, text @ ..] = bytes else { return Err(DescriptorError::Kind) };
    if usize::from(*length) != bytes.len() || text.len() % 2 != 0 {
        return Err(DescriptorError::Short);
    }
    let units: Vec<u16> = text.as_chunks().0.iter().copied().map(u16::from_le_bytes).collect();
    String::from_utf16(&units).map_err(|_| DescriptorError::Text)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEVICE: [u8; 18] = [18, 1, 0x10, 2, 0xEF, 2, 1, 64, 9, 0x12, 1, 0, 0, 1, 1, 2, 3, 1];

    fn configuration() -> Vec<u8> {
        let mut bytes = vec![9, 2, 0, 0, 1, 1, 0, 0x80, 50];
        bytes.extend([9, 4, 0, 0, 2, 10, 0, 0, 0]);
        bytes.extend([7, 5, 0x02, 2, 64, 0, 0]);
        bytes.extend([7, 5, 0x81, 2, 64, 0, 0]);
        bytes[2] = bytes.len() as u8;
        bytes
    }

    #[test]
    fn a_device_is_described_by_its_descriptors() {
        let description = Description::parse(&DEVICE, &configuration()).expect("valid descriptors");
        assert_eq!((description.vendor, description.product_number, description.current_ma), (0x1209, 1, 100));
        assert_eq!(description.serial_endpoints(), Ok((2, 1)));
        assert_eq!(description.interfaces, [[0, 10, 0, 0]]);
    }

    #[test]
    fn wrong_descriptors_are_told_apart() {
        let wrong = |at: usize, value: u8| {
            let mut bytes = configuration();
            bytes[at] = value;
            Description::parse(&DEVICE, &bytes).err()
        };
        assert_eq!(wrong(4, 2), Some(DescriptorError::Interfaces));
        assert_eq!(wrong(2, 40), Some(DescriptorError::Short));
        assert_eq!(wrong(9, 0), Some(DescriptorError::Short));
        assert_eq!(wrong(9, 200), Some(DescriptorError::Short));
        assert_eq!(wrong(18 + 4, 63), Some(DescriptorError::PacketSize));
        assert_eq!(Description::parse(&DEVICE[..17], &configuration()), Err(DescriptorError::Short));
    }

    #[test]
    fn strings_are_utf_16() {
        assert_eq!(string(&[6, 3, b'h', 0, b'i', 0]), Ok("hi".into()));
        assert_eq!(string(&[6, 3, b'h', 0, b'i']), Err(DescriptorError::Short));
        assert_eq!(string(&[4, 3, 0, 0xD8]), Err(DescriptorError::Text));
        assert_eq!(first_language(&[4, 3, 9, 4]), Ok(0x409));
    }
}
