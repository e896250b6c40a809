//! What accompanies the numbers: units, settings, device.
#![cfg_attr(
    not(all(feature = "parquet", feature = "matlab")),
    allow(dead_code, reason = "MCAP carries the settings alone")
)]

use serde_json::{Map, Value, json};

use super::{Column, EstimateTable, Source};
use inerter_core::Settings;

/// The settings by name.
pub fn settings_by_name(source: &Source) -> Map<String, Value> {
    let values = Settings::TABLE.iter().zip(source.settings.values());
    values.map(|(info, value)| (info.name.to_string(), json!(value))).collect()
}

/// The device as it describes itself; empty if unknown.
pub(super) fn device(source: &Source) -> Map<String, Value> {
    source.device.iter().flatten().map(|(name, text)| (name.clone(), json!(text))).collect()
}

/// Units of the columns by name.
pub(super) fn units(source: &Source, columns: &[Column]) -> Map<String, Value> {
    let machine = source.settings.machine;
    units_by_name(columns.iter().map(|column| (column.name(machine), column.unit(machine))))
}

/// Units of the estimates by name.
pub(super) fn estimate_units(table: &EstimateTable) -> Map<String, Value> {
    units_by_name(table.columns.iter().map(|column| (&*column.name, column.unit)))
}

/// Units by name; no entry for plain numbers.
pub(super) fn units_by_name<'a>(columns: impl Iterator<Item = (&'a str, &'a str)>) -> Map<String, Value> {
    columns.filter(|(_, unit)| !unit.is_empty()).map(|(name, unit)| (name.into(), unit.into())).collect()
}

/// The markers: time since the first sample and remark.
pub(super) fn markers(source: &Source) -> Vec<Value> {
    let marker = |marker: &crate::recording::Marker| json!({"t_s": marker.periods as f64 / source.settings.sample_rate_hz, "text": marker.text});
    source.markers.iter().map(marker).collect()
}
