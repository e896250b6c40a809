//! Small violations of the law, scaled by their effect on the parameters, and the resulting coverage of the intervals.

use crate::{
    diagnose::{Added, Case, Replayed, clean_case},
    grid::{Column, MOTIONS, Motion, Result, each, errors, three},
    sheet::{self, significant},
};
use inerter_analysis::diagnose::Kind;
use inerter_core::{LawStatus, Parameters, Regime};
use inerter_plant::Inerter;
use inerter_view::figure::{Axis, Colour, Figure, Layer, Panel, Shape, Stroke};
use std::{array::from_fn, ops::Range};

/// Shift of the most affected parameter, in half widths of that parameter's interval without the violation.
pub const SIZES: [f64; 4] = [0.3, 1.0, 3.0, 10.0];
/// Pairs of runs that determine a size: the same noise with and without the violation.
const PAIRS: u64 = 2;
/// Maximum number of iterations for a size, and the relative tolerance.
const ROUNDS: usize = 4;
const NEAR: f64 = 0.1;
/// Tolerance for inclusion in the table: in some motions the shift jumps over a size, or no violation causes such a
/// shift.
const REACHED: f64 = 0.35;
/// Goal for the coverage \[%\].
pub const WANTED: f64 = 90.0;
/// Minimum part of the violation's regressor that the law must leave unexplained for that goal to apply \[%\].
const LEAST_LEFT: f64 = 5.0;
/// One colour per motion.
const COLOURS: [Colour; 6] =
    [Colour::Ink, Colour::Blue, Colour::Vermilion, Colour::Green, Colour::Purple, Colour::Orange];

/// A violation of the law.
struct Violation {
    name: &'static str,
    unit: &'static str,
    /// Range of the sizes to search.
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
        name: "Stribeck friction (5 mm/s)",
        unit: "of fc",
        range: [1e-3, 2.0],
        kind: Kind::Stribeck,
        case: |case, part| {
            let device = Inerter { stribeck_ratio: 1.0 + part, stribeck_velocity_m_per_s: 5e-3, ..case.device };
            Case { device, ..case }
        },
    },
    Violation {
        name: "presliding friction",
        unit: "um",
        range: [0.01, 300.0],
        kind: Kind::Presliding,
        case: |case, um| Case { device: Inerter { presliding_m: um * 1e-6, ..case.device }, ..case },
    },
];

/// Results of a run: errors and half widths of the three parameters, if given, with the device's intervals and with
/// those from the samples.
struct Told {
    device: [Option<(f64, f64)>; 3],
    samples: [Option<(f64, f64)>; 3],
    /// Whether the report warns the user.
    warns: bool,
    /// Which of the three parameters are reported to assume the absence of the violation.
    assumed: [bool; 3],
}

/// One parameter of one size in one motion, in which some runs report nothing.
struct Silent {
    violation: &'static str,
    motion: &'static str,
    parameter: &'static str,
    /// Coverage of the samples' intervals \[%\].
    held: f64,
    /// Most of these runs report that the parameter assumes the absence of the violation.
    rests: bool,
    /// Part of the violation's regressor that the law leaves unexplained \[%\].
    left: f64,
}

impl Silent {
    fn is_held(&self) -> bool {
        self.held >= WANTED
    }

    fn place(&self) -> String {
        format!("{}, `{}` ({:.2} %), `{}`", self.violation, self.motion, self.left, self.parameter)
    }
}

