//! Figures with all runs overlaid.

use inerter_analysis::response::{Input, Point};
use inerter_core::Machine;
use inerter_data::names::{description, parameter};

use super::comparison::{Comparison, DRAWN};
use crate::{
    figure::{Axis, Colour, Figure, Layer, Panel, Shape, Stroke, ends},
    page::{
        Content, LOW_PX, MOST_TIMES, TALL_PX, Timed, apparent_kg, file_name, known, measured, over_run,
        response_panels, settled,
    },
};

/// The runs' colours.
const COLOURS: [Colour; DRAWN] = [Colour::Blue, Colour::Vermilion, Colour::Green, Colour::Purple, Colour::Orange];

/// All figures for which the runs have data.
pub(super) fn figures(comparison: &Comparison) -> Vec<Figure> {
    let all = [intervals(comparison), hysteresis(comparison), over_time(comparison), bode(comparison)];
    all.into_iter().filter_map(|figure| shown(figure, comparison.machine())).collect()
}

/// The figure of the loops, if any run has one.
pub fn loops(comparison: &Comparison) -> Option<Figure> {
    shown(hysteresis(comparison), comparison.machine())
}

/// A figure in the words of this machine, or `None` if it is empty.
fn shown(mut figure: Figure, machine: Machine) -> Option<Figure> {
    figure.title = description(machine, &figure.title);
    figure.caption = description(machine, &figure.caption);
    for axis in figure.panels.iter_mut().flat_map(|panel| [&mut panel.x, &mut panel.y]) {
        axis.label = description(machine, &axis.label);
    }
    (!figure.panels.is_empty()).then_some(figure)
}

/// The overlaid runs, each with its name and colour.
fn laid(comparison: &Comparison) -> impl Iterator<Item = (&Content, String, Colour)> {
    let named = comparison.runs.iter().enumerate().zip(COLOURS);
    named.map(|((number, content), colour)| (content, name(number, content), colour))
}

/// A run's name in a legend.
fn name(number: usize, content: &Content) -> String {
    format!("{} {}", number + 1, file_name(&content.run.name))
}

/// The caption's note if there are more runs than colours.
fn left_out(comparison: &Comparison) -> String {
    match comparison.runs.len() {
        count if count > DRAWN => format!(" Only the first {DRAWN} of {count} runs are drawn."),
        _ => String::new(),
    }
}

/// Each parameter of each run with its interval.
fn intervals(comparison: &Comparison) -> Figure {
    let count = comparison.runs.len() as f64;
    let machine = comparison.machine();
    let mut panels: Vec<Panel> = Vec::new();
    for row in &comparison.rows {
        let field = row.field(machine);
        let (unit, factor) = row.shown_unit(machine);
        let symbol = if field.symbol.is_empty() { field.label } else { field.symbol };
        let mut layers = Vec::new();
        for (number, (content, run)) in comparison.runs.iter().zip(&row.runs).enumerate() {
            let Some(found) = run.found else { continue };
            let u95 = comparison.shown_rig(number).u95(&found.budget);
            let [value, u95] = [found.value, u95].map(|one| factor * f64::from(one));
            let points = Shape::Points(vec![(number as f64 + 1.0, value, u95)]);
            let colour = COLOURS[number % DRAWN];
            let is_named = panels.is_empty() && comparison.runs.len() <= DRAWN;
            layers.push(Layer { label: is_named.then(|| name(number, content)), colour, shape: points });
        }
        let x = Axis::new("Run").within(0.0, count + 1.0);
        panels.push(Panel::new(x, Axis::new(format!("{symbol} [{unit}]")), LOW_PX - 20, layers));
    }
    Figure {
        name: "intervals",
        title: "Parameters by run".into(),
        caption:
            "Each parameter with the 95 % interval that the comparison rests on. The runs are numbered as in the table."
                .into(),
        panels,
    }
}

