//! `inerter report`: a run as a page to hand on.

use std::{
    fs,
    path::{Path, PathBuf},
};

use inerter_data::{
    json::json_line,
    output::{self, OutputError},
};
use inerter_view::{
    figure::render_png,
    page::{Content, html},
};
use serde_json::json;

use super::{
    args::FileSettingsArgs,
    terminal::{self, Progress, note},
};
use crate::Error;

/// Write a page on a run: parameters with intervals, figures, conditions, settings and versions.
///
/// The page is one HTML file that loads nothing else, prints on A4 and follows the reader's light or dark scheme. It shows the
/// force against the law, what is left over, the force-displacement loop, parameters over time, backlash by reversal, and
/// the measured frequency response beside the ideal and the complete model. What this run cannot show is said in words.
///
/// --png writes the figures as PNG files besides, for slides and papers; `inerter plot` writes a single one.
/// With --json one object: {"kind":"report","file":..,"source":..,"figures":[..],"png":[..]}. docs/CLI.md describes it.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    /// Recording (.mcap) or CSV file
    file: PathBuf,
    /// Page to write
    #[arg(short, long, value_name = "FILE.html")]
    output: PathBuf,
    /// Write the figures as PNG files into this folder, which is made when it is not there
    #[arg(long, value_name = "DIR")]
    png: Option<PathBuf>,
    /// Replace files that exist
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    settings: FileSettingsArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<(), Error> {
    if !args.force {
        output::refuse_existing(&args.output)?;
    }
    terminal::tidy_at_interrupts();
    let content = content(&args.file, &args.settings)?;
    let (page, figures) = html(&content);
    let mut images = Vec::new();
    if let Some(folder) = &args.png {
        make_folder(folder)?;
        let mut progress = Progress::new("drawing", figures.len() as u64);
        for (number, figure) in figures.iter().enumerate() {
            let path = folder.join(format!("{}.png", figure.name));
            render_png(figure, &path, args.force)?;
            progress.set(number as u64 + 1);
            images.push(path.display().to_string());
        }
        progress.done();
    }
    output::write(&args.output, args.force, &page)?;
    let file = args.output.display();
    if args.json {
        let names: Vec<&str> = figures.iter().map(|figure| figure.name).collect();
        let line = json!({ "kind": "report", "file": file.to_string(), "source": args.file.display().to_string(), "figures": names, "png": images });
        return Ok(output::line(json_line(&line))?);
    }
    terminal::say(format!("{file}: {} figures; open it in a browser, and print it from there", figures.len()));
    if let Some(folder) = &args.png {
        terminal::say(format!("{}: {} PNG files", folder.display(), images.len()));
    }
    Ok(())
}

/// Reads a file and takes it through the estimator, with a bar.
pub fn content(file: &Path, settings: &FileSettingsArgs) -> Result<Content, Error> {
    let run = inerter_data::open(file, &settings.overrides()?)?;
    run.notes.iter().for_each(note);
    let mut progress = Progress::new("replaying", 1000);
    let content = Content::of(run, |part| progress.set((part * 1e3) as u64))?;
    progress.done();
    Ok(content)
}

/// Makes a folder and those above it.
pub fn make_folder(folder: &Path) -> Result<(), OutputError> {
    fs::create_dir_all(folder).map_err(|source| OutputError::Create { path: folder.into(), source })
}
