//! `cargo xtask coverage`: how sharp the intervals are where the law is true, how often they hold, and how often where it is nearly true.
#![forbid(unsafe_code)]

use inerter_analysis::diagnose::{Kind, TOLD, reach};
use inerter_core::{LawStatus, NORMAL_COVERAGE, Regime};
use inerter_data::uncertainty::source_word;
use inerter_plant::{Inerter, Sensors};
use inerter_tests::{
    coverage::{Bench, Cell, Outcome, RIGHT, STATED, cells, errors},
    diagnose::{Added, Case, Replayed, clean_case},
    grid::{Error, MOTIONS, Motion, NAMES, each_seed},
    sheet::{self, significant},
};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use std::process::ExitCode;

/// First seed and number of the runs that judge; those from 1 to 100 on the first bench have set the part of the encoder's steps.
const SEEDS: (u64, u64) = (1001, 400);
/// The same for a law that is nearly true.
const NEARLY: (u64, u64) = (2001, 40);
/// Draws of the frontier.
const DRAWN: usize = 20_000;

fn main() -> ExitCode {
    inerter_tests::exit_code(run())
}

/// The benches: that of the grid, and others.
fn benches() -> Vec<Bench> {
    let sensors = Sensors { force_noise_n: 1.0, force_offset_n: 3.0, ..Sensors::default() };
    let paper = Inerter::paper();
    let light = Inerter { inertance_kg: 95.0, viscous_n_s_per_m: 80.0, coulomb_n: 12.0, ..paper };
    let bench = |name, device, sensors| Bench { name, device, sensors, wrong: &[] };
    vec![
        bench("1 kHz, 1 N, 2.44 um", paper, sensors),
        bench(
            "the same, its clock 10 ppm faster than the shaker's",
            paper,
            Sensors { sample_rate_hz: 1000.01, ..sensors },
        ),
        bench("5 N", paper, Sensors { force_noise_n: 5.0, ..sensors }),
        bench("4 kHz", paper, Sensors { sample_rate_hz: 4000.0, ..sensors }),
        bench("0.5 um", paper, Sensors { metres_per_count: 0.5e-6, ..sensors }),
        bench("20 um", paper, Sensors { metres_per_count: 20e-6, ..sensors }),
        bench("95 kg, 80 N s/m, 12 N", light, sensors),
    ]
}

/// A violation of the law in sizes of which each is thrice the one before, and what the whole run says of it.
struct Violation {
    name: &'static str,
    unit: &'static str,
    sizes: [f64; 5],
    kind: Kind,
    case: fn(Case, f64) -> Case,
}

const VIOLATIONS: [Violation; 4] = [
    Violation {
        name: "friction that grows with the load",
        unit: "of the load",
        sizes: [0.0003, 0.001, 0.003, 0.01, 0.03],
        kind: Kind::LoadDependent,
        case: |case, load| Case { added: Added { load, ..case.added }, ..case },
    },
    Violation {
        name: "force once a turn",
        unit: "N",
        sizes: [0.1, 0.3, 1.0, 3.0, 10.0],
        kind: Kind::PositionPeriodic,
        case: |case, ripple_n| Case { added: Added { ripple_n, ..case.added }, ..case },
    },
    Violation {
        name: "friction that rises towards rest (Stribeck, 5 mm/s)",
        unit: "of fc",
        sizes: [0.01, 0.03, 0.1, 0.3, 1.0],
        kind: Kind::Stribeck,
        case: |case, part| {
            let device = Inerter { stribeck_ratio: 1.0 + part, stribeck_velocity_m_per_s: 5e-3, ..case.device };
            Case { device, ..case }
        },
    },
    Violation {
        name: "friction that turns over a distance (presliding)",
        unit: "um",
        sizes: [1.0, 3.0, 10.0, 30.0, 100.0],
        kind: Kind::Presliding,
        case: |case, um| Case { device: Inerter { presliding_m: um * 1e-6, ..case.device }, ..case },
    },
];

