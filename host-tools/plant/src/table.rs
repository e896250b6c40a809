//! One table per set of fields: each field with its unit, default, range and help is written once.

use crate::PlantError;

/// A field's properties apart from its value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldInfo {
    /// Name, with its unit at the end, if any.
    pub name: &'static str,
    /// Unit for display; empty for a plain number.
    pub unit: &'static str,
    /// One line for a person.
    pub help: &'static str,
    /// Default value.
    pub default: f64,
    /// Minimum accepted value.
    pub min: f64,
    /// Maximum accepted value.
    pub max: f64,
    /// Further conditions on the value.
    pub kind: FieldKind,
}

/// Conditions on a field's value besides its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldKind {
    /// Any number.
    Real,
    /// An integer.
    Whole,
}

impl FieldInfo {
    /// Whether `value` is valid, apart from the other fields.
    pub fn check(&self, value: f64) -> Result<(), PlantError> {
        check(self.name, value, (self.min, self.max))?;
        match self.kind {
            FieldKind::Whole if value.fract() != 0.0 => Err(PlantError::NotWhole { field: self.name, value }),
            _ => Ok(()),
        }
    }
}

/// Whether a number lies in its range.
pub(crate) fn check(field: &'static str, value: f64, (min, max): (f64, f64)) -> Result<(), PlantError> {
    if !value.is_finite() {
        return Err(PlantError::NotFinite { field });
    }
    if !(min..=max).contains(&value) {
        return Err(PlantError::OutOfRange { field, value, min, max });
    }
    Ok(())
}

/// A struct of `f64` fields and at most one field of another type, with its table and access by name.
macro_rules! field_table {
    ($(#[$about:meta])* pub struct $type:ident {
        $($(#[$text:meta])*
          $name:ident, $unit:literal, $default:expr, $min:expr, $max:expr, $kind:ident, $help:literal;)+
    } $($(#[$other_text:meta])* $other:ident: $other_type:ty = $value:expr)?) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $type {
            $($(#[$text])* pub $name: f64,)+
            $($(#[$other_text])* pub $other: $other_type,)?
        }

        impl $type {
            const DEFAULT: Self = Self { $($name: $default,)+ $($other: $value)? };

            /// Every field that is a number: name, unit, default, range.
            pub const TABLE: &'static [$crate::table::FieldInfo] = &[
                $($crate::table::FieldInfo {
                    name: stringify!($name), unit: $unit, help: $help, default: $default, min: $min, max: $max,
                    kind: $crate::table::FieldKind::$kind,
                },)+
            ];

            /// The values, in the order of [`TABLE`](Self::TABLE).
            pub fn values(&self) -> Vec<f64> {
                vec![$(self.$name),+]
            }

            /// Value of the field with this name.
            pub fn get(&self, name: &str) -> Option<f64> {
                match name {
                    $(stringify!($name) => Some(self.$name),)+
                    _ => None,
                }
            }

            /// Replaces one value by its name, after checking that value alone.
            pub fn set(&mut self, name: &str, value: f64) -> Result<(), $crate::PlantError> {
                let info = Self::TABLE.iter().find(|info| info.name == name);
                info.ok_or_else(|| $crate::PlantError::UnknownField { name: name.to_owned() })?.check(value)?;
                match name {
                    $(stringify!($name) => self.$name = value,)+
                    _ => {}
                }
                Ok(())
            }

            fn check_fields(&self) -> Result<(), $crate::PlantError> {
                Self::TABLE.iter().zip(self.values()).try_for_each(|(info, value)| info.check(value))
            }
        }
    };
}
pub(crate) use field_table;
