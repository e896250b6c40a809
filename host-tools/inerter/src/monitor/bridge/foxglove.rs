//! Foxglove: a WebSocket server with a JSON channel, and its schema, for each kind of thing.

use std::sync::Arc;

use foxglove::{ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServerHandle};
use inerter_core::{Machine, Settings};
use inerter_data::json::{EstimateJson, EventJson, ReversalJson, health_json, json_line, machine_json_line};
use inerter_wire::catalogue::{self, Field, Group};
use serde_json::{Map, Value, json};

use super::address::{FOXGLOVE, resolve};
use crate::{
    Error,
    monitor::{
        MonitorError,
        feed::{Item, Moment},
        hub::Viewer,
    },
};

/// Messages that wait for a slow client: a second of samples, and more at 4 kHz.
const BACKLOG: usize = 8192;

/// The bridge.
pub struct Foxglove {
    server: Option<WebSocketServerHandle>,
    /// Channels do not keep it alive, and are closed with it.
    context: Arc<Context>,
    channels: Channels,
    settings: Settings,
    latest: Moment,
    address: String,
}

/// A channel for each kind of thing.
struct Channels {
    samples: Arc<RawChannel>,
    estimate: Arc<RawChannel>,
    reversal: Arc<RawChannel>,
    health: Arc<RawChannel>,
    event: Arc<RawChannel>,
    marker: Arc<RawChannel>,
}

impl Channels {
    /// With schemas in the names of this machine.
    fn new(context: &Arc<Context>, machine: Machine) -> Result<Self, String> {
        let channel = |topic: &str, properties: Map<String, Value>| {
            let schema = json!({ "type": "object", "title": format!("inerter.{topic}"), "properties": properties });
            let schema = machine_json_line(machine, &schema).into_bytes();
            ChannelBuilder::new(format!("/{topic}"))
                .context(context)
                .message_encoding("json")
                .schema(Schema::new(format!("inerter.{topic}"), "jsonschema", schema))
                .build_raw()
                .map_err(|error| error.to_string())
        };
        let metre = catalogue::unit(machine, "m");
        let reversal = [("value_m", "number", metre), ("error_m", "number", metre), ("rising", "boolean", "")];
        Ok(Self {
            samples: channel("samples", fields(machine, Group::Signal))?,
            estimate: channel("estimate", estimate_fields(machine))?,
            reversal: channel("reversal", plain(&reversal))?,
            health: channel("health", fields(machine, Group::Health))?,
            event: channel("event", plain(&[("code", "string", ""), ("event", "string", "")]))?,
            marker: channel("marker", plain(&[("text", "string", "")]))?,
        })
    }

    fn close(&self) {
        let Self { samples, estimate, reversal, health, event, marker } = self;
        [samples, estimate, reversal, health, event, marker].into_iter().for_each(|channel| channel.close());
    }
}

impl Foxglove {
    /// Listens at this address.
    pub fn new(address: &str) -> Result<Self, MonitorError> {
        let at = resolve("--foxglove", address, FOXGLOVE)?;
        let failed = |reason: String| failed(address, reason);
        let context = Context::new();
        let server = context
            .websocket_server()
            .name("instrumented inerter")
            .message_backlog_size(BACKLOG)
            .bind(at.ip().to_string(), at.port());
        let mut bridge = Self {
            channels: Channels::new(&context, Machine::Linear).map_err(&failed)?,
            server: None,
            context: context.clone(),
            settings: Settings::default(),
            latest: Moment::default(),
            address: String::new(),
        };
        let server = server.start_blocking().map_err(|error| failed(error.to_string()))?;
        bridge.address = format!("ws://{}", std::net::SocketAddr::new(at.ip(), server.port()));
        bridge.server = Some(server);
        Ok(bridge)
    }

    /// What Foxglove connects to.
    pub fn address(&self) -> &str {
        &self.address
    }

    fn send(channel: &RawChannel, at: Moment, value: impl FnOnce() -> String) {
        if channel.has_sinks() {
            channel.log_with_meta(value().as_bytes(), PartialMetadata { log_time: Some(at.unix_ns) });
        }
    }
}

impl Drop for Foxglove {
    fn drop(&mut self) {
        if let Some(server) = self.server.take() {
            // Nobody waits for it: the clients are cut off.
            drop(server.stop());
        }
    }
}

