//! Converts frames into displayable items: samples in SI units, estimates with their details, and the time of each.

use inerter_analysis::diagnose::Cause;
use inerter_core::{Reversal, Settings};
use inerter_data::{
    json::{EstimateJson, EventJson, ReversalJson, health_json, json_line, machine_json_line, rounded_s},
    series::Converter,
    text,
};
use inerter_device::{Device, Received};
use inerter_wire::{Estimated, EstimatorEvent, Event, EventKind, Frame, Health, Hello, Pairing, Record};
use serde_json::json;

/// The time of an item.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moment {
    /// Time since the first item, by the device's clock; continues across restarts of the estimator \[s\].
    pub run_s: f64,
    /// The same as host time since 1970 \[ns\].
    pub unix_ns: u64,
}

/// One sample in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    pub at: Moment,
    /// Force \[N\].
    pub force_n: f64,
    /// Displacement of the screw \[m\].
    pub position_m: f64,
    /// Displacement of the terminal, if there is a sensor \[m\].
    pub terminal_m: Option<f64>,
}

/// Something to display.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    /// The connected device: sent at the beginning and after each reconnection.
    Device {
        /// Port or address.
        port: String,
        hello: Hello,
        /// The settings in use.
        settings: Settings,
    },
    /// The device went away.
    Away {
        /// Why, for a person.
        reason: String,
    },
    /// It is back.
    Back { port: String },
    /// Other settings are in use.
    Settings(Settings),
    /// A batch of samples.
    Samples(Vec<Sample>),
    /// An estimate; its detail is missing if an older firmware does not send it or a bad line lost it.
    Estimate {
        at: Moment,
        /// Time since the estimator started \[s\].
        t_s: f64,
        estimated: Estimated,
    },
    /// An accepted reversal.
    Reversal {
        /// Time since the estimator started, if known \[s\].
        t_s: Option<f64>,
        reversal: Reversal,
    },
    /// The device's health.
    Health(Health),
    /// Something happened on the device.
    Event {
        at: Moment,
        /// Time since the estimator started, if known \[s\].
        t_s: Option<f64>,
        event: Event,
    },
    /// A cause of a violated law, found by this program.
    Cause {
        at: Moment,
        /// Time since the estimator started \[s\].
        t_s: f64,
        /// Index of the last sample that was searched.
        index: u32,
        cause: Cause,
    },
    /// Frames lost in transit so far.
    LostFrames(u64),
    /// Frames dropped so far because this program does not know their contents: the firmware is newer. Reported with
    /// the health.
    UnknownFrames(u64),
    /// The device refused a request.
    Refused {
        /// What and why, for a person.
        words: String,
    },
    /// The user's own note.
    Marker {
        at: Moment,
        /// Time since the estimator started, if known \[s\].
        t_s: Option<f64>,
        text: String,
    },
}

impl Item {
    /// A line of JSON with the key names of the machine; `None` if the item is not reported as one.
    pub fn json(&self, settings: &Settings) -> Option<String> {
        let machine = settings.machine;
        Some(match self {
            Self::Estimate { t_s, estimated, .. } => {
                machine_json_line(machine, &EstimateJson::live(*t_s, estimated, settings))
            }
            Self::Reversal { t_s, reversal } => machine_json_line(machine, &ReversalJson::new(*t_s, reversal)),
            Self::Health(health) => json_line(&health_json(health)),
            Self::Event { t_s, event, .. } => {
                machine_json_line(machine, &EventJson::new(*t_s, event.index, &event.kind, machine))
            }
            Self::Cause { t_s, index, cause, .. } => {
                json_line(&EventJson::cause(*t_s, *index, cause.kind.name(), cause.sentence(machine)))
            }
            Self::LostFrames(count) => json_line(&json!({ "kind": "link", "lost_frames": count })),
            Self::UnknownFrames(count) => json_line(&json!({ "kind": "link", "unknown_frames": count })),
            Self::Marker { t_s, text, .. } => {
                json_line(&json!({ "kind": "marker", "t_s": t_s.map(rounded_s), "text": text }))
            }
            Self::Device { .. }
            | Self::Away { .. }
            | Self::Back { .. }
            | Self::Settings(_)
            | Self::Samples(_)
            | Self::Refused { .. } => return None,
        })
    }
}

/// One continuous timeline for everything a device sends, even if its counters restart.
#[derive(Clone, Copy, Debug, Default)]
struct Timeline {
    period_s: f64,
    start_ns: Option<u64>,
    /// A value of the sample counter and its time.
    anchor: Option<(u32, f64)>,
    latest_s: f64,
}

impl Timeline {
    /// The time of a sample counter value received at `host_ns`.
    fn at(&mut self, index: u32, host_ns: u64) -> Moment {
        let start_ns = *self.start_ns.get_or_insert(host_ns);
        let passed_s = host_ns.saturating_sub(start_ns) as f64 * 1e-9;
        let (from, from_s) = *self.anchor.get_or_insert((index, passed_s.max(self.latest_s)));
        let after = index.wrapping_sub(from).cast_signed();
        let run_s = from_s + f64::from(after) * self.period_s;
        // Well before the counter has advanced half its range.
        if after > 1 << 30 {
            self.anchor = Some((index, run_s));
        }
        self.latest_s = self.latest_s.max(run_s);
        self.moment(run_s)
    }

    /// The latest time received.
    fn now(&self) -> Moment {
        self.moment(self.latest_s)
    }

    fn moment(&self, run_s: f64) -> Moment {
        let after_ns = (run_s.max(0.0) * 1e9) as u64;
        Moment { run_s, unix_ns: self.start_ns.unwrap_or(0).saturating_add(after_ns) }
    }
}

