//! A debug probe, and the operations that programming needs.

use super::error::FlashError;
#[cfg(any(feature = "probe", test))]
use crate::board::{CHIP_DEVICE_ID, FLASH_KB};
use crate::image::Image;

/// A debug probe that is plugged in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Probe {
    /// Its product name.
    pub name: String,
    /// USB vendor ID.
    pub vid: u16,
    /// USB product ID.
    pub pid: u16,
    /// Its serial number.
    pub serial: Option<String>,
    /// Whether this user may open it.
    pub accessible: bool,
}

impl Probe {
    /// The text that selects it with `--probe`.
    pub fn selector(&self) -> String {
        let serial = self.serial.as_ref().map(|serial| format!(":{serial}")).unwrap_or_default();
        format!("{:04x}:{:04x}{serial}", self.vid, self.pid)
    }

    /// Whether this `--probe` text selects it: VID:PID, VID:PID:SERIAL or SERIAL.
    pub(super) fn matches(&self, words: &str) -> bool {
        let numbers = format!("{:04x}:{:04x}", self.vid, self.pid);
        let serial = self.serial.as_deref().unwrap_or_default();
        [numbers, self.selector(), serial.to_string()].iter().any(|name| name.eq_ignore_ascii_case(words))
    }
}

impl std::fmt::Display for Probe {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({})", self.name, self.selector())
    }
}

/// The operation in progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Work {
    /// Pages are erased.
    Erasing,
    /// Pages are written.
    Writing,
    /// Pages are read back.
    Checking,
}

/// Access to probes.
pub trait Probes {
    /// The connected probes.
    fn list(&mut self) -> Result<Vec<Probe>, FlashError>;
    /// Writes the image, verifies it and starts it; `progress` gets the bytes done and the total. Returns the chip's
    /// serial number. Nothing is written to a chip that is not the board's.
    fn program(
        &mut self,
        probe: &Probe,
        chip: &str,
        image: &Image,
        progress: &mut dyn FnMut(Work, u64, u64),
    ) -> Result<String, FlashError>;
}

/// What a probe reads from a chip before it changes anything.
#[cfg(any(feature = "probe", test))]
#[derive(Clone, Copy, Debug)]
pub(super) struct ChipFacts {
    /// Device number.
    pub(super) device: u32,
    /// Flash in KB.
    pub(super) flash_kb: u16,
    /// FLASH_OPTR.
    pub(super) options: u32,
}

#[cfg(any(feature = "probe", test))]
impl ChipFacts {
    /// Checks that the board's firmware can run there.
    pub(super) fn check(self) -> Result<(), FlashError> {
        let is_set = |bit: u32| self.options >> bit & 1 != 0;
        let (dbank, nswboot0, nboot0) = (is_set(22), is_set(26), is_set(27));
        if self.device != CHIP_DEVICE_ID {
            Err(FlashError::OtherChip { found: self.device, wanted: CHIP_DEVICE_ID })
        } else if self.flash_kb < FLASH_KB {
            Err(FlashError::SmallFlash { kb: self.flash_kb })
        } else if !dbank {
            Err(FlashError::SingleBank)
        } else if !nswboot0 && !nboot0 {
            Err(FlashError::NoStart)
        } else {
            Ok(())
        }
    }
}
