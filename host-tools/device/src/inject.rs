//! Sends samples through the estimator of a connected device.

use std::{collections::VecDeque, time::Duration};

use inerter_core::{RawSample, Settings};
use inerter_wire::{
    Capabilities, Command, Done, Estimated, EstimatorEvent, EventKind, Frame, Pairing, Record, Refusal, Samples,
    Source, Streams, step,
};

use crate::{
    error::DeviceError,
    session::{Device, Received},
};

/// Maximum requests in flight; more would wait in the device's receive buffer.
const WINDOW: usize = 4;
/// Events after an estimate and before the next one; our devices send a few.
const MOST_LATER: usize = 1000;
/// Time for the reply to a batch.
const REPLY_TIME: Duration = Duration::from_secs(10);
/// Time for the device to process its queue at the end.
const END_TIME: Duration = Duration::from_secs(30);

/// What is sent: samples in order, the settings that they were taken with, and the time of the first one \[s\].
#[derive(Clone, Copy, Debug)]
pub struct Injection<'a> {
    /// Settings for the device while it takes the samples.
    pub settings: &'a Settings,
    /// The samples; a jump of the index is a discontinuity.
    pub samples: &'a [RawSample],
    /// Time of the first sample \[s\].
    pub start_s: f64,
}

/// The result of an injection.
#[derive(Clone, Copy, Debug)]
pub struct Injected {
    /// Time of the last sample \[s\].
    pub t_s: f64,
    /// The device's final estimate.
    pub estimated: Estimated,
    /// Samples that the device accepted.
    pub samples: u64,
}

/// Sends settings and samples; `publish` gets everything that the device's estimator reports, `progress` the number of
/// samples accepted. An error from either ends the injection.
///
/// The device's own settings are restored afterwards, whether or not everything succeeded.
pub fn inject<E: From<DeviceError>>(
    device: &mut Device,
    injection: &Injection,
    publish: impl FnMut(f64, &EstimatorEvent) -> Result<(), E>,
    progress: impl FnMut(u64) -> Result<(), E>,
) -> Result<Injected, E> {
    if !device.hello().capabilities.contains(Capabilities::INJECT) {
        let (name, what) = (device.name().to_string(), "to take samples over the link");
        return Err(DeviceError::Refused { name, what, refusal: Refusal::Unsupported }.into());
    }
    let before = *device.settings();
    device.stream(Streams { estimates: true, ..Streams::NONE })?;
    let prepared = device.write_settings(injection.settings).and_then(|()| halt(device));
    let result = prepared.map_err(E::from).and_then(|()| {
        let (times, begun) = (Times::new(injection), Begun::No);
        let (pairing, last, later) = (Pairing::new(), None, Vec::new());
        Sending { device: &mut *device, injection, publish, progress, times, begun, pairing, last, later }.all()
    });
    // The original failure matters more than whether the settings could be restored after it. After a failure it is
    // unknown whether the device had accepted the run's settings.
    let known = if result.is_ok() { Ok(()) } else { device.read_settings() };
    let restored = known.and_then(|()| device.write_settings(&before));
    let started = device.start_sampler();
    let injected = result?;
    restored.and(started)?;
    Ok(injected)
}

/// Stops the device's present source of samples, including an injection that was broken off.
fn halt(device: &mut Device) -> Result<(), DeviceError> {
    let has_sampler = device.hello().capabilities.contains(Capabilities::SAMPLER);
    let command = if has_sampler { Command::Stop } else { Command::InjectEnd };
    match device.request("to halt its sampler", command) {
        Err(DeviceError::Refused { refusal: Refusal::NotInjecting, .. }) | Ok(_) => Ok(()),
        Err(error) => Err(error),
    }
}

/// Whether the device's estimates belong to our samples yet: they do once it has switched to the link and restarted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Begun {
    No,
    Changed,
    Yes,
}

struct Sending<'a, P, G> {
    device: &'a mut Device,
    injection: &'a Injection<'a>,
    publish: P,
    progress: G,
    times: Times<'a>,
    begun: Begun,
    pairing: Pairing,
    /// The latest estimate: the last one of all is the final one, which goes to the caller.
    last: Option<Estimated>,
    /// Events that came after it.
    later: Vec<EstimatorEvent>,
}