fn failed(address: &str, reason: String) -> MonitorError {
    MonitorError::Listen {
        what: "the server for Foxglove",
        option: "--foxglove",
        address: address.into(),
        example: "127.0.0.1:8766",
        reason,
    }
}

fn property(kind: &str, label: &str, unit: &str) -> Value {
    let description = if unit.is_empty() { label.to_string() } else { format!("{label} [{unit}]") };
    json!({ "type": kind, "description": description.trim() })
}

fn plain(list: &[(&str, &str, &str)]) -> Map<String, Value> {
    list.iter().map(|(name, kind, unit)| (name.to_string(), property(kind, "", unit))).collect()
}

/// Keys are those of a linear machine, to be renamed when they are written.
fn fields(machine: Machine, group: Group) -> Map<String, Value> {
    let of = |(linear, field): (&Field, &Field)| (linear.path.to_string(), property("number", field.label, field.unit));
    catalogue::fields(Machine::Linear, group).zip(catalogue::fields(machine, group)).map(of).collect()
}

/// Value, interval and status of each parameter and of the backlash; further keys are as docs/CLI.md says.
fn estimate_fields(machine: Machine) -> Map<String, Value> {
    let quantity = |(linear, field): (&Field, &Field)| {
        let parts = json!({
            "value": property("number", field.label, field.unit),
            "u95": property("number", "half width of the 95 % interval", field.unit),
            "status": property("string", "", ""),
        });
        (linear.path.to_string(), json!({ "type": "object", "properties": parts }))
    };
    let of = |machine| {
        let backlash = catalogue::find(machine, Group::Detail, "backlash_m");
        catalogue::fields(machine, Group::Parameter).chain(backlash)
    };
    let mut map: Map<String, Value> = of(Machine::Linear).zip(of(machine)).map(quantity).collect();
    map.insert("t_s".into(), property("number", "Time since the estimator began", "s"));
    let residual = catalogue::find(machine, Group::Estimate, "residual_rms_n");
    map.extend(residual.map(|field| ("residual_rms_n".to_string(), property("number", field.label, field.unit))));
    map.insert("moving".into(), property("boolean", "", ""));
    map
}

impl Viewer for Foxglove {
    fn show(&mut self, item: &Item) -> Result<(), Error> {
        match item {
            Item::Device { settings, .. } | Item::Settings(settings) => {
                if settings.machine != self.settings.machine {
                    // First: a channel with the topic and schema of one that is open would be that one.
                    self.channels.close();
                    self.channels = Channels::new(&self.context, settings.machine)
                        .map_err(|reason| failed(&self.address, reason))?;
                }
                self.settings = *settings;
            }
            Item::Samples(samples) => {
                for sample in samples {
                    self.latest = sample.at;
                    Self::send(&self.channels.samples, sample.at, || {
                        machine_json_line(
                            self.settings.machine,
                            &json!({
                                "t_s": sample.at.run_s, "position_m": sample.position_m, "force_n": sample.force_n,
                                "terminal_m": sample.terminal_m,
                            }),
                        )
                    });
                }
            }
            Item::Estimate { at, t_s, estimate, detail } => {
                self.latest = *at;
                let line = || {
                    machine_json_line(
                        self.settings.machine,
                        &EstimateJson::live(*t_s, estimate, detail.as_ref(), &self.settings),
                    )
                };
                Self::send(&self.channels.estimate, *at, line);
            }
            Item::Reversal { t_s, reversal } => Self::send(&self.channels.reversal, self.latest, || {
                machine_json_line(self.settings.machine, &ReversalJson::new(*t_s, reversal))
            }),
            Item::Health(health) => Self::send(&self.channels.health, self.latest, || json_line(&health_json(health))),
            Item::Event { at, t_s, event } => {
                Self::send(&self.channels.event, *at, || {
                    let machine = self.settings.machine;
                    machine_json_line(machine, &EventJson::new(*t_s, event.index, &event.kind, machine))
                });
            }
            Item::Marker { at, text, .. } => {
                Self::send(&self.channels.marker, *at, || json_line(&json!({ "kind": "marker", "text": text })));
            }
            Item::Away { .. } | Item::Back { .. } | Item::LostFrames(_) | Item::UnknownFrames(_) => {}
        }
        Ok(())
    }
}
