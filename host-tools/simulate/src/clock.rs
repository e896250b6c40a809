//! The app's clock on a computer: embassy's hand-driven one, moved along with the machine's.

use std::{
    sync::{Mutex, OnceLock},
    time::Instant,
};

use embassy_time::{Duration, MockDriver};

/// Moves the app's clock up to now; to be called before every poll. The clock is one for the whole process.
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
