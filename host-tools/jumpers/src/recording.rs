//! Plays a tape and records what the board sends meanwhile.

use crate::board::{Board, JumperError};
use crate::tape::{REST, Tape};
use inerter_core::{Detail, Estimate, RawSample};
use inerter_wire::{Command, Done, EstimatorEvent, Event, EventKind, Fault, Knot, Pairing, Play, Record, Refusal};

/// Rate at which a board samples for the test \[Hz\].
pub const SAMPLE_RATE_HZ: f64 = 1_000.0;
/// Time for data still in transit, after the knots, after a burst, and after the end \[s\].
const TAIL_S: f64 = 0.06;
/// Time until the board sees only the rest: its sums arrive 4 ms later. Half of the rest is then still to come \[s\].
const AT_REST_S: f64 = 0.05;
/// Minimum number of knots in the board before listening without haste.
const AHEAD: u16 = 96;

/// Times that a tape is played if knots arrive too late: a computer may stall, and starts again.
const MOST_PLAYED: u32 = 4;
/// Refusals in a row for lack of room after which the board is given up.
const MOST_REFUSED: u32 = 100;
/// Times to listen again if fewer samples arrive than expected: in total less than the second after which a board that
/// receives nothing releases its outputs.
const MOST_LISTENS: u32 = 12;
/// Minimum length of one such wait, in samples: they arrive in batches.
const LEAST_LISTEN: usize = 10;

/// What the board sent while a tape was played.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// Its consecutive samples.
    pub samples: Vec<RawSample>,
    /// Arrival time of each sample \[s\].
    pub came_s: Vec<f64>,
    /// How many had arrived before the outputs were released.
    pub driven: usize,
    /// Its last estimate while the outputs were driven.
    pub estimate: Option<Estimate>,
    /// The last detail that came with an estimate: backlash and contact.
    pub detail: Option<Detail>,
    /// The faults it reported.
    pub faults: Vec<Fault>,
    /// The actual phase \[ticks\].
    pub phase_ticks: u32,
    /// Edges of the burst.
    pub edges: u32,
}

impl Recording {
    /// Samples that are missing between the others.
    pub fn lost(&self) -> u64 {
        let gaps = self.samples.windows(2).map(|pair| u64::from(pair[1].index.wrapping_sub(pair[0].index)));
        gaps.filter(|gap| *gap < 1 << 31).map(|gap| gap.saturating_sub(1)).sum()
    }
}

/// The request that [`Play::Progress`] stands for.
const PROGRESS: &str = "report its progress";

/// Sends the player a request; returns its answer and the room for knots.
pub fn ask(board: &mut impl Board, doing: &'static str, play: Play) -> Result<(u32, u16), JumperError> {
    match board.request(Command::Play(play)).map_err(JumperError::refused(doing))? {
        Done::Played { answer, free } => Ok((answer, free)),
        other => Err(JumperError::Link(format!("the device answers {other:?} to a request to {doing}"))),
    }
}

/// Plays a tape, and optionally a burst after its last knot.
pub fn record(
    board: &mut impl Board,
    tape: &Tape,
    phase_ticks: u16,
    burst: Option<(u16, u16)>,
) -> Result<Recording, JumperError> {
    in_time(board, |board| {
        let mut playing = Playing::begin(board, phase_ticks)?;
        playing.put(board, tape.knots())?;
        playing.play_out(board)?;
        if let Some((edge_ticks, blocks)) = burst {
            ask(board, "play a burst", Play::Burst { edge_ticks, blocks })?;
            for _ in 0..MOST_LISTENS {
                playing.wait(board, TAIL_S)?;
                let (edges, _) = ask(board, PROGRESS, Play::Progress)?;
                if edges == std::mem::replace(&mut playing.recording.edges, edges) {
                    break;
                }
            }
        }
        playing.end(board)
    })
}

/// Plays again until no knot is so late that the player stopped or released the outputs; a limited number of times.
fn in_time<B: Board>(
    board: &mut B,
    mut play: impl FnMut(&mut B) -> Result<Recording, JumperError>,
) -> Result<Recording, JumperError> {
    let mut left = MOST_PLAYED;
    loop {
        left -= 1;
        let played = play(board);
        match because(board, played) {
            Err(JumperError::TooLate(_) | JumperError::Refused { why: Refusal::NotPlaying, .. }) if left > 0 => {}
            other => return other,
        }
    }
}

