//! Where the files of a run are.

use inerter_data::{export::Source, words::utc};

/// Version of the layout and of the tables; later versions read it too. An added column or file does not change it; a
/// removed one, or another meaning, does.
pub const VERSION: u64 = 1;

/// The file that marks a folder as a store.
pub(crate) const MARK: &str = "inerter-store.json";

/// Its maximum length \[bytes\]: ours have some tens.
pub(crate) const LONGEST_MARK: usize = 4096;

/// Folder of further results.
pub(crate) const RESULTS: &str = "results";

/// Maximum length of a serial number in names.
const SERIAL: usize = 40;

/// A file that a store holds for a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Part {
    Recording,
    Estimates,
    Reversals,
    Events,
    /// Its row as JSON, which this program reads.
    Row,
    Sums,
    /// Its row as a table. Once it exists, the run exists.
    Run,
}

impl Part {
    /// In writing order.
    pub(crate) const ALL: [Self; 7] =
        [Self::Recording, Self::Estimates, Self::Reversals, Self::Events, Self::Row, Self::Sums, Self::Run];

    pub(crate) const fn folder(self) -> &'static str {
        match self {
            Self::Recording => "recordings",
            Self::Estimates => "estimates",
            Self::Reversals => "reversals",
            Self::Events => "events",
            Self::Row => "rows",
            Self::Sums => "sums",
            Self::Run => "runs",
        }
    }

    const fn extension(self) -> &'static str {
        match self {
            Self::Recording => "mcap",
            Self::Row => "json",
            Self::Sums => "sha256",
            Self::Estimates | Self::Reversals | Self::Events | Self::Run => "parquet",
        }
    }
}

/// The place of a run: the part of the name that is the same in each folder of the store.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    pub(crate) device: String,
    pub(crate) date: String,
    /// SHA-256 of the recording.
    pub(crate) run: String,
}

impl Place {
    pub(crate) fn of(source: &Source, run: String) -> Self {
        let date = utc(source.first_ns).chars().take("2026-01-01".len()).collect();
        Self { device: as_part(serial(source).unwrap_or_default()), date, run }
    }

    /// Parses the place from a file name, which must be exactly the name that this place has.
    pub(crate) fn parse(name: &str, part: Part) -> Option<Self> {
        Self::read(name, &format!("{}/", part.folder()), |place| place.file(part))
    }

    /// The same for a key.
    pub(crate) fn parse_key(key: &str) -> Option<Self> {
        Self::read(key, "", Self::key)
    }

    /// The part of the name that is the same everywhere: it finds a run without a search through all others.
    pub fn key(&self) -> String {
        format!("device={}/date={}/{}", self.device, self.date, self.run)
    }

    /// The same for a result.
    pub(crate) fn parse_result(name: &str, batch: &str) -> Option<Self> {
        Self::read(name, &format!("{RESULTS}/{batch}/"), |place| place.result(batch))
    }

    /// The place in a name with this beginning, if it has exactly this name by `named`.
    fn read(name: &str, beginning: &str, named: impl Fn(&Self) -> String) -> Option<Self> {
        let mut parts = name.strip_prefix(beginning)?.split('/');
        let device = parts.next()?.strip_prefix("device=")?.to_owned();
        let date = parts.next()?.strip_prefix("date=")?.to_owned();
        let run = parts.next()?.split('.').next()?.to_owned();
        let is_sum = run.len() == 64 && run.bytes().all(|letter| matches!(letter, b'0'..=b'9' | b'a'..=b'f'));
        Some(Self { device, date, run }).filter(|place| is_sum && named(place) == name)
    }

    pub(crate) fn file(&self, part: Part) -> String {
        format!("{}/{}.{}", part.folder(), self.key(), part.extension())
    }

    pub(crate) fn result(&self, batch: &str) -> String {
        format!("{RESULTS}/{batch}/{}.json", self.key())
    }

    /// SHA-256 of the recording: 64 hexadecimal digits.
    pub fn name(&self) -> &str {
        &self.run
    }
}

/// The device's serial number as it reports it.
pub(crate) fn serial(source: &Source) -> Option<&str> {
    source.device.as_ref()?.get("serial").map(String::as_str)
}

/// A serial number made safe for a file name: it comes from outside and may hold any characters.
pub(crate) fn as_part(serial: &str) -> String {
    let kept = |letter: char| if letter.is_ascii_alphanumeric() || "-_".contains(letter) { letter } else { '_' };
    let part: String = serial.chars().take(SERIAL).map(kept).collect();
    if part.is_empty() { "unknown".into() } else { part }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_read_back_from_each_of_its_files() {
        let place = Place { device: "SIM-1".into(), date: "2026-01-02".into(), run: "0a".repeat(32) };
        for part in Part::ALL {
            assert_eq!(Place::parse(&place.file(part), part), Some(place.clone()));
            assert_eq!(Place::parse(&format!("{}.bak", place.file(part)), part), None);
        }
        assert_eq!(Place::parse_result(&place.result("gain-2"), "gain-2"), Some(place.clone()));
        assert_eq!(Place::parse_key(&place.key()), Some(place.clone()));
        for stray in
            [place.name(), "device=a/date=b/0a", &format!("{}.parquet", place.key()), &format!("x/{}", place.key())]
        {
            assert_eq!(Place::parse_key(stray), None, "{stray}");
        }
        let shouted = place.file(Part::Run).replace("0a", "0A");
        for stray in ["runs/device=a/date=b/notes.txt", "runs/readme", "runs/device=a/0a.parquet", "", &shouted] {
            assert_eq!(Place::parse(stray, Part::Run), None, "{stray}");
        }
    }

    #[test]
    fn a_serial_number_leads_nowhere_else() {
        for (serial, part) in [("../../etc", "______etc"), ("", "unknown"), ("A1-b_2", "A1-b_2"), ("é=/\n", "____")] {
            assert_eq!(as_part(serial), part);
        }
    }
}
