//! The first tape: checks the wires, the converters' scale relative to each other, and the noise.

use crate::align::{Aligned, ENTRIES, Line, align, positions};
use crate::board::{Board, JumperError};
use crate::check::{Check, Judged, Report};
use crate::recording::{Recording, record};
use crate::tape::Tape;
use inerter_core::RawSample;
use inerter_wire::{Fault, Knot, Record, Refusal};
use std::ops::Range;

/// Half a period after the sampling clock's event: everything has settled when the converters sample.
pub const SETTLED_TICKS: u16 = 1312;
/// Codes at which the voltages are held.
const LEVELS: [u16; 5] = [600, 1300, 2048, 2800, 3500];
/// Knots for which each is held.
const HELD: usize = 24;
/// Knots in which the noise is measured.
const QUIET: usize = 400;
/// Gain from converter to converter: DS12288 allows 0.5 % for one and 0.4 % for the other.
const GAIN: Range<f64> = 0.97..1.03;
/// Combined offset \[codes\].
const OFFSET: f64 = 40.0;
/// Combined deviation from a straight line \[codes\].
const STRAIGHT: f64 = 8.0;
/// Noise of a conversion, rms \[codes\]: 0.7 is typical (66 dB, DS12288).
const NOISE: f64 = 2.5;

/// A code, and the knots that hold it.
type Level = (u16, Range<usize>);

/// The tape, and the ranges of its levels.
pub struct Levels {
    /// The tape to play.
    pub tape: Tape,
    force: Vec<Level>,
    terminal: Vec<Level>,
    quiet: Range<usize>,
}

impl Levels {
    /// Each voltage alone at its levels, then rest.
    pub fn new() -> Self {
        let mut tape = Tape::new();
        let force = LEVELS.map(|code| (code, tape.go(code * 16, Knot::MIDDLE, HELD))).to_vec();
        let terminal = LEVELS.map(|code| (code, tape.go(Knot::MIDDLE, code * 16, HELD))).to_vec();
        let quiet = tape.go(Knot::MIDDLE, Knot::MIDDLE, QUIET);
        Self { tape, force, terminal, quiet }
    }
}

/// What the converters read for the codes put out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chain {
    /// Code of the force input over the code put out.
    pub force: Line,
    /// The same for the terminal input.
    pub terminal: Line,
}

/// The cause if the converters deliver nothing, or lose samples repeatedly.
const NOT_IN_STEP: &str = "the converters do not follow the sampling clock: another trigger starts them, or none, or one of \
                               them is broken";
/// Maximum share of samples that a single disturbance affects.
const ONCE: f64 = 0.05;
/// Overruns since the board's start that are no single disturbance.
const REPEATED: u32 = 3;
/// A board reports its health once a second; on a slow computer an emulated one takes longer. Length of one wait \[s\],
/// and their maximum number.
const HEALTH_S: f64 = 1.2;
const MOST_WAITS: u32 = 5;

/// A tape's recording. If no sample arrives, that is a failed check.
pub fn played(outcome: Result<Recording, JumperError>, report: &mut Report) -> Judged<Recording> {
    if let Err(JumperError::NoSamples | JumperError::Refused { why: Refusal::NoSamples, .. }) = outcome {
        report.take(Check::new("sampling", "samples", "none", Some(NOT_IN_STEP)))?;
    }
    outcome.map_err(Some)
}

/// Plays a tape, and optionally a burst; a recording without a fault, aligned by its counts. `judge` adds the checks
/// to the report: all, or those that failed.
pub fn sound(
    board: &mut impl Board,
    tape: &Tape,
    phase_ticks: u16,
    burst: Option<(u16, u16)>,
    judge: fn(&mut Report, Check) -> Judged<()>,
    report: &mut Report,
) -> Judged<(Recording, Aligned)> {
    let recording = played(record(board, tape, phase_ticks, burst), report)?;
    let (check, aligned) = encoder(tape, &recording);
    judge(report, sampled(board, tape, &recording, check.passed())?)?;
    judge(report, check)?;
    aligned.map(|aligned| (recording, aligned)).ok_or(None)
}

