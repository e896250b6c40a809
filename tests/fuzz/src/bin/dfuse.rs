//! libFuzzer on the chip's ROM in update mode.
#![no_main]

inerter_fuzz::target!(dfuse);
