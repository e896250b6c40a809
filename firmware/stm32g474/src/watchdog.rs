//! The independent watchdog: resets a device that measures nothing.

use embassy_stm32::pac::DBGMCU;
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Peri, peripherals::IWDG};
use embassy_time::{Duration, Ticker};
use inerter_app::App;

/// Time without a sign of life. Its oscillator is good for 5 % or so (DS12288, table 46).
const LIMIT_US: u32 = 4_000_000;
const LOOK: Duration = Duration::from_millis(500);

/// Feeds the watchdog as long as sampling, estimating and telemetry all go on. For a task of its own.
pub async fn watch(watchdog: Peri<'static, IWDG>, app: &App) -> ! {
    // A probe that halts the core halts the watchdog.
    DBGMCU.apb1lfzr().modify(|w| w.set_iwdg(true));
    let mut watchdog = IndependentWatchdog::new(watchdog, LIMIT_US);
    watchdog.unleash();
    let mut ticker = Ticker::every(LOOK);
    loop {
        ticker.next().await;
        if app.alive() {
            watchdog.pet();
        }
    }
}
