//! The first tape: checks the wires, the converters' scale relative to each other, and the noise.

use crate::align::{Aligned, ENTRIES, Line, align, positions};
use crate::check::{Check, Report};
use crate::recording::Recording;
use crate::tape::Tape;
use inerter_core::RawSample;
use inerter_wire::{Fault, Knot};
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
pub const NOT_IN_STEP: &str = "the converters do not follow the sampling clock: another trigger starts them, or none, or one of \
                               them is broken";
/// Maximum share of samples that a single disturbance affects.
const ONCE: f64 = 0.05;

/// Checks that the board lost nothing; done for any recording before it is evaluated.
pub fn sampling(recording: &Recording) -> Check {
    let (lost, faults) = (recording.lost(), &recording.faults);
    // The sampler has given up: then no sample is lost, because none arrives.
    let ended = faults.contains(&Fault::SourceUnreadable);
    let cause = if ended || lost as f64 > ONCE * recording.samples.len() as f64 {
        Some(NOT_IN_STEP.to_owned())
    } else if faults.contains(&Fault::SamplerMisaligned) {
        Some("a DMA transfer was lost, so that force, terminal and count were no longer simultaneous".to_owned())
    } else if faults.contains(&Fault::SamplerOverrun) {
        Some("a conversion was not fetched by DMA in time".to_owned())
    } else if let Some(fault) = faults.first() {
        Some(fault.to_string())
    } else {
        (lost > 0).then(|| "samples were lost on the way: check the cable, or close other programs".to_owned())
    };
    let said: Vec<String> = faults.iter().map(|fault| format!("{fault:?}")).collect();
    Check::new("sampling", "no sample lost, no fault", format!("{lost} samples lost, faults: {said:?}"), cause)
}

/// Checks that each edge that is played is counted, in its direction.
pub fn encoder(tape: &Tape, recording: &Recording) -> (Check, Option<Aligned>) {
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
    /// Its line over its own output, after its checks; `None` if one fails.
    fn judge(
        &self,
        (levels, own, other): (&Levels, &[Level], &[Level]),
        recording: &Recording,
        aligned: &Aligned,
        report: &mut Report,
    ) -> Option<(Line, f64)> {
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
        if !report.take(Check::new(self.wire, "follows its own output alone", found, cause)) {
            return None;
        }
        let good = GAIN.contains(&own.slope) && own.offset.abs() < OFFSET && own.worst < STRAIGHT;
        let cause = (!good).then(|| {
            format!(
                "the wire {} is loaded, or a converter is damaged: disconnect everything else from both pins",
                self.pins
            )
        });
        let expected = format!("{} to {}, offset under {OFFSET}, linear to {STRAIGHT} codes", GAIN.start, GAIN.end);
        let found = format!("{:.4}, offset {:.1}, linear to {:.1} codes", own.slope, own.offset, own.worst);
        if !report.take(Check::new(self.gain, expected, found, cause)) {
            return None;
        }
        // Of one conversion: a sample is the mean of many here.
        let noise = held(recording, aligned, &levels.quiet, self.code).1 * (ENTRIES as f64).sqrt();
        Some((own, noise))
    }
}

/// The chain, after all checks of this tape; `None` if one fails.
pub fn chain(levels: &Levels, recording: &Recording, aligned: &Aligned, report: &mut Report) -> Option<Chain> {
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
    let check = Check::new("noise", format!("under {NOISE} codes rms"), found, cause);
    report.take(check).then_some(Chain { force: force.0, terminal: terminal.0 })
}
