//! Finds when the converters sample: the voltages change at one phase after another, and a converter's reading shows
//! how long before its sampling instant the change came.
//!
//! A converter that samples `u` after a change sees `1 - exp(-u / tau)` of it. All phases together give the settling
//! time `tau` and the sampling instant separately; the instant is relative to the count's latch.

use crate::align::{Aligned, Sums};
use crate::board::Board;
use crate::check::{Check, Judged, Measured, Report};
use crate::recording::Recording;
use crate::tape::Tape;
use crate::wires::sound;
use inerter_core::RawSample;

/// Ticks of the core's clock per step, and per microsecond.
const TICKS: f64 = 2625.0;
const TICKS_PER_US: f64 = 168.0;
/// Phases \[ticks\]: closely spaced where a good board's converters sample.
const PHASES: [u16; 16] = [40, 60, 80, 95, 110, 140, 200, 300, 450, 700, 1312, 1968, 2125, 2375, 2525, 2585];
/// Voltages between which both alternate \[sixteenths of a code\].
const ENDS: [u16; 2] = [1000 * 16, 3000 * 16];
/// Number of alternations.
const ROUNDS: usize = 12;
/// From the event to the aperture: 1.5 to 2.5 clocks of trigger latency and 24.5 clocks of sampling, at 42 MHz \[us\].
const LOOK_US: f64 = 0.631;
/// Allowed deviation of the sampling instant from it \[us\].
const NEAR_US: f64 = 0.5;
/// Maximum settling time constant of a good output \[us\]: 3 us to half a code from end to end (DS12288) correspond to
/// a third of it.
const SETTLING_US: f64 = 1.0;
/// 95 % uncertainty of a sampling instant between close phases: the latencies of both DMA controllers, the phase as
/// set, the shape of the settling \[us\].
const U95_US: f64 = 0.15;

fn tape() -> Tape {
    let mut tape = Tape::new();
    for _ in 0..ROUNDS {
        tape.go(ENDS[1], ENDS[0], 1);
        tape.go(ENDS[0], ENDS[1], 1);
    }
    tape.hold(4);
    tape
}

/// By how many of the tape's steps a channel lags the count, at one phase.
fn behind(tape: &Tape, recording: &Recording, aligned: &Aligned, terminal: bool) -> f64 {
    let played =
        Sums::new(tape.steps().iter().map(|step| f64::from(if terminal { step.terminal } else { step.force })));
    let code = |sample: &RawSample| if terminal { sample.terminal_code } else { sample.force_code };
    // After the marker and before the end.
    let inside = |place: usize| {
        let steps = aligned.steps(place);
        steps.start > 64 && steps.end < tape.steps().len() as i64 - 64
    };
    let seen: Vec<(usize, f64)> = recording
        .samples
        .iter()
        .enumerate()
        .filter(|(place, _)| inside(*place))
        .map(|(place, sample)| (place, f64::from(code(sample)) / 64.0))
        .collect();
    let shifted = |place: usize, by: i64| {
        let steps = aligned.steps(place);
        played.mean(steps.start - by..steps.end - by)
    };
    (-2..2)
        .map(|by| {
            // A sampling instant between two steps' levels sees (1 - part) of one, and part of the one before.
            let rows = seen.iter().map(|(place, code)| ([1.0, shifted(*place, by), shifted(*place, by + 1)], *code));
            let rows: Vec<_> = rows.collect();
            let [_, later, earlier] = solve(&rows);
            let part = earlier / (later + earlier);
            (by as f64 + part, (part - 0.5).abs())
        })
        .min_by(|one, other| one.1.total_cmp(&other.1))
        .map_or(0.0, |(behind, _)| behind)
}

/// Least squares with three unknowns, by elimination.
fn solve(rows: &[([f64; 3], f64)]) -> [f64; 3] {
    let mut matrix = [[0.0; 4]; 3];
    for (row, value) in rows {
        for i in 0..3 {
            for j in 0..3 {
                matrix[i][j] += row[i] * row[j];
            }
            matrix[i][3] += row[i] * value;
        }
    }
    for i in 0..3 {
        let best = (i..3).max_by(|&a, &b| matrix[a][i].abs().total_cmp(&matrix[b][i].abs())).unwrap_or(i);
        matrix.swap(i, best);
        let pivot = matrix[i];
        for (_, row) in matrix.iter_mut().enumerate().filter(|(other, _)| *other != i && pivot[i] != 0.0) {
            let factor = row[i] / pivot[i];
            row.iter_mut().zip(pivot).for_each(|(entry, above)| *entry -= factor * above);
        }
    }
    std::array::from_fn(|i| if matrix[i][i] == 0.0 { 0.0 } else { matrix[i][3] / matrix[i][i] })
}

