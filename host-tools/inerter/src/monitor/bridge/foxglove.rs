//! Foxglove: a WebSocket server with a JSON channel and its schema for each kind of message.
//!
//! These may connect: programs other than browsers, and pages of this machine, of Foxglove itself or named by
//! `--foxglove-origin`. The server acts only on subscriptions and ignores all other requests. Source: the specification
//! of `foxglove/ws-protocol`, version 1.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex},
};

use axum::{
    Extension, Router,
    body::Bytes,
    extract::{
        State,
        ws::{Message, Utf8Bytes, WebSocket, WebSocketUpgrade},
    },
    http::{HeaderMap, StatusCode},
    response::{IntoResponse, Response},
};
use inerter_core::{Machine, Settings};
use inerter_data::json::{json_line, machine_json_line};
use inerter_serve::{Place, Server, comes_from, limited, local_host, loopback, send};
use inerter_wire::catalogue::{self, Field, Group};
use serde::Deserialize;
use serde_json::{Map, Value, json};
use tokio::sync::broadcast;

use crate::{
    Error,
    monitor::{
        MonitorError,
        address::{FOXGLOVE, resolve},
        feed::{Item, Moment},
        hub::Viewer,
        locked,
    },
};

/// Messages queued for a slow client, which then misses some: a second of samples, and more at 4 kHz.
const BACKLOG: usize = 8192;
/// Size limit of a message from a client \[bytes\].
const MOST_FROM_CLIENT: usize = 1 << 16;
/// Channels that a client may subscribe to, more than there are.
const MOST_SUBSCRIPTIONS: usize = 64;
/// Names of version 1 of the protocol, of newer and of older programs.
const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// Origins that may connect besides this machine's: Foxglove's own, and its desktop programs, which use `file://`.
const ORIGINS: [&str; 2] = ["https://app.foxglove.dev", "file://"];
/// Opcode of a message.
const MESSAGE_DATA: u8 = 1;

/// A kind of message, each with its channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Topic {
    Samples,
    Estimate,
    Reversal,
    Health,
    Event,
    Marker,
}

/// All of them with their names, in order.
const TOPICS: [(Topic, &str); 6] = [
    (Topic::Samples, "samples"),
    (Topic::Estimate, "estimate"),
    (Topic::Reversal, "reversal"),
    (Topic::Health, "health"),
    (Topic::Event, "event"),
    (Topic::Marker, "marker"),
];

impl Topic {
    /// The properties of its messages, with the key names of this machine.
    fn properties(self, machine: Machine) -> Map<String, Value> {
        let metre = catalogue::unit(machine, "m");
        match self {
            Self::Samples => fields(machine, Group::Signal),
            Self::Estimate => estimate_fields(machine),
            Self::Reversal => {
                plain(&[("value_m", "number", metre), ("error_m", "number", metre), ("rising", "boolean", "")])
            }
            Self::Health => fields(machine, Group::Health),
            Self::Event => plain(&[("code", "string", ""), ("event", "string", "")]),
            Self::Marker => plain(&[("text", "string", "")]),
        }
    }
}

/// What all clients receive.
#[derive(Clone)]
enum Told {
    /// Channels that come or go.
    Channels(Utf8Bytes),
    /// A message of a channel.
    Message { channel: u32, unix_ns: u64, payload: Bytes },
}

/// The channels on offer. Another machine renumbers them.
struct Channels {
    first: u32,
    machine: Machine,
}

impl Channels {
    fn number(&self, topic: Topic) -> u32 {
        self.first + topic as u32
    }

    fn advertise(&self) -> Value {
        let channel = |(topic, name): (Topic, &str)| {
            let title = format!("inerter.{name}");
            let schema = json!({ "type": "object", "title": title, "properties": topic.properties(self.machine) });
            json!({
                "id": self.number(topic), "topic": format!("/{name}"), "encoding": "json", "schemaName": title,
                "schema": machine_json_line(self.machine, &schema), "schemaEncoding": "jsonschema",
            })
        };
        json!({ "op": "advertise", "channels": TOPICS.map(channel) })
    }

    fn unadvertise(&self) -> Value {
        json!({ "op": "unadvertise", "channelIds": TOPICS.map(|(topic, _)| self.number(topic)) })
    }
}

/// What the clients' tasks share.
struct Shared {
    channels: Mutex<Channels>,
    sender: broadcast::Sender<Told>,
    /// Distinguishes this run from others.
    session: String,
    origins: Vec<String>,
    /// Only this machine can connect.
    is_local: bool,
}

pub struct Foxglove {
    shared: Arc<Shared>,
    settings: Settings,
    latest: Moment,
    /// The address that Foxglove connects to.
    pub address: String,
    _server: Server,
}

