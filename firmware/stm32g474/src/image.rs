//! The device: start, tasks and restart.

use crate::boards::{self, Parts};
use crate::executor::{self, Executor};
use crate::flash::{self, Pages};
use crate::platform::Platform;
use crate::reset::Started;
use crate::source::{self, Source};
use crate::temperature::Sensor;
use crate::work::{self, Task};
use crate::{clocks, defaults, identity, led, lpuart, options, panic, player, reset, stack, usb, watchdog};
use core::pin::pin;
use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_futures::block_on;
use embassy_futures::join::{join, join4};
use embassy_stm32::gpio::Output;
use embassy_stm32::pac::RCC;
use embassy_time::Instant;
use inerter_app::{
    App, FlashStore, Identity, InUse, LinkReceiver, LinkTransmitter, Restart, Start, leave_settings_alone,
    load_settings,
};
use inerter_core::{Active, State};
use inerter_wire::{Capabilities, ClockSource, ResetCause};
use static_cell::{ConstStaticCell, StaticCell};

defmt::timestamp!("{=u64:us}", uptime_us());

/// 0 before the clock of embassy-time runs, because a panic may come first.
fn uptime_us() -> u64 {
    if RCC.apb2enr().read().tim15en() { Instant::now().as_micros() } else { 0 }
}

/// Constructed at the start, because initial values would take space in flash too.
static APP: StaticCell<App> = StaticCell::new();
static STATE: ConstStaticCell<State> = ConstStaticCell::new(State::empty());
// An argument passed to a task by value is stored twice.
static IDENTITY: StaticCell<Identity> = StaticCell::new();
static IN_USE: StaticCell<InUse> = StaticCell::new();
static ACTIVE: StaticCell<Active> = StaticCell::new();
static SOURCE: StaticCell<Source> = StaticCell::new();
static STORE: StaticCell<FlashStore<Pages>> = StaticCell::new();
static RECEIVER: StaticCell<Receiver> = StaticCell::new();
static TRANSMITTER: StaticCell<Transmitter> = StaticCell::new();

type Receiver = LinkReceiver<'static, usb::Receiver, lpuart::Receiver>;
type Transmitter = LinkTransmitter<'static, usb::Transmitter, lpuart::Transmitter>;

#[embassy_executor::task]
async fn sampling(app: &'static App, source: &'static mut Source) -> ! {
    inerter_app::sampling(app, source).await
}

#[embassy_executor::task]
async fn estimating(app: &'static App, state: &'static mut State, active: &'static mut Active) -> ! {
    work::counted(Task::Estimating, pin!(inerter_app::estimating(app, state, active))).await
}

#[embassy_executor::task]
async fn commands(
    app: &'static App,
    link: &'static mut Receiver,
    store: &'static mut FlashStore<Pages>,
    identity: &'static Identity<'static>,
    in_use: &'static mut InUse,
) -> ! {
    work::counted(Task::Commands, pin!(inerter_app::commands(app, link, store, identity, in_use, true))).await
}

#[embassy_executor::task]
async fn telemetry(app: &'static App, link: &'static mut Transmitter) {
    let restart = work::counted(Task::Telemetry, pin!(inerter_app::telemetry(app, link))).await;
    // The reply must be sent first.
    join(usb::drain(), lpuart::drain()).await;
    match restart {
        Restart::Reboot => reset::restart(app.saves_left()),
        Restart::Dfu => reset::update(app.saves_left()),
        Restart::Hang => reset::hang(app.saves_left()),
    }
}

#[embassy_executor::task]
async fn usb_device(app: &'static App, device: usb::Device) -> ! {
    work::counted(Task::Usb, pin!(device.run(|open| app.link_state().set_open(open)))).await
}

/// Health figures, LED, watchdog, and the memory of the reset button.
#[embassy_executor::task]
async fn supervise(app: &'static App, platform: Platform, led: Output<'static>, clock: ClockSource) {
    let all = join4(
        inerter_app::health_reports(app, platform),
        led::show(led, clock, app),
        watchdog::watch(app),
        reset::forget(),
    );
    work::counted(Task::Supervising, pin!(all)).await;
}

/// Blocks thread mode after a while, to trigger the watchdog.
#[cfg(feature = "hang")]
#[embassy_executor::task]
async fn hang() {
    embassy_time::Timer::after_secs(5).await;
    loop {
        cortex_m::asm::nop();
    }
}

/// Sets everything up. Separate from [`run`], whose stack frame is never freed.
#[inline(never)]
fn set_up(spawner: Spawner, started: Started) {
    let mut start = Start { cause: started.cause, panic: panic::take(), saves_left: started.saves_left };
    if start.panic.is_some() && start.cause == ResetCause::Software {
        start.cause = ResetCause::Panic;
    }
    watchdog::start();
    options::check(start.cause);
    let (clock, peripherals) = clocks::start();
    let Parts { led, usb, vbus, uart, source, player } = boards::wire(peripherals);
    player::start(player);
    let app: &'static App = APP.init_with(App::new);
    let [_, firmware, git, board] = identity::TEXTS;
    let serial = identity::serial();
    let identity: &Identity = IDENTITY.init(Identity {
        firmware,
        git,
        board,
        serial,
        clock,
        capabilities: Capabilities::SAMPLER
            .with(Capabilities::INJECT)
            .with(Capabilities::TERMINAL)
            .with(if flash::is_there() { Capabilities::STORE } else { Capabilities::NONE })
            .with(Capabilities::DFU)
            .with(Capabilities::REBOOT)
            .with(Capabilities::PLAYER)
            .with(Capabilities::MEASURE)
            .with_flash_kb(flash::size_kb()),
        accepts: source::accepts,
        play: player::play,
        start,
    });
    defmt::info!("{=str}, commit {=str}, {=str} {=str}", firmware, git, board, serial);
    let port = usb::start(usb, vbus, serial);
    let (receiver, transmitter) = app.link_state().join((port.receiver, port.transmitter), uart);
    let store = STORE.init(FlashStore::new(Pages::new(), 0..flash::SIZE));
    let defaults = defaults::settings(clock);
    let settings = if started.suspects_settings {
        leave_settings_alone(&defaults)
    } else {
        // Loading only reads, and reading the flash never waits.
        block_on(load_settings(store, identity, &defaults))
    };
    let Ok((in_use, active)) = settings else { panic!("the default settings are not valid") };
    let tasks = [
        telemetry(app, TRANSMITTER.init(transmitter)).map(|task| spawner.spawn(task)),
        estimating(app, STATE.take(), ACTIVE.init(active)).map(|task| spawner.spawn(task)),
        commands(app, RECEIVER.init(receiver), store, identity, IN_USE.init(in_use)).map(|task| spawner.spawn(task)),
        supervise(app, Platform::new(Sensor::new()), led, clock).map(|task| spawner.spawn(task)),
        usb_device(app, port.device).map(|task| spawner.spawn(task)),
        #[cfg(feature = "hang")]
        hang().map(|task| spawner.spawn(task)),
        sampling(app, SOURCE.init(source)).map(|task| executor::start_sampling().spawn(task)),
    ];
    assert!(tasks.iter().all(Result::is_ok), "every task is spawned once");
}

/// Runs the instrument. Must be called only once, at the start.
pub fn run() -> ! {
    let Some(mut core) = cortex_m::Peripherals::take() else { panic!("the instrument starts once") };
    let started = reset::begin();
    stack::guard(&mut core.MPU);
    work::start(&mut core.DCB, &mut core.DWT);
    let executor = Executor::new(&core.SCB);
    set_up(executor.spawner(), started);
    executor.run()
}
