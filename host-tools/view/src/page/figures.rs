//! The figures of a page.

use std::f64::consts::PI;

use inerter_core::{Interval, Machine};
use inerter_data::{
    names::description,
    text::{backlash_text, force_text, value_text},
    words::{interval_text, plural},
};
use inerter_wire::{
    Estimated,
    catalogue::{self, Group},
};

use super::{
    Content, PageError,
    bode::bode,
    layout::{LOW_PX, Made, TALL_PX},
};
use crate::figure::{Axis, Colour, Figure, Layer, Panel, Shape, Stroke, ends};
use inerter_analysis::rows::Row;

/// The kind of figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Force and law, close up.
    Force,
    /// Force over displacement.
    Loop,
    /// The residual of the law.
    Residual,
    /// Parameters over time.
    Parameters,
    /// Backlash by reversal.
    Backlash,
    /// Frequency response.
    Bode,
}

impl Kind {
    /// All of them, in the order of a page.
    pub const ALL: [Self; 6] = [Self::Force, Self::Residual, Self::Loop, Self::Parameters, Self::Backlash, Self::Bode];

    /// Its name on the command line and in file names.
    pub const fn name(self) -> &'static str {
        self.parts().0
    }

    /// Its heading.
    pub const fn heading(self) -> &'static str {
        self.parts().1
    }

    /// Name, heading, and what draws it.
    const fn parts(self) -> (&'static str, &'static str, fn(&Content) -> Made) {
        match self {
            Self::Force => ("force", "Force against the law", force),
            Self::Loop => ("loop", "Force over displacement", hysteresis),
            Self::Residual => ("residual", "Residual of the law", residual),
            Self::Parameters => ("parameters", "Parameters over time", parameters),
            Self::Backlash => ("backlash", "Backlash by reversal", backlash),
            Self::Bode => ("bode", "Frequency response", bode),
        }
    }
}

/// Up to this many reversals are drawn one by one.
const MOST_REVERSALS: usize = 300;
/// Minimum and maximum number of bars of a histogram.
const BARS: (f64, f64) = (8.0, 40.0);

/// One figure of a run, or why it has none.
pub fn figure(content: &Content, kind: Kind) -> Result<Figure, PageError> {
    let (name, heading, draw) = kind.parts();
    let file = &content.run.name;
    let words = |text: &str| description(content.run.settings.machine, text);
    let (caption, mut panels) = draw(content).map_err(|reason| PageError::NotShown {
        file: file.clone(),
        figure: name,
        reason: words(&reason),
    })?;
    for panel in &mut panels {
        let layers = panel.layers.iter_mut().filter_map(|layer| layer.label.as_mut());
        for label in layers.chain([&mut panel.x.label, &mut panel.y.label]) {
            *label = words(label);
        }
    }
    Ok(Figure { name, title: format!("{}: {file}", words(heading)), caption: words(&caption), panels })
}

fn needs_rows(rows: &[Row]) -> Result<(), String> {
    let some = rows.iter().filter(|row| row.force_n.is_finite()).count() > 2;
    if some { Ok(()) } else { Err("the run is shorter than the kernels of the estimator".into()) }
}

fn line(rows: &[Row], of: impl Fn(&Row) -> (f64, f64)) -> Vec<(f64, f64)> {
    rows.iter().map(of).collect()
}

fn force(content: &Content) -> Made {
    let rows = &content.close;
    needs_rows(rows)?;
    let measured = line(rows, |row| (row.t_s, row.force_n));
    let law = line(rows, |row| (row.t_s, row.law_n));
    let left = line(rows, |row| (row.t_s, row.force_n - row.law_n));
    let panels = vec![
        Panel::new(
            "Time [s]",
            "Force [N]",
            TALL_PX,
            vec![
                Layer::line("measured", Colour::Blue, measured, Stroke::Wide),
                Layer::line("mt a + cf v + fc sgn(v) + F0", Colour::Vermilion, law, Stroke::Dashed),
            ],
        ),
        Panel::new(
            "Time [s]",
            "Difference [N]",
            LOW_PX,
            vec![
                Layer::unnamed(Colour::Ink, Shape::Level(0.0, Stroke::Thin)),
                Layer::line("measured minus law", Colour::Green, left, Stroke::Solid),
            ],
        ),
    ];
    let caption = format!(
        "Measured force and the law with the values fitted to all motion, both through the estimator's kernels, in the middle of the run. {}",
        left_over(content)
    );
    Ok((caption, panels))
}

