//! ADS131M04: four simultaneous 24-bit channels over SPI, every frame checked in both directions.
//!
//! Terms:
//! - *frame*: six 24-bit words each way while chip select is low. Out: command, CRC, zeros. In: the response to the
//!   command of the frame *before*, four conversions, CRC.
//! - *data rate*: `CLKIN / 2 / OSR`, [`Osr`]; *tMOD*: a period of the modulator, `2 / CLKIN`.
//! - *in step*: the conversion that a frame brings belongs to the latest DRDY edge. The chip holds two conversions, so
//!   after a pause a frame brings the older one, and a force that is one period late acts as a false damper:
//!   [`Ads131m04::drain`] and [`Ads131m04::resynchronise`] bring the two in step.
//!
//! ```no_run
//! # use ads131m04::{Ads131m04, Config, Gain, Osr, MatchedPosition};
//! # async fn example<S, R, D>(spi: S, reset: R, mut delay: D) -> Result<(), ads131m04::Error<S::Error, R::Error>>
//! # where
//! #     S: embedded_hal_async::spi::SpiDevice,
//! #     R: embedded_hal::digital::OutputPin,
//! #     D: embedded_hal_async::delay::DelayNs,
//! # {
//! let gains = [Gain::X32, Gain::X1, Gain::X1, Gain::X1];
//! let config = Config { clkin_hz: 8_000_000, osr: Osr::X4096, gains, ..Config::default() };
//! let mut adc = Ads131m04::new(spi, reset, config);
//! adc.init(&mut delay).await?;
//! let mut position = MatchedPosition::new(config.osr);
//! loop {
//!     // wait for DRDY, take the encoder count that it latched
//!     let count = 0;
//!     let conversion = adc.read().await?;
//!     if let (true, Some(position_64ths)) = (conversion.settled, position.push(count)) {
//!         // conversion.channels and position_64ths are of one instant
//!     }
//! }
//! # }
//! ```
//!
//! Files: `frame`, the words and their CRC; `registers`, the map; `filter`, rates and delays; `ratio`, the correction
//! for the excitation; `driver`, the exchange with the chip; and `mock`, the chip's side of it, for tests.
//!
//! Source: Texas Instruments SBAS890 (ADS131M04), cited by section title, as the section numbers differ between
//! revisions. The automotive ADS131M04-Q1 (SBASA13) has the same registers and filter.
#![no_std]

#[cfg(test)]
extern crate std;

mod config;
mod driver;
mod error;
mod filter;
mod frame;
#[cfg(any(test, feature = "mock"))]
pub mod mock;
mod ratio;
pub mod registers;
#[cfg(test)]
mod tests;

pub use config::{Config, ConfigError, Power};
pub use driver::{Ads131m04, Conversion};
pub use error::{Error, Recovery};
pub use filter::{MatchedPosition, Osr};
pub use frame::{CHANNELS, FRAME_BYTES, crc};
pub use ratio::{ExcitationFault, Ratiometric};
pub use registers::{Gain, Status};
