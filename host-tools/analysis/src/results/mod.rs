//! Results of runs, as the program prints them and as other programs receive them.

mod by_name;
mod compared;
mod diagnosed;
mod fitted;
mod identified;
mod replayed;

pub use compared::CompareJson;
pub use diagnosed::{Diagnosed, DiagnosisJson, Unsought, diagnosed};
pub use fitted::FitJson;
pub use identified::{IdentifyJson, responses};
pub use replayed::{LastJson, LimitsJson, Replayed, replayed, warning};
