//! Numbers, intervals, counts and times as text.

use std::{borrow::Cow, ops::RangeInclusive};

use chrono::{DateTime, SecondsFormat};
use serde::Serialize;

/// One line of text that is safe to print on a terminal, wherever it comes from: control characters, bidirectional
/// controls and invisible characters become JSON escapes, so that JSON keeps its meaning.
pub fn printable(text: &str) -> Cow<'_, str> {
    escaped(text, is_unprintable)
}

/// A page or a figure that is safe to show, wherever its texts come from: the same as [`printable`], but line breaks
/// stay.
pub fn printable_lines(text: &str) -> Cow<'_, str> {
    escaped(text, |letter| letter != '\n' && is_unprintable(letter))
}

/// The text with these characters as JSON escapes.
fn escaped(text: &str, is_hidden: fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(is_hidden) {
        return text.into();
    }
    let mut out = String::with_capacity(text.len() + 16);
    for letter in text.chars() {
        match letter {
            letter if !is_hidden(letter) => out.push(letter),
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            '\t' => out.push_str("\\t"),
            letter => {
                // JSON writes characters beyond 16 bits as two escapes.
                for unit in letter.encode_utf16(&mut [0; 2]) {
                    out.push_str(&format!("\\u{unit:04x}"));
                }
            }
        }
    }
    out.into()
}

/// A text as a string of a TOML file, with everything that [`printable`] escapes as escapes of TOML.
pub fn toml_text(text: &str) -> String {
    let escaped = |letter: char| match letter {
        '"' | '\\' => format!("\\{letter}"),
        letter if is_unprintable(letter) => match u32::from(letter) {
            code @ ..=0xFFFF => format!("\\u{code:04x}"),
            code => format!("\\U{code:08x}"),
        },
        letter => letter.into(),
    };
    format!("\"{}\"", text.chars().map(escaped).collect::<String>())
}

/// Spreadsheets take a cell that begins like this for a formula, the wide forms in some languages.
const FORMULAS: [char; 8] = ['=', '+', '-', '@', '＝', '＋', '－', '＠'];

/// A text as a cell of a CSV that spreadsheets open: [`printable`], with a `'` before what would be a formula. Some
/// spreadsheets also separate cells at semicolons. Numbers do not need it, and would become texts.
pub fn csv_text(text: &str) -> Cow<'_, str> {
    let shown = printable(text);
    // A quote in a cell may begin the next one where semicolons separate cells.
    let is_formula = |cell: &str| cell.trim_start_matches('"').starts_with(FORMULAS);
    if !shown.split(';').any(is_formula) {
        return shown;
    }
    let quoted = |cell| if is_formula(cell) { format!("'{cell}") } else { cell.to_string() };
    shown.split(';').map(quoted).collect::<Vec<_>>().join(";").into()
}

/// The beginning of a text of any length, for part of a message.
pub fn shortened(text: &str) -> Cow<'_, str> {
    shortened_to(200, text)
}

/// At most this many characters of a text.
pub fn shortened_to(letters: usize, text: &str) -> Cow<'_, str> {
    match text.char_indices().nth(letters) {
        Some((end, _)) => format!("{}...", text.get(..end).unwrap_or_default()).into(),
        None => text.into(),
    }
}

/// Characters without a visible glyph: controls, formats (zero width, writing direction, tags), separators, private
/// use, fillers and blanks.
fn is_unprintable(letter: char) -> bool {
    if letter.is_ascii() {
        return letter.is_control();
    }
    // The standard library knows the others, but also escapes accents unless a letter precedes them.
    UNSEEN.iter().any(|range| range.contains(&letter))
        || ['a', letter].iter().collect::<String>().escape_debug().count() > 2
}

/// Characters that are drawn as nothing, some of which count as letters, accents or symbols.
const UNSEEN: [RangeInclusive<char>; 21] = [
    // Unicode's Default_Ignorable_Code_Point (DerivedCoreProperties.txt).
    '\u{ad}'..='\u{ad}',
    '\u{34f}'..='\u{34f}',
    '\u{61c}'..='\u{61c}',
    '\u{115f}'..='\u{1160}',
    '\u{17b4}'..='\u{17b5}',
    '\u{180b}'..='\u{180f}',
    '\u{200b}'..='\u{200f}',
    '\u{202a}'..='\u{202e}',
    '\u{2060}'..='\u{206f}',
    '\u{3164}'..='\u{3164}',
    '\u{fe00}'..='\u{fe0f}',
    '\u{feff}'..='\u{feff}',
    '\u{ffa0}'..='\u{ffa0}',
    '\u{fff0}'..='\u{fff8}',
    '\u{1bca0}'..='\u{1bca3}',
    '\u{1d173}'..='\u{1d17a}',
    '\u{e0000}'..='\u{e0fff}',
    // Others whose glyph is empty: blanks of Braille and hieroglyphs, a note without a head, a filler.
    '\u{2800}'..='\u{2800}',
    '\u{13441}'..='\u{13442}',
    '\u{16fe4}'..='\u{16fe4}',
    '\u{1d159}'..='\u{1d159}',
];