/// Asks a board that has released its outputs by itself for the reason, with the command to stop.
fn because(board: &mut impl Board, played: Result<Recording, JumperError>) -> Result<Recording, JumperError> {
    match played {
        Err(refused @ JumperError::Refused { why: Refusal::NotPlaying, .. }) => {
            let (stood, _) = ask(board, "stop playing", Play::End)?;
            Err(if stood == Play::TRANSFER_FAILED { JumperError::TransferFailed } else { refused })
        }
        other => other,
    }
}

/// Plays a tape that begins at rest, to an estimator that knows nothing before that rest: the inputs float until the
/// outputs are driven, which would look like a force and a displacement that no device has. With them the terminal's
/// stiffness came out as a 16th of its true value, and there was no backlash.
pub fn record_from_rest(board: &mut impl Board, tape: &Tape, phase_ticks: u16) -> Result<Recording, JumperError> {
    in_time(board, |board| {
        let mut playing = Playing::begin(board, phase_ticks)?;
        let (rest, motion) = tape.knots().split_at(REST);
        playing.put(board, rest)?;
        playing.wait(board, AT_REST_S)?;
        board.request(Command::ResetEstimator)?;
        playing.put(board, motion)?;
        playing.play_out(board)?;
        playing.end(board)
    })
}

/// A board that plays a tape.
struct Playing {
    recording: Recording,
    pairing: Pairing,
    /// Room for knots: total, and at present.
    full: u16,
    free: u16,
}

impl Playing {
    /// Starts to drive the outputs, which then stay constant.
    fn begin(board: &mut impl Board, phase_ticks: u16) -> Result<Self, JumperError> {
        board.records();
        let (phase_ticks, free) = ask(board, "play", Play::Begin { phase_ticks })?;
        let recording = Recording { phase_ticks, ..Recording::default() };
        Ok(Self { recording, pairing: Pairing::new(), full: free, free })
    }

    fn take(&mut self, board: &mut impl Board) {
        let recording = &mut self.recording;
        for (came_s, record) in board.records() {
            for event in self.pairing.take(&record) {
                if let EstimatorEvent::Estimate(estimated) = event {
                    recording.estimate = Some(estimated.estimate);
                    recording.detail = estimated.detail.or(recording.detail);
                }
            }
            match record {
                Record::Samples(batch) => {
                    for sample in batch.iter().flatten() {
                        recording.samples.push(sample);
                        recording.came_s.push(came_s);
                    }
                }
                Record::Event(Event { kind: EventKind::Fault(fault), .. }) => recording.faults.push(fault),
                _ => {}
            }
        }
    }

    /// Sends knots as there is room for them.
    fn put(&mut self, board: &mut impl Board, knots: &[Knot]) -> Result<(), JumperError> {
        let (mut rest, mut refused) = (knots, 0);
        while !rest.is_empty() {
            let count = rest.len().min(Knot::MAX_KNOTS);
            if usize::from(self.free) < count {
                // A knot takes a millisecond.
                let waiting = self.full.saturating_sub(self.free);
                board.listen(f64::from(waiting.saturating_sub(AHEAD).max(count as u16 - self.free).min(48)) * 1e-3)?;
                self.take(board);
            }
            let (batch, later) = rest.split_at(count);
            let knots = batch.iter().copied().collect();
            match ask(board, "take knots to play", Play::Knots(knots)) {
                Ok((_, room)) => {
                    self.free = room;
                    rest = later;
                    refused = 0;
                }
                Err(JumperError::Refused { why: Refusal::QueueFull { free: room, .. }, .. })
                    if refused < MOST_REFUSED =>
                {
                    self.free = room;
                    refused += 1;
                }
                Err(error) => return Err(error),
            }
            self.take(board);
        }
        Ok(())
    }

    /// Waits until the board has played the last knot.
    fn play_out(&mut self, board: &mut impl Board) -> Result<(), JumperError> {
        for _ in 0..MOST_REFUSED {
            let waiting = self.full.saturating_sub(self.free);
            if waiting == 0 {
                break;
            }
            board.listen(f64::from(waiting) * 1e-3)?;
            (_, self.free) = ask(board, PROGRESS, Play::Progress)?;
        }
        self.wait(board, TAIL_S)
    }

    /// Listens until this many seconds' worth of further samples have arrived: the wait is measured by the board's
    /// clock, however long the transfer takes. If none arrive, it ends nevertheless.
    fn wait(&mut self, board: &mut impl Board, for_s: f64) -> Result<(), JumperError> {
        self.take(board);
        let wanted = self.recording.samples.len() + (for_s * SAMPLE_RATE_HZ) as usize;
        for _ in 0..MOST_LISTENS {
            let left = wanted.saturating_sub(self.recording.samples.len());
            if left == 0 {
                break;
            }
            board.listen(left.max(LEAST_LISTEN) as f64 / SAMPLE_RATE_HZ)?;
            self.take(board);
        }
        Ok(())
    }