/// When a converter samples, and how its wire settles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Relative to the count's latch \[us\].
    pub at_us: f64,
    /// Time constant \[us\].
    pub settling_us: f64,
}

impl Look {
    /// Steps by which it lags the count at a phase.
    fn behind(&self, phase_us: f64) -> f64 {
        let period_us = TICKS / TICKS_PER_US;
        let since_us = (self.at_us - phase_us).rem_euclid(period_us);
        (-since_us / self.settling_us).exp() - if phase_us < self.at_us { 1.0 } else { 0.0 }
    }

    /// 95 % uncertainty of the instant \[us\]: where the phases around it are far apart, half their distance.
    fn u95_us(&self) -> f64 {
        let at = self.at_us * TICKS_PER_US;
        let phases = || PHASES.map(f64::from).into_iter();
        // The phases are on a circle.
        let after = phases().find(|phase| *phase > at).unwrap_or(TICKS + f64::from(PHASES[0]));
        let before = phases().rfind(|phase| *phase <= at).unwrap_or(f64::from(PHASES[PHASES.len() - 1]) - TICKS);
        U95_US.max((after - before) / TICKS_PER_US / 2.0)
    }

    /// The best fit to the lags found at each phase \[us, steps\].
    pub fn fit(found: &[(f64, f64)]) -> Self {
        let misfit =
            |look: &Self| found.iter().map(|(phase, behind)| (look.behind(*phase) - behind).powi(2)).sum::<f64>();
        let grid = |at: (f64, f64), settling: (f64, f64), count: usize| {
            let part = move |(low, high): (f64, f64), place: usize| low + (high - low) * place as f64 / count as f64;
            (0..=count * count).map(move |place| Self {
                at_us: part(at, place % count),
                // Logarithmically spaced.
                settling_us: part((settling.0.ln(), settling.1.ln()), place / count).exp(),
            })
        };
        let best = |of: &mut dyn Iterator<Item = Self>| {
            of.min_by(|one, other| misfit(one).total_cmp(&misfit(other)))
                .unwrap_or(Self { at_us: 0.0, settling_us: 1.0 })
        };
        let mut look = best(&mut grid((0.0, TICKS / TICKS_PER_US), (0.02, 4.0), 300));
        for width in [0.1, 0.01] {
            let (at, settling) = (look.at_us, look.settling_us);
            look = best(&mut grid((at - width, at + width), (settling * (1.0 - width), settling * (1.0 + width)), 60));
        }
        look
    }
}

/// Plays the tape at each phase and judges; returns the force's skew.
pub fn sweep(board: &mut impl Board, report: &mut Report) -> Judged<Measured> {
    let tape = tape();
    let mut found = [Vec::new(), Vec::new()];
    for phase in PHASES {
        let (recording, aligned) = sound(board, &tape, phase, None, Report::holds, report)?;
        let phase_us = f64::from(recording.phase_ticks) / TICKS_PER_US;
        for (list, terminal) in found.iter_mut().zip([false, true]) {
            list.push((phase_us, behind(&tape, &recording, &aligned, terminal)));
        }
    }
    let looks = found.map(|found| Look::fit(&found));
    judge(looks, report)?;
    Ok(Measured { skew_s: -looks[0].at_us * 1e-6, skew_u95_s: looks[0].u95_us() * 1e-6 })
}

