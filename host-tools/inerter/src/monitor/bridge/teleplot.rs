//! Teleplot: UDP text, `name:milliseconds:value;milliseconds:value§unit|g`, one line per quantity.
//! Source: README of Teleplot, "Telemetry Format"; a datagram stays below the 1432 bytes named there.

use std::fmt::Write;

use inerter_core::Machine;
use inerter_data::{names::name, text::event_words, words::printable};
use inerter_wire::catalogue::{self, Group};

use super::datagrams::Datagrams;
use crate::{
    Error,
    monitor::{
        MonitorError,
        address::TELEPLOT,
        feed::{Item, Moment, Sample},
        history::Entry,
        hub::Viewer,
    },
};

/// Maximum size of a datagram \[bytes\].
const MOST: usize = 1400;

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
