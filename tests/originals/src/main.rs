//! `originals FOLDER FILE...`: converts published recordings into the folder; `cargo xtask data` runs this.

use std::{path::PathBuf, process::ExitCode};

fn main() -> ExitCode {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let Some(folder) = arguments.next() else {
        eprintln!("usage: originals FOLDER FILE...");
        return ExitCode::from(2);
    };
    match inerter_originals::convert(&arguments.collect::<Vec<_>>(), &folder) {
        Ok(written) => {
            written.iter().for_each(|path| println!("{}", path.display()));
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
