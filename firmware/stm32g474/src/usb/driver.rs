//! embassy-stm32's USB driver, with additions.
//!
//! - *Bus power*: the peripheral has no VBUS detection, and the driver pulls D+ up permanently. Here the pull-up
//!   follows VBUS, so that a self-powered device does not feed a dead port.
//! - *Halts*: clearing a halt must reset the data toggle and re-enable the endpoint (USB 2.0, 9.4.5);
//!   embassy-stm32 0.6 does neither. An endpoint number that does not exist must not reach the registers.
//! - *Requests without data*: embassy-usb 0.6 neither answers nor rejects a request for 0 bytes, and the host waits
//!   until it gives up. Here such a request is passed on as one for 1 byte, and the answer is discarded.
//! - *Reset within a request*: embassy-usb 0.6 waits only for the end of a control transfer, which never comes after a
//!   bus reset. Here a reset or suspend ends the wait, and data received before a reset are discarded.
//! - *Suspend*: if a suspend and a resume are pending together, embassy-stm32 reports the suspend last.
//!
//! Register meanings: RM0440 45.6.

use core::future::poll_fn;
use core::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use core::task::Poll;
use embassy_futures::poll_once;
use embassy_futures::select::{Either, select};
use embassy_stm32::exti::ExtiInput;
use embassy_stm32::interrupt::typelevel::{Handler, USB_LP};
use embassy_stm32::mode::Async;
use embassy_stm32::pac::USB;
use embassy_stm32::pac::usb::regs::Epr;
use embassy_stm32::pac::usb::vals::Stat;
use embassy_stm32::{peripherals, usb};
use embassy_sync::waitqueue::AtomicWaker;
use embassy_time::Timer;
use embassy_usb_driver::{
    Direction, EndpointAddress, EndpointAllocError, EndpointError, EndpointInfo, EndpointType, Event, Unsupported,
};

type Inner = usb::Driver<'static, peripherals::USB>;

/// Number of endpoints of the peripheral.
const ENDPOINTS: usize = 8;
/// Attempts to drop a packet: the host fetches it during the first attempt, or the second one drops it.
const ATTEMPTS: u32 = 4;
/// Time for which VBUS must be present before the device connects, in milliseconds: contacts bounce.
const STEADY_MS: u64 = 100;
/// Direction bit of a request's first byte: to the host.
const TO_HOST: u8 = 0x80;

/// Wakes the task that waits for the end of a control transfer.
static DISTURBED: AtomicWaker = AtomicWaker::new();
/// Whether a bus reset was handled of which the control pipe does not know yet.
static WAS_RESET: AtomicBool = AtomicBool::new(false);

/// Detects resets and suspends; must be bound before the inner driver's handler, which clears their flags.
pub struct DisturbanceHandler;

impl Handler<USB_LP> for DisturbanceHandler {
    unsafe fn on_interrupt() {
        let flags = USB.istr().read();
        if flags.reset() || flags.susp() {
            DISTURBED.wake();
        }
    }
}

/// Waits for a reset, which disables endpoint 0, or a suspend.
async fn disturbed() {
    poll_fn(|context| {
        DISTURBED.register(context.waker());
        let control = USB.epr(0).read();
        let off = control.stat_rx() == Stat::DISABLED && control.stat_tx() == Stat::DISABLED;
        if off || USB.cntr().read().fsusp() { Poll::Ready(()) } else { Poll::Pending }
    })
    .await
}

/// Number of the endpoint that sends the port's bytes.
static SENDING: AtomicU8 = AtomicU8::new(0);

/// The driver.
pub struct Driver {
    inner: Inner,
    vbus: Option<ExtiInput<'static, Async>>,
}

impl Driver {
    pub fn new(inner: Inner, vbus: Option<ExtiInput<'static, Async>>) -> Self {
        Self { inner, vbus }
    }
}

