//! Finds how long each motion should last so that the sequence is most informative.
//!
//! The information of consecutive motions adds up. Starting from the best single one, the search makes the best
//! exchange of time between two motions as long as one improves the score (Fedorov), with decreasing portions; a motion
//! that would be too short for its ramps is left out, so each additional one must outweigh its own ramps. The score is
//! what the estimator would state for the sum: the optimum is that of its intervals, not a textbook's. Source:
//! Atkinson, Donev and Tobias, Optimum Experimental Designs, with SAS, 9 to 12.

use super::{candidates::Candidate, information::Together};

/// Portions of the total time that are exchanged; the last one is about the accuracy of the result.
const PORTIONS: [f64; 5] = [0.3, 0.1, 0.03, 0.01, 0.003];
/// Maximum exchanges of one portion before the next is tried.
const MOST_EXCHANGES: usize = 60;
/// Minimum improvement of the score for an exchange.
const LEAST_GAIN: f64 = 1e-4;
/// Number of starting motions: the best single ones.
const STARTS: usize = 4;
/// Maximum number of motions in a sequence.
const MOST: usize = 6;

/// Chosen times of each motion \[s\], and their score.
type Times = (Vec<f64>, f64);

/// How long each should last so that together they fill this time with the lowest score; `None` if no motion has a
/// score.
pub(super) fn times(choices: &[&Candidate], seconds: f64, score: impl Fn(&Together) -> f64) -> Option<Times> {
    let alone = (0..choices.len()).filter_map(|place| {
        let mut times = vec![0.0; choices.len()];
        times[place] = seconds;
        let is_long_enough = choices[place].shortest_s <= seconds;
        let score = score(&together(choices, &times)?);
        (is_long_enough && !score.is_nan()).then_some((times, score))
    });
    let mut starts: Vec<Times> = alone.collect();
    starts.sort_by(|a, b| a.1.total_cmp(&b.1));
    let found = starts.into_iter().take(STARTS).map(|start| exchanged(choices, start, seconds, &score));
    found.filter(|(_, score)| score.is_finite()).min_by(|a, b| a.1.total_cmp(&b.1))
}

/// The total information; `None` if no time is assigned.
pub(super) fn together(choices: &[&Candidate], times: &[f64]) -> Option<Together> {
    // The ramps contribute about half as much information.
    let parts = choices.iter().zip(times).filter(|(choice, seconds)| **seconds > choice.part.fade_s);
    Together::lasting(parts.map(|(choice, seconds)| (seconds - choice.part.fade_s, &choice.information)))
}

/// Exchanges times until no exchange improves the score.
fn exchanged(choices: &[&Candidate], start: Times, seconds: f64, score: &impl Fn(&Together) -> f64) -> Times {
    let (mut times, mut found) = start;
    for portion in PORTIONS {
        for _ in 0..MOST_EXCHANGES {
            let pairs = (0..times.len()).flat_map(|giver| (0..times.len()).map(move |taker| (giver, taker)));
            let tried = pairs.filter_map(|(giver, taker)| given(choices, &times, giver, taker, portion * seconds));
            let scored = tried.filter_map(|times| {
                let score = score(&together(choices, &times)?);
                Some((times, score))
            });
            let best = scored.min_by(|a, b| a.1.total_cmp(&b.1));
            match best.filter(|(_, score)| *score < found - LEAST_GAIN || (found.is_infinite() && score.is_finite())) {
                Some(better) => (times, found) = better,
                None => break,
            }
        }
    }
    (times, found)
}

/// The times after one motion has given a portion of its time to another; all of it if too little would be left.
fn given(choices: &[&Candidate], times: &[f64], giver: usize, taker: usize, seconds: f64) -> Option<Vec<f64>> {
    let (has, takes) = (times[giver], times[taker]);
    if giver == taker || has <= 0.0 {
        return None;
    }
    let (from, to) = (choices[giver], choices[taker]);
    let mut moved = seconds.max(to.shortest_s - takes);
    if has - moved < from.shortest_s {
        moved = has;
    }
    let is_one_more = takes == 0.0 && moved < has;
    let count = times.iter().filter(|time| **time > 0.0).count();
    if takes + moved < to.shortest_s || (is_one_more && count >= MOST) {
        return None;
    }
    let mut times = times.to_vec();
    times[giver] -= moved;
    times[taker] += moved;
    Some(times)
}
