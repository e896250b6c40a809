//! Raw samples of a device, with the host's time of their arrival.

use std::time::{Duration, Instant};

use inerter_analysis::calibrate::timebase::Arrival;
use inerter_core::RawSample;
use inerter_data::run::Run;
use inerter_device::{Device, DeviceError};
use inerter_wire::{EventKind, Frame, Record, Streams, step};

use super::dialogue::Dialogue;
use crate::error::Error;

/// A sampling device sends a new sample within this time.
const SILENCE: Duration = Duration::from_secs(5);

/// What a device sent.
#[derive(Clone, Debug, Default)]
pub struct Heard {
    /// The samples, with the settings of the device.
    pub run: Run,
    /// When the batches arrived.
    pub arrivals: Vec<Arrival>,
}

/// Passes on a device's raw samples with their arrival times until `take` has enough. Only samples are streamed
/// meanwhile, and nothing afterwards.
pub fn each_batch(
    device: &mut Device,
    mut take: impl FnMut(u64, Vec<RawSample>) -> Result<bool, Error>,
) -> Result<(), Error> {
    device.stream(Streams { samples: true, ..Streams::NONE })?;
    let result = batches(device, &mut take);
    // Also if the rest fails: a device must not keep streaming with nobody reading.
    let ended = device.stream(Streams::NONE);
    result?;
    Ok(ended?)
}

fn batches(
    device: &mut Device,
    take: &mut impl FnMut(u64, Vec<RawSample>) -> Result<bool, Error>,
) -> Result<(), Error> {
    device.start_sampler()?;
    // Frames in flight predate the request.
    while device.pending().is_some() {}
    let (mut heard, mut last) = (Instant::now(), None);
    loop {
        let mut samples = Vec::new();
        let mut time_ns = 0;
        if let Some(received) = device.receive()? {
            time_ns = received.time_ns;
            match received.frame {
                Frame::Message { message: Record::Samples(batch), .. } if batch.check().is_ok() => {
                    // A repeated index is not a new sample.
                    let is_new = |sample: &RawSample| last.replace(sample.index) != Some(sample.index);
                    samples.extend(batch.iter().flatten().filter(is_new));
                    if !samples.is_empty() {
                        heard = Instant::now();
                    }
                }
                Frame::Message { message: Record::Event(event), .. } if event.kind == EventKind::SourceEnded => {
                    return Ok(());
                }
                _ => {}
            }
        }
        if take(time_ns, samples)? {
            return Ok(());
        }
        if heard.elapsed() > SILENCE {
            return Err(DeviceError::Silent { name: device.name().into(), seconds: SILENCE.as_secs_f64() }.into());
        }
    }
}

impl Heard {
    /// Everything for this long, counted in samples. `keep_samples` is false for runs of hours.
    pub fn listen(
        device: &mut Device,
        dialogue: &mut dyn Dialogue,
        seconds: f64,
        keep_samples: bool,
    ) -> Result<Self, Error> {
        let settings = *device.settings();
        let mut heard = Self::default();
        let wanted = (seconds * settings.sample_rate_hz).max(1.0);
        let (mut elapsed, mut last) = (0, None);
        each_batch(device, |time_ns, samples| {
            for sample in &samples {
                elapsed += last.replace(sample.index).map_or(0, |last| step(last, sample.index));
            }
            if !samples.is_empty() {
                heard.arrivals.push(Arrival { elapsed, time_ns });
                if keep_samples {
                    heard.run.samples.extend(samples);
                }
            }
            let done = elapsed as f64 / wanted;
            dialogue.progress("listening", done.min(1.0))?;
            Ok(done >= 1.0)
        })?;
        heard.run.settings = settings;
        heard.run.name = device.name().into();
        heard.run.hello = Some(device.hello().clone());
        Ok(heard)
    }
}