/// Checks that the board lost nothing; done for any recording before it is evaluated. `is_credible` means that the
/// counts are those that were played.
///
/// A recording may not show what is wrong: a board sends the first fault of each kind only, possibly before the
/// recording, and no sample if its sampler has given up. Its health has the number of overruns, so where anything looks
/// wrong the board is asked for it.
pub fn sampled(
    board: &mut impl Board,
    tape: &Tape,
    recording: &Recording,
    is_credible: bool,
) -> Result<Check, JumperError> {
    let (lost, seen) = (recording.lost(), recording.samples.len());
    let is_short = (seen as f64 + lost as f64) < (1.0 - ONCE) * tape.knots().len() as f64;
    let is_doubtful = !is_credible || is_short || lost > 0 || !recording.faults.is_empty();
    let overruns = if is_doubtful { overruns(board)? } else { 0 };
    Ok(sampling(recording, overruns))
}

/// Overruns of the sampler since the board's start; none if the board does not report them.
fn overruns(board: &mut impl Board) -> Result<u32, JumperError> {
    for _ in 0..MOST_WAITS {
        board.listen(HEALTH_S)?;
        let last = board.records().into_iter().rev().find_map(|(_, record)| match record {
            Record::Health(health) => Some(health.overruns),
            _ => None,
        });
        if let Some(overruns) = last {
            return Ok(overruns);
        }
    }
    Ok(0)
}

fn sampling(recording: &Recording, overruns: u32) -> Check {
    let (lost, faults) = (recording.lost(), &recording.faults);
    // The sampler has given up: then no sample is lost, because none arrives.
    let ended = faults.contains(&Fault::SourceUnreadable);
    let cause = if ended || overruns >= REPEATED || lost as f64 > ONCE * recording.samples.len() as f64 {
        Some(NOT_IN_STEP.to_owned())
    } else if faults.contains(&Fault::SamplerMisaligned) {
        Some("a DMA transfer was lost, so that force, terminal and count were no longer simultaneous".to_owned())
    } else if faults.contains(&Fault::SamplerOverrun) {
        Some("a conversion was not fetched by DMA in time".to_owned())
    } else if let Some(fault) = faults.first() {
        Some(fault.to_string())
    } else {
        (lost > 0).then(|| match overruns {
            0 => "samples were lost on the way: check the cable, or close other programs".to_owned(),
            _ => {
                "the sampler lost samples: a DMA transfer was lost, or a conversion was not fetched in time".to_owned()
            }
        })
    };
    let said: Vec<String> = faults.iter().map(|fault| format!("{fault:?}")).collect();
    let also = if overruns > 0 { format!(", {overruns} overruns since the start") } else { String::new() };
    Check::new("sampling", "no sample lost, no fault", format!("{lost} samples lost, faults: {said:?}{also}"), cause)
}

/// Checks that each edge that is played is counted, in its direction.
fn encoder(tape: &Tape, recording: &Recording) -> (Check, Option<Aligned>) {
    const NAME: &str = "encoder wires";
    let expected = "1 count for each edge, upwards";
    let Some(aligned) = align(tape, recording) else {
        let positions = positions(recording);
        let mut sorted = positions.clone();
        sorted.sort_by(f64::total_cmp);
        let base = sorted[sorted.len() / 2];
        // Only one line moves: the count alternates by one, upwards first if A is high, as its pull-up makes it.
        let mean = positions.iter().map(|count| count - base).filter(|count| count.abs() < 1.5).sum::<f64>();
        let cause = match mean / 10.0 {
            1.0.. => "the wire to A (PB1 to PA15) is missing",
            ..=-1.0 => "the wire to B (PB2 to PB3) is missing",
            _ => "the wires to A (PB1 to PA15) and B (PB2 to PB3) are missing",
        };
        return (Check::new(NAME, expected, "no lasting count", Some(cause)), None);
    };
    let Aligned { ratio, residual_counts, .. } = aligned;
    let cause = match ratio {
        -1.05..-0.95 => Some("the wires to A and B are swapped: PB1 goes to PA15, PB2 to PB3"),
        0.45..0.55 => Some("every other edge is counted: the counter takes the edges of one line only"),
        0.99..1.01 if residual_counts < 0.5 => None,
        _ => Some("edges are lost, or noise is counted: check the wires to A and B and the ground"),
    };
    let found = format!("{ratio:.4} counts, {residual_counts:.3} left");
    (Check::new(NAME, expected, found, cause), Some(aligned))
}

