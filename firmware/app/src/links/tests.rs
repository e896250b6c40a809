//! Scripted tests of both links: every change at every byte.

use super::{LinkReceiver, LinkState, LinkTransmitter, Which};
use embassy_futures::{block_on, poll_once};
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};
use inerter_wire::{Command, DELIMITER, Frame, FrameReader, MAX_FRAME, Request, encode_request};
use std::boxed::Box;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::future::poll_fn;
use std::pin::pin;
use std::rc::Rc;
use std::task::Poll;
use std::vec;
use std::vec::Vec;

/// One direction. The wakers are not kept, because the tests poll.
#[derive(Clone)]
struct Pipe(Rc<RefCell<Inner>>);

struct Inner {
    bytes: VecDeque<u8>,
    room: usize,
    broken: bool,
}

impl Pipe {
    fn new() -> Self {
        Self(Rc::new(RefCell::new(Inner { bytes: VecDeque::new(), room: usize::MAX, broken: false })))
    }

    fn put(&self, bytes: &[u8]) {
        self.0.borrow_mut().bytes.extend(bytes);
    }

    fn all(&self) -> Vec<u8> {
        self.0.borrow_mut().bytes.drain(..).collect()
    }

    fn set_room(&self, room: usize) {
        self.0.borrow_mut().room = room;
    }
}

impl ErrorType for Pipe {
    type Error = ErrorKind;
}

impl Read for Pipe {
    async fn read(&mut self, into: &mut [u8]) -> Result<usize, ErrorKind> {
        poll_fn(|_| {
            let mut inner = self.0.borrow_mut();
            let count = inner.bytes.len().min(into.len());
            if inner.broken {
                return Poll::Ready(Err(ErrorKind::NotConnected));
            }
            into.iter_mut().zip(inner.bytes.drain(..count)).for_each(|(place, byte)| *place = byte);
            if count > 0 { Poll::Ready(Ok(count)) } else { Poll::Pending }
        })
        .await
    }
}

impl Write for Pipe {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        poll_fn(|_| {
            let mut inner = self.0.borrow_mut();
            let count = bytes.len().min(inner.room);
            inner.room -= count;
            inner.bytes.extend(&bytes[..count]);
            if count > 0 { Poll::Ready(Ok(count)) } else { Poll::Pending }
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), ErrorKind> {
        poll_fn(|_| if self.0.borrow().room > 0 { Poll::Ready(Ok(())) } else { Poll::Pending }).await
    }
}

/// Two links, [in, out] each, and the device's end of them.
struct LinkPair {
    state: &'static LinkState,
    usb: [Pipe; 2],
    uart: [Pipe; 2],
    receiver: LinkReceiver<'static, Pipe, Pipe>,
    transmitter: LinkTransmitter<'static, Pipe, Pipe>,
}

impl LinkPair {
    fn new() -> Self {
        Self::of(Box::leak(Box::default()))
    }

    fn of(state: &'static LinkState) -> Self {
        let (usb, uart) = ([Pipe::new(), Pipe::new()], [Pipe::new(), Pipe::new()]);
        let end = |[to, from]: &[Pipe; 2]| (to.clone(), from.clone());
        let (receiver, transmitter) = state.join(end(&usb), end(&uart));
        Self { state, usb, uart, receiver, transmitter }
    }

    /// With hosts that have sent a valid request on both.
    fn heard() -> Self {
        let mut bench = Self::new();
        for open in [false, true] {
            bench.state.set_open(open);
            bench.speak();
        }
        bench
    }

    /// A host sends a valid request on the link in use.
    fn speak(&mut self) {
        let link = if self.state.in_use() == Which::First { &self.usb } else { &self.uart };
        link[0].put(b"request");
        self.read();
        self.state.note_request();
        assert!(!self.state.is_mute());
    }

    /// Everything that can be read now.
    fn read(&mut self) -> Vec<u8> {
        let mut all = Vec::new();
        let mut buffer = [0; 7];
        while let Poll::Ready(result) = poll_once(self.receiver.read(&mut buffer)) {
            all.extend(&buffer[..result.unwrap()]);
        }
        all
    }

    /// Sends a whole frame as telemetry does; an error if that was impossible.
    fn send(&mut self, frame: &[u8]) -> Result<(), ErrorKind> {
        block_on(self.send_from(frame))
    }

