//! What the screen shows and how keys change it. Uses no terminal, no clock and no threads.

use std::collections::VecDeque;

use inerter_analysis::diagnose::{Cause, is_suspect};
use inerter_core::Settings;
use inerter_data::text::{event_words, is_trouble};
use inerter_wire::{Estimated, EventKind, Hello};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

use super::{
    causes,
    feed::Item,
    history::{Entry, History},
    losses::{Losses, UNKNOWN_FRAMES},
    trace::{Traces, keep},
};

/// Maximum number of stored event lines, and of markers.
const KEPT: usize = 500;
/// Maximum length of a marker's text.
const MARKER_LETTERS: usize = 200;
/// Spans of the signals' time axis \[s\].
pub const TRACE_SPANS_S: [f64; 11] = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0, 300.0, 1800.0];
/// Spans of the parameters' time axis \[s\]; the last one is the whole run.
pub const HISTORY_SPANS_S: [f64; 8] = [10.0, 30.0, 60.0, 300.0, 900.0, 3600.0, 14400.0, f64::INFINITY];

/// Which pane is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tab {
    /// The table, with the signals below.
    #[default]
    Overview,
    /// Force and displacements.
    Signals,
    /// Parameters over time.
    Parameters,
    /// Losses and health.
    Health,
    Events,
}

impl Tab {
    /// All of them with their titles, in order.
    pub const ALL: [(Self, &'static str); 5] = [
        (Self::Overview, "Overview"),
        (Self::Signals, "Signals"),
        (Self::Parameters, "Parameters"),
        (Self::Health, "Health"),
        (Self::Events, "Events"),
    ];

    fn step(self, by: usize) -> Self {
        let place = Self::ALL.iter().position(|(tab, _)| *tab == self).unwrap_or(0);
        Self::ALL.get((place + by) % Self::ALL.len()).map_or(self, |(tab, _)| *tab)
    }
}

/// What the keys currently mean.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Prompt {
    /// Keys are commands.
    #[default]
    None,
    /// Any key closes the list of keys.
    Help,
    /// The text of a marker so far.
    Marker(String),
    /// A yes-or-no question before a reset.
    Reset,
}

/// What the program should do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    Quit,
    /// Set a marker at the current time.
    Mark(String),
    /// Make the estimator forget all motion.
    ResetEstimator,
}

/// The connected device.
#[derive(Clone, Debug, PartialEq)]
pub struct Present {
    /// Port or address.
    pub port: String,
    pub hello: Hello,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Values {
    /// Time since the estimator started \[s\], and the estimate.
    pub estimate: Option<(f64, Estimated)>,
    /// The largest violation of the law, while there is one.
    pub cause: Option<Cause>,
    /// Losses and health.
    pub losses: Losses,
}

/// The kind of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineKind {
    /// Normal operation.
    Plain,
    Trouble,
    /// The user's own note.
    Marker,
}

/// A line in the list of events.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Time on the feed's timeline \[s\].
    pub run_s: f64,
    pub words: String,
    pub kind: LineKind,
}

/// Everything that the screen shows.
#[derive(Clone, Debug, Default)]
pub struct State {
    /// The connected device; `None` before the first one.
    pub present: Option<Present>,
    /// Why the device is away, while it is.
    pub away: Option<String>,
    /// Settings in use.
    pub settings: Settings,
    /// The latest numbers.
    pub values: Values,
    pub traces: Traces,
    /// Parameters over time.
    pub history: History,
    /// Events, oldest first.
    pub lines: VecDeque<Line>,
    /// Markers, oldest first.
    pub marks: VecDeque<(f64, String)>,
    /// Time of the latest item \[s\].
    pub now_s: f64,
    /// Time at which the view was paused, and the values at that time.
    pub paused: Option<(f64, Values)>,
    /// Which pane is shown.
    pub tab: Tab,
    /// Index into [`TRACE_SPANS_S`].
    pub trace_span: usize,
    /// Index into [`HISTORY_SPANS_S`].
    pub history_span: usize,
    /// What the keys mean.
    pub prompt: Prompt,
    /// The file being recorded to.
    pub recording: Option<String>,
    /// Addresses of the other views.
    pub elsewhere: Vec<String>,
}

