//! The frequency response of a run as a figure.

use std::f64::consts::PI;

use inerter_analysis::{
    identify::Parameters,
    response::{self, Complex, Input, Method, Response, ideal, model},
};
use inerter_data::words::{amount_text, plural};

use super::{
    Content,
    layout::{LOW_PX, Made, TALL_PX},
};
use crate::figure::{Axis, Colour, Layer, Panel, Shape, Stroke, ends};
use inerter_wire::catalogue;

/// With more points than this the intervals are drawn as a band.
const MOST_POINTS: usize = 60;
/// Apparent inertances are drawn up to this multiple of the inertance: where friction or the resonance dominates the
/// force, they are unbounded.
pub(crate) const MOST_TIMES: f64 = 3.0;

/// Converts a response at a frequency to the quantity shown.
type Show<'a> = &'a dyn Fn(f64, Complex<f64>) -> f64;
/// Half width of the interval of the quantity shown, at a point.
pub(crate) type Half<'a> = &'a dyn Fn(f64, &response::Point) -> f64;

/// Phase in degrees, from -90 to 270, so that the 180 of an inertance lies in the middle.
pub fn degrees(response: Complex<f64>) -> f64 {
    let degrees = response.arg() * 180.0 / PI;
    if degrees < -90.0 { degrees + 360.0 } else { degrees }
}

/// Points `(x, y, low, high)`, with a break where their spacing is wider than the smallest.
fn broken_where_points_miss(points: &[(f64, f64, f64, f64)]) -> Vec<(f64, f64, f64, f64)> {
    let steps = || points.iter().zip(points.iter().skip(1)).map(|(before, after)| after.0 - before.0);
    let least = steps().fold(f64::INFINITY, f64::min);
    let breaks = std::iter::once(false).chain(steps().map(|step| step > 1.5 * least));
    let nothing = (f64::NAN, f64::NAN, f64::NAN, f64::NAN);
    points
        .iter()
        .zip(breaks)
        .flat_map(|(point, breaks)| breaks.then_some(nothing).into_iter().chain([*point]))
        .collect()
}

/// Half width of a magnitude's interval.
pub(crate) fn relative(value: f64, point: &response::Point) -> f64 {
    value * point.error
}

/// Half width of a phase's interval \[°\].
pub(crate) fn phase_error_degrees(_: f64, point: &response::Point) -> f64 {
    point.phase_error_rad() * 180.0 / PI
}

/// The apparent mass of a response at a frequency \[kg\].
pub(crate) fn apparent_kg(frequency_hz: f64, response: Complex<f64>) -> f64 {
    response.norm() / (2.0 * PI * frequency_hz).powi(2)
}

/// The measured response with its intervals: single points if there are few, otherwise a line in a band.
pub(crate) fn measured(
    response: &Response,
    name: Option<&str>,
    (colour, stroke): (Colour, Stroke),
    show: &dyn Fn(&response::Point) -> f64,
    half: Half,
) -> Vec<Layer> {
    let all = response.points.iter().map(|point| {
        let value = show(point);
        (point.frequency_hz, value, value - half(value, point), value + half(value, point))
    });
    let layer = |shape| Layer { label: name.map(str::to_string), colour, shape };
    if response.points.len() <= MOST_POINTS {
        return vec![layer(Shape::Points(all.collect()))];
    }
    let points = broken_where_points_miss(&all.collect::<Vec<_>>());
    let band = points.iter().map(|point| (point.0, point.2, point.3)).collect();
    let line = points.iter().map(|point| (point.0, point.1)).collect();
    vec![Layer::unnamed(colour, Shape::Band(band)), layer(Shape::Line(line, stroke))]
}

