//! The decoded channels of a recording: the frames' contents again, as JSON that PlotJuggler and Foxglove display
//! directly.

use inerter_core::{RawSample, Settings};
use inerter_wire::{Estimated, EstimatorEvent, Frame, Pairing, Record};
use serde::Serialize;

use super::{messages::Framing, samples::Extent};
use crate::{
    json::{EstimateJson, EventJson, ReversalJson, health_json, machine_json, rounded_s},
    series::{Converter, Point},
    text::elapsed_s,
};

/// Averaging time of one message of `motion` \[s\]: it shows a shaker's force and motion, and takes little space.
const MOTION_S: f64 = 0.05;
/// Minimum time between two messages of `reversal`, and of `estimate` \[s\], each of which takes as much space as two
/// hundred samples. The frames hold every one.
const ESTIMATE_S: f64 = 1.0;
const REVERSAL_S: f64 = 0.1;

/// A decoded channel, or that of the markers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Channel {
    Motion,
    Estimate,
    Reversal,
    Event,
    Health,
    Marker,
}

impl Channel {
    /// All of them, each with its topic.
    pub(super) const ALL: [(Self, &'static str); 6] = [
        (Self::Marker, super::MARKER_TOPIC),
        (Self::Motion, "motion"),
        (Self::Estimate, "estimate"),
        (Self::Reversal, "reversal"),
        (Self::Event, "event"),
        (Self::Health, "health"),
    ];
}

/// A message of the channel `motion`; 32 bits are enough for a plot.
#[derive(Serialize)]
struct MotionJson {
    t_s: f64,
    position_m: f32,
    force_n: f32,
    force_min_n: f32,
    force_max_n: f32,
    #[serde(skip_serializing_if = "Option::is_none")]
    terminal_m: Option<f32>,
}

/// A message on a channel.
pub(super) type Decoded = (Channel, Vec<u8>);

/// Decodes frames into messages.
pub(super) struct Decoder {
    framing: Framing,
    settings: Settings,
    clock: Extent,
    converter: Converter,
    motion: Motion,
    pairing: Pairing,
    estimates: Sparse,
    reversals: Sparse,
    /// Messages not handed out yet.
    decoded: Vec<Decoded>,
}

/// Thins out frequent messages.
struct Sparse {
    every_s: f64,
    due_s: f64,
}

impl Sparse {
    fn new(every_s: f64) -> Self {
        Self { every_s, due_s: f64::NEG_INFINITY }
    }

    fn is_due(&mut self, t_s: f64) -> bool {
        let began_anew = t_s < self.due_s - 2.0 * self.every_s;
        // The tenth prevents rounding from skipping one of a steady series.
        let due = t_s + 0.1 * self.every_s >= self.due_s || began_anew;
        if due {
            self.due_s = t_s + self.every_s;
        }
        due
    }
}

impl Decoder {
    /// For frames of a device with these settings.
    pub(super) fn new(settings: &Settings) -> Self {
        Self {
            framing: Framing::default(),
            settings: *settings,
            clock: Extent::default(),
            converter: Converter::new(settings),
            motion: Motion::default(),
            pairing: Pairing::new(),
            estimates: Sparse::new(ESTIMATE_S),
            reversals: Sparse::new(REVERSAL_S),
            decoded: Vec::new(),
        }
    }

    /// Processes the bytes of a message of channel `raw`; returns its contents.
    pub(super) fn take(&mut self, part: u16, bytes: &[u8]) -> Vec<Decoded> {
        let mut framing = std::mem::take(&mut self.framing);
        framing.take(part, bytes, |frame| {
            if let Frame::Message { message, .. } = frame {
                self.record(message);
            }
        });
        self.framing = framing;
        std::mem::take(&mut self.decoded)
    }

    /// An estimate whose detail did not arrive before the end.
    pub(super) fn end(&mut self) -> Vec<Decoded> {
        if let Some(event) = self.pairing.flush() {
            self.event(event);
        }
        std::mem::take(&mut self.decoded)
    }

