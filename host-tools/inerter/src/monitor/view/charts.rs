//! Charts over time: signals as the range of their values, parameters with their intervals.

use inerter_data::words::interval_text;
use inerter_wire::catalogue::{self, Group};
use ratatui::{
    Frame,
    layout::{Constraint, Layout, Rect},
    style::Style,
    symbols::Marker,
    text::{Line, Span},
    widgets::{Axis, Chart, Dataset, GraphType},
};

use super::Theme;
use crate::monitor::{state::State, trace::Signal};

/// Minimum number of rows for a chart.
const CHART_ROWS: u16 = 6;

/// Force and displacements, one below the other.
pub fn signals(frame: &mut Frame<'_>, area: Rect, state: &State, theme: Theme) {
    let mut list = vec![(Signal::Force, "force_n"), (Signal::Position, "position_m")];
    if state.settings.terminal_sensor {
        list.push((Signal::Terminal, "terminal_m"));
    }
    list.truncate(usize::from(area.height / CHART_ROWS).max(1));
    let areas = Layout::vertical(list.iter().map(|_| Constraint::Fill(1))).split(area);
    for ((signal, path), area) in list.into_iter().zip(areas.iter()) {
        trace(frame, *area, state, theme, signal, path);
    }
}

/// One signal over the time on view.
pub fn trace(frame: &mut Frame<'_>, area: Rect, state: &State, theme: Theme, signal: Signal, path: &str) {
    let field = catalogue::find(state.settings.machine, Group::Signal, path);
    let unit = catalogue::unit(state.settings.machine, if signal == Signal::Force { "N" } else { "mm" });
    let title = format!("{} [{unit}]", field.map_or("", |field| field.label));
    let (end_s, span_s) = (state.end_s(), state.trace_span_s());
    let from_s = end_s - span_s;
    // A Braille cell is two dots wide.
    let columns = usize::from(area.width).saturating_mul(2);
    let window = state.traces.window(from_s, end_s, columns);
    let mut pieces: Vec<Vec<(f64, f64)>> = Vec::new();
    let mut before_s = f64::NEG_INFINITY;
    for bucket in &window {
        let Some((low, high)) = bucket.range(signal) else { continue };
        // Nothing is drawn across a gap wider than a column.
        if bucket.start_s - before_s > 2.5 * span_s / columns.max(1) as f64 + 2.0 / state.settings.sample_rate_hz {
            pieces.push(Vec::new());
        }
        before_s = bucket.end_s;
        if let Some(piece) = pieces.last_mut() {
            // Start with the end nearer to the previous point, so that two columns are not joined by a false edge.
            let rising = piece.last().is_none_or(|(_, last)| (last - low).abs() <= (last - high).abs());
            let (first, second) = if rising { (low, high) } else { (high, low) };
            let x = bucket.start_s - end_s;
            piece.extend([(x, first), (x, second)]);
        }
    }
    let curves = pieces.iter().map(|piece| (piece.as_slice(), theme.curve())).collect();
    plot(frame, area, state, theme, Plot { title, curves, span_s });
}

/// The four parameters and the backlash, each with its band.
pub fn parameters(frame: &mut Frame<'_>, area: Rect, state: &State, theme: Theme) {
    let parameters = catalogue::fields(state.settings.machine, Group::Parameter).map(|field| (field.label, field.unit));
    let all: Vec<(&str, &str)> =
        parameters.chain([("Backlash", catalogue::unit(state.settings.machine, "µm"))]).collect();
    let across = if area.width >= 76 { 2 } else { 1 };
    let down = all.len().div_ceil(across).min(usize::from(area.height / CHART_ROWS).max(1));
    let rows = Layout::vertical((0..down).map(|_| Constraint::Fill(1))).split(area);
    for (row, (list, row_area)) in all.chunks(across).zip(rows.iter()).enumerate() {
        let areas = Layout::horizontal(list.iter().map(|_| Constraint::Fill(1))).split(*row_area);
        for (column, ((label, unit), area)) in list.iter().zip(areas.iter()).enumerate() {
            parameter(frame, *area, state, theme, row * across + column, label, unit);
        }
    }
}

/// One parameter over time.
pub fn parameter(
    frame: &mut Frame<'_>,
    area: Rect,
    state: &State,
    theme: Theme,
    quantity: usize,
    label: &str,
    unit: &str,
) {
    let (end_s, span_s) = (state.end_s(), state.history_span_s());
    let entries = state.history.since(end_s - span_s);
    let entries = entries.iter().take_while(|entry| entry.run_s <= end_s);
    let known: Vec<(f64, f64, f64)> = entries
        .filter_map(|entry| {
            let (value, u95) = entry.points.get(quantity)?.known()?;
            Some((entry.run_s - end_s, value, u95))
        })
        .collect();
    // Draw no more points than there are dots.
    let step = known.len().div_ceil(usize::from(area.width).max(1) * 2).max(1);
    // The last one must stay: the title shows its value.
    let thinned: Vec<(f64, f64, f64)> = known.iter().rev().step_by(step).rev().copied().collect();
    let title = match known.last() {
        Some((_, value, u95)) => format!("{label} {} {unit}", interval_text(*value, *u95)),
        None => format!("{label}: not identifiable"),
    };
    let curve = |y: fn(f64, f64) -> f64| -> Vec<(f64, f64)> {
        thinned.iter().map(|(x, value, u95)| (*x, y(*value, *u95))).collect()
    };
    let (low, high) = (curve(|value, u95| value - u95), curve(|value, u95| value + u95));
    let values = curve(|value, _| value);
    let curves = vec![(&*low, theme.band()), (&*high, theme.band()), (&*values, theme.curve())];
    plot(frame, area, state, theme, Plot { title, curves, span_s });
}

