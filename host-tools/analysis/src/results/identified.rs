//! The complete model of a device, with the frequency response of each of its runs.

use inerter_data::{run::Run, series::Series};
use serde::Serialize;

use crate::{
    identify::Identified,
    response::{self, Beside},
};

/// An identification in JSON.
#[derive(Clone, Debug, Serialize)]
pub struct IdentifyJson<'a> {
    kind: &'static str,
    files: Vec<String>,
    #[serde(flatten)]
    identified: &'a Identified,
    /// One for each file.
    responses: Vec<Beside>,
}

impl<'a> IdentifyJson<'a> {
    /// From these runs, with the names of their files.
    pub fn new(files: Vec<String>, runs: &[Run], identified: &'a Identified) -> Self {
        Self { kind: "identify", files, identified, responses: responses(runs, identified) }
    }
}

/// The frequency response of each run, with the models from the values found.
pub fn responses(runs: &[Run], found: &Identified) -> Vec<Beside> {
    let model = found.model();
    runs.iter().map(|run| Beside::of(&response::measured(&Series::of(run)), &model)).collect()
}
