//! Name, label, symbol and unit of every quantity that a view can show.
//!
//! Tables, plots, exports and exchange formats take their wording from here and from [`Settings::TABLE`], so that a
//! quantity has the same name everywhere.
//!
//! [`Settings::TABLE`]: inerter_core::Settings::TABLE

use crate::{Health, Measured};
use inerter_core::{Detail, Estimate, Machine, Parameter, Parameters, RawSample};

/// Where a field belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Group {
    /// An estimated parameter: appears in `recent` and in `whole_run`, each with value, U95 and status.
    Parameter,
    /// The rest of an estimate.
    Estimate,
    /// Data published with an estimate.
    Detail,
    /// A raw sample.
    Sample,
    /// A sample in SI units, by the settings.
    Signal,
    /// The device's health.
    Health,
    /// What a board measures of itself: raw numbers, each at the place of its [`Quantity`](crate::Quantity).
    Measured,
}

/// One quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Field {
    /// Where it belongs.
    pub group: Group,
    /// Name in code, JSON, CSV and recordings; ends in the unit where there is one.
    pub path: &'static str,
    /// Name for a person.
    pub label: &'static str,
    /// Symbol in formulas; empty when there is none.
    pub symbol: &'static str,
    /// Unit; empty for a plain number.
    pub unit: &'static str,
}

macro_rules! field {
    ($group:ident, $path:literal, $label:literal, $symbol:literal, $unit:literal) => {
        Field { group: Group::$group, path: $path, label: $label, symbol: $symbol, unit: $unit }
    };
    (
        $group:ident, $linear_path:literal, $linear_label:literal, $symbol:literal, $linear_unit:literal,
        $path:literal, $label:literal, $unit:literal
    ) => {
        field!($group, $path, $label, $symbol, $unit)
    };
}

macro_rules! fields {
    ($($group:ident $path:literal, $label:literal, $symbol:literal, $unit:literal $(=> $($rotary:literal),+)?;)+) => {
        /// Every quantity, as named for a linear machine.
        pub const FIELDS: &[Field] = &[$(field!($group, $path, $label, $symbol, $unit),)+];
        /// The same for a rotary machine, in the same order.
        pub const ROTARY_FIELDS: &[Field] = &[$(field!($group, $path, $label, $symbol, $unit $(, $($rotary),+)?),)+];
    };
}

/// Units of a linear machine, each with its rotary counterpart.
pub const ROTARY_UNITS: &[(&str, &str)] = &[
    ("N s/m", "N m s"),
    ("N/m", "N m/rad"),
    ("m/s", "rad/s"),
    ("kN/m", "kN m/rad"),
    ("kg", "kg m²"),
    ("N", "N m"),
    ("m", "rad"),
    ("mm", "mrad"),
    ("µm", "µrad"),
];

/// Words in names for a linear machine, each with its rotary counterpart.
pub const ROTARY_WORDS: &[(&str, &str)] =
    &[("inertance", "inertia"), ("mass", "inertia"), ("force", "torque"), ("position", "angle")];

