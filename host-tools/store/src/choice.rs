//! Selects runs of a store.

use std::{cmp::Ordering, str::FromStr};

use inerter_data::words::nearest;
use serde_json::Value;

use crate::{
    error::StoreError,
    place::{Place, as_part},
    row::Row,
};

/// A selection of runs; by default all.
#[derive(Clone, Debug, Default)]
pub struct Choice {
    /// Only of this device, by its serial number.
    pub device: Option<String>,
    /// From this day on.
    pub from: Option<Day>,
    /// Up to and including this day.
    pub to: Option<Day>,
    /// Conditions on columns; all must hold.
    pub conditions: Vec<Condition>,
}

/// A day, a month or a year in UTC: `2026-01-31`, `2026-01` or `2026`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Day(String);

impl FromStr for Day {
    type Err = StoreError;

    fn from_str(text: &str) -> Result<Self, StoreError> {
        let is_number = |part: &str, digits: usize, most: u32| {
            part.len() == digits
                && part.bytes().all(|digit| digit.is_ascii_digit())
                && part.parse().is_ok_and(|number: u32| (1..=most).contains(&number))
        };
        let parts: Vec<&str> = text.split('-').collect();
        let limits = [(4, 9999), (2, 12), (2, 31)];
        let are_numbers = parts.iter().zip(limits).all(|(part, (digits, most))| is_number(part, digits, most));
        if parts.len() <= limits.len() && are_numbers {
            return Ok(Self(text.into()));
        }
        Err(StoreError::Condition {
            condition: text.into(),
            problem: "it is not a day".into(),
            help: "write it as 2026-01-31, or 2026-01 for a month".into(),
        })
    }
}

/// A condition on a column: `inertance_kg < 300`.
#[derive(Clone, Debug)]
pub struct Condition {
    text: String,
    column: String,
    relation: Relation,
    value: String,
}

