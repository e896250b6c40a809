//! The instrument on the STM32G474; on a host the library is empty.
//!
//! ```text
//! cd firmware/stm32g474
//! cargo build --release                                                   # NUCLEO-G474RE
//! cargo build --release --no-default-features --features board-weact     # WeAct STM32G474
//! cargo run --release                                                     # flashes by probe-rs and shows the log
//! ```
//!
//! - *Boards*: `boards/*.rs` are the only files that name pins and clocks; wiring and bring-up are in docs/HARDWARE.md.
//! - *Samples*: one 64 kHz timer event starts everything; see `rings.rs` and `sampler.rs`. Or an ADS131M04; see
//!   `converter.rs`. The setting `front_end` chooses.
//! - *Links*: USB CDC-ACM while its port is open, otherwise LPUART1 (the ST-Link's serial port), with the same protocol
//!   on both.
//! - *Executors*: sampling runs in an interrupt, above everything that may take long; everything else runs in thread
//!   mode.
//! - *Measurements of the board itself*, on request: `measure.rs`, with the counters of `work.rs`.
//! - *Memory*: static only. Settings are in the last 16 KB of the second flash bank; what must survive a reset
//!   (panic message, update request) is in RAM that start-up does not touch.
#![cfg(target_os = "none")]
#![no_std]

mod adc;
mod boards;
mod clkin;
mod clocks;
mod converter;
mod defaults;
mod executor;
mod flash;
mod identity;
mod image;
mod interrupts;
mod led;
mod lpuart;
mod measure;
mod options;
mod panic;
mod pins;
mod platform;
mod player;
mod ready;
mod reset;
mod rings;
mod sampler;
mod source;
mod spi;
mod stack;
mod temperature;
mod usb;
mod watchdog;
mod work;

pub use image::run;
