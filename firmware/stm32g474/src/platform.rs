//! What the board measures of itself, once a second.

use crate::temperature::Sensor;
use crate::{executor, stack};
use embassy_time::Instant;
use inerter_app::Figures;

/// The board's own figures.
pub struct Platform {
    sensor: Sensor,
    /// Time and idle time at the last call, in microseconds.
    before: (u64, u64),
}

impl Platform {
    /// With the temperature sensor switched on.
    pub fn new(sensor: Sensor) -> Self {
        Self { sensor, before: (0, 0) }
    }
}

impl inerter_app::Platform for Platform {
    fn figures(&mut self) -> Figures {
        let (now, idle) = (Instant::now().as_micros(), executor::idle_us());
        let (elapsed, idle_since) = (now.saturating_sub(self.before.0), idle.saturating_sub(self.before.1));
        self.before = (now, idle);
        let busy = elapsed.saturating_sub(idle_since) * 1_000;
        Figures {
            cpu_load_permille: busy.checked_div(elapsed).and_then(|load| u16::try_from(load).ok()),
            stack_free_bytes: Some(stack::free_bytes()),
            temperature_c: self.sensor.read_c(),
        }
    }
}