/// Mean and deviation of a channel while knots are held, without the first two, when the voltage still moves.
fn held(recording: &Recording, aligned: &Aligned, knots: &Range<usize>, code: fn(&RawSample) -> i32) -> (f64, f64) {
    let steps = ((knots.start + 2) * ENTRIES) as i64..(knots.end * ENTRIES) as i64 - 2;
    let inside = recording.samples.iter().enumerate().filter(|(place, _)| {
        let of = aligned.steps(*place);
        steps.start <= of.start && of.end <= steps.end
    });
    let codes: Vec<f64> = inside.map(|(_, sample)| f64::from(code(sample)) / ENTRIES as f64).collect();
    let count = codes.len().max(1) as f64;
    let mean = codes.iter().sum::<f64>() / count;
    (mean, (codes.iter().map(|code| (code - mean).powi(2)).sum::<f64>() / count).sqrt())
}

struct Channel {
    wire: &'static str,
    gain: &'static str,
    pins: &'static str,
    swapped: &'static str,
    code: fn(&RawSample) -> i32,
}

const FORCE: Channel = Channel {
    wire: "force wire",
    gain: "force gain",
    pins: "PA4 to PA0",
    swapped: "the wires to force and terminal are swapped: PA4 goes to PA0, PA6 to PA1",
    code: |sample| sample.force_code,
};
const TERMINAL: Channel = Channel {
    wire: "terminal wire",
    gain: "terminal gain",
    pins: "PA6 to PA1",
    code: |sample| sample.terminal_code,
    ..FORCE
};

impl Channel {
    /// Its line over its own output, and its noise, after its checks.
    fn judge(
        &self,
        (levels, own, other): (&Levels, &[Level], &[Level]),
        recording: &Recording,
        aligned: &Aligned,
        report: &mut Report,
    ) -> Judged<(Line, f64)> {
        let by = |of: &[Level]| {
            Line::fit(of.iter().map(|(code, knots)| (f64::from(*code), held(recording, aligned, knots, self.code).0)))
        };
        let (own, other) = (by(own), by(other));
        let cause = match (own.slope, other.slope) {
            (0.5.., -0.05..0.05) => None,
            (-0.05..0.05, 0.5..) => Some(self.swapped.to_owned()),
            (-0.05..0.05, -0.05..0.05) => Some(format!("the wire {} is missing", self.pins)),
            _ => Some(format!("the wire {} also leads elsewhere", self.pins)),
        };
        let found = format!("{:.3} of its own output, {:.3} of the other", own.slope, other.slope);
        report.take(Check::new(self.wire, "follows its own output alone", found, cause))?;
        let good = GAIN.contains(&own.slope) && own.offset.abs() < OFFSET && own.worst < STRAIGHT;
        let cause = (!good).then(|| {
            format!(
                "the wire {} is loaded, or a converter is damaged: disconnect everything else from both pins",
                self.pins
            )
        });
        let expected = format!("{} to {}, offset under {OFFSET}, linear to {STRAIGHT} codes", GAIN.start, GAIN.end);
        let found = format!("{:.4}, offset {:.1}, linear to {:.1} codes", own.slope, own.offset, own.worst);
        report.take(Check::new(self.gain, expected, found, cause))?;
        // Of one conversion: a sample is the mean of many here.
        let noise = held(recording, aligned, &levels.quiet, self.code).1 * (ENTRIES as f64).sqrt();
        Ok((own, noise))
    }
}

