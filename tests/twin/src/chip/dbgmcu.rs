//! Debug support of the chip (RM0440 section 47.6): the device ID. The freeze bits are storage.

use crate::Storage;

/// Category 3 devices of the G4, revision X (RM0440 47.6.1).
const IDCODE: u32 = 0x2003_6469;

/// The DBGMCU registers: IDCODE, CR, APB1FZR1, APB1FZR2, APB2FZR.
pub fn registers() -> Storage {
    Storage::shared(&[
        (0x00, IDCODE, 0),
        (0x04, 0, 0xe7),
        (0x08, 0, 0xc060_1c3f),
        (0x0c, 0, 0x2),
        (0x10, 0, 0x3c17_2800),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::{read, write};

    #[test]
    fn identity_cannot_be_changed() {
        let mut dbgmcu = registers();
        write(&mut dbgmcu, 0, 0, 0);
        assert_eq!(read(&mut dbgmcu, 0, 0), IDCODE);
    }
}
