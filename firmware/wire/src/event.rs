//! Events of an estimator, in a device or in a replay, and steps of the sample counter.

use crate::{Event, EventKind, Record};
use inerter_core::{Change, Detail, Estimate, Reversal};

/// An event of an estimator: of the one in a device, or of the one that replays a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EstimatorEvent {
    /// A reversal of the flanks was accepted.
    Reversal(Reversal),
    /// The device measured has changed.
    Changed(Change),
    /// An estimate, with what goes with it; a device with an older firmware sends it alone.
    Estimate(Estimate, Option<Detail>),
}

impl EstimatorEvent {
    /// Index of the sample that the event belongs to. For a reversal it is the middle of the flight, before the latest sample.
    pub fn index(&self) -> u32 {
        match self {
            Self::Reversal(reversal) => reversal.index,
            Self::Changed(change) => change.index,
            Self::Estimate(estimate, _) => estimate.index,
        }
    }
}

/// Puts each estimate together with the record that goes with it.
///
/// A device sends `Detail` after its `Estimate`, with the same index; other records may stand between them, as they come from
/// other tasks. An older firmware sends none, and a frame may be lost: such an estimate is handed out alone, when the estimator
/// says the next thing or on [`flush`](Self::flush). What later versions add to an estimate is a further record after `Detail`
/// with the same index: it gets a field here, and a place in [`EstimatorEvent::Estimate`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pairing {
    waiting: Option<Estimate>,
}

impl Pairing {
    /// Nothing waits.
    pub const fn new() -> Self {
        Self { waiting: None }
    }

    /// Takes the next record of one device; gives the events that are complete with it, in the order in which the device sent them.
    pub fn take(&mut self, record: &Record) -> impl Iterator<Item = EstimatorEvent> + use<> {
        let events = match record {
            Record::Estimate(estimate) => {
                let before = self.flush();
                self.waiting = Some(*estimate);
                [before, None]
            }
            // Of another sample: its own estimate is lost.
            Record::Detail(detail) => {
                let estimate = self.waiting.take_if(|estimate| estimate.index == detail.index);
                [estimate.map(|estimate| EstimatorEvent::Estimate(estimate, Some(*detail))), None]
            }
            Record::Reversal(reversal) => [self.flush(), Some(EstimatorEvent::Reversal(*reversal))],
            Record::Event(Event { kind: EventKind::Changed(change), .. }) => {
                [self.flush(), Some(EstimatorEvent::Changed(*change))]
            }
            Record::Event(Event {
                kind: EventKind::Started | EventKind::EstimatorReset | EventKind::SourceEnded,
                ..
            }) => [self.flush(), None],
            _ => [None, None],
        };
        events.into_iter().flatten()
    }

    /// The estimate that waits, alone: nothing comes any more, or not in time.
    pub fn flush(&mut self) -> Option<EstimatorEvent> {
        self.waiting.take().map(|estimate| EstimatorEvent::Estimate(estimate, None))
    }
}

/// Sample periods between two values of the sample counter; one where the counter went back, because the device
/// started anew and nothing says how long that took.
pub fn step(from: u32, to: u32) -> u64 {
    let step = to.wrapping_sub(from);
    if step < 1 << 31 { u64::from(step) } else { 1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Health;
    extern crate std;
    use std::vec::Vec;

    fn estimate(index: u32) -> Estimate {
        Estimate { index, ..Estimate::default() }
    }

    fn detail(index: u32) -> Detail {
        Detail { index, ..Detail::default() }
    }

    /// What comes of the records; `None` stands for a quiet moment.
    fn paired(records: &[Option<Record>]) -> Vec<EstimatorEvent> {
        let mut pairing = Pairing::new();
        let mut events = Vec::new();
        for record in records {
            match record {
                Some(record) => events.extend(pairing.take(record)),
                None => events.extend(pairing.flush()),
            }
        }
        events
    }

    #[test]
    fn a_detail_finds_its_estimate_past_records_of_other_tasks() {
        let records = [
            Some(Record::Estimate(estimate(7))),
            Some(Record::Health(Health::default())),
            Some(Record::Detail(detail(7))),
            None,
        ];
        assert_eq!(paired(&records), [EstimatorEvent::Estimate(estimate(7), Some(detail(7)))]);
    }

    #[test]
    fn an_older_device_sends_estimates_alone_and_in_order() {
        let reversal = Reversal { index: 8, ..Reversal::default() };
        let records = [
            Some(Record::Estimate(estimate(7))),
            Some(Record::Reversal(reversal)),
            Some(Record::Estimate(estimate(9))),
            Some(Record::Estimate(estimate(11))),
            Some(Record::Event(Event { index: 11, kind: EventKind::SourceEnded })),
        ];
        let alone = |index| EstimatorEvent::Estimate(estimate(index), None);
        assert_eq!(paired(&records), [alone(7), EstimatorEvent::Reversal(reversal), alone(9), alone(11)]);
        assert_eq!(paired(&[Some(Record::Estimate(estimate(3))), None, None]), [alone(3)]);
    }

    #[test]
    fn a_detail_whose_estimate_is_lost_goes_with_no_other() {
        let lost_estimate = [Some(Record::Estimate(estimate(7))), Some(Record::Detail(detail(9))), None];
        assert_eq!(paired(&lost_estimate), [EstimatorEvent::Estimate(estimate(7), None)]);
        let lost_detail =
            [Some(Record::Estimate(estimate(7))), Some(Record::Estimate(estimate(9))), Some(Record::Detail(detail(9)))];
        let found =
            [EstimatorEvent::Estimate(estimate(7), None), EstimatorEvent::Estimate(estimate(9), Some(detail(9)))];
        assert_eq!(paired(&lost_detail), found);
        assert_eq!(paired(&[Some(Record::Detail(detail(9)))]), []);
    }
}
