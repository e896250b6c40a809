use std::io::{self, Read};

use super::{
    super::lines::{as_far_as_needed, decimals},
    *,
};

fn error(text: &str) -> String {
    parse("run.csv", text.as_bytes()).unwrap_err().to_string()
}

#[test]
fn columns_come_in_any_order_among_others_with_comments_blank_lines_crlf_and_a_mark() {
    let text = "\u{feff}# rig 3\r\n\r\nForce_N, note ,encoder_count,t_s,terminal_m\r\n1.5,x,149.0,0.000,0.1\r\n% pause\r\n-2,\"y,z\",150,0.001,0.2\r\n";
    let table = parse("run.csv", text.as_bytes()).unwrap();
    assert_eq!(table.t_s, [0.0, 0.001]);
    assert_eq!(table.encoder_count, [149, 150]);
    assert_eq!(table.force_n, [1.5, -2.0]);
    assert_eq!(table.terminal_m, [0.1, 0.2]);
    assert_eq!(table.line, [4, 6]);
    assert_eq!(table.time_decimals, 3);
}

#[test]
fn european_excel_is_understood() {
    let table = parse("run.csv", b"t_s;encoder_count;force_n\r\n0,000;5;1,25\r\n0,001;6;-1,5\r\n").unwrap();
    assert_eq!((table.t_s, table.force_n), (vec![0.0, 0.001], vec![1.25, -1.5]));
}

#[test]
fn an_empty_file_is_named() {
    for text in ["", "\n\n", "# only a comment\n", "t_s,encoder_count,force_n\n"] {
        assert_eq!(error(text), "run.csv is empty");
    }
}

#[test]
fn a_missing_column_is_named_with_the_one_that_may_be_meant() {
    let problem = parse("run.csv", b"t_s,encoder,force_n\n0,1,2\n").unwrap_err();
    assert_eq!(problem.to_string(), "run.csv, line 1: the column `encoder_count` is missing");
    use miette::Diagnostic;
    assert!(problem.help().unwrap().to_string().contains("if `encoder` is that column, rename it"));
    assert!(error("a,b,c\n1,2,3\n").contains("`t_s` is missing"));
    assert!(error("0,1,2\n1,2,3\n").contains("the header is missing"));
    assert!(error("t_s,force_n,encoder_count,force_n\n").contains("`force_n` appears twice"));
}

#[test]
fn columns_of_two_kinds_of_machine_are_refused_and_one_alone_asks_for_its_own() {
    let mixed = |other: &str, force: &str| format!("the column `{other}` does not go with `{force}`");
    assert!(error("t_s,encoder_count,force_n,terminal_rad\n").contains(&mixed("terminal_rad", "force_n")));
    assert!(error("t_s,encoder_count,torque_n_m,terminal_m\n").contains(&mixed("terminal_m", "torque_n_m")));
    assert!(error("t_s,encoder_count,force_n,torque_n_m\n").contains(&mixed("force_n", "torque_n_m")));
    assert!(error("t_s,encoder_count,terminal_rad\n").contains("`torque_n_m` is missing"));
    assert!(error("t_s,encoder_count,terminal_m\n").contains("`force_n` is missing"));
}

#[test]
fn text_in_a_number_names_line_and_column() {
    let head = "t_s,encoder_count,force_n\n0.000,1,2\n";
    for (row, expected) in [
        ("0.001,2,abc\n", "run.csv, line 3, column force_n: `abc` is not a number"),
        ("0.001,2,NaN\n", "run.csv, line 3, column force_n: the value is not finite (NaN)"),
        ("0.001,2,inf\n", "run.csv, line 3, column force_n: the value is not finite (inf)"),
        ("0.001,,2\n", "run.csv, line 3, column encoder_count: the cell is empty"),
        ("0.001,2.5,2\n", "run.csv, line 3, column encoder_count: 2.5 is not a whole number of counts"),
        ("0.001,1e300,2\n", "run.csv, line 3, column encoder_count: 1e300 is not a whole number of counts"),
        ("x,2,2\n", "run.csv, line 3, column t_s: `x` is not a number"),
        ("0.001,2\n", "run.csv, line 3: the line ends before the column `force_n`"),
    ] {
        assert_eq!(error(&format!("{head}{row}")), expected);
    }
}