/// The sections of the table, and the corresponding figure.
pub fn sections(seeds: Range<u64>) -> Result<(String, Figure)> {
    let mut text = String::new();
    let mut silent = Vec::new();
    let mut panels = Vec::new();
    for violation in &VIOLATIONS {
        text += &format!(
            "\n### {}\n\n| motion | intended | in U95 | {} | left % | reported % | mt covered % | cf | fc | error/U95 |\n|---|--:|--:|--:|--:|--:|--:|--:|--:|---|\n",
            violation.name, violation.unit
        );
        let mut layers = vec![Layer::unnamed(Colour::Grid, Shape::Level(WANTED, Stroke::Dashed))];
        for (motion, colour) in MOTIONS.iter().zip(COLOURS) {
            eprintln!("{}: {}", violation.name, motion.name);
            let mut points = Vec::new();
            for (wanted, in_u95, size) in violation.sizes(motion, seeds.start)? {
                let case = (violation.case)(clean_case(1.0, 1000.0), size);
                let runs = each(seeds.clone(), |seed| told(violation.kind, &case, motion, seed))?;
                // By the plant's true values.
                let fault = Case { kind: Some(violation.kind), ..case };
                let left = 100.0 * fault.told_by(motion, seeds.start, 1.0)?.left;
                let (line, cells) = row(violation.name, motion.name, [wanted, in_u95, size, left], &runs);
                text += &line;
                points.extend(cells.iter().map(|cell| cell.held).reduce(f64::min).map(|held| (in_u95, held)));
                silent.extend(cells);
            }
            layers.push(Layer::new(motion.name, colour, Shape::Line(points, Stroke::Solid)));
        }
        panels.push(Panel {
            x: Axis::log(format!("{}: shift of the parameter it moves most [U95]", violation.name)).within(0.2, 15.0),
            y: Axis::new("coverage of replay [%]").within(0.0, 101.0),
            height_px: 240,
            layers,
        });
    }
    text += &summary(&silent);
    let figure = Figure {
        name: "coverage",
        title: "A law that is nearly true".into(),
        caption: "Coverage of the interval of replay in silent runs, for the parameter with the lowest coverage".into(),
        panels,
    };
    Ok((text, figure))
}

/// Summary in words of all cells in which some runs report nothing.
fn summary(cells: &[Silent]) -> String {
    let count = |which: &dyn Fn(&Silent) -> bool| cells.iter().filter(|cell| which(cell)).count();
    let all = cells.len();
    let held = count(&|cell| cell.is_held());
    let least = cells.iter().map(|cell| cell.held).fold(f64::INFINITY, f64::min);
    let worst = count(&|cell| cell.held <= least);
    let mut places: Vec<&Silent> = cells.iter().filter(|cell| cell.held <= least).collect();
    // List a place once, not once per size.
    places.sort_by_key(|cell| (cell.violation, cell.motion, cell.parameter));
    places.dedup_by_key(|cell| (cell.violation, cell.motion, cell.parameter));
    let places: String = places.iter().map(|cell| sheet::item(&cell.place())).collect();
    let seen = count(&|cell| cell.left >= LEAST_LEFT);
    format!(
        "
### All cells

The goal is a coverage of {WANTED:.0} % in the silent runs of a cell. Of {all} cells with silent runs,
{held} reach it and {} miss it. Where the law leaves at least {LEAST_LEFT:.0} % of the violation's regressor
unexplained, {} of {seen} reach it.

The lowest coverage is {least:.0} %, in {worst} cells. They are in these places: violation, motion (part left
unexplained at one of the sizes) and parameter.

{places}
In {} cells `replay` reports that the parameter assumes the absence of the violation (`assumes`):
{} of the cells that miss the goal and {} of those that reach it. Cells that miss the goal without
this report: {}.
",
        all - held,
        count(&|cell| cell.left >= LEAST_LEFT && cell.is_held()),
        count(&|cell| cell.rests),
        count(&|cell| cell.rests && !cell.is_held()),
        count(&|cell| cell.rests && cell.is_held()),
        count(&|cell| !cell.rests && !cell.is_held()),
    )
}

