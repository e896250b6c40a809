//! Events of an estimator, in a device or in a replay, and steps of the sample counter.

use crate::{Event, EventKind, Record};
use inerter_core::{Change, Detail, Estimate, Law, Published, Reversal, Warning};

/// An event of an estimator: the one in a device, or the one that replays a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EstimatorEvent {
    /// A reversal of the flanks was accepted.
    Reversal(Reversal),
    /// The device measured has changed.
    Changed(Change),
    /// The samples show something that no device can cause.
    Warned(Warning),
    /// An estimate with what was published with it.
    Estimate(Estimated),
}

/// An estimate with what was published with it, all for the same sample; a device with older firmware sends less.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimated {
    /// The parameters.
    pub estimate: Estimate,
    /// Whether the law holds.
    pub law: Option<Law>,
    /// Band, backlash, contact, friction and changes.
    pub detail: Option<Detail>,
}

impl From<Estimate> for Estimated {
    fn from(estimate: Estimate) -> Self {
        Self { estimate, law: None, detail: None }
    }
}

impl From<Published> for Estimated {
    fn from(Published { estimate, law, detail }: Published) -> Self {
        Self { estimate, law: Some(law), detail: Some(detail) }
    }
}

impl EstimatorEvent {
    /// Index of the sample that the event belongs to. For a reversal it is the middle of the flight, before the latest
    /// sample.
    pub fn index(&self) -> u32 {
        match self {
            Self::Reversal(reversal) => reversal.index,
            Self::Changed(change) => change.index,
            Self::Warned(warning) => warning.index,
            Self::Estimate(estimated) => estimated.estimate.index,
        }
    }
}

/// Joins each estimate with the records that belong to it.
///
/// A device sends `Law` and then `Detail` after its `Estimate`, with the same index; other records may stand between
/// them, as they come from other tasks. `Detail` completes the estimate. Older firmware sends less, and a frame may be
/// lost: an estimate that never gets its `Detail` is handed out without it, with the estimator's next event or on
/// [`flush`](Self::flush). What later versions add to an estimate is a further record before `Detail`, with a field in
/// [`Estimated`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pairing {
    waiting: Option<Estimated>,
}

impl Pairing {
    /// Nothing waits.
    pub const fn new() -> Self {
        Self { waiting: None }
    }

    /// Takes the next record of one device; returns the events that are complete with it, in the order in which the
    /// device sent them.
    pub fn take(&mut self, record: &Record) -> impl Iterator<Item = EstimatorEvent> + use<> {
        let events = match record {
            Record::Estimate(estimate) => {
                let before = self.flush();
                self.waiting = Some((*estimate).into());
                [before, None]
            }
            // For another sample: its own estimate is lost.
            Record::Law(law) => {
                if let Some(waiting) = self.waiting.as_mut().filter(|waiting| waiting.estimate.index == law.index) {
                    waiting.law = Some(*law);
                }
                [None, None]
            }
            Record::Detail(detail) => {
                let waiting = self.waiting.take_if(|waiting| waiting.estimate.index == detail.index);
                let complete = |waiting| Estimated { detail: Some(*detail), ..waiting };
                [waiting.map(complete).map(EstimatorEvent::Estimate), None]
            }
            Record::Reversal(reversal) => [self.flush(), Some(EstimatorEvent::Reversal(*reversal))],
            Record::Event(Event { kind: EventKind::Changed(change), .. }) => {
                [self.flush(), Some(EstimatorEvent::Changed(*change))]
            }
            Record::Event(Event { kind: EventKind::Warned(warning), .. }) => {
                [self.flush(), Some(EstimatorEvent::Warned(*warning))]
            }
            Record::Event(Event {
                kind: EventKind::Started | EventKind::EstimatorReset | EventKind::SourceEnded,
                ..
            }) => [self.flush(), None],
            _ => [None, None],
        };
        events.into_iter().flatten()
    }

    /// The waiting estimate, without what it lacks: for when nothing more comes, or not in time.
    pub fn flush(&mut self) -> Option<EstimatorEvent> {
        self.waiting.take().map(EstimatorEvent::Estimate)
    }
}

