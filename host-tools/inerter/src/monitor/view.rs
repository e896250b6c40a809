//! The screen: draws a [`State`] without changing it.
//!
//! Text from outside is drawn [`printable`]: ratatui leaves out control characters, but draws invisible ones and those
//! that change the writing direction.

mod charts;
mod panels;
mod theme;

pub use theme::Theme;

use inerter_data::words::{duration_text, printable};
use ratatui::{
    Frame,
    layout::{Constraint, Layout, Rect},
    style::{Modifier, Style},
    text::{Line, Span},
    widgets::{Clear, Paragraph, Tabs, Wrap},
};

use super::state::{Prompt, State, Tab};

/// Draws everything.
pub fn draw(frame: &mut Frame<'_>, state: &State, theme: Theme) {
    let [head, tabs, body, foot] =
        Layout::vertical([Constraint::Length(1), Constraint::Length(1), Constraint::Min(0), Constraint::Length(1)])
            .areas(frame.area());
    frame.render_widget(heading(state, theme), head);
    let titles = Tab::ALL.iter().enumerate().map(|(place, (_, title))| format!("{} {title}", place + 1));
    let selected = Tab::ALL.iter().position(|(tab, _)| *tab == state.tab);
    let highlight = Style::new().add_modifier(Modifier::REVERSED);
    frame.render_widget(Tabs::new(titles).select(selected).highlight_style(highlight).divider(" "), tabs);
    match state.tab {
        Tab::Overview => panels::overview(frame, body, state, theme),
        Tab::Signals => charts::signals(frame, body, state, theme),
        Tab::Parameters => charts::parameters(frame, body, state, theme),
        Tab::Health => panels::health(frame, body, state, theme),
        Tab::Events => panels::events(frame, body, state, theme),
    }
    frame.render_widget(footing(state, theme), foot);
    if state.prompt == Prompt::Help {
        help(frame, body, theme);
    }
}

fn heading(state: &State, theme: Theme) -> Line<'static> {
    let mut spans = Vec::new();
    if state.paused.is_some() {
        spans.push(Span::styled(" PAUSED ", Style::new().add_modifier(Modifier::REVERSED)));
        spans.push(Span::raw(" "));
    }
    if let Some(reason) = &state.away {
        spans.push(Span::styled(format!("{} ", printable(reason)), theme.bad()));
    }
    if let Some(file) = &state.recording {
        spans.push(Span::styled("● ", theme.bad()));
        spans.push(Span::raw(format!("{}  ", printable(file))));
    }
    match &state.present {
        Some(present) => {
            let hello = &present.hello;
            let name = format!("{} {}", printable(&hello.board), printable(&hello.serial));
            spans.push(Span::styled(name, theme.title()));
            spans.push(Span::raw(format!(
                "  {} Hz  {}  {}",
                state.settings.sample_rate_hz,
                duration_text(state.now_s),
                printable(&present.port)
            )));
        }
        None => spans.push(Span::raw("waiting for the device")),
    }
    Line::from(spans)
}

fn footing(state: &State, theme: Theme) -> Line<'static> {
    match &state.prompt {
        Prompt::Marker(text) => Line::from(vec![
            Span::styled("marker: ", theme.title()),
            Span::raw(printable(text).into_owned()),
            Span::styled("█", theme.curve()),
            Span::styled("   Enter sets it, Esc cancels", theme.quiet()),
        ]),
        Prompt::Reset => Line::styled(
            "forget all motion seen so far and restart the estimates? y: yes, any other key: no",
            theme.doubtful().add_modifier(Modifier::BOLD),
        ),
        Prompt::None | Prompt::Help => {
            Line::styled("q quit  ? keys  space pause  +/- zoom  Tab pane  m marker  r reset", theme.quiet())
        }
    }
}

fn help(frame: &mut Frame<'_>, body: Rect, theme: Theme) {
    let keys = [
        ("q, Esc", "quit"),
        ("1 to 5, Tab", "choose the pane"),
        ("space", "freeze the view; measuring and recording continue"),
        ("+ -", "more or less detail in time"),
        ("left, right", "back and forth in time"),
        ("m", "set a marker, with a text; kept in the recording"),
        ("r", "reset the estimator; asks first"),
        ("?", "this list"),
    ];
    let lines: Vec<Line<'_>> = keys
        .into_iter()
        .map(|(key, what)| Line::from(vec![Span::styled(format!("{key:<13}"), theme.title()), Span::raw(what)]))
        .collect();
    let (width, height) = (74.min(body.width), (lines.len() as u16 + 2).min(body.height));
    let area = Rect { x: body.x + (body.width - width) / 2, y: body.y + (body.height - height) / 2, width, height };
    frame.render_widget(Clear, area);
    frame.render_widget(Paragraph::new(lines).block(theme.block("Keys")).wrap(Wrap { trim: false }), area);
}

#[cfg(test)]
#[path = "view_tests.rs"]
mod tests;
