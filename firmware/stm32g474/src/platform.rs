//! What the board measures about itself, once a second and on request.

use crate::temperature::Sensor;
use crate::{executor, measure, stack};
use embassy_time::Instant;
use inerter_app::{Figures, Load};
use inerter_wire::{Measure, Measured};

/// The board's own figures.
pub struct Platform {
    sensor: Sensor,
    load: Load,
}

impl Platform {
    /// Takes a temperature sensor that is switched on.
    pub fn new(sensor: Sensor) -> Self {
        Self { sensor, load: Load::default() }
    }
}

impl inerter_app::Platform for Platform {
    fn figures(&mut self) -> Figures {
        Figures {
            cpu_load_permille: self.load.permille(Instant::now().as_micros(), executor::idle_us()),
            stack_free_bytes: Some(stack::free_bytes()),
            temperature_c: self.sensor.read_c(),
        }
    }

    async fn measure(&mut self, what: Measure) -> Measured {
        measure::measure(what, &mut self.sensor).await
    }
}
