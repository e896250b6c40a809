//! The commands, one file each with its manual, and what they share.

pub mod calibrate;
pub mod compare;
pub mod completions;
pub mod config;
pub mod cut;
pub mod diagnose;
pub mod doctor;
pub mod export;
pub mod fit;
pub mod flash;
pub mod identify;
pub mod info;
pub mod merge;
pub mod monitor;
pub mod plan;
pub mod plot;
pub mod ports;
pub mod record;
pub mod replay;
pub mod report;
pub mod reproduce_paper;
pub mod selftest;
pub mod send;
pub mod settings;
pub mod simulate;
pub mod store;
pub mod update;

mod args;
mod limits;
mod lines;
mod plant;
mod screen;
mod shard;
mod terminal;
