//! How long each motion should last, so that in a row they tell most.
//!
//! Motions one after the other add their information. From the best one alone the best exchange of time between two
//! motions is made as long as there is one (Fedorov), the times growing smaller; one that would be too short for its
//! lead-in and lead-out is left out, and so each more pays for its own. What is scored is what the estimator would
//! state of the sum: the optimum is that of its intervals, not of a textbook's. Source: Atkinson, Donev and Tobias,
//! Optimum Experimental Designs, with SAS, 9 to 12.

use super::information::{Information, Together};

/// Parts of the whole time that are exchanged, the last one about the accuracy of the result.
const PORTIONS: [f64; 5] = [0.3, 0.1, 0.03, 0.01, 0.003];
/// Exchanges of one portion after which the next is tried in any case.
const MOST_EXCHANGES: usize = 60;
/// Gain in the score under which an exchange is none.
const LEAST_GAIN: f64 = 1e-4;
/// Motions that are each begun with: the best ones by themselves.
const STARTS: usize = 4;
/// Most motions in a row.
const MOST: usize = 6;

/// One motion to choose.
pub(super) struct Choice<'a> {
    /// What it tells in a second.
    pub information: &'a Information,
    /// Least time that it takes \[s\].
    pub shortest_s: f64,
    /// Time of it in which it tells nothing \[s\].
    pub lost_s: f64,
}

/// Chosen times of each motion \[s\], and their score.
type Times = (Vec<f64>, f64);

/// How long each should last so that together they fill this time with the least score; nothing where no motion has a
/// score.
pub(super) fn times(choices: &[Choice<'_>], seconds: f64, score: impl Fn(&Together) -> f64) -> Option<Times> {
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

/// What all of them tell; nothing of no time at all.
pub(super) fn together(choices: &[Choice<'_>], times: &[f64]) -> Option<Together> {
    let parts = choices.iter().zip(times).filter(|(choice, seconds)| **seconds > choice.lost_s);
    Together::lasting(parts.map(|(choice, seconds)| (seconds - choice.lost_s, choice.information)))
}

/// Exchanges times until no exchange improves the score.
fn exchanged(choices: &[Choice<'_>], start: Times, seconds: f64, score: &impl Fn(&Together) -> f64) -> Times {
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

/// The times after one motion has given another so much of its own; all of it where too little would be left.
fn given(choices: &[Choice<'_>], times: &[f64], giver: usize, taker: usize, seconds: f64) -> Option<Vec<f64>> {
    let (has, takes) = (times[giver], times[taker]);
    if giver == taker || has <= 0.0 {
        return None;
    }
    let (from, to) = (&choices[giver], &choices[taker]);
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
