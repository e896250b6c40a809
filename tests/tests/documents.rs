//! Figures quoted in a document equal those of the quoted table.

use std::{fs, path::Path};

/// A document, a template of the table's text with named figures, and a template of the document's sentence.
struct Quote {
    document: &'static str,
    table: &'static str,
    stands: &'static str,
    quoted: &'static str,
}

const fn validation(table: &'static str, stands: &'static str, quoted: &'static str) -> Quote {
    Quote { document: "VALIDATION", table, stands, quoted }
}

const fn testing(table: &'static str, stands: &'static str, quoted: &'static str) -> Quote {
    Quote { document: "TESTING", table, stands, quoted }
}

const QUOTES: [Quote; 40] = [
    validation(
        "coverage",
        "{right} of {all} rows are not bold. In {wide} rows the coverage is above 95 % by more than chance explains.",
        "Of {all} cells on seven benches {right} are right. In {wide} the coverage is above 95 % by more than chance explains",
    ),
    validation(
        "coverage",
        "In each of {all} cells the coverage is at least {least} %. The rms is over 0.6 in {over} of them, and \
         under 0.25 in {under}.",
        "in {all} cells the coverage is at least {least} %. The rms is over 0.6 in {over} of them and under 0.25 in {under}",
    ),
    validation(
        "coverage",
        "With all sources wrong, {within} of {all} cells have a coverage of 93 to 97 %",
        "With all settings wrong at once {within} of {all} cells reach it",
    ),
    validation(
        "coverage",
        "With one source wrong, {within} of {all} cells have a coverage of 93 to 97 %, {under} have less and {over} \
         have more.",
        "With one setting wrong at a time {under} of {all} cells are under 93 %; {over} are over 97 %",
    ),
    validation(
        "coverage",
        "Where the law leaves at least 5 % of the violation's regressor unexplained, {held} of {all} reach it.",
        "{held} of {all} such cells reach 90 %",
    ),
    validation(
        "coverage",
        "The goal is a coverage of 90 % in the silent runs of a cell. Of {all} cells with silent runs, {held} reach \
         it and {other} miss it.",
        "and {held} of all {all} cells ([all cells](tables/coverage.md#all-cells))",
    ),
    validation("coverage", "The lowest coverage is {least} %, in", "The worst have {least} %. Friction"),
    validation(
        "coverage",
        "In {named} cells `replay` reports that the parameter assumes the absence of the violation (`assumes`): \
         {not} of the cells that miss the goal and {held} of those that reach it. Cells that miss the goal without \
         this report: 0.",
        "In all {not} cells that miss the goal, `replay` reports",
    ),
    validation(
        "coverage",
        "In {named} cells `replay` reports that the parameter assumes the absence of the violation (`assumes`): \
         {not} of the cells that miss the goal and {held} of those that reach it.",
        "it is made in {named} of all cells, and {held} of those reach the goal",
    ),
    validation(
        "merge",
        "The interval contains the mean value in {mt} % of {} cases for mt, {cf} % of {} for cf and {fc} % of {} \
         for fc.",
        "The true value lies in {mt} % of the intervals of `mt`, {cf} % of `cf` and {fc} % of `fc`",
    ),
    validation(
        "merge",
        "Of {groups} groups of more than one run of a device that does not vary, 0 are reported to differ.",
        "In none of {groups} groups is a device that stays the same reported to differ",
    ),
    Quote {
        document: "THEORY",
        table: "merge",
        stands: "cf and {least} % of {all} for fc. Of {groups} groups of more than one run of a device that does \
         not vary, 0 are reported to differ.",
        quoted: "at least {least} % of {all} intervals hold each parameter, and none of {groups} groups",
    },
    validation("diagnose", "| all | {runs} | {first} | {sized} |", "Over all runs it is {sized} %"),
    validation(
        "diagnose",
        "| where the motion shows enough | {runs} | {first} | {sized} |",
        "of the fault, judged by the plant's true values, it is {sized} %",
    ),
    validation("plan", "| fixed motions | {within} of {all} (", "in {within} of {all} cells of the grid's motions"),
    validation("plan", "| designed motions | {within} of {all} (", "{within} of {all} of the designed ones"),
    validation("plan", "| fixed motions | {within} of {all} (farthest {far})", "0.5 um: {far} of what is predicted"),
    validation(
        "defects",
        "| defects | {runs} | {harmful} | {told} | {assumed} | {silent} | {part} | {device} | {twice} |",
        "it is reached by `replay`: {part} % of {runs} runs, {twice} % where the value is off by more than twice",
    ),
    validation(
        "defects",
        "| defects | {runs} | {harmful} | {told} | {assumed} | {silent} | {part} | {device} | {twice} |",
        "In {assumed} further runs the only message",
    ),
    validation(
        "defects",
        "| defects | {runs} | {harmful} | {told} | {assumed} | {silent} | {part} | {device} | {twice} |",
        "The device alone, without the samples, is silent in {device} %.",
    ),
    validation(
        "defects",
        "| clean | {runs} | {harmful} | {told} | {assumed} | {silent} | {part} | {device} | {twice} |",
        "For clean runs these figures are {part} % and {twice} %.",
    ),
    validation(
        "defects",
        "| other message | |---|--:|--:| | {runs} | {broken} | {word} |",
        "and are {broken} of {runs}, both of two tones",
    ),
    testing(
        "chaos",
        "| {all} behaviours x {commands} commands; {ended} runs ended by themselves, 0 were late",
        "{all} behaviours of a device, {commands} commands",
    ),
    testing("chaos", ", ms to end after a signal {ms} (", "at most {ms} ms after a signal"),
    testing(
        "chaos",
        ", ms to end after the device disconnected {ms} (",
        "{ms} ms after the device disconnected (`monitor`)",
    ),
    testing(
        "chaos",
        " ended by themselves, 0 were late and repeated; maxima: memory in kB {kb} (",
        "and {kb} kB of memory",
    ),
    testing(
        "chaos",
        "| {all} floods x {commands} commands for 8 s; maximum: memory in kB {kb} (",
        "({kb} kB in one of {all} floods)",
    ),
    testing(
        "chaos",
        "| {cuts} connections cut off, after {least} to {most} bytes",
        "{cuts} connections cut off after {least} to {most} bytes",
    ),
    testing("chaos", "| {hosts} hosts connected and disconnected, ", "{hosts} hosts that connected and disconnected"),
    testing(
        "chaos",
        "| {kills} kills of `record` and `monitor --record`; at most {s} s lost",
        "{kills} kills: at most {s} s lost",
    ),
    testing(
        "chaos",
        "| {kills} kills of `store add`, {left} left unfinished files",
        "{kills} kills, {left} of which left unfinished files",
    ),
    testing("chaos", "| {kills} kills of `settings set`", "{kills} kills of `settings set`"),
    testing(
        "chaos",
        " runs of {commands} commands, each with {outlets} states of its outputs",
        "{commands} commands, each with {outlets} states",
    ),
    testing(
        "chaos",
        "| {closed} terminals closed; each program ended within {ms} ms",
        "{closed} closed terminals: each program ended within {ms} ms",
    ),
    testing(
        "chaos",
        " bytes read by the slow readers: {samples} samples recorded",
        "{samples} samples at 4 kHz with readers that do not read",
    ),
    testing(
        "soak",
        " | 0.60 | {samples} | {lost} | {grown} | {apart} |",
        "{samples} samples in three recordings, {lost} lost; no process grew by more than {grown} %, and samples and the host's clock were {apart} s apart",
    ),
    testing(
        "soak",
        " | 0.10 | {samples} | {lost} | {grown} |",
        "{samples} samples in four recordings, {lost} lost; no process grew by more than {grown} %",
    ),
    testing(
        "../../tests/mutants/wire",
        " files, {caught} of {all} mutants are caught ({percent} %",
        "| {all} | {caught} ({percent} %) |",
    ),
    testing(
        "../../tests/mutants/core",
        " In a sample, {caught} of {all} mutants are caught ({percent} %, goal 95 %). \
         Of all mutants, {least} to {most} % are",
        "| {all} | {caught} ({percent} %; {least} to {most} % of all) |",
    ),
    testing(
        "../../tests/mutants/app",
        " In a sample, {caught} of {all} mutants are caught ({percent} %, goal 95 %). \
         Of all mutants, {least} to {most} % are",
        "| {all} | {caught} ({percent} %; {least} to {most} % of all) |",
    ),
];

