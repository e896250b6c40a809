//! Results of runs, as the program prints them and as other programs receive them.

mod compared;
mod diagnosed;
mod fitted;
mod identified;
mod replayed;

pub use compared::CompareJson;
pub use diagnosed::{CauseJson, Diagnosed, DiagnosisJson, Unsought, diagnosed};
pub use fitted::FitJson;
pub use identified::{IdentifyJson, responses};
pub use replayed::{AdviceJson, LastJson, LimitsJson, Replayed, replayed, warning};
