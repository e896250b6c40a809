//! `cargo xtask longrun [UPDATES]`: the fixed-point estimator against the same algorithm in f64, over ten million
//! updates.
//!
//! Two runs: one alternates all motions and rest, the other is the slow motion alone, whose inertance is the hardest to
//! maintain. Prints the largest differences, and fails if one exceeds its bound.

use inerter_core::Settings;
use inerter_plant::{Excitation, Inerter, Simulation};
use inerter_tests::{
    grid::{self, Result},
    reference::{BOUNDS, Pair},
    sheet::number,
};

/// Updates of the fast bank.
const UPDATES: u32 = 10_000_000;
/// One segment of each run, which is repeated.
const RUNS: [(&str, &str); 2] = [
    ("all motions", "mid@20s;hold@5s;slow@60s;random@20s;hold@2s;fast@20s;two@20s;multi@20s;chirp:0.2-20Hz:15mm/s:30s"),
    ("slow alone", "slow@600s"),
];

pub fn run(words: &[&str]) -> Result<bool> {
    let updates = number(words, UPDATES, "updates")?;
    println!("core's integers beside f64, greatest difference at any published estimate over {updates} updates:");
    let pairs = grid::each(RUNS.iter(), |(_, motion)| Ok(shake(motion, updates)))?;
    let mut agree = true;
    for ((name, _), pair) in RUNS.iter().zip(pairs) {
        let pair = match pair {
            Ok(pair) => pair,
            Err(error) => {
                eprintln!("{name}: {error}");
                agree = false;
                continue;
            }
        };
        println!("{name}: {} updates, {} values compared", pair.updates(), pair.compared);
        for ((label, greatest), bound) in ["mt kg", "cf N s/m", "fc N", "F0 N"].iter().zip(pair.greatest).zip(BOUNDS) {
            let word = if greatest <= bound { "" } else { "  OVER" };
            println!("  {label:<9} {greatest:9.2e}  bound {bound:.0e}{word}");
        }
        agree &= pair.agrees() && pair.compared > 0;
    }
    Ok(agree)
}

fn shake(motion: &str, updates: u32) -> Result<Pair> {
    let device = Inerter::paper();
    let settings = Settings { publish_rate_hz: 1.0, ..grid::calibrated(&device, &grid::sensors()) };
    let mut pair = Pair::new(&settings)?;
    let mut index = 0_u32;
    for seed in 1.. {
        let sensors = grid::seeded(grid::sensors(), seed);
        let excitation = Excitation::parse(motion, seed)?;
        let duration_s = excitation.duration_s();
        for sample in Simulation::new(device, excitation, sensors)?.lasting(duration_s) {
            pair.step(&inerter_core::RawSample { index, ..grid::raw(&sample) });
            index = index.wrapping_add(1);
            if pair.updates() >= updates {
                return Ok(pair);
            }
        }
        // The next segment starts at another position, so a sample must be missing here.
        index = index.wrapping_add(1);
    }
    Err("the seeds ran out".into())
}
