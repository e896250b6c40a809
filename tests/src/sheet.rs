//! Measured tables: written as Markdown, committed, and compared cell by cell with what is measured anew.

use crate::grid::Error;
use std::path::PathBuf;

/// Part by which a figure may differ from the committed one: mathematical libraries differ in the last digits of a
/// sine, which moves a few counts of a run.
pub const TOLERANCE: f64 = 0.02;

/// What is to be done with a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// All of it is measured, and compared with the committed one.
    Compare,
    /// The first of its rigs is, as long as all would take too long.
    CompareShort,
    /// All of it is measured and written.
    Update,
}

/// Writes `text` as `docs/tables/NAME.md`, or compares with it and says what differs. True when all that was measured is
/// as committed. `keys` is the number of columns that name a row.
pub fn conclude(name: &str, text: &str, keys: usize, asked: Asked) -> Result<bool, Error> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("../docs/tables/{name}.md"));
    if asked == Asked::Update {
        std::fs::create_dir_all(path.parent().unwrap_or(&path))?;
        std::fs::write(&path, text).map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        println!("{name}: written {}", path.display());
        return Ok(true);
    }
    let committed = std::fs::read_to_string(&path).map_err(|error| {
        format!("cannot read {}: {error}; make it by `cargo xtask {name} --update`", path.display())
    })?;
    let differences = match asked {
        Asked::CompareShort => changed(&rows(&committed, keys), &rows(text, keys)),
        Asked::Compare | Asked::Update => differences(&committed, text, keys),
    };
    for line in &differences {
        eprintln!("{line}");
    }
    if differences.is_empty() {
        println!("{name}: as in docs/tables/{name}.md");
    } else {
        eprintln!(
            "{name}: {} figures left docs/tables/{name}.md; when the change is meant, run `cargo xtask {name} --update` \
             and commit the table",
            differences.len()
        );
    }
    Ok(differences.is_empty())
}

/// `--update`, or nothing.
pub fn asked(name: &str) -> Result<Asked, Error> {
    match asked_or_short(name)? {
        Asked::CompareShort => Err(format!("usage: cargo xtask {name} [--update]").into()),
        asked => Ok(asked),
    }
}

/// `--update`, `--short`, or nothing.
pub fn asked_or_short(name: &str) -> Result<Asked, Error> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.as_slice() {
        [] => Ok(Asked::Compare),
        [word] if word == "--short" => Ok(Asked::CompareShort),
        [word] if word == "--update" => Ok(Asked::Update),
        _ => Err(format!("usage: cargo xtask {name} [--short | --update]").into()),
    }
}

/// Three digits of a number; nothing of what is none.
pub fn significant(value: f64) -> String {
    if value.is_finite() { format!("{value:.*}", decimals(value)) } else { "-".into() }
}

/// A mean to the digits of its scatter.
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
pub fn line(cells: &[String]) -> String {
    format!("| {} |\n", cells.join(" | "))
}

/// A row: its name, by section and leading cells, which of the rows of this name it is, and the other cells with the heads of their columns,
/// which may be alike as well.
type Row = ((String, usize), Vec<(String, String)>);

/// Cells of the second document that are not those of the first within the tolerance, and rows of one of them only.
pub fn differences(committed: &str, now: &str, keys: usize) -> Vec<String> {
    let (committed, now) = (rows(committed, keys), rows(now, keys));
    let mut differences = changed(&committed, &now);
    for ((name, place), cells) in &committed {
        match now.iter().find(|((other, other_place), _)| other == name && other_place == place) {
            Some((_, now)) if now.len() >= cells.len() => {}
            Some(_) => differences.push(format!("{name}: has columns in the table that are no longer measured")),
            None => differences.push(format!("{name}: in the table, no longer measured")),
        }
    }
    differences
}

/// Cells of the second rows that are not those of the first.
fn changed(committed: &[Row], now: &[Row]) -> Vec<String> {
    let mut differences = Vec::new();
    for (key, cells) in now {
        let (name, _) = key;
        let Some((_, before)) = committed.iter().find(|(other, _)| other == key) else {
            differences.push(format!("{name}: not in the table"));
            continue;
        };
        let find = |column: &str| before.iter().find(|(other, _)| other == column).map_or("", |(_, cell)| cell);
        for (place, (column, cell)) in cells.iter().enumerate() {
            // A mean is as uncertain as its scatter says.
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
            let name = [section]
                .into_iter()
                .filter(|name| !name.is_empty())
                .chain(cells.iter().take(keys).map(String::as_str));
            let name = name.collect::<Vec<_>>().join(", ");
            let before = rows.iter().filter(|((other, _), _)| *other == name).count();
            rows.push(((name, before), head.iter().cloned().zip(cells).skip(keys).collect()));
        }
    }
    rows
}

/// Numbers agree within the tolerance, of `beside` where that is greater, and a unit of their last digit, as both may have
/// been rounded the other way; words to the letter.
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
    fn what_moves_is_named() {
        assert!(differences(TABLE, &TABLE.replace("1.50", "1.53"), 1).is_empty());
        assert_eq!(differences(TABLE, &TABLE.replace("1.50", "1.60"), 1), ["one, x: b 1.60, the table says 1.50"]);
        assert_eq!(differences(TABLE, &TABLE.replace("no", "yes"), 1), ["one, y: c yes, the table says no"]);
        assert_eq!(differences(TABLE, &TABLE.replace("| y |", "| z |"), 1).len(), 2);
    }

    #[test]
    fn a_part_of_a_table_is_compared_alone() {
        let part = |now: &str| changed(&rows(TABLE, 1), &rows(now, 1));
        assert!(part("## one\n\n| a | b | c |\n|---|--:|---|\n| y | - | no |\n").is_empty());
        assert_eq!(part("## one\n\n| a | b | c |\n|---|--:|---|\n| y | 1 | no |\n"), ["one, y: b 1, the table says -"]);
        assert_eq!(part("## two\n\n| a | b | c |\n|---|--:|---|\n| y | - | no |\n"), ["two, y: not in the table"]);
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
        let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../docs/tables");
        let mut tables = 0;
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|extension| extension == "md") {
                let text = std::fs::read_to_string(&path).unwrap();
                for keys in 1..=3 {
                    assert_eq!(differences(&text, &text, keys), [""; 0], "{}", path.display());
                }
                tables += 1;
            }
        }
        assert!(tables > 15, "{tables}");
    }
}