    fn event(&mut self, event: EstimatorEvent) {
        match event {
            EstimatorEvent::Estimate(estimated) => self.estimate(&estimated),
            EstimatorEvent::Reversal(reversal) => {
                let t_s = self.time_s(reversal.index);
                if t_s.is_none_or(|t_s| self.reversals.is_due(t_s)) {
                    self.put(Channel::Reversal, &ReversalJson::new(t_s, &reversal));
                }
            }
            // Handled like the device's other events.
            EstimatorEvent::Changed(_) | EstimatorEvent::Warned(_) => {}
        }
    }

    fn record(&mut self, record: Record) {
        for event in self.pairing.take(&record) {
            self.event(event);
        }
        match record {
            Record::Samples(batch) if batch.check().is_ok() => {
                batch.iter().flatten().for_each(|sample| self.sample(&sample));
            }
            Record::Event(event) => {
                let t_s = self.time_s(event.index);
                let json = EventJson::new(t_s, event.index, &event.kind, self.settings.machine);
                self.put(Channel::Event, &json);
            }
            Record::Health(health) => self.put(Channel::Health, &health_json(&health)),
            Record::Settings(values) => {
                // The channels keep the names that they started with.
                let settings = Settings { machine: self.settings.machine, ..values.read(&self.settings).settings };
                if settings != self.settings {
                    self.settings = settings;
                    self.converter = Converter::new(&self.settings);
                    self.motion = Motion::default();
                }
            }
            _ => {}
        }
    }

    fn estimate(&mut self, estimated: &Estimated) {
        let t_s = self.time_s(estimated.estimate.index);
        let t_s = t_s.unwrap_or_else(|| elapsed_s(&estimated.estimate, self.settings.sample_rate_hz));
        if self.estimates.is_due(t_s) {
            self.put(Channel::Estimate, &EstimateJson::live(t_s, estimated, &self.settings));
        }
    }

    fn sample(&mut self, sample: &RawSample) {
        let before = self.clock.periods;
        self.clock.take(sample);
        if self.clock.periods > before + 1 {
            self.motion = Motion::default();
        }
        let rate_hz = self.settings.sample_rate_hz;
        self.motion.take(&self.converter.point(sample));
        if f64::from(self.motion.count) >= MOTION_S * rate_hz {
            let motion = std::mem::take(&mut self.motion);
            let middle = self.clock.periods as f64 - 0.5 * f64::from(motion.count - 1);
            self.put(Channel::Motion, &motion.json(middle / rate_hz));
        }
    }

    fn put(&mut self, channel: Channel, json: &impl Serialize) {
        self.decoded.push((channel, machine_json(self.settings.machine, json)));
    }

    /// Time of a sample since the first one \[s\].
    fn time_s(&self, index: u32) -> Option<f64> {
        Some(self.clock.periods_of(index)? as f64 / self.settings.sample_rate_hz)
    }
}

/// Sums over some samples.
#[derive(Default)]
struct Motion {
    count: u32,
    position_m: f64,
    force_n: f64,
    force_range_n: Option<(f64, f64)>,
    terminal_m: Option<f64>,
}

impl Motion {
    fn take(&mut self, point: &Point) {
        let force = point.force_n;
        let (least, greatest) = self.force_range_n.unwrap_or((force, force));
        self.count += 1;
        self.position_m += point.position_m;
        self.force_n += force;
        self.force_range_n = Some((least.min(force), greatest.max(force)));
        self.terminal_m = point.terminal_m.map(|terminal| self.terminal_m.unwrap_or(0.0) + terminal);
    }

    fn json(&self, t_s: f64) -> MotionJson {
        let mean = |sum: f64| (sum / f64::from(self.count)) as f32;
        let (least, greatest) = self.force_range_n.unwrap_or_default();
        MotionJson {
            t_s: rounded_s(t_s),
            position_m: mean(self.position_m),
            force_n: mean(self.force_n),
            force_min_n: least as f32,
            force_max_n: greatest as f32,
            terminal_m: self.terminal_m.map(mean),
        }
    }
}
