//! The app's clock on a computer: embassy's manually driven clock, advanced with the system clock.

use std::{
    sync::{Mutex, OnceLock},
    time::Instant,
};

use embassy_time::{Duration, MockDriver};

/// Advances the app's clock to now; call it before every poll. The clock is shared by the whole process.
pub fn advance() {
    static START: OnceLock<Instant> = OnceLock::new();
    static LOCK: Mutex<()> = Mutex::new(());
    let _one_at_a_time = LOCK.lock();
    let due = START.get_or_init(Instant::now).elapsed().as_micros() as u64;
    let now = embassy_time::Instant::now().as_micros();
    if due > now {
        MockDriver::get().advance(Duration::from_micros(due - now));
    }
}
