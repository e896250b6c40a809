//! Measured tables: written as Markdown, committed, and compared cell by cell with new measurements.

use crate::grid::{Column, Result};
use std::{
    fmt::Display,
    fs,
    path::{Path, PathBuf},
    str::FromStr,
};

/// Maximum relative difference from the committed figure. Mathematical libraries differ in the last digits of a sine,
/// which moves a few counts of a run.
pub const TOLERANCE: f64 = 0.02;

/// Maximum length of a line of text; rows of tables may be longer.
const COLUMNS: usize = 100;

/// What to do with a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// Measure all of it, and compare with the committed table.
    Compare,
    /// Measure only the first of its rigs, because all would take too long; compare the sections measured.
    CompareShort,
    /// Measure all of it and write the table.
    Update,
}

/// A measured table, and whether its figures are good.
pub type Measured = Result<(String, bool)>;

/// Measures a table, prints it and concludes. Accepts `--update`, or nothing, or `--short` if the table can be measured
/// in part. Returns true if everything measured is good and agrees with the committed table.
pub fn measured(
    name: &str,
    words: &[&str],
    keys: usize,
    can_be_short: bool,
    measure: fn(Asked) -> Measured,
) -> Result<bool> {
    let asked = asked(name, words, can_be_short)?;
    let (text, is_good) = measure(asked)?;
    print!("{text}");
    Ok(conclude(name, &text, keys, asked)? && is_good)
}

/// What these words ask for.
pub fn asked(name: &str, words: &[&str], can_be_short: bool) -> Result<Asked> {
    match words {
        [] => Ok(Asked::Compare),
        ["--update"] => Ok(Asked::Update),
        ["--short"] if can_be_short => Ok(Asked::CompareShort),
        _ => {
            Err(format!("usage: cargo xtask {name} [{}--update]", if can_be_short { "--short | " } else { "" }).into())
        }
    }
}

/// Writes `text` as `docs/tables/NAME.md`, or compares it with that file and reports differences. Returns true if
/// everything measured agrees with the committed table. `keys` is the number of columns that identify a row.
pub fn conclude(name: &str, text: &str, keys: usize, asked: Asked) -> Result<bool> {
    let below_docs = format!("tables/{name}.md");
    if asked == Asked::Update {
        println!("{name}: written {}", write(&below_docs, text)?.display());
        return Ok(true);
    }
    let path = docs().join(below_docs);
    let committed = fs::read_to_string(&path).map_err(|error| {
        format!("cannot read {}: {error}; make it by `cargo xtask {name} --update`", path.display())
    })?;
    let differences = match asked {
        Asked::CompareShort => differences_in_part(&committed, text, keys),
        Asked::Compare | Asked::Update => differences(&committed, text, keys),
    };
    for line in &differences {
        eprintln!("{line}");
    }
    if differences.is_empty() {
        let part = if asked == Asked::CompareShort { "the first rig is " } else { "" };
        println!("{name}: {part}as in docs/tables/{name}.md");
    } else {
        eprintln!(
            "{name}: {} figures differ from docs/tables/{name}.md; if that is intended, run \
             `cargo xtask {name} --update` and commit the table",
            differences.len()
        );
    }
    Ok(differences.is_empty())
}

fn docs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs")
}

/// Writes a file below `docs`; returns its path.
pub fn write(below_docs: &str, text: &str) -> Result<PathBuf> {
    let path = docs().join(below_docs);
    fs::create_dir_all(path.parent().unwrap_or(&path))?;
    fs::write(&path, text).map_err(|error| format!("cannot write {}: {error}", path.display()))?;
    Ok(path)
}

/// The column of errors with their half widths, in the order of the widths, and the median half width.
pub fn by_width(found: impl Iterator<Item = (f64, f64)>) -> (Column, f64) {
    let mut found: Vec<_> = found.collect();
    found.sort_by(|(_, a), (_, b)| a.total_cmp(b));
    let median = found.get(found.len() / 2).map_or(f64::NAN, |(_, u95)| *u95);
    (Column::of(found.into_iter()), median)
}

/// The number of these in the first word, which may have underscores; `usual` without a word.
pub fn number<N: FromStr>(words: &[&str], usual: N, these: &str) -> Result<N> {
    let Some(word) = words.first() else { return Ok(usual) };
    word.replace('_', "").parse().map_err(|_| format!("`{word}` is no number of {these}").into())
}

/// Three digits of a number; a dash if it is not finite.
pub fn significant(value: f64) -> String {
    if value.is_finite() { format!("{value:.*}", decimals(value)) } else { "-".into() }
}

