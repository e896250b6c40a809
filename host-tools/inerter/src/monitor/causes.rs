//! Names what violates the law while a device is monitored: a separate thread searches the latest samples.

use std::thread::{self, JoinHandle};

use inerter_analysis::diagnose::{Cause, Kind, Latest, is_suspect};
use inerter_core::{Law, Machine, Published, RawSample, Settings};
use inerter_wire::EventKind;

use super::feed::Item;

/// Motion required before the first search, and between two searches \[s\].
const LEAST_S: f64 = 10.0;

/// The search in progress, and the latest findings.
pub struct Causes {
    latest: Latest,
    search: Option<JoinHandle<Vec<Cause>>>,
    /// When the next search may begin \[s\].
    next_s: f64,
    told: Vec<Kind>,
}

/// Describes a cause for a person.
pub fn words(machine: Machine, cause: &Cause) -> String {
    format!("the law does not hold: {}", cause.sentence(machine))
}

impl Default for Causes {
    fn default() -> Self {
        Self::of(&Settings::default())
    }
}

impl Causes {
    /// State for a device with these settings, with no search yet.
    fn of(settings: &Settings) -> Self {
        Self { latest: Latest::new(settings), search: None, next_s: f64::NEG_INFINITY, told: Vec::new() }
    }

    /// Takes the next sample.
    pub fn sample(&mut self, sample: RawSample) {
        self.latest.push(sample);
    }

    /// What this item adds.
    pub fn look(&mut self, item: &Item) -> Vec<Item> {
        match item {
            Item::Device { settings, .. } | Item::Settings(settings) => *self = Self::of(settings),
            Item::Event { event, .. } => {
                if matches!(event.kind, EventKind::Changed(_) | EventKind::EstimatorReset | EventKind::Started) {
                    self.latest.forget();
                    (self.search, self.told) = (None, Vec::new());
                }
                if let EventKind::Warned(warning) = event.kind {
                    self.latest.warn(warning);
                }
            }
            Item::Estimate { at, t_s, estimated } => {
                let law = estimated.law.unwrap_or_default();
                let index = estimated.estimate.index;
                let found = self.found(&law).into_iter();
                let new = found.map(|cause| Item::Cause { at: *at, t_s: *t_s, index, cause }).collect();
                let may = self.search.is_none() && at.run_s >= self.next_s && self.latest.duration_s() >= LEAST_S;
                if may && is_suspect(&law) {
                    let (estimate, detail) = (estimated.estimate, estimated.detail.unwrap_or_default());
                    let latest = self.latest.clone();
                    let causes = move || latest.suspected(&Published { estimate, detail, law });
                    self.search = thread::Builder::new().name("causes".into()).spawn(causes).ok();
                    self.next_s = at.run_s + LEAST_S;
                }
                return new;
            }
            _ => {}
        }
        Vec::new()
    }

    /// New findings of a search that has ended.
    fn found(&mut self, law: &Law) -> Vec<Cause> {
        let Some(search) = self.search.take_if(|search| search.is_finished()) else { return Vec::new() };
        let found = if is_suspect(law) { search.join().unwrap_or_default() } else { Vec::new() };
        let before = std::mem::replace(&mut self.told, found.iter().map(|cause| cause.kind).collect());
        found.into_iter().filter(|cause| !before.contains(&cause.kind)).collect()
    }
}
