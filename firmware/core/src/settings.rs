//! Settings in SI, and what makes them valid.
//!
//! Every setting is one number with a name that carries its unit; a choice has a type of its own. The table below is
//! the only place where a setting's name, unit, default and range are written; the wire, the host and the documents
//! read it from here.

/// Why a set of settings was refused, naming the field.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SettingsError {
    /// No setting has this name (or, on the wire, this number).
    Unknown,
    /// The value is NaN or infinite.
    NotFinite {
        /// The setting's name.
        field: &'static str,
    },
    /// The value lies outside its range.
    OutOfRange {
        /// The setting's name.
        field: &'static str,
        /// The value that was refused.
        value: f64,
        /// Least value accepted.
        min: f64,
        /// Greatest value accepted.
        max: f64,
    },
    /// The value must be a whole number.
    NotWhole {
        /// The setting's name.
        field: &'static str,
        /// The value that was refused.
        value: f64,
    },
    /// The value must not be zero, nor under 1e-12 in magnitude: everything measured is multiplied by it.
    Zero {
        /// The setting's name.
        field: &'static str,
    },
    /// Two settings contradict each other.
    Conflict {
        /// The setting's name.
        field: &'static str,
        /// The other one.
        other: &'static str,
        /// What must hold between them.
        rule: &'static str,
    },
    /// The value is possible, but not on this board.
    NotOffered {
        /// The setting's name.
        field: &'static str,
        /// The value that was refused.
        value: f64,
        /// Values that the board offers together with the other settings.
        offered: &'static [f64],
    },
}

impl core::fmt::Display for SettingsError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Self::Unknown => write!(f, "no setting has this name"),
            Self::NotFinite { field } => write!(f, "{field}: the value is not a finite number"),
            Self::OutOfRange { field, value, min, max } => {
                write!(f, "{field}: {value} is outside {min} to {max}")
            }
            Self::NotWhole { field, value } => write!(f, "{field}: {value} is not a whole number"),
            Self::Zero { field } => write!(f, "{field}: must be at least 1e-12 in magnitude"),
            Self::Conflict { field, other, rule } => write!(f, "{field} and {other}: {rule}"),
            Self::NotOffered { field, value, offered } => {
                write!(f, "{field}: the board does not offer {value}, but")?;
                let last = offered.len().saturating_sub(1);
                offered.iter().enumerate().try_for_each(|(place, value)| match place {
                    0 => write!(f, " {value}"),
                    _ if place == last => write!(f, " and {value}"),
                    _ => write!(f, ", {value}"),
                })
            }
        }
    }
}

impl core::error::Error for SettingsError {}

/// Unit and explanation of a setting, for people. Not in [`SettingInfo`], because a device does not need them and its
/// flash is small.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SettingText {
    /// Unit for display; empty for a plain number.
    pub unit: &'static str,
    /// Explanation in one line.
    pub help: &'static str,
}

/// Name, default and limits of a setting.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SettingInfo {
    /// Name, ending in the unit where there is one.
    pub name: &'static str,
    /// Value on a device that was never set up.
    pub default: f64,
    /// Least value accepted.
    pub min: f64,
    /// Greatest value accepted.
    pub max: f64,
    /// Further restriction of the value.
    pub kind: Kind,
}

/// Restriction of a setting's value besides its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Kind {
    /// Any number.
    Real,
    /// Any number but zero; the sign gives the direction.
    NonZero,
    /// A whole number.
    Whole,
}

/// Where the force comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FrontEnd {
    /// The board's own converter behind an analogue amplifier.
    #[default]
    Analogue,
    /// The 24-bit converter ADS131M04.
    Ads131m04,
}

/// What kind of machine the screw belongs to: what position, force and inertance are measured in.
///
/// The arithmetic is the same for both; only the names and units that people and programs see differ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Machine {
    /// Translation: m, N, kg.
    #[default]
    Linear,
    /// Rotation: rad, N m, kg m^2.
    Rotary,
}

/// A setting's type, as the number that tables, files and the wire hold.
trait Number: Copy {
    fn number(self) -> f64;
    /// From a number that [`SettingInfo::check`] accepts.
    fn of(number: f64) -> Self;
}