/// Smaller numbers are written with an exponent.
const TINY: f64 = 1e-5;

/// A value with its interval, both with the digits that the interval justifies.
pub fn interval_text(value: f64, u95: f64) -> String {
    if !(u95.is_finite() && u95 > 0.0) {
        return amount_text(value, 4);
    }
    if u95 >= TINY || !value.is_finite() {
        return format!("{} ± {}", rounded_text(value, u95), rounded_text(u95, u95));
    }
    let exponent = value.abs().max(u95).log10().floor();
    let parts = [value, u95].map(|part| rounded_text(part / 10f64.powf(exponent), u95 / 10f64.powf(exponent)));
    format!("({})e{exponent}", parts.join(" ± "))
}

/// A number with the digits that an interval above 0 justifies: two significant digits of the interval.
pub fn rounded_text(value: f64, u95: f64) -> String {
    let digits = 1.0 - u95.log10().floor();
    if u95 < TINY && value.is_finite() {
        let more = if value == 0.0 { 0.0 } else { value.abs().log10().floor() + digits };
        return format!("{value:.*e}", more.clamp(1.0, 9.0) as usize);
    }
    let digits = digits.min(9.0);
    let unit = 10f64.powf(-digits);
    let decimals = digits.max(0.0) as usize;
    // Digits before the point are rounded too.
    let value = if unit > 1.0 { (value / unit).round() * unit } else { value };
    format!("{value:.decimals$}")
}

/// A number with three significant digits, however small or large: `0.00207`, `12.3`, `3.14e-7`.
pub fn three_digits(value: f64) -> String {
    if !value.is_finite() || value == 0.0 {
        return format!("{value}");
    }
    match value.abs().log10().floor() {
        exponent if (-4.0..6.0).contains(&exponent) => format!("{value:.*}", (2.0 - exponent).max(0.0) as usize),
        _ => format!("{value:.2e}"),
    }
}

/// A list of words: `mt, cf and fc`.
pub fn listed(words: &[String]) -> String {
    match words {
        [] => String::new(),
        [only] => only.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

/// A number with this many decimals, or as many more as its first two digits need: machines of 2e-4 kg m² have forces
/// of 0.03 N m.
pub fn amount_text(value: f64, decimals: usize) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value:.decimals$}");
    }
    if value.abs() < TINY {
        return format!("{value:.1e}");
    }
    let needed = 1.0 - value.abs().log10().floor();
    format!("{value:.*}", (needed as usize).max(decimals))
}

/// The name of a value for programs: `not_identifiable` for `NotIdentifiable`.
pub fn code(value: &impl Serialize) -> String {
    let name = serde_json::to_value(value).unwrap_or_default();
    snake_case(name.as_str().unwrap_or_default())
}

pub(crate) fn snake_case(name: &str) -> String {
    let mut text = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !text.is_empty() {
            text.push('_');
        }
        text.extend(letter.to_lowercase());
    }
    text
}

/// A unit after a name: ` [N]`; empty for a plain number.
pub(crate) fn bracketed(unit: &str) -> String {
    if unit.is_empty() { String::new() } else { format!(" [{unit}]") }
}

/// A count of things with the right plural.
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

