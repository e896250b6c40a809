//! What every recording becomes.

use std::fmt::Write;

/// What keeps a file from being converted, in words.
pub type Error = Box<dyn std::error::Error + Send + Sync>;

/// Samples as the tests read them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples {
    /// Time, encoder count and force of each \[s, 1, N\].
    pub rows: Vec<(f64, i64, f64)>,
}

impl Samples {
    /// As a file.
    pub fn csv(&self) -> String {
        let mut text = String::from("t_s,encoder_count,force_n\n");
        for (t_s, count, force_n) in &self.rows {
            // Writing to a text cannot fail.
            let _ = writeln!(text, "{t_s:.6},{count},{force_n:.6}");
        }
        text
    }
}
