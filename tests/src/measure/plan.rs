//! `cargo xtask plan`: whether motions reach the intervals predicted for them, and whether designing them is
//! worthwhile.

use inerter_analysis::plan::{Limits, Part, Plan, Prediction, design, part_text, predict};
use inerter_core::Machine;
use inerter_data::wants;
use inerter_plant::{Excitation, Inerter, Sensors};
use inerter_tests::{
    grid::{self, MOTIONS, Motion, NAMES, Result},
    plan::{Bench, Reached, WITHIN, as_written},
    sheet::{self, Asked, Measured, significant},
};
use std::array::from_fn;

/// First seed and number of the runs that count. No rehearsal uses these seeds.
const SEEDS: (u64, u64) = (1001, 200);
/// First seed and number of runs for fixed motions compared with a design.
const BESIDE: (u64, u64) = (3001, 40);
/// Sample rate of a designed motion's file \[Hz\].
const FILE_HZ: f64 = 1000.0;

/// The grid's benches and others, of which the last two were not used during development; then a rotary axis.
fn benches() -> Vec<Bench> {
    let sensors = Sensors { force_noise_n: 1.0, ..Sensors::default() };
    let paper = Inerter::paper();
    let other =
        Inerter { inertance_kg: 700.0, viscous_n_s_per_m: 250.0, coulomb_n: 90.0, stiffness_n_per_m: 8e6, ..paper };
    let others = [
        (
            "preloaded, 2 kHz, 0.3 N, 1 um",
            Inerter::preloaded(),
            Sensors { force_noise_n: 0.3, sample_rate_hz: 2000.0, metres_per_count: 1e-6, ..sensors },
        ),
        (
            "700 kg, 250 N s/m, 90 N, 3 N, 5 um",
            other,
            Sensors { force_noise_n: 3.0, metres_per_count: 5e-6, ..sensors },
        ),
        (
            "30 kg, 25 N s/m, 4 N, 0.5 N, 1 um",
            Inerter {
                inertance_kg: 30.0,
                viscous_n_s_per_m: 25.0,
                coulomb_n: 4.0,
                stiffness_n_per_m: 4e5,
                contact_damping_n_s_per_m: 300.0,
                structure_mass_kg: 0.4,
                ..paper
            },
            Sensors { force_noise_n: 0.5, metres_per_count: 1e-6, ..sensors },
        ),
        (
            "2000 kg, 900 N s/m, 300 N, 10 N, 10 um, 500 Hz",
            Inerter {
                inertance_kg: 2000.0,
                viscous_n_s_per_m: 900.0,
                coulomb_n: 300.0,
                stiffness_n_per_m: 3e7,
                contact_damping_n_s_per_m: 2e4,
                structure_mass_kg: 8.0,
                ..paper
            },
            Sensors {
                force_noise_n: 10.0,
                newtons_per_code: 0.02,
                metres_per_count: 10e-6,
                sample_rate_hz: 500.0,
                ..sensors
            },
        ),
    ];
    let all = grid::benches(sensors).into_iter().chain(others);
    all.map(|(name, device, sensors)| Bench { name, device, sensors, full_scale: 1.0, machine: Machine::Linear })
        .chain([axis()])
        .collect()
}

/// A rotary axis with the inertia of a shaft, in kg m2, N m and rad.
fn axis() -> Bench {
    let device = Inerter {
        inertance_kg: 2e-4,
        viscous_n_s_per_m: 5e-4,
        coulomb_n: 0.02,
        stiffness_n_per_m: 79.0,
        contact_damping_n_s_per_m: 0.13,
        structure_mass_kg: 0.0,
        ..Inerter::paper()
    };
    let sensors =
        Sensors { force_noise_n: 0.003, newtons_per_code: 1e-5, metres_per_count: 6.2832e-4, ..Sensors::default() };
    Bench {
        name: "rotary axis, 2e-4 kg m2, 10 000 counts a turn",
        device,
        sensors,
        full_scale: 20.0,
        machine: Machine::Rotary,
    }
}

