//! The instrument on the STM32G474 with a task that hangs, for the test of the watchdog.
#![cfg_attr(target_os = "none", no_std, no_main)]

include!("modules.rs");
