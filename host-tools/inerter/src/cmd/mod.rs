//! The commands, one file each with its manual, and the code they share.

mod calibrate;
mod compare;
mod completions;
pub mod config;
mod cut;
mod diagnose;
mod doctor;
mod export;
mod fit;
mod flash;
mod identify;
mod info;
mod merge;
mod monitor;
mod plan;
mod plot;
mod ports;
mod record;
mod replay;
mod report;
mod reproduce_paper;
mod selftest;
mod send;
mod settings;
mod simulate;
mod store;
mod update;

mod args;
mod limits;
mod lines;
mod plant;
mod print;
#[cfg(feature = "reports")]
mod reports;
#[cfg(feature = "screen")]
mod screen;
mod shard;
#[cfg(feature = "tables")]
mod tables;
mod terminal;
#[cfg(not(all(feature = "reports", feature = "tables")))]
mod without;

#[cfg(not(feature = "reports"))]
use without as reports;
#[cfg(not(feature = "tables"))]
use without as tables;

use crate::Error;

#[derive(clap::Subcommand)]
pub enum Command {
    Simulate(Box<simulate::Args>),
    Monitor(monitor::Args),
    Record(record::Args),
    Replay(replay::Args),
    Send(send::Args),
    Export(Box<export::Args>),
    Cut(cut::Args),
    Merge(merge::Args),
    Fit(fit::Args),
    Compare(compare::Args),
    Report(report::Args),
    Plot(plot::Args),
    ReproducePaper(reproduce_paper::Args),
    Identify(identify::Args),
    Diagnose(diagnose::Args),
    Plan(Box<plan::Args>),
    Calibrate(calibrate::Args),
    Info(info::Args),
    Ports(ports::Args),
    Doctor(doctor::Args),
    Settings(settings::Args),
    Store(store::Args),
    Selftest(selftest::Args),
    Update(update::Args),
    Flash(flash::Args),
    Completions(completions::Args),
    Man(completions::ManArgs),
}

impl Command {
    /// Runs the command; `line` rebuilds the whole command line.
    pub fn run(&self, line: fn() -> clap::Command) -> Result<(), Error> {
        match self {
            Self::Simulate(args) => simulate::run(args),
            Self::Monitor(args) => monitor::run(args),
            Self::Record(args) => record::run(args),
            Self::Replay(args) => replay::run(args),
            Self::Send(args) => send::run(args),
            Self::Export(args) => export::run(args),
            Self::Cut(args) => cut::run(args),
            Self::Merge(args) => merge::run(args),
            Self::Fit(args) => fit::run(args),
            Self::Compare(args) => reports::compare(args),
            Self::Report(args) => reports::report(args),
            Self::Plot(args) => reports::plot(args),
            Self::ReproducePaper(args) => reports::reproduce_paper(args),
            Self::Identify(args) => identify::run(args),
            Self::Diagnose(args) => diagnose::run(args),
            Self::Plan(args) => plan::run(args),
            Self::Calibrate(args) => calibrate::run(args),
            Self::Info(args) => info::run(args),
            Self::Ports(args) => ports::run(args),
            Self::Doctor(args) => doctor::run(args),
            Self::Settings(args) => settings::run(args),
            Self::Store(args) => tables::store(args),
            Self::Selftest(args) => selftest::run(args),
            Self::Update(args) => update::run(args),
            Self::Flash(args) => flash::run(args),
            Self::Completions(args) => completions::run(args, line()),
            Self::Man(args) => completions::man(args, line()),
        }
    }
}
