//! `inerter monitor` without a screen: a line per estimate, or JSON.

use inerter_core::{Machine, Settings};
use inerter_data::{
    json::rounded_s,
    json::{EstimateJson, EventJson, ReversalJson, health_json, json_line, machine_json_line},
    output,
    text::{self, event_words},
    words::plural,
};
use serde_json::json;

use super::terminal::{self, note};
use crate::{
    Error,
    monitor::{
        causes,
        feed::Item,
        hub::Viewer,
        losses::{Losses, UNKNOWN_FRAMES},
    },
};

/// One object a line.
#[derive(Default)]
pub struct Json {
    settings: Settings,
}

impl Viewer for Json {
    fn show(&mut self, item: &Item) -> Result<(), Error> {
        let line = match item {
            Item::Device { port, hello, settings } => {
                self.settings = *settings;
                json_line(&json!({
                    "kind": "device", "port": port, "board": hello.board.as_str(), "serial": hello.serial.as_str(),
                    "firmware": hello.firmware.as_str(), "sample_rate_hz": hello.sample_rate_hz,
                    "wire_version": hello.wire_version,
                }))
            }
            Item::Settings(settings) => {
                self.settings = *settings;
                return Ok(());
            }
            Item::Away { reason: words } | Item::Refused { words } => {
                note(words);
                return Ok(());
            }
            Item::Back { port } => {
                note(back(port));
                return Ok(());
            }
            Item::Samples(_) => return Ok(()),
            Item::Estimate { t_s, estimated, .. } => {
                machine_json_line(self.settings.machine, &EstimateJson::live(*t_s, estimated, &self.settings))
            }
            Item::Reversal { t_s, reversal } => {
                machine_json_line(self.settings.machine, &ReversalJson::new(*t_s, reversal))
            }
            Item::Health(health) => json_line(&health_json(health)),
            Item::Event { t_s, event, .. } => {
                let machine = self.settings.machine;
                machine_json_line(machine, &EventJson::new(*t_s, event.index, &event.kind, machine))
            }
            Item::Cause { t_s, index, cause, .. } => {
                json_line(&EventJson::cause(*t_s, *index, cause.kind.name(), cause.sentence(self.settings.machine)))
            }
            Item::LostFrames(count) => json_line(&json!({ "kind": "link", "lost_frames": count })),
            Item::UnknownFrames(count) => json_line(&json!({ "kind": "link", "unknown_frames": count })),
            Item::Marker { t_s, text, .. } => {
                json_line(&json!({ "kind": "marker", "t_s": t_s.map(rounded_s), "text": text }))
            }
        };
        output::line(line)?;
        Ok(output::flush()?)
    }
}

/// A line per estimate; all else as notes.
#[derive(Default)]
pub struct Lines {
    losses: Losses,
    machine: Machine,
}

impl Viewer for Lines {
    fn show(&mut self, item: &Item) -> Result<(), Error> {
        match item {
            Item::Device { port, hello, settings } => {
                self.losses.begin();
                self.machine = settings.machine;
                terminal::say(format!(
                    "{}, serial {}, {} Hz, {} at {port}",
                    hello.board, hello.serial, hello.sample_rate_hz, hello.firmware
                ));
                output::line(text::row_header(self.machine))?;
                output::flush()?;
            }
            Item::Estimate { t_s, estimated, .. } => {
                output::line(text::row(*t_s, estimated))?;
                output::flush()?;
            }
            Item::Health(health) => {
                let told = self.losses.problems();
                self.losses.health(*health);
                self.losses.problems().filter(|problems| Some(problems) != told.as_ref()).iter().for_each(note);
            }
            Item::LostFrames(count) => note(format!("{} lost on the way so far", plural(*count, "frame"))),
            Item::UnknownFrames(count) => {
                if self.losses.unknown_frames == 0 {
                    note(UNKNOWN_FRAMES);
                }
                self.losses.unknown_frames = *count;
            }
            Item::Event { event, .. } => note(event_words(self.machine, &event.kind)),
            Item::Cause { cause, .. } => note(causes::words(self.machine, cause)),
            Item::Marker { text, .. } => note(format!("marker: {text}")),
            Item::Away { reason: words } | Item::Refused { words } => note(words),
            Item::Back { port } => note(back(port)),
            Item::Settings(settings) => self.machine = settings.machine,
            Item::Samples(_) | Item::Reversal { .. } => {}
        }
        Ok(())
    }
}

fn back(port: &str) -> String {
    format!("the device is back at {port}")
}
