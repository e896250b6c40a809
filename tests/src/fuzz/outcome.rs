//! A reply in the words of the corpus; the twin includes this file, as it may not use this crate.

use inerter_wire::{Done, Refusal};

/// A reply in words that do not depend on time.
pub fn outcome(result: &Result<Done, Refusal>) -> String {
    match result {
        Ok(Done::Plain) => "done".into(),
        Ok(Done::Injected { .. }) => "injected".into(),
        Ok(Done::Played { .. }) => "played".into(),
        Err(Refusal::QueueFull { .. }) => "refused QueueFull".into(),
        Err(Refusal::Worn { .. }) => "refused Worn".into(),
        Err(refusal) => format!("refused {refusal:?}"),
    }
}
