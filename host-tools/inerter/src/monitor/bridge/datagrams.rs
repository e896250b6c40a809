//! Bridges that send datagrams (UDP).
//!
//! Teleplot: text, `name:milliseconds:value;milliseconds:value§unit|g`, one line per quantity. Source: README of
//! Teleplot, "Telemetry Format"; a datagram stays below the 1432 bytes named there.
//!
//! PlotJuggler: its UDP server with the protocol JSON; one object per datagram, its time in `timestamp` \[s\].

use std::{
    fmt::Write,
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket},
};

use inerter_core::{Machine, Settings};
use inerter_data::{
    json::{EstimateJson, machine_json_line},
    names::name,
    text::event_words,
    words::printable,
};
use inerter_wire::catalogue::{self, Group};
use serde_json::{Map, Value, json};

use crate::{
    Error,
    monitor::{
        MonitorError,
        address::{PLOTJUGGLER, TELEPLOT, resolve},
        feed::{Item, Moment, Sample},
        history::Entry,
        hub::Viewer,
    },
};

/// Maximum size of a datagram \[bytes\].
const MOST: usize = 1400;

/// A socket to send from. It is not connected: if no program listens, every other send would fail.
struct Datagrams {
    socket: UdpSocket,
    to: SocketAddr,
}

impl Datagrams {
    fn new(option: &'static str, address: &str, example: &'static str) -> Result<Self, MonitorError> {
        let to = resolve(option, address, example)?;
        // If the destination is local, nobody outside can reach the socket either.
        let from = match to {
            SocketAddr::V4(to) if to.ip().is_loopback() => Ipv4Addr::LOCALHOST.into(),
            SocketAddr::V4(_) => IpAddr::from(Ipv4Addr::UNSPECIFIED),
            SocketAddr::V6(to) if to.ip().is_loopback() => Ipv6Addr::LOCALHOST.into(),
            SocketAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
        };
        let failed = |source| MonitorError::Address { option, address: address.into(), example, source };
        let socket = UdpSocket::bind((from, 0)).map_err(failed)?;
        // A full buffer loses a datagram, not a sample: the measurement must not wait for a plot.
        socket.set_nonblocking(true).map_err(failed)?;
        Ok(Self { socket, to })
    }

    fn send(&self, bytes: &[u8]) {
        self.socket.send_to(bytes, self.to).ok();
    }
}

pub struct PlotJuggler {
    datagrams: Datagrams,
    settings: Settings,
}

impl PlotJuggler {
    /// Sends to this address.
    pub fn new(address: &str) -> Result<Self, MonitorError> {
        let datagrams = Datagrams::new("--plotjuggler", address, PLOTJUGGLER)?;
        Ok(Self { datagrams, settings: Settings::default() })
    }

    fn send(&self, at: Moment, name: &str, value: Value) {
        let mut object = Map::from_iter([("timestamp".to_string(), json!(at.unix_ns as f64 * 1e-9))]);
        object.insert(name.into(), known(value));
        self.datagrams.send(machine_json_line(self.settings.machine, &object).as_bytes());
    }
}

/// Drops unknown values: a curve has no point there.
fn known(value: Value) -> Value {
    match value {
        Value::Object(object) => {
            object.into_iter().filter(|(_, value)| !value.is_null()).map(|(key, value)| (key, known(value))).collect()
        }
        other => other,
    }
}

impl Viewer for PlotJuggler {
    fn show(&mut self, item: &Item) -> Result<(), Error> {
        match item {
            Item::Device { settings, .. } | Item::Settings(settings) => self.settings = *settings,
            Item::Samples(samples) => {
                for sample in samples {
                    let (force_n, position_m) = (sample.force_n, sample.position_m);
                    let value =
                        json!({ "force_n": force_n, "position_m": position_m, "terminal_m": sample.terminal_m });
                    self.send(sample.at, "samples", value);
                }
            }
            Item::Estimate { at, t_s, estimated } => {
                let estimate = EstimateJson::live(*t_s, estimated, &self.settings);
                // Plain numbers and texts: serialisation cannot fail.
                self.send(*at, "estimate", serde_json::to_value(estimate).unwrap_or_default());
            }
            _ => {}
        }
        Ok(())
    }
}

pub struct Teleplot {
    datagrams: Datagrams,
    machine: Machine,
}

impl Teleplot {
    /// Sends to this address.
    pub fn new(address: &str) -> Result<Self, MonitorError> {
        Ok(Self { datagrams: Datagrams::new("--teleplot", address, TELEPLOT)?, machine: Machine::Linear })
    }

