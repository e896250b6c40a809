//! `inerter plot`: one figure of a run.

use std::{ffi::OsStr, path::PathBuf};

use clap::builder::PossibleValuesParser;
use inerter_data::output;
use inerter_view::{
    figure::{render_png, svg},
    page::{Kind, PageError, figure},
};
use serde_json::json;

use super::{args::FileSettingsArgs, print::print_json, report, terminal};
use crate::Error;

/// Draw one figure of a run, as SVG for print or as PNG.
///
/// force: measured force and law in the middle of the run. loop: force over displacement. residual: residual of the
/// law. parameters: estimates with intervals over time. backlash: by reversal. bode: measured, ideal and complete
/// frequency response. A figure that the run cannot give is refused with code 9.
///
/// With --json one object: {"kind":"plot","file":..,"source":..,"figure":..,"caption":..}.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    /// Recording (.mcap) or CSV file
    file: PathBuf,
    /// Which figure
    #[arg(long, value_name = "NAME", value_parser = PossibleValuesParser::new(Kind::ALL.map(Kind::name)))]
    figure: String,
    /// File to write, .svg or .png
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Replace a file that exists
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    settings: FileSettingsArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let path = args.output.as_path();
    let ending = path.extension().and_then(OsStr::to_str).map(str::to_lowercase);
    let bitmap = match ending.as_deref() {
        Some("png") => true,
        Some("svg") => false,
        _ => return Err(PageError::Format { path: path.display().to_string() }.into()),
    };
    if !args.force {
        output::refuse_existing(path)?;
    }
    terminal::tidy_at_interrupts();
    // clap has let through only these names.
    let kind = Kind::ALL.into_iter().find(|kind| kind.name() == args.figure).unwrap_or(Kind::Force);
    let drawn = figure(&report::content(&args.file, &args.settings)?, kind)?;
    if bitmap {
        render_png(&drawn, path, args.force)?
    } else {
        output::write(path, args.force, svg(&drawn))?
    }
    if args.json {
        let line = json!({ "kind": "plot", "file": path.display().to_string(), "source": args.file.display().to_string(), "figure": drawn.name, "caption": drawn.caption });
        return print_json(&line);
    }
    terminal::say(format!("{}: {}", path.display(), drawn.caption));
    Ok(())
}
