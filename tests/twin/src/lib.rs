//! The twin: runs the shipping binary on a computer.
//!
//! The release ELF for the STM32G474RE runs unmodified. [unicorn](https://www.unicorn-engine.org) executes the
//! instructions; this crate implements everything around them: interrupt controller and virtual time ([`nvic`],
//! [`cpu`]), one small model per peripheral ([`chip`]), the world outside the pins ([`world`], [`mod@bench`]) and the
//! USB host ([`usb_host`]). Tests use a [`machine::Machine`].
//!
//! Glossary:
//! - *cycle*: one period of the core clock HCLK. An instruction counts as one cycle, an exception entry or return as
//!   12; [`cycles`] bounds their cost on the chip.
//! - *now*: cycles since power was first applied, the only time base; [`chip::clocks::Clocks`] converts it to seconds.
//! - *line*: the level of an interrupt request from a peripheral to the interrupt controller.
//! - *storage*: a register that only stores what was written to it. A read of one that was never written is listed.
//!
//! What a passing test means: the binary agrees with these models, and the models are our reading of RM0440 (reference
//! manual), DS12288 (data sheet) and ARM DDI 0403 (ARMv7-M). They were not checked against silicon.
//!
//! Licence: unicorn is GPL-2.0. This crate is for tests only and is not linked into anything that ships.

/// Declares the registers of a peripheral as constants: the offset of each, and in braces the numbers of its bits,
/// whose masks have the given type.
macro_rules! registers {
    ($type:ty: $($visible:vis $register:ident $offset:literal $({ $($bit:ident $number:literal),+ })?),+ $(,)?) => {
        $(
            $visible const $register: u32 = $offset;
            $($(const $bit: $type = 1 << $number;)+)?
        )+
    };
}

pub mod bench;
pub mod board;
pub mod boot_rom;
pub mod chip;
pub mod cpu;
pub mod cycles;
pub mod elf;
pub mod machine;
#[cfg(test)]
mod metapac;
pub mod nvic;
pub mod registers;
pub mod serial_link;
pub mod talk;
pub mod tcp;
pub mod usb_host;
pub mod usb_link;
pub mod usbip;
pub mod world;

pub use board::Board;
pub use chip::clocks::Cycles;
pub use registers::{Modelled, Registers, Storage, Unknown, Width};
pub use world::World;
