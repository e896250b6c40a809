//! libFuzzer on the estimator.
#![no_main]

inerter_fuzz::target!(estimator);
