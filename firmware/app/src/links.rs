//! Combines two links into one: the first while its port is open, otherwise the second.
//!
//! Terms:
//! - *first*, *second*: USB, whose port a host opens and closes, and a UART, which has no such state.
//! - *session*: the time from one opening or closing of the first link's port to the next.
//! - *mute*: a link on which no host has sent a valid request since it was opened. Nothing is sent on it: a terminal
//!   that was just opened echoes what it receives, and some other program may have it open.
//!
//! What arrives on the link that is not in use is dropped, so that no request waits there to be executed later.
//! At the beginning of a session the reader finds one delimiter and the writer sends one, so that a fragment of the
//! previous session does no harm.

use core::cell::RefCell;
use core::convert::Infallible;
use core::future::poll_fn;
use core::task::Poll;
use embassy_futures::select::{Either, Either3, select, select3};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::waitqueue::WakerRegistration;
use embassy_time::{Duration, Timer};
use embedded_io_async::{Error, ErrorKind, ErrorType, Read, Write};
use inerter_wire::DELIMITER;

/// Bytes dropped at once.
const DROPPED: usize = 64;
/// Pause before a link that gave an error is read again.
const RETRY: Duration = Duration::from_millis(50);

/// One of the two links.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Which {
    /// The one with a port that opens and closes.
    First,
    /// The one that is always available.
    Second,
}

/// Which link is in use, and whether a host is connected.
///
/// An [`App`](crate::App) has one. Until links are [joined](Self::join) to it, it describes a single link that is never
/// mute.
pub struct LinkState {
    inner: Mutex<CriticalSectionRawMutex, RefCell<Inner>>,
}

struct Inner {
    joined: bool,
    open: bool,
    /// Counts the sessions, wrapping.
    session: u32,
    /// Session of the bytes that the reader returned last.
    read_in: u32,
    /// Whether a host has sent a valid request: on the first link in this session, on the second ever.
    heard: [bool; 2],
    receiver: WakerRegistration,
    transmitter: WakerRegistration,
}

impl Inner {
    fn in_use(&self) -> Which {
        if self.open { Which::First } else { Which::Second }
    }

    fn is_mute(&self) -> bool {
        let [first, second] = self.heard;
        self.joined && !(if self.open { first } else { second })
    }
}

/// Which half waits for the next session.
#[derive(Clone, Copy)]
enum Half {
    Receiver,
    Transmitter,
}

impl LinkState {
    /// For a single link.
    pub const fn new() -> Self {
        Self {
            inner: Mutex::new(RefCell::new(Inner {
                joined: false,
                open: false,
                session: 0,
                read_in: 0,
                heard: [false; 2],
                receiver: WakerRegistration::new(),
                transmitter: WakerRegistration::new(),
            })),
        }
    }

    fn with<R>(&self, act: impl FnOnce(&mut Inner) -> R) -> R {
        self.inner.lock(|inner| act(&mut inner.borrow_mut()))
    }

    /// Joins two links, each a receiver and a transmitter, into one that is mute until a host speaks.
    ///
    /// When the other link comes into use, their waiting futures are dropped; that must lose no received byte. A link
    /// that cannot be read returns an error or 0 bytes; it is tried again later.
    pub fn join<A: Read, B: Write, C: Read, D: Write>(
        &self,
        first: (A, B),
        second: (C, D),
    ) -> (LinkReceiver<'_, A, C>, LinkTransmitter<'_, B, D>) {
        let session = self.with(|inner| {
            inner.joined = true;
            inner.session
        });
        let receiver = LinkReceiver { state: self, first: first.0, second: second.0, session };
        let transmitter =
            LinkTransmitter { state: self, first: first.1, second: second.1, session, begun: true, within: false };
        (receiver, transmitter)
    }

    /// Sets whether a host has the first link's port open (and the cable is in, and the bus is awake).
    ///
    /// Each change begins a session. May be called from anywhere, including an interrupt.
    pub fn set_open(&self, open: bool) {
        self.with(|inner| {
            if inner.open != open {
                inner.open = open;
                inner.session = inner.session.wrapping_add(1);
                let [first, _] = &mut inner.heard;
                *first = false;
                inner.receiver.wake();
                inner.transmitter.wake();
            }
        });
    }

    /// The link in use now.
    pub fn in_use(&self) -> Which {
        self.with(|inner| inner.in_use())
    }

    /// Whether nothing may be sent on the link in use.
    pub fn is_mute(&self) -> bool {
        self.with(|inner| inner.is_mute())
    }

    /// Counts the sessions, wrapping.
    pub(crate) fn session(&self) -> u32 {
        self.with(|inner| inner.session)
    }

    /// Notes a valid request in the bytes that were read last: the link is no longer mute. Returns whether it was.
    pub(crate) fn note_request(&self) -> bool {
        self.with(|inner| {
            if !inner.is_mute() || inner.read_in != inner.session {
                return false;
            }
            let [first, second] = &mut inner.heard;
            *(if inner.open { first } else { second }) = true;
            true
        })
    }

    /// Waits for the end of a session; for one task per half only.
    async fn end_of(&self, session: u32, half: Half) {
        poll_fn(|context| {
            self.with(|inner| {
                if inner.session != session {
                    return Poll::Ready(());
                }
                let waker = match half {
                    Half::Receiver => &mut inner.receiver,
                    Half::Transmitter => &mut inner.transmitter,
                };
                waker.register(context.waker());
                Poll::Pending
            })
        })
        .await
    }
}