/// A sentence on the residual.
fn left_over(content: &Content) -> String {
    match content.residual() {
        Some((rms_n, explained)) => format!(
            "Over {} the residual is {} rms, {:.2} % of the force's. \
             Where the screw is at rest the law does not apply: static friction can take any value.",
            if content.changes.is_empty() {
                "the whole run"
            } else {
                "all that came after the last change of the device"
            },
            force_text(content.run.settings.machine, rms_n),
            100.0 * (1.0 - explained).max(0.0).sqrt()
        ),
        None => "Nothing moves: there is no law to compare with.".into(),
    }
}

fn residual(content: &Content) -> Made {
    let rows = &content.rows;
    needs_rows(rows)?;
    let left = line(rows, |row| (row.t_s, row.force_n - row.law_n));
    let values: Vec<f64> = left.iter().map(|(_, value)| *value).filter(|value| value.is_finite()).collect();
    let (rms_n, _) = content.residual().ok_or("nothing moves")?;
    let (bars, width_n) = histogram(&values);
    let normal = |n: i32| {
        let z = f64::from(n) / 20.0;
        (z * rms_n, values.len() as f64 * width_n / (rms_n * (2.0 * PI).sqrt()) * (-z * z / 2.0).exp())
    };
    let reach = bars.iter().map(|bar| bar.0.abs().max(bar.1.abs())).fold(4.0 * rms_n, f64::max);
    let panels = vec![
        Panel::new(
            "Time [s]",
            "Measured minus law [N]",
            LOW_PX + 20,
            vec![
                Layer::unnamed(Colour::Green, Shape::Line(left, Stroke::Thin)),
                Layer::new("± 2 rms", Colour::Ink, Shape::Level(2.0 * rms_n, Stroke::Dashed)),
                Layer::unnamed(Colour::Ink, Shape::Level(-2.0 * rms_n, Stroke::Dashed)),
            ],
        ),
        Panel::new(
            Axis::new("Measured minus law [N]").within(-reach, reach),
            "Count",
            LOW_PX + 20,
            vec![
                Layer::new("residuals", Colour::Green, Shape::Bars(bars)),
                Layer::line(
                    "normal distribution of the same rms",
                    Colour::Ink,
                    (-100..=100).map(normal).collect(),
                    Stroke::Solid,
                ),
            ],
        ),
    ];
    let caption = format!(
        "Residual of the law while the screw moves, two values in each box of the kernel. Noise alone would follow the normal distribution; \
         long tails come from reversals, impacts and changes. {}",
        left_over(content)
    );
    Ok((caption, panels))
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

/// The quantile of sorted values; 0 if there are none.
fn quantile(sorted: &[f64], part: f64) -> f64 {
    sorted.get((sorted.len().saturating_sub(1) as f64 * part).round() as usize).copied().unwrap_or(0.0)
}

/// Bars `(left, right, count)` of equal width by the Freedman-Diaconis rule, and that width.
fn histogram(values: &[f64]) -> (Vec<(f64, f64, f64)>, f64) {
    let sorted = sorted(values.iter().copied());
    let at = |part| quantile(&sorted, part);
    let (low, high) = (at(0.0), at(1.0));
    let wanted = 2.0 * (at(0.75) - at(0.25)) / (sorted.len().max(1) as f64).cbrt();
    let count = ((high - low) / wanted).clamp(BARS.0, BARS.1).ceil();
    let width = (high - low) / count;
    if !(width > 0.0 && count.is_finite()) {
        let half = 0.05 * low.abs() + 1e-9;
        return (vec![(low - half, low + half, sorted.len() as f64)], 2.0 * half);
    }
    let edge = |bar: usize| low + width * bar as f64;
    let below = |bar: usize| {
        if bar as f64 >= count { sorted.len() } else { sorted.partition_point(|value| *value < edge(bar)) }
    };
    let bars = (0..count as usize).map(|bar| (edge(bar), edge(bar + 1), (below(bar + 1) - below(bar)) as f64));
    (bars.collect(), width)
}

fn hysteresis(content: &Content) -> Made {
    let rows = &content.close;
    needs_rows(rows)?;
    let (low, high) = ends(rows.iter().map(|row| row.position_m).filter(|position| position.is_finite()));
    let middle_m = (low + high) / 2.0;
    let millimetres = |row: &Row| (row.position_m - middle_m) * 1e3;
    let measured = line(rows, |row| (millimetres(row), row.force_n));
    let law = line(rows, |row| (millimetres(row), row.law_n));
    let panel = Panel::new(
        "Displacement of the screw about its middle [mm]",
        "Force [N]",
        360,
        vec![
            Layer::line("measured", Colour::Blue, measured, Stroke::Wide),
            Layer::line("law", Colour::Vermilion, law, Stroke::Dashed),
        ],
    );
    let caption = "Force over displacement in the same stretch of time. An inertance tilts the loop down to the right, by mt w²; \
                   the area inside is the friction loss per cycle; Coulomb friction makes the steps at both ends.";
    Ok((caption.into(), vec![panel]))
}

/// Time \[s\], value and half width of the interval, NaN if unknown.
pub(crate) type Timed = (f64, f64, f64);

/// A parameter over a run, by its index.
pub(crate) fn over_run(content: &Content, number: usize) -> Vec<Timed> {
    let machine = content.run.settings.machine;
    let of = |found: &Estimated| catalogue::parameters(machine, &found.estimate.recent).nth(number);
    content.moments.iter().filter_map(|(t_s, found)| Some(timed(*t_s, of(found)?.1.known(), 1.0))).collect()
}

/// A value at a time, converted by `factor` to the unit shown.
fn timed(t_s: f64, known: Option<Interval>, factor: f64) -> Timed {
    let [value, u95] = known.map_or([f32::NAN; 2], |known| [known.value, known.u95]).map(f64::from);
    (t_s, value * factor, u95 * factor)
}

/// Points with a value and an interval.
pub(crate) fn known(points: &[Timed]) -> impl Iterator<Item = &Timed> {
    points.iter().filter(|point| point.1.is_finite() && point.2.is_finite())
}

/// The range of the values once they have settled, including their intervals.
pub(crate) fn settled(points: &[Timed]) -> (f64, f64) {
    let values = sorted(known(points).map(|point| point.1));
    let u95 = quantile(&sorted(known(points).map(|point| point.2)), 0.5);
    (quantile(&values, 0.03) - 2.2 * u95, quantile(&values, 0.97) + 2.2 * u95)
}

fn parameters(content: &Content) -> Made {
    let mut panels = Vec::new();
    let machine = content.run.settings.machine;
    let linear = catalogue::fields(Machine::Linear, Group::Parameter);
    for (number, (linear, field)) in linear.zip(catalogue::fields(machine, Group::Parameter)).enumerate() {
        let points = over_run(content, number);
        // The offset does not get its own panel.
        if known(&points).count() < 2 || field.symbol == "F0" {
            continue;
        }
        let truth = truth_line(content, linear.path, 1.0);
        let whole = catalogue::parameters(machine, &content.replayed.outcome.estimate.whole_run).nth(number);
        let whole = whole.map(|(_, parameter)| value_text(&parameter)).unwrap_or_default();
        let label = format!("{} [{}]", field.symbol, field.unit);
        let title = format!("{}, whole run {whole} {}", field.label, field.unit);
        panels.push(over_time(content, label, title, points, Colour::Blue, truth));
    }
    let widths: Vec<Timed> = content
        .moments
        .iter()
        .filter_map(|(t_s, found)| Some(timed(*t_s, found.detail?.backlash.known(), 1e6)))
        .collect();
    if widths.iter().filter(|point| point.1.is_finite()).count() > 1 {
        let text = format!(
            "Backlash so far, {} {}",
            backlash_text(&content.replayed.outcome.detail.backlash),
            catalogue::unit(machine, "µm")
        );
        let truth = truth_line(content, "backlash_m", 1e6);
        panels.push(over_time(content, "eps [µm]".into(), text, widths, Colour::Purple, truth));
    }
    if panels.is_empty() {
        return Err("the motion identifies no parameter for long enough".into());
    }
    let true_line =
        if panels.iter().any(|panel| panel.layers.iter().any(|layer| layer.label.as_deref() == Some("truth"))) {
            " The dashed line is the truth of the simulated device."
        } else {
            ""
        };
    let changes = if content.changes.is_empty() {
        ""
    } else {
        " Vertical lines mark where a change of the device was found and the estimator restarted."
    };
    let caption = format!(
        "Estimates with their 95 % interval, from the last {} s of motion. Where the line is interrupted, the motion could not identify the parameter.{true_line}{changes}",
        content.run.settings.memory_s
    );
    Ok((caption, panels))
}

/// The true value of a simulated device over time, converted by `factor` to the unit shown; empty if unknown.
fn truth_line(content: &Content, name: &str, factor: f64) -> Vec<(f64, f64)> {
    let (start_s, end_s) = (content.run.start_s, content.run.start_s + content.duration_s);
    let Some(first) = content.first_truth(name) else { return Vec::new() };
    let points = match content.later_truth(name) {
        Some((at_s, later)) => vec![(start_s, first), (at_s, first), (at_s, later), (end_s, later)],
        None => vec![(start_s, first), (end_s, first)],
    };
    points.into_iter().map(|(t_s, value)| (t_s, value * factor)).collect()
}

/// A value with its interval over time; the axis fits the settled value, not its first uncertain moments.
fn over_time(
    content: &Content,
    label: String,
    title: String,
    points: Vec<Timed>,
    colour: Colour,
    truth: Vec<(f64, f64)>,
) -> Panel {
    let (low, high) = settled(&points);
    let start = content.run.start_s;
    let mut layers = vec![Layer::new(title, colour, Shape::Band(points, Stroke::Solid))];
    if truth.iter().any(|(_, value)| (low..=high).contains(value)) {
        layers.push(Layer::line("truth", Colour::Ink, truth, Stroke::Dashed));
    }
    layers.extend(content.changes.iter().enumerate().map(|(number, (t_s, _))| Layer {
        label: (number == 0).then(|| "change found".into()),
        colour: Colour::Orange,
        shape: Shape::Instant(*t_s, Stroke::Solid),
    }));
    let x = Axis::new("Time [s]").within(start, start + content.duration_s.max(1e-3));
    let room = 0.02 * (high - low).max(1e-6);
    Panel::new(x, Axis::new(label).within(low - room, high + room), LOW_PX - 10, layers)
}

fn backlash(content: &Content) -> Made {
    let estimate = &content.replayed.outcome.detail.backlash;
    if content.reversals.len() < 2 {
        return Err(format!(
            "{} of the flanks accepted ({})",
            plural(content.reversals.len() as u64, "reversal"),
            backlash_text(estimate)
        ));
    }
    let micrometres: Vec<Timed> = content
        .reversals
        .iter()
        .map(|(t_s, reversal)| (*t_s, f64::from(reversal.value_m) * 1e6, 1.96 * f64::from(reversal.error_m) * 1e6))
        .filter(|(_, value, error)| value.is_finite() && error.is_finite())
        .collect();
    let sorted = sorted(micrometres.iter().map(|point| point.1));
    let at = |part| quantile(&sorted, part);
    // Outliers, which the estimate excludes too, would squeeze all others into one bar.
    let spread = (at(0.75) - at(0.25)).max(0.1);
    let (low, high) = (at(0.5) - 6.0 * spread, at(0.5) + 6.0 * spread);
    let (inside, outside): (Vec<f64>, Vec<f64>) = sorted.iter().partition(|value| (low..=high).contains(*value));
    let (bars, _) = histogram(&inside);
    let mut layers = vec![Layer::new("reversals", Colour::Purple, Shape::Bars(bars))];
    if let Some(Interval { value, u95 }) = estimate.known() {
        let (value, u95) = (f64::from(value) * 1e6, f64::from(u95) * 1e6);
        let label =
            format!("estimate {} {}", interval_text(value, u95), catalogue::unit(content.run.settings.machine, "µm"));
        layers.push(Layer::unnamed(Colour::Vermilion, Shape::Span(value - u95, value + u95)));
        layers.push(Layer::new(label, Colour::Vermilion, Shape::Instant(value, Stroke::Solid)));
    }
    if let Some(truth) = content.truth("backlash_m") {
        layers.push(Layer::new("truth", Colour::Ink, Shape::Instant(truth * 1e6, Stroke::Dashed)));
    }
    let every = micrometres.len().div_ceil(MOST_REVERSALS);
    let points = micrometres.iter().step_by(every).copied().collect();
    let panels = vec![
        Panel::new("Backlash by one reversal [µm]", "Reversals", LOW_PX + 30, layers),
        Panel::new(
            "Time [s]",
            Axis::new("Backlash [µm]").within(low, high),
            LOW_PX + 10,
            vec![Layer::new("each reversal with its own 95 % interval", Colour::Purple, Shape::Points(points))],
        ),
    ];
    let left_out = match outside.len() {
        0 => String::new(),
        count => format!(" {} beyond the figure are not shown.", plural(count as u64, "reversal")),
    };
    let thinned = if every > 1 { format!(" Over time one reversal in {every} is shown.") } else { String::new() };
    let caption = format!(
        "Backlash from each of {}; impacts and noise make them differ, and the estimate weights them by their information.{left_out}{thinned}",
        plural(content.reversals.len() as u64, "accepted reversal")
    );
    Ok((caption, panels))
}
