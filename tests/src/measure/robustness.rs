//! `cargo xtask robustness`: one imperfection of rig or device at a time, as a committed table.
//!
//! Without arguments it compares the measured table with `docs/tables/robustness.md`, lists the differences and fails
//! if there are any. `--update` writes the table instead.

mod table;

use inerter_tests::{
    robustness::cases,
    sheet::{Asked, Measured},
};
use table::Row;

/// Runs per row.
const SEEDS: u64 = 8;

pub fn measure(_: Asked) -> Measured {
    let mut rows: Vec<Row> = Vec::new();
    for case in cases() {
        eprintln!("{}", case.name);
        for &motion in case.motions {
            let usual_n = rows.iter().find(|row| row.motion == motion).map(|row| row.cell.residual_n);
            rows.push(Row { case: case.name, motion, cell: case.cell(motion, 1..=SEEDS, usual_n)? });
        }
    }
    Ok((table::markdown(&rows, SEEDS), true))
}
