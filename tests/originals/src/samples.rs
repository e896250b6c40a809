//! What every recording becomes.

use std::fmt::Write;

/// What keeps a file from being converted, in words.
pub type Error = Box<dyn std::error::Error + Send + Sync>;

/// Time, encoder count and force of a sample \[s, 1, N\].
pub type Row = (f64, i64, f64);

/// Samples as the tests read them.
pub fn csv(rows: &[Row]) -> String {
    let mut text = String::from("t_s,encoder_count,force_n\n");
    for (t_s, count, force_n) in rows {
        // Writing to a text cannot fail.
        let _ = writeln!(text, "{t_s:.6},{count},{force_n:.6}");
    }
    text
}