fn run() -> Result<bool, Error> {
    let update = sheet::update_asked("coverage")?;
    let (first, seeds) = SEEDS;
    let mut text = format!(
        "# Coverage

`cargo xtask coverage --update` writes this table. What `U95` over the whole run is worth where all that the settings state is true to the last digit: {seeds} runs of each motion of
[accuracy](accuracy.md), seeds from {first} on.

- *rms*: root mean square of the error over `U95`. An interval that is right has 0.51; {} to {} is wanted. *covered*: runs whose interval holds the truth.
- A cell is bold where less than 95 % are covered beyond chance (1 in 10 000), or the rms lies outside beyond chance. *broken*: runs in which the law is called broken in the end.
",
        RIGHT.start(),
        RIGHT.end()
    );
    let (mut right, mut blunt, mut all) = (0, 0, 0);
    for bench in benches() {
        text += &format!(
            "\n## {}\n\n| motion | parameter | U95 | rms | covered % | broken |\n|---|---|--:|--:|--:|--:|\n",
            bench.name
        );
        for motion in MOTIONS.iter().filter(|motion| motion.name != "slow" || bench.sensors.sample_rate_hz < 2000.0) {
            eprintln!("{}: {}", bench.name, motion.name);
            let runs = bench.runs(motion, first, seeds)?;
            let broken = runs.iter().filter(|(_, broken)| *broken).count();
            for (cell, name) in cells(&runs).into_iter().zip(NAMES) {
                all += 1;
                right += usize::from(!cell.is_wrong());
                blunt += usize::from(cell.is_blunt());
                text += &row(motion, name, &cell, broken);
            }
        }
    }
    text += &format!("\n{right} of {all} cells are right. In {blunt} more than 95 % are covered beyond chance.\n");
    text += &stated()?;
    text += &frontier();
    text += &nearly()?;
    print!("{text}");
    sheet::conclude("coverage", &text, 2, update)
}

/// What the settings state is wrong by its uncertainty.
fn stated() -> Result<String, Error> {
    let (first, seeds) = SEEDS;
    let sensors = Sensors { force_noise_n: 1.0, force_offset_n: 3.0, ..Sensors::default() };
    let chance = 196.0 * (0.95 * 0.05 / seeds as f64).sqrt();
    let mut text = format!(
        "
## Settings that are wrong by what they state

Monte Carlo after JCGM 101: in each of {seeds} runs of the first bench the settings are wrong by a normal error of the size that they state, one source at a time, then all. Stated as 95 % are 0.5 % of
the force's gain, 0.2 % of the lead, 0.1 % of the timebase, 20 us of skew, 0.1 kg of the structure's 1.5, 20 % of the contact's stiffness. 95 % of so many runs are {:.1} to {:.1} % by chance.

| wrong | motion | broken | mt: U95 | rms | covered % | cf: U95 | rms | covered % | fc: U95 | rms | covered % |
|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|
",
        95.0 - chance,
        95.0 + chance
    );
    let alone = STATED.iter().map(|source| (source_word(*source), std::slice::from_ref(source)));
    for (name, wrong) in alone.chain([("all", &STATED[..])]) {
        let bench = Bench { name, device: Inerter::paper(), sensors, wrong };
        for motion in MOTIONS.iter().filter(|motion| ["random", "fast", "two"].contains(&motion.name)) {
            eprintln!("{name}: {}", motion.name);
            let runs = bench.runs(motion, first, seeds)?;
            let found = cells(&runs);
            let broken = runs.iter().filter(|(_, broken)| *broken).count().to_string();
            let figures = found.iter().flat_map(|cell| {
                let covered = format!("{:.1}", 100.0 * cell.covered as f64 / cell.given as f64);
                let bold = if cell.is_low() { format!("**{covered}**") } else { covered };
                [significant(cell.u95), format!("{:.2}", cell.rms), bold]
            });
            text += &sheet::line(
                &[name.into(), motion.name.into(), broken].into_iter().chain(figures).collect::<Vec<String>>(),
            );
        }
    }
    Ok(text)
}

fn row(motion: &Motion, name: &str, cell: &Cell, broken: usize) -> String {
    let bold = |text: String| if cell.is_wrong() { format!("**{text}**") } else { text };
    sheet::line(&[
        motion.name.into(),
        name.into(),
        significant(cell.u95),
        bold(format!("{:.2}", cell.rms)),
        bold(format!("{:.1}", 100.0 * cell.covered as f64 / cell.given as f64)),
        broken.to_string(),
    ])
}

/// What a run of a law that is nearly true says: by the device's intervals, and by those of the samples.
struct Told {
    device: Outcome,
    samples: Outcome,
    /// Which of the three name the violation as what they rest on.
    assumed: [bool; 3],
}