/// The unit that this machine has in place of a linear one's.
pub fn unit(machine: Machine, linear: &'static str) -> &'static str {
    let rotary = || ROTARY_UNITS.iter().find(|(of_linear, _)| *of_linear == linear).map(|(_, rotary)| *rotary);
    match machine {
        Machine::Linear => linear,
        Machine::Rotary => rotary().unwrap_or(linear),
    }
}

fields! {
    Parameter "inertance_kg", "Effective inertance", "mt", "kg" => "inertia_kg_m2", "Effective inertia", "kg m²";
    Parameter "viscous_n_s_per_m", "Viscous friction", "cf", "N s/m" => "viscous_n_m_s", "Viscous friction", "N m s";
    Parameter "coulomb_n", "Coulomb friction", "fc", "N" => "coulomb_n_m", "Coulomb friction", "N m";
    Parameter "offset_n", "Force offset", "F0", "N" => "offset_n_m", "Torque offset", "N m";
    Estimate "index", "Sample counter", "", "";
    Estimate "elapsed_samples", "Samples since the reset", "", "";
    Estimate "bank", "Kernel bank", "", "";
    Estimate "moving", "Moving", "", "";
    Estimate "residual_rms_n", "Residual force, rms", "", "N" => "residual_rms_n_m", "Residual torque, rms", "N m";
    Estimate "updates", "Updates since the reset", "", "";
    Detail "index", "Sample counter", "", "";
    Detail "band_hz", "Frequency band", "", "Hz";
    Detail "backlash_m", "Backlash", "eps", "m" => "backlash_rad", "Backlash", "rad";
    Detail "contact", "Contact", "", "";
    Detail "stiffness_n_per_m", "Contact stiffness", "ks", "N/m" => "stiffness_n_m_per_rad", "Contact stiffness", "N m/rad";
    Detail "contact_damping_n_s_per_m", "Contact damping", "cs", "N s/m" => "contact_damping_n_m_s", "Contact damping", "N m s";
    Detail "friction", "Friction", "", "";
    Detail "changes", "Changes since the reset", "", "";
    Sample "index", "Sample counter", "", "";
    Sample "position_count", "Encoder counts", "", "";
    Sample "force_code", "Force code", "", "";
    Sample "terminal_code", "Terminal displacement code", "", "";
    Signal "t_s", "Time", "t", "s";
    Signal "position_m", "Screw displacement", "x2", "m" => "angle_rad", "Rotor angle", "rad";
    Signal "force_n", "Force", "F", "N" => "torque_n_m", "Torque", "N m";
    Signal "terminal_m", "Terminal displacement", "x1", "m" => "terminal_rad", "Terminal angle", "rad";
    Health "index", "Sample counter", "", "";
    Health "uptime_s", "Time since the start", "", "s";
    Health "dropped_frames", "Frames dropped by the device", "", "";
    Health "bad_frames", "Frames not understood by the device", "", "";
    Health "lost_samples", "Samples lost", "", "";
    Health "discontinuities", "Discontinuities in the samples", "", "";
    Health "overruns", "Sampler overruns", "", "";
    Health "saturated", "Samples saturated", "", "";
    Health "cpu_load_permille", "Processor load", "", "1/1000";
    Health "stack_free_bytes", "Stack never used", "", "bytes";
    Health "temperature_c", "Chip temperature", "", "°C";
    Measured "device_id", "Device and revision", "", "";
    Measured "flash_kb", "Flash", "", "KB";
    Measured "package", "Package", "", "";
    Measured "option_bytes", "Option bytes", "", "";
    Measured "option_bytes_wanted", "Option bytes wanted", "", "";
    Measured "reset_flags", "Reset flags at the start", "", "";
    Measured "stack_bytes", "Stack", "", "bytes";
    Measured "stack_free_bytes", "Stack never used", "", "bytes";
    Measured "saves_left", "Saves left", "", "";
    Measured "core_hz", "Clock of the core, as built", "", "Hz";
    Measured "usb_frames", "USB frames", "", "";
    Measured "usb_frames_cycles", "Core's clock in these USB frames", "", "cycles";
    Measured "lsi_periods", "Periods of the 32 kHz oscillator", "", "";
    Measured "lsi_periods_cycles", "Core's clock in these 32 kHz periods", "", "cycles";
    Measured "clock_us", "Time by the firmware's clock", "", "µs";
    Measured "clock_us_cycles", "Core's clock in that time", "", "cycles";
    Measured "clock_control", "Oscillators, RCC_CR", "", "";
    Measured "recovery_status", "Clock recovery, CRS_ISR", "", "";
    Measured "reference_code", "Voltage reference", "", "";
    Measured "reference_factory_code", "Voltage reference at the factory", "", "";
    Measured "temperature_code", "Temperature sensor", "", "";
    Measured "temperature_factory_30_code", "Temperature sensor at 30 °C, factory", "", "";
    Measured "temperature_factory_130_code", "Temperature sensor at 130 °C, factory", "", "";
    Measured "work_us", "Time in which work was counted", "", "µs";
    Measured "idle_us", "Time with nothing to do", "", "µs";
    Measured "sampling_cycles", "Work: sampling", "", "cycles";
    Measured "estimating_cycles", "Work: estimating", "", "cycles";
    Measured "telemetry_cycles", "Work: telemetry", "", "cycles";
    Measured "commands_cycles", "Work: commands", "", "cycles";
    Measured "usb_cycles", "Work: USB", "", "cycles";
    Measured "supervising_cycles", "Work: health, LED, watchdog", "", "cycles";
}

/// The fields of one group as named for this machine, in the order of its type.
pub fn fields(machine: Machine, group: Group) -> impl Iterator<Item = &'static Field> {
    let all = match machine {
        Machine::Linear => FIELDS,
        Machine::Rotary => ROTARY_FIELDS,
    };
    all.iter().filter(move |field| field.group == group)
}

