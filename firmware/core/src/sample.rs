//! What a board hands over once per sample period, before any arithmetic.

/// One latched sample in raw units.
///
/// All channels are taken at the same instant by the same trigger; [`Settings`](crate::Settings) hold the scales.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RawSample {
    /// Sample counter of the device, one per sample period, wrapping at 2^32.
    /// A jump is a discontinuity: samples were lost, and nothing is assumed about them.
    pub index: u32,
    /// Sum of `oversampling` latched encoder counts, wrapping in 32 bits; only differences are used.
    pub position_count: i32,
    /// Force code: sum of ADC codes. Saturated when at or beyond `force_min_code` or `force_max_code`.
    pub force_code: i32,
    /// Terminal displacement code; 0 where there is no such sensor.
    pub terminal_code: i32,
}
