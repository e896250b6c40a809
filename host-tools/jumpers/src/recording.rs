//! A tape played, and what the board sent meanwhile.

use crate::board::{Board, JumperError};
use crate::tape::{REST, Tape};
use inerter_core::{Detail, Estimate, RawSample};
use inerter_wire::{Command, Done, EstimatorEvent, Event, EventKind, Fault, Knot, Pairing, Play, Record, Refusal};

/// Time for what is still on its way, after the knots, after a burst, and after the end \[s\].
pub const TAIL_S: f64 = 0.06;
/// Until only the rest is seen: what the board adds up comes 4 ms later. Half of the rest is then still to come \[s\].
const AT_REST_S: f64 = 0.05;
/// Knots that the board shall hold at least before it is listened to at leisure.
const AHEAD: u16 = 96;

/// Times that a board may say in a row that it has no room, after which it never will have any.
const MOST_REFUSED: u32 = 100;

/// What the board sent while a tape was played.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// Its samples, without the time between others.
    pub samples: Vec<RawSample>,
    /// For each sample, when it had come \[s\].
    pub came_s: Vec<f64>,
    /// Its last estimate while the outputs were driven.
    pub estimate: Option<Estimate>,
    /// The last that came with an estimate: backlash and contact.
    pub detail: Option<Detail>,
    /// What it said is wrong.
    pub faults: Vec<Fault>,
    /// The phase, as it came to be \[ticks\].
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

    fn take(&mut self, board: &mut impl Board, pairing: &mut Pairing) {
        for (came_s, record) in board.records() {
            for event in pairing.take(&record) {
                if let EstimatorEvent::Estimate(estimated) = event {
                    self.estimate = Some(estimated.estimate);
                    self.detail = estimated.detail.or(self.detail);
                }
            }
            match record {
                Record::Samples(batch) => {
                    for sample in batch.iter().flatten() {
                        self.samples.push(sample);
                        self.came_s.push(came_s);
                    }
                }
                Record::Event(Event { kind: EventKind::Fault(fault), .. }) => self.faults.push(fault),
                _ => {}
            }
        }
    }
}

/// Asks something of the player; gives its answer and the room for knots.
pub fn ask(board: &mut impl Board, doing: &'static str, play: Play) -> Result<(u32, u16), JumperError> {
    match board.request(Command::Play(play)).map_err(JumperError::refused(doing))? {
        Done::Played { answer, free } => Ok((answer, free)),
        other => Err(JumperError::Link(format!("the device answers {other:?} to a request to {doing}"))),
    }
}

/// Plays a tape, and where it is wanted a burst after it, from the last knot on.
pub fn record(
    board: &mut impl Board,
    tape: &Tape,
    phase_ticks: u16,
    burst: Option<(u16, u16)>,
) -> Result<Recording, JumperError> {
    let played = played(board, tape, phase_ticks, burst);
    because(board, played)
}

/// A board that has let go of its outputs by itself says why when it is told to.
fn because(board: &mut impl Board, played: Result<Recording, JumperError>) -> Result<Recording, JumperError> {
    match played {
        Err(refused @ JumperError::Refused { why: Refusal::NotPlaying, .. }) => {
            let (stood, _) = ask(board, "stop playing", Play::End)?;
            Err(if stood == Play::TRANSFER_FAILED { JumperError::TransferFailed } else { refused })
        }
        other => other,
    }
}

fn played(
    board: &mut impl Board,
    tape: &Tape,
    phase_ticks: u16,
    burst: Option<(u16, u16)>,
) -> Result<Recording, JumperError> {
    let mut playing = Playing::begin(board, phase_ticks)?;
    playing.put(board, tape.knots())?;
    playing.play_out(board)?;
    if let Some((edge_ticks, blocks)) = burst {
        ask(board, "play a burst", Play::Burst { edge_ticks, blocks })?;
        board.listen(f64::from(blocks) * 256.0 * f64::from(edge_ticks) / 168e6 * 1.5 + TAIL_S)?;
        (playing.recording.edges, _) = ask(board, "tell how far it is", Play::Progress)?;
        board.listen(TAIL_S)?;
    }
    playing.end(board)
}