impl State {
    /// The initial state.
    pub fn new(recording: Option<String>, elsewhere: Vec<String>) -> Self {
        Self { trace_span: 5, history_span: 2, recording, elsewhere, ..Self::default() }
    }

    /// The values to show: the latest, or those at the pause.
    pub fn shown(&self) -> &Values {
        self.paused.as_ref().map_or(&self.values, |(_, values)| values)
    }

    /// The right end of the time axes \[s\].
    pub fn end_s(&self) -> f64 {
        self.paused.as_ref().map_or(self.now_s, |(at_s, _)| *at_s)
    }

    /// Extent of the signals' time axis \[s\].
    pub fn trace_span_s(&self) -> f64 {
        TRACE_SPANS_S.get(self.trace_span).copied().unwrap_or(5.0)
    }

    /// Extent of the parameters' time axis \[s\]; the whole run if the last span is chosen.
    pub fn history_span_s(&self) -> f64 {
        let span_s = HISTORY_SPANS_S.get(self.history_span).copied().unwrap_or(60.0);
        if span_s.is_finite() { span_s } else { self.end_s().max(10.0) }
    }

    /// Takes an item from the device, or from the program.
    pub fn item(&mut self, item: &Item) {
        match item {
            Item::Device { port, hello, settings } => {
                self.use_settings(settings, self.present.is_none());
                self.values.losses.begin();
                self.present = Some(Present { port: port.clone(), hello: hello.clone() });
            }
            Item::Away { reason } => {
                self.line(self.now_s, reason.clone(), LineKind::Trouble);
                self.away = Some(reason.clone());
            }
            Item::Back { port } => {
                self.away = None;
                self.line(self.now_s, format!("the device is back at {port}"), LineKind::Plain);
            }
            Item::Settings(settings) => self.use_settings(settings, false),
            Item::Samples(samples) => {
                for sample in samples {
                    self.traces.push(sample);
                    self.now_s = self.now_s.max(sample.at.run_s);
                }
            }
            Item::Estimate { at, t_s, estimated } => {
                self.now_s = self.now_s.max(at.run_s);
                self.values.estimate = Some((*t_s, *estimated));
                self.values.cause.take_if(|_| !is_suspect(&estimated.law.unwrap_or_default()));
                self.history.push(Entry::new(at.run_s, estimated));
            }
            // The backlash itself comes with the estimates.
            Item::Reversal { .. } => {}
            Item::Health(health) => self.values.losses.health(*health),
            Item::Event { at, event, .. } => {
                if event.kind == EventKind::EstimatorReset {
                    self.values.estimate = None;
                }
                let kind = if is_trouble(&event.kind) { LineKind::Trouble } else { LineKind::Plain };
                self.line(at.run_s, event_words(self.settings.machine, &event.kind), kind);
            }
            Item::Cause { at, cause, .. } => {
                if self.values.cause.is_none_or(|before| cause.f > before.f) {
                    self.values.cause = Some(*cause);
                }
                self.line(at.run_s, causes::words(self.settings.machine, cause), LineKind::Trouble);
            }
            Item::LostFrames(count) => {
                self.values.losses.lost_frames = *count;
                self.line(self.now_s, "frames were lost on the way".into(), LineKind::Trouble);
            }
            Item::UnknownFrames(count) => {
                self.values.losses.unknown_frames = *count;
                self.line(self.now_s, UNKNOWN_FRAMES.into(), LineKind::Plain);
            }
            Item::Refused { words } => self.line(self.now_s, words.clone(), LineKind::Trouble),
            Item::Marker { at, text, .. } => {
                keep(&mut self.marks, KEPT, (at.run_s, text.clone()));
                self.line(at.run_s, format!("marker: {text}"), LineKind::Marker);
            }
        }
    }

