//! A law that is nearly true: violations of the law in sizes of what they do to the parameters, and what intervals hold then.

use crate::{
    coverage::{Outcome, cells, errors},
    diagnose::{Added, Case, Replayed, clean_case},
    grid::{Error, MOTIONS, Motion, each_seed, three},
    sheet::{self, significant},
};
use inerter_analysis::diagnose::Kind;
use inerter_core::{LawStatus, Parameters, Regime};
use inerter_plant::Inerter;
use inerter_view::figure::{Axis, Colour, Figure, Layer, Panel, Shape, Stroke};

/// What a violation moves the parameter that it moves most by, in half widths of that parameter's interval without it.
pub const SIZES: [f64; 4] = [0.3, 1.0, 3.0, 10.0];
/// Runs from which a size is found, of the same noise with and without the violation.
const PAIRS: u64 = 2;
/// Times that a size is sought, and how near is near enough.
const ROUNDS: usize = 4;
const NEAR: f64 = 0.1;
/// How near it is at least in the table: a motion may jump over a size, or none may do so much.
const REACHED: f64 = 0.35;
/// What is wanted to be held \[%\].
const WANTED: f64 = 90.0;
/// One for each motion.
const COLOURS: [Colour; 6] =
    [Colour::Ink, Colour::Blue, Colour::Vermilion, Colour::Green, Colour::Purple, Colour::Orange];

/// A violation of the law.
struct Violation {
    name: &'static str,
    unit: &'static str,
    /// Where sizes are sought.
    range: [f64; 2],
    kind: Kind,
    case: fn(Case, f64) -> Case,
}

const VIOLATIONS: [Violation; 4] = [
    Violation {
        name: "friction that grows with the load",
        unit: "of the load",
        range: [1e-6, 0.1],
        kind: Kind::LoadDependent,
        case: |case, load| Case { added: Added { load, ..case.added }, ..case },
    },
    Violation {
        name: "force once a turn",
        unit: "N",
        range: [1e-3, 30.0],
        kind: Kind::PositionPeriodic,
        case: |case, ripple_n| Case { added: Added { ripple_n, ..case.added }, ..case },
    },
    Violation {
        name: "friction that rises towards rest (Stribeck, 5 mm/s)",
        unit: "of fc",
        range: [1e-3, 2.0],
        kind: Kind::Stribeck,
        case: |case, part| {
            let device = Inerter { stribeck_ratio: 1.0 + part, stribeck_velocity_m_per_s: 5e-3, ..case.device };
            Case { device, ..case }
        },
    },
    Violation {
        name: "friction that turns over a distance (presliding)",
        unit: "um",
        range: [0.3, 300.0],
        kind: Kind::Presliding,
        case: |case, um| Case { device: Inerter { presliding_m: um * 1e-6, ..case.device }, ..case },
    },
];

/// What a run says: by the device's intervals, and by those of the samples.
struct Told {
    device: Outcome,
    samples: Outcome,
    /// Which of the three name the violation as what they rest on.
    assumed: [bool; 3],
}

/// Cells with silent runs.
#[derive(Default)]
struct Count {
    all: usize,
    held: usize,
    assumed: usize,
}

/// The sections of the table, and the same as a figure.
pub fn sections(first: u64, seeds: u64) -> Result<(String, Figure), Error> {
    let mut text = String::new();
    let mut count = Count::default();
    let mut panels = Vec::new();
    for violation in &VIOLATIONS {
        text += &format!(
            "\n### {}\n\n| motion | size | in U95 | {} | told % | mt covered % | cf | fc | error/U95 |\n|---|--:|--:|--:|--:|--:|--:|--:|---|\n",
            violation.name, violation.unit
        );
        let mut layers = vec![Layer::unnamed(Colour::Grid, Shape::Level(WANTED, Stroke::Dashed))];
        for (motion, colour) in MOTIONS.iter().zip(COLOURS) {
            eprintln!("{}: {}", violation.name, motion.name);
            let mut points = Vec::new();
            for (wanted, in_u95, size) in violation.sizes(motion, first)? {
                let case = (violation.case)(clean_case(1.0, 1000.0), size);
                let runs = each_seed(seeds, |seed| told(violation.kind, &case, motion, first + seed - 1))?;
                let row = Row::of(&runs, &mut count);
                points.extend(row.least_held.map(|held| (in_u95, held)));
                text += &row.line(motion.name, wanted, in_u95, size);
            }
            layers.push(Layer::new(motion.name, colour, Shape::Line(points, Stroke::Solid)));
        }
        panels.push(Panel {
            x: Axis::log(format!("{}: what it moves a parameter by [U95]", violation.name)).within(0.2, 15.0),
            y: Axis::new("held by replay [%]").within(0.0, 101.0),
            height_px: 240,
            layers,
        });
    }
    let Count { all, held, assumed } = count;
    text += &format!(
        "\nOf {all} cells with silent runs, {held} are covered in {WANTED:.0} % of them or more; {assumed} of the others name the violation as what they rest on.\n"
    );
    let figure = Figure {
        name: "coverage",
        title: "A law that is nearly true".into(),
        caption: "Truths that the interval of replay holds, of the parameter that holds fewest, in runs without a word"
            .into(),
        panels,
    };
    Ok((text, figure))
}

