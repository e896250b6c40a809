//! The order of an update: into update mode, write, read back, start, ask who runs.

use std::time::Duration;

use super::{
    dfuse::{self, Going, Stage},
    error::UpdateError,
    machine::{Back, Machine, Running},
};
use crate::{
    board::FLASH_KB,
    dfu::DfuDevice,
    error::DeviceError,
    image::{Identity, Image},
    session::REPLY_TIME,
};
use inerter_wire::Hello;

/// Longest time for a device to come back as another one: Windows takes seconds the first time (s).
const RETURN_S: u64 = 15;
/// The same where somebody wants to end (s).
const SOON_S: u64 = 3;
/// Time between two looks for it.
const LOOK: Duration = Duration::from_millis(250);
/// Attempts to lead a device out of update mode.
const ATTEMPTS: usize = 3;
/// Looks until a missing permission is believed: 2 s.
const PERMISSION_LOOKS: usize = 8;

/// Progress of an update.
#[derive(Debug)]
pub enum UpdateEvent<'a> {
    /// This is what runs now.
    Found(&'a Running),
    /// The device is asked to enter update mode.
    Entering,
    /// This device in update mode takes the image.
    InDfu(&'a DfuDevice),
    /// Pages done of all.
    Pages(Stage, usize, usize),
    /// The image is written and started; the device is waited for.
    Returning,
}

/// Brings the image onto the device. `serial` chooses one; `other_board` allows an image of another board.
pub fn update<M: Machine>(
    machine: &mut M,
    image: &Image,
    serial: Option<&str>,
    other_board: bool,
    tell: &mut dyn FnMut(UpdateEvent) -> Going,
) -> Result<Back, UpdateError> {
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

/// Fails where a device that runs does not take the image.
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

/// Writes the image to a device in update mode and starts it. `is_whole` says whether the firmware that was there
/// before is whole where this fails.
fn write<M: Machine>(
    machine: &mut M,
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

/// Leads a device back that was told to enter update mode, of whose firmware nothing was erased: somebody interrupted
/// that, or the chip turned out to be another. Gives what to tell.
fn given_up<M: Machine>(machine: &mut M, serial: &str, error: UpdateError) -> UpdateError {
    match error {
        UpdateError::Device(DeviceError::Interrupted) => {
            let device = wait_for_dfu(machine, serial, Heeds::Nothing, SOON_S);
            match device.and_then(|device| lead_back(machine, &device, SOON_S)) {
                Ok(()) => error,
                Err(reason) => stays(serial, &reason),
            }
        }
        UpdateError::OtherChip { .. } | UpdateError::SmallFlash { .. } | UpdateError::SingleBank { .. } => {
            // What is wrong with the chip says more than that it stayed there.
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

/// Into update mode and back, without writing anything. `enter` asks the device to go there; otherwise the user puts it
/// there by hand, and this waits for it.
///
/// An interruption ends the wait for the user. Before the device was asked to leave, it does not end anything else, or
/// the device would stay there.
pub fn visit<M: Machine>(machine: &mut M, running: &Hello, enter: bool) -> Result<Back, UpdateError> {
    let stays = |error| stays(&running.serial, &error);
    if enter {
        machine.running()?;
        match machine.enter_dfu() {
            // It may have gone there already.
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

/// Lets a device in update mode start its firmware, which takes it no longer than so many seconds. What fails is tried
/// again while the device is there.
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
        // The first attempt has waited for a permission, or for the device.
        if matches!(result, Ok(()) | Err(UpdateError::Permission { .. } | UpdateError::Stuck { .. })) {
            break;
        }
        machine.sleep(LOOK);
        if !machine.in_dfu()?.contains(device) {
            // It has gone, and where to shows when it is asked who it is.
            return Ok(());
        }
        result = once(machine);
    }
    result
}

/// What ends a wait besides its end.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Heeds {
    Interruptions,
    Nothing,
}

impl Heeds {
    fn check<M: Machine>(self, machine: &M) -> Result<(), UpdateError> {
        // Asked in any case: a program ends at once whose work does not ask.
        let going = machine.check_interrupted();
        if self == Self::Interruptions { going } else { Ok(()) }
    }
}

/// Opens a device that may have appeared a moment ago, which belongs to root until udev has seen it.
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

/// Waits for a device that was just started and compares what it runs with what was written.
pub fn confirm<M: Machine>(machine: &mut M, written: &Identity, serial: &str) -> Result<Back, UpdateError> {
    let mut reason = String::new();
    let mut left_s = RETURN_S as f64;
    while left_s > 0.0 {
        match machine.hello(serial) {
            Ok(back) if back.serial != serial => {
                reason = format!("another device (serial {}) answers at {}", back.serial, back.port);
            }
            Ok(back) if back.identity == *written => return Ok(back),
            Ok(back) => {
                let running = back.identity.to_string();
                return Err(UpdateError::OtherVersion { running, written: written.to_string() });
            }
            Err(error) => {
                // One that does not answer takes its time for it.
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

fn wait_for_dfu<M: Machine>(
    machine: &mut M,
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
