//! Published recordings of real machines into the form in which the tests read them.
//!
//! docs/DATA.md says where the originals are found and what is done to each. Which recording a file is, its name says:
//!
//! | original | becomes |
//! |---|---|
//! | `DATA_EMPS.mat` | `emps/emps.csv` |
//! | `DATE-RUN_mr.csv` with `DATE-RUN_ni.csv` | `lodz/RUN.csv` |
//! | `1Hz20lbtension.json` | `arts/1hz_20lb.csv` |

mod arts;
mod emps;
mod lodz;
mod samples;

pub use samples::{Error, Row};

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

/// Converts the originals into the folder; says what was written.
pub fn convert(files: &[PathBuf], folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut written = Vec::new();
    // The servo's log and the card's of each run.
    let mut pairs = BTreeMap::<String, [Option<PathBuf>; 2]>::new();
    for file in files {
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if name.ends_with(".mat") {
            written.push(write(folder, "emps/emps.csv", of(file, emps::samples))?);
        } else if let Some(test) = name.strip_suffix("tension.json") {
            let name = format!("arts/{}.csv", test.to_lowercase().replace("hz", "hz_"));
            written.push(write(folder, &name, of(file, arts::samples))?);
        } else if let Some(run) = name.strip_suffix("_mr.csv") {
            pairs.entry(run.into()).or_default()[0] = Some(file.clone());
        } else if let Some(run) = name.strip_suffix("_ni.csv") {
            pairs.entry(run.into()).or_default()[1] = Some(file.clone());
        } else {
            return Err(
                format!("{}: by its name none of the recordings that docs/DATA.md lists", file.display()).into()
            );
        }
    }
    for (run, pair) in pairs {
        let [Some(servo), Some(card)] = &pair else {
            return Err(
                format!("{run}: both {run}_mr.csv, the servo's log, and {run}_ni.csv, the card's, are needed").into()
            );
        };
        let (servo, card) = (of(servo, lodz::servo), of(card, lodz::card));
        // The date is no part of the name.
        let name = run.trim_start_matches(|letter: char| letter.is_ascii_digit()).trim_start_matches(['-', '_']);
        let joined = lodz::join(&servo?, &card?).map_err(|error| format!("{run}: {error}").into());
        written.push(write(folder, &format!("lodz/{name}.csv"), joined)?);
    }
    Ok(written)
}

/// Reads a file; an error names it.
fn of<T>(file: &Path, read: impl Fn(&[u8]) -> Result<T, Error>) -> Result<T, Error> {
    let bytes = fs::read(file).map_err(Error::from);
    bytes.and_then(|bytes| read(&bytes)).map_err(|error| format!("{}: {error}", file.display()).into())
}

fn write(folder: &Path, name: &str, rows: Result<Vec<Row>, Error>) -> Result<PathBuf, Error> {
    let (rows, path) = (rows?, folder.join(name));
    fs::create_dir_all(path.parent().unwrap_or(folder))?;
    fs::write(&path, samples::csv(&rows)).map_err(|error| format!("{}: {error}", path.display()))?;
    Ok(path)
}
