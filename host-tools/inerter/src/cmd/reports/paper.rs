//! `inerter reproduce-paper`: the paper's experiment, simulated and identified.

use inerter_analysis::paper::{PLANS, PUBLISHED_BAND_RAD_PER_S, Plan, Reproduction, reproduce};
use inerter_data::{output, run::Run, settings::Overrides};
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{Setup, bench_sensors, raw};
use inerter_view::{
    figure::{render_png, svg},
    paper,
};
use serde_json::{Value, json};

use super::page::make_folder;
use crate::{
    Error,
    cmd::{
        print::print_json,
        reproduce_paper::Args,
        terminal::{self, Progress},
    },
};

/// Noise of the terminal's displacement, rms \[m\].
const TERMINAL_NOISE_M: f64 = 1e-6;
/// Seed of the first test; each further one takes the next.
const SEED: u64 = 2011;

pub fn run(args: &Args) -> Result<(), Error> {
    let page = args.output.join("reproduction.html");
    if !args.force {
        output::refuse_existing(&page)?;
    }
    terminal::tidy_at_interrupts();
    make_folder(&args.output)?;
    let mut progress = Progress::new("simulating", 1000);
    let paper = reproduced(|part| progress.set_part(part))?;
    progress.done();
    let figures = paper::figures(&paper);
    for figure in &figures {
        output::write(&args.output.join(format!("{}.svg", figure.name)), args.force, svg(figure))?;
        render_png(figure, &args.output.join(format!("{}.png", figure.name)), args.force)?;
    }
    output::write(&page, args.force, paper::html(&paper, &figures))?;
    let file = page.display().to_string();
    if args.json {
        let names: Vec<&str> = figures.iter().map(|figure| figure.name).collect();
        return print_json(&object(&paper, &file, &names));
    }
    output::lines(table(&paper))?;
    terminal::say(format!("{file}: the page; the figures are beside it as SVG and PNG"));
    Ok(())
}

/// One test as the rig records it. Its settings hold the instruments and the weighed mass of the structure, and nothing
/// else.
fn recorded(plan: &Plan, seed: u64) -> Result<Run, Error> {
    let sensors = Sensors { terminal_noise_m: TERMINAL_NOISE_M, seed, ..bench_sensors() };
    let mut blind = Overrides::default();
    for (name, value) in [("stiffness_n_per_m", 0.0), ("contact_damping_n_s_per_m", 0.0), ("terminal_sensor", 1.0)] {
        blind.set(name, value, "the reproduction")?;
    }
    let setup = Setup::new(Inerter::paper(), sensors, &plan.motion(), Some(plan.duration_s), &blind)?;
    let samples = setup.samples()?.map(|sample| raw(&sample)).collect();
    let name = format!("test at {} Hz", plan.frequency_hz);
    Ok(Run { name, settings: setup.settings, samples, ..Run::default() })
}

/// The three tests recorded and evaluated; `progress` gets the completed fraction, from 0 to 1.
fn reproduced(mut progress: impl FnMut(f64)) -> Result<Reproduction, Error> {
    let [first, second, third] = &PLANS;
    let runs = [recorded(first, SEED)?, recorded(second, SEED + 1)?, recorded(third, SEED + 2)?];
    progress(0.4);
    Ok(reproduce(runs, |part| progress(0.4 + 0.6 * part))?)
}

fn object(paper: &Reproduction, file: &str, figures: &[&str]) -> Value {
    let parameters: Value = paper
        .parameters
        .iter()
        .map(|one| (one.name, json!({ "value": one.value, "u95": one.u95, "published": one.truth })))
        .collect();
    let tests: Vec<_> = paper
        .tests
        .iter()
        .map(|test| {
            let (rms_n, _) = test.residual();
            json!({ "figure": test.plan.figure, "frequency_hz": test.plan.frequency_hz, "amplitude_m": test.plan.amplitude_m, "residual_rms_n": rms_n })
        })
        .collect();
    let (low, high) = PUBLISHED_BAND_RAD_PER_S;
    let band = paper.band_rad_per_s.map(|(low, high)| [low, high]);
    json!({
        "kind": "reproduced", "file": file, "figures": figures, "parameters": parameters, "tests": tests,
        "ideal_band_rad_per_s": band, "published_band_rad_per_s": [low, high],
    })
}

fn table(paper: &Reproduction) -> String {
    let mut text = format!("{:<20} {:<6} {:<22} {:<12} {}", "", "", "found", "published", "found at");
    for one in &paper.parameters {
        let (found, published) = (paper::found_text(one), paper::truth_text(one));
        text += &format!("\n{:<20} {:<6} {found:<22} {published:<12} {}", one.label, one.shown.0, one.from);
    }
    let end = |end: Option<f64>| end.map_or_else(|| "no limit".to_string(), |end| format!("{end:.2}"));
    let words = match paper.band_rad_per_s {
        Some((low, high)) => format!("from {} to {} rad/s", end(low), end(high)),
        None => "nowhere".into(),
    };
    let (low, high) = PUBLISHED_BAND_RAD_PER_S;
    let [slow, fast] = paper.at_published_ends;
    format!(
        "{text}\n\nThe ideal mass is within 1 dB and 5 degrees of the complete model {words}.\nThe paper's middle band is {low} to {high} rad/s: at its ends they differ \
         by {:.1} dB and {:.0} degrees, and by {:.1} dB and {:.1} degrees.\nfc: the paper's is missing from our copy of its text; 50 N is our choice.",
        slow.decibels,
        slow.degrees.abs(),
        fast.decibels,
        fast.degrees.abs()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_is_reproduced_and_its_band_is_not() {
        let mut parts = Vec::new();
        let found = reproduced(|part| parts.push(part)).unwrap();
        assert_eq!(parts.last(), Some(&1.0));
        for one in &found.parameters {
            println!("{} {:?} ± {:?}, {}", one.name, one.value, one.u95, one.truth);
            assert_eq!(one.covers(), Some(true), "{one:?}");
        }
        for test in &found.tests {
            let (rms_n, part) = test.residual();
            println!("{} Hz: {rms_n} N, {part}", test.plan.frequency_hz);
            assert!((0.5..40.0).contains(&rms_n) && part < 0.05, "{} Hz: {rms_n} N, {part}", test.plan.frequency_hz);
        }
        let (low, high) = found.band_rad_per_s.unwrap();
        let (low, high) = (low.unwrap(), high.unwrap());
        assert!((0.9..1.5).contains(&low) && (27.0..29.0).contains(&high), "{low} {high}");
        let [slow, fast] = found.at_published_ends;
        assert!(slow.degrees.abs() > 30.0 && fast.decibels > 2.0, "{slow:?} {fast:?}");
        let drawn = paper::figures(&found);
        assert_eq!(
            drawn.iter().map(|figure| figure.name).collect::<Vec<_>>(),
            ["figure-8", "figure-9", "figure-10", "figure-11"]
        );
        let page = paper::html(&found, &drawn);
        assert!(!page.contains("NaN") && !page.contains("http://") || page.contains("http://www.w3.org/2000/svg"));
        assert!(page.contains("0.1 to 40 rad/s") && page.contains("50 N is our choice"));
    }
}