/// Checks that both converters sample when they should.
fn judge(looks: [Look; 2], report: &mut Report) -> Judged<()> {
    let [force, terminal] = looks.map(|look| look.at_us - LOOK_US);
    let [force_u95, terminal_u95] = looks.map(|look| look.u95_us());
    let [force_is_off, terminal_is_off] = [force, terminal].map(|off| off.abs() > NEAR_US);
    let late = |converter: &str, off: f64, u95: f64| {
        let word = if off > 0.0 { "late" } else { "early" };
        let off = off.abs();
        format!("{converter} samples {off:.1} +- {u95:.2} us too {word}: force and position are not simultaneous")
    };
    let cause = match (force_is_off, terminal_is_off) {
        (false, false) => None,
        (true, true) if (force - terminal).abs() < NEAR_US => Some(format!(
            "both converters sample {force:.1} +- {force_u95:.2} us off: a trigger other than the sampling clock starts them"
        )),
        (true, _) => Some(late("the force's converter", force, force_u95)),
        (false, true) => Some(late("the terminal's converter", terminal, terminal_u95)),
    };
    let expected = format!("{LOOK_US} us after the count, within {NEAR_US} us");
    let found = format!("force {:.2} us, terminal {:.2} us", looks[0].at_us, looks[1].at_us);
    report.take(Check::new("timing", expected, found, cause))?;
    let slow = looks.iter().any(|look| look.settling_us > SETTLING_US);
    let cause = slow
        .then_some("an output settles too slowly: disconnect everything but the jumpers from PA4, PA6, PA0 and PA1");
    let found = format!("{:.2} us and {:.2} us", looks[0].settling_us, looks[1].settling_us);
    report.take(Check::new("settling", format!("under {SETTLING_US} us"), found, cause))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn phases() -> impl Iterator<Item = f64> {
        PHASES.iter().map(|ticks| f64::from(*ticks) / TICKS_PER_US)
    }

    #[test]
    fn look_and_settling_are_found_apart() {
        for at_us in [0.4, 0.631, 0.9, 2.631] {
            for settling_us in [0.05, 0.19, 0.6] {
                let look = Look { at_us, settling_us };
                let found: Vec<_> = phases().map(|phase| (phase, look.behind(phase))).collect();
                let fitted = Look::fit(&found);
                assert!((fitted.at_us - at_us).abs() < 0.06, "{look:?}: {fitted:?}");
                // Phases are at least 0.09 us apart: a fast output is found to a fifth, one near the limit to a part in
                // 1000.
                assert!((fitted.settling_us - settling_us).abs() < 0.012, "{look:?}: {fitted:?}");
            }
        }
    }

    #[test]
    fn an_instant_is_as_sure_as_the_phases_around_it_are_close() {
        let u95_us = |at_us| Look { at_us, settling_us: 0.2 }.u95_us();
        assert_eq!(u95_us(0.631), U95_US);
        // From 2585 ticks round to 40, and from 300 to 450.
        for at_us in [0.1, 15.5] {
            assert!((u95_us(at_us) - 80.0 / 168.0 / 2.0).abs() < 1e-9, "{at_us}");
        }
        assert!((u95_us(2.631) - 150.0 / 168.0 / 2.0).abs() < 1e-9);
    }

    #[test]
    fn what_is_off_is_named() {
        let judged = |force: f64, terminal: f64| {
            let mut report = Report::default();
            judge([force, terminal].map(|at_us| Look { at_us, settling_us: 0.2 }), &mut report).ok();
            report.checks.iter().find_map(|check| check.cause.clone())
        };
        assert_eq!(judged(0.63, 0.7), None);
        assert!(judged(8.4, 8.4).is_some_and(|cause| cause.contains("a trigger other than")));
        assert!(
            judged(2.6, 0.63).is_some_and(|cause| cause.contains("force's converter samples 2.0 +- 0.45 us too late"))
        );
        assert!(judged(0.63, 2.6).is_some_and(|cause| cause.contains("terminal's converter")));
        let mut report = Report::default();
        assert_eq!(judge([Look { at_us: 0.63, settling_us: 3.0 }; 2], &mut report), Err(None));
    }

    #[test]
    fn three_unknowns_are_solved() {
        let rows: Vec<_> = (0..9)
            .map(|n| {
                let n = f64::from(n);
                ([1.0, n, n * n], 3.0 - 2.0 * n + 0.5 * n * n)
            })
            .collect();
        for (got, wanted) in solve(&rows).iter().zip([3.0, -2.0, 0.5]) {
            assert!((got - wanted).abs() < 1e-9);
        }
    }
}
