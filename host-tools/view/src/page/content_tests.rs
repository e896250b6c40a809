use inerter_data::{run::Run, settings::Overrides};
use inerter_simulate::{Setup, bench_sensors, raw};

use super::*;

fn content(excite: &str, duration_s: f64) -> Content {
    let setup =
        Setup::new(inerter_plant::Inerter::paper(), bench_sensors(), excite, Some(duration_s), &Overrides::default())
            .unwrap();
    let samples = setup.samples().unwrap().map(|sample| raw(&sample)).collect();
    Content::of(Run { settings: setup.settings, samples, ..Run::default() }, |_| ()).unwrap()
}

#[test]
fn the_law_leaves_no_more_than_the_estimator_does() {
    for (excite, duration_s) in [("mid", 10.0), ("fast", 10.0), ("random", 10.0)] {
        let content = content(excite, duration_s);
        let (rms_n, explained) = content.residual().unwrap();
        let estimator_n = f64::from(content.replayed.outcome.estimate.residual_rms_n);
        println!("{excite}: {rms_n} {estimator_n} {explained}");
        assert!(rms_n < 1.6 * estimator_n && rms_n > 0.4 * estimator_n, "{excite}: {rms_n} against {estimator_n}");
        assert!(explained > 0.999 && explained < 1.0, "{excite}: {explained}");
        assert!(content.close.len() > 50 && content.close.len() < 5000, "{}", content.close.len());
    }
}

#[test]
fn at_rest_there_is_no_law() {
    let content = content("mid@4s;hold@4s", 8.0);
    let at_rest = |row: &&Row| row.t_s > 5.0;
    assert!(content.rows.iter().filter(at_rest).count() > 100);
    assert!(content.rows.iter().filter(at_rest).all(|row| row.law_n.is_nan()));
}
