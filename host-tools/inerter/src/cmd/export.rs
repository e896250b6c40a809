//! `inerter export`: a recording as CSV.

use std::path::PathBuf;

use inerter::{Error, csv, output, report::plural, run::Run, settings};

use super::{args::FileSettingsArgs, terminal};

/// Write the samples of a recording as CSV.
///
/// Columns: t_s, encoder_count, force_n and, when it was measured, terminal_m.
///
/// The settings go into a TOML file beside it (run.csv, run.settings.toml): with them a replay of the CSV gives the same
/// result as a replay of the recording. `--csv -` writes to standard output, without the settings.
#[derive(clap::Args)]
pub struct Args {
    /// Recording (.mcap) or CSV file
    file: PathBuf,
    /// CSV file to write, - for standard output
    #[arg(long, value_name = "FILE")]
    csv: PathBuf,
    #[command(flatten)]
    settings: FileSettingsArgs,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let run = Run::open(&args.file, &args.settings.overrides()?)?;
    run.notes.iter().for_each(terminal::note);
    if args.csv.as_os_str() == "-" {
        let mut out = std::io::BufWriter::new(std::io::stdout().lock());
        let written = csv::write_to(&run, &mut out).and_then(|()| std::io::Write::flush(&mut out));
        return Ok(written.map_err(|source| output::OutputError::write("standard output", source))?);
    }
    csv::write(&run, &args.csv)?;
    let toml = settings::write_beside(&run.settings, &args.csv)?;
    let (csv, toml) = (args.csv.display(), toml.display());
    terminal::say(format!("{} written to {csv}, the settings to {toml}", plural(run.samples.len() as u64, "sample")));
    terminal::say(format!("replay it with: inerter replay {csv} --settings {toml}"));
    Ok(())
}
