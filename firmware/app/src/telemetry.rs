//! Sends records as frames on the link.
//!
//! Replies, events and estimates go before raw samples. Every write has a time limit, so that a task waiting for room
//! here waits for a bounded time; a record that cannot be written is dropped, counted, and leaves a gap in the
//! sequence.
//!
//! On a mute link records are discarded without being counted, because no host is connected to miss them. The stream
//! begins, with [`EventKind::Started`] and sequence 0, when a host speaks.

use crate::alive::{BEAT, Task};
use crate::app::App;
use crate::logging::log;
use crate::messages::{Outgoing, Restart};
use core::pin::pin;
use embassy_futures::select::{Either3, select3};
use embassy_time::{Duration, Timer, with_timeout};
use embedded_io_async::Write;
use inerter_wire::{DELIMITER, Event, EventKind, MAX_FRAME, Record, SequenceCounter, SettingsValues, encode_record};

/// Time limit for a frame on a link whose host reads.
const WRITE_LIMIT: Duration = Duration::from_millis(1_000);
/// Time limit for a frame after one that timed out, until one gets through.
const STALLED_WRITE_LIMIT: Duration = Duration::from_millis(10);
/// Largest jump of the sequence: half of its range would look like a restart.
const GREATEST_JUMP: u32 = 0x7000;

struct Sender<'a, W> {
    app: &'a App,
    link: W,
    sequence: SequenceCounter,
    /// Whether the stream has begun.
    begun: bool,
    /// Whether nothing was lost since the stream began or restarted.
    intact: bool,
    /// Session of the link that the state below belongs to.
    session: u32,
    /// Dropped frames that the host has seen as gaps in the sequence.
    accounted: u32,
    stalled: bool,
    /// Whether the link may hold the beginning of a frame.
    unfinished: bool,
    /// Room for the delimiter, then a frame.
    buffer: [u8; MAX_FRAME + 1],
}

/// Sends what the other tasks hand over, beginning with [`EventKind::Started`], until a restart is due.
pub async fn telemetry(app: &App, link: impl Write) -> Restart {
    let mut sender = Sender {
        app,
        link,
        sequence: SequenceCounter::new(),
        begun: false,
        intact: false,
        session: app.link.session(),
        accounted: 0,
        stalled: false,
        unfinished: true,
        buffer: [DELIMITER; MAX_FRAME + 1],
    };
    loop {
        app.heartbeats.beat(Task::Telemetry);
        let record = match select3(app.urgent.receive(), app.batches.receive(), Timer::after(BEAT)).await {
            Either3::First(outgoing) => match outgoing {
                Outgoing::Hello(hello) => Record::Hello(hello),
                Outgoing::Estimate(estimate) => Record::Estimate(estimate),
                Outgoing::Law(law) => Record::Law(law),
                Outgoing::Detail(detail) => Record::Detail(detail),
                Outgoing::Reversal(reversal) => Record::Reversal(reversal),
                Outgoing::Health(health) => Record::Health(health),
                Outgoing::Event(event) => Record::Event(event),
                Outgoing::Reply(reply) => Record::Reply(reply),
                Outgoing::Settings(settings) => Record::Settings(SettingsValues::from(&settings)),
                Outgoing::Saved(settings) => Record::Saved(SettingsValues::from(&settings)),
                Outgoing::Measured(measured) => Record::Measured(measured),
                Outgoing::Sums(sums) => Record::Sums(sums),
                Outgoing::MoreSums(sums) => Record::MoreSums(sums),
                Outgoing::Greeted => {
                    if sender.intact {
                        app.set_greeted();
                    }
                    continue;
                }
                Outgoing::Restart(restart) => return restart,
            },
            Either3::Second(Some(samples)) => Record::Samples(samples),
            Either3::Second(None) => {
                app.batches_sent.signal(());
                continue;
            }
            Either3::Third(()) => continue,
        };
        sender.send(&record).await;
    }
}

