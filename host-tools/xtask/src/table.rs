//! Committed tables of figures, and whether today's figures still match them.
//!
//! A table is a Markdown file under `docs/tables` whose rows read `| name | value | unit | goal |`. The limits are
//! two-sided: a figure that becomes much better is suspect too, since it may have stopped being measured.

use crate::tree;
use anyhow::{Context, Result, bail, ensure};
use serde_json::Value;
use std::{fmt::Display, fs, path::PathBuf};

/// How much a figure may change before the table must be updated, as a fraction. Compilers differ by about a percent; a
/// change to the code usually has a larger effect.
const TOLERANCE: f64 = 0.03;

/// Compare, or write.
#[derive(clap::Args)]
pub struct Options {
    /// Write the table instead of comparing with it
    #[arg(long)]
    pub update: bool,
}

/// One figure.
#[derive(Debug, PartialEq)]
pub struct Row {
    /// Name of the figure and of the row.
    pub name: String,
    pub value: f64,
    pub unit: &'static str,
    /// Goal: at most this.
    pub goal: Option<f64>,
    /// How much it may change before the table must be updated, as a fraction.
    pub tolerance: f64,
}

impl Row {
    /// A figure without a goal.
    pub fn new(name: impl Into<String>, value: f64, unit: &'static str) -> Self {
        Self { name: name.into(), value, unit, goal: None, tolerance: TOLERANCE }
    }

    /// A figure that varies from run to run.
    pub fn within(self, tolerance: f64) -> Self {
        Self { tolerance, ..self }
    }

    /// With a goal: at most this.
    pub fn at_most(self, goal: f64) -> Self {
        Self { goal: Some(goal), ..self }
    }

    /// Whether it misses its goal; NaN does.
    fn misses(&self) -> bool {
        self.goal.is_some_and(|goal| self.value.is_nan() || self.value > goal)
    }
}

/// Names of the figures that miss their goals.
pub fn missed(rows: &[Row]) -> String {
    rows.iter().filter(|row| row.misses()).map(|row| row.name.as_str()).collect::<Vec<_>>().join(", ")
}

/// A table of figures.
pub struct Table {
    /// File name under `docs/tables`, without `.md`; also the command that makes it.
    pub name: &'static str,
    /// First line.
    pub title: &'static str,
    /// What the figures mean and how they are measured.
    pub about: String,
    pub rows: Vec<Row>,
    /// Whether every run has the same figures, so that `cargo xtask test` can compare them.
    pub repeats: bool,
}

impl Table {
    /// The table as Markdown.
    fn markdown(&self) -> String {
        let mut text = format!("# {}\n\n{}\n\n", self.title, self.about.trim());
        let checked = if self.repeats { "; checked by `cargo xtask test`" } else { "" };
        text += &format!("Written by `cargo xtask {} --update`{checked}.\n\n", self.name);
        text.push_str("| figure | value | unit | goal |\n|---|--:|---|---|\n");
        for row in &self.rows {
            let reached = if row.misses() { "**missed**" } else { "reached" };
            let goal = row.goal.map(|goal| format!("at most {goal}, {reached}")).unwrap_or_default();
            text += &format!("| {} | {} | {} | {goal} |\n", row.name, figure(row.value), row.unit);
        }
        text
    }

    /// Prints the figures.
    pub fn print(&self) {
        for row in &self.rows {
            let mark = if row.misses() { "  over its goal" } else { "" };
            println!("  {:<44} {:>12} {}{mark}", row.name, figure(row.value), row.unit);
        }
    }

    /// Writes the table.
    pub fn write(&self) -> Result<()> {
        write_text(self.name, &self.markdown())
    }

    /// Prints the table, then writes it or compares it with the committed one.
    pub fn settle(&self, options: &Options) -> Result<()> {
        self.print();
        if options.update {
            return self.write();
        }
        let command = format!("cargo xtask {} --update", self.name);
        let faults = differences(&parse(&committed(self.name, &command)?), &self.rows);
        for fault in &faults {
            eprintln!("  {fault}");
        }
        ensure!(
            faults.is_empty(),
            "{} figures differ from docs/tables/{}.md; if that is intended, run `{command}` and commit the table",
            faults.len(),
            self.name
        );
        println!("{0}: {1} figures as in docs/tables/{0}.md", self.name, self.rows.len());
        Ok(())
    }
}

fn figure(value: f64) -> String {
    if value == value.trunc() { format!("{value}") } else { format!("{value:.1}") }
}

/// A number in `place`, by its path, such as `step.mean`.
pub fn number(value: &Value, path: &str, place: impl Display) -> Result<f64> {
    let found = path.split('.').try_fold(value, |value, name| value.get(name)).and_then(Value::as_f64);
    found.with_context(|| format!("no number `{path}` in {place}"))
}

/// The cells of a row that has so many.
pub fn cells<const N: usize>(line: &str) -> Option<[&str; N]> {
    let cells = line.strip_prefix("| ")?.strip_suffix(" |")?.split('|');
    cells.map(str::trim).collect::<Vec<_>>().try_into().ok()
}

