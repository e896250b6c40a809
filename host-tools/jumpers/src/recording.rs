//! A tape played, and what the board sent meanwhile.

use crate::board::{Board, JumperError};
use crate::tape::Tape;
use inerter_core::Estimate;
use inerter_core::RawSample;
use inerter_wire::{Command, Done, EstimatorEvent, Event, EventKind, Fault, Knot, Pairing, Play, Record, Refusal};

/// Time for what is still on its way, after the knots, after a burst, and after the end \[s\].
pub const TAIL_S: f64 = 0.06;
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
    /// Its last estimate.
    pub estimate: Option<Estimate>,
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
    match play(board, tape, phase_ticks, burst) {
        // A board that has let go by itself says why when it is told to.
        Err(refused @ JumperError::Refused { why: Refusal::NotPlaying, .. }) => {
            let (stood, _) = ask(board, "stop playing", Play::End)?;
            Err(if stood == Play::TRANSFER_FAILED { JumperError::TransferFailed } else { refused })
        }
        other => other,
    }
}

fn play(
    board: &mut impl Board,
    tape: &Tape,
    phase_ticks: u16,
    burst: Option<(u16, u16)>,
) -> Result<Recording, JumperError> {
    board.records();
    let mut recording = Recording::default();
    let mut pairing = Pairing::new();
    let (found, mut free) = ask(board, "play", Play::Begin { phase_ticks })?;
    recording.phase_ticks = found;
    let full = free;
    let (mut rest, mut refused) = (tape.knots(), 0);
    while !rest.is_empty() {
        let count = rest.len().min(Knot::MAX_KNOTS);
        if usize::from(free) < count {
            // A knot takes a millisecond.
            let waiting = full.saturating_sub(free);
            board.listen(f64::from(waiting.saturating_sub(AHEAD).max(count as u16 - free).min(48)) * 1e-3)?;
            recording.take(board, &mut pairing);
        }
        let (batch, later) = rest.split_at(count);
        let knots = batch.iter().copied().collect();
        match ask(board, "take what it is to play", Play::Knots(knots)) {
            Ok((_, room)) => {
                free = room;
                rest = later;
                refused = 0;
            }
            Err(JumperError::Refused { why: Refusal::QueueFull { free: room, .. }, .. }) if refused < MOST_REFUSED => {
                free = room;
                refused += 1;
            }
            Err(error) => return Err(error),
        }
        recording.take(board, &mut pairing);
    }
    board.listen(f64::from(full.saturating_sub(free)) * 1e-3 + TAIL_S)?;
    if let Some((edge_ticks, blocks)) = burst {
        ask(board, "play a burst", Play::Burst { edge_ticks, blocks })?;
        board.listen(f64::from(blocks) * 256.0 * f64::from(edge_ticks) / 168e6 * 1.5 + TAIL_S)?;
        (recording.edges, _) = ask(board, "tell how far it is", Play::Progress)?;
        board.listen(TAIL_S)?;
    }
    let (stood, _) = ask(board, "stop playing", Play::End)?;
    board.listen(TAIL_S)?;
    recording.take(board, &mut pairing);
    if stood == Play::TRANSFER_FAILED {
        return Err(JumperError::TransferFailed);
    }
    if stood > 0 {
        return Err(JumperError::TooLate(stood));
    }
    if recording.samples.len() < 2 {
        return Err(JumperError::NoSamples);
    }
    Ok(recording)
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