impl Number for f64 {
    fn number(self) -> f64 {
        self
    }

    fn of(number: f64) -> Self {
        number
    }
}

impl Number for bool {
    fn number(self) -> f64 {
        f64::from(u8::from(self))
    }

    fn of(number: f64) -> Self {
        number != 0.0
    }
}

impl Number for FrontEnd {
    fn number(self) -> f64 {
        f64::from(self as u8)
    }

    fn of(number: f64) -> Self {
        if number == 0.0 { Self::Analogue } else { Self::Ads131m04 }
    }
}

impl Number for Machine {
    fn number(self) -> f64 {
        f64::from(self as u8)
    }

    fn of(number: f64) -> Self {
        if number == 0.0 { Self::Linear } else { Self::Rotary }
    }
}

macro_rules! settings {
    ($($name:ident: $type:ty, $unit:literal, $default:expr, $min:expr, $max:expr, $kind:ident, $help:literal;)+) => {
        /// Everything a user can set, in SI units.
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct Settings {
            $(#[doc = $help] #[doc = concat!("Unit: `", $unit, "`.")] pub $name: $type,)+
        }

        impl Settings {
            /// The table of settings. A setting's number on the wire is its place here, so new ones go at the end.
            pub const TABLE: &'static [SettingInfo] = &[
                $(SettingInfo {
                    name: stringify!($name), default: $default, min: $min, max: $max, kind: Kind::$kind,
                },)+
            ];

            /// Units and explanations, in the order of [`TABLE`](Self::TABLE).
            pub const TEXTS: &'static [SettingText] = &[
                $(SettingText { unit: $unit, help: $help },)+
            ];

            /// Number of settings.
            pub const COUNT: usize = Self::TABLE.len();

            /// All values, in the order of [`TABLE`](Self::TABLE).
            pub fn values(&self) -> [f64; Self::COUNT] {
                [$(self.$name.number()),+]
            }

            fn of(values: [f64; Self::COUNT]) -> Self {
                let [$($name),+] = values;
                Self { $($name: Number::of($name)),+ }
            }
        }

        impl Default for Settings {
            fn default() -> Self {
                Self::of([$($default),+])
            }
        }
    };
}

settings! {
    sample_rate_hz: f64, "Hz", 1000.0, 50.0, 5000.0, Real, "Samples per second of the device's clock";
    metres_per_count: f64, "m", 2.44140625e-6, -1e-1, 1e-1, NonZero, "Terminal displacement per encoder count: lead / counts per revolution; negative reverses the direction";
    oversampling: f64, "", 1.0, 1.0, 64.0, Whole, "Encoder counts summed into one sample's position";
    newtons_per_code: f64, "N", 0.002, -1e3, 1e3, NonZero, "Force per force code; negative reverses the direction";
    force_zero_code: f64, "", 0.0, -8388608.0, 8388607.0, Whole, "Force code at no force (tare)";
    force_min_code: f64, "", -8388608.0, -8388608.0, 8388607.0, Whole, "Force code at or below which the channel is saturated";
    force_max_code: f64, "", 8388607.0, -8388608.0, 8388607.0, Whole, "Force code at or above which the channel is saturated";
    metres_per_terminal_code: f64, "m", 1e-7, -1e-1, 1e-1, NonZero, "Terminal displacement per code of its own sensor";
    structure_mass_kg: f64, "kg", 0.0, 0.0, 1e4, Real, "Structure mass attached to the measured terminal, screw not included";
    structure_mass_u95_kg: f64, "kg", 0.0, 0.0, 1e4, Real, "95 % uncertainty of the structure mass";
    stiffness_n_per_m: f64, "N/m", 0.0, 0.0, 1e12, Real, "Contact stiffness between terminal and screw; 0 if unknown";
    contact_damping_n_s_per_m: f64, "N s/m", 0.0, 0.0, 1e9, Real, "Contact damping between terminal and screw";
    skew_s: f64, "s", 0.0, -0.005, 0.005, Real, "Delay of the force behind the position";
    skew_u95_s: f64, "s", 1e-6, 0.0, 0.01, Real, "95 % uncertainty of the skew";
    force_gain_u95: f64, "", 0.005, 0.0, 1.0, Real, "95 % relative uncertainty of the force calibration";
    lead_u95: f64, "", 0.001, 0.0, 1.0, Real, "95 % relative uncertainty of metres per count";
    timebase_u95: f64, "", 5e-5, 0.0, 1.0, Real, "95 % relative uncertainty of the sample clock";
    memory_s: f64, "s", 30.0, 0.5, 3600.0, Real, "Averaging time of the live estimate";
    stuck_displacement_m: f64, "m", 0.0, 0.0, 1.0, Real, "Greatest motion within 24 ms that counts as rest; 2 encoder counts if that is more";
    publish_rate_hz: f64, "Hz", 5.0, 0.1, 10.0, Real, "Estimates per second";
    full_scale_velocity_m_per_s: f64, "m/s", 2.0, 1e-3, 1e5, Real, "Velocity beyond which samples are left out as saturated";
    full_scale_acceleration_m_per_s2: f64, "m/s^2", 200.0, 1e-2, 1e7, Real, "Acceleration beyond which samples are left out as saturated";
    front_end: FrontEnd, "", 0.0, 0.0, 1.0, Whole, "Force front end: 0 analogue, 1 ADS131M04";
    stiffness_u95_n_per_m: f64, "N/m", 0.0, 0.0, 1e12, Real, "95 % uncertainty of the contact stiffness; 0 stands for 1 % of it";
    terminal_sensor: bool, "", 0.0, 0.0, 1.0, Whole, "Terminal displacement sensor: 0 none, 1 on the third channel";
    machine: Machine, "", 0.0, 0.0, 1.0, Whole, "Kind of machine: 0 linear (kg, N, m), 1 rotary (kg m^2, N m, rad)";
}