impl Violation {
    /// [`SIZES`], what was reached of each, and the size that does it, as far as there are such sizes.
    fn sizes(&self, motion: &Motion, first: u64) -> Result<Vec<(f64, f64, f64)>, Error> {
        let clean = clean_case(1.0, 1000.0);
        let without = each_seed(PAIRS, |seed| Ok(clean.estimated(motion, first + seed - 1)?.estimate.whole_run))?;
        let moved = |size: f64| -> Result<f64, Error> {
            let case = (self.case)(clean, size);
            let with = each_seed(PAIRS, |seed| Ok(case.estimated(motion, first + seed - 1)?.estimate.whole_run))?;
            let all = with.iter().zip(&without).map(|(with, without)| moved_most(with, without));
            Ok(all.sum::<f64>() / PAIRS as f64)
        };
        let [least, most] = self.range;
        let mut found = Vec::new();
        let mut size = (least * most).sqrt();
        for wanted in SIZES {
            let mut is = moved(size)?;
            for _ in 0..ROUNDS {
                if (is / wanted - 1.0).abs() < NEAR {
                    break;
                }
                size = (size * wanted / is).clamp(least, most);
                is = moved(size)?;
            }
            if (is / wanted - 1.0).abs() < REACHED || size >= most {
                found.push((wanted, is, size));
            }
            if size >= most {
                break;
            }
        }
        Ok(found)
    }
}

/// Most that one of the three is moved by, in half widths of its interval without.
fn moved_most(with: &Parameters, without: &Parameters) -> f64 {
    let pairs = three(with).into_iter().zip(three(without));
    let told = pairs.filter(|(with, without)| with.u95().is_finite() && without.u95().is_finite());
    let moved = told.map(|(with, without)| (with.fitted().value - without.fitted().value).abs() / without.u95());
    f64::from(moved.fold(0.0, f32::max))
}

/// What a run says of the parameters, and whether a person is told that something is wrong.
fn told(kind: Kind, case: &Case, motion: &Motion, seed: u64) -> Result<Told, Error> {
    let Replayed { outcome, causes, judged } = case.replayed(motion, seed)?;
    let told = !causes.is_empty()
        || outcome.law.status == LawStatus::Broken
        || matches!(outcome.detail.friction.regime, Regime::Presliding | Regime::Stribeck);
    let device = errors(&outcome.estimate.whole_run, &case.device);
    let wider = |i: usize| device[i].map(|(error, _)| (error, f64::from(judged[i].budget.u95())));
    Ok(Told {
        device: (device, told),
        samples: (std::array::from_fn(wider), told),
        assumed: std::array::from_fn(|i| judged[i].assumes.contains(&kind)),
    })
}

/// One size in one motion.
struct Row {
    told_percent: f64,
    /// Of the three parameters: held by the device and by the samples, and what it rests on.
    parts: [String; 3],
    ratios: String,
    /// Least that the samples' intervals hold of the three \[%\].
    least_held: Option<f64>,
}

impl Row {
    fn of(runs: &[Told], count: &mut Count) -> Self {
        let device = cells(&runs.iter().map(|run| run.device).collect::<Vec<_>>());
        let samples = cells(&runs.iter().map(|run| run.samples).collect::<Vec<_>>());
        let silent: Vec<&Told> = runs.iter().filter(|run| !run.device.1).collect();
        let mut least_held: Option<f64> = None;
        let parts = std::array::from_fn(|i| {
            if samples[i].given == 0 {
                return "-".to_string();
            }
            let [by_device, by_samples] =
                [device[i], samples[i]].map(|cell| 100.0 * cell.covered as f64 / samples[i].given as f64);
            let rests = 2 * silent.iter().filter(|run| run.assumed[i]).count() > silent.len();
            count.all += 1;
            count.held += usize::from(by_samples >= WANTED);
            count.assumed += usize::from(by_samples < WANTED && rests);
            least_held = Some(least_held.map_or(by_samples, |least| least.min(by_samples)));
            format!("{by_device:.0} {by_samples:.0}{}", if rests { "*" } else { "" })
        });
        let ratios = samples.map(|cell| if cell.given == 0 { "-".into() } else { format!("{:.1}", cell.rms) });
        let told_percent = 100.0 * (runs.len() - silent.len()) as f64 / runs.len() as f64;
        Self { told_percent, parts, ratios: ratios.join(", "), least_held }
    }

    fn line(&self, motion: &str, wanted: f64, in_u95: f64, size: f64) -> String {
        let [mt, cf, fc] = &self.parts;
        sheet::line(&[
            motion.into(),
            wanted.to_string(),
            format!("{in_u95:.1}"),
            significant(size),
            format!("{:.0}", self.told_percent),
            mt.clone(),
            cf.clone(),
            fc.clone(),
            self.ratios.clone(),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_move_a_parameter_by_so_much() {
        let [load, ..] = &VIOLATIONS;
        let motion = MOTIONS.iter().find(|motion| motion.name == "random").unwrap();
        let sizes = load.sizes(motion, 1).unwrap();
        assert_eq!(sizes.len(), SIZES.len());
        for (wanted, is, _) in &sizes {
            assert!((is / wanted - 1.0).abs() < 0.2, "{sizes:?}");
        }
        assert!(sizes.windows(2).all(|pair| pair[0].2 < pair[1].2), "{sizes:?}");
    }
}
