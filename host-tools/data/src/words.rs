//! Numbers, intervals, counts and times in words.

use std::borrow::Cow;

use chrono::{DateTime, SecondsFormat};

/// One line of text that a terminal shows as it is, whoever wrote it: control characters and those that turn the writing
/// direction stand as the escapes of JSON, so JSON stays what it was.
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.contains(is_unprintable) {
        return text.into();
    }
    let mut out = String::with_capacity(text.len() + 16);
    for letter in text.chars() {
        match letter {
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            '\t' => out.push_str("\\t"),
            letter if is_unprintable(letter) => out.push_str(&format!("\\u{:04x}", u32::from(letter))),
            letter => out.push(letter),
        }
    }
    out.into()
}

/// The beginning of a text that may be of any length, for a message.
pub fn shortened(text: &str) -> Cow<'_, str> {
    match text.char_indices().nth(200) {
        Some((end, _)) => format!("{}...", text.get(..end).unwrap_or_default()).into(),
        None => text.into(),
    }
}

/// Control characters; marks, embeddings, overrides and isolates of the writing direction; line and paragraph separators.
fn is_unprintable(letter: char) -> bool {
    letter.is_control()
        || matches!(letter, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// A value with its interval, both with the digits that the interval bears.
pub fn interval_text(value: f64, u95: f64) -> String {
    if !(u95.is_finite() && u95 > 0.0) {
        return format!("{value:.4}");
    }
    format!("{} ± {}", rounded_text(value, u95), rounded_text(u95, u95))
}

/// A number with the digits that an interval bears, which is above 0: two of its own.
pub fn rounded_text(value: f64, u95: f64) -> String {
    let digits = (1.0 - u95.log10().floor()).min(9.0);
    let unit = 10f64.powf(-digits);
    let decimals = digits.max(0.0) as usize;
    // What is left of the point is rounded too.
    let value = if unit > 1.0 { (value / unit).round() * unit } else { value };
    format!("{value:.decimals$}")
}

/// Number of things with the right ending.
pub fn plural(count: u64, thing: &str) -> String {
    format!("{count} {thing}{}", if count == 1 { "" } else { "s" })
}

/// `12.3 s`, `4 min 5 s`.
pub fn duration_text(seconds: f64) -> String {
    if seconds < 120.0 {
        return format!("{seconds:.1} s");
    }
    let seconds = seconds.round();
    format!("{:.0} min {:.0} s", (seconds / 60.0).floor(), seconds % 60.0)
}

/// A host time \[ns since 1970\] for a person.
pub fn utc(time_ns: u64) -> String {
    let time = DateTime::from_timestamp_nanos(time_ns.min(i64::MAX as u64) as i64);
    time.to_rfc3339_opts(SecondsFormat::Millis, true)
}

/// The name among `candidates` that `name` was probably meant to be.
pub fn nearest<'a>(name: &str, candidates: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let wanted = name.to_lowercase().replace(['-', ' '], "_");
    let score = |candidate: &str| {
        let contained = wanted.len() >= 4 && (candidate.contains(&wanted) || wanted.contains(candidate));
        strsim::jaro_winkler(&wanted, &candidate.to_lowercase()) + if contained { 0.2 } else { 0.0 }
    };
    candidates
        .map(|candidate| (score(candidate), candidate))
        .filter(|(score, _)| *score > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}
