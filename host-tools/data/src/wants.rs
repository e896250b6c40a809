//! Wanted intervals: `fc to 0.3 N, mt to 0.1 %`.

use inerter_core::Machine;
use inerter_wire::catalogue::{self, Field, Group};
use miette::Diagnostic;

use crate::words::no_parameter;

/// The wanted intervals are written incorrectly.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[error("--want, at `{part}`: {problem}")]
#[diagnostic(
    code(inerter::want),
    help(
        "write \"fc to 0.3 N, mt to 0.1 %\": {known}, each with an interval in its own unit or in % of the expected value"
    )
)]
pub struct WantError {
    /// The part of the text that is wrong.
    pub part: String,
    /// What is wrong with it.
    pub problem: String,
    /// The parameters that can be wanted, with their units.
    known: String,
}

/// One parameter, and the half width of the 95 % interval that is wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Want {
    /// Index into `[mt, cf, fc, F0]`.
    pub place: usize,
    /// Half width \[its unit\].
    pub u95: f64,
}

/// Parses wanted intervals; `values` are the expected parameters, for percentages of them.
///
/// Of two wants for the same parameter the narrower one counts.
pub fn parse(text: &str, machine: Machine, values: [f64; 4]) -> Result<Vec<Want>, WantError> {
    let fields: Vec<&Field> = catalogue::fields(machine, Group::Parameter).collect();
    let wrong = |part: &str, problem: String| {
        let known: Vec<String> = fields.iter().map(|field| format!("{} [{}]", field.symbol, field.unit)).collect();
        WantError { part: part.into(), problem, known: known.join(", ") }
    };
    let mut wants: Vec<Want> = Vec::new();
    for part in text.split([',', ';']).map(str::trim) {
        let Some((name, wanted)) = part.split_once(" to ") else {
            return Err(wrong(part, "it is not NAME to NUMBER UNIT".into()));
        };
        let name = name.trim();
        let is_named = |field: &&Field| {
            [field.symbol, field.path, field.label].iter().any(|known| known.eq_ignore_ascii_case(name))
        };
        let place = fields.iter().position(is_named).ok_or_else(|| {
            wrong(part, no_parameter(name, fields.iter().flat_map(|field| [field.path, field.label])))
        })?;
        let field = fields.get(place).copied().unwrap_or(&catalogue::FIELDS[0]);
        let wanted = wanted.trim();
        let is_digit = |letter: char| letter.is_ascii_digit() || "+-.eE".contains(letter);
        let digits = match wanted.find(|letter| !is_digit(letter)) {
            Some(0) => wanted.find(char::is_whitespace),
            found => found,
        };
        let (number, unit) = wanted.split_at(digits.unwrap_or(wanted.len()));
        let number: f64 = number.parse().map_err(|_| wrong(part, format!("`{number}` is not a number")))?;
        if !(number.is_finite() && number > 0.0) {
            return Err(wrong(part, format!("{number} is not a finite number above 0")));
        }
        let value = values.get(place).copied().unwrap_or_default().abs();
        let u95 = match unit.trim() {
            "%" if value > 0.0 => 0.01 * number * value,
            "%" => return Err(wrong(part, format!("{} is expected to be 0: write its unit, not %", field.symbol))),
            given if same_unit(given, field.unit) => number,
            "" => return Err(wrong(part, format!("the unit is missing: {} or %", field.unit))),
            given => return Err(wrong(part, format!("the unit is {}, not `{given}`", field.unit))),
        };
        match wants.iter_mut().find(|want| want.place == place) {
            Some(want) => want.u95 = want.u95.min(u95),
            None => wants.push(Want { place, u95 }),
        }
    }
    Ok(wants)
}

/// Whether both are the same unit, however it is typed.
fn same_unit(given: &str, unit: &str) -> bool {
    let plain = |unit: &str| unit.replace('²', "2").replace('^', "").split_whitespace().collect::<Vec<_>>().join(" ");
    plain(given) == plain(unit)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const VALUES: [f64; 4] = [300.0, 30.0, 50.0, 0.0];

    fn wants(text: &str) -> Result<Vec<Want>, WantError> {
        parse(text, Machine::Linear, VALUES)
    }

    #[test]
    fn symbols_names_and_labels_are_understood_in_units_and_percents() {
        let wanted = [Want { place: 2, u95: 0.3 }, Want { place: 0, u95: 0.3 }];
        for text in
            ["fc to 0.3 N, mt to 0.1 %", "FC to 0.3N;inertance_kg to 0.3 kg", "Coulomb friction to 3e-1 N,mt to 0.1%"]
        {
            let found = wants(text).unwrap();
            assert!(
                found.iter().zip(wanted).all(|(a, b)| a.place == b.place && (a.u95 - b.u95).abs() < 1e-12),
                "{text}: {found:?}"
            );
        }
        assert_eq!(wants("cf to 2 N s/m, cf to 5 N s/m").unwrap(), [Want { place: 1, u95: 2.0 }]);
        let rotary =
            parse("mt to 1e-6 kg m2, cf to 1 N m s, fc to 10 %", Machine::Rotary, [1e-4, 1.0, 0.5, 0.0]).unwrap();
        assert_eq!(rotary.iter().map(|want| want.place).collect::<Vec<_>>(), [0, 1, 2]);
    }

    #[test]
    fn what_is_wrong_is_named_with_what_would_do() {
        for (text, says) in [
            ("", "it is not NAME to NUMBER UNIT"),
            ("fc 0.3 N", "it is not NAME to NUMBER UNIT"),
            ("fd to 0.3 N", "no parameter is called `fd`"),
            ("inertanc_kg to 1 kg", "did you mean `inertance_kg`?"),
            ("fc to zero N", "`zero` is not a number"),
            ("fc to NaN N", "NaN is not a finite number above 0"),
            ("fc to inf N", "inf is not a finite number above 0"),
            ("fc to -1 N", "-1 is not a finite number above 0"),
            ("fc to 0 N", "0 is not a finite number above 0"),
            ("fc to 1", "the unit is missing: N or %"),
            ("fc to 1 kg", "the unit is N, not `kg`"),
            ("F0 to 1 %", "expected to be 0"),
            ("fc to 1 N,", "it is not NAME to NUMBER UNIT"),
        ] {
            let error = wants(text).unwrap_err();
            assert!(error.to_string().contains(says), "{text}: {error}");
            assert!(error.help().unwrap().to_string().contains("mt [kg], cf [N s/m], fc [N], F0 [N]"), "{text}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_answered(text in any::<String>()) {
            wants(&text).ok();
        }
    }
}
