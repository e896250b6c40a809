//! The shipping image on the emulated chip.

mod common;

mod boot;
mod foreign;
mod jumpers;
mod linux;
mod registers;
mod sampling;
mod selftest;
mod system;
mod update;
mod usb;