impl<W: Write> Sender<'_, W> {
    async fn send(&mut self, record: &Record) {
        let mute = self.app.link.is_mute();
        let mut begins = false;
        if matches!(record, Record::Event(Event { kind: EventKind::Started, .. })) {
            begins = !mute && !self.begun;
            self.begun |= begins;
            self.intact = true;
        }
        if mute || !self.begun {
            self.intact = false;
            if self.begun {
                self.sequence.take();
            }
            return;
        }
        let session = self.app.link.session();
        if core::mem::replace(&mut self.session, session) != session {
            self.stalled = false;
            self.unfinished = true;
        }
        let dropped = self.app.health().dropped_frames;
        let mut sequence = self.sequence;
        // A host sees no gap before the first frame: a frame that is already missing leaves one after it.
        let accounted = if begins { self.accounted } else { dropped };
        for _ in 0..accounted.wrapping_sub(self.accounted).min(GREATEST_JUMP) {
            sequence.take();
        }
        let number = sequence.take();
        if self.write(record, number).await.is_ok() {
            self.sequence = sequence;
            self.accounted = accounted;
        } else {
            self.intact = false;
            self.app.note_dropped_frame();
        }
    }

    async fn write(&mut self, record: &Record, number: u16) -> Result<(), Failed> {
        let [_, frame @ ..] = &mut self.buffer;
        let length = encode_record(record, number, frame).map_err(|_| Failed)?;
        let bytes = self.buffer.get(usize::from(!self.unfinished)..=length).unwrap_or_default();
        let limit = if self.stalled { STALLED_WRITE_LIMIT } else { WRITE_LIMIT };
        let writing = pin!(with_timeout(limit, write_all(&mut self.link, bytes)));
        let result = self.app.heartbeats.with_heartbeat(Task::Telemetry, writing).await.unwrap_or(Err(Failed));
        if result.is_err() && !self.stalled {
            log!(warn, "link stalled");
        }
        self.stalled = result.is_err();
        self.unfinished = result.is_err();
        result
    }
}

/// The frame could not be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Failed;

async fn write_all(link: &mut impl Write, bytes: &[u8]) -> Result<(), Failed> {
    let mut left = bytes;
    while !left.is_empty() {
        match link.write(left).await {
            Ok(count @ 1..) => left = left.get(count..).unwrap_or_default(),
            Ok(0) | Err(_) => return Err(Failed),
        }
    }
    link.flush().await.map_err(|_| Failed)
}

#[cfg(test)]
mod tests {
    use super::telemetry;
    use crate::app::App;
    use crate::messages::Outgoing;
    use core::cell::RefCell;
    use core::convert::Infallible;
    use core::pin::pin;
    use embassy_futures::{block_on, poll_once};
    use embedded_io_async::{ErrorType, Read, Write};
    use inerter_wire::{Event, EventKind, Frame, FrameReader, Record};
    use std::rc::Rc;
    use std::vec::Vec;

    /// What a host receives.
    #[derive(Clone, Default)]
    struct Received(Rc<RefCell<Vec<u8>>>);

    impl ErrorType for Received {
        type Error = Infallible;
    }

    impl Write for Received {
        async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
            self.0.borrow_mut().extend(bytes);
            Ok(bytes.len())
        }

        async fn flush(&mut self) -> Result<(), Infallible> {
            Ok(())
        }
    }

    /// A host may close the port before it is greeted.
    #[test]
    fn a_stream_begins_with_sequence_0_though_a_start_was_discarded_before() {
        let (app, received) = (App::new(), Received::default());
        let usb = (&b"request"[..], received.clone());
        let (mut receiver, transmitter) = app.link.join(usb, (&b""[..], Received::default()));
        let started = || Event { index: 0, kind: EventKind::Started };
        let mut sending = pin!(telemetry(&app, transmitter));
        assert!(app.urgent.try_send(Outgoing::Event(started())).is_ok());
        assert!(poll_once(sending.as_mut()).is_pending());

        app.link.set_open(true);
        let mut buffer = [0; 8];
        // The delimiter that begins the session, then what the host sent.
        assert_eq!(block_on(receiver.read(&mut buffer)), Ok(1));
        assert_eq!(block_on(receiver.read(&mut buffer)), Ok(7));
        assert!(app.link.note_request());
        assert!(app.urgent.try_send(Outgoing::Event(started())).is_ok());
        assert!(poll_once(sending.as_mut()).is_pending());
        let bytes = received.0.borrow();
        let first = FrameReader::<Record>::new().read(&mut bytes.as_slice());
        assert_eq!(first, Some(Frame::Message { sequence: 0, message: Record::Event(started()) }));
    }
}