/// Designs: name, bench, limits of stroke \[m\], speed \[m/s\], force \[N\] and duration \[s\], and goals.
const CASES: [(&str, usize, [f64; 4], &str); 12] = [
    ("A: 10 mm, 0.1 m/s, 600 N, 20 s", 0, [0.01, 0.1, 600.0, 20.0], ""),
    ("B: 8 mm, 0.12 m/s, 3000 N, 20 s", 0, [0.008, 0.12, 3000.0, 20.0], ""),
    ("C: 5 N of noise, as A", 1, [0.01, 0.1, 600.0, 20.0], ""),
    ("D: 20 um, as A", 4, [0.01, 0.1, 600.0, 20.0], ""),
    ("E: 95 kg, 5 mm, 0.05 m/s, 200 N, 10 s", 5, [0.005, 0.05, 200.0, 10.0], ""),
    ("F: as A, fc to 0.05 N and mt to 0.03 kg in 60 s", 0, [0.01, 0.1, 600.0, 60.0], "fc to 0.05 N, mt to 0.03 kg"),
    ("G: 5 N of noise, as A, cf to 2 N s/m in 60 s", 1, [0.01, 0.1, 600.0, 60.0], "cf to 2 N s/m"),
    ("H: preloaded, 4 mm, 0.2 m/s, 1500 N, 15 s", 6, [0.004, 0.2, 1500.0, 15.0], ""),
    ("I: 700 kg, 12 mm, 0.06 m/s, 900 N, 30 s", 7, [0.012, 0.06, 900.0, 30.0], ""),
    ("K: 30 kg, 5 mm, 0.1 m/s, 60 N, 25 s", 8, [0.005, 0.1, 60.0, 25.0], ""),
    ("L: 2000 kg, 15 mm, 0.15 m/s, 5000 N, 30 s", 9, [0.015, 0.15, 5000.0, 30.0], ""),
    ("J: rotary axis, 2 rad, 30 rad/s, 0.5 N m, 20 s", 10, [2.0, 30.0, 0.5, 20.0], ""),
];

/// Ratios of results to their predictions.
#[derive(Default)]
struct Tally(Vec<f64>);

impl Tally {
    fn is_within(ratio: f64) -> bool {
        (ratio - 1.0).abs() <= WITHIN
    }

    /// Adds a prediction and its result. Returns the ratio, in bold if it is beyond the limit.
    fn add(&mut self, (predicted, reached): (f64, f64)) -> String {
        let ratio = reached / predicted;
        self.0.push(ratio);
        if Self::is_within(ratio) { format!("{ratio:.2}") } else { format!("**{ratio:.2}**") }
    }

    /// How many are within the limit, and the ratio that is farthest from 1.
    fn text(&self) -> String {
        let within = self.0.iter().filter(|ratio| Self::is_within(**ratio)).count();
        let farthest = self
            .0
            .iter()
            .fold(1.0_f64, |farthest, ratio| if ratio.ln().abs() > farthest.ln().abs() { *ratio } else { farthest });
        format!("{within} of {} (farthest {farthest:.2})", self.0.len())
    }
}

/// For `u_a` from theory alone, for `u_a` with the rehearsed residual, for the scatter, and for `U95`.
type Tallies = [Tally; 4];

/// A number of any magnitude.
fn figure(value: f64) -> String {
    if value.is_finite() && value < 1e-4 { format!("{value:.2e}") } else { significant(value) }
}

