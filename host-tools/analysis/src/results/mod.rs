//! What a run comes to, as the program prints it and other programs get it.

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
