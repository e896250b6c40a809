//! Further results of the runs of a store: batches, each named by the caller.

use serde_json::{Value, json};

use crate::{error::StoreError, place::Place};

/// Maximum length of a result as JSON \[bytes\]. Most have some tens of kilobytes; `identify` gives the response at
/// each frequency, and for a long recording at 5 kHz up to 10 MB.
pub(crate) const LONGEST_RESULT: usize = 16 << 20;

/// The outcome of one run in a batch.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The command: `replay`, `diagnose` or `identify`.
    pub kind: String,
    /// Its settings by name.
    pub given: Value,
    /// The output of the command with `--json`, or code and text of the error.
    pub result: Result<Value, (String, String)>,
}

impl Outcome {
    /// The stored form.
    pub(crate) fn json(&self, place: &Place) -> Value {
        let (result, error) = (self.result.as_ref().ok(), self.result.as_ref().err());
        json!({
            "run": place.name(), "kind": self.kind, "software": concat!("inerter ", env!("CARGO_PKG_VERSION")),
            "given": self.given, "code": error.map(|(code, _)| code), "error": error.map(|(_, text)| text), "result": result,
        })
    }
}

/// Checks the name of a batch, which becomes a folder.
pub(crate) fn checked(batch: &str) -> Result<&str, StoreError> {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "-_".contains(letter);
    let is_name = batch.chars().all(is_plain) && (1..=80).contains(&batch.len());
    if is_name { Ok(batch) } else { Err(StoreError::Batch { name: batch.into() }) }
}

/// A part of a store's runs, the same for every caller: part `number` of `of`, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    number: u64,
    of: u64,
}

impl Shard {
    /// Whether the run at this place belongs to it; a run added later does not move any other.
    pub fn has(self, place: &Place) -> bool {
        let beginning = place.name().get(..15).and_then(|digits| u64::from_str_radix(digits, 16).ok());
        beginning.unwrap_or_default() % self.of == self.number - 1
    }
}

impl std::str::FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/').and_then(|(number, of)| Some((number.parse().ok()?, of.parse().ok()?)));
        match parts {
            Some((number, of)) if (1..=of).contains(&number) => Ok(Self { number, of }),
            _ => Err("write it as 3/100: the third of a hundred parts".into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_run_is_in_one_shard_of_all() {
        for byte in 0..=255_u8 {
            let run = format!("{byte:02x}").repeat(32);
            let place = Place { device: "a".into(), date: "2026-01-02".into(), run };
            let shards = (1..=7).map(|number| format!("{number}/7").parse::<Shard>().unwrap());
            assert_eq!(shards.filter(|shard| shard.has(&place)).count(), 1);
        }
        for text in ["0/7", "8/7", "1", "1/0", "-1/7", "a/b", "1/7/2"] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
    }

    #[test]
    fn a_batch_is_named_by_letters_and_digits() {
        assert!(["gain-2", "a", "Replay_3"].iter().all(|name| checked(name).is_ok()));
        assert!(["", "..", "a/b", "a b", "é"].iter().all(|name| checked(name).is_err()));
    }
}