/// Time to wait for the detail of an estimate \[ns\]: the device sends it right after the estimate.
const DETAIL_NS: u64 = 250_000_000;

/// Converts received frames into items.
#[derive(Clone, Debug)]
pub struct Feed {
    settings: Settings,
    converter: Converter,
    timeline: Timeline,
    pairing: Pairing,
    /// When the latest estimate arrived.
    estimate_ns: u64,
    /// The latest estimate's counter, and its time on both clocks.
    latest: Option<(u32, f64, Moment)>,
    lost_frames: u64,
    unknown_frames: u64,
    unknown_told: u64,
}

impl Default for Feed {
    fn default() -> Self {
        let settings = Settings::default();
        Self {
            settings,
            converter: Converter::new(&settings),
            timeline: Timeline::default(),
            pairing: Pairing::new(),
            estimate_ns: 0,
            latest: None,
            lost_frames: 0,
            unknown_frames: 0,
            unknown_told: 0,
        }
    }
}

impl Feed {
    /// A newly connected device.
    pub fn device(&mut self, device: &Device) -> Item {
        self.connected(device.name(), device.hello(), device.settings())
    }

    fn connected(&mut self, port: &str, hello: &Hello, settings: &Settings) -> Item {
        self.use_settings(settings);
        // The device may have restarted: its counter says nothing about the time before.
        self.timeline.anchor = None;
        Item::Device { port: port.into(), hello: hello.clone(), settings: *settings }
    }

    fn use_settings(&mut self, settings: &Settings) {
        self.settings = *settings;
        self.converter = Converter::new(settings);
        self.timeline.period_s = 1.0 / settings.sample_rate_hz;
    }

    /// The user's note, stamped now.
    pub fn marker(&self, text: &str) -> Item {
        let at = self.timeline.now();
        let t_s = self.latest.map(|(_, t_s, then)| t_s + at.run_s - then.run_s);
        Item::Marker { at, t_s, text: text.into() }
    }

    /// The items of one received frame, in order. `lost_frames` counts those lost in transit so far.
    pub fn received(&mut self, received: &Received, lost_frames: u64, mut show: impl FnMut(Item)) {
        if lost_frames > self.lost_frames {
            show(Item::LostFrames(lost_frames));
        }
        self.lost_frames = lost_frames;
        match &received.frame {
            Frame::Message { message, .. } => self.message(message, received.time_ns, &mut show),
            Frame::Restarted => self.timeline.anchor = None,
            Frame::Unknown { .. } => self.unknown_frames += 1,
            Frame::Lost { .. } | Frame::ForeignVersion { .. } | Frame::Corrupt(_) => {}
        }
    }

    /// Emits an estimate whose detail does not arrive. `now_ns` is host time, on the same clock as the received frames.
    pub fn quiet(&mut self, now_ns: u64, mut show: impl FnMut(Item)) {
        if now_ns.saturating_sub(self.estimate_ns) < DETAIL_NS {
            return;
        }
        if let Some(event) = self.pairing.flush() {
            self.event(event, &mut show);
        }
    }

    fn message(&mut self, message: &Record, time_ns: u64, show: &mut impl FnMut(Item)) {
        for event in self.pairing.take(message) {
            self.event(event, show);
        }
        match message {
            Record::Samples(batch) if batch.check().is_ok() => {
                let samples = batch.iter().flatten().map(|raw| {
                    let point = self.converter.point(&raw);
                    let at = self.timeline.at(raw.index, time_ns);
                    Sample { at, force_n: point.force_n, position_m: point.position_m, terminal_m: point.terminal_m }
                });
                show(Item::Samples(samples.collect()));
            }
            Record::Estimate(_) => self.estimate_ns = time_ns,
            Record::Health(health) => {
                if self.unknown_frames > self.unknown_told {
                    self.unknown_told = self.unknown_frames;
                    show(Item::UnknownFrames(self.unknown_frames));
                }
                show(Item::Health(*health));
            }
            Record::Event(event) => {
                if event.kind == EventKind::Started {
                    self.timeline.anchor = None;
                }
                let at = self.timeline.at(event.index, time_ns);
                show(Item::Event { at, t_s: self.time_of(event.index), event: event.clone() });
            }
            Record::Settings(values) => {
                let settings = values.read(&self.settings).settings;
                if settings != self.settings {
                    self.use_settings(&settings);
                    show(Item::Settings(self.settings));
                }
            }
            _ => {}
        }
    }

    fn event(&mut self, event: EstimatorEvent, show: &mut impl FnMut(Item)) {
        match event {
            EstimatorEvent::Estimate(estimated) => {
                let estimate = &estimated.estimate;
                let t_s = text::elapsed_s(estimate, self.settings.sample_rate_hz);
                let at = self.timeline.at(estimate.index, self.estimate_ns);
                self.latest = Some((estimate.index, t_s, at));
                show(Item::Estimate { at, t_s, estimated });
            }
            EstimatorEvent::Reversal(reversal) => {
                show(Item::Reversal { t_s: self.time_of(reversal.index), reversal });
            }
            // Handled like the device's other events.
            EstimatorEvent::Changed(_) | EstimatorEvent::Warned(_) => {}
        }
    }

    /// Time of a sample on the estimates' clock; unknown before the first estimate.
    fn time_of(&self, index: u32) -> Option<f64> {
        let (latest, t_s, _) = self.latest?;
        let after = index.wrapping_sub(latest).cast_signed();
        Some(t_s + f64::from(after) / self.settings.sample_rate_hz)
    }
}

#[cfg(test)]
#[path = "feed_tests.rs"]
mod tests;