impl Foxglove {
    /// Listens at this address; also accepts pages of these origins.
    pub fn new(address: &str, origins: &[String]) -> Result<Self, MonitorError> {
        let at = resolve("--foxglove", address, FOXGLOVE)?;
        let is_local = at.ip().is_loopback();
        let (sender, _) = broadcast::channel(BACKLOG);
        let session = inerter_device::Clock::new().now_ns().to_string();
        let channels = Mutex::new(Channels { first: 1, machine: Machine::Linear });
        let shared = Arc::new(Shared { channels, sender, session, origins: origins.to_vec(), is_local });
        let router = Router::new().fallback(live).with_state(shared.clone());
        let server = Server::start("Foxglove", at, router).map_err(|error| MonitorError::Listen {
            what: "the server for Foxglove",
            option: "--foxglove",
            address: address.into(),
            example: "127.0.0.1:8766",
            reason: error.to_string(),
        })?;
        let address = format!("ws://{}", server.address());
        Ok(Self { shared, settings: Settings::default(), latest: Moment::default(), address, _server: server })
    }

    fn send(&self, topic: Topic, at: Moment, value: impl FnOnce() -> String) {
        if self.shared.sender.receiver_count() > 0 {
            let channel = locked(&self.shared.channels).number(topic);
            let message = Told::Message { channel, unix_ns: at.unix_ns, payload: value().into() };
            self.shared.sender.send(message).ok();
        }
    }

    /// Replaces the channels, because the names and units change.
    fn turn_to(&self, machine: Machine) {
        let mut channels = locked(&self.shared.channels);
        let before = channels.unadvertise();
        *channels = Channels { first: channels.first + TOPICS.len() as u32, machine };
        for message in [before, channels.advertise()] {
            self.shared.sender.send(Told::Channels(message.to_string().into())).ok();
        }
    }
}

/// Whether a page of this origin may connect.
fn may_ask(origin: &str, named: &[String]) -> bool {
    let of_this_machine = ["http://", "https://"]
        .into_iter()
        .any(|scheme| origin.strip_prefix(scheme).is_some_and(|host| loopback(host).is_some()));
    of_this_machine || ORIGINS.contains(&origin) || named.iter().any(|name| name == origin)
}

fn refusal(headers: &HeaderMap, shared: &Shared) -> Option<&'static str> {
    // A foreign host name that somebody points at this address must not pass for this machine.
    if shared.is_local && local_host(headers).is_none() {
        return Some("only this machine may connect, by its own name\n");
    }
    let is_allowed = comes_from(headers, |origin| may_ask(origin, &shared.origins));
    (!is_allowed)
        .then_some("pages of this origin may not connect: allow it with `inerter monitor --foxglove-origin ORIGIN`\n")
}

async fn live(
    State(shared): State<Arc<Shared>>,
    Extension(place): Extension<Place>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if let Some(words) = refusal(&headers, &shared) {
        return (StatusCode::FORBIDDEN, words).into_response();
    }
    let upgrade = limited(upgrade.protocols(PROTOCOLS), MOST_FROM_CLIENT);
    if upgrade.selected_protocol().is_none() {
        return (StatusCode::BAD_REQUEST, "the WebSocket subprotocol foxglove.sdk.v1 is needed\n").into_response();
    }
    upgrade.on_upgrade(move |socket| async move {
        talk(socket, shared, place).await;
    })
}

/// What a client requests.
#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum Asked {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: u32,
}

/// Announces the channels to a client, then sends messages on its subscriptions until either end is gone.
async fn talk(mut socket: WebSocket, shared: Arc<Shared>, _place: Place) -> Option<()> {
    let (advertised, mut receiver) = {
        // Channels do not change while this is held.
        let channels = locked(&shared.channels);
        (channels.advertise(), shared.sender.subscribe())
    };
    let info = json!({
        "op": "serverInfo", "name": "instrumented inerter", "capabilities": [], "supportedEncodings": [],
        "metadata": {}, "sessionId": shared.session,
    });
    for message in [info, advertised] {
        send(&mut socket, Message::Text(message.to_string().into())).await?;
    }
    // Channel by subscription.
    let mut subscriptions: HashMap<u32, u32> = HashMap::new();
    loop {
        tokio::select! {
            told = receiver.recv() => {
                let messages: Vec<Message> = match told {
                    Ok(Told::Channels(text)) => vec![Message::Text(text)],
                    Ok(Told::Message { channel, unix_ns, payload }) => {
                        let wanted = subscriptions.iter().filter(|(_, of)| **of == channel);
                        wanted.map(|(id, _)| Message::Binary(data(*id, unix_ns, &payload))).collect()
                    }
                    // The client was too slow: the oldest messages are dropped.
                    Err(broadcast::error::RecvError::Lagged(_)) => continue,
                    Err(broadcast::error::RecvError::Closed) => return None,
                };
                for message in messages {
                    send(&mut socket, message).await?;
                }
            }
            asked = socket.recv() => match asked {
                Some(Ok(Message::Text(text))) => match serde_json::from_str(&text) {
                    Ok(Asked::Subscribe { subscriptions: new }) => {
                        let room = MOST_SUBSCRIPTIONS.saturating_sub(subscriptions.len());
                        subscriptions.extend(new.iter().take(room).map(|new| (new.id, new.channel_id)));
                    }
                    Ok(Asked::Unsubscribe { subscription_ids }) => {
                        subscriptions.retain(|id, _| !subscription_ids.contains(id));
                    }
                    // This server offers nothing else.
                    Ok(Asked::Other) | Err(_) => {}
                },
                Some(Ok(Message::Close(_)) | Err(_)) | None => return None,
                Some(Ok(_)) => {}
            },
        }
    }
}

