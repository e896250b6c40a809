//! `inerter compare`: runs side by side, and what differs between them.

use std::path::PathBuf;

use inerter_analysis::compare::{Rig, Row};
use inerter_core::Machine;
use inerter_data::{limits::Judged, output};
use inerter_view::{
    compared::{Comparison, html},
    figure::render_png,
};

use super::page::{content, make_folder};
use crate::{
    Error,
    cmd::{
        compare::{Args, Rigs},
        limits::{Held, heard, judged_line, prove},
        print::{aligned, print_machine_json},
        terminal,
    },
};

pub fn run(args: &Args) -> Result<(), Error> {
    let settings = args.settings.settings.settings.as_deref();
    let read = args.files.iter().map(PathBuf::as_path).chain(settings);
    args.limits.check(read, args.output.as_deref(), args.force)?;
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

/// Writes page and figures, if requested.
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

/// Output for a person: each parameter with all runs one below the other.
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

/// One line per run, with aligned columns.
fn lines(comparison: &Comparison, row: &Row, factor: f64) -> Vec<String> {
    let first = row.runs.first().and_then(|run| run.doubt);
    let cells: Vec<Vec<String>> = comparison
        .sides
        .iter()
        .zip(&row.runs)
        .enumerate()
        .map(|(number, (side, run))| {
            let (difference, said) = run.difference_text(factor).unwrap_or_default();
            let reason = if run.verdict.is_none() { run.doubt.map(str::to_string) } else { run.reason(first) };
            let said = [said.to_string()].into_iter().chain(reason).filter(|word| !word.is_empty());
            let said = said.collect::<Vec<_>>().join(": ");
            vec![side.name.clone(), run.value_text(comparison.shown_rig(number), factor), difference, said]
        })
        .collect();
    aligned(&cells, "   ")
}
