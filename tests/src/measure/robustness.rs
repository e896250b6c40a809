//! `cargo xtask robustness`: one imperfection of rig or device at a time, as a committed table.
//!
//! Without arguments it compares the measured table with `docs/tables/robustness.md`, lists the differences and fails
//! if there are any. `--update` writes the table instead.

mod table;

use inerter_tests::grid::{self, Error};
use inerter_tests::robustness::{cases, cell};
use inerter_tests::sheet;
use table::Row;

/// Runs per row.
const SEEDS: u64 = 8;

pub fn run(words: &[&str]) -> Result<bool, Error> {
    let asked = sheet::asked("robustness", words)?;
    let mut rows: Vec<Row> = Vec::new();
    for case in cases() {
        eprintln!("{}", case.name);
        for &motion in case.motions {
            let usual_n = rows.iter().find(|row| row.motion == motion).map(|row| row.cell.residual_n);
            let runs = grid::each(1..=SEEDS, |seed| case.run(motion, seed))?;
            rows.push(Row { case: case.name, motion, cell: cell(&runs, usual_n) });
        }
    }
    let text = table::markdown(&rows, SEEDS);
    print!("{text}");
    sheet::conclude("robustness", &text, 3, asked)
}
