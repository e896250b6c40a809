//! libFuzzer on CSV files.
#![no_main]

inerter_fuzz::target!(csv);
