//! Messages to the page: the full state when it connects, then each item as it happens.

use std::borrow::Cow;

use inerter_core::Machine;
use inerter_data::{
    json::{EstimateJson, health_json},
    text::{self, event_words, is_trouble},
    words::printable,
};
use inerter_wire::catalogue::{self, Field, Group};
use serde_json::{Value, json};

use crate::monitor::{
    causes,
    feed::Item,
    history::{Entry, QUANTITIES},
    state::{LineKind, State},
    trace::{Bucket, Signal},
};

/// Signals are sent as ranges over this time \[s\]: a display cannot show more.
const RESOLUTION_S: f64 = 0.02;
/// Duration of one message of signals \[s\].
const PORTION_S: f64 = 0.1;
/// Signals that a new page receives \[s\].
const PAST_S: f64 = 60.0;

/// What the page already knows.
pub struct Messages {
    state: State,
    sent_s: f64,
}

impl Messages {
    pub fn new(recording: Option<String>) -> Self {
        Self { state: State::new(recording, Vec::new()), sent_s: f64::NEG_INFINITY }
    }

    /// The message to the pages for one item, if there is one.
    pub fn take(&mut self, item: &Item) -> Option<Value> {
        self.state.item(item);
        let machine = self.state.settings.machine;
        let mut new = match item {
            Item::Device { .. } | Item::Settings(_) => self.device()?,
            Item::Away { reason } => away(reason),
            Item::Back { .. } => json!({ "kind": "back" }),
            Item::Samples(_) => self.samples()?,
            Item::Estimate { at, .. } => self.estimate(at.run_s)?,
            Item::Reversal { .. } => return None,
            Item::Health(_) | Item::LostFrames(_) | Item::UnknownFrames(_) => self.health()?,
            Item::Event { at, event, .. } => {
                line(at.run_s, &event_words(machine, &event.kind), is_trouble(&event.kind))
            }
            Item::Cause { at, cause, .. } => line(at.run_s, &causes::words(machine, cause), true),
            Item::Refused { words } => line(self.state.now_s, words, true),
            Item::Marker { at, text, .. } => mark(at.run_s, text),
        };
        show(&mut new);
        Some(new)
    }

    /// The full state so far.
    pub fn all(&self) -> Vec<Value> {
        let state = &self.state;
        let mut all = vec![json!({ "kind": "begin", "recording": state.recording })];
        all.extend(self.device());
        let from_s = state.now_s - PAST_S;
        let past: Vec<&Bucket> =
            state.traces.after(from_s, RESOLUTION_S).filter(|bucket| bucket.start_s <= self.sent_s).collect();
        all.push(self.ranges(&past));
        all.push(self.history());
        all.extend(state.values.estimate.and_then(|_| self.estimate(state.now_s)));
        all.extend(self.health());
        // Markers are among the lines, but are sent as markers.
        let lines = state.lines.iter().filter(|one| one.kind != LineKind::Marker);
        let lines = lines.map(|one| (one.run_s, line(one.run_s, &one.words, one.kind == LineKind::Trouble)));
        let marks = state.marks.iter().map(|(run_s, text)| (*run_s, mark(*run_s, text)));
        let mut lines: Vec<(f64, Value)> = lines.chain(marks).collect();
        lines.sort_by(|(one, _), (other, _)| one.total_cmp(other));
        all.extend(lines.into_iter().map(|(_, message)| message));
        all.extend(state.away.iter().map(|reason| away(reason)));
        all.iter_mut().for_each(show);
        all
    }

    fn device(&self) -> Option<Value> {
        let present = self.state.present.as_ref()?;
        let hello = &present.hello;
        let machine = self.state.settings.machine;
        // The keys of the page's messages are those of a linear machine; the labels are those of this machine.
        let field = |(linear, field): (&Field, &Field)| json!({ "path": linear.path, "label": field.label, "unit": field.unit });
        let fields = |group| catalogue::fields(Machine::Linear, group).zip(catalogue::fields(machine, group));
        let contact = catalogue::contact_fields(Machine::Linear).zip(catalogue::contact_fields(machine));
        let signals = fields(Group::Signal).filter(|(linear, _)| linear.path != "t_s").map(|(linear, field)| {
            let unit = catalogue::unit(machine, if linear.unit == "m" { "mm" } else { linear.unit });
            format!("{} [{unit}]", field.label)
        });
        Some(json!({
            "kind": "device", "port": present.port, "board": hello.board, "serial": hello.serial,
            "firmware": hello.firmware, "sample_rate_hz": self.state.settings.sample_rate_hz,
            "memory_s": self.state.settings.memory_s, "terminal": self.state.settings.terminal_sensor,
            "parameters": fields(Group::Parameter).map(field).collect::<Vec<_>>(),
            "contact": contact.map(field).collect::<Vec<_>>(), "signals": signals.collect::<Vec<_>>(),
            "backlash_unit": catalogue::unit(machine, "µm"), "force_unit": catalogue::unit(machine, "N"),
        }))
    }

    fn samples(&mut self) -> Option<Value> {
        let latest_s = self.state.traces.latest_s()?;
        if latest_s - self.sent_s < PORTION_S {
            return None;
        }
        let new: Vec<&Bucket> = self.state.traces.after(self.sent_s, RESOLUTION_S).collect();
        let sent_s = new.last()?.start_s;
        let message = self.ranges(&new);
        self.sent_s = sent_s;
        Some(message)
    }