/// Sample periods between two values of the sample counter; 1 if the counter went back, because the device restarted
/// and it is unknown how long that took.
pub fn step(from: u32, to: u32) -> u64 {
    let step = to.wrapping_sub(from);
    if step < 1 << 31 { u64::from(step) } else { 1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Health;
    use inerter_core::{Changed, WarningKind};
    extern crate std;
    use std::{vec, vec::Vec};

    fn estimate(index: u32) -> Estimate {
        Estimate { index, ..Estimate::default() }
    }

    fn detail(index: u32) -> Detail {
        Detail { index, ..Detail::default() }
    }

    /// The events for these records; `None` is a pause, which flushes.
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

    fn alone(index: u32) -> EstimatorEvent {
        EstimatorEvent::Estimate(estimate(index).into())
    }

    fn with_detail(index: u32) -> EstimatorEvent {
        EstimatorEvent::Estimate(Estimated { detail: Some(detail(index)), ..estimate(index).into() })
    }

    #[test]
    fn law_and_detail_find_their_estimate_past_records_of_other_tasks() {
        let law = Law { index: 7, ..Law::default() };
        let mut records = vec![
            Some(Record::Estimate(estimate(7))),
            Some(Record::Health(Health::default())),
            Some(Record::Law(law)),
            Some(Record::Health(Health::default())),
            Some(Record::Detail(detail(7))),
            None,
        ];
        let whole = Estimated { law: Some(law), detail: Some(detail(7)), estimate: estimate(7) };
        assert_eq!(paired(&records), [EstimatorEvent::Estimate(whole)]);
        // The detail is lost.
        records.remove(4);
        assert_eq!(paired(&records), [EstimatorEvent::Estimate(Estimated { detail: None, ..whole })]);
        // A device that sends no law; a law of another estimate.
        for between in [Record::Health(Health::default()), Record::Law(Law { index: 6, ..law })] {
            let records = [Record::Estimate(estimate(7)), between, Record::Detail(detail(7))];
            assert_eq!(paired(&records.map(Some)), [with_detail(7)]);
        }
        assert_eq!(paired(&[Some(Record::Law(law)), None]), []);
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
        assert_eq!(paired(&records), [alone(7), EstimatorEvent::Reversal(reversal), alone(9), alone(11)]);
        assert_eq!(paired(&[Some(Record::Estimate(estimate(3))), None, None]), [alone(3)]);
    }

    #[test]
    fn changes_and_warnings_stand_in_order_between_estimates() {
        let change = Change { index: 8, parameter: Changed::Inertance, before: 300.0, after: 250.0 };
        let warning = Warning { index: 10, kind: WarningKind::WrongSign };
        let event = |index, kind| Some(Record::Event(Event { index, kind }));
        let records = [
            Some(Record::Estimate(estimate(7))),
            event(8, EventKind::Changed(change)),
            Some(Record::Estimate(estimate(9))),
            event(10, EventKind::Warned(warning)),
            event(11, EventKind::SettingsChanged),
        ];
        let events = paired(&records);
        let expected = [alone(7), EstimatorEvent::Changed(change), alone(9), EstimatorEvent::Warned(warning)];
        assert_eq!(events, expected);
        assert_eq!(events.iter().map(EstimatorEvent::index).collect::<Vec<_>>(), [7, 8, 9, 10]);
        let reversal = EstimatorEvent::Reversal(Reversal { index: 11, ..Reversal::default() });
        assert_eq!(reversal.index(), 11);
    }

    #[test]
    fn a_replay_gives_all_that_goes_with_an_estimate() {
        let law = Law { index: 7, ..Law::default() };
        let whole = Estimated { law: Some(law), detail: Some(detail(7)), estimate: estimate(7) };
        assert_eq!(Estimated::from(Published { estimate: estimate(7), law, detail: detail(7) }), whole);
    }

    #[test]
    fn steps_of_the_counter_go_over_its_wrap_and_never_back() {
        assert_eq!([step(5, 5), step(5, 6), step(5, 305), step(u32::MAX, 3)], [0, 1, 300, 4]);
        let half = 1 << 31;
        assert_eq!([step(7, 7 + (half - 1)), step(7, 7 + half), step(7, 6)], [u64::from(half - 1), 1, 1]);
    }

    #[test]
    fn a_detail_whose_estimate_is_lost_goes_with_no_other() {
        let lost_estimate = [Some(Record::Estimate(estimate(7))), Some(Record::Detail(detail(9))), None];
        assert_eq!(paired(&lost_estimate), [alone(7)]);
        let lost_detail =
            [Some(Record::Estimate(estimate(7))), Some(Record::Estimate(estimate(9))), Some(Record::Detail(detail(9)))];
        assert_eq!(paired(&lost_detail), [alone(7), with_detail(9)]);
        assert_eq!(paired(&[Some(Record::Detail(detail(9)))]), []);
    }
}
