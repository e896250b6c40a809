//! Names of quantities for a rotary machine, derived from those of a linear one with the catalogue's units and words.

use std::{borrow::Cow, io};

use inerter_core::Machine;
pub use inerter_wire::catalogue::unit;
use inerter_wire::catalogue::{self, Field, Group, ROTARY_UNITS, ROTARY_WORDS};
use serde_json::ser::{CompactFormatter, Formatter};

/// Objects whose keys are names of settings or of a simulated device's parameters, which are the same for all machines.
const VERBATIM: [&str; 6] = ["settings", "truth", "expected", "values", "u95", "differences"];

/// Keys whose values are names.
const HOLD_NAMES: [&str; 5] = ["parameter", "names", "lacking", "told", "differs"];

/// The suffix for this unit in a name: `n_s_per_m`.
pub(crate) fn unit_suffix(unit: &str) -> String {
    unit.to_lowercase().replace('/', "_per_").replace(' ', "_").replace('²', "2").replace('µ', "u")
}

/// The name on this machine for a linear machine's name: `residual_rms_n_m` for `residual_rms_n`.
pub fn name(machine: Machine, linear: &str) -> Cow<'_, str> {
    if machine == Machine::Linear {
        return linear.into();
    }
    let split = |(of_linear, rotary): &(&str, &str)| {
        Some((linear.strip_suffix(&unit_suffix(of_linear))?.strip_suffix('_')?, unit_suffix(rotary)))
    };
    // `n_s_per_m` ends in `m` as well: the longest unit applies, which the catalogue lists first.
    let Some((stem, suffix)) = ROTARY_UNITS.iter().find_map(split) else { return linear.into() };
    let word = |part| ROTARY_WORDS.iter().find(|(of_linear, _)| *of_linear == part).map_or(part, |(_, rotary)| *rotary);
    let stem = stem.split('_').map(word).collect::<Vec<_>>().join("_");
    format!("{stem}_{suffix}").into()
}

/// The name of a quantity derived from a field, with the unit at the end again: `inertance_u95_kg` for `_u95` of
/// `inertance_kg`.
pub fn beside(field: &Field, what: &str) -> String {
    format!("{}{what}_{}", stem(field), unit_suffix(field.unit))
}

/// The name of a field without its unit: `inertance`.
pub fn stem(field: &Field) -> &'static str {
    field.path.strip_suffix(&unit_suffix(field.unit)).map_or(field.path, |stem| stem.trim_end_matches('_'))
}

/// The field of a parameter by its index (inertance, viscous and Coulomb friction, offset): label, symbol and unit.
pub fn parameter(machine: Machine, place: usize) -> &'static Field {
    catalogue::fields(machine, Group::Parameter).nth(place).unwrap_or(&catalogue::FIELDS[0])
}

/// A description in the words and units of this machine: `mean torque [N m]` for `mean force [N]`.
pub fn description(machine: Machine, linear: &str) -> String {
    if machine == Machine::Linear {
        return linear.into();
    }
    let (text, unit) = match linear.strip_suffix(']').and_then(|text| text.rsplit_once('[')) {
        Some((text, of_linear)) => {
            let found = ROTARY_UNITS.iter().find(|(linear, _)| *linear == of_linear);
            (text, format!("[{}]", found.map_or(of_linear, |(_, rotary)| *rotary)))
        }
        None => (linear, String::new()),
    };
    let told = |word: &str| {
        // A setting has one name for all machines.
        if word.contains('_') {
            return word.to_string();
        }
        ROTARY_WORDS.iter().chain(&[("displacement", "angle")]).fold(word.to_string(), |word, (of_linear, rotary)| {
            word.replace(of_linear, rotary).replace(&capital(of_linear), &capital(rotary))
        })
    };
    text.split_inclusive(' ').map(told).collect::<String>() + &unit
}

fn capital(word: &str) -> String {
    let (first, rest) = word.split_at(1);
    first.to_uppercase() + rest
}