impl embassy_usb_driver::Driver<'static> for Driver {
    type EndpointOut = <Inner as embassy_usb_driver::Driver<'static>>::EndpointOut;
    type EndpointIn = <Inner as embassy_usb_driver::Driver<'static>>::EndpointIn;
    type ControlPipe = ControlPipe;
    type Bus = Bus;

    fn alloc_endpoint_out(
        &mut self,
        kind: EndpointType,
        address: Option<EndpointAddress>,
        packet: u16,
        interval_ms: u8,
    ) -> Result<Self::EndpointOut, EndpointAllocError> {
        self.inner.alloc_endpoint_out(kind, address, packet, interval_ms)
    }

    fn alloc_endpoint_in(
        &mut self,
        kind: EndpointType,
        address: Option<EndpointAddress>,
        packet: u16,
        interval_ms: u8,
    ) -> Result<Self::EndpointIn, EndpointAllocError> {
        let endpoint = self.inner.alloc_endpoint_in(kind, address, packet, interval_ms)?;
        let EndpointInfo { addr, ep_type, .. } = embassy_usb_driver::Endpoint::info(&endpoint);
        if *ep_type == EndpointType::Bulk {
            SENDING.store(addr.index() as u8, Ordering::Relaxed);
        }
        Ok(endpoint)
    }

    fn start(self, control_packet: u16) -> (Bus, ControlPipe) {
        let (bus, control) = self.inner.start(control_packet);
        pull_up(false);
        (Bus { inner: bus, vbus: self.vbus, powered: false }, ControlPipe { inner: control, without_data: false })
    }
}

/// Connects the device to the host, or disconnects it.
fn pull_up(on: bool) {
    USB.bcdr().modify(|w| w.set_dppu(on));
}

/// The bus.
pub struct Bus {
    inner: <Inner as embassy_usb_driver::Driver<'static>>::Bus,
    vbus: Option<ExtiInput<'static, Async>>,
    powered: bool,
}

/// Waits for bus power, or its loss.
async fn power(vbus: &mut Option<ExtiInput<'static, Async>>, wanted: bool) {
    match vbus {
        Some(vbus) if wanted => loop {
            vbus.wait_for_high().await;
            Timer::after_millis(STEADY_MS).await;
            if vbus.is_high() {
                return;
            }
        },
        Some(vbus) => vbus.wait_for_low().await,
        None if wanted => {}
        None => core::future::pending().await,
    }
}

impl embassy_usb_driver::Bus for Bus {
    async fn enable(&mut self) {
        USB.cntr().modify(|w| {
            w.set_fsusp(false);
            w.set_lpmode(false);
        });
        pull_up(true);
    }

    async fn disable(&mut self) {
        pull_up(false);
        for index in 1..ENDPOINTS {
            for direction in [Direction::In, Direction::Out] {
                self.inner.endpoint_set_enabled(EndpointAddress::from_parts(index, direction), false);
            }
        }
    }

    async fn poll(&mut self) -> Event {
        loop {
            match select(power(&mut self.vbus, !self.powered), self.inner.poll()).await {
                Either::First(()) => {
                    self.powered = !self.powered;
                    return if self.powered { Event::PowerDetected } else { Event::PowerRemoved };
                }
                // An unconnected bus looks suspended, and the inner driver always reports power.
                Either::Second(_) if !self.powered => {}
                Either::Second(Event::PowerDetected | Event::PowerRemoved) => {}
                Either::Second(Event::Suspend) if !USB.cntr().read().fsusp() => {}
                Either::Second(event) => {
                    if event == Event::Reset {
                        WAS_RESET.store(true, Ordering::Relaxed);
                    }
                    return event;
                }
            }
        }
    }

    fn endpoint_set_enabled(&mut self, address: EndpointAddress, enabled: bool) {
        if enabled {
            reset_toggle(address);
        }
        self.inner.endpoint_set_enabled(address, enabled);
    }

    fn endpoint_set_stalled(&mut self, address: EndpointAddress, stalled: bool) {
        // The control pipe clears its stalls itself.
        if !(1..ENDPOINTS).contains(&address.index()) || status(address) == Stat::DISABLED {
            return;
        }
        if stalled {
            self.inner.endpoint_set_stalled(address, true);
        } else {
            reset_toggle(address);
            // Sets "not ready" or "ready to receive", and wakes the waiting task.
            self.inner.endpoint_set_enabled(address, true);
        }
    }

