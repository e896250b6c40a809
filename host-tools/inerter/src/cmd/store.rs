//! `inerter store`: arguments and manual; its work is in `tables/store.rs`.

use std::path::PathBuf;

use super::{limits::LimitsArgs, tables::values::Day};

/// Keep recordings in a store, and find them by their results.
///
/// A store is a folder, or a place in S3-compatible storage: s3://BUCKET/FOLDER, with the credentials of the usual
/// variables AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION and AWS_ENDPOINT. It holds the recordings as they
/// are, each named by the SHA-256 of its contents, and tables in Parquet that DuckDB, pandas and Polars read without
/// this program. docs/STORE.md describes it.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(clap::Subcommand)]
pub enum Command {
    Add(AddArgs),
    Ls(LsArgs),
    Show(ShowArgs),
    Query(QueryArgs),
    Get(GetArgs),
    Verify(VerifyArgs),
    Remove(RemoveArgs),
}

/// Add recordings; the first valid one creates the store.
///
/// Each goes through the estimator, and the results become the tables beside it. The same recording twice is one run,
/// whatever its file is called. Several processes may add at once. If a recording cannot be used, the command says so,
/// adds the others, and the exit code is 3.
#[derive(clap::Args)]
pub struct AddArgs {
    /// Folder, or s3://BUCKET/FOLDER
    #[arg(value_name = "STORE")]
    pub url: String,
    /// Recordings (.mcap)
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Print JSON: one object per recording
    #[arg(long)]
    pub json: bool,
}

/// Which runs, and how they are printed.
#[derive(clap::Args)]
pub struct ListArgs {
    /// Only runs of this device, by its serial number
    #[arg(long, value_name = "SERIAL")]
    pub device: Option<String>,
    /// Runs recorded on this day (UTC) or later: 2026-01-31, or 2026-01
    #[arg(long, value_name = "DATE")]
    pub from: Option<Day>,
    /// Runs recorded on this day (UTC) or earlier
    #[arg(long, value_name = "DATE")]
    pub to: Option<Day>,
    /// Print JSON: one object per run
    #[arg(long, conflicts_with = "csv")]
    pub json: bool,
    /// Print CSV with all columns
    #[arg(long)]
    pub csv: bool,
    #[command(flatten)]
    pub limits: LimitsArgs,
    /// Replace the files of --junit and --verdicts if they exist
    #[arg(long, help_heading = "Limits")]
    pub force: bool,
}

/// List the runs of a store.
///
/// With --json one object per line with all columns of the table `runs`:
/// {"run":..,"device":..,"date":..,"inertance_kg":..,..}. With --limits each run is checked against limits, as by
/// `inerter replay`, and the exit code is 10 unless all pass.
#[derive(clap::Args)]
pub struct LsArgs {
    /// Folder, or s3://BUCKET/FOLDER
    #[arg(value_name = "STORE")]
    pub url: String,
    #[command(flatten)]
    pub list: ListArgs,
}

/// List the runs that meet all conditions.
///
/// A condition is a column of the table `runs`, one of < <= > >= = !=, and a number or a word: "inertance_kg < 300",
/// "law = broken". An unknown value meets no condition. For more than that, query the tables with DuckDB: docs/STORE.md
/// has examples. With --limits those runs are checked against limits, and the exit code is 10 unless all pass.
#[derive(clap::Args)]
pub struct QueryArgs {
    /// Folder, or s3://BUCKET/FOLDER
    #[arg(value_name = "STORE")]
    pub url: String,
    /// Condition on a column: "inertance_kg < 300"
    #[arg(required = true, value_name = "CONDITION")]
    pub conditions: Vec<String>,
    #[command(flatten)]
    pub list: ListArgs,
}

/// Show the results that a store holds of a run.
#[derive(clap::Args)]
pub struct ShowArgs {
    /// Folder, or s3://BUCKET/FOLDER
    #[arg(value_name = "STORE")]
    pub url: String,
    /// The beginning of its name
    pub run: String,
    /// Print JSON: one object with all columns, settings and truth as objects
    #[arg(long)]
    pub json: bool,
}

/// Write the recording of a run into a file.
///
/// It is checked against its name while it is copied.
#[derive(clap::Args)]
pub struct GetArgs {
    /// Folder, or s3://BUCKET/FOLDER
    #[arg(value_name = "STORE")]
    pub url: String,
    /// The beginning of its name
    pub run: String,
    /// File to write (.mcap)
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Replace a file that exists
    #[arg(long)]
    pub force: bool,
}

/// Read every file of a store, and report those that have changed since they were written.
///
/// The exit code is 3 if a file is missing, changed, unreadable, oversized (a row of more than 256 KB or 512 columns),
/// unfinished (of a run whose adding or removal was not completed) or foreign. `sha256sum` does the same without this
/// program: docs/STORE.md.
#[derive(clap::Args)]
pub struct VerifyArgs {
    /// Folder, or s3://BUCKET/FOLDER
    #[arg(value_name = "STORE")]
    pub url: String,
    /// First rebuild the derived files from intact recordings, and remove what is left of runs without one; nobody may
    /// add or remove runs meanwhile
    #[arg(long)]
    pub repair: bool,
    /// Print JSON: one object per file, and one at the end
    #[arg(long)]
    pub json: bool,
}

/// Remove runs with their recordings and results.
///
/// Nobody may add the same recording meanwhile.
#[derive(clap::Args)]
pub struct RemoveArgs {
    /// Folder, or s3://BUCKET/FOLDER
    #[arg(value_name = "STORE")]
    pub url: String,
    /// The beginnings of their names
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<String>,
    /// Do not ask
    #[arg(long)]
    pub yes: bool,
}
