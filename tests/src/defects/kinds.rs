//! The kinds of defects, by place: device, force channel, encoder, sampling, settings.

mod device;
mod encoder;
mod force;
mod kind;
mod sampling;
mod settings;

pub use kind::{Group, Kind};

/// All kinds.
pub fn all() -> Vec<&'static Kind> {
    let parts: [&'static [Kind]; 5] =
        [&device::KINDS, &force::KINDS, &encoder::KINDS, &sampling::KINDS, &settings::KINDS];
    parts.into_iter().flatten().collect()
}
