//! The commands, one file each with its manual, and what they share.

pub mod export;
pub mod info;
pub mod monitor;
pub mod ports;
pub mod record;
pub mod replay;
pub mod send;
pub mod simulate;

mod args;
mod screen;
mod terminal;
