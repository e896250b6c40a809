//! The sequence of an update: enter update mode, write, verify, start, identify the running firmware.

use std::time::Duration;

use super::{
    dfuse::{self, Going, Stage},
    error::UpdateError,
    machine::{Machine, Running},
};
use crate::{
    board::FLASH_KB,
    dfu::DfuDevice,
    error::DeviceError,
    image::{Identity, Image},
    session::REPLY_TIME,
};
use inerter_wire::Hello;

/// Longest time for a device to re-enumerate: Windows takes seconds the first time (s).
const RETURN_S: u64 = 15;
/// The same if the user wants to stop (s).
const SOON_S: u64 = 3;
/// Time between two polls for the device.
const LOOK: Duration = Duration::from_millis(250);
/// Attempts to get a device out of update mode.
const ATTEMPTS: usize = 3;
/// Polls before a missing permission is reported: 2 s.
const PERMISSION_LOOKS: usize = 8;

/// Progress of an update.
#[derive(Debug)]
pub enum UpdateEvent<'a> {
    /// The firmware that runs now.
    Found(&'a Running),
    /// The device is asked to enter update mode.
    Entering,
    /// This device in update mode receives the image.
    InDfu(&'a DfuDevice),
    /// Pages done and the total.
    Pages(Stage, usize, usize),
    /// The image is written and started; waiting for the device.
    Returning,
}

/// Installs the image on the device. `serial` chooses one; `other_board` allows an image for another board.
pub fn update(
    machine: &mut impl Machine,
    image: &Image,
    serial: Option<&str>,
    other_board: bool,
    tell: &mut dyn FnMut(UpdateEvent) -> Going,
) -> Result<Running, UpdateError> {
    let device = match machine.running()? {
        Some(running) => {
            let _ = tell(UpdateEvent::Found(&running));
            check_running(&running, image, other_board)?;
            let _ = tell(UpdateEvent::Entering);
            let serial = &running.hello.serial;
            let mut is_whole = true;
            let written = machine
                .enter_dfu()
                .and_then(|()| wait_for_dfu(machine, serial, Heeds::Interruptions, RETURN_S))
                .and_then(|device| write(machine, image, device, &mut is_whole, tell));
            match written {
                Err(error) if is_whole => return Err(given_up(machine, serial, error)),
                written => written?,
            }
        }
        None => {
            let device = only_one(machine.in_dfu()?, serial)?;
            write(machine, image, device, &mut true, tell)?
        }
    };
    let _ = tell(UpdateEvent::Returning);
    confirm(machine, &image.identity, &device.serial)
}

/// Fails if the running device cannot use the image.
fn check_running(running: &Running, image: &Image, other_board: bool) -> Result<(), UpdateError> {
    let Running { name, hello } = running;
    let board = hello.board.as_str();
    if board != image.identity.board && !other_board {
        let image = image.identity.board.clone();
        return Err(UpdateError::OtherBoard { image, device: board.into() });
    }
    if !hello.capabilities.contains(inerter_wire::Capabilities::DFU) {
        return Err(UpdateError::CannotEnter { name: name.clone(), firmware: hello.firmware.to_string() });
    }
    match hello.capabilities.flash_kb() {
        Some(kb) if kb < FLASH_KB => Err(UpdateError::SmallFlash { kb: kb.into() }),
        _ => Ok(()),
    }
}

/// Writes the image to a device in update mode and starts it. On failure `is_whole` says whether the previous firmware
/// is still complete.
fn write(
    machine: &mut impl Machine,
    image: &Image,
    device: DfuDevice,
    is_whole: &mut bool,
    tell: &mut dyn FnMut(UpdateEvent) -> Going,
) -> Result<DfuDevice, UpdateError> {
    let _ = tell(UpdateEvent::InDfu(&device));
    let io = open(machine, &device, Heeds::Interruptions)?;
    let mut sleep = |time| {
        machine.sleep(time);
        if machine.check_interrupted().is_ok() { Going::On } else { Going::Stop }
    };
    let mut progress = |stage, done, all| tell(UpdateEvent::Pages(stage, done, all));
    let mut rom = dfuse::Rom::new(&io, &mut sleep);
    let written = rom.program(image, &mut progress);
    *is_whole = rom.is_whole();
    written.map(|()| device)
}

/// Gets a device out of update mode when nothing of its firmware was erased: the user interrupted, or the chip turned
/// out to be another. Returns the error to report.
fn given_up(machine: &mut impl Machine, serial: &str, error: UpdateError) -> UpdateError {
    match error {
        UpdateError::Device(DeviceError::Interrupted) => {
            let device = wait_for_dfu(machine, serial, Heeds::Nothing, SOON_S);
            match device.and_then(|device| lead_back(machine, &device, SOON_S)) {
                Ok(()) => error,
                Err(reason) => stays(serial, &reason),
            }
        }
        UpdateError::OtherChip { .. } | UpdateError::SmallFlash { .. } | UpdateError::SingleBank { .. } => {
            // The fault of the chip matters more than that it stayed in update mode.
            let devices = machine.in_dfu().unwrap_or_default();
            if let Some(device) = devices.iter().find(|device| device.serial == serial) {
                let _ = lead_back(machine, device, RETURN_S);
            }
            error
        }
        error => error,
    }
}

fn stays(serial: &str, reason: &UpdateError) -> UpdateError {
    UpdateError::StaysInDfu { serial: serial.into(), reason: reason.to_string() }
}

/// Enters update mode and returns, without writing anything. With `enter` the device is told to enter it; otherwise the
/// user puts it there by hand, and this waits for it.
///
/// An interrupt ends the wait for the user. It does not end anything else until the device was told to leave, because
/// the device would stay in update mode.
pub fn visit(machine: &mut impl Machine, running: &Hello, enter: bool) -> Result<Running, UpdateError> {
    let stays = |error| stays(&running.serial, &error);
    if enter {
        machine.running()?;
        match machine.enter_dfu() {
            // The device may already have entered update mode.
            Ok(()) | Err(UpdateError::Device(DeviceError::Interrupted)) => {}
            Err(error) => return Err(error),
        }
    }
    let heeds = if enter { Heeds::Nothing } else { Heeds::Interruptions };
    let device = wait_for_dfu(machine, &running.serial, heeds, RETURN_S);
    let device = if enter { device.map_err(stays)? } else { device? };
    lead_back(machine, &device, RETURN_S).map_err(stays)?;
    match confirm(machine, &Identity::from(running), &device.serial) {
        Err(UpdateError::NotBack { serial, seconds, reason, .. }) => {
            let reason = format!("it did not come back within {seconds} s: {reason}");
            Err(UpdateError::StaysInDfu { serial, reason })
        }
        result => result,
    }
}

/// Makes a device in update mode start its firmware, within this many seconds. Retries a failure while the device is
/// there.
fn lead_back<M: Machine>(machine: &mut M, device: &DfuDevice, seconds: u64) -> Result<(), UpdateError> {
    let mut left = Duration::from_secs(seconds);
    let mut once = |machine: &mut M| {
        let io = open(machine, device, Heeds::Nothing)?;
        let mut sleep = |time| {
            machine.sleep(time);
            left = left.saturating_sub(time);
            let _ = Heeds::Nothing.check(machine);
            if left.is_zero() { Going::Stop } else { Going::On }
        };
        match dfuse::Rom::new(&io, &mut sleep).start() {
            Err(_) if left.is_zero() => {
                let (action, state) = ("starting the firmware".into(), "busy".into());
                Err(UpdateError::Stuck { action, seconds, state })
            }
            result => result,
        }
    };
    let mut result = once(machine);
    for _ in 1..ATTEMPTS {
        // The first attempt has already waited for the permission or the device.
        if matches!(result, Ok(()) | Err(UpdateError::Permission { .. } | UpdateError::Stuck { .. })) {
            break;
        }
        machine.sleep(LOOK);
        if !machine.in_dfu()?.contains(device) {
            // The device has gone; asking for its identity shows where to.
            return Ok(());
        }
        result = once(machine);
    }
    result
}

/// What can end a wait early.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Heeds {
    Interruptions,
    Nothing,
}