    fn ranges(&self, buckets: &[&Bucket]) -> Value {
        let of = |signal: Signal| -> [Vec<Value>; 2] {
            let ranges = buckets.iter().map(|bucket| bucket.range(signal));
            // Five decimals are enough, and shorter than all digits of a float.
            let short = |value: Option<f64>| value.map_or(Value::Null, |value| json!((value * 1e5).round() / 1e5));
            ranges.map(|range| (short(range.map(|(low, _)| low)), short(range.map(|(_, high)| high)))).unzip().into()
        };
        let times: Vec<f64> = buckets.iter().map(|bucket| (bucket.start_s * 1e4).round() / 1e4).collect();
        let terminal = self.state.settings.terminal_sensor.then(|| of(Signal::Terminal));
        json!({
            "kind": "samples", "t_s": times, "force_n": of(Signal::Force), "position_mm": of(Signal::Position),
            "terminal_mm": terminal,
        })
    }

    fn estimate(&self, run_s: f64) -> Option<Value> {
        let state = &self.state;
        let (t_s, estimated) = state.values.estimate?;
        // Plain numbers and texts: serialisation cannot fail.
        let mut value = serde_json::to_value(EstimateJson::live(t_s, &estimated, &state.settings)).unwrap_or_default();
        value["run_s"] = json!((run_s * 1e4).round() / 1e4);
        value["state"] = text::line(state.settings.machine, &estimated).into();
        Some(value)
    }

    fn history(&self) -> Value {
        let entries = self.state.history.since(f64::NEG_INFINITY);
        let of = |quantity: usize| -> [Vec<Option<f64>>; 2] {
            let points = entries.iter().map(|entry: &Entry| entry.points.get(quantity).and_then(|point| point.known()));
            points.map(|known| (known.map(|(value, _)| value), known.map(|(_, u95)| u95))).unzip().into()
        };
        let times: Vec<f64> = entries.iter().map(|entry| entry.run_s).collect();
        json!({ "kind": "history", "t_s": times, "quantities": (0..QUANTITIES).map(of).collect::<Vec<_>>() })
    }

    fn health(&self) -> Option<Value> {
        let losses = &self.state.values.losses;
        let mut value = health_json(&losses.health?);
        value["lost_frames"] = losses.lost_frames.into();
        value["clean"] = losses.is_clean().into();
        value["words"] = losses.line().into();
        Some(value)
    }
}

/// Makes the texts of a message safe to show, wherever they come from.
fn show(message: &mut Value) {
    match message {
        Value::String(text) => {
            if let Cow::Owned(shown) = printable(text) {
                *text = shown;
            }
        }
        Value::Array(values) => values.iter_mut().for_each(show),
        Value::Object(values) => values.values_mut().for_each(show),
        Value::Null | Value::Bool(_) | Value::Number(_) => {}
    }
}

fn away(reason: &str) -> Value {
    json!({ "kind": "away", "reason": reason })
}

fn line(run_s: f64, words: &str, trouble: bool) -> Value {
    json!({ "kind": "event", "run_s": run_s, "words": words, "trouble": trouble })
}

fn mark(run_s: f64, text: &str) -> Value {
    json!({ "kind": "marker", "run_s": run_s, "text": text })
}

#[cfg(test)]
mod tests {
    use inerter_core::Settings;

    use super::*;
    use crate::{
        hostile::{SHOWN, WORDS, monitored},
        monitor::feed::{Moment, Sample},
    };

    fn portion(from: u32) -> Item {
        let sample = |index: u32| Sample {
            at: Moment { run_s: f64::from(index) * 1e-3, unix_ns: 0 },
            force_n: f64::from(index % 10),
            position_m: 1e-3,
            terminal_m: None,
        };
        Item::Samples((from..from + 20).map(sample).collect())
    }

    #[test]
    fn signals_are_told_once_in_order_and_a_late_page_is_told_the_same() {
        let mut messages = Messages::new(None);
        let told: Vec<Value> = (0..500).filter_map(|place| messages.take(&portion(20 * place))).collect();
        assert!((90..=130).contains(&told.len()), "{}", told.len());
        let times = |value: &Value| -> Vec<f64> {
            value["t_s"].as_array().unwrap().iter().map(|time| time.as_f64().unwrap()).collect()
        };
        let all: Vec<f64> = told.iter().flat_map(times).collect();
        assert!(all.windows(2).all(|pair| pair[1] > pair[0]) && all.len() > 400 && all.len() < 700, "{}", all.len());
        let late = messages.all();
        let samples = late.iter().find(|message| message["kind"] == "samples").unwrap();
        assert_eq!(times(samples), all);
        assert_eq!(samples["terminal_mm"], Value::Null);
        let [low, high] = [0, 1].map(|side| samples["force_n"][side][5].as_f64().unwrap());
        assert_eq!((low, high), (0.0, 9.0));
    }

    #[test]
    fn no_page_is_told_a_text_as_it_came() {
        fn texts(message: &Value) -> Vec<&str> {
            match message {
                Value::String(text) => vec![text],
                Value::Array(values) => values.iter().flat_map(texts).collect(),
                Value::Object(values) => values.values().flat_map(texts).collect(),
                _ => Vec::new(),
            }
        }
        let mut messages = Messages::new(Some(WORDS.into()));
        let at = Moment { run_s: 1.0, unix_ns: 0 };
        let told: Vec<Value> =
            monitored(Settings::default(), at).iter().filter_map(|item| messages.take(item)).collect();
        // The port, the panic, what was refused, the marker, and why the device is away. A new page is also told the
        // recording, and the lines about the device's return and absence.
        for (all, expected) in [(told, 5), (messages.all(), 8)] {
            let texts: Vec<&str> = all.iter().flat_map(texts).collect();
            for text in &texts {
                assert_eq!(printable(text), *text);
            }
            assert_eq!(texts.iter().filter(|text| text.contains(SHOWN)).count(), expected, "{texts:?}");
        }
    }
}