/// The chain, after all checks of this tape.
pub fn chain(levels: &Levels, recording: &Recording, aligned: &Aligned, report: &mut Report) -> Judged<Chain> {
    let force = FORCE.judge((levels, &levels.force, &levels.terminal), recording, aligned, report)?;
    let terminal = TERMINAL.judge((levels, &levels.terminal, &levels.force), recording, aligned, report)?;
    let noise = [force.1, terminal.1];
    let cause = match noise.map(|noise| noise < NOISE) {
        [true, true] => None,
        [false, false] => {
            Some("noise on the supply or the ground: shorten the wires, and power the board from another port")
        }
        [false, true] => Some("noise on the force's wire: shorten it, and keep it away from the encoder's"),
        [true, false] => Some("noise on the terminal's wire: shorten it, and keep it away from the encoder's"),
    };
    let found = format!("force {:.2}, terminal {:.2} codes rms", noise[0], noise[1]);
    report.take(Check::new("noise", format!("under {NOISE} codes rms"), found, cause))?;
    Ok(Chain { force: force.0, terminal: terminal.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use inerter_wire::{Command, Done, Health};

    /// A board that reports its overruns at the second listening.
    struct Ill {
        overruns: u32,
        listens: u32,
    }

    impl Board for Ill {
        fn request(&mut self, command: Command) -> Result<Done, JumperError> {
            panic!("{command:?}")
        }

        fn listen(&mut self, _: f64) -> Result<(), JumperError> {
            self.listens += 1;
            Ok(())
        }

        fn records(&mut self) -> Vec<(f64, Record)> {
            let health = Record::Health(Health { overruns: self.overruns, ..Health::default() });
            if self.listens == 2 { vec![(0.0, health)] } else { Vec::new() }
        }
    }

    /// This many samples, without those that were lost.
    fn recording(seen: u32, lost: u32, faults: &[Fault]) -> Recording {
        let samples = (0..seen).filter(|index| !(10..10 + lost).contains(index));
        let samples = samples.map(|index| RawSample { index, ..RawSample::default() }).collect();
        Recording { samples, faults: faults.to_vec(), ..Recording::default() }
    }

    #[test]
    fn the_sampler_is_named_before_what_follows_from_its_faults() {
        const TRIGGER: &str = "another trigger starts them";
        const NONE: &[Fault] = &[];
        const ENDED: &[Fault] = &[Fault::SourceUnreadable];
        const MISALIGNED: &[Fault] = &[Fault::SamplerMisaligned];
        let tape = Tape::new();
        for (seen, lost, faults, is_credible, overruns, expected) in [
            (1000, 0, NONE, false, 9, Some(TRIGGER)),
            // The wires are to blame for the counts.
            (1000, 0, NONE, false, 0, None),
            (1000, 0, NONE, false, 1, None),
            (1000, 4, NONE, true, 9, Some(TRIGGER)),
            (1000, 4, NONE, true, 1, Some("a DMA transfer was lost, or a conversion was not fetched")),
            (1000, 4, NONE, true, 0, Some("lost on the way")),
            (1000, 4, MISALIGNED, true, 1, Some("a DMA transfer was lost, so that")),
            (1000, 4, MISALIGNED, true, 40, Some(TRIGGER)),
            (1000, 60, NONE, true, 0, Some(TRIGGER)),
            (1000, 0, ENDED, true, 0, Some(TRIGGER)),
            // The sampler has given up, and nothing says so.
            (20, 0, NONE, true, 70, Some(TRIGGER)),
            (20, 0, NONE, true, 0, None),
        ] {
            let mut board = Ill { overruns, listens: 0 };
            let check = sampled(&mut board, &tape, &recording(seen, lost, faults), is_credible).unwrap();
            let is_named = match (expected, &check.cause) {
                (Some(expected), Some(cause)) => cause.contains(expected),
                (expected, cause) => expected.is_none() && cause.is_none(),
            };
            assert!(is_named, "{seen} {lost} {faults:?} {is_credible} {overruns}: {check:?}");
            assert_eq!(check.found.contains("overruns"), overruns > 0, "{check:?}");
        }
        // A board that looks right is not kept waiting.
        let mut board = Ill { overruns: 9, listens: 0 };
        let check = sampled(&mut board, &tape, &recording(1000, 0, &[]), true).unwrap();
        assert!(check.passed() && board.listens == 0, "{check:?}");
    }

    #[test]
    fn no_samples_are_a_failed_check_at_any_tape() {
        let refused = JumperError::Refused { doing: "play", why: Refusal::NoSamples };
        for error in [JumperError::NoSamples, refused] {
            let mut report = Report::default();
            assert_eq!(played(Err(error), &mut report).map(|_| ()), Err(None));
            assert_eq!(report.checks.len(), 1);
            assert!(report.checks.iter().all(|check| check.name == "sampling" && !check.passed()));
        }
        let mut report = Report::default();
        let late = JumperError::TooLate(1);
        assert_eq!(played(Err(late.clone()), &mut report).map(|_| ()), Err(Some(late)));
        assert!(report.checks.is_empty());
    }
}