#[test]
fn time_must_advance() {
    let head = "t_s,encoder_count,force_n\n0.000,1,2\n0.002,1,2\n";
    assert_eq!(
        error(&format!("{head}0.001,1,2\n")),
        "run.csv, line 4, column t_s: time goes backwards from 0.002 to 0.001"
    );
    assert_eq!(
        error(&format!("{head}0.002,1,2\n")),
        "run.csv, line 4, column t_s: time stands still from 0.002 to 0.002"
    );
}

#[test]
fn a_last_line_that_is_cut_off_costs_only_itself() {
    let head = "t_s,encoder_count,force_n\n0.000,1,2\n";
    for tail in ["0.001,", "0.001,2,-", "0.0"] {
        let table = parse("run.csv", format!("{head}{tail}").as_bytes()).unwrap();
        assert_eq!((table.t_s.len(), table.notes.len()), (1, 1));
    }
    assert_eq!(parse("run.csv", format!("{head}0.001,2,-3").as_bytes()).unwrap().force_n, [2.0, -3.0]);
}

#[test]
fn decimals_of_written_times() {
    assert_eq!([decimals("0.001"), decimals("1e-3"), decimals("1.25e1"), decimals("7")], [3, 3, 1, 0]);
}

proptest::proptest! {
    #[test]
    fn no_bytes_panic(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..400)) {
        let _ = parse("run.csv", &bytes);
    }

    #[test]
    fn no_cells_panic(rows in proptest::collection::vec("[-0-9.,;e\"\t naif#]{0,24}", 0..20)) {
        let _ = parse("run.csv", format!("t_s,encoder_count,force_n\n{}", rows.join("\n")).as_bytes());
    }
}

#[test]
fn lines_end_by_either_character_or_both() {
    let expected = parse("a.csv", b"t_s,encoder_count,force_n\n0,1,2\n1,3,4\n").unwrap();
    for ending in ["\r", "\r\n"] {
        let text = ["# a comment", "t_s,encoder_count,force_n", "", "0,1,2", "1,3,4", ""].join(ending);
        let found = parse("a.csv", text.as_bytes()).unwrap();
        assert_eq!(
            (&found.t_s, &found.encoder_count, &found.force_n),
            (&expected.t_s, &expected.encoder_count, &expected.force_n)
        );
        assert_eq!((found.line, found.notes.len()), (vec![4, 5], 0), "{ending:?}");
    }
}

#[test]
fn what_an_error_shows_of_a_line_is_short_and_printable() {
    let shown = |text: String| {
        let error = parse("a\u{1b}.csv", text.as_bytes()).unwrap_err();
        let mut out = String::new();
        let options = miette::NarratableReportHandler::new();
        options.render_report(&mut out, &error).unwrap();
        out
    };
    let header = "t_s,encoder_count,force_n";
    for long in
        [format!("{header}\n0,1,{}\n1,1,1\n", "9x".repeat(30_000)), format!("{header},{}\n0,1,x\n", "y".repeat(60_000))]
    {
        let words = shown(long);
        assert!(words.len() < 1500, "{}", words.len());
    }
    let words = shown(format!("{header}\n0,1,{}\n1,1,1\n", "9".repeat(1 << 20)));
    assert!(words.contains("line 2: the line is longer than 65536 bytes") && words.len() < 1000, "{}", words.len());
    let words = shown(format!("{header}\n0,\u{9b}31m,2\n1,1,1\n"));
    assert!(words.contains(r"0,\u009b31m,2"), "{words}");
}

#[test]
fn a_file_that_is_no_csv_is_not_read_to_its_end() {
    let header = "t_s,encoder_count,force_n\n0,1,2\n";
    for beginning in ["", header, "t_s,encoder_count,force_n\r0,1,2\r", &format!("{header}#")] {
        let bytes = as_far_as_needed(beginning.as_bytes().chain(io::repeat(b'7'))).unwrap();
        let last =
            beginning.lines().count().max(beginning.matches('\r').count()) + usize::from(!beginning.ends_with('#'));
        let Err(CsvError::LongLine { line, .. }) = parse("a.csv", &bytes) else { panic!("{beginning:?}") };
        assert_eq!(line, last, "{beginning:?}");
        let bytes = as_far_as_needed(beginning.as_bytes().chain(io::repeat(0))).unwrap();
        assert!(matches!(parse("a.csv", &bytes), Err(CsvError::WrongKind { .. })), "{beginning:?}");
    }
    let whole = header.repeat(40_000);
    assert!(as_far_as_needed(whole.as_bytes()).unwrap() == whole.as_bytes());
}
