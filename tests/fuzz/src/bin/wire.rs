//! libFuzzer on the frames of the wire.
#![no_main]

inerter_fuzz::target!(wire);
