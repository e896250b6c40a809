//! `inerter monitor`: what a device measures, while it measures.

use std::{
    io::{self, IsTerminal},
    time::Instant,
};

use inerter::{
    Error,
    detail::GapJson,
    live::{Happening, Live},
    output,
    report::{self, EstimateJson, EventJson, event_words, health_json, json_line},
};
use inerter_core::Detail;
use inerter_wire::{EventKind, Frame, Record, Streams};
use serde_json::json;

use super::{
    args::{LinkArgs, TimeArgs},
    screen::{Screen, View},
    terminal::{self, note},
};

/// Show what a device measures, live.
///
/// Values with 95 % intervals, status, losses and health.
/// In a terminal one block is redrawn; otherwise one line per estimate is printed. With --json one object a line:
/// {"kind":"device",..} at the beginning and after each reconnection, {"kind":"estimate",..} as `inerter replay --json`
/// prints it, {"kind":"gap",..} for each reversal of the flanks, {"kind":"health",..} once a second,
/// {"kind":"event","code":..,"event":..}, {"kind":"link","lost_frames":..} when frames were lost.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    link: LinkArgs,
    #[command(flatten)]
    time: TimeArgs,
    /// Print JSON, one object a line
    #[arg(long)]
    json: bool,
    /// Print lines even in a terminal
    #[arg(long, conflicts_with = "json")]
    plain: bool,
}

/// How it is shown.
enum Style {
    Json,
    Lines,
    Screen(Screen),
}

pub fn run(args: &Args) -> Result<(), Error> {
    terminal::catch_interrupts();
    let streams = Streams { estimates: true, health: true, ..Streams::NONE };
    let mut live = Live::connect(args.link.target(), streams, args.time.wait)?;
    let mut style = match (args.json, args.plain || !io::stdout().is_terminal()) {
        (true, _) => Style::Json,
        (false, true) => Style::Lines,
        (false, false) => Style::Screen(Screen::default()),
    };
    let mut view = View::default();
    introduce(&live, &mut view, &mut style)?;
    let started = Instant::now();
    while !terminal::interrupted() && args.time.duration.is_none_or(|duration| started.elapsed() < duration) {
        match live.next() {
            Ok(Happening::Received(received)) => show(received.frame, &live, &mut view, &mut style)?,
            Ok(Happening::Quiet) => publish(None, &mut view, &mut style)?,
            Ok(Happening::Away { reason }) => {
                publish(None, &mut view, &mut style)?;
                view.message =
                    Some(format!("{reason}; waiting {} s for it to come back", args.time.wait.as_secs_f64()));
                tell(&view, &mut style)?;
            }
            Ok(Happening::Back) => {
                introduce(&live, &mut view, &mut style)?;
                view.message = Some(back(&view.port));
                tell(&view, &mut style)?;
            }
            Err(error) => return Err(error.into()),
        }
        output::flush()?;
    }
    Ok(())
}

/// Says who is there.
fn introduce(live: &Live, view: &mut View, style: &mut Style) -> Result<(), Error> {
    let Some(device) = live.device() else { return Ok(()) };
    let (hello, settings) = (device.hello(), device.settings());
    view.device = format!("{}, serial {}, {} Hz, {}", hello.board, hello.serial, hello.sample_rate_hz, hello.firmware);
    view.port = device.name().into();
    view.before = None;
    view.settings = *settings;
    match style {
        Style::Json => output::line(json_line(&json!({
            "kind": "device", "port": device.name(), "board": hello.board.as_str(), "serial": hello.serial.as_str(),
            "firmware": hello.firmware.as_str(), "sample_rate_hz": hello.sample_rate_hz,
            "wire_version": hello.wire_version,
        })))?,
        Style::Lines => {
            terminal::say(format!("{} at {}", view.device, view.port));
            output::line(report::row_header())?;
        }
        Style::Screen(screen) => screen.draw(view)?,
    }
    Ok(())
}

fn show(frame: Frame<Record>, live: &Live, view: &mut View, style: &mut Style) -> Result<(), Error> {
    let lost_before = std::mem::replace(&mut view.lost_frames, live.lost_frames());
    if view.lost_frames > lost_before {
        match style {
            Style::Json => output::line(json_line(&json!({ "kind": "link", "lost_frames": view.lost_frames })))?,
            Style::Lines => note(format!("{} lost on the way so far", report::plural(view.lost_frames, "frame"))),
            Style::Screen(_) => {}
        }
    }
    let Frame::Message { message, .. } = frame else { return Ok(()) };
    match message {
        Record::Estimate(estimate) => {
            publish(None, view, style)?;
            view.waiting = Some(estimate);
        }
        Record::Detail(detail) if view.waiting.is_some_and(|estimate| estimate.index == detail.index) => {
            publish(Some(detail), view, style)?;
        }
        Record::Gap(gap) => {
            if let Style::Json = style {
                publish(None, view, style)?;
                let t_s = view.time_of(gap.index);
                output::line(json_line(&GapJson::new(t_s, &gap)))?;
            }
        }
        Record::Health(health) => {
            let told = view.problems();
            view.before.get_or_insert((health.dropped_frames, health.bad_frames));
            view.health = Some(health);
            match style {
                Style::Json => output::line(json_line(&health_json(&health)))?,
                Style::Lines => {
                    view.problems().filter(|problems| Some(problems) != told.as_ref()).iter().for_each(note)
                }
                Style::Screen(screen) => screen.draw(view)?,
            }
        }
        Record::Event(event) => {
            if let Style::Json = style {
                output::line(json_line(&EventJson::new(view.time_of(event.index), event.index, &event.kind)))?;
                return Ok(());
            }
            let words = event_words(&event.kind);
            match event.kind {
                EventKind::Changed(_) => view.change = Some(words.clone()),
                EventKind::EstimatorReset => (view.change, view.detail) = (None, None),
                _ => {}
            }
            view.message = Some(words);
            tell(view, style)?;
        }
        _ => {}
    }
    Ok(())
}

/// Shows the estimate that waits for its detail, which an older firmware does not send and a bad line may lose.
fn publish(detail: Option<Detail>, view: &mut View, style: &mut Style) -> Result<(), Error> {
    let Some(estimate) = view.waiting.take() else { return Ok(()) };
    let t_s = report::elapsed_s(&estimate, view.settings.sample_rate_hz);
    (view.estimate, view.detail, view.message) = (Some((t_s, estimate)), detail, None);
    match style {
        Style::Json => {
            output::line(json_line(&EstimateJson::live(t_s, &estimate, detail.as_ref(), &view.settings)))?;
        }
        Style::Lines => output::line(report::row(t_s, &estimate, detail.as_ref()))?,
        Style::Screen(screen) => screen.draw(view)?,
    }
    Ok(())
}

fn back(port: &str) -> String {
    format!("the device is back at {port}")
}

/// Shows the view's message.
fn tell(view: &View, style: &mut Style) -> Result<(), Error> {
    match style {
        Style::Json | Style::Lines => view.message.iter().for_each(note),
        Style::Screen(screen) => screen.draw(view)?,
    }
    Ok(())
}
