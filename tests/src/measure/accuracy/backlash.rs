//! The columns of the backlash: every width in every motion, from the force alone and with the terminal sensor.

use inerter_plant::Inerter;
use inerter_tests::{
    backlash::{self, BACKLASHES_M, Cell, goal, sensed_goal},
    coverage,
    grid::{self, Column, Error, Instruments, MOTIONS, Motion},
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

struct Row {
    motion: &'static Motion,
    backlash_m: f64,
    cell: Cell,
}

/// Measures every backlash in every motion on this rig.
pub fn section(rig: &Instruments, seeds: u64) -> Result<Section, Error> {
    eprintln!("{}: backlash", rig.name);
    let mut rows = Vec::new();
    for motion in &MOTIONS {
        for backlash_m in BACKLASHES_M {
            let device = Inerter { backlash_m, ..Inerter::paper() };
            let run = |seed| backlash::run(&device, motion.name, motion.duration_s, rig, seed);
            let runs = grid::each(1..=seeds, run)?;
            rows.push(Row { motion, backlash_m, cell: backlash::cell(&device, &runs) });
        }
    }
    let mut text = format!(
        "\n## Backlash by the force alone, {0}\n\n{FORCE_HEAD}\n|---|--:|--:|--:|---|---|--:|--:|--:|\n",
        rig.name
    );
    for row in &rows {
        text += &line(row.cells(&row.cell.force, row.goal()));
    }
    text += &format!(
        "\n## Backlash and contact with the terminal's sensor, {}\n\n{SENSED_HEAD}\n|---|--:|--:|--:|---|---|--:|--:|--:|--:|--:|--:|--:|\n",
        rig.name
    );
    for row in &rows {
        let mut cells = row.cells(&row.cell.sensed, row.sensed_goal());
        for Column { bias, sigma, .. } in [row.cell.stiffness, row.cell.damping] {
            cells.extend([mean(100.0 * bias, 100.0 * sigma), significant(100.0 * sigma)]);
        }
        text += &line(cells);
    }
    let (given, wrong) = rows
        .iter()
        .flat_map(|row| [row.cell.force, row.cell.sensed])
        .fold((0, 0), |(given, wrong), c| (given + c.given, wrong + c.wrong));
    let part_wrong = wrong as f64 / given.max(1) as f64;
    text += &format!(
        "\nOf {given} values that were given, {wrong} lie farther from the truth than their interval: {:.2} %; at most {} % is wanted.\n",
        100.0 * part_wrong,
        100.0 * MOST_WRONG
    );
    let mut misses = Vec::new();
    let mut holds = part_wrong <= MOST_WRONG;
    if !holds {
        eprintln!("{}, backlash: {wrong} of {given} values outside of their interval", rig.name);
    }
    for row in &rows {
        for (route, column, goal) in
            [("force", &row.cell.force, row.goal()), ("sensor", &row.cell.sensed, row.sensed_goal())]
        {
            let name =
                format!("{}, {}, backlash {} um by the {route}", rig.name, row.motion.name, row.backlash_m * MICRO);
            misses.extend(missed(column, goal).map(|what| format!("{name}: {what}")));
            let (given, covered) = (column.given as u64, (column.given - column.wrong) as u64);
            if (coverage::Cell { given, covered, ..Default::default() }).is_low() {
                eprintln!("{name}: {} of {} values outside of their interval", column.wrong, column.given);
                holds = false;
            }
        }
        let stiffness = row.cell.stiffness;
        let known = stiffness.bias.abs().max(stiffness.sigma) <= STIFFNESS_GOAL;
        if !row.motion.is_slow() && !known {
            misses.push(format!(
                "{}, {}, backlash {} um: ks {} %, {} % against {} %",
                rig.name,
                row.motion.name,
                row.backlash_m * MICRO,
                significant(100.0 * stiffness.bias),
                significant(100.0 * stiffness.sigma),
                100.0 * STIFFNESS_GOAL
            ));
        }
    }
    Ok(Section { text, misses, holds })
}

const FORCE_HEAD: &str = "| motion | backlash um | bias | sigma | goal | reached | U95 | given | wrong |";
const SENSED_HEAD: &str = "| motion | backlash um | bias | sigma | goal | reached | U95 | given | wrong | ks % bias | ks % sigma | cs % bias | cs % sigma |";

impl Row {
    /// Goals for bias and sigma of the backlash from the force alone.
    fn goal(&self) -> Option<(f64, f64)> {
        let (bias, sigma, up_to_m) = goal(self.motion.name);
        // Widths are round numbers of micrometres.
        (self.backlash_m < up_to_m + 1e-9).then_some((bias, sigma))
    }

    fn sensed_goal(&self) -> Option<(f64, f64)> {
        let goal = sensed_goal(self.motion.name);
        Some((goal, goal))
    }

    fn cells(&self, column: &Column, goal: Option<(f64, f64)>) -> Vec<String> {
        let verdict = match (goal, missed(column, goal)) {
            (None, _) => String::new(),
            (Some(_), None) => "yes".into(),
            (Some(_), Some(_)) => "**no**".into(),
        };
        vec![
            self.motion.name.into(),
            format!("{:.0}", self.backlash_m * MICRO),
            mean(column.bias * MICRO, column.sigma * MICRO),
            significant(column.sigma * MICRO),
            goal.map_or(String::new(), |(bias, sigma)| format!("{:.1}, {:.1}", bias * MICRO, sigma * MICRO)),
            verdict,
            significant(column.u95 * MICRO),
            column.given.to_string(),
            column.wrong.to_string(),
        ]
    }
}

/// Describes by how much a goal is missed.
fn missed(column: &Column, goal: Option<(f64, f64)>) -> Option<String> {
    let (bias, sigma) = goal?;
    let figures = format!("{} um, {} um", significant(column.bias * MICRO), significant(column.sigma * MICRO));
    if column.given == 0 {
        Some("no value".into())
    } else if column.bias.abs() > bias || column.sigma > sigma {
        Some(format!("bias and sigma {figures} against {:.1}, {:.1}", bias * MICRO, sigma * MICRO))
    } else {
        None
    }
}