impl Heeds {
    fn check(self, machine: &impl Machine) -> Result<(), UpdateError> {
        // Checked in any case: the program is ended at once if its work never checks.
        let going = machine.check_interrupted();
        if self == Self::Interruptions { going } else { Ok(()) }
    }
}

/// Opens a device that may just have appeared and belongs to root until udev has processed it.
fn open<M: Machine>(machine: &mut M, device: &DfuDevice, heeds: Heeds) -> Result<M::Io, UpdateError> {
    for _ in 0..PERMISSION_LOOKS {
        match machine.open(device) {
            Err(UpdateError::Permission { .. }) => {
                heeds.check(machine)?;
                machine.sleep(LOOK);
            }
            result => return result,
        }
    }
    machine.open(device)
}

/// Waits for a device that was just started and compares its firmware with what was written.
pub fn confirm(machine: &mut impl Machine, written: &Identity, serial: &str) -> Result<Running, UpdateError> {
    let mut reason = String::new();
    let mut left_s = RETURN_S as f64;
    while left_s > 0.0 {
        match machine.hello(serial) {
            Ok(Running { name, hello }) if hello.serial.as_str() != serial => {
                reason = format!("another device (serial {}) answers at {name}", hello.serial);
            }
            Ok(back) if Identity::from(&back.hello) == *written => return Ok(back),
            Ok(back) => {
                let running = Identity::from(&back.hello).to_string();
                return Err(UpdateError::OtherVersion { running, written: written.to_string() });
            }
            Err(error) => {
                // The time that an unanswered attempt took counts too.
                left_s -= match &error {
                    UpdateError::Device(DeviceError::Silent { seconds, .. }) => *seconds,
                    UpdateError::Device(DeviceError::NoReply { .. }) => REPLY_TIME.as_secs_f64(),
                    _ => 0.0,
                };
                reason = error.to_string();
            }
        }
        left_s -= LOOK.as_secs_f64();
        machine.check_interrupted()?;
        machine.sleep(LOOK);
    }
    Err(UpdateError::NotBack { written: written.to_string(), serial: serial.into(), seconds: RETURN_S, reason })
}