    fn endpoint_is_stalled(&mut self, address: EndpointAddress) -> bool {
        address.index() < ENDPOINTS && self.inner.endpoint_is_stalled(address)
    }

    async fn remote_wakeup(&mut self) -> Result<(), Unsupported> {
        self.inner.remote_wakeup().await
    }
}

fn status(address: EndpointAddress) -> Stat {
    let register = USB.epr(address.index()).read();
    match address.direction() {
        Direction::In => register.stat_tx(),
        Direction::Out => register.stat_rx(),
    }
}

/// What leaves the register as it is when written: writing 1 to a toggle bit toggles it, and writing 1 to a transfer
/// flag leaves it unchanged.
fn unchanged(now: Epr) -> Epr {
    let mut change = now;
    change.set_ctr_rx(true);
    change.set_ctr_tx(true);
    change.set_dtog_rx(false);
    change.set_dtog_tx(false);
    change.set_stat_rx(Stat::from_bits(0));
    change.set_stat_tx(Stat::from_bits(0));
    change
}

/// Restarts with DATA0.
fn reset_toggle(address: EndpointAddress) {
    let register = USB.epr(address.index());
    let now = register.read();
    let mut change = unchanged(now);
    change.set_dtog_rx(now.dtog_rx() && address.direction() == Direction::Out);
    change.set_dtog_tx(now.dtog_tx() && address.direction() == Direction::In);
    register.write_value(change);
}

/// Whether a packet waits for the host.
pub fn is_sending() -> bool {
    USB.epr(sending()).read().stat_tx() == Stat::VALID
}

/// Drops the packet that waits for the host, if any.
pub fn drop_sent() {
    let register = USB.epr(sending());
    // The host may fetch it at this moment; then there is nothing to drop.
    for _ in 0..ATTEMPTS {
        if !is_sending() {
            return;
        }
        let mut change = unchanged(register.read());
        change.set_stat_tx(Stat::from_bits(Stat::VALID.to_bits() ^ Stat::NAK.to_bits()));
        register.write_value(change);
    }
}

fn sending() -> usize {
    usize::from(SENDING.load(Ordering::Relaxed))
}

/// Runs part of a control transfer until it ends, or until a reset or suspend.
async fn undisturbed<R>(transfer: impl Future<Output = R>) -> Result<R, EndpointError> {
    match select(transfer, disturbed()).await {
        Either::First(result) => Ok(result),
        Either::Second(()) => Err(EndpointError::Disabled),
    }
}

/// Endpoint 0.
pub struct ControlPipe {
    inner: <Inner as embassy_usb_driver::Driver<'static>>::ControlPipe,
    /// Whether the current request is one for 0 bytes.
    without_data: bool,
}

impl embassy_usb_driver::ControlPipe for ControlPipe {
    fn max_packet_size(&self) -> usize {
        self.inner.max_packet_size()
    }

    async fn setup(&mut self) -> [u8; 8] {
        if WAS_RESET.swap(false, Ordering::Relaxed) {
            // A host waits 10 ms after a reset: a request that is already there is from before it.
            let _ = poll_once(self.inner.setup());
        }
        let mut request = self.inner.setup().await;
        let [kind, .., low, high] = &mut request;
        self.without_data = *kind & TO_HOST != 0 && [*low, *high] == [0, 0];
        if self.without_data {
            *low = 1;
        }
        request
    }

    async fn data_out(&mut self, data: &mut [u8], first: bool, last: bool) -> Result<usize, EndpointError> {
        undisturbed(self.inner.data_out(data, first, last)).await?
    }

    async fn data_in(&mut self, data: &[u8], first: bool, last: bool) -> Result<(), EndpointError> {
        if self.without_data {
            return undisturbed(self.inner.accept()).await;
        }
        undisturbed(self.inner.data_in(data, first, last)).await?
    }

    async fn accept(&mut self) {
        // On an error the host has abandoned the request: nothing to do.
        let _ = undisturbed(self.inner.accept()).await;
    }

    async fn reject(&mut self) {
        self.inner.reject().await
    }

    async fn accept_set_address(&mut self, address: u8) {
        // The inner driver sets the address last, which it must not do after a reset.
        let _ = undisturbed(self.inner.accept_set_address(address)).await;
    }
}
