//! `cargo xtask changes`: how soon a change of the device is detected, and how often one is reported falsely.

use inerter_core::{Change, Changed, Settings};
use inerter_plant::{Excitation, Inerter, Plant, Simulation};
use inerter_tests::{
    grid::{self, Estimator, Instruments, MOTIONS, Motion, RIGS, Result},
    sheet::{self, Asked, Measured},
};

/// Duration of steady motion in which no change may be reported \[s\].
const STEADY_S: f64 = 3600.0;
/// Runs per step.
const SEEDS: u64 = 4;

/// A step change of the device.
struct Step {
    name: &'static str,
    parameter: Changed,
    times: f64,
}

const STEPS: [Step; 5] = [
    Step { name: "mt +5 %", parameter: Changed::Inertance, times: 1.05 },
    Step { name: "mt halved", parameter: Changed::Inertance, times: 0.5 },
    Step { name: "fc +30 %", parameter: Changed::Coulomb, times: 1.3 },
    Step { name: "fc halved", parameter: Changed::Coulomb, times: 0.5 },
    Step { name: "cf x 3", parameter: Changed::Viscous, times: 3.0 },
];

impl Step {
    fn of(&self, mut device: Inerter) -> Inerter {
        let changed = match self.parameter {
            Changed::Inertance => &mut device.inertance_kg,
            Changed::Viscous => &mut device.viscous_n_s_per_m,
            Changed::Coulomb => &mut device.coulomb_n,
            // A machine without an offset would keep none, whatever it is multiplied by.
            Changed::Offset => unreachable!("no step of the offset"),
        };
        *changed *= self.times;
        device
    }
}

pub fn measure(asked: Asked) -> Measured {
    let mut text = format!(
        "# Changes of the device

How soon the estimator finds a change of the simulated device while it moves, and how many changes
it reports falsely in {:.0} minutes of steady motion. Rigs and motions are those of
[accuracy](accuracy.md). The device changes after 10 s of motion, in `slow` after 60 s.

- Times are the longest of {SEEDS} runs, in seconds.
- `2/4`: the change is found in two of four runs, within 10 s (60 s in `slow`). `-`: it is found in
  none, and the estimate follows it slowly as the memory forgets.
- `*`: in some run another parameter is named than the one that changed. Until the estimator has
  seen more of the motion, it may take viscous friction for Coulomb friction.

Written by `cargo xtask changes --update`. `cargo xtask changes`, part of `cargo xtask test --full`,
measures again. It fails if a figure differs from the table, if a change is found before it happens
or in steady motion, or if a step at 3.2 Hz and 1 N is not found within 2 s in all runs. `--short`,
part of `cargo xtask test`, does the same for the first rig and the device without backlash.
",
        STEADY_S / 60.0
    );
    let mut good = true;
    let (devices, rigs) = if asked == Asked::CompareShort { (1, 1) } else { (2, RIGS.len()) };
    for device in [Inerter::paper(), Inerter::worn()].into_iter().take(devices) {
        for rig in &RIGS[..rigs] {
            let worn = if device.backlash_m > 0.0 { ", worn: 0.1 mm of backlash" } else { "" };
            text += &format!("\n## {}{worn}\n\n| motion |", rig.name);
            text.extend(STEPS.iter().map(|step| format!(" {} |", step.name)));
            text += " found in steady motion |\n|---|--:|--:|--:|--:|--:|--:|\n";
            let mut rows = grid::each(MOTIONS.iter().enumerate(), |(n, motion)| Ok((n, row(&device, motion, rig)?)))?;
            rows.sort_by_key(|(n, _)| *n);
            for (_, (cells, is_good)) in rows {
                text += &sheet::line(cells);
                good &= is_good;
            }
        }
    }
    Ok((text, good))
}

/// The cells of a motion, and whether they are good.
fn row(device: &Inerter, motion: &Motion, rig: &Instruments) -> Result<(Vec<String>, bool)> {
    // As long before the change as after it.
    let at_s = if motion.is_slow() { 60.0 } else { 10.0 };
    let mut cells = vec![motion.name.to_owned()];
    let mut good = true;
    let mut doubt = |what: String| {
        eprintln!("{}, {}{what}", rig.name, motion.name);
        good = false;
    };
    for step in &STEPS {
        let mut found = Vec::new();
        for seed in 1..=SEEDS {
            let excitation = Excitation::parse(motion.name, seed)?;
            let plant = Plant::changing(*device, vec![(at_s, step.of(*device))], excitation)?;
            found.extend(changes(plant, rig, seed, 2.0 * at_s)?.first().copied());
        }
        if let Some((t_s, change)) = found.iter().find(|(t_s, _)| *t_s < at_s) {
            doubt(format!(", {}: found before it was made, at {t_s:.1} s: {change:?}", step.name));
        }
        let longest = found.iter().fold(0.0_f64, |longest, (t_s, _)| longest.max(t_s - at_s));
        let other = if found.iter().any(|(_, change)| change.parameter != step.parameter) { "*" } else { "" };
        let all = found.len() as u64 == SEEDS;
        if motion.name == "mid" && rig.force_noise_n == 1.0 && !(all && longest <= 2.0) {
            doubt(format!(": {} found in {} of {SEEDS}, after {longest:.2} s", step.name, found.len()));
        }
        cells.push(match found.len() {
            0 => "-".into(),
            _ if all => format!("{longest:.2}{other}"),
            some => format!("{some}/{SEEDS}{other}"),
        });
    }
    let steady = changes(Plant::new(*device, Excitation::parse(motion.name, 5)?)?, rig, 5, STEADY_S)?;
    steady.iter().for_each(|(t_s, change)| doubt(format!(", steady: at {t_s:.1} s {change:?}")));
    cells.push(steady.len().to_string());
    Ok((cells, good))
}

/// The reported changes, each with its time \[s\].
fn changes(plant: Plant, rig: &Instruments, seed: u64, duration_s: f64) -> Result<Vec<(f64, Change)>> {
    let sensors = grid::instruments(rig, seed);
    let settings = Settings { memory_s: 30.0, ..grid::calibrated(plant.device(), &sensors) };
    let mut estimator = Estimator::new(&settings)?;
    let mut found = Vec::new();
    for sample in Simulation::of(plant, sensors)?.lasting(duration_s) {
        found.extend(estimator.step(&grid::raw(&sample)).change.map(|change| (sample.t_s, change)));
    }
    Ok(found)
}