/// Names and values of a table's rows; other lines are skipped.
fn parse(markdown: &str) -> Vec<(String, f64)> {
    let row = |line: &str| {
        let [name, value, ..] = cells::<4>(line)?;
        Some((name.to_owned(), value.parse().ok()?))
    };
    markdown.lines().filter_map(row).collect()
}

/// What differs by more than the tolerance, misses a goal that the table reached, or is in only one of the two.
fn differences(committed: &[(String, f64)], now: &[Row]) -> Vec<String> {
    let mut faults = Vec::new();
    for row in now {
        let said = match committed.iter().find(|(name, _)| *name == row.name) {
            None => "not in the table".to_owned(),
            Some((_, before))
                if (row.value - before).abs() > row.tolerance * before.abs() || !row.value.is_finite() =>
            {
                format!("the table says {}", figure(*before))
            }
            Some((_, before)) if row.goal.is_some_and(|goal| *before <= goal && row.value > goal) => {
                format!("which misses its goal; the table says {}", figure(*before))
            }
            Some(_) => continue,
        };
        faults.push(format!("{}: {} {}, {said}", row.name, figure(row.value), row.unit));
    }
    for (name, value) in committed {
        if !now.iter().any(|row| row.name == *name) {
            faults.push(format!("{name}: {} in the table, no longer measured", figure(*value)));
        }
    }
    faults
}

/// The file of a table.
fn path(name: &str) -> PathBuf {
    tree::root().join(format!("docs/tables/{name}.md"))
}

/// Writes a table and prints where.
pub fn write_text(name: &str, text: &str) -> Result<()> {
    let path = path(name);
    tree::make("docs/tables")?;
    tree::write(&path, text)?;
    println!("{name}: written {}", path.display());
    Ok(())
}

/// The committed table, which `command` makes.
fn committed(name: &str, command: &str) -> Result<String> {
    let path = path(name);
    fs::read_to_string(&path).with_context(|| format!("cannot read {}; make it with `{command}`", path.display()))
}

/// Writes a table that is only text, or compares it; `command` makes it.
pub fn settle_text(name: &str, command: &str, text: &str, update: bool) -> Result<()> {
    if update {
        return write_text(name, text);
    }
    let path = path(name);
    let committed = committed(name, &format!("{command} --update"))?;
    if committed == text {
        println!("{name}: as in {}", path.display());
        return Ok(());
    }
    let only_in = |one: &str, other: &str| -> String {
        one.lines().filter(|line| !other.lines().any(|same| same == *line)).map(|line| format!("\n{line}")).collect()
    };
    bail!(
        "{} differs.\nNew lines:{}\nMissing lines:{}\nIf the change is intended, run `{command} --update`",
        path.display(),
        only_in(text, &committed),
        only_in(&committed, text)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(value: f64) -> Table {
        Table {
            name: "size",
            title: "Size",
            about: "Of the image.".into(),
            rows: vec![Row::new("flash", value, "bytes").at_most(1000.0), Row::new("RAM", 10.5, "KB")],
            repeats: true,
        }
    }

    #[test]
    fn what_is_written_reads_back() {
        let table = table(900.0);
        assert_eq!(parse(&table.markdown()), [("flash".to_owned(), 900.0), ("RAM".to_owned(), 10.5)]);
        assert!(table.markdown().contains("| flash | 900 | bytes | at most 1000, reached |"));
        assert!(differences(&parse(&table.markdown()), &table.rows).is_empty());
    }

    #[test]
    fn both_sides_are_limited() {
        let committed = parse(&table(900.0).markdown());
        assert!(differences(&committed, &table(926.0).rows).is_empty());
        assert!(differences(&committed, &table(874.0).rows).is_empty());
        assert_eq!(differences(&committed, &table(928.0).rows), ["flash: 928 bytes, the table says 900"]);
        assert_eq!(differences(&committed, &table(872.0).rows).len(), 1);
        assert_eq!(differences(&committed, &table(f64::NAN).rows).len(), 1);
    }

    #[test]
    fn a_goal_that_was_reached_must_be_reached() {
        let reached = parse(&table(990.0).markdown());
        let missed = ["flash: 1001 bytes, which misses its goal; the table says 990"];
        assert_eq!(differences(&reached, &table(1001.0).rows), missed);
        assert!(differences(&reached, &table(1000.0).rows).is_empty());
        // The table says that it is missed.
        assert!(differences(&parse(&table(1001.0).markdown()), &table(1010.0).rows).is_empty());
    }

    #[test]
    fn a_figure_that_went_missing_is_a_fault() {
        let committed = parse(&table(900.0).markdown());
        let faults = differences(&committed, &table(900.0).rows[..1]);
        assert_eq!(faults, ["RAM: 10.5 in the table, no longer measured"]);
        assert_eq!(differences(&[], &table(900.0).rows).len(), 2);
    }

    #[test]
    fn a_goal_that_is_missed_is_said() {
        assert!(table(1100.0).markdown().contains("at most 1000, **missed**"));
    }
}
