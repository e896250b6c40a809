//! Data on a rig's calibration: when it was made, by which certificate, and how long it is valid.
//!
//! In a settings file it is the table `[calibration]`, in a recording the metadata `inerter.calibration`.

use std::{
    collections::BTreeMap,
    time::{SystemTime, UNIX_EPOCH},
};

use chrono::NaiveDate;
use toml::de::{DeTable, DeValue};

use crate::words::{printable, shortened_to, toml_text, utc};

/// Name of the table in a settings file.
pub const TABLE: &str = "calibration";
/// Maximum length of a certificate or note.
const LONGEST: usize = 120;

/// When and how a rig was calibrated.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Calibration {
    /// Day of the calibration.
    pub date: NaiveDate,
    /// Number of its certificate, or a note.
    pub certificate: Option<String>,
    /// Last day on which it is valid.
    pub expires: Option<NaiveDate>,
}

impl Calibration {
    /// From a TOML table: `date`, and `certificate` and `expires` if known. The error says what is wrong.
    pub(crate) fn of_table(table: &DeTable) -> Result<Self, String> {
        let mut texts = BTreeMap::new();
        for (key, value) in table {
            let text = match value.get_ref() {
                DeValue::String(text) => text.to_string(),
                DeValue::Datetime(date) => date.to_string(),
                _ => return Err(format!("`{}` is neither a date nor a text", key.get_ref())),
            };
            texts.insert(key.get_ref().to_string(), text);
        }
        Self::of_texts(&texts)
    }

    /// From the texts of a recording's metadata. The error says what is wrong.
    pub fn of_texts(texts: &BTreeMap<String, String>) -> Result<Self, String> {
        if let Some(unknown) = texts.keys().find(|key| !["date", "certificate", "expires"].contains(&key.as_str())) {
            return Err(format!("it has `date`, `certificate` and `expires`, not `{unknown}`"));
        }
        let day = |key: &str| {
            let parsed = |text: &String| {
                let day = NaiveDate::parse_from_str(text, "%Y-%m-%d").ok().filter(|day| day.to_string() == *text);
                day.ok_or_else(|| format!("{key}: `{text}` is not a day such as 2026-01-31"))
            };
            texts.get(key).map(parsed).transpose()
        };
        let date = day("date")?.ok_or("it has no `date`, such as 2026-01-31")?;
        let expires = day("expires")?;
        if expires.is_some_and(|expires| expires < date) {
            return Err("it expires before it was made".into());
        }
        let certificate = texts.get("certificate").filter(|text| !text.trim().is_empty()).cloned();
        if certificate.as_ref().is_some_and(|text| text.chars().count() > LONGEST) {
            return Err(format!("certificate: it has more than {LONGEST} letters"));
        }
        Ok(Self { date, certificate, expires })
    }

    /// For a recording's metadata.
    pub fn texts(&self) -> BTreeMap<String, String> {
        let certificate = self.certificate.clone().map(|text| ("certificate".to_string(), text));
        let expires = self.expires.map(|day| ("expires".to_string(), day.to_string()));
        [("date".to_string(), self.date.to_string())].into_iter().chain(certificate).chain(expires).collect()
    }

    /// As a table of a settings file.
    pub(crate) fn to_toml(&self) -> String {
        let line = |(name, text): (String, String)| format!("{name} = {}\n", toml_text(&text));
        format!("\n[{TABLE}]\n{}", self.texts().into_iter().map(line).collect::<String>())
    }

    /// The certificate as it may be shown.
    pub fn certificate_text(&self) -> Option<String> {
        self.certificate.as_ref().map(|text| shortened_to(LONGEST, &printable(text)).into_owned())
    }

    /// For a person: `2026-01-31, K-2031, valid until 2027-01-31`.
    pub fn words(&self) -> String {
        let valid = self.expires.map(|day| format!("valid until {day}"));
        let all: Vec<String> =
            [self.date.to_string()].into_iter().chain(self.certificate_text()).chain(valid).collect();
        all.join(", ")
    }

    /// What is wrong with it on this day \[ns since 1970\], or today.
    pub fn trouble(&self, time_ns: Option<u64>) -> Option<String> {
        let when = if time_ns.is_some() { "was recorded" } else { "is replayed" };
        let now = || SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
        let day = NaiveDate::parse_from_str(utc(time_ns.unwrap_or_else(now)).get(..10)?, "%Y-%m-%d").ok()?;
        let expires = self.expires.filter(|expires| day > *expires)?;
        let which = self.certificate_text().map(|text| format!(" ({text})")).unwrap_or_default();
        Some(format!("the calibration of {}{which} was valid until {expires}, and the run {when} on {day}", self.date))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(pairs: &[(&str, &str)]) -> Result<Calibration, String> {
        Calibration::of_texts(&pairs.iter().map(|(key, text)| (key.to_string(), text.to_string())).collect())
    }

    #[test]
    fn what_is_written_is_read_back() {
        for pairs in [
            &[("date", "2026-01-31")][..],
            &[("date", "2026-01-31"), ("certificate", "K-2031"), ("expires", "2027-01-31")],
        ] {
            let calibration = of(pairs).unwrap();
            assert_eq!(Calibration::of_texts(&calibration.texts()), Ok(calibration));
        }
    }

    #[test]
    fn what_is_no_calibration_is_told() {
        for (pairs, words) in [
            (&[][..], "no `date`"),
            (&[("date", "31.1.2026")], "`31.1.2026` is not a day"),
            (&[("date", "2026-02-30")], "`2026-02-30` is not a day"),
            (&[("date", "2026-01-31T10:00:00")], "is not a day"),
            (&[("date", "2026-01-31"), ("expires", "2025-01-31")], "before it was made"),
            (&[("date", "2026-01-31"), ("until", "2027-01-31")], "not `until`"),
        ] {
            let told = of(pairs).unwrap_err();
            assert!(told.contains(words), "{told}");
        }
        assert!(of(&[("date", "2026-01-31"), ("certificate", &"x".repeat(121))]).unwrap_err().contains("letters"));
    }

    #[test]
    fn a_calibration_holds_through_its_last_day() {
        let calibration =
            of(&[("date", "2026-01-31"), ("certificate", "K\u{1b}[2J"), ("expires", "2027-01-31")]).unwrap();
        // 2027-01-31T23:59:59Z and a second later.
        let last = 1_801_439_999_000_000_000;
        assert_eq!(calibration.trouble(Some(last)), None);
        let told = calibration.trouble(Some(last + 1_000_000_000)).unwrap();
        assert!(told.contains("was valid until 2027-01-31, and the run was recorded on 2027-02-01"), "{told}");
        assert!(!told.contains('\u{1b}') && !calibration.words().contains('\u{1b}'), "{told}");
        let old = of(&[("date", "2001-01-01"), ("expires", "2001-01-01")]).unwrap();
        assert!(old.trouble(None).unwrap().contains("the run is replayed on 20"));
        assert_eq!(of(&[("date", "2001-01-01")]).unwrap().trouble(None), None);
    }
}