impl Settings {
    /// The skew in whole samples, by which force and position are shifted against each other, and the remainder \[s\].
    pub fn skew_parts(&self) -> (i32, f64) {
        let samples = self.skew_s * self.sample_rate_hz;
        let half = if samples < 0.0 { -0.5 } else { 0.5 };
        let whole = (samples + half) as i32;
        (whole, self.skew_s - f64::from(whole) / self.sample_rate_hz)
    }

    /// Every setting with its text.
    pub fn described() -> impl Iterator<Item = (&'static SettingInfo, &'static SettingText)> {
        Self::TABLE.iter().zip(Self::TEXTS)
    }

    /// Number of the setting with this name.
    pub fn find(name: &str) -> Option<usize> {
        Self::TABLE.iter().position(|info| info.name == name)
    }

    /// Value of the setting with this name.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.values().get(Self::find(name)?).copied()
    }

    /// Replaces the value with this number in [`TABLE`](Self::TABLE). Checks the value alone, not against the other
    /// settings.
    pub fn set(&mut self, number: usize, value: f64) -> Result<(), SettingsError> {
        let info = Self::TABLE.get(number).ok_or(SettingsError::Unknown)?;
        info.check(value)?;
        let mut values = self.values();
        if let Some(place) = values.get_mut(number) {
            *place = value;
        }
        *self = Self::of(values);
        Ok(())
    }

    /// Replaces the value with this name. Checks the value alone, not against the other settings.
    pub fn set_by_name(&mut self, name: &str, value: f64) -> Result<(), SettingsError> {
        self.set(Self::find(name).ok_or(SettingsError::Unknown)?, value)
    }
}

impl SettingInfo {
    /// Checks `value` alone, not against the other settings.
    pub fn check(&self, value: f64) -> Result<(), SettingsError> {
        let field = self.name;
        if !value.is_finite() {
            return Err(SettingsError::NotFinite { field });
        }
        if !(self.min..=self.max).contains(&value) {
            return Err(SettingsError::OutOfRange { field, value, min: self.min, max: self.max });
        }
        match self.kind {
            Kind::Real => Ok(()),
            Kind::NonZero if (-1e-12..1e-12).contains(&value) => Err(SettingsError::Zero { field }),
            Kind::NonZero => Ok(()),
            Kind::Whole if value != (value as i64) as f64 => Err(SettingsError::NotWhole { field, value }),
            Kind::Whole => Ok(()),
        }
    }
}