/// A document below `docs`, with its white space normalised.
fn document(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs").join(name).with_extension("md");
    let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The names in a template and the figures at their places in a text.
fn figures<'a>(text: &str, template: &'a str) -> Option<Vec<(&'a str, String)>> {
    let (begin, names) = template.split_once('{')?;
    text.match_indices(begin).find_map(|(at, _)| {
        let mut rest = text.get(at + begin.len()..)?;
        let mut found = Vec::new();
        for part in names.split('{') {
            let (name, then) = part.split_once('}')?;
            let end = rest.find(|c: char| !c.is_ascii_digit() && !".-".contains(c)).unwrap_or(rest.len());
            // A full stop at the end belongs to the sentence.
            let figure = rest.get(..end)?.trim_end_matches('.');
            rest = rest.get(figure.len()..)?.strip_prefix(then)?;
            found.push((name, figure.to_string()));
        }
        Some(found)
    })
}

#[test]
fn quoted_figures_stand_in_their_tables() {
    let wrong: Vec<String> = QUOTES
        .iter()
        .filter_map(|Quote { document: name, table, stands, quoted }| {
            let Some(figures) = figures(&document(&format!("tables/{table}")), stands) else {
                return Some(format!("tables/{table} lacks: {stands}"));
            };
            let sentence = figures
                .iter()
                .fold((*quoted).to_string(), |text, (name, figure)| text.replace(&format!("{{{name}}}"), figure));
            (!document(name).contains(&sentence)).then(|| format!("{name} lacks: {sentence}"))
        })
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The lines of text outside code blocks and tables, and without those that are a code span alone.
fn prose(text: &str) -> impl Iterator<Item = &str> {
    let mut is_code = false;
    text.lines().filter(move |line| {
        let is_fence = line.trim_start().starts_with("```");
        is_code ^= is_fence;
        let is_span =
            line.starts_with('`') && line.trim_end_matches(',').ends_with('`') && line.matches('`').count() == 2;
        !is_code && !is_fence && !is_span && !line.starts_with('|')
    })
}

#[test]
fn prose_is_wrapped_at_100_columns() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut long = Vec::new();
    for folder in ["", "docs", "docs/tables", "tests/mutants"] {
        let files = fs::read_dir(root.join(folder)).unwrap().map(|file| file.unwrap().path());
        let files: Vec<_> = files.filter(|file| file.extension().is_some_and(|is| is == "md")).collect();
        assert!(files.len() > 2, "{folder}");
        for file in files {
            let text = fs::read_to_string(&file).unwrap();
            let lines = prose(&text).filter(|line| line.chars().count() > 100);
            long.extend(lines.map(|line| format!("{}: {line}", file.display())));
        }
    }
    assert!(long.is_empty(), "{}", long.join("\n"));
}

#[test]
fn figures_are_found_where_all_around_them_stands() {
    let text = "1 of 3 runs. In 12.5 % of 7 runs, of which 4.";
    let found = figures(text, "In {part} % of {all} runs").unwrap();
    assert_eq!(found, [("part", "12.5".to_string()), ("all", "7".to_string())]);
    assert_eq!(figures(text, "In {part} % of {all} cells"), None);
}