impl Default for LinkState {
    fn default() -> Self {
        Self::new()
    }
}

/// Receiver of the link in use; see [`LinkState::join`].
pub struct LinkReceiver<'a, A, B> {
    state: &'a LinkState,
    first: A,
    second: B,
    session: u32,
}

impl<A, B> ErrorType for LinkReceiver<'_, A, B> {
    type Error = ErrorKind;
}

impl<A: Read, B: Read> Read for LinkReceiver<'_, A, B> {
    async fn read(&mut self, into: &mut [u8]) -> Result<usize, ErrorKind> {
        let (in_use, session) = self.state.with(|inner| (inner.in_use(), inner.session));
        if session == self.session {
            let end = self.state.end_of(session, Half::Receiver);
            let found = match in_use {
                Which::First => select3(end, read(&mut self.first, into), drop_all(&mut self.second)).await,
                Which::Second => select3(end, read(&mut self.second, into), drop_all(&mut self.first)).await,
            };
            match found {
                Either3::First(()) => {}
                Either3::Second(result) => {
                    self.state.with(|inner| inner.read_in = session);
                    return result;
                }
                Either3::Third(never) => match never {},
            }
        }
        // Belongs to the previous session: it may end a request received in that session.
        self.session = self.state.session();
        let Some(place) = into.first_mut() else { return Ok(0) };
        *place = DELIMITER;
        Ok(1)
    }
}

async fn read(link: &mut impl Read, into: &mut [u8]) -> Result<usize, ErrorKind> {
    link.read(into).await.map_err(|error| error.kind())
}

/// Discards all received bytes, forever.
async fn drop_all(link: &mut impl Read) -> Infallible {
    let mut dropped = [0; DROPPED];
    loop {
        if !matches!(link.read(&mut dropped).await, Ok(1..)) {
            Timer::after(RETRY).await;
        }
    }
}

/// Transmitter of the link in use; see [`LinkState::join`].
pub struct LinkTransmitter<'a, A, B> {
    state: &'a LinkState,
    first: A,
    second: B,
    session: u32,
    /// The delimiter that begins the session has been sent.
    begun: bool,
    /// Part of a frame has been sent.
    within: bool,
}

impl<A, B> ErrorType for LinkTransmitter<'_, A, B> {
    type Error = ErrorKind;
}

impl<A: Write, B: Write> LinkTransmitter<'_, A, B> {
    /// Switches to the current session; an error if `bytes` continue a frame that was begun in another.
    fn turn(&mut self, bytes: &[u8]) -> Result<Which, ErrorKind> {
        let (in_use, session, mute) = self.state.with(|inner| (inner.in_use(), inner.session, inner.is_mute()));
        if session != self.session {
            self.session = session;
            self.begun = false;
            // A lone delimiter ends the frame; with more after it, the frame was abandoned and another one begins.
            if core::mem::take(&mut self.within) && !matches!(bytes, [DELIMITER, _, ..]) {
                return Err(ErrorKind::NotConnected);
            }
        }
        if mute { Err(ErrorKind::NotConnected) } else { Ok(in_use) }
    }

    async fn send(&mut self, in_use: Which, bytes: &[u8]) -> Option<Result<usize, ErrorKind>> {
        let end = self.state.end_of(self.session, Half::Transmitter);
        let result = match in_use {
            Which::First => select(end, write(&mut self.first, bytes)).await,
            Which::Second => select(end, write(&mut self.second, bytes)).await,
        };
        match result {
            Either::First(()) => None,
            Either::Second(result) => Some(result),
        }
    }
}

async fn write(link: &mut impl Write, bytes: &[u8]) -> Result<usize, ErrorKind> {
    link.write(bytes).await.map_err(|error| error.kind())
}

async fn flush(link: &mut impl Write) -> Result<(), ErrorKind> {
    link.flush().await.map_err(|error| error.kind())
}

impl<A: Write, B: Write> Write for LinkTransmitter<'_, A, B> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        loop {
            let in_use = self.turn(bytes)?;
            self.begun |= bytes.first() == Some(&DELIMITER);
            let part = if self.begun { bytes } else { &[DELIMITER] };
            match self.send(in_use, part).await {
                // A new session: the frame begins there, or cannot be completed.
                None => {}
                Some(Ok(1..)) if !self.begun => self.begun = true,
                Some(Ok(count)) => {
                    self.within = bytes.get(..count).and_then(<[u8]>::last).is_some_and(|last| *last != DELIMITER);
                    return Ok(count);
                }
                Some(Err(error)) => return Err(error),
            }
        }
    }

    async fn flush(&mut self) -> Result<(), ErrorKind> {
        if self.state.session() != self.session {
            return Err(ErrorKind::NotConnected);
        }
        let end = self.state.end_of(self.session, Half::Transmitter);
        let result = match self.state.in_use() {
            Which::First => select(end, flush(&mut self.first)).await,
            Which::Second => select(end, flush(&mut self.second)).await,
        };
        match result {
            Either::First(()) => Err(ErrorKind::NotConnected),
            Either::Second(result) => result,
        }
    }
}

#[cfg(test)]
mod tests;
