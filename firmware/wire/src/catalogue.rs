//! Name, label, symbol and unit of every number that a view can show.
//!
//! Tables, plots, exports and exchange formats take their words from here and from [`Settings::TABLE`], so that a
//! quantity is called the same everywhere.
//!
//! [`Settings::TABLE`]: inerter_core::Settings::TABLE

use crate::Health;
use inerter_core::{Detail, Estimate, Parameter, Parameters, RawSample};

/// Where a field belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Group {
    /// An estimated parameter: stands in `recent` and in `whole_run`, each with value, U95 and status.
    Parameter,
    /// The rest of an estimate.
    Estimate,
    /// What goes with an estimate.
    Detail,
    /// A raw sample.
    Sample,
    /// A sample in SI units, by the settings.
    Signal,
    /// The device's health.
    Health,
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

macro_rules! fields {
    ($($group:ident $path:literal, $label:literal, $symbol:literal, $unit:literal;)+) => {
        /// Every quantity.
        pub const FIELDS: &[Field] =
            &[$(Field { group: Group::$group, path: $path, label: $label, symbol: $symbol, unit: $unit },)+];
    };
}

fields! {
    Parameter "inertance_kg", "Effective inertance", "mt", "kg";
    Parameter "viscous_n_s_per_m", "Viscous friction", "cf", "N s/m";
    Parameter "coulomb_n", "Coulomb friction", "fc", "N";
    Parameter "offset_n", "Force offset", "F0", "N";
    Estimate "index", "Sample counter", "", "";
    Estimate "elapsed_samples", "Samples since the reset", "", "";
    Estimate "bank", "Kernel bank", "", "";
    Estimate "moving", "Moving", "", "";
    Estimate "residual_rms_n", "Residual force, rms", "", "N";
    Estimate "updates", "Updates since the reset", "", "";
    Detail "index", "Sample counter", "", "";
    Detail "band_hz", "Seen between", "", "Hz";
    Detail "backlash_m", "Backlash", "eps", "m";
    Detail "contact", "Contact", "", "";
    Detail "stiffness_n_per_m", "Contact stiffness", "ks", "N/m";
    Detail "contact_damping_n_s_per_m", "Contact damping", "cs", "N s/m";
    Detail "friction", "Friction", "", "";
    Detail "changes", "Changes since the reset", "", "";
    Sample "index", "Sample counter", "", "";
    Sample "position_count", "Encoder counts", "", "";
    Sample "force_code", "Force code", "", "";
    Sample "terminal_code", "Terminal displacement code", "", "";
    Signal "t_s", "Time", "t", "s";
    Signal "position_m", "Screw displacement", "x2", "m";
    Signal "force_n", "Force", "F", "N";
    Signal "terminal_m", "Terminal displacement", "x1", "m";
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
}

/// The fields of one group, in the order of its type.
pub fn fields(group: Group) -> impl Iterator<Item = &'static Field> {
    FIELDS.iter().filter(move |field| field.group == group)
}

/// One field by its group and path.
pub fn find(group: Group, path: &str) -> Option<&'static Field> {
    fields(group).find(|field| field.path == path)
}

/// The four parameters with their fields.
pub fn parameters(parameters: &Parameters) -> impl Iterator<Item = (&'static Field, Parameter)> {
    let Parameters { inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n } = *parameters;
    fields(Group::Parameter).zip([inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n])
}

/// The plain numbers of an estimate with their fields: bank 0 is fast, 1 slow; moving is 0 or 1.
pub fn estimate(estimate: &Estimate) -> impl Iterator<Item = (&'static Field, f64)> {
    let Estimate { index, elapsed_samples, bank, moving, recent: _, whole_run: _, residual_rms_n, updates } = *estimate;
    fields(Group::Estimate).zip([
        f64::from(index),
        elapsed_samples as f64,
        f64::from(bank as u8),
        f64::from(u8::from(moving)),
        f64::from(residual_rms_n),
        f64::from(updates),
    ])
}

/// The parameters of the contact with their fields, as a terminal displacement sensor shows them.
pub fn contact(detail: &Detail) -> impl Iterator<Item = (&'static Field, Parameter)> {
    let Detail { stiffness_n_per_m, contact_damping_n_s_per_m, .. } = *detail;
    let fields = fields(Group::Detail).filter(|field| matches!(field.symbol, "ks" | "cs"));
    fields.zip([stiffness_n_per_m, contact_damping_n_s_per_m])
}

/// The numbers of a raw sample with their fields.
pub fn sample(sample: &RawSample) -> impl Iterator<Item = (&'static Field, f64)> {
    let RawSample { index, position_count, force_code, terminal_code } = *sample;
    fields(Group::Sample).zip([
        f64::from(index),
        f64::from(position_count),
        f64::from(force_code),
        f64::from(terminal_code),
    ])
}

/// The device's health with its fields; `None` where the device does not know.
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
    fields(Group::Health).zip([
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
