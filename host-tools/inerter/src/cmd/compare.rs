//! `inerter compare`: runs side by side, and what differs between them.

use std::path::{Path, PathBuf};

use inerter_analysis::compare::{Rig, Row};
use inerter_core::Machine;
use inerter_data::{limits::Judged, output};
use inerter_view::{
    compared::{Comparison, html},
    figure::render_png,
};

use super::{
    args::FileSettingsArgs,
    limits::{Held, LimitsArgs, heard, judged_line, prove},
    print::print_machine_json,
    report::{content, make_folder},
    terminal,
};
use crate::Error;

/// Compare runs side by side: which differences are significant, and one page with all figures overlaid.
///
/// All other runs are compared with the first. Runs on one rig share the errors of force gain, lead and clock, so these
/// do not count in a difference. Runs of another board or calibration, or with another scale of encoder or force, count
/// as measured on another rig, and their full intervals are used; --rigs overrides that. A difference is significant if
/// chance alone would hardly make one as large; the more differences are tested, the stricter each test (Holm's
/// method). A run whose law is broken, in which the device changed, or with wrong samples stays undecided.
///
/// With --limits each run is also checked against limits, and the exit code is 10 unless all pass. With --json one
/// object:
/// {"kind":"compare","files":[..],"rigs":[{"rig":"same"},..],"parameters":{"inertance_kg":[{"value":..,"u95":..,
/// "same_rig_u95":..},{..,"difference":{"value":..,"u95":..,"p":..},"verdict":"differs"}],..}}. docs/CLI.md describes
/// it.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    /// Recordings (.mcap) or CSV files, at least two; the others are compared with the first
    #[arg(required = true, num_args = 2.., value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Page to write
    #[arg(short, long, value_name = "FILE.html")]
    output: Option<PathBuf>,
    /// Write the figures as PNG files into this folder, which is created if needed
    #[arg(long, value_name = "DIR")]
    png: Option<PathBuf>,
    /// Replace files that exist
    #[arg(long)]
    force: bool,
    /// Whether the runs share a rig and its calibration [default: as the files show]
    #[arg(long, value_name = "HOW_MANY")]
    rigs: Option<Rigs>,
    #[command(flatten)]
    settings: FileSettingsArgs,
    #[command(flatten)]
    limits: LimitsArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// How many rigs the runs are of.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Rigs {
    One,
    Several,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let settings = args.settings.settings.settings.as_deref();
    let read: Vec<&Path> = args.files.iter().map(PathBuf::as_path).chain(settings).collect();
    args.limits.check(&read, &args.output.as_deref().into_iter().collect::<Vec<_>>(), args.force)?;
    let rig = args.rigs.map(|rigs| match rigs {
        Rigs::One => Rig::Same,
        Rigs::Several => Rig::Other("stated by --rigs".into()),
    });
    let runs = args.files.iter().map(|file| content(file, &args.settings));
    let mut comparison = Comparison::of(runs, rig)?;
    let machine = comparison.machine();
    if let Some(limits) = args.limits.read(machine)? {
        comparison = comparison.within(&limits);
    }
    write(args, &comparison)?;
    let held: Vec<Held> = comparison
        .sides
        .iter()
        .zip(&comparison.within)
        .map(|(side, judged)| Held { run: side.name.clone(), is_file: true, machine, judged })
        .collect();
    args.limits.write(args.force, &held)?;
    let said = match args.json {
        true => print_machine_json(machine, &comparison.json()),
        false => tell(&comparison, machine),
    };
    prove(&held).and(heard(said, true))
}

/// Writes page and figures, where they are asked for.
fn write(args: &Args, comparison: &Comparison) -> Result<(), Error> {
    if args.output.is_none() && args.png.is_none() {
        return Ok(());
    }
    let (page, figures) = html(comparison);
    if let Some(folder) = &args.png {
        make_folder(folder)?;
        for figure in &figures {
            render_png(figure, &folder.join(format!("{}.png", figure.name)), args.force)?;
        }
        terminal::say(format!("{}: {} PNG files", folder.display(), figures.len()));
    }
    if let Some(path) = &args.output {
        output::write(path, args.force, &page)?;
        terminal::say(format!("{}: open it in a browser, and print it from there", path.display()));
    }
    Ok(())
}

/// What a person sees: each parameter with all runs below each other.
fn tell(comparison: &Comparison, machine: Machine) -> Result<(), Error> {
    for row in &comparison.rows {
        let field = row.field(machine);
        let (unit, factor) = row.shown_unit(machine);
        output::line(format!("{} [{unit}]", field.label))?;
        lines(comparison, row, factor).iter().try_for_each(|line| output::line(format!("  {line}")))?;
    }
    output::line("")?;
    comparison.words().iter().try_for_each(output::line)?;
    for (side, judged) in comparison.sides.iter().zip(&comparison.within) {
        output::line("")?;
        output::line(format!("{}:", side.name))?;
        judged.iter().try_for_each(|judged: &Judged| output::line(judged_line(machine, judged)))?;
        let wants: Vec<String> = judged.iter().filter_map(|judged| judged.want(machine)).collect();
        if !wants.is_empty() {
            output::line(format!("to decide: inerter plan {} --want \"{}\"", side.name, wants.join(", ")))?;
        }
    }
    Ok(())
}

/// A line for each run, its columns below each other.
fn lines(comparison: &Comparison, row: &Row, factor: f64) -> Vec<String> {
    let first = row.runs.first().and_then(|run| run.doubt);
    let cells: Vec<[String; 4]> = comparison
        .sides
        .iter()
        .zip(&row.runs)
        .enumerate()
        .map(|(number, (side, run))| {
            let (difference, said) = run.difference_text(factor).unwrap_or_default();
            let reason = if run.verdict.is_none() { run.doubt.map(str::to_string) } else { run.reason(first) };
            let said = [said.to_string()].into_iter().chain(reason).filter(|word| !word.is_empty());
            [
                side.name.clone(),
                run.value_text(comparison.shown_rig(number), factor),
                difference,
                said.collect::<Vec<_>>().join(": "),
            ]
        })
        .collect();
    let width = |place: usize| cells.iter().map(|row| row[place].chars().count()).max().unwrap_or(0);
    let widths = [width(0), width(1), width(2)];
    let line = |[name, value, difference, said]: &[String; 4]| {
        let [of_name, of_value, of_difference] = widths;
        format!("{name:<of_name$}   {value:<of_value$}   {difference:<of_difference$}   {said}").trim_end().to_string()
    };
    cells.iter().map(line).collect()
}