fn wait_for_dfu(
    machine: &mut impl Machine,
    serial: &str,
    heeds: Heeds,
    seconds: u64,
) -> Result<DfuDevice, UpdateError> {
    let mut others = Vec::new();
    for _ in 0..seconds * 1000 / LOOK.as_millis() as u64 {
        heeds.check(machine)?;
        machine.sleep(LOOK);
        let devices = machine.in_dfu()?;
        if let Some(device) = devices.iter().find(|device| device.serial == serial) {
            return Ok(device.clone());
        }
        others = devices.into_iter().map(|device| device.serial).collect();
    }
    Err(UpdateError::DidNotAppear { serial: serial.into(), seconds, others })
}

fn only_one(devices: Vec<DfuDevice>, serial: Option<&str>) -> Result<DfuDevice, UpdateError> {
    let mut matching = devices.into_iter().filter(|device| serial.is_none_or(|serial| device.serial == serial));
    let first = matching.next().ok_or_else(|| UpdateError::NoDevice { serial: serial.map(str::to_string) })?;
    let more: Vec<String> = matching.map(|device| device.serial).collect();
    if more.is_empty() {
        return Ok(first);
    }
    Err(UpdateError::Several { serials: std::iter::once(first.serial).chain(more).collect::<Vec<_>>().join(", ") })
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