    fn use_settings(&mut self, settings: &Settings, anew: bool) {
        if anew || settings.sample_rate_hz != self.settings.sample_rate_hz {
            self.traces = Traces::new(1.0 / settings.sample_rate_hz);
        }
        self.settings = *settings;
    }

    fn line(&mut self, run_s: f64, words: String, kind: LineKind) {
        // A bad line loses frames many times a second, so that one event line counts them.
        match self.lines.back_mut() {
            Some(last) if last.words == words => last.run_s = run_s,
            _ => keep(&mut self.lines, KEPT, Line { run_s, words, kind }),
        }
    }

    /// Takes a key press; returns what the program should do.
    pub fn key(&mut self, key: KeyEvent) -> Option<Action> {
        if key.modifiers.contains(KeyModifiers::CONTROL) {
            return (key.code == KeyCode::Char('c')).then_some(Action::Quit);
        }
        match std::mem::take(&mut self.prompt) {
            Prompt::None => self.command(key.code),
            Prompt::Help => None,
            Prompt::Reset => matches!(key.code, KeyCode::Char('y' | 'Y')).then_some(Action::ResetEstimator),
            Prompt::Marker(mut text) => {
                match key.code {
                    KeyCode::Esc => return None,
                    KeyCode::Enter => {
                        let text = text.trim();
                        return Some(Action::Mark(if text.is_empty() { "marker".into() } else { text.into() }));
                    }
                    KeyCode::Backspace => {
                        text.pop();
                    }
                    KeyCode::Char(letter) if !letter.is_control() && text.chars().count() < MARKER_LETTERS => {
                        text.push(letter);
                    }
                    _ => {}
                }
                self.prompt = Prompt::Marker(text);
                None
            }
        }
    }

    fn command(&mut self, code: KeyCode) -> Option<Action> {
        match code {
            KeyCode::Char('q') | KeyCode::Esc => return Some(Action::Quit),
            KeyCode::Char('?' | 'h') => self.prompt = Prompt::Help,
            KeyCode::Char('m') => self.prompt = Prompt::Marker(String::new()),
            KeyCode::Char('r') => self.prompt = Prompt::Reset,
            KeyCode::Char(' ') => {
                self.paused = self.paused.is_none().then_some((self.now_s, self.values));
            }
            KeyCode::Char('+' | '=') | KeyCode::Up => self.zoom(|place, _| place.saturating_sub(1)),
            KeyCode::Char('-' | '_') | KeyCode::Down => self.zoom(|place, count| (place + 1).min(count - 1)),
            KeyCode::Left => self.pan(-0.25),
            KeyCode::Right => self.pan(0.25),
            KeyCode::Tab => self.tab = self.tab.step(1),
            KeyCode::BackTab => self.tab = self.tab.step(Tab::ALL.len() - 1),
            KeyCode::Char(digit) => {
                let place = digit.to_digit(10).and_then(|digit| (digit as usize).checked_sub(1));
                if let Some((tab, _)) = place.and_then(|place| Tab::ALL.get(place)) {
                    self.tab = *tab;
                }
            }
            _ => {}
        }
        None
    }

    fn zoom(&mut self, to: impl Fn(usize, usize) -> usize) {
        match self.tab {
            Tab::Parameters => self.history_span = to(self.history_span, HISTORY_SPANS_S.len()),
            _ => self.trace_span = to(self.trace_span, TRACE_SPANS_S.len()),
        }
    }

    /// Moves the time axis of a paused view by a fraction of its extent.
    fn pan(&mut self, part: f64) {
        let span_s = if self.tab == Tab::Parameters { self.history_span_s() } else { self.trace_span_s() };
        let now_s = self.now_s;
        let (at_s, _) = self.paused.get_or_insert((now_s, self.values));
        *at_s = (*at_s + part * span_s).clamp(0.0, now_s);
    }
}

#[cfg(test)]
#[path = "state_tests.rs"]
mod tests;