/// Writes JSON with the keys of a machine.
#[derive(Default)]
pub(crate) struct Names {
    machine: Machine,
    in_key: bool,
    key: String,
    depth: usize,
    verbatim_from: Option<usize>,
}

impl Names {
    pub fn new(machine: Machine) -> Self {
        Self { machine, ..Self::default() }
    }
}

impl Formatter for Names {
    fn begin_object<W: ?Sized + io::Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.depth += 1;
        if VERBATIM.contains(&self.key.as_str()) {
            self.verbatim_from.get_or_insert(self.depth);
        }
        CompactFormatter.begin_object(writer)
    }

    fn end_object<W: ?Sized + io::Write>(&mut self, writer: &mut W) -> io::Result<()> {
        if self.verbatim_from == Some(self.depth) {
            self.verbatim_from = None;
        }
        self.depth -= 1;
        // The next object in a list does not belong to this object's keys.
        self.key.clear();
        CompactFormatter.end_object(writer)
    }

    fn begin_object_key<W: ?Sized + io::Write>(&mut self, writer: &mut W, first: bool) -> io::Result<()> {
        self.in_key = true;
        CompactFormatter.begin_object_key(writer, first)
    }

    fn end_object_key<W: ?Sized + io::Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.in_key = false;
        CompactFormatter.end_object_key(writer)
    }

    fn write_string_fragment<W: ?Sized + io::Write>(&mut self, writer: &mut W, fragment: &str) -> io::Result<()> {
        if self.in_key {
            self.key.clear();
            self.key.push_str(fragment);
        }
        let is_name = self.in_key || HOLD_NAMES.contains(&self.key.as_str());
        let machine = if is_name && self.verbatim_from.is_none() { self.machine } else { Machine::Linear };
        CompactFormatter.write_string_fragment(writer, &name(machine, fragment))
    }
}

#[cfg(test)]
mod tests {
    use inerter_wire::catalogue::{FIELDS, ROTARY_FIELDS};
    use serde_json::json;

    use super::*;
    use crate::json::machine_json_line;

    #[test]
    fn the_rule_gives_the_names_and_units_of_the_catalogue() {
        for (linear, rotary) in FIELDS.iter().zip(ROTARY_FIELDS) {
            assert_eq!(name(Machine::Rotary, linear.path), rotary.path);
            assert_eq!(unit(Machine::Rotary, linear.unit), rotary.unit);
            assert_eq!((linear.group, linear.symbol), (rotary.group, rotary.symbol));
        }
        assert_eq!(name(Machine::Rotary, "inertance_u95_kg"), "inertia_u95_kg_m2");
        assert_eq!(name(Machine::Rotary, "force_min_n"), "torque_min_n_m");
        assert_eq!(name(Machine::Linear, "force_min_n"), "force_min_n");
    }

    #[test]
    fn descriptions_change_words_and_units() {
        let cases =
            [("mean force [N]", "mean torque [N m]"), ("Effective inertance [kg]", "Effective inertia [kg m²]")];
        for (linear, rotary) in cases {
            assert_eq!(description(Machine::Rotary, linear), rotary);
            assert_eq!(description(Machine::Linear, linear), linear);
        }
        assert_eq!(description(Machine::Rotary, "Processor load [1/1000]"), "Processor load [1/1000]");
        assert_eq!(description(Machine::Rotary, "the force, or force_min_code"), "the torque, or force_min_code");
    }

    #[test]
    fn keys_change_but_numbers_texts_and_settings_do_not() {
        let value = json!({"coulomb_n": {"value": 0.1, "u95": 1}, "settings": {"stiffness_n_per_m": 2}, "error_m": null,
            "file": "force_n", "parameter": "inertance_kg"});
        assert_eq!(
            machine_json_line(Machine::Rotary, &value),
            r#"{"coulomb_n_m":{"value":0.1,"u95":1},"settings":{"stiffness_n_per_m":2},"error_rad":null,"file":"force_n","parameter":"inertia_kg_m2"}"#
        );
        assert_eq!(machine_json_line(Machine::Linear, &value), value.to_string());
    }
}
