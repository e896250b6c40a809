//! The states that the LED shows.
//!
//! | LED | state |
//! |---|---|
//! | steady light | starting; if it lasts, the firmware does not start |
//! | fast blinking, 5 a second | no samples: halted, injected, or the front end delivers none |
//! | two flashes a second | samples, but the crystal does not run: the clock may be 1 % off |
//! | one flash a second | samples, and no host listens |
//! | half a second on, half off | samples, and a host listens |
//! | dark | no power, or update mode |

use core::sync::atomic::{AtomicBool, Ordering};
use embassy_stm32::gpio::Output;
use embassy_time::{Duration, Ticker};
use inerter_app::App;
use inerter_wire::ClockSource;

/// Duration of one bit of a pattern.
const STEP: Duration = Duration::from_millis(100);
const STEPS: u16 = 10;
// One second each, the first step in the lowest bit.
const NO_SAMPLES: u16 = 0b01_0101_0101;
const NO_CRYSTAL: u16 = 0b00_0000_0101;
const NO_HOST: u16 = 0b00_0000_0001;
const HOST_PRESENT: u16 = 0b00_0001_1111;

/// Whether samples have arrived since the LED last checked.
static SAMPLES: AtomicBool = AtomicBool::new(false);

/// Notes that samples have arrived.
pub fn note_samples() {
    SAMPLES.store(true, Ordering::Relaxed);
}

/// Shows the state.
pub async fn show(mut led: Output<'static>, clock: ClockSource, app: &App) -> ! {
    let mut ticker = Ticker::every(STEP);
    loop {
        ticker.next().await;
        let pattern = if !SAMPLES.swap(false, Ordering::Relaxed) {
            NO_SAMPLES
        } else if clock == ClockSource::Internal {
            NO_CRYSTAL
        } else if app.link_state().is_mute() {
            NO_HOST
        } else {
            HOST_PRESENT
        };
        for step in 0..STEPS {
            led.set_level((pattern >> step & 1 == 1).into());
            if step + 1 < STEPS {
                ticker.next().await;
            }
        }
    }
}
