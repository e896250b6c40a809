//! Instructions that the estimator costs on the Cortex-M4F, counted by QEMU.
//!
//! QEMU's `-icount` ties virtual time to executed instructions, so SysTick counts instructions and repeats exactly;
//! cycles of the real core are not modelled (flash wait states, dual issue), so the figures guard against growth and
//! are not timings.

use crate::{
    firmware::{self, Image},
    table::{Options, Row, Table, number},
};
use anyhow::{Context, Result};
use serde_json::Value;
use std::{path::Path, time::Duration};

/// Ends a run that hangs. A run takes under a second, and a hundred times as long in parallel with the suite's tests,
/// which have priority.
const LIMIT: Duration = Duration::from_secs(1800);

/// Goal per sample at 4 kHz, both banks and both routes of the backlash, in instructions.
const SAMPLE_GOAL: f64 = 1600.0;

/// Goal per solve, in instructions.
const SOLVE_GOAL: f64 = 8000.0;

/// Solves per publication: the recent memory, the part of it in motion, and the whole run.
const SOLVES: f64 = 3.0;

/// Compares with the committed table, or writes it.
pub fn run(options: &Options) -> Result<()> {
    let image = firmware::build(Image::QEMU)?;
    let (rows, _) = measure(&image)?;
    let table = Table {
        name: "icount",
        title: "Instructions on the Cortex-M4F",
        about: "Executed instructions of the QEMU image (profile `firmware`), counted by SysTick under `-icount`.\n\n\
                A *sample* is everything from raw counts to the sums of both kernel banks: kernels, sign, gate,\n\
                update and detection of changes. A *sample with backlash* also includes both routes of the backlash.\n\
                A *reversal* is all that an accepted one takes in the route from the force. A *publication* is all\n\
                that it adds to its sample. It solves three times, for the recent memory, its part away from rest\n\
                and the whole run. It also gives each parameter its interval and computes the other published\n\
                figures. A *solve with intervals* is a third of that computation, measured alone.\n\n\
                The goals apply to the means; the maxima have no goal. The figures guard against growth; they are\n\
                not cycles of a real core."
            .into(),
        rows,
        repeats: true,
    };
    table.settle(options)
}

/// Runs the image's own measurement in QEMU: instructions at each sample rate, as the slow bank's share falls with the
/// rate, and the state of the estimator in bytes.
pub fn measure(image: &Path) -> Result<(Vec<Row>, f64)> {
    let printed = firmware::run(image, &["icount"], LIMIT).context("the image's measurement did not run")?;
    parse(&printed)
}

/// Reads the one JSON line that the image prints.
fn parse(printed: &str) -> Result<(Vec<Row>, f64)> {
    let line = printed.lines().rev().find(|line| line.starts_with('{'));
    let line = line.with_context(|| format!("the image printed no JSON line; it printed: {}", printed.trim()))?;
    let value: Value = serde_json::from_str(line).with_context(|| format!("the image's line is not JSON: {line}"))?;
    let number = |value: &Value, path: &str| number(value, path, format_args!("the image's line: {line}"));
    let rates = value["rates"].as_array().with_context(|| format!("no list `rates` in the image's line: {line}"))?;
    let mut rows = Vec::new();
    for rate in rates {
        let rate_hz = number(rate, "sample_rate_hz")?;
        let sample_goal = (rate_hz == 4000.0).then_some(SAMPLE_GOAL);
        for (what, path, parts, goal) in [
            // Without publication.
            ("sample: mean", "step.mean", 1.0, None),
            ("sample: maximum", "step.max", 1.0, None),
            // With both routes of the backlash.
            ("sample with backlash: mean", "contact.mean", 1.0, sample_goal),
            ("sample with backlash: maximum", "contact.max", 1.0, None),
            // What an accepted one costs in the force's route.
            ("reversal", "reversal", 1.0, None),
            // A publication by itself.
            ("solve with intervals: mean", "estimate.mean", SOLVES, Some(SOLVE_GOAL)),
            ("solve with intervals: maximum", "estimate.max", SOLVES, None),
            // What a publication adds to a sample.
            ("publication: mean", "solve", 1.0, None),
        ] {
            let name = format!("{} kHz, {what}", rate_hz / 1000.0);
            rows.push(Row { goal, ..Row::new(name, number(rate, path)? / parts, "instructions") });
        }
    }
    Ok((rows, number(&value, "state_bytes")?))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = r#"{"kind":"icount","rates":[{"sample_rate_hz":1000,"step":{"count":9,"min":420,"mean":883,"max":3654},"publish":{"count":1,"min":2395,"mean":12003,"max":12334},"solve":11020,"estimate":{"count":1,"min":1807,"mean":10020,"max":10256},"contact":{"count":9,"min":520,"mean":983,"max":82000},"reversal":51000,"reversals":12}],"state_bytes":11608}"#;

    #[test]
    fn the_images_line_is_read() {
        let (rows, _) = parse(&format!("booting\n{LINE}\n")).unwrap();
        assert_eq!(rows.len(), 8);
        assert_eq!([rows[0].value, rows[1].value], [883.0, 3654.0]);
        assert_eq!(rows[0], Row::new("1 kHz, sample: mean", 883.0, "instructions"));
        assert_eq!([rows[2].value, rows[4].value, rows[5].value], [983.0, 51_000.0, 3340.0]);
    }

    #[test]
    fn what_is_missing_is_named() {
        assert!(parse("nothing").unwrap_err().to_string().contains("no JSON line"));
        let error = parse(&LINE.replace("state_bytes", "state")).unwrap_err();
        assert!(error.to_string().contains("state_bytes"));
        assert!(parse(&LINE.replace("3654", "\"many\"")).unwrap_err().to_string().contains("step.max"));
        assert!(parse(&LINE.replace("rates", "r")).unwrap_err().to_string().contains("rates"));
    }
}
