//! Foxglove: a WebSocket server with a JSON channel, and its schema, for each kind of thing.

use std::sync::Arc;

use foxglove::{ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServerHandle};
use inerter_core::Settings;
use inerter_data::json::{EstimateJson, EventJson, ReversalJson, health_json, json_line};
use inerter_wire::catalogue::{self, Group};
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
    _context: Arc<Context>,
    samples: Arc<RawChannel>,
    estimate: Arc<RawChannel>,
    reversal: Arc<RawChannel>,
    health: Arc<RawChannel>,
    event: Arc<RawChannel>,
    marker: Arc<RawChannel>,
    settings: Settings,
    latest: Moment,
    address: String,
}

impl Foxglove {
    /// Listens at this address.
    pub fn new(address: &str) -> Result<Self, MonitorError> {
        let at = resolve("--foxglove", address, FOXGLOVE)?;
        let failed = |reason: String| MonitorError::Listen {
            what: "the server for Foxglove",
            option: "--foxglove",
            address: address.into(),
            example: "127.0.0.1:8766",
            reason,
        };
        let context = Context::new();
        let channel = |topic: &str, properties: Map<String, Value>| {
            let schema = json!({ "type": "object", "title": format!("inerter.{topic}"), "properties": properties });
            ChannelBuilder::new(format!("/{topic}"))
                .context(&context)
                .message_encoding("json")
                .schema(Schema::new(format!("inerter.{topic}"), "jsonschema", json_line(&schema).into_bytes()))
                .build_raw()
                .map_err(|error| failed(error.to_string()))
        };
        let server = context
            .websocket_server()
            .name("instrumented inerter")
            .message_backlog_size(BACKLOG)
            .bind(at.ip().to_string(), at.port());
        let mut bridge = Self {
            samples: channel("samples", fields(Group::Signal))?,
            estimate: channel("estimate", estimate_fields())?,
            reversal: channel(
                "reversal",
                plain(&[("value_m", "number", "m"), ("error_m", "number", "m"), ("rising", "boolean", "")]),
            )?,
            health: channel("health", fields(Group::Health))?,
            event: channel("event", plain(&[("code", "string", ""), ("event", "string", "")]))?,
            marker: channel("marker", plain(&[("text", "string", "")]))?,
            server: None,
            _context: context.clone(),
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

fn property(kind: &str, label: &str, unit: &str) -> Value {
    let description = if unit.is_empty() { label.to_string() } else { format!("{label} [{unit}]") };
    json!({ "type": kind, "description": description.trim() })
}

fn plain(list: &[(&str, &str, &str)]) -> Map<String, Value> {
    list.iter().map(|(name, kind, unit)| (name.to_string(), property(kind, "", unit))).collect()
}

fn fields(group: Group) -> Map<String, Value> {
    let of = |field: &catalogue::Field| (field.path.to_string(), property("number", field.label, field.unit));
    catalogue::fields(group).map(of).collect()
}

/// Value, interval and status of each parameter and of the backlash; further keys are as docs/CLI.md says.
fn estimate_fields() -> Map<String, Value> {
    let quantity = |field: &catalogue::Field| {
        let parts = json!({
            "value": property("number", field.label, field.unit),
            "u95": property("number", "half width of the 95 % interval", field.unit),
            "status": property("string", "", ""),
        });
        (field.path.to_string(), json!({ "type": "object", "properties": parts }))
    };
    let backlash = catalogue::find(Group::Detail, "backlash_m");
    let mut map: Map<String, Value> = catalogue::fields(Group::Parameter).chain(backlash).map(quantity).collect();
    map.insert("t_s".into(), property("number", "Time since the estimator began", "s"));
    map.insert("residual_rms_n".into(), property("number", "Residual force, rms", "N"));
    map.insert("moving".into(), property("boolean", "", ""));
    map
}

impl Viewer for Foxglove {
    fn show(&mut self, item: &Item) -> Result<(), Error> {
        match item {
            Item::Device { settings, .. } | Item::Settings(settings) => self.settings = *settings,
            Item::Samples(samples) => {
                for sample in samples {
                    self.latest = sample.at;
                    Self::send(&self.samples, sample.at, || {
                        json_line(&json!({
                            "t_s": sample.at.run_s, "position_m": sample.position_m, "force_n": sample.force_n,
                            "terminal_m": sample.terminal_m,
                        }))
                    });
                }
            }
            Item::Estimate { at, t_s, estimate, detail } => {
                self.latest = *at;
                let line = || json_line(&EstimateJson::live(*t_s, estimate, detail.as_ref(), &self.settings));
                Self::send(&self.estimate, *at, line);
            }
            Item::Reversal { t_s, reversal } => {
                Self::send(&self.reversal, self.latest, || json_line(&ReversalJson::new(*t_s, reversal)))
            }
            Item::Health(health) => Self::send(&self.health, self.latest, || json_line(&health_json(health))),
            Item::Event { at, t_s, event } => {
                Self::send(&self.event, *at, || json_line(&EventJson::new(*t_s, event.index, &event.kind)));
            }
            Item::Marker { at, text, .. } => {
                Self::send(&self.marker, *at, || json_line(&json!({ "kind": "marker", "text": text })));
            }
            Item::Away { .. } | Item::Back { .. } | Item::LostFrames(_) => {}
        }
        Ok(())
    }
}
