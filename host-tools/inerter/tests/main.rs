//! The program from outside: the files, output and exit code of each command, with files and with virtual devices.

mod common;

mod calibrate;
mod diagnose;
mod files;
mod firmware;
mod hostile;
mod identify;
mod live;
mod manners;
mod monitor;
#[cfg(unix)]
mod outputs;
mod plan;
#[cfg(target_os = "linux")]
mod power;
mod qemu;
mod recordings;
mod replay;
mod report;
mod rotary;
mod share;
mod store;
#[cfg(unix)]
mod unruly;
mod versions;
