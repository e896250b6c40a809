//! ARTS: `{"data": [[time, displacement, friction force, ..], ..]}` in seconds, inches and kip, as their repository
//! says.

use crate::samples::{Error, Row};
use serde_json::Value;

/// An inch in counts of 1 um.
const COUNTS_PER_INCH: f64 = 25_400.0;
/// A kip in newtons.
const N_PER_KIP: f64 = 4448.22;

/// Displacement in counts, force in newtons.
pub fn samples(bytes: &[u8]) -> Result<Vec<Row>, Error> {
    let json: Value = serde_json::from_slice(bytes)?;
    let rows = json["data"].as_array().ok_or("no list `data`")?.iter().enumerate();
    let rows = rows.map(|(place, row)| {
        let number = |column: usize| row[column].as_f64().ok_or(format!("row {place}: no number in column {column}"));
        Ok((number(0)?, (number(1)? * COUNTS_PER_INCH).round() as i64, number(2)? * N_PER_KIP))
    });
    Ok(rows.collect::<Result<_, String>>()?)
}
