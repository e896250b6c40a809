//! libFuzzer on firmware images.
#![no_main]

inerter_fuzz::target!(image);