    /// One quantity with all its points, in as many datagrams as needed.
    fn series(&self, name: &str, unit: &str, points: impl Iterator<Item = (Moment, f64)>) {
        let tail = if unit.is_empty() { "|g".to_string() } else { format!("§{unit}|g") };
        let mut text = String::new();
        let send = |text: &mut String| {
            if !text.is_empty() {
                self.datagrams.send(format!("{name}:{text}{tail}").as_bytes());
                text.clear();
            }
        };
        for (at, value) in points.filter(|(_, value)| value.is_finite()) {
            if text.len() + name.len() + tail.len() + 48 > MOST {
                send(&mut text);
            }
            let separator = if text.is_empty() { "" } else { ";" };
            // Writing to a String cannot fail.
            let _ = write!(text, "{separator}{:.3}:{:?}", at.unix_ns as f64 * 1e-6, value as f32);
        }
        send(&mut text);
    }

    fn log(&self, at: Moment, words: &str) {
        self.datagrams.send(format!(">{:.0}:{}", at.unix_ns as f64 * 1e-6, line(words)).as_bytes());
    }
}

impl Viewer for Teleplot {
    fn show(&mut self, item: &Item) -> Result<(), Error> {
        match item {
            Item::Device { settings, .. } | Item::Settings(settings) => self.machine = settings.machine,
            Item::Samples(samples) => {
                let linear = catalogue::fields(Machine::Linear, Group::Signal);
                for (linear, field) in linear.zip(catalogue::fields(self.machine, Group::Signal)) {
                    let value: fn(&Sample) -> Option<f64> = match linear.path {
                        "force_n" => |sample| Some(sample.force_n),
                        "position_m" => |sample| Some(sample.position_m),
                        "terminal_m" => |sample| sample.terminal_m,
                        _ => continue,
                    };
                    let points = samples.iter().filter_map(|sample| Some((sample.at, value(sample)?)));
                    self.series(field.path, field.unit, points);
                }
            }
            Item::Estimate { at, estimated, .. } => {
                let entry = Entry::new(at.run_s, estimated);
                let backlash = name(self.machine, "backlash_um");
                let backlash = (backlash.as_ref(), catalogue::unit(self.machine, "µm"));
                let parameters =
                    catalogue::fields(self.machine, Group::Parameter).map(|field| (field.path, field.unit));
                for ((path, unit), point) in parameters.chain([backlash]).zip(entry.points) {
                    let Some((value, u95)) = point.known() else { continue };
                    self.series(path, unit, [(*at, value)].into_iter());
                    if point.u95.is_finite() {
                        self.series(&format!("{path}_u95"), unit, [(*at, u95)].into_iter());
                    }
                }
                let (residual, unit) = (name(self.machine, "residual_rms_n"), catalogue::unit(self.machine, "N"));
                self.series(&residual, unit, [(*at, estimated.estimate.residual_rms_n.into())].into_iter());
                let ratio = estimated.law.and_then(|law| law.misfit).map(|misfit| (*at, misfit.ratio.into()));
                self.series("law_ratio", "", ratio.into_iter());
            }
            Item::Event { at, event, .. } => self.log(*at, &event_words(self.machine, &event.kind)),
            Item::Cause { at, cause, .. } => self.log(*at, &cause.sentence(self.machine)),
            Item::Marker { at, text, .. } => self.log(*at, text),
            _ => {}
        }
        Ok(())
    }
}

/// Text from outside, reduced to one line of the log.
fn line(words: &str) -> String {
    printable(&words.replace(['\n', '|'], " ")).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_device_says_stays_text() {
        let listener = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        listener.set_read_timeout(Some(std::time::Duration::from_secs(5))).unwrap();
        let teleplot = Teleplot::new(&listener.local_addr().unwrap().to_string()).unwrap();
        let sent = |words: &str| {
            teleplot.log(Moment { run_s: 1.0, unix_ns: 2_000_000 }, words);
            let mut datagram = [0; MOST];
            let length = listener.recv(&mut datagram).unwrap();
            String::from_utf8(datagram[..length].to_vec()).unwrap()
        };
        assert_eq!(sent("a panic | of\ntwo lines"), ">2:a panic   of two lines");
        let hostile = sent("\u{1b}]52;c;aGVsbG8=\u{7}\r\u{202e}");
        assert!(!hostile.contains(|letter: char| letter.is_control() || letter == '\u{202e}'), "{hostile:?}");
        assert!(hostile.contains("52;c;"), "{hostile:?}");
    }
}