impl Violation {
    /// For each of [`SIZES`] that can be reached: the wanted shift, the shift reached, and the size of the violation.
    fn sizes(&self, motion: &Motion, first: u64) -> Result<Vec<(f64, f64, f64)>> {
        let clean = clean_case(1.0, 1000.0);
        let values =
            |case: Case| each(first..first + PAIRS, |seed| Ok(case.estimated(motion, seed)?.estimate.whole_run));
        let without = values(clean)?;
        let moved = |size: f64| -> Result<f64> {
            let with = values((self.case)(clean, size))?;
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

/// Largest shift of the three parameters, in half widths of the interval without the violation.
fn moved_most(with: &Parameters, without: &Parameters) -> f64 {
    let pairs = three(with).into_iter().zip(three(without));
    let told = pairs.filter(|(with, without)| with.u95().is_finite() && without.u95().is_finite());
    let moved = told.map(|(with, without)| (with.fitted().value - without.fitted().value).abs() / without.u95());
    f64::from(moved.fold(0.0, f32::max))
}

/// The parameters of a run, and whether the report warns the user.
fn told(kind: Kind, case: &Case, motion: &Motion, seed: u64) -> Result<Told> {
    let Replayed { outcome, causes, judged } = case.replayed(motion, seed)?;
    let device = errors(&outcome.estimate.whole_run, &case.device);
    Ok(Told {
        device,
        samples: from_fn(|i| device[i].map(|(error, _)| (error, f64::from(judged[i].budget.u95())))),
        warns: !causes.is_empty()
            || outcome.law.status == LawStatus::Broken
            || matches!(outcome.detail.friction.regime, Regime::Presliding | Regime::Stribeck),
        assumed: from_fn(|i| judged[i].assumes.contains(&kind)),
    })
}

/// The line of one size in one motion, and its cells in which some runs report nothing. The figures are the wanted
/// shift, the shift reached, the size of the violation, and the part of it that the law leaves unexplained \[%\].
fn row(
    violation: &'static str,
    motion: &'static str,
    [wanted, in_u95, size, left]: [f64; 4],
    runs: &[Told],
) -> (String, Vec<Silent>) {
    let silent: Vec<&Told> = runs.iter().filter(|run| !run.warns).collect();
    let told_percent = 100.0 * (runs.len() - silent.len()) as f64 / runs.len() as f64;
    let mut figures = vec![
        wanted.to_string(),
        format!("{in_u95:.1}"),
        significant(size),
        format!("{left:.2}"),
        format!("{told_percent:.0}"),
    ];
    let (mut cells, mut ratios) = (Vec::new(), Vec::<String>::new());
    for (i, parameter) in ["mt", "cf", "fc"].into_iter().enumerate() {
        let column = Column::of(silent.iter().filter_map(|run| run.samples[i]));
        if column.given == 0 {
            figures.push("-".into());
            ratios.push("-".into());
            continue;
        }
        let by_device = Column::of(silent.iter().filter_map(|run| run.device[i]));
        let [held_by_device, held] = [by_device, column].map(|by| 100.0 * by.covered() as f64 / column.given as f64);
        let rests = 2 * silent.iter().filter(|run| run.assumed[i]).count() > silent.len();
        cells.push(Silent { violation, motion, parameter, held, rests, left });
        figures.push(format!("{held_by_device:.0} {held:.0}{}", if rests { "*" } else { "" }));
        ratios.push(format!("{:.1}", column.rms));
    }
    figures.push(ratios.join(", "));
    (sheet::row(&[motion], figures), cells)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::motion;

    #[test]
    fn the_summary_says_where_intervals_hold_least_and_what_is_not_named() {
        let cell = |motion, held, rests, left| Silent { violation: "load", motion, parameter: "cf", held, rests, left };
        let cells = [
            cell("random", 0.0, true, 36.6),
            cell("random", 0.0, true, 36.6),
            cell("slow", 50.0, false, 0.0),
            cell("two", 90.0, true, 18.8),
        ];
        let text = summary(&cells);
        for said in [
            "a coverage of 90 % in the silent runs of a cell. Of 4 cells with silent runs,\n1 reach it and 3 miss it.",
            "at least 5 % of the violation's regressor\nunexplained, 1 of 3 reach it.",
            "The lowest coverage is 0 %, in 2 cells.",
            "and parameter.\n\n- load, `random` (36.60 %), `cf`\n\nIn 3 cells",
            "(`assumes`):\n2 of the cells that miss the goal and 1 of those that reach it.",
            "Cells that miss the goal without\nthis report: 1.",
        ] {
            assert!(text.contains(said), "{said}\n{text}");
        }
    }

    #[test]
    fn sizes_move_a_parameter_by_so_much() {
        let [load, ..] = &VIOLATIONS;
        let sizes = load.sizes(motion("random"), 1).unwrap();
        assert_eq!(sizes.len(), SIZES.len());
        for (wanted, is, _) in &sizes {
            assert!((is / wanted - 1.0).abs() < 0.2, "{sizes:?}");
        }
        assert!(sizes.windows(2).all(|pair| pair[0].2 < pair[1].2), "{sizes:?}");
    }
}
