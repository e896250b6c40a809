//! Where the files of a run lie.

use inerter_data::{export::Source, words::utc};

/// What a store holds of a run beside its recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Table {
    Estimates,
    Reversals,
    Events,
    Runs,
}

impl Table {
    pub(crate) const ALL: [Self; 4] = [Self::Estimates, Self::Reversals, Self::Events, Self::Runs];

    /// Its folder.
    pub(crate) const fn folder(self) -> &'static str {
        match self {
            Self::Estimates => "estimates",
            Self::Reversals => "reversals",
            Self::Events => "events",
            Self::Runs => "runs",
        }
    }
}

/// The place of a run: the same part of the name in each folder of the store.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Place {
    pub device: String,
    pub date: String,
    /// SHA-256 of the recording.
    pub run: String,
}

impl Place {
    pub(crate) fn of(source: &Source, run: String) -> Self {
        let serial = source.device.as_ref().and_then(|device| device.get("serial")).map_or("unknown", String::as_str);
        let date = utc(source.first_ns).chars().take("2026-01-01".len()).collect();
        Self { device: as_part(serial), date, run }
    }

    /// Reads the place back from the name of a file in one of the folders.
    pub(crate) fn parse(name: &str) -> Option<Self> {
        let mut parts = name.split('/').skip(1);
        let device = parts.next()?.strip_prefix("device=")?.to_owned();
        let date = parts.next()?.strip_prefix("date=")?.to_owned();
        let run = parts.next()?.split('.').next()?.to_owned();
        let is_sum = run.len() == 64 && run.bytes().all(|letter| letter.is_ascii_hexdigit());
        (is_sum && parts.next().is_none()).then_some(Self { device, date, run })
    }

    pub(crate) fn table(&self, table: Table) -> String {
        self.file(table.folder(), "parquet")
    }

    pub(crate) fn recording(&self) -> String {
        self.file("recordings", "mcap")
    }

    pub(crate) fn sums(&self) -> String {
        self.file("sums", "sha256")
    }

    fn file(&self, folder: &str, extension: &str) -> String {
        format!("{folder}/device={}/date={}/{}.{extension}", self.device, self.date, self.run)
    }
}

/// A serial number as a part of a file's name: it comes from outside, and may hold anything.
fn as_part(serial: &str) -> String {
    let kept = |letter: char| if letter.is_ascii_alphanumeric() || "-_".contains(letter) { letter } else { '_' };
    let part: String = serial.chars().take(40).map(kept).collect();
    if part.is_empty() { "unknown".into() } else { part }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_read_back_from_each_of_its_files() {
        let place = Place { device: "SIM-1".into(), date: "2026-01-02".into(), run: "0a".repeat(32) };
        for name in [place.recording(), place.sums(), place.table(Table::Runs), place.table(Table::Events)] {
            assert_eq!(Place::parse(&name), Some(place.clone()), "{name}");
        }
        for stray in ["runs/device=a/date=b/notes.txt", "runs/readme", "runs/device=a/0a.parquet", ""] {
            assert_eq!(Place::parse(stray), None, "{stray}");
        }
    }

    #[test]
    fn a_serial_number_leads_nowhere_else() {
        for (serial, part) in [("../../etc", "______etc"), ("", "unknown"), ("A1-b_2", "A1-b_2"), ("é=/\n", "____")] {
            assert_eq!(as_part(serial), part);
        }
    }
}