/// Plays a tape that begins at rest, to an estimator that knows nothing before that rest: the inputs float until the outputs
/// are driven, which would be a force and a displacement of no device. With them the terminal's stiffness came out a 16th of
/// what it is, and gave no backlash.
pub fn record_from_rest(board: &mut impl Board, tape: &Tape, phase_ticks: u16) -> Result<Recording, JumperError> {
    let played = played_from_rest(board, tape, phase_ticks);
    because(board, played)
}

fn played_from_rest(board: &mut impl Board, tape: &Tape, phase_ticks: u16) -> Result<Recording, JumperError> {
    let mut playing = Playing::begin(board, phase_ticks)?;
    let (rest, motion) = tape.knots().split_at(REST);
    playing.put(board, rest)?;
    board.listen(AT_REST_S)?;
    board.request(Command::ResetEstimator)?;
    playing.put(board, motion)?;
    playing.play_out(board)?;
    playing.end(board)
}

/// A board that plays.
struct Playing {
    recording: Recording,
    pairing: Pairing,
    /// Room for knots: all, and now.
    full: u16,
    free: u16,
}

impl Playing {
    /// Drives the outputs, which then stand.
    fn begin(board: &mut impl Board, phase_ticks: u16) -> Result<Self, JumperError> {
        board.records();
        let (phase_ticks, free) = ask(board, "play", Play::Begin { phase_ticks })?;
        let recording = Recording { phase_ticks, ..Recording::default() };
        Ok(Self { recording, pairing: Pairing::new(), full: free, free })
    }

    fn take(&mut self, board: &mut impl Board) {
        self.recording.take(board, &mut self.pairing);
    }

    /// Hands knots over as they find room.
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
            match ask(board, "take what it is to play", Play::Knots(knots)) {
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

    /// Waits for the last knot.
    fn play_out(&self, board: &mut impl Board) -> Result<(), JumperError> {
        board.listen(f64::from(self.full.saturating_sub(self.free)) * 1e-3 + TAIL_S)
    }

    fn end(mut self, board: &mut impl Board) -> Result<Recording, JumperError> {
        self.take(board);
        // Afterwards the inputs float again.
        let Recording { estimate, detail, .. } = self.recording;
        let (stood, _) = ask(board, "stop playing", Play::End)?;
        board.listen(TAIL_S)?;
        self.take(board);
        if stood == Play::TRANSFER_FAILED {
            return Err(JumperError::TransferFailed);
        }
        if stood > 0 {
            return Err(JumperError::TooLate(stood));
        }
        if self.recording.samples.len() < 2 {
            return Err(JumperError::NoSamples);
        }
        Ok(Recording { estimate, detail, ..self.recording })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A player whose outputs fail after so many requests.
    struct Failing {
        requests_left: usize,
        /// What it answers to `End`.
        stood: u32,
        heard: Vec<(f64, Record)>,
    }

    impl Board for Failing {
        fn request(&mut self, command: Command) -> Result<Done, JumperError> {
            let refused = JumperError::Refused { doing: "do", why: Refusal::NotPlaying };
            let stands = self.requests_left == 0;
            self.requests_left = self.requests_left.saturating_sub(1);
            match command {
                Command::Play(Play::End) => Ok(Done::Played { answer: self.stood, free: 256 }),
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

    #[test]
    fn outputs_that_failed_are_told_apart_from_a_computer_that_was_late() {
        let outcome = |requests_left, stood| {
            let mut board = Failing { requests_left, stood, heard: Vec::new() };
            record(&mut board, &Tape::new(), 0, None).map(|_| ())
        };
        // While knots are sent, and after the last one.
        for requests_left in [1, usize::MAX] {
            assert_eq!(outcome(requests_left, Play::TRANSFER_FAILED), Err(JumperError::TransferFailed));
        }
        // The board's patience was at its end.
        assert!(matches!(outcome(1, 3), Err(JumperError::Refused { why: Refusal::NotPlaying, .. })));
        assert_eq!(outcome(usize::MAX, 3), Err(JumperError::TooLate(3)));
        assert_eq!(outcome(usize::MAX, 0), Err(JumperError::NoSamples));
    }
}