/// Contents of a chart; times count from its right end.
struct Plot<'a> {
    title: String,
    curves: Vec<(&'a [(f64, f64)], Style)>,
    span_s: f64,
}

fn plot(frame: &mut Frame<'_>, area: Rect, state: &State, theme: Theme, plot: Plot<'_>) {
    let Plot { title, curves, span_s } = plot;
    let title = Line::styled(format!(" {title} "), theme.title());
    // Smaller areas have no room for axes.
    if area.height < 4 || area.width < 16 {
        frame.render_widget(title, area);
        return;
    }
    let values = curves.iter().flat_map(|(points, _)| points.iter().map(|(_, y)| *y));
    let [low, high] = bounds(values);
    let end_s = state.end_s();
    let marks: Vec<[(f64, f64); 2]> = state
        .marks
        .iter()
        .map(|(at_s, _)| at_s - end_s)
        .filter(|x| (-span_s..=0.0).contains(x))
        .map(|x| [(x, low), (x, high)])
        .collect();
    let line = |points, style| {
        Dataset::default().marker(Marker::Braille).graph_type(GraphType::Line).data(points).style(style)
    };
    let marked = marks.iter().map(|points| line(points.as_slice(), theme.doubtful()));
    let datasets = marked.chain(curves.iter().map(|(points, style)| line(points, *style))).collect();
    let right = if state.paused.is_some() { format!("{end_s:.2} s") } else { "now".into() };
    let ago = |s: f64| if s >= 120.0 { format!("-{:.0} min", s / 60.0) } else { format!("-{s} s") };
    let x_labels = [ago(span_s), ago(span_s / 2.0), right].map(|text| Span::styled(text, theme.quiet()));
    let y_labels = [low, (low + high) / 2.0, high].map(|y| Span::raw(number(y, high - low)));
    let chart = Chart::new(datasets)
        .block(theme.block(title))
        .legend_position(None)
        .x_axis(Axis::default().bounds([-span_s, 0.0]).labels(x_labels).style(theme.quiet()))
        .y_axis(Axis::default().bounds([low, high]).labels(y_labels).style(theme.quiet()));
    frame.render_widget(chart, area);
}

/// Bounds that contain all values, rounded so that they do not change with every value.
fn bounds(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let (low, high) = values
        .filter(|value| value.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return [-1.0, 1.0];
    }
    let extent = (high - low).max(high.abs().max(low.abs()) * 1e-6).max(1e-12);
    let decade = 10f64.powf((extent / 2.0).log10().floor());
    let step = if extent / decade > 8.0 { decade } else { decade / 2.0 };
    let (low, high) = ((low / step).floor() * step, (high / step).ceil() * step);
    if high > low { [low, high] } else { [low - step, high + step] }
}

/// A label with enough digits to distinguish it from its neighbours.
fn number(value: f64, extent: f64) -> String {
    let decimals = (1.0 - extent.max(1e-12).log10().floor()).max(0.0) as usize;
    if decimals > 6 && value != 0.0 {
        let exponent = value.abs().log10().floor() as i32;
        return format!("{value:>7.*e}", (decimals as i32 + exponent).max(0) as usize);
    }
    let decimals = decimals.min(6);
    // Avoids "-0.0".
    let text = format!("{value:>7.decimals$}");
    if text.contains(|letter: char| ('1'..='9').contains(&letter)) { text } else { text.replace('-', " ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_hold_everything_and_are_round() {
        assert_eq!(bounds([].into_iter()), [-1.0, 1.0]);
        assert_eq!(bounds([0.12, 9.7, f64::NAN].into_iter()), [0.0, 10.0]);
        assert_eq!(bounds([-431.0, 389.0].into_iter()), [-500.0, 400.0]);
        for value in [0.0, 95.0, -1e-3, 1e6] {
            let [low, high] = bounds([value].into_iter());
            assert!(low <= value && value <= high && low < high, "{low} {high}");
        }
        assert_eq!(
            [number(2e-4, 4e-7), number(-2e-7, 1e-6), number(0.0, 1e-9)].map(|text| text.trim().to_string()),
            ["2.0000e-4", "-2e-7", "0.000000"]
        );
        assert_eq!([number(-0.0, 5.0), number(-12.34, 5.0)].map(|text| text.trim().to_string()), ["0.0", "-12.3"]);
    }
}
