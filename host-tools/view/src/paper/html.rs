//! The page of the reproduction.

use std::f64::consts::TAU;

use inerter_data::words::interval_text;
use maud::{Markup, html as markup};

use crate::{
    figure::Figure,
    frame::{figure_section, framed, head},
};
use inerter_analysis::paper::{Recovered, Reproduction};

/// The whole page.
pub fn html(paper: &Reproduction, figures: &[Figure]) -> String {
    let meta = markup! {
        "After Li, Liang and Wang, " i { "Two-terminal manipulation of masses: application to vibration suppression of vehicle suspensions, Part I" }
    };
    let main = markup! {
        (parameters(paper))
        (band(paper))
        @for figure in figures { (figure_section(figure)) }
        (rig())
    };
    let heading = "Two-terminal manipulation of masses, section 4";
    framed("the paper reproduced", "a published experiment, simulated", heading, &meta, &main)
}

/// Value and interval in the unit shown.
pub fn found_text(one: &Recovered) -> String {
    let (_, factor) = one.shown;
    match (one.value, one.u95) {
        (Some(value), Some(u95)) if u95 > 0.0 => interval_text(value * factor, u95 * factor),
        (Some(value), _) => plain(value * factor),
        (None, _) => "not identifiable".into(),
    }
}

/// The simulated device's value in the unit shown.
pub fn truth_text(one: &Recovered) -> String {
    plain(one.truth * one.shown.1)
}

fn plain(value: f64) -> String {
    format!("{}", (value * 1e9).round() / 1e9)
}

fn parameters(paper: &Reproduction) -> Markup {
    markup! {
        section #parameters {
            h2 { "Recovered parameters beside the published ones" }
            table {
                (head(&["Parameter", "Unit"], &["Found, blindly", "Published"], &["Interval", "Found at", "Published value"]))
                tbody {
                    @for one in &paper.parameters {
                        tr {
                            th scope="row" { (one.label) " " i { (one.symbol) } }
                            td { (one.shown.0) }
                            td.number { (found_text(one)) }
                            td.number { (truth_text(one)) }
                            @match (one.covers(), one.u95) {
                                (_, Some(0.0)) => td { "given" },
                                (Some(true), _) => td.ok { "covers it" },
                                (Some(false), _) => td.differs { "misses it" },
                                (None, _) => td.none { "none" },
                            }
                            td { (one.from) }
                            td { (one.published) }
                        }
                    }
                }
            }
            p.small {
                "The device is simulated with the published values, so they are the truth here. The Coulomb friction of the paper is missing from our copy "
                "of its text: 50 N is our choice."
            }
        }
    }
}

fn band(paper: &Reproduction) -> Markup {
    let [slow, fast] = paper.at_published_ends;
    let (natural_hz, damping) = paper.resonance;
    let end = |value: Option<f64>| value.map_or_else(|| "no limit".to_string(), |value| format!("{value:.2}"));
    let words = paper
        .band_rad_per_s
        .map_or_else(|| "nowhere".to_string(), |(low, high)| format!("from {} to {} rad/s", end(low), end(high)));
    markup! {
        section #band {
            h2 { "Where the paper's claim differs" }
            p {
                "The paper calls deviations from the ideal insignificant in a middle band of 0.1 to 40 rad/s. Computed from the complete model with the values found, the ideal "
                "mass is within 1 dB and 5° only " strong { (words) } "."
            }
            ul {
                li { "At 0.1 rad/s the complete model differs from the ideal mass by " (format!("{:.1} dB and {:.0}°", slow.decibels, slow.degrees.abs())) ": there viscous friction is as large as the inertance's force." }
                li { "At 40 rad/s it differs by " (format!("{:.1} dB and {:.1}°", fast.decibels, fast.degrees.abs())) ": the contact's stiffness and the inertance resonate at "
                    (format!("{natural_hz:.1} Hz ({:.0} rad/s) with a damping ratio of {damping:.3}", natural_hz * TAU)) "." }
                li { "Dry friction is not in that model, and narrows the band further at small motion: in the first test (0.333 rad/s, inside the paper's band) the inertance's force is "
                    (inertial_n(paper)) " N of amplitude, against 50 N of friction." }
                li { "The validation test at 15.9 Hz (99.9 rad/s) runs above the resonance, where the device acts as its contact's spring and damper do and not as a mass." }
            }
        }
    }
}

/// Amplitude of the inertance's force in the slow test.
fn inertial_n(paper: &Reproduction) -> String {
    paper.tests.first().map_or_else(String::new, |test| {
        let turn = test.plan.frequency_hz * TAU;
        format!("{:.1}", paper.model.inertance_kg * turn * turn * test.plan.amplitude_m)
    })
}

fn rig() -> Markup {
    markup! {
        section #rig {
            h2 { "Method" }
            p {
                "Simulated device and rig: samples at 1 kHz, 2.44 µm per encoder count, 1 N rms of noise in the force, 1 µm rms in the terminal's displacement; fixed seeds, so that every run "
                "gives the same. The complete model is fitted as " code { "inerter identify --staged" } " does: the slowest test for the Coulomb friction, the next for the "
                "rest, the last validates. It is given the instruments' scales and the weighed structure mass, nothing else. "
                "Made by " code { "inerter reproduce-paper" } ", version " (env!("CARGO_PKG_VERSION")) "."
            }
        }
    }
}