    /// As [`send`](Self::send), but to be polled.
    async fn send_from(&mut self, frame: &[u8]) -> Result<(), ErrorKind> {
        let mut left = frame;
        while !left.is_empty() {
            let count = self.transmitter.write(left).await?;
            left = &left[count..];
        }
        self.transmitter.flush().await
    }
}

/// What a host receives in `bytes`: the complete frames.
fn whole(bytes: &[u8]) -> Vec<&[u8]> {
    let mut frames: Vec<&[u8]> = bytes.split_inclusive(|byte| *byte == DELIMITER).collect();
    frames.retain(|frame| frame.len() > 1 && frame.ends_with(&[DELIMITER]));
    frames
}

#[test]
fn the_first_link_is_in_use_while_its_port_is_open() {
    let mut bench = LinkPair::new();
    assert_eq!(bench.state.in_use(), Which::Second);
    bench.usb[0].put(b"nobody");
    bench.uart[0].put(b"uart");
    assert_eq!(bench.read(), b"uart");
    assert_eq!(bench.usb[0].all(), [], "what arrives on the other is dropped");
    bench.state.set_open(true);
    assert_eq!(bench.state.in_use(), Which::First);
    bench.uart[0].put(b"noise");
    bench.usb[0].put(b"usb");
    assert_eq!(bench.read(), b"\0usb");
    bench.uart[0].put(b"more noise");
    assert_eq!(bench.read(), []);
    bench.state.set_open(false);
    assert_eq!(bench.read(), b"\0");
    bench.uart[0].put(b"uart");
    assert_eq!(bench.read(), b"uart");
}

#[test]
fn uart_noise_never_reaches_a_host_on_usb() {
    let mut bench = LinkPair::heard();
    bench.read();
    for portion in 0..200u32 {
        let noise: Vec<u8> = (0..portion % 97).map(|place| (place * portion) as u8).collect();
        bench.uart[0].put(&noise);
        let sent = [portion as u8; 3];
        bench.usb[0].put(&sent);
        assert_eq!(bench.read(), sent);
        bench.send(b"frame\0").unwrap();
        assert_eq!(bench.uart[0].all(), []);
        assert_eq!(bench.uart[1].all(), []);
    }
}

#[test]
fn a_reader_that_waits_learns_of_the_change() {
    let mut bench = LinkPair::new();
    let mut buffer = [1; 4];
    {
        let mut reading = pin!(bench.receiver.read(&mut buffer));
        assert!(poll_once(reading.as_mut()).is_pending());
        bench.state.set_open(true);
        assert_eq!(block_on(reading), Ok(1));
    }
    assert_eq!(buffer[0], DELIMITER);
}

#[test]
fn a_request_that_was_cut_by_the_change_spoils_no_other() {
    let mut out = [0; MAX_FRAME];
    let request = Request { id: 7, command: Command::Stop };
    let length = encode_request(&request, 0, &mut out).unwrap();
    // A request that lacks only its delimiter is executed, but does not count as heard in the next session.
    for cut in 0..length {
        for open in [true, false] {
            let mut bench = LinkPair::new();
            bench.state.set_open(!open);
            let (before, after) = if open { (&bench.uart, &bench.usb) } else { (&bench.usb, &bench.uart) };
            let (before, after) = (before[0].clone(), after[0].clone());
            before.put(&out[..cut]);
            let mut bytes = bench.read();
            bench.state.set_open(open);
            // The rest arrives where nobody listens any more.
            before.put(&out[cut..length]);
            bytes.extend(bench.read());
            assert!(!bench.state.note_request());
            after.put(&out[..length]);
            bytes.extend(bench.read());
            let mut frames = FrameReader::<Request>::new();
            let mut input = bytes.as_slice();
            let found: Vec<_> = std::iter::from_fn(|| frames.read(&mut input))
                .filter(|frame| matches!(frame, Frame::Message { .. }))
                .collect();
            let wanted = Frame::Message { sequence: 0, message: request.clone() };
            assert_eq!(found, vec![wanted; if cut == length - 1 { 2 } else { 1 }], "{cut} {open}");
            assert!(bench.state.note_request());
        }
    }
}

#[test]
fn stale_bytes_of_a_port_that_was_closed_are_dropped() {
    let mut bench = LinkPair::heard();
    bench.usb[0].put(b"req");
    assert_eq!(bench.read(), b"req");
    bench.state.set_open(false);
    bench.usb[0].put(b"uest\0");
    assert_eq!(bench.read(), b"\0");
    bench.state.set_open(true);
    assert_eq!(bench.read(), b"\0");
    bench.usb[0].put(b"new");
    assert_eq!(bench.read(), b"new");
}

#[test]
fn nothing_is_sent_before_the_host_has_spoken() {
    let mut bench = LinkPair::new();
    assert!(bench.state.is_mute());
    assert_eq!(bench.send(b"frame\0"), Err(ErrorKind::NotConnected));
    bench.state.set_open(true);
    assert!(bench.state.is_mute());
    assert_eq!(bench.send(b"frame\0"), Err(ErrorKind::NotConnected));
    bench.uart[0].put(b"request");
    bench.read();
    assert!(!bench.state.note_request(), "what was said was not said here");
    bench.usb[0].put(b"request");
    bench.read();
    assert!(bench.state.note_request());
    assert!(!bench.state.note_request(), "once");
    bench.send(b"frame\0").unwrap();
    assert_eq!((bench.usb[1].all(), bench.uart[1].all()), (b"\0frame\0".to_vec(), vec![]));
    // On the UART no host has sent a request yet; on USB one must send another.
    bench.state.set_open(false);
    bench.read();
    assert!(bench.state.is_mute());
    bench.state.set_open(true);
    assert!(bench.state.is_mute());
}

#[test]
fn a_port_may_be_open_before_the_links_are_joined() {
    let state: &'static LinkState = Box::leak(Box::default());
    state.set_open(true);
    let mut bench = LinkPair::of(state);
    bench.speak();
    bench.send(b"frame\0").unwrap();
    assert_eq!(bench.usb[1].all(), b"frame\0");
}

#[test]
fn a_single_link_is_never_mute() {
    let state = LinkState::new();
    assert!(!state.is_mute());
    assert!(!state.note_request());
}

#[test]
fn a_port_that_opens_and_closes_without_end_leaves_no_torn_frame() {
    let mut bench = LinkPair::heard();
    bench.read();
    let mut sent = 0;
    for round in 0..400usize {
        if round % 3 == 0 {
            // Changes faster than any poll.
            for flap in 0..round % 4 {
                bench.state.set_open(flap % 2 == 0);
            }
            bench.state.set_open(true);
        }
        bench.usb[1].set_room(usize::MAX);
        bench.speak();
        sent += usize::from(bench.send(b"abcdef\0").is_ok());
        assert!(whole(&bench.usb[1].all()).iter().all(|frame| *frame == b"abcdef\0"));
        assert_eq!(bench.uart[1].all(), []);
    }
    assert_eq!(sent, 400, "each on the session under way");
}

/// A frame is cut after any number of bytes by a change either way; the next one arrives whole and alone.
#[test]
fn a_change_in_the_middle_of_a_frame_tears_that_one_only() {
    let frame = b"0123456789\0";
    for cut in 0..=frame.len() {
        for open in [true, false] {
            let mut bench = LinkPair::heard();
            bench.state.set_open(!open);
            bench.speak();
            bench.send(b"first\0").unwrap();
            let pipes = [bench.uart[1].clone(), bench.usb[1].clone()];
            let (before, after) = (&pipes[usize::from(!open)], &pipes[usize::from(open)]);
            before.all();
            before.set_room(cut);
            let state = bench.state;
            let result = {
                let mut sending = pin!(bench.send_from(frame));
                assert!(poll_once(sending.as_mut()).is_pending());
                state.set_open(open);
                if open {
                    // A new session, in which no byte from a host has been read yet.
                    assert!(state.is_mute());
                }
                block_on(sending)
            };
            assert_eq!(before.all(), frame[..cut]);
            if open {
                assert_eq!((result, after.all()), (Err(ErrorKind::NotConnected), vec![]), "mute");
            } else if cut == 0 {
                assert_eq!((result, after.all()), (Ok(()), [&[0], &frame[..]].concat()), "begun where it can be ended");
            } else {
                assert_eq!((result, after.all()), (Err(ErrorKind::NotConnected), vec![]), "{cut}");
            }
            bench.speak();
            before.set_room(usize::MAX);
            bench.send(b"next\0").unwrap();
            let bytes = after.all();
            assert_eq!(whole(&bytes), [&b"next\0"[..]]);
            let begun_before = cut == 0 && !open;
            assert_eq!(bytes.starts_with(&[DELIMITER]), !begun_before);
            assert_eq!(before.all(), []);
        }
    }
}

/// Telemetry abandons a frame and begins the next one with a delimiter; the port was closed and opened meanwhile.
#[test]
fn a_frame_after_one_that_was_given_up_is_not_taken_for_its_rest() {
    let mut bench = LinkPair::heard();
    bench.read();
    bench.usb[1].set_room(3);
    assert!(poll_once(bench.send_from(b"given up\0")).is_pending());
    bench.state.set_open(false);
    bench.state.set_open(true);
    bench.usb[1].all();
    bench.usb[1].set_room(usize::MAX);
    bench.speak();
    bench.send(b"\0hello\0").unwrap();
    assert_eq!(bench.usb[1].all(), b"\0hello\0");
}

#[test]
fn a_link_that_cannot_be_read_does_not_keep_the_other_from_being_read() {
    let mut bench = LinkPair::new();
    bench.usb[0].0.borrow_mut().broken = true;
    bench.uart[0].put(b"uart");
    assert_eq!(bench.read(), b"uart");
    bench.state.set_open(true);
    let mut buffer = [0; 4];
    assert_eq!(block_on(bench.receiver.read(&mut buffer)), Ok(1));
    assert_eq!(block_on(bench.receiver.read(&mut buffer)), Err(ErrorKind::NotConnected), "for the app to try again");
}
