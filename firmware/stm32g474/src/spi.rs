//! The converter's bus: SPI2 with DMA, and its chip select.
//!
//! Bytes go through a buffer that outlives every future, so the DMA never accesses memory of a dropped future.
//! Source: RM0440 39.5.9 (communication using DMA), 13 table 91 (requests).

use crate::pins;
use core::cell::UnsafeCell;
use core::future::poll_fn;
use core::ptr;
use core::task::Poll;
use embassy_stm32::gpio::{AfType, Flex, Output, OutputType, Pull, Speed};
use embassy_stm32::interrupt::typelevel::{DMA1_CHANNEL5, Handler, Interrupt};
use embassy_stm32::pac::bdma::vals::{Dir, Size};
use embassy_stm32::pac::spi::vals::{Br, Cpha, Ds, Frlvl, Frxth, Ftlvl, Mstr};
use embassy_stm32::pac::{DMA1, DMAMUX1, RCC, SPI2};
use embassy_stm32::spi::{MisoPin, MosiPin, SckPin};
use embassy_stm32::{Peri, peripherals};
use embassy_sync::waitqueue::AtomicWaker;
use embassy_time::{Duration, with_timeout};
use embedded_hal_async::spi::{ErrorKind, ErrorType, Operation, SpiDevice};

/// DMA channels, counted from 0 as the registers are.
const SENT: usize = 3;
const RECEIVED: usize = 4;
const REQUEST_SENT: u8 = 13;
const REQUEST_RECEIVED: u8 = 12;
/// Maximum bytes per transfer; a frame has 18.
const LENGTH: usize = 32;
/// Bytes of the SPI's own receive buffer.
const FIFO: usize = 4;
/// Longest wait for a transfer; 32 bytes take 25 us.
const LIMIT: Duration = Duration::from_millis(5);
/// Polls of the bus, of at least 10 cycles each: four bytes take 512.
const BUSY_POLLS: usize = 100;

struct Buffer(UnsafeCell<[u8; LENGTH]>);

// SAFETY: used by the one `Device` only, and not while the DMA runs.
unsafe impl Sync for Buffer {}

static BUFFER: Buffer = Buffer(UnsafeCell::new([0; LENGTH]));
static DONE: AtomicWaker = AtomicWaker::new();

/// Interrupt of the last byte received.
pub struct DoneHandler;

impl Handler<DMA1_CHANNEL5> for DoneHandler {
    unsafe fn on_interrupt() {
        // The flag stays set for the waiting task.
        DMA1_CHANNEL5::disable();
        DONE.wake();
    }
}

/// A transfer failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Failed;

impl embedded_hal_async::spi::Error for Failed {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

/// One device on the bus: mode 1, 10.5 MHz, so a frame of 18 bytes takes 14 us.
///
/// It can only transfer in place, which is all that the converter's driver needs.
pub struct Device {
    select: Output<'static>,
}

impl Device {
    /// Takes the bus. `select` is high when idle.
    pub fn new(
        _bus: Peri<'static, peripherals::SPI2>,
        clock: Peri<'static, impl SckPin<peripherals::SPI2>>,
        out: Peri<'static, impl MosiPin<peripherals::SPI2>>,
        back: Peri<'static, impl MisoPin<peripherals::SPI2>>,
        select: Output<'static>,
    ) -> Self {
        let driven = AfType::output(OutputType::PushPull, Speed::VeryHigh);
        let (clock_function, out_function, back_function) = (clock.af_num(), out.af_num(), back.af_num());
        pins::connect(Flex::new(clock), clock_function, driven);
        pins::connect(Flex::new(out), out_function, driven);
        pins::connect(Flex::new(back), back_function, AfType::input(Pull::Down));
        critical_section::with(|_| RCC.apb1enr1().modify(|w| w.set_spi2en(true)));
        SPI2.cr2().write(|w| {
            w.set_ds(Ds::BITS8);
            w.set_frxth(Frxth::QUARTER);
        });
        SPI2.cr1().write(|w| {
            w.set_mstr(Mstr::MASTER);
            w.set_br(Br::DIV16);
            w.set_cpha(Cpha::SECOND_EDGE);
            w.set_ssm(true);
            w.set_ssi(true);
        });
        DMAMUX1.ccr(SENT).write(|w| w.set_dmareq_id(REQUEST_SENT));
        DMAMUX1.ccr(RECEIVED).write(|w| w.set_dmareq_id(REQUEST_RECEIVED));
        Self { select }
    }
}

/// Deselects the device and stops the bus, even if the future is dropped.
struct Selected<'a>(&'a mut Output<'static>);

impl<'a> Selected<'a> {
    fn new(select: &'a mut Output<'static>) -> Self {
        select.set_low();
        Self(select)
    }

