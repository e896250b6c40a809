//! PlotJuggler: its UDP server with the protocol JSON; one object per datagram, its time in `timestamp` \[s\].

use inerter_core::Settings;
use inerter_data::json::{EstimateJson, machine_json_line};
use serde_json::{Map, Value, json};

use super::datagrams::Datagrams;
use crate::{
    Error,
    monitor::{
        MonitorError,
        address::PLOTJUGGLER,
        feed::{Item, Moment},
        hub::Viewer,
    },
};

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
