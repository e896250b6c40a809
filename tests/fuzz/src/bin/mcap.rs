//! libFuzzer on recordings.
#![no_main]

inerter_fuzz::target!(mcap);
