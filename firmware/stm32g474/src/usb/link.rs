//! The port's bytes, in both directions, while a host has it open.
//!
//! *Open* means: configured, not suspended, and DTR set. A host that closes the port fetches no more packets, so
//! pending data are dropped: the next host to open it must not receive the end of an old session.

use super::driver::{self, Driver};
use core::future::{Future, poll_fn};
use core::pin::pin;
use core::sync::atomic::{AtomicBool, Ordering};
use core::task::Poll;
use embassy_futures::select::select;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::Timer;
use embassy_usb::class::cdc_acm::{self, ControlChanged};
use embassy_usb::driver::EndpointError;
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};

/// Size of a full-speed bulk packet \[bytes\].
pub const PACKET: usize = 64;

static CONFIGURED: AtomicBool = AtomicBool::new(false);
static SUSPENDED: AtomicBool = AtomicBool::new(false);
static CHANGED: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// Longest wait for the host to fetch the last packet, in milliseconds.
const DRAIN_MS: u64 = 100;
/// Time for the host to process it, in milliseconds.
const SETTLE_MS: u64 = 5;

/// Tracks the state of the bus.
pub struct Handler;

impl Handler {
    fn note(&self, flag: &AtomicBool, value: bool) {
        flag.store(value, Ordering::Relaxed);
        CHANGED.signal(());
    }
}

impl embassy_usb::Handler for Handler {
    fn enabled(&mut self, _enabled: bool) {
        self.note(&CONFIGURED, false);
        self.note(&SUSPENDED, false);
    }

    fn reset(&mut self) {
        self.note(&CONFIGURED, false);
        self.note(&SUSPENDED, false);
    }

    fn configured(&mut self, configured: bool) {
        self.note(&CONFIGURED, configured);
    }

    fn suspended(&mut self, suspended: bool) {
        self.note(&SUSPENDED, suspended);
    }
}

fn is_open(lines: &ControlChanged) -> bool {
    CONFIGURED.load(Ordering::Relaxed) && !SUSPENDED.load(Ordering::Relaxed) && lines.dtr()
}

/// Calls `opened` at each change, and drops pending data for a host that has gone.
pub async fn watch(lines: &ControlChanged<'_>, opened: impl Fn(bool)) {
    let mut open = false;
    loop {
        select(lines.control_changed(), CHANGED.wait()).await;
        let now = is_open(lines);
        if now != open {
            open = now;
            driver::drop_sent();
            opened(open);
        }
    }
}

/// Waits until the host has fetched the last packet, for a limited time.
pub async fn drain() {
    for _ in 0..DRAIN_MS {
        if !driver::is_sending() {
            break;
        }
        Timer::after_millis(1).await;
    }
    Timer::after_millis(SETTLE_MS).await;
}

/// Polls `transfer` only while the port is open: a closed port's endpoint must stay empty.
async fn while_open<R>(
    lines: &ControlChanged<'_>,
    transfer: impl Future<Output = Result<R, EndpointError>>,
) -> Result<R, ErrorKind> {
    let mut transfer = pin!(transfer);
    poll_fn(|context| {
        if !is_open(lines) {
            return Poll::Ready(Err(ErrorKind::NotConnected));
        }
        transfer.as_mut().poll(context).map_err(|_| ErrorKind::NotConnected)
    })
    .await
}

/// Bytes from the host.
pub struct Receiver {
    endpoint: cdc_acm::Receiver<'static, Driver>,
    lines: &'static ControlChanged<'static>,
    packet: [u8; PACKET],
    /// Start of the part of the packet that was not returned yet.
    start: usize,
    end: usize,
}

impl Receiver {
    pub fn new(endpoint: cdc_acm::Receiver<'static, Driver>, lines: &'static ControlChanged<'static>) -> Self {
        Self { endpoint, lines, packet: [0; PACKET], start: 0, end: 0 }
    }
}

impl ErrorType for Receiver {
    type Error = ErrorKind;
}

impl Read for Receiver {
    async fn read(&mut self, into: &mut [u8]) -> Result<usize, ErrorKind> {
        if self.start == self.end {
            self.start = 0;
            self.end = 0;
            self.end = while_open(self.lines, self.endpoint.read_packet(&mut self.packet)).await?;
        }
        let left = self.packet.get(self.start..self.end).unwrap_or_default();
        let count = left.len().min(into.len());
        if let (Some(from), Some(to)) = (left.get(..count), into.get_mut(..count)) {
            to.copy_from_slice(from);
        }
        self.start += count;
        Ok(count)
    }
}

/// Bytes to the host.
pub struct Transmitter {
    endpoint: cdc_acm::Sender<'static, Driver>,
    lines: &'static ControlChanged<'static>,
    /// The last packet was full, so the host waits for the next.
    full: bool,
}

impl Transmitter {
    pub fn new(endpoint: cdc_acm::Sender<'static, Driver>, lines: &'static ControlChanged<'static>) -> Self {
        Self { endpoint, lines, full: false }
    }

    async fn packet(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        while_open(self.lines, self.endpoint.write_packet(bytes)).await?;
        self.full = bytes.len() == PACKET;
        Ok(bytes.len())
    }
}

impl ErrorType for Transmitter {
    type Error = ErrorKind;
}

impl Write for Transmitter {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        self.packet(bytes.get(..PACKET).unwrap_or(bytes)).await
    }

    /// After a full last packet sends an empty one to end the transfer: until then the host delivers nothing.
    async fn flush(&mut self) -> Result<(), ErrorKind> {
        if self.full {
            self.packet(&[]).await?;
        }
        Ok(())
    }
}