impl<E: From<DeviceError>, P: FnMut(f64, &EstimatorEvent) -> Result<(), E>, G: FnMut(u64) -> Result<(), E>>
    Sending<'_, P, G>
{
    fn all(mut self) -> Result<Injected, E> {
        let mut left = self.injection.samples;
        let mut under_way: VecDeque<(u16, usize)> = VecDeque::new();
        let (mut credit, mut taken) = (None, 0u64);
        loop {
            // The first batch is sent alone: its reply states how much room there is.
            while under_way.len() < WINDOW && !left.is_empty() && (credit.is_some() || under_way.is_empty()) {
                let (batch, count) = Samples::from_slice(left);
                if credit.is_some_and(|credit| credit < count) && !under_way.is_empty() {
                    break;
                }
                let id = self.device.send(Command::Inject(batch))?;
                under_way.push_back((id, count));
                credit = credit.map(|credit: usize| credit.saturating_sub(count));
                left = left.get(count..).unwrap_or_default();
            }
            let Some((id, count)) = under_way.front().copied() else { break };
            let done = self.reply(id)?;
            under_way.pop_front();
            // The reply to the first batch follows the events that announce the switch, in case those were lost.
            self.begun = Begun::Yes;
            taken += count as u64;
            (self.progress)(taken)?;
            if let Done::Injected { free, .. } = done {
                let on_the_way: usize = under_way.iter().map(|(_, count)| count).sum();
                credit = Some(usize::from(free).saturating_sub(on_the_way));
            }
        }
        let done = self.device.request_within("to end the injection", Command::InjectEnd, END_TIME);
        while let Some(received) = self.device.pending() {
            self.take(&received)?;
        }
        if let Some(event) = self.pairing.flush() {
            self.hold(event)?;
        }
        done?;
        let estimated = self
            .last
            .ok_or_else(|| DeviceError::Silent { name: self.device.name().into(), seconds: END_TIME.as_secs_f64() })?;
        let t_s = self.times.of(estimated.estimate.index);
        Ok(Injected { t_s, estimated, samples: taken })
    }

    /// Waits for the reply to `id`, and passes on the estimates that come before it.
    fn reply(&mut self, id: u16) -> Result<Done, E> {
        const WHAT: &str = "to take a batch of samples";
        let started = std::time::Instant::now();
        loop {
            self.device.check_interrupted()?;
            if started.elapsed() > REPLY_TIME {
                return Err(DeviceError::NoReply { name: self.device.name().into(), what: WHAT }.into());
            }
            let Some(received) = self.device.receive()? else { continue };
            if let Some(result) = received.reply_to(id) {
                let name = self.device.name().to_string();
                let refused = |refusal| DeviceError::Refused { name, what: "a batch of samples", refusal };
                return Ok(result.map_err(refused)?);
            }
            self.take(&received)?;
        }
    }

    fn take(&mut self, received: &Received) -> Result<(), E> {
        let Frame::Message { message, .. } = &received.frame else { return Ok(()) };
        if let Record::Event(event) = message {
            match event.kind {
                EventKind::SourceChanged(Source::Link) => self.begun = Begun::Changed,
                EventKind::EstimatorReset if self.begun == Begun::Changed => self.begun = Begun::Yes,
                _ => {}
            }
        }
        if self.begun == Begun::Yes {
            for event in self.pairing.take(message) {
                self.hold(event)?;
            }
        }
        Ok(())
    }

    /// Publishes in the order in which the device sent, but holds the latest estimate back: it may be the final one.
    fn hold(&mut self, event: EstimatorEvent) -> Result<(), E> {
        let EstimatorEvent::Estimate(estimated) = event else {
            if self.last.is_some() {
                if self.later.len() >= MOST_LATER {
                    return Err(DeviceError::Flood { name: self.device.name().into() }.into());
                }
                self.later.push(event);
                return Ok(());
            }
            return (self.publish)(self.times.near(&event), &event);
        };
        if let Some(before) = self.last.replace(estimated) {
            (self.publish)(self.times.of(before.estimate.index), &EstimatorEvent::Estimate(before))?;
        }
        for event in std::mem::take(&mut self.later) {
            (self.publish)(self.times.near(&event), &event)?;
        }
        Ok(())
    }
}

/// Times of the samples by their index, requested in order.
struct Times<'a> {
    injection: &'a Injection<'a>,
    at: usize,
    elapsed: u64,
}

impl<'a> Times<'a> {
    fn new(injection: &'a Injection<'a>) -> Self {
        Self { injection, at: 0, elapsed: 0 }
    }

    fn of(&mut self, index: u32) -> f64 {
        while let Some([this, next]) = self.injection.samples.get(self.at..self.at + 2) {
            if this.index == index {
                break;
            }
            self.elapsed += step(this.index, next.index);
            self.at += 1;
        }
        self.injection.start_s + self.elapsed as f64 / self.injection.settings.sample_rate_hz
    }

    /// Time of an event near the sample that was requested last, before or after it.
    fn near(&self, event: &EstimatorEvent) -> f64 {
        let here = self.injection.samples.get(self.at).map_or(0, |sample| sample.index);
        let after = event.index().wrapping_sub(here).cast_signed();
        self.injection.start_s + (self.elapsed as f64 + f64::from(after)) / self.injection.settings.sample_rate_hz
    }
}