/// A mean with three digits of its scatter.
pub fn mean(bias: f64, sigma: f64) -> String {
    if bias.is_finite() { format!("{bias:.*}", decimals(sigma)) } else { "-".into() }
}

/// Decimals that show three digits of `value`.
fn decimals(value: f64) -> usize {
    if value == 0.0 || !value.is_finite() {
        return 0;
    }
    (2.0 - value.abs().log10().floor()).clamp(0.0, 9.0) as usize
}

/// One line of a table.
pub fn line(cells: impl IntoIterator<Item = impl Display>) -> String {
    cells.into_iter().fold("|".to_owned(), |line, cell| format!("{line} {cell} |")) + "\n"
}

/// The same, from the cells that name it and the others.
pub fn row(names: &[&str], cells: impl IntoIterator<Item = String>) -> String {
    line(names.iter().map(|name| (*name).to_owned()).chain(cells))
}

/// Each sentence as an item of a list; `None.` if there is none.
pub fn list(sentences: &[String]) -> String {
    if sentences.is_empty() {
        return "None.\n".into();
    }
    sentences.iter().map(|sentence| item(&format!("{sentence}."))).collect()
}

/// An item of a list, wrapped at 100 columns.
pub fn item(text: &str) -> String {
    let (mut item, mut column) = ("-".to_owned(), 1);
    for word in text.split(' ') {
        let length = 1 + word.chars().count();
        if column + length > COLUMNS {
            item += "\n ";
            column = 1;
        }
        item += " ";
        item += word;
        column += length;
    }
    item + "\n"
}

/// A part as a percentage; a dash if there is none.
pub fn percent(part: Option<f64>) -> String {
    part.map_or("-".into(), |part| format!("{:.1}", part * 100.0))
}

/// A row of a table.
struct Row {
    section: String,
    /// Its name, section and leading cells, and its number among the rows with this name.
    key: (String, usize),
    /// The other cells with their column headings; several columns may have the same heading.
    cells: Vec<(String, String)>,
}

/// Cells of the new document that differ from the committed ones by more than the tolerance, and rows that exist in
/// only one of the two.
pub fn differences(committed: &str, now: &str, keys: usize) -> Vec<String> {
    between(&rows(committed, keys), &rows(now, keys))
}

/// The differences in those sections of the committed document that the new one has; it must have at least one.
fn differences_in_part(committed: &str, now: &str, keys: usize) -> Vec<String> {
    let now = rows(now, keys);
    if now.is_empty() {
        return vec!["nothing was measured".into()];
    }
    let mut committed = rows(committed, keys);
    committed.retain(|row| now.iter().any(|other| other.section == row.section));
    between(&committed, &now)
}

fn between(committed: &[Row], now: &[Row]) -> Vec<String> {
    let mut differences = Vec::new();
    for Row { key, cells, .. } in now {
        let (name, _) = key;
        let Some(Row { cells: before, .. }) = committed.iter().find(|other| other.key == *key) else {
            differences.push(format!("{name}: not in the table"));
            continue;
        };
        let find = |column: &str| before.iter().find(|(other, _)| other == column).map_or("", |(_, cell)| cell);
        for (place, (column, cell)) in cells.iter().enumerate() {
            // A mean is as uncertain as its scatter.
            let beside = match column.strip_suffix("bias") {
                Some(of) => find(&format!("{of}sigma")).parse().unwrap_or(0.0),
                None => 0.0,
            };
            let before = before.get(place).filter(|(other, _)| other == column).map_or("", |(_, cell)| cell);
            if !same(before, cell, beside) {
                differences.push(format!("{name}: {column} {cell}, the table says {before}"));
            }
        }
    }
    for Row { key, cells, .. } in committed {
        let (name, _) = key;
        match now.iter().find(|other| other.key == *key) {
            Some(now) if now.cells.len() >= cells.len() => {}
            Some(_) => differences.push(format!("{name}: has columns in the table that are no longer measured")),
            None => differences.push(format!("{name}: in the table, no longer measured")),
        }
    }
    differences
}

fn rows(markdown: &str, keys: usize) -> Vec<Row> {
    let (mut section, mut head, mut rows) = ("", Vec::new(), Vec::<Row>::new());
    for line in markdown.lines() {
        if let Some(title) = line.strip_prefix("## ").or_else(|| line.strip_prefix("### ")) {
            (section, head) = (title, Vec::new());
        }
        let Some(line) = line.strip_prefix('|').and_then(|line| line.strip_suffix('|')) else {
            head.clear();
            continue;
        };
        let cells: Vec<String> = line.split('|').map(|cell| cell.trim().to_owned()).collect();
        if head.is_empty() {
            head = cells;
        } else if !cells[0].starts_with("--") {
            let names = Some(section).filter(|name| !name.is_empty()).into_iter();
            let names = names.chain(cells.iter().take(keys).map(String::as_str)).collect::<Vec<_>>();
            let name = names.join(", ");
            let place = rows.iter().filter(|row| row.key.0 == name).count();
            let cells = head.iter().cloned().zip(cells).skip(keys).collect();
            rows.push(Row { section: section.into(), key: (name, place), cells });
        }
    }
    rows
}

