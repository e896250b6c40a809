//! The paper's figures 8 to 11.

use std::f64::consts::{PI, TAU};

use inerter_analysis::response::{Complex, Input, ideal, model};

use crate::{
    figure::{Axis, Colour, Figure, Layer, Panel, Shape, Stroke},
    page::degrees,
};
use inerter_analysis::paper::{PUBLISHED_BAND_RAD_PER_S, Reproduction, Test};

/// Periods shown of each test.
const PERIODS: f64 = 3.0;
/// Range of figure 11 \[rad/s\].
const SHOWN_RAD_PER_S: (f64, f64) = (0.01, 1000.0);

/// Figures 8, 9, 10 and 11.
pub fn figures(paper: &Reproduction) -> Vec<Figure> {
    let names = ["figure-8", "figure-9", "figure-10"];
    let tests = paper.tests.iter().zip(names).map(|(test, name)| force(test, name));
    tests.chain([bode(paper)]).collect()
}

fn force(test: &Test, name: &'static str) -> Figure {
    let plan = &test.plan;
    // From the middle, when the initial transient has decayed.
    let start_s = (plan.duration_s / 2.0 * plan.frequency_hz).floor() / plan.frequency_hz;
    let end_s = start_s + PERIODS / plan.frequency_hz;
    let shown = || test.force.iter().filter(|(t_s, ..)| (start_s..=end_s).contains(t_s));
    let line = |of: fn(&(f64, f64, f64)) -> f64| shown().map(|row| (row.0 - start_s, of(row))).collect::<Vec<_>>();
    // In the slowest test the force rings after each reversal, faster than dashes can show.
    let stroke = if plan.frequency_hz < 1.0 { Stroke::Thin } else { Stroke::Dashed };
    let panels = vec![
        Panel::new(
            "Time [s]",
            "Force [N]",
            250,
            vec![
                Layer::line("Fexp, measured", Colour::Blue, line(|row| row.1), Stroke::Wide),
                Layer::line("Fth, calculated", Colour::Vermilion, line(|row| row.2), stroke),
            ],
        ),
        Panel::new(
            "Time [s]",
            "Fexp − Fth [N]",
            170,
            vec![Layer::unnamed(Colour::Green, Shape::Line(line(|row| row.1 - row.2), Stroke::Thin))],
        ),
    ];
    let (rms_n, part) = test.residual();
    let caption = format!(
        "The paper's figure {}, {}: {} Hz, {} mm. Fth is calculated with the values that were found. Over the whole test the residual is {rms_n:.2} N rms, \
         {:.2} % of the force; 1 N of it is the load cell's noise.",
        plan.figure,
        plan.purpose,
        plan.frequency_hz,
        millimetres(test),
        100.0 * part
    );
    Figure {
        name,
        title: format!("Figure {}: {}, {} Hz", plan.figure, plan.purpose, plan.frequency_hz),
        caption,
        panels,
    }
}

/// The amplitude without rounding residue.
fn millimetres(test: &Test) -> f64 {
    (test.plan.amplitude_m * 1e6).round() / 1e3
}

fn decibels(response: Complex<f64>) -> f64 {
    20.0 * response.norm().log10()
}

fn bode(paper: &Reproduction) -> Figure {
    let (low, high) = SHOWN_RAD_PER_S;
    let step = (high / low).powf(1.0 / 1500.0);
    let turns: Vec<f64> = (0..=1500).map(|n| low * step.powi(n)).collect();
    let curve = |of: &dyn Fn(f64) -> Complex<f64>, show: fn(Complex<f64>) -> f64| -> Vec<(f64, f64)> {
        turns.iter().map(|turn| (*turn, show(of(turn / TAU)))).collect()
    };
    let complete = |f: f64| model(&paper.model, Input::Terminal, f);
    let perfect = |f: f64| ideal(paper.model.inertance_kg, f);
    let measured = |show: fn(Complex<f64>) -> f64, half: fn(f64) -> f64| {
        let points = paper.tests.iter().filter_map(|test| test.response);
        let shown = points.map(|point| (point.frequency_hz * TAU, show(point.response), half(point.error.min(0.99))));
        Shape::Points(shown.collect())
    };
    let (from, to) = PUBLISHED_BAND_RAD_PER_S;
    let (good_from, good_to) = paper.band_rad_per_s.unwrap_or_default();
    let layers = |show: fn(Complex<f64>) -> f64, half: fn(f64) -> f64| {
        let good = Shape::Span(good_from.unwrap_or(low), good_to.unwrap_or(high));
        vec![
            Layer::new("the paper's band", Colour::Orange, Shape::Span(from, to)),
            Layer::new("ideal to 1 dB, 5°", Colour::Green, good),
            Layer::line("ideal", Colour::Ink, curve(&perfect, show), Stroke::Solid),
            Layer::line("complete", Colour::Vermilion, curve(&complete, show), Stroke::Dashed),
            Layer::new("tests", Colour::Blue, measured(show, half)),
        ]
    };
    let x = || Axis::log("Angular frequency [rad/s]").within(low, high);
    let phase = Axis::new("Phase of F / x1 [°]").within(-20.0, 200.0);
    let mut panels = vec![
        Panel::new(x(), "|F / x1| [dB re 1 N/m]", 290, layers(decibels, |part| 20.0 * (1.0 + part).log10())),
        Panel::new(x(), phase, 210, layers(degrees, |part| part.asin() * 180.0 / PI)),
    ];
    panels.iter_mut().skip(1).for_each(Panel::unname);
    let caption = "The paper's figure 11, (a) magnitude and (b) phase of the force over the terminal's displacement: the ideal mass, and the complete model with the \
                   values that were found, without structure mass. The points are measured in the three tests, with the dry friction that neither curve has: \
                   at 0.333 rad/s it is nearly all of the force. A phase of 180° is that of an inertance.";
    Figure { name: "figure-11", title: "Figure 11: frequency response".into(), caption: caption.into(), panels }
}
