//! libFuzzer on the device's commands.
#![no_main]

inerter_fuzz::target!(commands);