/// Numbers agree within the tolerance, relative to `beside` if that is greater, plus one unit of the last digit,
/// because both are rounded. Words must be identical.
fn same(before: &str, now: &str, beside: f64) -> bool {
    let number = |cell: &str| {
        let cell = cell.trim_matches('*');
        let decimals = cell.split_once('.').map_or(0, |(_, behind)| behind.len());
        cell.parse::<f64>().ok().map(|value| (value, 10_f64.powi(-(decimals as i32))))
    };
    match (number(before), number(now)) {
        (Some((a, digit_a)), Some((b, digit_b))) => {
            (a - b).abs() <= TOLERANCE * a.abs().max(beside) + 1.001 * digit_a.max(digit_b)
        }
        _ => before == now,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLE: &str = "# T\n\n## one\n\n| a | b | c |\n|---|--:|---|\n| x | 1.50 | yes |\n| y | - | no |\n";

    #[test]
    fn a_mean_may_move_with_its_scatter() {
        let table = |bias: &str| format!("| a | bias | sigma |\n|---|---|---|\n| x | {bias} | 5.00 |\n");
        assert!(differences(&table("0.10"), &table("0.20"), 1).is_empty());
        assert_eq!(differences(&table("0.10"), &table("0.30"), 1).len(), 1);
    }

    #[test]
    fn items_are_wrapped() {
        let word = "a".repeat(COLUMNS - 2);
        assert_eq!(item(&word), format!("- {word}\n"));
        assert_eq!(item(&format!("{word} b c")), format!("- {word}\n  b c\n"));
        assert_eq!(list(&["a b".into()]), "- a b.\n");
    }

    #[test]
    fn what_moves_is_named() {
        assert!(differences(TABLE, &TABLE.replace("1.50", "1.53"), 1).is_empty());
        assert_eq!(differences(TABLE, &TABLE.replace("1.50", "1.60"), 1), ["one, x: b 1.60, the table says 1.50"]);
        assert_eq!(differences(TABLE, &TABLE.replace("no", "yes"), 1), ["one, y: c yes, the table says no"]);
        assert_eq!(differences(TABLE, &TABLE.replace("| y |", "| z |"), 1).len(), 2);
    }

    #[test]
    fn a_part_of_a_table_is_compared_alone() {
        let table = format!("{TABLE}\n## two\n\n| a | b |\n|---|--:|\n| z | 7 |\n");
        assert_eq!(differences_in_part(&table, TABLE, 1), [""; 0]);
        assert_eq!(differences_in_part(&table, &TABLE.replace("1.50", "1.60"), 1).len(), 1);
        let gone = TABLE.replace("| y | - | no |\n", "");
        assert_eq!(differences_in_part(&table, &gone, 1), ["one, y: in the table, no longer measured"]);
        assert_eq!(differences_in_part(&table, &TABLE.replace("one", "three"), 1).len(), 2);
        assert_eq!(differences_in_part(&table, "", 1).len(), 1);
    }

    #[test]
    fn columns_and_rows_of_one_name_are_told_apart() {
        let table = "| a | b | % | c | % |\n|---|---|---|---|---|\n| x | 1 | 90 | 2 | 95 |\n| x | 3 | 91 | 4 | 96 |\n";
        assert!(differences(table, table, 1).is_empty());
        for (cell, other) in [("90", "80"), ("95", "85"), ("91", "81"), ("96", "86"), ("4 |", "8 |")] {
            assert_eq!(differences(table, &table.replace(cell, other), 1).len(), 1, "{cell}");
        }
        assert_eq!(differences(table, &table.replace("| 4 | 96 |", "|"), 1).len(), 1);
        assert_eq!(differences(table, &table.replace("| x | 3 | 91 | 4 | 96 |\n", ""), 1).len(), 1);
    }

    #[test]
    fn each_committed_table_agrees_with_itself() {
        let mut tables = 0;
        for entry in fs::read_dir(docs().join("tables")).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|extension| extension == "md") {
                let text = fs::read_to_string(&path).unwrap();
                for keys in 1..=3 {
                    assert_eq!(differences(&text, &text, keys), [""; 0], "{}", path.display());
                }
                tables += 1;
            }
        }
        assert!(tables > 15, "{tables}");
    }
}