    /// Sends the buffer's bytes and replaces them with those received.
    async fn exchange(&mut self, count: usize) -> Result<(), Failed> {
        SPI2.cr2().modify(|w| w.set_rxdmaen(true));
        prepare(RECEIVED, Dir::FROM_PERIPHERAL, count);
        prepare(SENT, Dir::FROM_MEMORY, count);
        SPI2.cr2().modify(|w| w.set_txdmaen(true));
        SPI2.cr1().modify(|w| w.set_spe(true));
        let ended = poll_fn(|context| {
            DONE.register(context.waker());
            let flags = DMA1.isr().read();
            if flags.teif(RECEIVED) || flags.teif(SENT) {
                return Poll::Ready(Err(Failed));
            }
            if flags.tcif(RECEIVED) {
                return Poll::Ready(Ok(()));
            }
            DMA1_CHANNEL5::unpend();
            // SAFETY: the interrupt's handler only masks it again and wakes.
            unsafe { DMA1_CHANNEL5::enable() };
            Poll::Pending
        });
        let result = with_timeout(LIMIT, ended).await.unwrap_or(Err(Failed));
        stop();
        result
    }
}

impl Drop for Selected<'_> {
    fn drop(&mut self) {
        stop();
        self.0.set_high();
    }
}

fn prepare(channel: usize, dir: Dir, count: usize) {
    DMA1.ifcr().write(|w| w.set_gif(channel, true));
    DMA1.ch(channel).par().write_value(SPI2.dr16().as_ptr() as u32);
    DMA1.ch(channel).mar().write_value(BUFFER.0.get() as u32);
    DMA1.ch(channel).ndtr().write(|w| w.set_ndt(count as u16));
    let interrupts = channel == RECEIVED;
    DMA1.ch(channel).cr().write(|w| {
        w.set_dir(dir);
        w.set_minc(true);
        w.set_psize(Size::BITS8);
        w.set_msize(Size::BITS8);
        w.set_tcie(interrupts);
        w.set_teie(interrupts);
        w.set_en(true);
    });
}

/// Stops a transfer at any point; does nothing if it has ended.
fn stop() {
    DMA1.ch(SENT).cr().write(|_| ());
    // If all bytes have been received, nothing is in transit. Otherwise that ends within one to four bytes. An SPI that
    // was switched off before may show busy forever (ES0430 2.18.1), so the flag is not read afterwards.
    if DMA1.ch(RECEIVED).ndtr().read().ndt() != 0 {
        let is_idle = || {
            let status = SPI2.sr().read();
            status.ftlvl() == Ftlvl::EMPTY && !status.bsy()
        };
        let _ = (0..BUSY_POLLS).any(|_| is_idle());
    }
    DMA1.ch(RECEIVED).cr().write(|_| ());
    SPI2.cr1().modify(|w| w.set_spe(false));
    // An aborted transfer may have left bytes.
    for _ in 0..FIFO {
        if SPI2.sr().read().frlvl() == Frlvl::EMPTY {
            break;
        }
        let _ = SPI2.dr8().read();
    }
    SPI2.cr2().modify(|w| {
        w.set_rxdmaen(false);
        w.set_txdmaen(false);
    });
}

impl ErrorType for Device {
    type Error = Failed;
}

impl SpiDevice for Device {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Failed> {
        let mut selected = Selected::new(&mut self.select);
        for operation in operations {
            let Operation::TransferInPlace(bytes) = operation else { return Err(Failed) };
            for part in bytes.chunks_mut(LENGTH) {
                let count = part.len();
                // SAFETY: the DMA does not run.
                unsafe { ptr::copy_nonoverlapping(part.as_ptr(), BUFFER.0.get().cast(), count) };
                selected.exchange(count).await?;
                // SAFETY: as above.
                unsafe { ptr::copy_nonoverlapping(BUFFER.0.get().cast(), part.as_mut_ptr(), count) };
            }
        }
        Ok(())
    }
}
