//! `inerter export`: samples and estimates for other tools.

use std::path::{Path, PathBuf};

use inerter_core::Machine;
use inerter_data::{
    export::{self, Column, EstimateTable, Format, Selection},
    output, settings,
    words::{nearest, plural},
};
use serde_json::json;

use super::{
    args::{FileSettingsArgs, RangeArgs},
    print::print_json,
    terminal::{self, Progress},
};
use crate::{Error, error::Failure, feature::Feature};

/// Write samples and estimates for Excel, pandas, MATLAB, PlotJuggler.
///
/// Several formats may be written at once. Memory use stays small, however long the recording.
///
/// CSV: t_s, encoder_count, force_n and, if measured, terminal_m. The settings go into a TOML file beside it
/// (run.csv, run.settings.toml): with them a replay of the CSV gives the same result as a replay of the recording.
/// `--csv -` writes to standard output, without the settings.
///
/// Parquet, MATLAB: also position_m; units, settings and device are included (metadata of the Parquet file and
/// DataFrame.attrs in pandas; the variables `settings`, `units`, `device` in MATLAB). A .mat is version 7.3, which is
/// HDF5.
///
/// MCAP: every sample as JSON for PlotJuggler and Foxglove, about 100 bytes each.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("output").required(true).multiple(true))]
pub struct Args {
    /// Recording (.mcap) or CSV file
    file: PathBuf,
    /// CSV file to write, - for standard output
    #[arg(long, value_name = "FILE", group = "output")]
    csv: Option<PathBuf>,
    /// Parquet file to write
    #[arg(long, value_name = "FILE", group = "output")]
    parquet: Option<PathBuf>,
    /// MATLAB file to write (v7.3)
    #[arg(long, value_name = "FILE", group = "output")]
    mat: Option<PathBuf>,
    /// MCAP file to write, with decoded samples at the full rate
    #[arg(long, value_name = "FILE", group = "output")]
    mcap: Option<PathBuf>,
    #[command(flatten)]
    range: RangeArgs,
    /// Columns instead of the usual ones, separated by commas: t_s, encoder_count, position_m, force_n, terminal_m,
    /// index, saturated
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = column)]
    columns: Option<Vec<Column>>,
    /// Also write the device's estimates with their intervals: beside a CSV or Parquet file (run.estimates.csv), as the
    /// variable `estimates` in MATLAB. For a CSV a replay computes them
    #[arg(long)]
    estimates: bool,
    /// Replace files that exist
    #[arg(long)]
    force: bool,
    /// Print JSON: one object when everything is written
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: FileSettingsArgs,
}

fn column(name: &str) -> Result<Column, String> {
    Column::find(name.trim()).ok_or_else(|| {
        let names = |machine| Column::ALL.into_iter().map(move |column| column.name(machine));
        let rotary: Vec<_> =
            names(Machine::Rotary).filter(|name| !names(Machine::Linear).any(|linear| linear == *name)).collect();
        match nearest(name, names(Machine::Linear).chain(rotary.iter().copied())) {
            Some(nearest) => format!("there is no such column; did you mean {nearest}?"),
            None => format!(
                "there is no such column; there are {}; of a rotary machine {}",
                names(Machine::Linear).collect::<Vec<_>>().join(", "),
                rotary.join(", ")
            ),
        }
    })
}

impl Args {
    fn to_stdout(&self) -> bool {
        self.csv.as_ref().is_some_and(|path| path.as_os_str() == "-")
    }

    /// Files to write with their formats.
    fn targets(&self) -> Vec<(Format, PathBuf)> {
        let outputs = [
            (Format::Csv, &self.csv),
            (Format::Parquet, &self.parquet),
            (Format::Mat, &self.mat),
            (Format::Mcap, &self.mcap),
        ];
        let files = outputs.into_iter().filter_map(|(format, path)| Some((format, path.clone()?)));
        files.filter(|(format, path)| *format != Format::Csv || path.as_os_str() != "-").collect()
    }
}

pub fn run(args: &Args) -> Result<(), Error> {
    for (option, file) in [("--parquet", &args.parquet), ("--mat", &args.mat)] {
        Feature::TABLES.check(option, file.is_some(), "--csv and --mcap are always built in")?;
    }
    if args.to_stdout() && (args.json || args.estimates) {
        return Err(Failure::StandardOutput.into());
    }
    let targets = args.targets();
    let csv = targets.iter().find(|(format, _)| *format == Format::Csv).map(|(_, path)| path);
    if !args.force {
        let toml = csv.map(|csv| settings::beside(csv));
        targets.iter().try_for_each(|(_, path)| output::refuse_existing(path))?;
        let tables =
            targets.iter().filter(|(format, _)| args.estimates && matches!(format, Format::Csv | Format::Parquet));
        let mut beside = tables.map(|(_, path)| export::beside(path)).chain(toml);
        beside.try_for_each(|path| output::refuse_existing(&path))?;
    }
    let source = args.settings.source(&args.file)?;
    let selection = Selection { columns: args.columns.clone(), range_s: args.range.range_s() };
    let table = args.estimates.then(|| EstimateTable::collect(&source, &selection.range_s)).transpose()?;
    // From here on there is a file to remove on interrupt.
    terminal::catch_interrupts();
    let mut bar = Progress::new("exporting", 1000);
    let mut progress = |part: f64| {
        bar.set_part(part);
        terminal::go_on()
    };
    if args.to_stdout() {
        export::write_csv(&source, &selection, "standard output", std::io::stdout(), &mut progress)?;
    }
    if targets.is_empty() {
        bar.done();
        return Ok(());
    }
    let exported = export::export(&source, &selection, &targets, args.force, table.as_ref(), &mut progress)?;
    bar.done();
    let toml = csv
        .map(|csv| settings::write_beside(&source.settings, source.calibration.as_ref(), csv, args.force))
        .transpose()?;
    if args.json {
        let outputs: Vec<_> = exported
            .files
            .iter()
            .map(|(format, file)| json!({"format": word(*format), "file": file.to_string_lossy()}))
            .collect();
        return print_json(&json!({
            "kind": "exported", "file": source.name, "samples": exported.rows, "estimates": exported.estimates,
            "outputs": outputs, "settings_file": toml.as_deref().map(Path::to_string_lossy),
        }));
    }
    let files: Vec<String> = exported.files.iter().map(|(_, file)| file.display().to_string()).collect();
    let beside = toml.as_ref().map(|toml| format!(", the settings to {}", toml.display())).unwrap_or_default();
    let estimates =
        if args.estimates { format!(" and {}", plural(exported.estimates, "estimate")) } else { String::new() };
    terminal::say(format!("{}{estimates} written to {}{beside}", plural(exported.rows, "sample"), files.join(", ")));
    if let (Some(csv), Some(toml), None) = (csv, &toml, &args.columns) {
        terminal::say(format!("replay it with: inerter replay {} --settings {}", csv.display(), toml.display()));
    }
    Ok(())
}

fn word(format: Format) -> &'static str {
    match format {
        Format::Csv => "csv",
        Format::Parquet => "parquet",
        Format::Mat => "mat",
        Format::Mcap => "mcap",
    }
}
