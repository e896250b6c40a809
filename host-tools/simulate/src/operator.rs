//! A simulated operator: hangs a weight on the load cell, turns the screw, shakes the rig for a while; and the samples
//! of a set-up's device, with an operator or without.
//!
//! An operator does what a person does at a bench, so that calibration can be tried and tested without one. Commands
//! are lines such as `mass 5`.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use inerter_plant::{Excitation, Hands, Inerter, Plant, Sample, Simulation};

use crate::{error::SimulateError, setup::Setup};

/// Standard gravity, for a mass that hangs on the simulated cell \[m/s^2\].
pub const GRAVITY_M_PER_S2: f64 = 9.80665;
/// Speed of a movement by hand \[m/s\].
const SPEED_M_PER_S: f64 = 0.02;

/// The operator of a simulated device; clones share its state.
#[derive(Clone)]
pub struct Operator {
    orders: Arc<Mutex<Orders>>,
    lead_m: f64,
    seed: u64,
}

struct Orders {
    hands: Hands,
    parameters: Inerter,
    plant: Option<Plant>,
}

impl Operator {
    fn orders(&self) -> MutexGuard<'_, Orders> {
        // The orders are consistent even if a thread panicked.
        self.orders.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Applies this force to the load cell from now on \[N\].
    pub fn load(&self, newtons: f64) {
        self.orders().hands.load_n = newtons;
    }

    /// Turns the screw by this much, at the speed of a hand \[m\].
    pub fn advance(&self, metres: f64) {
        self.orders().hands.moved_m += metres;
    }

    /// Moves the terminal like this, from rest.
    pub fn shake(&self, motion: &str) -> Result<(), SimulateError> {
        let mut orders = self.orders();
        orders.plant = Some(Plant::new(orders.parameters, Excitation::parse(motion, self.seed)?)?);
        Ok(())
    }

    /// Executes one line: `load NEWTONS`, `mass KG`, `move METRES`, `turn REVOLUTIONS`, `shake MOTION`.
    pub fn obey(&self, line: &str) -> Result<(), SimulateError> {
        let unknown = || SimulateError::Hand { line: line.trim().into() };
        let (verb, what) = line.trim().split_once(' ').ok_or_else(unknown)?;
        let number = || what.trim().parse::<f64>().ok().filter(|number| number.abs() < 1e6).ok_or_else(unknown);
        match verb {
            "load" => self.load(number()?),
            "mass" => self.load(number()? * GRAVITY_M_PER_S2),
            "move" => self.advance(number()?),
            "turn" => self.advance(number()? * self.lead_m),
            "shake" => self.shake(what.trim())?,
            _ => return Err(unknown()),
        }
        Ok(())
    }
}

/// Samples of a set-up's device, up to a duration.
pub struct Samples {
    pub(crate) simulation: Simulation,
    duration_s: f64,
    /// Who loads and moves the device, if anybody does.
    bench: Option<Operator>,
}

impl Setup {
    /// The samples, with the truth beside them, up to the duration.
    pub fn samples(&self) -> Result<Samples, SimulateError> {
        let duration_s = self.duration_s.unwrap_or(f64::INFINITY);
        Ok(Samples { simulation: self.simulation()?, duration_s, bench: None })
    }

    /// Endless samples of the device, and the operator who loads and moves it; the motion of the set-up is the first
    /// one.
    pub(crate) fn handled(&self) -> Result<(Samples, Operator), SimulateError> {
        let simulation = self.simulation()?;
        let orders = Orders { hands: simulation.hands, parameters: self.parameters, plant: None };
        let orders = Arc::new(Mutex::new(orders));
        let bench = Operator { orders, lead_m: self.sensors.lead_m, seed: self.sensors.seed };
        Ok((Samples { simulation, duration_s: f64::INFINITY, bench: Some(bench.clone()) }, bench))
    }
}

impl Iterator for Samples {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        if let Some(bench) = &self.bench {
            let (wanted, plant) = {
                let mut orders = bench.orders();
                (orders.hands, orders.plant.take())
            };
            if let Some(plant) = plant {
                self.simulation.replace(plant);
            }
            let step_m = SPEED_M_PER_S / self.simulation.sensors().sample_rate_hz;
            let hands = &mut self.simulation.hands;
            let moved_m = hands.moved_m + (wanted.moved_m - hands.moved_m).clamp(-step_m, step_m);
            *hands = Hands { moved_m, ..wanted };
        }
        self.simulation.next().filter(|sample| sample.t_s < self.duration_s)
    }
}

#[cfg(test)]
mod tests {
    use inerter_data::settings::Overrides;

    use super::*;
    use crate::setup::bench_sensors;

    #[test]
    fn lines_load_move_turn_and_shake_and_others_are_refused() {
        let sensors = inerter_plant::Sensors { force_noise_n: 0.0, ..bench_sensors() };
        let setup = Setup::new(Inerter::paper(), sensors, "hold", None, &Overrides::default()).unwrap();
        let setup = Setup { load_n: 3.0, ..setup };
        let (mut samples, bench) = setup.handled().unwrap();
        let mut after = |count: usize| samples.by_ref().nth(count).unwrap();
        assert_eq!(after(0).force_code, 1500);
        bench.obey("mass -5\n").unwrap();
        bench.obey("turn 2").unwrap();
        bench.obey("move 0.001").unwrap();
        let moved = after(1100);
        assert_eq!(moved.force_code, (-5.0 * GRAVITY_M_PER_S2 / 0.002f64).round() as i32);
        assert!((i64::from(moved.position_count) - 8601).abs() <= 1, "{}", moved.position_count);
        bench.obey("load 0").unwrap();
        bench.obey("shake mid@1s").unwrap();
        assert!((0..100).map(|_| after(9)).any(|sample| sample.force_code.abs() > 50_000));
        for line in ["", "load", "load much", "load inf", "lift 3", "shake wildly"] {
            assert!(bench.obey(line).is_err(), "{line}");
        }
    }
}