/// How it is written, and whether an order fulfils it.
type Relation = (&'static str, fn(Ordering) -> bool);

/// A longer one comes before a shorter one with the same beginning.
const RELATIONS: [Relation; 7] = [
    ("<=", Ordering::is_le),
    (">=", Ordering::is_ge),
    ("!=", Ordering::is_ne),
    ("==", Ordering::is_eq),
    ("<", Ordering::is_lt),
    (">", Ordering::is_gt),
    ("=", Ordering::is_eq),
];

/// Texts that can be ordered.
const TIMES: [&str; 2] = ["date", "recorded_utc"];

impl FromStr for Condition {
    type Err = StoreError;

    fn from_str(text: &str) -> Result<Self, StoreError> {
        let refused = |problem: &str| refused(text, problem, String::new());
        let place = text.find(['<', '>', '=', '!']).ok_or_else(|| refused("it has no comparison"))?;
        let (column, rest) = text.split_at(place);
        let known = RELATIONS.iter().find_map(|relation| Some((*relation, rest.strip_prefix(relation.0)?)));
        let (relation, value) = known.ok_or_else(|| refused("it has no comparison"))?;
        let (column, value) = (column.trim(), value.trim());
        let quoted = ['\'', '"'].iter().find_map(|mark| value.strip_prefix(*mark)?.strip_suffix(*mark));
        if value.starts_with(['<', '>', '=', '!']) && quoted.is_none() {
            return Err(refused("it has two comparisons"));
        }
        let value = quoted.unwrap_or(value);
        if column.is_empty() || value.is_empty() && quoted.is_none() {
            return Err(refused("one side of it is empty"));
        }
        Ok(Self { text: text.into(), column: column.into(), relation, value: value.into() })
    }
}

fn refused(condition: &str, problem: &str, more: String) -> StoreError {
    StoreError::Condition {
        condition: condition.into(),
        problem: problem.into(),
        help: format!("{more}write a column, one of < <= > >= = !=, and a number or a word: \"inertance_kg < 300\""),
    }
}

impl Condition {
    /// Rejects a column that no run has. Not every run has every column: a rotary machine has others.
    pub(crate) fn check(&self, rows: &[Row]) -> Result<(), StoreError> {
        if rows.is_empty() || rows.iter().any(|row| row.columns().any(|name| name == self.column)) {
            return Ok(());
        }
        let nearest = nearest(&self.column, rows.iter().flat_map(Row::columns));
        let more = nearest.map(|name| format!("did you mean {name}? ")).unwrap_or_default();
        Err(refused(&self.text, "no run has such a column", more))
    }

    /// Whether a row meets the condition. An unknown value does not: it is neither equal nor unequal.
    pub(crate) fn holds(&self, row: &Row) -> Result<bool, StoreError> {
        let Some(found) = row.get(&self.column) else { return Ok(false) };
        let (sign, is_met) = self.relation;
        let is_order = sign.starts_with(['<', '>']);
        let is_time = TIMES.contains(&self.column.as_str());
        let order = match found {
            Value::Number(number) => {
                let value = self.value.parse().ok().filter(|value: &f64| value.is_finite());
                let value = value.ok_or_else(|| refused(&self.text, "the column holds numbers", String::new()))?;
                number.as_f64().and_then(|number| number.partial_cmp(&value))
            }
            Value::String(_) if is_order && !is_time => {
                return Err(refused(&self.text, "the column holds text: use = or !=", String::new()));
            }
            Value::String(_) if is_order && self.value.get(..4).is_none_or(|year| year.parse::<u32>().is_err()) => {
                return Err(refused(&self.text, "the column holds times such as 2026-01-31", String::new()));
            }
            // A day includes all its times, a month all its days.
            Value::String(text) if is_time => {
                Some(text.get(..self.value.len()).unwrap_or(&text).cmp(self.value.as_str()))
            }
            Value::String(text) => Some(text.as_str().cmp(self.value.as_str())),
            _ => return Err(refused(&self.text, "the column holds objects, which DuckDB can query", String::new())),
        };
        Ok(order.is_some_and(is_met))
    }
}

impl Choice {
    /// Whether the place alone allows the run to be selected.
    pub(crate) fn may_be(&self, place: &Place) -> bool {
        let date = place.date.as_str();
        self.device.as_ref().is_none_or(|device| as_part(device) == place.device)
            && self.from.as_ref().is_none_or(|Day(from)| date >= from.as_str())
            // All days of a month begin with its text.
            && self.to.as_ref().is_none_or(|Day(to)| date <= to.as_str() || date.starts_with(to.as_str()))
    }

    /// Whether a row meets all conditions.
    pub(crate) fn is(&self, row: &Row) -> Result<bool, StoreError> {
        self.conditions.iter().try_fold(true, |all, condition| Ok(condition.holds(row)? && all))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn row() -> Row {
        let values = json!({"run": "00", "inertance_kg": 299.5, "viscous_n_s_per_m": null, "law": "holds", "samples": 20,
            "settings": {}, "causes": "", "recorded_utc": "2026-03-04T05:06:07.000Z"});
        let place = Place { device: "SIM-1".into(), date: "2026-03-04".into(), run: "00".into() };
        Row { place, values: values.as_object().unwrap().clone() }
    }

    fn met(text: &str) -> Result<bool, StoreError> {
        let condition = text.parse::<Condition>()?;
        condition.check(&[row()])?;
        condition.holds(&row())
    }

    #[test]
    fn conditions_compare_numbers_and_words() {
        let cases = [
            ("inertance_kg < 300", true),
            ("inertance_kg<=299.5", true),
            ("inertance_kg > 299.5", false),
            ("samples >= 20", true),
            ("samples != 20", false),
            ("samples == 2e1", true),
            ("law = holds", true),
            ("law = 'holds'", true),
            ("law != broken", true),
            ("device = SIM-2", false),
            ("date > 2026-01-01", true),
            ("date <= 2026-03", true),
            ("date > 2026-03", false),
            ("date = 2026", true),
            ("causes = ''", true),
            ("recorded_utc < 2026-03-04T05:00", false),
            ("viscous_n_s_per_m < 1", false),
            ("viscous_n_s_per_m != 1", false),
        ];
        for (text, expected) in cases {
            assert_eq!(met(text).unwrap(), expected, "{text}");
        }
    }

    #[test]
    fn what_is_no_condition_is_refused_with_what_to_do() {
        let wrong = ["inertance_kg", "< 3", "inertance_kg <", "law < holds", "a ! b", "inertance_kg < NaN"];
        let misread =
            ["inertance_kg => 3", "inertance_kg =< 3", "inertance_kg = abc", "date < yesterday", "settings = 1"];
        for text in wrong.iter().chain(&misread) {
            assert!(met(text).is_err(), "{text}");
        }
        let error = met("inertance < 3").unwrap_err();
        assert!(miette::Diagnostic::help(&error).unwrap().to_string().contains("did you mean inertance_kg?"));
    }

    #[test]
    fn days_and_months_bound_a_choice() {
        let may_be = |from: Option<&str>, to: Option<&str>| {
            let day = |text: &str| text.parse().unwrap();
            Choice { from: from.map(day), to: to.map(day), ..Choice::default() }.may_be(&row().place)
        };
        assert!(may_be(None, None) && may_be(Some("2026-03-04"), Some("2026-03-04")));
        assert!(may_be(Some("2026-03"), Some("2026-03")) && may_be(None, Some("2026")));
        assert!(
            !may_be(Some("2026-03-05"), None) && !may_be(None, Some("2026-03-03")) && !may_be(None, Some("2026-02"))
        );
        assert!(!Choice { device: Some("SIM-2".into()), ..Choice::default() }.may_be(&row().place));
        for text in ["yesterday", "2026-99-99", "2026-1-2", "26", "2026-01-31x", "2026-01-01-01", ""] {
            assert!(text.parse::<Day>().is_err(), "{text}");
        }
    }
}