/// The message that no parameter has this name, with the likely one among `known`.
pub(crate) fn no_parameter<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> String {
    let hint = nearest(name, known).map(|near| format!("; did you mean `{near}`?")).unwrap_or_default();
    format!("no parameter is called `{name}`{hint}")
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn three_digits_of_any_size() {
        let cases = [
            (0.0, "0"),
            (0.00207, "0.00207"),
            (12.345, "12.3"),
            (-299.4906, "-299"),
            (1234.5, "1234"),
            (3.14e-7, "3.14e-7"),
        ];
        for (value, text) in cases.into_iter().chain([(f64::INFINITY, "inf"), (9.999, "10.00")]) {
            assert_eq!(three_digits(value), text);
        }
        assert_eq!(listed(&["a", "b", "c"].map(str::to_string)), "a, b and c");
    }

    #[test]
    fn a_duration_is_rounded_before_it_is_parted() {
        for (seconds, text) in
            [(119.94, "119.9 s"), (120.0, "2 min 0 s"), (1199.7, "20 min 0 s"), (3605.4, "60 min 5 s")]
        {
            assert_eq!(duration_text(seconds), text);
        }
    }

    #[test]
    fn what_nobody_sees_is_escaped_and_what_is_written_anywhere_is_not() {
        let seen = "Prüfstand 3 µm ± 2 °C, \"a\\b\", ひずみ, e\u{301}, 🛠";
        assert_eq!(printable(seen), seen);
        for hidden in
            "\0\u{7f}\u{9b}\u{a0}\u{ad}\u{61c}\u{200b}\u{200d}\u{202e}\u{2060}\u{feff}\u{e0041}\u{f8ff}".chars()
        {
            assert!(printable(&hidden.to_string()).is_ascii(), "{hidden:?}");
        }
    }

    #[test]
    fn what_is_drawn_as_nothing_is_escaped_though_it_counts_as_a_letter_or_an_accent() {
        // Fillers and blanks, and what selects or joins glyphs.
        let fillers = "\u{115f}\u{1160}\u{17b4}\u{17b5}\u{2800}\u{3164}\u{ffa0}\u{13441}\u{13442}\u{16fe4}\u{1d159}";
        let joiner = "\u{34f}";
        let selectors = ['\u{180b}'..='\u{180f}', '\u{fe00}'..='\u{fe0f}', '\u{e0000}'..='\u{e01ef}'];
        for hidden in fillers.chars().chain(joiner.chars()).chain(selectors.into_iter().flatten()) {
            let shown = printable(&format!("a{hidden}b")).into_owned();
            assert!(shown.is_ascii() && shown.len() > 7, "{hidden:?}: {shown}");
        }
        assert_eq!(printable("a\u{3164}\u{e0100}"), r"a\u3164\udb40\udd00");
        // Neighbours that are seen.
        for seen in ["\u{10fc}\u{1100}\u{1161}", "\u{17b3}\u{17b6}", "\u{2801}", "\u{3163}", "a\u{34e}\u{350}"] {
            assert_eq!(printable(seen), seen);
        }
    }

    #[test]
    fn lines_keep_their_breaks_and_nothing_else_that_is_not_seen() {
        let seen = "<p>3 µm\n\ne\u{301}</p>\n";
        assert_eq!(printable_lines(seen), seen);
        assert_eq!(printable_lines("a\r\n\tb\u{202e}\u{1b}\n"), "a\\r\n\\tb\\u202e\\u001b\n");
    }

    #[test]
    fn no_cell_is_a_formula_and_other_cells_stay() {
        for (text, cell) in [
            ("=1+1", "'=1+1"),
            ("+1", "'+1"),
            ("-1", "'-1"),
            ("@SUM(1)", "'@SUM(1)"),
            ("＝1+1", "'＝1+1"),
            ("a;=1;-2; b", "a;'=1;'-2; b"),
            ("a;\"=1", "a;'\"=1"),
            ("\t=1", r"\t=1"),
            ("\r\n=1", r"\r\n=1"),
            ("a\nforged", r"a\nforged"),
            ("=\u{202e}", r"'=\u202e"),
            ("", ""),
            ("holds", "holds"),
            ("a - b", "a - b"),
        ] {
            assert_eq!(csv_text(text), cell, "{text:?}");
        }
    }

    /// Any characters; a `String` of proptest has no control characters.
    fn text() -> impl Strategy<Value = String> {
        prop::collection::vec(any::<char>(), 0..40).prop_map(String::from_iter)
    }

    proptest! {
        #[test]
        fn toml_reads_back_and_can_be_shown(text in text()) {
            let line = format!("text = {}", toml_text(&text));
            prop_assert_eq!(printable(&line), line.as_str());
            let read: toml::Table = toml::from_str(&line).unwrap();
            prop_assert_eq!(read["text"].as_str(), Some(text.as_str()));
        }

        #[test]
        fn json_stays_what_it_was(text in text()) {
            let json = serde_json::to_string(&text).unwrap();
            prop_assert_eq!(serde_json::from_str::<String>(&printable(&json)).unwrap(), text);
        }
    }
}
