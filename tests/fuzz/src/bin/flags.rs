//! libFuzzer on flags from a file.
#![no_main]

inerter_fuzz::target!(flags);
