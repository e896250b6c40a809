//! Text panes: the table with its status, losses and health, and the events.

use inerter_core::Parameter;
use inerter_data::{
    json::{BacklashJson, Shown},
    text::{self, value_text},
    words::{code, duration_text, printable},
};
use inerter_wire::{Estimated, catalogue};
use ratatui::{
    Frame,
    layout::{Constraint, Layout, Rect},
    style::Style,
    text::{Line, Span},
    widgets::{Cell, Paragraph, Row, Table, Wrap},
};

use super::{Theme, charts};
use crate::monitor::{
    causes,
    state::{LineKind, State, Values},
    trace::Signal,
};

/// Minimum rows for the signals in the overview.
const ROOM_FOR_SIGNALS: u16 = 6;

/// The table, and the force below or beside it.
pub fn overview(frame: &mut Frame<'_>, area: Rect, state: &State, theme: Theme) {
    let rows = rows(state, theme);
    let height = rows.len() as u16 + 3;
    let words = words(state, theme);
    // If there is not room for everything, the table has priority.
    let word_rows = area
        .height
        .saturating_sub(height)
        .min(3 + 2 * u16::from(state.shown().cause.is_some()) + state.elsewhere.len() as u16);
    let [top, middle, bottom] =
        Layout::vertical([Constraint::Max(height), Constraint::Length(word_rows), Constraint::Fill(1)]).areas(area);
    let title = match state.shown().estimate {
        Some((t_s, Estimated { estimate, law, .. })) => {
            let motion = if estimate.moving { "moving" } else { "at rest" };
            let residual = text::residual_text(state.settings.machine, &estimate);
            let law = law.map(|law| {
                let ratio = law.misfit.map(|misfit| format!(" ({:.1} times explained)", misfit.ratio));
                format!(", law {}{}", code(&law.status), ratio.unwrap_or_default())
            });
            let law = law.unwrap_or_default();
            format!(" {}, {motion}, residual {residual}{law} ", duration_text(t_s))
        }
        None => " waiting for the first estimate ".into(),
    };
    let memory = format!("last {} s", state.settings.memory_s);
    let head = Row::new(["", "", memory.as_str(), "status", "whole run"]).style(theme.quiet());
    // Label, unit, memory, status, whole run; a narrow terminal shows only the essential columns.
    let (widths, spacing) = if area.width < 60 { ([21, 0, 17, 0, 0], 0) } else { ([20, 5, 17, 16, 16], 1) };
    let widths = widths.map(Constraint::Length);
    frame.render_widget(Table::new(rows, widths).column_spacing(spacing).header(head).block(theme.block(title)), top);
    frame.render_widget(Paragraph::new(words).wrap(Wrap { trim: true }), middle);
    if bottom.height < ROOM_FOR_SIGNALS {
        return;
    }
    let halves = [Constraint::Fill(1); 2];
    let areas = if area.width >= 110 {
        Layout::horizontal(halves).split(bottom)
    } else if bottom.height >= 2 * ROOM_FOR_SIGNALS {
        Layout::vertical(halves).split(bottom)
    } else {
        [bottom].into()
    };
    // In one area, the force alone.
    for ((signal, path), area) in [(Signal::Force, "force_n"), (Signal::Position, "position_m")].iter().zip(&*areas) {
        charts::trace(frame, *area, state, theme, *signal, path);
    }
}

/// The table's rows: parameters, backlash, and the terminal sensor's value.
fn rows(state: &State, theme: Theme) -> Vec<Row<'static>> {
    let Estimated { estimate, detail, .. } =
        &state.shown().estimate.map(|(_, estimated)| estimated).unwrap_or_default();
    let whole = catalogue::parameters(state.settings.machine, &estimate.whole_run);
    let mut rows: Vec<Row<'static>> = catalogue::parameters(state.settings.machine, &estimate.recent)
        .zip(whole)
        .map(|((field, recent), (_, whole))| {
            row(field.label, field.unit, number(&recent), status(Shown::of(field, &recent), theme), number(&whole))
        })
        .collect();
    let Some(detail) = detail else { return rows };
    let backlash = BacklashJson::from(detail.backlash);
    let text = text::backlash_text(&detail.backlash);
    let (style, word, value, reason) = match (backlash.reason, backlash.status) {
        (Some(_), _) => (theme.quiet(), "not identifiable", "-".into(), text),
        (None, "not_identifiable") => (theme.quiet(), "not identifiable", "-".into(), String::new()),
        (None, "ok") => (theme.good(), "ok", text, String::new()),
        (None, _) => (theme.doubtful(), "maybe none", text.replace(" (maybe none)", ""), String::new()),
    };
    // The backlash belongs to the whole run; the other column has room for the reason if there is none.
    rows.push(row("Backlash", catalogue::unit(state.settings.machine, "µm"), reason, Span::styled(word, style), value));
    if state.settings.terminal_sensor {
        rows.extend(catalogue::contact(state.settings.machine, detail).map(|(field, parameter)| {
            row(field.label, field.unit, String::new(), status(Shown::of_size(&parameter), theme), number(&parameter))
        }));
    }
    rows
}

