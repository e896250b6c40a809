//! Receives from a device while it is connected, and waits for it while it is not.

use std::time::{Duration, Instant};

use inerter_wire::{Refusal, Streams};

use crate::{
    error::DeviceError,
    link::Target,
    session::{Clock, Device, Interrupted, Received},
};

/// Pause between two attempts to reach a device that went away.
const RETRY: Duration = Duration::from_millis(300);
/// A device sends something every second, so silence this long means that it is gone.
const SILENCE: Duration = Duration::from_secs(5);

/// What happened on the link.
#[derive(Debug)]
pub enum LinkEvent {
    /// A received frame or a loss.
    Received(Box<Received>),
    /// Nothing for the moment.
    Quiet,
    /// The device went away; attempts to reach it continue.
    Away {
        /// Why, for a person.
        reason: String,
    },
    /// The device is back.
    Back,
}

/// A device with its stream.
pub struct Live {
    target: Target,
    streams: Streams,
    wait: Duration,
    clock: Clock,
    interrupted: Interrupted,
    state: State,
    /// Whether another program controlled the device when this one connected.
    looks_on: bool,
    /// Frames lost on the links before this one.
    lost_before: u64,
}

enum State {
    Here { device: Box<Device>, heard: Instant },
    Away { since: Instant, tried: Instant, error: Option<DeviceError> },
}

impl Live {
    /// Connects and switches the streams on. If the device later goes away, waits up to `wait` for it. Ends as
    /// [`Device::connect`] does if `interrupted`.
    pub fn connect(
        target: Target,
        streams: Streams,
        wait: Duration,
        interrupted: Interrupted,
    ) -> Result<Self, DeviceError> {
        let clock = Clock::new();
        let (device, controls) = open(&target, streams, clock, interrupted)?;
        let device = Box::new(device);
        let (target, state) = (target.known(&device.hello().serial), State::Here { device, heard: Instant::now() });
        Ok(Self { target, streams, wait, clock, interrupted, state, looks_on: !controls, lost_before: 0 })
    }

    /// The device, while it is connected.
    pub fn device(&self) -> Option<&Device> {
        match &self.state {
            State::Here { device, .. } => Some(device),
            State::Away { .. } => None,
        }
    }

    /// The device, for requests, while it is connected.
    pub fn device_mut(&mut self) -> Option<&mut Device> {
        match &mut self.state {
            State::Here { device, .. } => Some(device),
            State::Away { .. } => None,
        }
    }

    /// Whether another program controlled the device when this one connected: the device then refuses requests.
    pub fn looks_on(&self) -> bool {
        self.looks_on
    }

    /// Host time now, on the same clock as the received frames \[ns\].
    pub fn now_ns(&self) -> u64 {
        self.clock.now_ns()
    }

    /// Frames lost or damaged in transit so far.
    pub fn lost_frames(&self) -> u64 {
        self.lost_before + self.device().map_or(0, lost)
    }

    /// The next event; an error once the device has stayed away too long or cannot come back.
    #[allow(clippy::should_implement_trait, reason = "it ends by an error, not by None")]
    pub fn next(&mut self) -> Result<LinkEvent, DeviceError> {
        match &mut self.state {
            State::Here { device, heard } => {
                let error = match device.receive() {
                    Ok(Some(received)) => {
                        *heard = Instant::now();
                        return Ok(LinkEvent::Received(Box::new(received)));
                    }
                    Ok(None) if heard.elapsed() < SILENCE => return Ok(LinkEvent::Quiet),
                    Ok(None) => DeviceError::Silent { name: device.name().into(), seconds: SILENCE.as_secs_f64() },
                    Err(error) => error,
                };
                self.lost_before += lost(device);
                if !error.may_come_back() || self.wait.is_zero() {
                    return Err(error);
                }
                let reason = error.to_string();
                self.state = State::Away { since: Instant::now(), tried: Instant::now(), error: Some(error) };
                Ok(LinkEvent::Away { reason })
            }
            State::Away { since, tried, error } => {
                if since.elapsed() > self.wait
                    && let Some(error) = error.take()
                {
                    return Err(error);
                }
                if tried.elapsed() < RETRY {
                    std::thread::sleep(Duration::from_millis(20));
                    return Ok(LinkEvent::Quiet);
                }
                match open(&self.target, self.streams, self.clock, self.interrupted) {
                    Ok((device, controls)) => {
                        self.looks_on = !controls;
                        self.state = State::Here { device: Box::new(device), heard: Instant::now() };
                        Ok(LinkEvent::Back)
                    }
                    // The caller requested the interrupt and checks for it.
                    Err(DeviceError::Interrupted) => Ok(LinkEvent::Quiet),
                    Err(error) if !error.may_come_back() => Err(error),
                    Err(_) => {
                        *tried = Instant::now();
                        Ok(LinkEvent::Quiet)
                    }
                }
            }
        }
    }
}

/// The device, and whether this program controls it.
fn open(
    target: &Target,
    streams: Streams,
    clock: Clock,
    interrupted: Interrupted,
) -> Result<(Device, bool), DeviceError> {
    let mut device = Device::connect(target, clock, interrupted)?;
    device.stream(streams)?;
    match device.start_sampler() {
        // The program that controls the device decides whether its sampler runs.
        Err(DeviceError::Refused { refusal: Refusal::Busy, .. }) => Ok((device, false)),
        Err(error) => Err(error),
        Ok(()) => Ok((device, true)),
    }
}

fn lost(device: &Device) -> u64 {
    u64::from(device.counts().lost)
}
