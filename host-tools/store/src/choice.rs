//! Which runs of a store are meant.

use std::str::FromStr;

use inerter_data::words::nearest;
use serde_json::Value;

use crate::{error::StoreError, place::Place, row::Row};

/// Some of the runs; by default all.
#[derive(Clone, Debug, Default)]
pub struct Choice {
    /// Of this device alone.
    pub device: Option<String>,
    /// From this day on, `2026-01-31`, or `2026-01` for all of a month.
    pub from: Option<String>,
    /// To this day, which is among them.
    pub to: Option<String>,
    /// What their columns must be, each of it.
    pub conditions: Vec<Condition>,
}

/// What a column must be: `inertance_kg < 300`.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    column: String,
    relation: Relation,
    value: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Relation {
    Less,
    AtMost,
    More,
    AtLeast,
    Equal,
    Unequal,
}

/// How relations are written; of those that begin alike the longer one first.
const RELATIONS: [(&str, Relation); 6] = [
    ("<=", Relation::AtMost),
    (">=", Relation::AtLeast),
    ("!=", Relation::Unequal),
    ("<", Relation::Less),
    (">", Relation::More),
    ("=", Relation::Equal),
];

impl FromStr for Condition {
    type Err = StoreError;

    fn from_str(text: &str) -> Result<Self, StoreError> {
        let refused = |problem: &str| StoreError::Condition {
            condition: text.into(),
            problem: problem.into(),
            help: "write a column, one of < <= > >= = !=, and a number or a word: \"inertance_kg < 300\"".into(),
        };
        let place = text.find(['<', '>', '=', '!']).ok_or_else(|| refused("it has no relation"))?;
        let (column, rest) = text.split_at(place);
        let known = RELATIONS.iter().find_map(|(sign, relation)| Some((*relation, rest.strip_prefix(sign)?)));
        let (relation, value) = known.ok_or_else(|| refused("it has no relation"))?;
        let (column, value) = (column.trim(), value.trim());
        if column.is_empty() || value.is_empty() {
            return Err(refused("a side of it is empty"));
        }
        let is_order = !matches!(relation, Relation::Equal | Relation::Unequal);
        if is_order && !value.parse().is_ok_and(f64::is_finite) && column != "date" {
            return Err(refused("only numbers and dates are less or more"));
        }
        Ok(Self { column: column.into(), relation, value: value.into() })
    }
}

impl Condition {
    /// Whether a row is like this. What is not known is not: neither equal nor unequal.
    fn holds(&self, row: &Row) -> Result<bool, StoreError> {
        if !row.columns().any(|name| name == self.column) {
            let nearest = nearest(&self.column, row.columns()).map(|name| format!("did you mean {name}? "));
            return Err(StoreError::Condition {
                condition: self.column.clone(),
                problem: "no run has such a column".into(),
                help: format!("{}`inerter store show` prints all columns of a run", nearest.unwrap_or_default()),
            });
        }
        let Some(found) = row.get(&self.column) else { return Ok(false) };
        let order = match (&found, self.value.parse::<f64>()) {
            (Value::Number(number), Ok(value)) => number.as_f64().and_then(|number| number.partial_cmp(&value)),
            (Value::String(text), _) => Some(text.as_str().cmp(self.value.as_str())),
            _ => None,
        };
        Ok(order.is_some_and(|order| match self.relation {
            Relation::Less => order.is_lt(),
            Relation::AtMost => order.is_le(),
            Relation::More => order.is_gt(),
            Relation::AtLeast => order.is_ge(),
            Relation::Equal => order.is_eq(),
            Relation::Unequal => order.is_ne(),
        }))
    }
}

impl Choice {
    /// Whether the place alone can be meant.
    pub(crate) fn may_be(&self, place: &Place) -> bool {
        let date = place.date.as_str();
        self.device.as_ref().is_none_or(|device| *device == place.device)
            && self.from.as_ref().is_none_or(|from| date >= from.as_str())
            // All days of a month begin like it.
            && self.to.as_ref().is_none_or(|to| date <= to.as_str() || date.starts_with(to.as_str()))
    }

    /// Whether a row is meant.
    pub(crate) fn is(&self, row: &Row) -> Result<bool, StoreError> {
        self.conditions.iter().try_fold(true, |all, condition| Ok(condition.holds(row)? && all))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn row() -> Row {
        let values =
            json!({"run": "00", "inertance_kg": 299.5, "viscous_n_s_per_m": null, "law": "holds", "samples": 20});
        let place = Place { device: "SIM-1".into(), date: "2026-03-04".into(), run: "00".into() };
        Row { place, values: values.as_object().unwrap().clone() }
    }

    #[test]
    fn conditions_compare_numbers_and_words() {
        let cases = [
            ("inertance_kg < 300", true),
            ("inertance_kg<=299.5", true),
            ("inertance_kg > 299.5", false),
            ("samples >= 20", true),
            ("samples != 20", false),
            ("samples = 2e1", true),
            ("law = holds", true),
            ("law != broken", true),
            ("device = SIM-2", false),
            ("date > 2026-01-01", true),
            ("viscous_n_s_per_m < 1", false),
            ("viscous_n_s_per_m != 1", false),
        ];
        for (text, expected) in cases {
            assert_eq!(text.parse::<Condition>().unwrap().holds(&row()).unwrap(), expected, "{text}");
        }
    }

    #[test]
    fn what_is_no_condition_is_refused_with_what_to_do() {
        for text in ["inertance_kg", "< 3", "inertance_kg <", "law < holds", "a ! b", "inertance_kg < NaN"] {
            assert!(text.parse::<Condition>().is_err(), "{text}");
        }
        let error = "inertance < 3".parse::<Condition>().unwrap().holds(&row()).unwrap_err();
        assert!(miette::Diagnostic::help(&error).unwrap().to_string().contains("did you mean inertance_kg?"));
    }

    #[test]
    fn days_and_months_bound_a_choice() {
        let may_be = |from: Option<&str>, to: Option<&str>| {
            let choice = Choice { from: from.map(Into::into), to: to.map(Into::into), ..Choice::default() };
            choice.may_be(&row().place)
        };
        assert!(may_be(None, None) && may_be(Some("2026-03-04"), Some("2026-03-04")));
        assert!(may_be(Some("2026-03"), Some("2026-03")) && may_be(None, Some("2026")));
        assert!(
            !may_be(Some("2026-03-05"), None) && !may_be(None, Some("2026-03-03")) && !may_be(None, Some("2026-02"))
        );
        assert!(!Choice { device: Some("SIM-2".into()), ..Choice::default() }.may_be(&row().place));
    }
}
