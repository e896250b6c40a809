//! The loop of a firmware: no allocator, no clock, no I/O but the board's.
//!
//! Check it for a chip with `cargo check -p inerter-core --example firmware --target thumbv7em-none-eabihf`.
#![no_std]

use inerter_core::{Interval, RawSample, Settings, SettingsError, State};

/// What the loop needs of a board.
pub trait Board {
    /// Waits for the next sample: counts and codes latched by one trigger. `None` ends the loop.
    fn sample(&mut self) -> Option<RawSample>;
    /// Takes the inertance \[kg\] while the motion identifies it.
    fn show(&mut self, inertance_kg: Option<Interval>);
    /// Learns that the device has changed.
    fn alarm(&mut self);
}

/// Measures until the samples end. The state may lie in a static, as [`State::empty`] is a constant.
pub fn measure(board: &mut impl Board, state: &mut State) -> Result<(), SettingsError> {
    let settings = Settings {
        sample_rate_hz: 4000.0,
        // 10 mm of lead, 4096 counts per revolution.
        metres_per_count: 0.01 / 4096.0,
        // 16 bits over 10 kN, the zero in the middle.
        newtons_per_code: 10_000.0 / 65_536.0,
        force_zero_code: 32_768.0,
        force_min_code: 0.0,
        force_max_code: 65_535.0,
        ..Settings::default()
    };
    let active = settings.validate()?;
    state.reset(&active);
    while let Some(sample) = board.sample() {
        let output = active.step(state, &sample);
        if let Some(estimate) = output.estimate() {
            board.show(estimate.recent.inertance_kg.ok());
        }
        if output.change.is_some() {
            board.alarm();
        }
    }
    Ok(())
}
