//! The columns of the backlash: every width in every motion, from the force alone and with the terminal sensor.

use inerter_plant::Inerter;
use inerter_tests::{
    backlash::{self, BACKLASHES_M, Cell, goal, sensed_goal},
    grid::{self, Column, Instruments, MOTIONS, Motion, Result},
    sheet::{line, mean, significant},
};

/// Maximum fraction of all values of a rig whose interval misses the true value. A single cell may exceed it by chance.
const MOST_WRONG: f64 = 0.05;
/// Maximum relative error of the stiffness above 0.5 Hz.
const STIFFNESS_GOAL: f64 = 3e-3;
const MICRO: f64 = 1e6;

/// One rig: its tables, the missed goals, and whether the intervals are valid.
pub struct Section {
    pub text: String,
    pub misses: Vec<String>,
    pub holds: bool,
}

/// Measures every backlash in every motion on this rig.
pub fn section(rig: &Instruments, seeds: u64) -> Result<Section> {
    eprintln!("{}: backlash", rig.name);
    let mut by_force = format!(
        "
## Backlash by the force alone, {}

| motion | backlash um | bias | sigma | goal | reached | U95 | given | wrong |
|---|--:|--:|--:|---|---|--:|--:|--:|
",
        rig.name
    );
    let mut by_sensor = format!(
        "
## Backlash and contact with the terminal's sensor, {}

| motion | backlash um | bias | sigma | goal | reached | U95 | given | wrong | ks % bias | ks % sigma | cs % bias | cs % sigma |
|---|--:|--:|--:|---|---|--:|--:|--:|--:|--:|--:|--:|
",
        rig.name
    );
    let (mut given, mut wrong, mut holds) = (0_usize, 0, true);
    let mut misses = Vec::new();
    for (motion, backlash_m) in MOTIONS.iter().flat_map(|motion| BACKLASHES_M.map(|backlash_m| (motion, backlash_m))) {
        let device = Inerter { backlash_m, ..Inerter::paper() };
        let runs = grid::each(1..=seeds, |seed| backlash::run(&device, motion.name, motion.duration_s, rig, seed))?;
        let Cell { force, sensed, stiffness, damping } = backlash::cell(&device, &runs);
        let (bias, sigma, up_to_m) = goal(motion.name);
        // Widths are round numbers of micrometres.
        let by_force_alone = (backlash_m < up_to_m + 1e-9).then_some((bias, sigma));
        let with_sensor = Some((sensed_goal(motion.name), sensed_goal(motion.name)));
        by_force += &line(cells(motion, backlash_m, &force, by_force_alone));
        let mut cells = cells(motion, backlash_m, &sensed, with_sensor);
        for Column { bias, sigma, .. } in [stiffness, damping] {
            cells.extend([mean(100.0 * bias, 100.0 * sigma), significant(100.0 * sigma)]);
        }
        by_sensor += &line(cells);
        let name = format!("{}, {}, backlash {} um", rig.name, motion.name, backlash_m * MICRO);
        for (route, column, goal) in [("force", force, by_force_alone), ("sensor", sensed, with_sensor)] {
            given += column.given;
            wrong += column.wrong;
            misses.extend(missed(&column, goal).map(|what| format!("{name} by the {route}: {what}")));
            if column.is_low() {
                let Column { wrong, given, .. } = column;
                eprintln!("{name} by the {route}: {wrong} of {given} values outside of their interval");
                holds = false;
            }
        }
        let known = stiffness.bias.abs().max(stiffness.sigma) <= STIFFNESS_GOAL;
        if !motion.is_slow() && !known {
            misses.push(format!(
                "{name}: ks bias {} %, sigma {} %; goal {} %",
                significant(100.0 * stiffness.bias),
                significant(100.0 * stiffness.sigma),
                100.0 * STIFFNESS_GOAL
            ));
        }
    }
    let part_wrong = wrong as f64 / given.max(1) as f64;
    if part_wrong > MOST_WRONG {
        eprintln!("{}, backlash: {wrong} of {given} values outside of their interval", rig.name);
        holds = false;
    }
    let text = format!(
        "{by_force}{by_sensor}
In {wrong} of {given} values the interval does not contain the true value: {:.2} %. The goal is at
most {} %.
",
        100.0 * part_wrong,
        100.0 * MOST_WRONG
    );
    Ok(Section { text, misses, holds })
}

fn cells(motion: &Motion, backlash_m: f64, column: &Column, goal: Option<(f64, f64)>) -> Vec<String> {
    let verdict = match (goal, missed(column, goal)) {
        (None, _) => "",
        (Some(_), None) => "yes",
        (Some(_), Some(_)) => "**no**",
    };
    vec![
        motion.name.into(),
        format!("{:.0}", backlash_m * MICRO),
        mean(column.bias * MICRO, column.sigma * MICRO),
        significant(column.sigma * MICRO),
        goal.map_or(String::new(), |(bias, sigma)| format!("{:.1}, {:.1}", bias * MICRO, sigma * MICRO)),
        verdict.into(),
        significant(column.u95 * MICRO),
        column.given.to_string(),
        column.wrong.to_string(),
    ]
}

/// Describes by how much a goal is missed.
fn missed(column: &Column, goal: Option<(f64, f64)>) -> Option<String> {
    let (bias, sigma) = goal?;
    let [found_bias, found_sigma] = [column.bias, column.sigma].map(|found| significant(found * MICRO));
    if column.given == 0 {
        Some("no value".into())
    } else if column.bias.abs() > bias || column.sigma > sigma {
        Some(format!("bias {found_bias}, sigma {found_sigma}; goals {:.1}, {:.1} um", bias * MICRO, sigma * MICRO))
    } else {
        None
    }
}
