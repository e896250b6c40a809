//! The board: parts, tasks and exit.

use crate::source::{self, FileSource};
use crate::{clock, executor, icount, semihosting, stack, usart};
use cortex_m_rt::{ExceptionFrame, entry, exception};
use embassy_time::Instant;
use inerter_app::{App, Figures, Identity, InUse, Load, NoStore, Platform, Restart, Start, accept_all, play_nothing};
use inerter_core::{Active, Settings, State};
use inerter_wire::{Capabilities, ClockSource};
use static_cell::ConstStaticCell;

/// Exit status of a panic or fault, as that of a Rust program on a computer.
const PANICKED: u32 = 101;
/// Command-line word that asks for the measuring mode instead of naming a file.
const ICOUNT: &str = "icount";
/// File of samples when the command line names none.
const SAMPLES: &str = "samples.bin";

const IDENTITY: Identity<'static> = Identity {
    firmware: concat!("inerter ", env!("CARGO_PKG_VERSION")),
    git: env!("INERTER_GIT"),
    board: "qemu netduinoplus2",
    serial: "QEMU-0",
    clock: ClockSource::Simulated,
    capabilities: Capabilities::SAMPLER.with(Capabilities::INJECT).with(Capabilities::REBOOT),
    accepts: accept_all,
    play: play_nothing,
    start: Start::POWER_ON,
};

static APP: App = App::new();
static STATE: ConstStaticCell<State> = ConstStaticCell::new(State::empty());
static FILE_BUFFER: ConstStaticCell<[u8; source::BUFFER]> = ConstStaticCell::new([0; source::BUFFER]);
static COMMAND_LINE: ConstStaticCell<[u8; 512]> = ConstStaticCell::new([0; 512]);

struct Machine {
    load: Load,
}

impl Platform for Machine {
    fn figures(&mut self) -> Figures {
        Figures {
            cpu_load_permille: self.load.permille(Instant::now().as_micros(), executor::idle_us()),
            stack_free_bytes: Some(stack::free_bytes()),
            temperature_c: None,
        }
    }
}

#[embassy_executor::task]
async fn sampling(source: FileSource) {
    inerter_app::sampling(&APP, source).await
}

#[embassy_executor::task]
async fn estimating(state: &'static mut State, mut active: Active) {
    inerter_app::estimating(&APP, state, &mut active).await
}

#[embassy_executor::task]
async fn commands(link: usart::Receiver, mut in_use: InUse) {
    inerter_app::commands(&APP, link, NoStore, &IDENTITY, &mut in_use, false).await
}

#[embassy_executor::task]
async fn health() {
    inerter_app::health_reports(&APP, Machine { load: Load::default() }).await
}

#[embassy_executor::task]
async fn telemetry(link: usart::Transmitter) {
    match inerter_app::telemetry(&APP, link).await {
        Restart::Reboot | Restart::Dfu | Restart::Hang => {
            let (free, total) = (stack::free_bytes(), stack::total_bytes());
            let used = total - free;
            semihosting::print(format_args!(r#"{{"kind":"exit","stack_used_bytes":{used},"stack_bytes":{total}}}"#));
            semihosting::exit(0)
        }
    }
}

#[entry]
fn main() -> ! {
    // First of all: QEMU drops what arrives while the USART is off.
    let (receiver, transmitter) = usart::start();
    let Some(peripherals) = cortex_m::Peripherals::take() else { panic!("main runs once") };
    let argument = semihosting::argument(COMMAND_LINE.take());
    if argument == Some(ICOUNT) {
        icount::run(peripherals.SYST, STATE.take());
        semihosting::exit(0);
    }
    clock::start(peripherals.SYST);
    let source = FileSource::new(argument.unwrap_or(SAMPLES), FILE_BUFFER.take());
    let state = STATE.take();
    let settings = Settings::default();
    // The error's text would pull float formatting into the image.
    let Ok(active) = settings.validate() else { panic!("the default settings are not valid") };
    let in_use = InUse { settings, defaults: settings, fault: None };
    executor::run(|spawner| {
        let tasks = [
            telemetry(transmitter).map(|task| spawner.spawn(task)),
            estimating(state, active).map(|task| spawner.spawn(task)),
            sampling(source).map(|task| spawner.spawn(task)),
            commands(receiver, in_use).map(|task| spawner.spawn(task)),
            health().map(|task| spawner.spawn(task)),
        ];
        assert!(tasks.iter().all(Result::is_ok), "every task is spawned once");
    })
}

#[exception]
unsafe fn DefaultHandler(number: i16) {
    match u16::try_from(number) {
        Ok(usart::INTERRUPT) => usart::on_interrupt(),
        _ => panic!("interrupt {number} has no handler"),
    }
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    panic!("hard fault: {frame:?}")
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo) -> ! {
    cortex_m::interrupt::disable();
    semihosting::print_error(format_args!("{info}"));
    semihosting::exit(PANICKED)
}