/// What it costs to hold a cause of any size that is left out, by how much the standard error grows with it beside the law. A
/// standard error is 1, and so is the step of the sizes.
fn frontier() -> String {
    let mut text = format!(
        "
## Frontier

What is left out beside the law moves a parameter by any size; the run shows by how much, but for chance. Errors are normal, {DRAWN} draws a size. *held*: least part of the truths that the
interval holds, over all sizes; *width*: its mean where there is no such cause, over that of the law's own. *replay*: the interval of `replay`; *beside*: the law fitted with the cause beside it, which is unbiased.

| the standard error grows by | law alone: held % | replay: held % | width | beside: held % | width |
|--:|--:|--:|--:|--:|--:|
"
    );
    for grows in [1.05_f64, 1.1, 1.25, 1.5, TOLD, 2.5, 4.0] {
        let chance = (grows * grows - 1.0).sqrt();
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let draws: Vec<[f64; 2]> = (0..DRAWN).map(|_| [(); 2].map(|()| StandardNormal.sample(&mut random))).collect();
        let k = f64::from(NORMAL_COVERAGE);
        let held = |by: &dyn Fn([f64; 2]) -> (f64, f64)| {
            let within = draws.iter().filter(|draw| {
                let (error, half_width) = by(**draw);
                error.abs() <= half_width
            });
            100.0 * within.count() as f64 / DRAWN as f64
        };
        let sizes = (0..=60).map(|step| f64::from(step) * chance.max(1.0) * 0.25);
        let (mut alone, mut ours, mut beside) = (100.0_f64, 100.0_f64, 100.0_f64);
        for size in sizes {
            alone = alone.min(held(&|[own, _]| (own + size, k)));
            ours = ours.min(held(&|[own, other]| (own + size, k.hypot(reach(size + chance * other, chance)))));
            beside = beside.min(held(&|[own, other]| (own - chance * other, k * grows)));
        }
        let width =
            draws.iter().map(|[_, other]| k.hypot(reach(chance * other, chance))).sum::<f64>() / DRAWN as f64 / k;
        text += &sheet::line(&[
            grows.to_string(),
            format!("{alone:.0}"),
            format!("{ours:.0}"),
            format!("{width:.2}"),
            format!("{beside:.0}"),
            format!("{grows:.2}"),
        ]);
    }
    text
}

/// A law that is nearly true.
fn nearly() -> Result<String, Error> {
    let (first, seeds) = NEARLY;
    let mut text = format!(
        "
## A law that is nearly true

The first bench with one violation of the law in five sizes, {seeds} runs each, seeds from {first} on. *told*: runs in which the law is called broken, or a cause is named unasked, or friction is
called presliding or Stribeck's. The others are silent. Of these, each cell gives two percentages: truths that the device's interval holds, and truths that the interval of `replay` holds, which looks at the samples as well
(`uncertainty`, [THEORY](../THEORY.md), 14). An asterisk: the motion does not tell the violation from the parameter, and `replay` says that the parameter rests on its absence (`assumes`).
*error/U95*: root mean square, by `replay`'s interval.
"
    );
    let (mut held, mut assumed, mut all) = (0, 0, 0);
    for violation in &VIOLATIONS {
        text += &format!(
            "\n### {}\n\n| motion | size {} | told % | mt covered % | cf | fc | error/U95 |\n|---|--:|--:|--:|--:|--:|---|\n",
            violation.name, violation.unit
        );
        for motion in MOTIONS.iter().filter(|motion| motion.name != "slow") {
            for size in violation.sizes {
                let case = (violation.case)(clean_case(1.0, 1000.0), size);
                let runs = each_seed(seeds, |seed| silent(violation.kind, &case, motion, first + seed - 1))?;
                let told = runs.iter().filter(|run| run.device.1).count();
                let device = cells(&runs.iter().map(|run| run.device).collect::<Vec<_>>());
                let samples = cells(&runs.iter().map(|run| run.samples).collect::<Vec<_>>());
                let silent: Vec<&Told> = runs.iter().filter(|run| !run.device.1).collect();
                let rests: [bool; 3] =
                    std::array::from_fn(|i| 2 * silent.iter().filter(|run| run.assumed[i]).count() > silent.len());
                let part: [String; 3] = std::array::from_fn(|i| match samples[i].given {
                    0 => "-".to_string(),
                    given => {
                        let percent = |cell: &Cell| 100.0 * cell.covered as f64 / given as f64;
                        all += 1;
                        held += usize::from(percent(&samples[i]) >= 90.0);
                        assumed += usize::from(percent(&samples[i]) < 90.0 && rests[i]);
                        let star = if rests[i] { "*" } else { "" };
                        format!("{:.0} {:.0}{star}", percent(&device[i]), percent(&samples[i]))
                    }
                });
                let ratios = samples
                    .each_ref()
                    .map(|cell| if cell.given == 0 { "-".into() } else { format!("{:.1}", cell.rms) });
                let [mt, cf, fc] = part;
                text += &sheet::line(&[
                    motion.name.into(),
                    size.to_string(),
                    format!("{:.0}", 100.0 * told as f64 / seeds as f64),
                    mt,
                    cf,
                    fc,
                    ratios.join(", "),
                ]);
            }
        }
    }
    text += &format!(
        "\nOf {all} cells with silent runs, {held} are covered in 90 % of them or more; {assumed} of the others name the violation as what they rest on.\n"
    );
    Ok(text)
}

/// What a run says of the parameters, and whether a person is told that something is wrong.
fn silent(kind: Kind, case: &Case, motion: &Motion, seed: u64) -> Result<Told, Error> {
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
