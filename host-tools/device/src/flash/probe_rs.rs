//! Debug probes through probe-rs.

use std::{collections::HashMap, error::Error};

use ::probe_rs::{
    MemoryInterface, Permissions, Session,
    config::Registry,
    flashing::{DownloadOptions, FlashProgress, ProgressEvent, ProgressOperation},
    probe::{
        DebugProbeInfo, DebugProbeSelector,
        list::{Accessibility, Lister},
    },
};

use super::{FlashError, Probe, Probes, Work, probe::ChipFacts};
use crate::{
    board::{CHIP, CHIP_DEVICE_ID_ADDRESS, FLASH_KB_ADDRESS, OPTIONS_ADDRESS, UID_ADDRESS, serial_number},
    image::Image,
};

/// The probes of this machine.
pub struct Attached;

impl Probes for Attached {
    fn list(&mut self) -> Result<Vec<Probe>, FlashError> {
        let items = Lister::new().list_all_with_access();
        let probe = |info: &DebugProbeInfo, accessible| Probe {
            name: info.identifier.clone(),
            vid: info.vendor_id,
            pid: info.product_id,
            serial: info.serial_number.clone(),
            accessible,
        };
        Ok(items.iter().map(|item| probe(&item.info, item.accessibility == Accessibility::Accessible)).collect())
    }

    fn program(
        &mut self,
        probe: &Probe,
        chip: &str,
        image: &Image,
        progress: &mut dyn FnMut(Work, u64, u64),
    ) -> Result<String, FlashError> {
        // Looked up first, so that a wrong name is not mistaken for a wiring fault.
        let unknown = |error: &dyn Error| FlashError::Chip { chip: chip.into(), reason: reason(error) };
        Registry::from_builtin_families().get_target_by_name(chip).map_err(|error| unknown(&error))?;
        let mut session = attach(probe, chip)?;
        if chip == CHIP {
            let mut core = session.core(0).map_err(failed)?;
            let mut word = |address| core.read_word_32(address).map_err(failed);
            let device = word(CHIP_DEVICE_ID_ADDRESS)? & 0xFFF;
            let (flash_kb, options) = (word(FLASH_KB_ADDRESS)? as u16, word(OPTIONS_ADDRESS)?);
            ChipFacts { device, flash_kb, options }.check()?;
        }
        let mut loader = session.target().flash_loader();
        for (address, bytes) in image.pages() {
            loader.add_data(address.into(), bytes).map_err(failed)?;
        }
        let mut options = DownloadOptions::new();
        options.verify = true;
        options.progress = bars(progress);
        loader.commit(&mut session, options).map_err(failed)?;
        let mut core = session.core(0).map_err(failed)?;
        let mut uid = [0; 3];
        core.read_32(UID_ADDRESS, &mut uid).map_err(failed)?;
        core.reset().map_err(failed)?;
        Ok(serial_number(uid))
    }
}

fn failed(error: impl Error) -> FlashError {
    FlashError::Program { reason: reason(&error) }
}

fn attach(probe: &Probe, chip: &str) -> Result<Session, FlashError> {
    let selector = DebugProbeSelector {
        vendor_id: probe.vid,
        product_id: probe.pid,
        interface: None,
        serial_number: probe.serial.clone(),
    };
    let open = || {
        let opened = Lister::new().open(selector.clone());
        opened.map_err(|error| FlashError::Open { probe: probe.to_string(), reason: reason(&error) })
    };
    match open()?.attach(chip, Permissions::default()) {
        Ok(session) => Ok(session),
        // Firmware in deep sleep, or that uses the debug pins, can be reached only under reset.
        Err(first) => open()?
            .attach_under_reset(chip, Permissions::default())
            .map_err(|_| FlashError::Attach { probe: probe.to_string(), reason: reason(&first) }),
    }
}

/// Adds up probe-rs's progress messages.
fn bars<'a>(progress: &'a mut dyn FnMut(Work, u64, u64)) -> FlashProgress<'a> {
    let mut done: HashMap<&'static str, (u64, u64)> = HashMap::new();
    FlashProgress::new(move |event| {
        let (operation, add) = match event {
            ProgressEvent::AddProgressBar { operation, total } => {
                if let Some((key, _)) = work(operation) {
                    done.insert(key, (0, total.unwrap_or(0)));
                }
                return;
            }
            ProgressEvent::Progress { operation, size, .. } => (operation, size),
            _ => return,
        };
        let Some((key, work)) = work(operation) else { return };
        let entry = done.entry(key).or_default();
        entry.0 += add;
        progress(work, entry.0, entry.1.max(entry.0));
    })
}

fn work(operation: ProgressOperation) -> Option<(&'static str, Work)> {
    match operation {
        ProgressOperation::Fill => None,
        ProgressOperation::Erase => Some(("erase", Work::Erasing)),
        ProgressOperation::Program => Some(("program", Work::Writing)),
        ProgressOperation::Verify => Some(("verify", Work::Checking)),
    }
}

/// An error with its chain of causes.
fn reason(error: &dyn Error) -> String {
    let mut words = error.to_string().trim_end_matches('.').to_string();
    let mut source = error.source();
    while let Some(inner) = source {
        let inner_words = inner.to_string();
        let inner_words = inner_words.trim_end_matches('.');
        if !words.ends_with(inner_words) {
            words = format!("{words}: {inner_words}");
        }
        source = inner.source();
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_boards_chip_is_known_and_its_flash_has_the_pages_that_we_count_on() {
        let target = Registry::from_builtin_families().get_target_by_name(CHIP).unwrap();
        let algorithm = target.flash_algorithms.iter().find(|algorithm| {
            let flash = &algorithm.flash_properties.address_range;
            flash.contains(&u64::from(crate::board::CODE.start))
                && flash.contains(&(u64::from(crate::board::SETTINGS.end) - 1))
        });
        let sectors = &algorithm.unwrap().flash_properties.sectors;
        assert_eq!(sectors.iter().map(|sector| sector.size).collect::<Vec<_>>(), [u64::from(crate::board::PAGE)]);
    }

    #[test]
    fn progress_is_added_up_for_each_kind_of_work() {
        let mut heard = Vec::new();
        let mut progress = |work, done, all| heard.push((work, done, all));
        let mut bars = bars(&mut progress);
        let time = std::time::Duration::ZERO;
        for (operation, total) in [(ProgressOperation::Erase, Some(4096)), (ProgressOperation::Program, None)] {
            bars.emit(ProgressEvent::AddProgressBar { operation, total });
        }
        for (operation, size) in [
            (ProgressOperation::Erase, 2048),
            (ProgressOperation::Fill, 2048),
            (ProgressOperation::Program, 1024),
            (ProgressOperation::Erase, 2048),
        ] {
            bars.emit(ProgressEvent::Progress { operation, size, time });
        }
        drop(bars);
        assert_eq!(heard, [(Work::Erasing, 2048, 4096), (Work::Writing, 1024, 1024), (Work::Erasing, 4096, 4096)]);
    }
}