fn row(label: &'static str, unit: &'static str, recent: String, status: Span<'static>, whole: String) -> Row<'static> {
    Row::new([Cell::from(label), Cell::from(unit), Cell::from(recent), Cell::from(status), Cell::from(whole)])
}

/// Value ± U95; the status stands in its own column.
fn number(parameter: &Parameter) -> String {
    match Shown::of_offset(parameter) {
        Shown::NotIdentifiable => "-".into(),
        _ => value_text(parameter).replace(" (held)", ""),
    }
}

fn status(shown: Shown, theme: Theme) -> Span<'static> {
    let (word, style) = match shown {
        Shown::Ok => ("ok", theme.good()),
        Shown::BelowU95 => ("maybe none", theme.doubtful()),
        Shown::Held => ("held", theme.doubtful()),
        Shown::NotIdentifiable => ("not identifiable", theme.quiet()),
    };
    Span::styled(word, style)
}

/// Losses, the device's health, and the addresses of the other views.
fn words(state: &State, theme: Theme) -> Vec<Line<'static>> {
    let Values { estimate, cause, losses } = state.shown();
    let machine = state.settings.machine;
    let style = if losses.is_clean() { theme.good() } else { theme.bad() };
    let mut lines = vec![Line::styled(losses.line(), style)];
    lines.extend(estimate.map(|(_, estimated)| Line::raw(text::line(machine, &estimated))));
    lines.extend(cause.iter().map(|cause| Line::styled(causes::words(machine, cause), theme.bad())));
    lines.extend(state.elsewhere.iter().map(|place| Line::styled(printable(place).into_owned(), theme.quiet())));
    lines
}

/// Everything that the device reports about itself.
pub fn health(frame: &mut Frame<'_>, area: Rect, state: &State, theme: Theme) {
    let losses = &state.shown().losses;
    let Some(health) = losses.health else {
        frame.render_widget(Paragraph::new("no report yet").block(theme.block(" Health ")), area);
        return;
    };
    let plain = |field: &str, value: Option<f64>| match (field, value) {
        (_, None) => "not known".to_string(),
        ("cpu_load_permille", Some(value)) => format!("{:.1} %", value / 10.0),
        ("temperature_c", Some(value)) => format!("{value:.1} °C"),
        ("uptime_s", Some(value)) => duration_text(value),
        (_, Some(value)) => format!("{value}"),
    };
    let on_the_way = [
        Row::new(["Frames lost on the way".to_string(), losses.lost_frames.to_string()]),
        Row::new(["Frames of unknown kind left out".to_string(), losses.unknown_frames.to_string()]),
    ];
    let rows = catalogue::health(&health).map(|(field, value)| {
        let is_loss = match field.path {
            "lost_samples" | "discontinuities" | "overruns" | "saturated" => true,
            // Losses before this program connected are not ours.
            "dropped_frames" | "bad_frames" => !losses.is_clean(),
            _ => false,
        };
        let style = if is_loss && value.is_some_and(|value| value > 0.0) { theme.bad() } else { theme.title() };
        Row::new([Cell::from(field.label), Cell::from(Span::styled(plain(field.path, value), style))])
    });
    let rows: Vec<Row<'_>> = on_the_way.into_iter().chain(rows).collect();
    let mut lines: Vec<Line<'static>> = Vec::new();
    if let Some(present) = &state.present {
        let hello = &present.hello;
        let (firmware, board) = (printable(&hello.firmware), printable(&hello.board));
        lines.push(Line::raw(format!("{firmware}, {board}, clock: {:?}", hello.clock)));
    }
    lines.extend(state.elsewhere.iter().map(|place| Line::raw(printable(place).into_owned())));
    let [top, bottom] = Layout::vertical([Constraint::Length(rows.len() as u16 + 2), Constraint::Fill(1)]).areas(area);
    let title = if losses.is_clean() { " Nothing lost or saturated " } else { " Losses " };
    let widths = [Constraint::Length(36), Constraint::Fill(1)];
    frame.render_widget(Table::new(rows, widths).block(theme.block(title)), top);
    frame.render_widget(Paragraph::new(lines).wrap(Wrap { trim: true }), bottom);
}

/// Events, the latest at the bottom.
pub fn events(frame: &mut Frame<'_>, area: Rect, state: &State, theme: Theme) {
    let room = usize::from(area.height.saturating_sub(2));
    let skip = state.lines.len().saturating_sub(room);
    let lines: Vec<Line<'_>> = state
        .lines
        .iter()
        .skip(skip)
        .map(|line| {
            let style = match line.kind {
                LineKind::Plain => Style::new(),
                LineKind::Trouble => theme.bad(),
                LineKind::Marker => theme.doubtful(),
            };
            Line::from(vec![
                Span::styled(format!("{:>10.2} s  ", line.run_s), theme.quiet()),
                Span::styled(printable(&line.words), style),
            ])
        })
        .collect();
    let lines = if lines.is_empty() { vec![Line::styled("nothing yet", theme.quiet())] } else { lines };
    frame.render_widget(Paragraph::new(lines).block(theme.block(" Events ")), area);
}