/// Table rows of one motion.
fn rows(name: &str, prediction: &Prediction, reached: &[Reached; 3], tallies: &mut Tallies) -> String {
    let mut text = String::new();
    let (_, seeds) = SEEDS;
    for ((predicted, reached), parameter) in prediction.parameters.iter().zip(reached).zip(NAMES) {
        let part = |given: f64| format!("{:.0}", 100.0 * given);
        let mut cells = vec![name.to_string(), parameter.to_string()];
        let given = reached.given as f64 / seeds as f64;
        if predicted.is_given() && given >= 0.5 {
            let pairs = [
                (predicted.theory_u_a, reached.u_a),
                (predicted.u_a(), reached.u_a),
                (predicted.scatter, reached.scatter),
                (predicted.u95(), reached.u95),
            ];
            let [by_theory, of_u_a, of_scatter, of_u95] = from_fn(|i| tallies[i].add(pairs[i]));
            cells.extend([predicted.theory_u_a, predicted.u_a(), reached.u_a].map(figure));
            cells.extend([by_theory, of_u_a]);
            cells.extend([figure(predicted.scatter), figure(reached.scatter), of_scatter]);
            cells.extend([figure(predicted.u95()), figure(reached.u95), of_u95]);
        } else {
            cells.extend(std::iter::repeat_n("-".to_string(), 11));
        }
        let covered = if reached.given == 0 { "-".into() } else { part(reached.covered as f64 / reached.given as f64) };
        cells.extend([part(predicted.given), part(given), covered]);
        text += &sheet::line(cells);
    }
    text
}

const HEAD: &str = "| motion | parameter | u_a by theory | with residual | stated | ratio, theory | ratio | scatter predicted | reached | ratio | U95 predicted | stated | ratio | given % predicted | reached | covered % |
|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|
";

pub fn measure(_: Asked) -> Measured {
    let (first, seeds) = SEEDS;
    let benches = benches();
    let (mut fixed, mut designed) = (Tallies::default(), Tallies::default());
    let mut body = String::new();
    for bench in benches.iter().filter(|bench| bench.machine == Machine::Linear) {
        body += &format!("\n## Fixed motions: {}\n\n{HEAD}", bench.name);
        for motion in MOTIONS.iter().filter(|motion| !motion.is_slow() || bench.sensors.sample_rate_hz < 1500.0) {
            eprintln!("{}: {}", bench.name, motion.name);
            let excitation = Excitation::parse(motion.name, 1)?;
            let prediction = predict(&bench.expected(), &excitation, motion.duration_s)?;
            let reached = bench.reached(&excitation, motion.duration_s, first, seeds)?;
            body += &rows(motion.name, &prediction, &reached, &mut fixed);
        }
    }
    body += &format!("\n## Designed motions\n\n{HEAD}");
    let (mut made, mut beside) = (String::new(), String::new());
    for (name, bench, [stroke_m, speed_m_per_s, force_n, duration_s], wants) in CASES {
        eprintln!("{name}");
        let bench = &benches[bench];
        let limits = Limits { stroke_m, speed_m_per_s, force_n, duration_s, ..Limits::default() };
        let expected = bench.expected();
        let wanted = if wants.is_empty() { Vec::new() } else { wants::parse(wants, Machine::Linear, expected.law())? };
        let plan = design(&expected, limits, &wanted, |_| ())?;
        let written = as_written(&plan.motion, FILE_HZ)?;
        let reached = bench.reached(&written, plan.duration_s, first, seeds)?;
        let letter = name.get(..1).unwrap_or_default();
        body += &rows(letter, &plan.prediction, &reached, &mut designed);
        made += &sheet::item(&format!("{name}: {}", description(&plan, bench.machine)));
        if wanted.is_empty() {
            beside += &compared(name, bench, Limits { duration_s: plan.duration_s, ..limits }, &reached)?;
        }
    }
    let [fixed, designed] = [fixed, designed].map(|tallies| tallies.map(|tally| tally.text()).join(" | "));
    let text = format!(
        "# Planned motions

`cargo xtask plan --update` writes this table. It compares what `inerter plan` predicts for a motion
with the results of {seeds} runs of this motion, with seeds from {first} on (`multi` and `random` keep
seed 1). The settings of the rig are exactly true and stated as exact. The rehearsals of the
predictions use other seeds.

- *u_a*: standard uncertainty from scatter: predicted by the theory alone; predicted with the
  residual of the rehearsals, which is the value that `inerter plan` reports; and stated by the
  estimator, as the mean of all runs.
- *scatter*: predicted by rehearsals, and the root mean square of the errors.
- *U95*: half width of the interval over the whole run: predicted, and the mean of all runs.
- *ratio*: reached over predicted; bold if it differs from 1 by more than {:.0} %.
- *given*: percentage of the rehearsals, and of the runs, with a value. If either is less than half,
  for example because the law is broken, nothing is compared.
- *covered*: percentage of the runs with a value whose interval contains the true value.

| within {:.0} % | u_a, theory | u_a | scatter | U95 |
|---|---|---|---|---|
| fixed motions | {fixed} |
| designed motions | {designed} |

The preloaded bench, the 700 kg bench, H and I were looked at once while the method was developed;
after that, the residual of the rehearsals was added to `u_a`. The last two benches (30 kg and
2000 kg), K and L were not looked at before, and nothing was changed afterwards. The other benches
and cases were used throughout development. Rehearsals and runs use the same plant: the table tests
theory, search and prediction, not whether the plant resembles a real device.

These are the designed motions. Each is within its limits, and the plant reads it from a CSV of
{FILE_HZ} Hz.

{made}{body}
## Under the same limits

Mean half widths of the 95 % intervals over the whole run: of the designed motion, from the runs
above, and of the fixed motions, from {} runs with seeds from {} on. The fixed motions last as
long as the design and are as large as the same limits allow.

- *best*: for mt, cf and fc, the narrowest interval of any fixed motion, relative to the design's.
  One design has to be good at all three at once.
- *together*: the cube root of the product of the three intervals, relative to the design's, for the
  fixed motion with the smallest product.

{beside}",
        100.0 * WITHIN,
        100.0 * WITHIN,
        BESIDE.1,
        BESIDE.0,
    );
    Ok((text, true))
}

