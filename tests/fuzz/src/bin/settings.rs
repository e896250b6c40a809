//! libFuzzer on settings files.
#![no_main]

inerter_fuzz::target!(settings);