/// One field as named for this machine, by its group and its path for a linear machine.
pub fn find(machine: Machine, group: Group, path: &str) -> Option<&'static Field> {
    fields(Machine::Linear, group)
        .zip(fields(machine, group))
        .find(|(linear, _)| linear.path == path)
        .map(|(_, field)| field)
}

/// The four parameters with their fields.
pub fn parameters(machine: Machine, parameters: &Parameters) -> impl Iterator<Item = (&'static Field, Parameter)> {
    let Parameters { inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n } = *parameters;
    fields(machine, Group::Parameter).zip([inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n])
}

/// The plain numbers of an estimate with their fields: bank 0 is fast, 1 slow; moving is 0 or 1.
pub fn estimate(machine: Machine, estimate: &Estimate) -> impl Iterator<Item = (&'static Field, f64)> {
    let Estimate { index, elapsed_samples, bank, moving, recent: _, whole_run: _, residual_rms_n, updates } = *estimate;
    fields(machine, Group::Estimate).zip([
        f64::from(index),
        elapsed_samples as f64,
        f64::from(bank as u8),
        f64::from(u8::from(moving)),
        f64::from(residual_rms_n),
        f64::from(updates),
    ])
}

/// The fields of the contact's parameters.
pub fn contact_fields(machine: Machine) -> impl Iterator<Item = &'static Field> {
    fields(machine, Group::Detail).filter(|field| matches!(field.symbol, "ks" | "cs"))
}

/// The parameters of the contact with their fields, as a terminal displacement sensor shows them.
pub fn contact(machine: Machine, detail: &Detail) -> impl Iterator<Item = (&'static Field, Parameter)> {
    let Detail { stiffness_n_per_m, contact_damping_n_s_per_m, .. } = *detail;
    contact_fields(machine).zip([stiffness_n_per_m, contact_damping_n_s_per_m])
}

/// The numbers of a raw sample with their fields.
pub fn sample(sample: &RawSample) -> impl Iterator<Item = (&'static Field, f64)> {
    let RawSample { index, position_count, force_code, terminal_code } = *sample;
    fields(Machine::Linear, Group::Sample).zip([
        f64::from(index),
        f64::from(position_count),
        f64::from(force_code),
        f64::from(terminal_code),
    ])
}

/// The figures that a board measured, with their fields. Figures of a newer board that this table does not contain are
/// left out.
pub fn measured(measured: &Measured) -> impl Iterator<Item = (&'static Field, u32)> {
    measured.figures.iter().filter_map(|figure| {
        let field = fields(Machine::Linear, Group::Measured).nth(usize::from(figure.quantity))?;
        Some((field, figure.value))
    })
}

/// The device's health with its fields; `None` for what the device does not know.
pub fn health(health: &Health) -> impl Iterator<Item = (&'static Field, Option<f64>)> {
    let Health {
        index,
        uptime_s,
        dropped_frames,
        bad_frames,
        lost_samples,
        discontinuities,
        overruns,
        saturated,
        cpu_load_permille,
        stack_free_bytes,
        temperature_c,
    } = *health;
    fields(Machine::Linear, Group::Health).zip([
        Some(f64::from(index)),
        Some(f64::from(uptime_s)),
        Some(f64::from(dropped_frames)),
        Some(f64::from(bad_frames)),
        Some(lost_samples as f64),
        Some(f64::from(discontinuities)),
        Some(f64::from(overruns)),
        Some(f64::from(saturated)),
        cpu_load_permille.map(f64::from),
        stack_free_bytes.map(f64::from),
        temperature_c.map(f64::from),
    ])
}
