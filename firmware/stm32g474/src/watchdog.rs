//! The independent watchdog: resets a device that has stopped measuring.

use embassy_stm32::pac::iwdg::vals::{Key, Pr};
use embassy_stm32::pac::{DBGMCU, IWDG};
use embassy_time::{Duration, Ticker, Timer};
use inerter_app::App;

/// Time allowed without heartbeats: 2000 periods of 32 kHz / 64, 4 s. The oscillator is accurate to about 5 % (DS12288,
/// table 46).
const PERIODS: u16 = 2_000;
/// Longest wait for the watchdog to update its registers, which takes 5 periods of 32 kHz / 64, 10 ms.
const TAKEN_OVER_MS: u32 = 50;
const CHECK_PERIOD: Duration = Duration::from_millis(500);

/// Starts the watchdog, before the first wait, so that a start that hangs fails.
///
/// [`watch`] runs in time: until then the limit is that of the registers' reset values, 0.5 s, and a start takes 0.2 s
/// if there is no crystal.
pub fn start() {
    // A probe that halts the core halts the watchdog.
    DBGMCU.apb1lfzr().modify(|w| w.set_iwdg(true));
    IWDG.kr().write(|w| w.set_key(Key::START));
}

/// Feeds the watchdog while sampling, estimating and telemetry all give heartbeats.
pub async fn watch(app: &App) -> ! {
    // After the start (RM0440, 42.3.2).
    IWDG.kr().write(|w| w.set_key(Key::ENABLE));
    IWDG.pr().write(|w| w.set_pr(Pr::DIVIDE_BY64));
    IWDG.rlr().write(|w| w.set_rl(PERIODS));
    // Until the registers are updated and loaded, the limit is the longest possible.
    for _ in 0..TAKEN_OVER_MS {
        if IWDG.sr().read().0 == 0 {
            break;
        }
        Timer::after_millis(1).await;
    }
    IWDG.kr().write(|w| w.set_key(Key::RESET));
    let mut ticker = Ticker::every(CHECK_PERIOD);
    loop {
        ticker.next().await;
        if app.alive() {
            IWDG.kr().write(|w| w.set_key(Key::RESET));
        }
    }
}