/// Measured, ideal and complete response.
pub(super) fn bode(content: &Content) -> Made {
    let response = &content.response;
    let (low_hz, high_hz) = ends(response.points.iter().map(|point| point.frequency_hz));
    if response.points.is_empty() {
        return Err(
            "at no frequency does the displacement explain the force (coherence above 0.8), or the run is too short"
                .into(),
        );
    }
    let (low_hz, high_hz) =
        if high_hz < 4.0 * low_hz { (low_hz / 8.0, high_hz * 8.0) } else { (low_hz / 1.3, high_hz * 1.3) };
    let curve = |of: &dyn Fn(f64) -> Complex<f64>, show: Show| {
        let step = (high_hz / low_hz).powf(1.0 / 400.0);
        (0..=400).map(|n| low_hz * step.powi(n)).map(|f| (f, show(f, of(f)))).collect()
    };
    let complete = |f: f64| model(&content.model, response.input, f);
    let rubbing = Parameters {
        viscous_n_s_per_m: content.model.viscous_n_s_per_m + content.equivalent_viscous.unwrap_or(0.0),
        ..content.model
    };
    let with_friction = |f: f64| model(&rubbing, response.input, f);
    let perfect = |f: f64| ideal(content.model.inertance_kg, f);
    let measured = |show: Show, half: Half| {
        let show = |point: &response::Point| show(point.frequency_hz, point.response);
        measured(response, Some("measured"), (Colour::Blue, Stroke::Wide), &show, half)
    };
    let has_friction = content.equivalent_viscous.is_some() && content.law.coulomb_n.abs() > 0.0;
    let models = |show: Show| {
        let mut layers = vec![
            Layer::line("ideal", Colour::Ink, curve(&perfect, show), Stroke::Solid),
            Layer::line("complete", Colour::Vermilion, curve(&complete, show), Stroke::Dashed),
        ];
        if has_friction {
            let label = "complete, with dry friction";
            layers.push(Layer::line(label, Colour::Green, curve(&with_friction, show), Stroke::Dashed));
        }
        layers
    };
    let (over, displacement) = match response.input {
        Input::Terminal => ("x1", "the terminal"),
        Input::Screw => ("x2", "the screw, by the encoder"),
    };
    let panel = |y: Axis, height_px, show: Show, half: Half| {
        let x = Axis::log("Frequency [Hz]").within(low_hz, high_hz);
        Panel::new(x, y, height_px, [measured(show, half), models(show)].concat())
    };
    let kilonewtons = |_: f64, response: Complex<f64>| response.norm() / 1e3;
    let phase = |_: f64, response: Complex<f64>| degrees(response);
    let apparent = response.points.iter().map(|point| apparent_kg(point.frequency_hz, point.response));
    let most = apparent.fold(1.25, |most, kg| f64::max(most, 1.1 * kg / content.model.inertance_kg)).min(MOST_TIMES);
    let most_kg = most * content.model.inertance_kg.abs().max(1e-3);
    let panels = vec![
        panel(Axis::log(format!("|F / {over}| [kN/m]")), TALL_PX - 20, &kilonewtons, &relative),
        panel(Axis::new(format!("|F / {over}| / w² [kg]")).within(0.0, most_kg), LOW_PX, &apparent_kg, &relative)
            .unnamed(),
        panel(Axis::new(format!("Phase of F / {over} [°]")), LOW_PX, &phase, &phase_error_degrees).unnamed(),
    ];
    let how = match response.method {
        Method::Tones => format!(
            "{} in force and displacement, with the 95 % interval by their scatter over pieces of the run",
            plural(response.points.len() as u64, "steady tone")
        ),
        Method::Welch { averages } => format!(
            "H1 of {averages:.0} independent pieces, with the 95 % interval; only where the coherence is above 0.8"
        ),
    };
    let contact = if content.model.stiffness_n_per_m > 0.0 {
        ""
    } else {
        " The contact stiffness is not known: the complete model is rigid."
    };
    let friction = match content.equivalent_viscous {
        Some(c) if has_friction => format!(
            " Dry friction is not linear; at this motion's speed it acts like {} {} more of viscous friction.",
            amount_text(c, 1),
            catalogue::unit(content.run.settings.machine, "N s/m")
        ),
        _ => String::new(),
    };
    Ok((
        format!(
            "Force over the displacement of {displacement}: {how}. Ideal is mt s², complete has friction, stiffness, damping and structure mass; in the middle, the same magnitude over w²: the apparent mass.{contact}{friction}"
        ),
        panels,
    ))
}
