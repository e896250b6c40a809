use super::*;
use crate::{csv::parse, replay::replay};

/// The run of a table with the encoder's scale and these settings.
fn run_of(table: Table, assignments: &[&str]) -> Result<Run, Error> {
    let all: Vec<String> = ["metres_per_count=1e-6"].iter().chain(assignments).map(|text| text.to_string()).collect();
    to_run(table, &Overrides::from_inputs(None, &all).unwrap())
}

fn table(rate_hz: f64, samples: usize) -> Table {
    let mut text = String::from("t_s,encoder_count,force_n,terminal_m\n");
    for i in 0..samples {
        text += &format!(
            "{:.7},{},{},{}\n",
            i as f64 / rate_hz,
            10 * i as i64 - 5,
            (i as f64 * 0.1).sin() * 100.0,
            i as f64 * 1e-5
        );
    }
    parse("run.csv", text.as_bytes()).unwrap()
}

#[test]
fn the_encoder_scale_must_be_given() {
    let error = to_run(table(1000.0, 100), &Overrides::default()).unwrap_err();
    assert_eq!(error.to_string(), "run.csv holds encoder counts, but not the displacement of one count");
}

#[test]
fn the_force_scale_is_a_power_of_two_that_leaves_a_quarter_of_22_bits() {
    let run = run_of(table(1000.0, 100), &[]).unwrap();
    assert_eq!(run.settings.newtons_per_code, 2f64.powi(-15));
    let largest = run.samples.iter().map(|sample| sample.force_code.abs()).max().unwrap();
    assert!((2_097_152..=3_355_443).contains(&largest), "{largest}");
    assert_eq!(scale(&[0.0], 1e3), 2f64.powi(-20));
    assert!(scale(&[f64::MIN_POSITIVE], 1e3) > 1e-12, "settings allow no finer scale");
    assert_eq!(scale(&[f64::MAX], 1e3), 512.0);
    let run = run_of(table(1000.0, 100), &["newtons_per_code=0.01", "force_zero_code=7"]).unwrap();
    assert_eq!(run.samples.get(1).map(|sample| sample.force_code), Some(998 + 7));
}

#[test]
fn a_column_for_the_terminal_is_a_sensor_unless_it_is_switched_off() {
    let with = table(1000.0, 100);
    let without = Table { terminal_m: Vec::new(), ..with.clone() };
    let sensor = |table: &Table, more: &[&str]| {
        let run = run_of(table.clone(), more).unwrap();
        (run.settings.terminal_sensor, run.notes.join("\n"))
    };
    let silent = |sensor: bool| (sensor, String::new());
    assert_eq!((sensor(&with, &[]), sensor(&without, &[])), (silent(true), silent(false)));
    assert_eq!(sensor(&with, &["terminal_sensor=1"]), silent(true));
    assert_eq!(sensor(&without, &["terminal_sensor=0"]), silent(false));
    let (off, note) = sensor(&with, &["terminal_sensor=0"]);
    assert!(!off && note.contains("terminal_m is ignored") && note.contains("--set terminal_sensor=1"), "{note}");
}

#[test]
fn fast_recordings_are_brought_down_as_the_board_does_it() {
    let run = run_of(table(20_000.0, 4000), &[]).unwrap();
    assert_eq!((run.settings.sample_rate_hz, run.settings.oversampling), (5000.0, 4.0));
    assert_eq!(run.samples.len(), 1000);
    // -5 + 5 + 15 + 25
    assert_eq!(run.samples.first().map(|sample| sample.position_count), Some(40));
    assert!((run.start_s - 1.5 / 20_000.0).abs() < 1e-12);
    assert!(run.notes.iter().any(|note| note.contains("summing 4 samples")));
}

#[test]
fn a_group_with_a_missing_sample_is_left_out() {
    let mut table = table(20_000.0, 4000);
    for column in [&mut table.t_s, &mut table.force_n, &mut table.terminal_m] {
        column.remove(9);
    }
    table.encoder_count.remove(9);
    let run = run_of(table, &[]).unwrap();
    let indices: Vec<u32> = run.samples.iter().map(|sample| sample.index).take(4).collect();
    assert_eq!(indices, [0, 1, 3, 4]);
}

#[test]
fn a_rate_that_contradicts_the_times_is_refused() {
    let error = run_of(table(1000.0, 100), &["sample_rate_hz=2000"]).unwrap_err();
    assert!(error.to_string().contains("sample_rate_hz was set to 2000, but t_s in run.csv says 1000 Hz"));
    let run = run_of(table(1000.0, 100), &["sample_rate_hz=1000.02"]).unwrap();
    assert_eq!(run.settings.sample_rate_hz, 1000.02);
    for rate in [10.0, 1e6] {
        assert!(run_of(table(rate, 100), &[]).unwrap_err().to_string().contains("outside"));
    }
}

#[test]
fn a_force_that_does_not_fit_names_its_line() {
    let error = run_of(table(1000.0, 100), &["newtons_per_code=1e-9"]).unwrap_err();
    assert!(error.to_string().starts_with("run.csv, line 3, column force_n: 9.98"), "{error}");
}

/// A jump of 112 m between two samples would need a larger full scale than a sample's counts allow.
#[test]
fn a_count_that_leaps_is_replayed() {
    let mut leaping = table(234.0, 8);
    leaping.encoder_count[6] = -112_122_260;
    let run = run_of(leaping, &[]).unwrap();
    assert!(run.settings.full_scale_velocity_m_per_s > 1000.0, "{:?}", run.settings);
    replay(&run, |_, _| Ok::<(), Error>(())).unwrap();
}

proptest::proptest! {
    #[test]
    fn no_table_panics(rows in proptest::collection::vec((0.0f64..1e3, -(1i64 << 53)..(1i64 << 53), proptest::num::f64::NORMAL), 0..40), fine in 1e-6f64..1e-2) {
        let mut table = Table::default();
        let mut t_s = 0.0;
        for (number, (pause, count, force_n)) in rows.into_iter().enumerate() {
            // Mostly regular, sometimes with a gap.
            t_s += if number % 7 == 0 { fine * pause.ceil() + fine } else { fine };
            table.t_s.push(t_s);
            table.encoder_count.push(count);
            table.force_n.push(force_n);
            table.line.push(number + 2);
        }
        table.time_decimals = 9;
        if let Ok(run) = run_of(table, &[]) {
            let outcome = replay(&run, |_, _| Ok::<(), Error>(()));
            proptest::prop_assert!(outcome.is_ok());
        }
    }
}
