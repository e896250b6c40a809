//! A reply in the words of the corpus. The twin includes this file, because it must not depend on this crate.

use inerter_wire::{Done, Refusal};

/// A reply in words that do not depend on timing.
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
