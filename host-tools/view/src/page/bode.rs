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
pub(crate) type Show<'a> = &'a dyn Fn(f64, Complex<f64>) -> f64;
/// Half width of the interval of the quantity shown, at a point.
pub(crate) type Half<'a> = &'a dyn Fn(f64, &response::Point) -> f64;

/// Phase in degrees, from -90 to 270, so that the 180 of an inertance lies in the middle.
pub fn degrees(response: Complex<f64>) -> f64 {
    let degrees = response.arg() * 180.0 / PI;
    if degrees < -90.0 { degrees + 360.0 } else { degrees }
}

/// Points `(x, y, half)`, with a break where their spacing is wider than the smallest.
fn broken_where_points_miss(points: &[(f64, f64, f64)]) -> Vec<(f64, f64, f64)> {
    let steps = || points.iter().zip(points.iter().skip(1)).map(|(before, after)| after.0 - before.0);
    let least = steps().fold(f64::INFINITY, f64::min);
    let breaks = std::iter::once(false).chain(steps().map(|step| step > 1.5 * least));
    let nothing = (f64::NAN, f64::NAN, f64::NAN);
    points
        .iter()
        .zip(breaks)
        .flat_map(|(point, breaks)| breaks.then_some(nothing).into_iter().chain([*point]))
        .collect()
}

/// Half width of a magnitude's interval.
fn relative(value: f64, point: &response::Point) -> f64 {
    value * point.error
}

/// Half width of a phase's interval \[°\].
fn phase_error_degrees(_: f64, point: &response::Point) -> f64 {
    point.phase_error_rad() * 180.0 / PI
}

/// The apparent mass of a response at a frequency \[kg\].
pub(crate) fn apparent_kg(frequency_hz: f64, response: Complex<f64>) -> f64 {
    response.norm() / (2.0 * PI * frequency_hz).powi(2)
}

/// The measured response with its intervals: single points if there are few, otherwise a line in a band.
pub(crate) fn measured(
    response: &Response,
    name: &str,
    (colour, stroke): (Colour, Stroke),
    show: Show,
    half: Half,
) -> Layer {
    let points = response.points.iter().map(|point| {
        let value = show(point.frequency_hz, point.response);
        (point.frequency_hz, value, half(value, point))
    });
    let points: Vec<_> = points.collect();
    let shape = if points.len() <= MOST_POINTS {
        Shape::Points(points)
    } else {
        Shape::Band(broken_where_points_miss(&points), stroke)
    };
    Layer::new(name, colour, shape)
}

/// Force over displacement, the apparent mass up to `most_kg`, and the phase, each with its layers; only the first
/// panel names them.
pub(crate) fn response_panels(
    x: &Axis,
    over: &str,
    most_kg: f64,
    tall_px: u32,
    layers: impl Fn(Show, Half) -> Vec<Layer>,
) -> Vec<Panel> {
    let kilonewtons = |_: f64, response: Complex<f64>| response.norm() / 1e3;
    let phase = |_: f64, response: Complex<f64>| degrees(response);
    let panel = |y: Axis, height_px, layers| Panel::new(x.clone(), y, height_px, layers);
    let mut panels = vec![
        panel(Axis::log(format!("|F / {over}| [kN/m]")), tall_px, layers(&kilonewtons, &relative)),
        panel(
            Axis::new(format!("|F / {over}| / w² [kg]")).within(0.0, most_kg),
            LOW_PX,
            layers(&apparent_kg, &relative),
        ),
        panel(Axis::new(format!("Phase of F / {over} [°]")), LOW_PX, layers(&phase, &phase_error_degrees)),
    ];
    panels.iter_mut().skip(1).for_each(Panel::unname);
    panels
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
    let step = (high_hz / low_hz).powf(1.0 / 400.0);
    let frequencies: Vec<f64> = (0..=400).map(|n| low_hz * step.powi(n)).collect();
    let complete = |f: f64| model(&content.model, response.input, f);
    let rubbing = Parameters {
        viscous_n_s_per_m: content.model.viscous_n_s_per_m + content.equivalent_viscous.unwrap_or(0.0),
        ..content.model
    };
    let with_friction = |f: f64| model(&rubbing, response.input, f);
    let perfect = |f: f64| ideal(content.model.inertance_kg, f);
    let has_friction = content.equivalent_viscous.is_some() && content.law.coulomb_n.abs() > 0.0;
    let (over, displacement) = match response.input {
        Input::Terminal => ("x1", "the terminal"),
        Input::Screw => ("x2", "the screw, by the encoder"),
    };
    let apparent = response.points.iter().map(|point| apparent_kg(point.frequency_hz, point.response));
    let most = apparent.fold(1.25, |most, kg| f64::max(most, 1.1 * kg / content.model.inertance_kg)).min(MOST_TIMES);
    let most_kg = most * content.model.inertance_kg.abs().max(1e-3);
    let x = Axis::log("Frequency [Hz]").within(low_hz, high_hz);
    let panels = response_panels(&x, over, most_kg, TALL_PX - 20, |show, half| {
        let curve = |of: &dyn Fn(f64) -> Complex<f64>| frequencies.iter().map(|f| (*f, show(*f, of(*f)))).collect();
        let mut layers = vec![
            measured(response, "measured", (Colour::Blue, Stroke::Wide), show, half),
            Layer::line("ideal", Colour::Ink, curve(&perfect), Stroke::Solid),
            Layer::line("complete", Colour::Vermilion, curve(&complete), Stroke::Dashed),
        ];
        if has_friction {
            let label = "complete, with dry friction";
            layers.push(Layer::line(label, Colour::Green, curve(&with_friction), Stroke::Dashed));
        }
        layers
    });
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
