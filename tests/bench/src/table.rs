//! Lines and the table of the bench.

use crate::{
    answers::Answers,
    cases::Outcome,
    machine::{FORCE_NOISE_N, FORGETTING, REST_S, STAGES, STROKES, TRUTH, VARIANCE},
};
use serde_json::Value;
use std::{error::Error, fmt::Write};

/// One line of the table.
#[derive(Clone, Debug)]
pub struct Line {
    /// Method.
    pub name: String,
    /// Number formats.
    pub arithmetic: String,
    /// Time of an update \[ns\].
    pub nanoseconds: f64,
    /// Parameters after the motion.
    pub motion: [f64; 4],
    /// Parameters after the rest.
    pub rest: [f64; 4],
    /// Remarks.
    pub remark: String,
}

/// What the Python part wrote.
pub struct Python {
    /// Of the first table.
    pub lines: Vec<Line>,
    /// Of what is reported.
    pub answers: Vec<Answers>,
}

impl Python {
    /// Reads it; every method must have answered `cases` cases.
    pub fn read(text: &str, cases: usize) -> Result<Self, Box<dyn Error>> {
        let value: Value = serde_json::from_str(text)?;
        let list = value.as_array().ok_or("not a list")?;
        let lines = list.iter().map(python_line).collect::<Result<_, _>>()?;
        let answers = list.iter().map(|one| python_answers(one, cases)).collect::<Result<_, _>>()?;
        Ok(Self { lines, answers })
    }
}

fn python_line(one: &Value) -> Result<Line, Box<dyn Error>> {
    Ok(Line {
        name: text(one, "name")?,
        arithmetic: text(one, "arithmetic")?,
        nanoseconds: one["ns_per_update"].as_f64().ok_or("no number `ns_per_update`")?,
        motion: four(one, "motion")?,
        rest: four(one, "rest")?,
        remark: text(one, "remark")?,
    })
}

fn python_answers(one: &Value, cases: usize) -> Result<Answers, Box<dyn Error>> {
    let list = one["cases"].as_array().ok_or("no list `cases`")?;
    if list.len() != cases {
        return Err(format!("{} cases, not {cases}", list.len()).into());
    }
    let outcome = |one: &Value| -> Result<_, String> {
        let (parameters, variances) = (four(one, "parameters")?, Some(four(one, "variances")?));
        Ok(Some(Outcome { parameters, variances, track: numbers(one, "track")? }))
    };
    Ok(Answers { name: text(one, "name")?, outcomes: list.iter().map(outcome).collect::<Result<_, _>>()? })
}

fn text(one: &Value, field: &str) -> Result<String, String> {
    one[field].as_str().map(str::to_owned).ok_or(format!("no text `{field}`"))
}

/// NaN is written as null.
fn numbers(one: &Value, field: &str) -> Result<Vec<f64>, String> {
    let values = one[field].as_array().ok_or(format!("no list `{field}`"))?;
    Ok(values.iter().map(|value| value.as_f64().unwrap_or(f64::NAN)).collect())
}

fn four(one: &Value, field: &str) -> Result<[f64; 4], String> {
    numbers(one, field)?.try_into().map_err(|_| format!("`{field}` has not four values"))
}

/// The table; the first line is ours, and all times are relative to it.
pub fn markdown(lines: &[Line], without_python: Option<&str>) -> String {
    let [mass, viscous, coulomb, _] = TRUTH;
    let mut text = format!(
        "# Our update beside other recursive least squares\n\n\
         Written by `cargo xtask bench --update` in one run on one machine. The first section compares the\n\
         time of an update, and the values after a rest. The second shows what each method can and cannot\n\
         report.\n\n\
         ## Time of an update, and rest\n\n\
         All lines but the second get the same regressors `[a, v, sgn v, 1]` and force. The machine has\n\
         {mass} kg, {viscous} N s/m and {coulomb} N. It moves like the EMPS axis for {:.0} s at 1 kHz, with\n\
         counts of 50 nm and {FORCE_NOISE_N} N of noise. Then it rests for {:.0} minutes with one-count\n\
         flicker. Forgetting is {FORGETTING} per update, the initial variance {VARIANCE:.0e}. Times are the\n\
         best of several passes on a desktop processor, and only their ratio to our update carries over to\n\
         other machines. Instructions on the Cortex-M4F are in [icount.md](icount.md). A covariance method\n\
         yields parameters at every update; ours yields averages, which are solved at 5 Hz.\n\n\
         | method | arithmetic | time per update | mt, cf, fc after motion: error | mt, cf, fc after rest | remark |\n\
         |---|---|--:|---|---|---|\n",
        2.0 * STROKES as f64 * STAGES.iter().map(|stage| stage.1).sum::<f64>(),
        REST_S / 60.0,
    );
    let ours = lines.first().map_or(f64::NAN, |line| line.nanoseconds);
    for line in lines {
        let [mt, cf, fc, _] = line.motion;
        let error = if [mt, cf, fc].iter().all(|value| value.is_finite()) {
            format!("{:+.2} %, {:+.1} N s/m, {:+.2} N", (mt / mass - 1.0) * 100.0, cf - viscous, fc - coulomb)
        } else {
            "not a number".into()
        };
        let [mt, cf, fc, _] = line.rest.map(plain);
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "| {} | {} | {:.1} ns, x {} | {error} | {mt} kg, {cf} N s/m, {fc} N | {} |",
            line.name,
            line.arithmetic,
            line.nanoseconds,
            ratio(line.nanoseconds / ours),
            line.remark
        );
    }
    if let Some(reason) = without_python {
        let _ = writeln!(text, "\n`padasip` and `filterpy` are not in this run: {reason}.");
    }
    text
}

fn ratio(value: f64) -> String {
    if value < 10.0 { format!("{value:.1}") } else { format!("{value:.0}") }
}

fn plain(value: f64) -> String {
    match value.abs() {
        size if !size.is_finite() => "NaN".into(),
        size if size >= 1e5 => format!("{value:.1e}"),
        size if size >= 1000.0 => format!("{value:.0}"),
        size if size >= 100.0 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_python_wrote_is_read() {
        let text = r#"[{"name": "a", "arithmetic": "f64", "ns_per_update": 5.0, "motion": [1, 2, 3, 4],
            "rest": [null, 2, 3, 4],
            "remark": "", "cases": [{"parameters": [1, 2, 3, 4], "variances": [1, 1, 1, null], "track": [7]}]}]"#;
        let python = Python::read(text, 1).unwrap();
        assert!(python.lines[0].rest[0].is_nan());
        assert!(markdown(&python.lines, None).contains("NaN kg"));
        assert!(markdown(&python.lines, Some("no python3")).contains("not in this run: no python3"));
        let outcome = python.answers[0].outcomes[0].as_ref().unwrap();
        assert_eq!((outcome.parameters[3], outcome.track[0]), (4.0, 7.0));
        let refusal = |text: &str, cases| Python::read(text, cases).err().unwrap().to_string();
        assert!(refusal(text, 2).contains("1 cases, not 2"));
        assert!(refusal("{}", 0).contains("list"));
        assert!(refusal(r#"[{"name": "a"}]"#, 0).contains("arithmetic"));
    }
}