/// A message encoded as the protocol requires.
fn data(subscription: u32, unix_ns: u64, payload: &[u8]) -> Bytes {
    [&[MESSAGE_DATA], &subscription.to_le_bytes()[..], &unix_ns.to_le_bytes(), payload].concat().into()
}

fn property(kind: &str, label: &str, unit: &str) -> Value {
    let description = if unit.is_empty() { label.to_string() } else { format!("{label} [{unit}]") };
    json!({ "type": kind, "description": description.trim() })
}

fn plain(list: &[(&str, &str, &str)]) -> Map<String, Value> {
    list.iter().map(|(name, kind, unit)| (name.to_string(), property(kind, "", unit))).collect()
}

/// Keys are those of a linear machine; they are renamed on output.
fn fields(machine: Machine, group: Group) -> Map<String, Value> {
    let of = |(linear, field): (&Field, &Field)| (linear.path.to_string(), property("number", field.label, field.unit));
    catalogue::fields(Machine::Linear, group).zip(catalogue::fields(machine, group)).map(of).collect()
}

/// Value, interval and status of each parameter and of the backlash; docs/CLI.md lists further keys.
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
    map.insert("t_s".into(), property("number", "Time since the estimator started", "s"));
    let residual = catalogue::find(machine, Group::Estimate, "residual_rms_n");
    map.extend(residual.map(|field| ("residual_rms_n".to_string(), property("number", field.label, field.unit))));
    map.insert("moving".into(), property("boolean", "", ""));
    map
}

impl Viewer for Foxglove {
    fn show(&mut self, item: &Item) -> Result<(), Error> {
        let settings = self.settings;
        let machine = settings.machine;
        let json = || item.json(&settings).unwrap_or_default();
        match item {
            Item::Device { settings, .. } | Item::Settings(settings) => {
                if settings.machine != machine {
                    self.turn_to(settings.machine);
                }
                self.settings = *settings;
            }
            Item::Samples(samples) => {
                for sample in samples {
                    self.latest = sample.at;
                    self.send(Topic::Samples, sample.at, || {
                        machine_json_line(
                            machine,
                            &json!({
                                "t_s": sample.at.run_s, "position_m": sample.position_m, "force_n": sample.force_n,
                                "terminal_m": sample.terminal_m,
                            }),
                        )
                    });
                }
            }
            Item::Estimate { at, .. } => {
                self.latest = *at;
                self.send(Topic::Estimate, *at, json);
            }
            Item::Reversal { .. } => self.send(Topic::Reversal, self.latest, json),
            Item::Health(_) => self.send(Topic::Health, self.latest, json),
            Item::Event { at, .. } | Item::Cause { at, .. } => self.send(Topic::Event, *at, json),
            Item::Marker { at, text, .. } => {
                self.send(Topic::Marker, *at, || json_line(&json!({ "kind": "marker", "text": text })));
            }
            Item::Away { .. }
            | Item::Back { .. }
            | Item::Refused { .. }
            | Item::LostFrames(_)
            | Item::UnknownFrames(_) => {}
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use axum::http::header;

    use super::*;

    #[test]
    fn only_known_pages_may_connect() {
        let named = ["https://plots.example".to_string()];
        for origin in
            ["http://localhost:8080", "https://127.0.0.1", "http://[::1]:3000", "https://app.foxglove.dev", "file://"]
        {
            assert!(may_ask(origin, &[]), "{origin}");
        }
        for origin in [
            "https://plots.example",
            "http://localhost.evil.example",
            "https://evil.example",
            "null",
            "",
            "http://app.foxglove.dev",
            "https://app.foxglove.dev.evil.example",
            "localhost",
            "http://localhost:80, https://evil.example",
        ] {
            assert!(!may_ask(origin, &[]), "{origin}");
        }
        assert!(may_ask("https://plots.example", &named));
    }

    #[test]
    fn a_name_that_is_made_to_point_here_is_refused() {
        let (sender, _) = broadcast::channel(1);
        let shared = |is_local| Shared {
            channels: Mutex::new(Channels { first: 1, machine: Machine::Linear }),
            sender: sender.clone(),
            session: String::new(),
            origins: Vec::new(),
            is_local,
        };
        let host: HeaderMap = [(header::HOST, "evil.example:8765".parse().unwrap())].into_iter().collect();
        assert!(refusal(&host, &shared(true)).is_some());
        assert!(refusal(&host, &shared(false)).is_none(), "a machine has names of its own elsewhere");
        let page = [(header::HOST, "127.0.0.1:8765"), (header::ORIGIN, "https://evil.example")];
        let page: HeaderMap = page.into_iter().map(|(name, value)| (name, value.parse().unwrap())).collect();
        assert!(refusal(&page, &shared(true)).is_some() && refusal(&page, &shared(false)).is_some());
    }
}