/// The parts of a design, and which of its goals it reaches.
fn description(plan: &Plan, machine: Machine) -> String {
    let part = |part: &Part| format!("{:.1} s of {}", part.duration_s, part_text(machine, part));
    let parts: Vec<String> = plan.parts.iter().map(part).collect();
    let reached = plan.wants.iter().map(|want| {
        let u95 = plan.reached(want);
        let verdict = if u95 <= want.u95 { "reached" } else { "not reached" };
        format!("; {}: U95 {}, goal {}, {verdict}", NAMES[want.place], figure(u95), want.u95)
    });
    parts.join(", ") + &reached.collect::<String>()
}

/// Compares a design, which has reached this, with the fixed motions under the same limits.
fn compared(name: &str, bench: &Bench, limits: Limits, reached: &[Reached; 3]) -> Result<String> {
    let (first, seeds) = BESIDE;
    let line = |name: &str, found: &[Reached; 3]| {
        let given = found.iter().map(|found| found.given).min().unwrap_or(0);
        sheet::row(&[name], found.map(|found| figure(found.u95)).into_iter().chain([given.to_string()]))
    };
    let mut text = format!(
        "### {name}\n\n| motion | {} | {} | {} | runs with a value |\n|---|--:|--:|--:|--:|\n",
        NAMES[0], NAMES[1], NAMES[2]
    );
    let own = reached.map(|reached| reached.u95);
    text += &line("designed", reached);
    let (mut best, mut together) = ([f64::INFINITY; 3], f64::INFINITY);
    for Motion { name, .. } in &MOTIONS {
        let large = bench.enlarged(&Excitation::parse(name, 1)?, &limits)?;
        let found = bench.reached(&large, limits.duration_s, first, seeds)?;
        // Without a value it is not a number, which no minimum takes.
        let u95 = found.map(|found| found.u95);
        best = from_fn(|i| best[i].min(u95[i]));
        together = together.min(u95.iter().product());
        text += &line(name, &found);
    }
    let ratios: Vec<String> = best.iter().zip(own).map(|(best, own)| format!("{:.1}", best / own)).collect();
    let together = (together / own.iter().product::<f64>()).cbrt();
    Ok(text + &format!("\nBest: {} times as wide; together {together:.1} times.\n\n", ratios.join(", ")))
}