    fn end(mut self, board: &mut impl Board) -> Result<Recording, JumperError> {
        self.take(board);
        // Afterwards the inputs float again.
        let Recording { estimate, detail, .. } = self.recording;
        let driven = self.recording.samples.len();
        let (stood, _) = ask(board, "stop playing", Play::End)?;
        self.wait(board, TAIL_S)?;
        if stood == Play::TRANSFER_FAILED {
            return Err(JumperError::TransferFailed);
        }
        if stood > 0 {
            return Err(JumperError::TooLate(stood));
        }
        if self.recording.samples.len() < 2 {
            return Err(JumperError::NoSamples);
        }
        Ok(Recording { estimate, detail, driven, ..self.recording })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use inerter_wire::Samples;

    /// A player whose outputs fail after this many requests.
    struct Failing {
        requests_left: usize,
        /// Its answers to successive `End` requests; the last one repeats.
        stood: &'static [u32],
        heard: Vec<(f64, Record)>,
    }

    impl Board for Failing {
        fn request(&mut self, command: Command) -> Result<Done, JumperError> {
            let refused = JumperError::Refused { doing: "do", why: Refusal::NotPlaying };
            let stands = self.requests_left == 0;
            self.requests_left = self.requests_left.saturating_sub(1);
            match command {
                Command::Play(Play::End) => {
                    let (answer, later) = self.stood.split_first().expect("an answer");
                    self.stood = if later.is_empty() { self.stood } else { later };
                    Ok(Done::Played { answer: *answer, free: 256 })
                }
                Command::Play(_) if stands => Err(refused),
                Command::Play(_) => Ok(Done::Played { answer: 0, free: 256 }),
                other => panic!("{other:?}"),
            }
        }

        fn listen(&mut self, _: f64) -> Result<(), JumperError> {
            Ok(())
        }

        fn records(&mut self) -> Vec<(f64, Record)> {
            std::mem::take(&mut self.heard)
        }
    }

    /// A board that delivers this many samples each time, however long one listens.
    struct Behind {
        each: u32,
        index: u32,
        listens: u32,
    }

    impl Board for Behind {
        fn request(&mut self, command: Command) -> Result<Done, JumperError> {
            panic!("{command:?}")
        }

        fn listen(&mut self, _: f64) -> Result<(), JumperError> {
            self.listens += 1;
            Ok(())
        }

        fn records(&mut self) -> Vec<(f64, Record)> {
            let due = self.index..self.listens * self.each;
            self.index = due.end;
            let samples: Vec<_> = due.map(|index| RawSample { index, ..RawSample::default() }).collect();
            vec![(0.0, Record::Samples(Samples::from_slice(&samples).0))]
        }
    }

    #[test]
    fn waits_go_by_the_samples_and_end_without_them() {
        let waited = |each| {
            let mut board = Behind { each, index: 0, listens: 0 };
            let recording = Recording::default();
            let mut playing = Playing { recording, pairing: Pairing::new(), full: 256, free: 256 };
            playing.wait(&mut board, 0.06).unwrap();
            (playing.recording.samples.len(), board.listens)
        };
        assert_eq!(waited(30), (60, 2));
        assert_eq!(waited(7), (63, 9));
        assert_eq!(waited(0), (0, MOST_LISTENS));
    }

    #[test]
    fn outputs_that_failed_are_told_apart_from_a_computer_that_was_late() {
        let outcome = |requests_left, stood| {
            let mut board = Failing { requests_left, stood, heard: Vec::new() };
            record(&mut board, &Tape::new(), 0, None).map(|_| ())
        };
        // While knots are sent, and after the last one.
        for requests_left in [1, usize::MAX] {
            assert_eq!(outcome(requests_left, &[Play::TRANSFER_FAILED]), Err(JumperError::TransferFailed));
        }
        // The board has timed out.
        assert!(matches!(outcome(1, &[3]), Err(JumperError::Refused { why: Refusal::NotPlaying, .. })));
        assert_eq!(outcome(usize::MAX, &[3]), Err(JumperError::TooLate(3)));
        assert_eq!(outcome(usize::MAX, &[0]), Err(JumperError::NoSamples));
        // A failure need not persist: the tape is played again.
        assert_eq!(outcome(usize::MAX, &[3, 1, 0]), Err(JumperError::NoSamples));
    }
}