/// Force over displacement, each centred on the middle of its stroke.
fn hysteresis(comparison: &Comparison) -> Figure {
    let layers = laid(comparison).filter_map(|(content, name, colour)| {
        let known = || content.close.iter().filter(|row| row.position_m.is_finite() && row.force_n.is_finite());
        let (low, high) = ends(known().map(|row| row.position_m));
        let middle_m = (low + high) / 2.0;
        let points = content.close.iter().map(|row| ((row.position_m - middle_m) * 1e3, row.force_n)).collect();
        (known().count() > 2).then(|| Layer::line(name, colour, points, Stroke::Solid))
    });
    let panel = Panel::new("Displacement of the screw about its middle [mm]", "Force [N]", 360, layers.collect());
    Figure {
        name: "loops",
        title: "Force over displacement".into(),
        caption: format!(
            "Measured force over the displacement of the screw, in the middle of each run. Inertance leans a loop down to the right, friction \
             opens it.{}",
            left_out(comparison)
        ),
        panels: [panel].into_iter().filter(|panel| !panel.layers.is_empty()).collect(),
    }
}

/// The first three parameters over time; the offset is not worth a panel.
fn over_time(comparison: &Comparison) -> Figure {
    let mut panels = Vec::new();
    let machine = comparison.machine();
    let duration_s = laid(comparison).map(|(content, ..)| content.duration_s).fold(1e-3, f64::max);
    for number in 0..3 {
        let field = parameter(machine, number);
        let (mut layers, mut range) = (Vec::new(), (f64::INFINITY, f64::NEG_INFINITY));
        for (content, name, colour) in laid(comparison) {
            let points = over_run(content, number);
            if known(&points).count() < 2 {
                continue;
            }
            let (low, high) = settled(&points);
            range = (range.0.min(low), range.1.max(high));
            let since = |(t_s, value, u95): Timed| (t_s - content.run.start_s, value, u95);
            let shape = Shape::Band(points.into_iter().map(since).collect(), Stroke::Solid);
            layers.push(Layer { label: panels.is_empty().then_some(name), colour, shape });
        }
        if !layers.is_empty() {
            let room = 0.02 * (range.1 - range.0).max(1e-9);
            let x = Axis::new("Time since the first sample [s]").within(0.0, duration_s);
            let y = Axis::new(format!("{} [{}]", field.symbol, field.unit)).within(range.0 - room, range.1 + room);
            panels.push(Panel::new(x, y, LOW_PX, layers));
        }
    }
    Figure {
        name: "over-time",
        title: "Parameters over time".into(),
        caption: format!(
            "Live estimates with their whole 95 % intervals, those of the device. Where a line breaks off, the motion did not show the \
             parameter.{}",
            left_out(comparison)
        ),
        panels,
    }
}

/// The measured frequency responses.
fn bode(comparison: &Comparison) -> Figure {
    let seen: Vec<_> = laid(comparison).filter(|(content, ..)| !content.response.points.is_empty()).collect();
    let apparent = |point: &Point| apparent_kg(point.frequency_hz, point.response);
    let of_all = || seen.iter().flat_map(|(content, ..)| content.response.points.iter().map(apparent));
    let inertance_kg = seen.iter().map(|(content, ..)| content.model.inertance_kg.abs()).fold(1e-9, f64::max);
    let most_kg = of_all().map(|kg| 1.1 * kg).fold(1.25 * inertance_kg, f64::max).min(MOST_TIMES * inertance_kg);
    let panels = match seen.is_empty() {
        true => Vec::new(),
        false => response_panels(&Axis::log("Frequency [Hz]"), "x", most_kg, TALL_PX, |show, half| {
            let of = |(content, name, colour): &(&Content, String, Colour)| {
                measured(&content.response, name, (*colour, Stroke::Solid), show, half)
            };
            seen.iter().map(of).collect()
        }),
    };
    let of = |input: Input| seen.iter().any(|(content, ..)| content.response.input == input);
    let over = match (of(Input::Terminal), of(Input::Screw)) {
        (true, true) => {
            "the terminal where a run has its sensor, of the screw in the others: do not compare these above the contact's resonance"
        }
        (true, false) => "the terminal",
        _ => "the screw",
    };
    Figure {
        name: "bode",
        title: "Frequency response".into(),
        caption: format!(
            "Measured force over the displacement of {over}. In the middle, the same over w²: the apparent mass. Intervals are of 95 %.{}",
            left_out(comparison)
        ),
        panels,
    }
}
