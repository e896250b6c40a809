//! The motion: plays a simulated inerter at the inputs, and compares the board's parameters and backlash with the
//! truth.

use crate::align::Line;
use crate::board::JumperError;
use crate::check::{Check, Judged, Report};
use crate::recording::{Recording, SAMPLE_RATE_HZ};
use crate::tape::Tape;
use crate::wires::Chain;
use inerter_core::{Detail, Estimate, Interval, Route, Settings};
use inerter_plant::{Excitation, Inerter, Plant};
use inerter_wire::Knot;

/// It ends at rest before the knots do: no real device's force stays constant right after a motion.
const MOTION: &str = "multi@7.8s";
/// Scale of that motion, so that neither voltages nor counts come near the limits of the outputs.
const SCALE: f64 = 0.35;
/// Length of the motion \[knots\]: 8 s.
const KNOTS: usize = 8_000;
/// Encoder: 10 mm of lead and 1024 lines \[m\].
const METRES_PER_COUNT: f64 = 2.44140625e-6;
/// Force per code of one conversion: 2 kN either way \[N\].
const NEWTONS_PER_CONVERSION: f64 = 1.0;
/// Terminal displacement per code of one conversion: 33 mm over the range \[m\].
const METRES_PER_CONVERSION: f64 = 0.033 / 4096.0;
/// Counts, and conversions, summed into a sample.
const OVERSAMPLING: f64 = 64.0;
/// Code at zero force and zero displacement.
const ZERO: f64 = 2048.0;
/// Allowed relative difference between the board's and this computer's clock: a crystal is 1000 times better, but
/// packets are late.
const TIMEBASE: f64 = 5e-3;

/// The device that is played for its parameters: without backlash, because impacts would make the intervals of friction
/// five times as wide.
pub fn truth() -> Inerter {
    Inerter::paper()
}

/// The same device after wear, which is played for its backlash.
pub fn worn() -> Inerter {
    Inerter::worn()
}

/// The board's settings for the test, with this route of the backlash.
pub fn settings(skew_s: f64, route: Route) -> Settings {
    let device = truth();
    Settings {
        sample_rate_hz: SAMPLE_RATE_HZ,
        metres_per_count: METRES_PER_COUNT,
        oversampling: OVERSAMPLING,
        newtons_per_code: NEWTONS_PER_CONVERSION / OVERSAMPLING,
        force_zero_code: ZERO * OVERSAMPLING,
        force_min_code: 0.0,
        force_max_code: 4095.0 * OVERSAMPLING,
        metres_per_terminal_code: METRES_PER_CONVERSION / OVERSAMPLING,
        structure_mass_kg: device.structure_mass_kg,
        stiffness_n_per_m: device.stiffness_n_per_m,
        contact_damping_n_s_per_m: device.contact_damping_n_s_per_m,
        skew_s,
        force_gain_u95: 0.0,
        lead_u95: 0.0,
        timebase_u95: 0.0,
        memory_s: 100.0,
        terminal_sensor: route == Route::Terminal,
        ..Settings::default()
    }
}

/// The output code at which a converter sees the wanted code \[sixteenths\].
fn through(line: &Line, seen: f64) -> u16 {
    ((seen - line.offset) / line.slope * 16.0).round().clamp(0.0, 65_535.0) as u16
}

/// A device's motion as outputs, such that the converters see the sensors' values.
pub fn tape(device: Inerter, chain: &Chain) -> Result<Tape, JumperError> {
    let broken = |error: inerter_plant::PlantError| JumperError::Link(error.to_string());
    let motion = Excitation::parse(MOTION, 11).map_err(broken)?.scaled(SCALE);
    let mut plant = Plant::new(device, motion).map_err(broken)?;
    let mut segment = plant.next_segment();
    let mut tape = Tape::from_rest(through(&chain.force, ZERO), through(&chain.terminal, ZERO));
    let mut played = 0;
    for knot in 0..KNOTS {
        let t_s = knot as f64 * 1e-3;
        while segment.end_s() <= t_s {
            segment = plant.next_segment();
        }
        let now = segment.at(t_s);
        let force_n = now.force_n + device.structure_mass_kg * now.a1_m_per_s2;
        // In 256ths of a count; the rounding remainder goes to the next knot.
        let place = (now.x2_m / METRES_PER_COUNT * 256.0).round() as i32;
        let advance = (place - played).clamp(-i32::from(Knot::MAX_ADVANCE), i32::from(Knot::MAX_ADVANCE));
        played += advance;
        tape.push(Knot {
            force: through(&chain.force, ZERO + force_n / NEWTONS_PER_CONVERSION),
            terminal: through(&chain.terminal, ZERO + now.x1_m / METRES_PER_CONVERSION),
            advance: advance as i16,
        });
    }
    tape.hold(10);
    Ok(tape)
}

/// The board's clock against this computer's: samples per second by the computer's clock, over their rate.
pub fn timebase(recording: &Recording) -> Check {
    let first = recording.samples.first().map_or(0, |sample| sample.index);
    let pairs = recording.came_s.iter().zip(&recording.samples);
    let line = Line::fit(pairs.map(|(came_s, sample)| (*came_s, f64::from(sample.index.wrapping_sub(first)))));
    let off = line.slope / SAMPLE_RATE_HZ - 1.0;
    let cause = (off.abs() > TIMEBASE).then(|| {
        format!(
            "the board's clock is {:.1} % too {}: its crystal differs from that of the firmware's board, or does not start",
            off.abs() * 100.0,
            if off > 0.0 { "fast" } else { "slow" }
        )
    });
    Check::new(
        "clock",
        format!("this computer's within {} %", TIMEBASE * 100.0),
        format!("{:+.3} %", off * 100.0),
        cause,
    )
}

/// A value to judge: name, unit and truth.
struct Wanted {
    name: &'static str,
    unit: &'static str,
    truth: f64,
    /// Allowed error beyond the interval, as a fraction of the truth: the error of straight lines between knots.
    beyond: f64,
    /// Maximum useful width of the interval, as a fraction of the truth: about five times that of a good chain.
    widest: f64,
}

impl Wanted {
    fn judge(&self, found: Option<Interval>) -> Check {
        let Self { name, unit, truth, beyond, widest } = *self;
        let good = found.is_some_and(|Interval { value, u95 }| {
            let (value, u95) = (f64::from(value), f64::from(u95));
            (value - truth).abs() <= u95 + beyond * truth && u95 <= widest * truth
        });
        let cause = (!good).then_some(
            "each part passed, but the board's result is wrong or too uncertain: please report it with this page",
        );
        let expected = format!("{truth} {unit}, within the interval plus {} %", beyond * 100.0);
        let found = found.map_or("no value".into(), |Interval { value, u95 }| format!("{value:.2} +- {u95:.2} {unit}"));
        Check::new(name, expected, found, cause)
    }
}

/// Compares the parameters with [`truth`].
pub fn parameters(estimate: &Estimate, report: &mut Report) -> Judged<()> {
    let (device, found) = (truth(), &estimate.whole_run);
    let inertance = Wanted { name: "inertance", unit: "kg", truth: device.inertance_kg, beyond: 0.001, widest: 0.002 };
    let viscous =
        Wanted { name: "viscous friction", unit: "N s/m", truth: device.viscous_n_s_per_m, beyond: 0.1, widest: 0.6 };
    let coulomb = Wanted { name: "Coulomb friction", unit: "N", truth: device.coulomb_n, beyond: 0.02, widest: 0.01 };
    let pairs = [(inertance, found.inertance_kg), (viscous, found.viscous_n_s_per_m), (coulomb, found.coulomb_n)];
    // All are judged, whichever fails.
    pairs.map(|(wanted, found)| report.take(wanted.judge(found.known()))).into_iter().collect()
}

/// Compares the backlash from one route with [`worn`].
pub fn backlash(detail: &Detail, route: Route, report: &mut Report) -> Judged<()> {
    const UM: f64 = 1e6;
    let (name, widest) = match route {
        Route::Force => ("backlash by the force", 0.08),
        Route::Terminal => ("backlash by the terminal", 0.02),
    };
    let wanted = Wanted { name, unit: "um", truth: worn().backlash_m * UM, beyond: 0.005, widest };
    let found = &detail.backlash;
    let in_um = |of: Interval| Interval { value: of.value * UM as f32, u95: of.u95 * UM as f32 };
    // A backlash from the other route says nothing about this one.
    report.take(wanted.judge(found.known().filter(|_| found.route == route).map(in_um)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use inerter_app::player::Step;
    use inerter_core::{Active, Backlash, BacklashSize, Published, RawSample, State};

    /// The best that wires and converters can deliver: the codes as they were put out.
    fn at_best(device: Inerter) -> Tape {
        let line = Line { slope: 1.0, offset: 0.0, ..Line::default() };
        tape(device, &Chain { force: line, terminal: line }).unwrap()
    }

    /// The estimator alone, fed with the tape's steps.
    fn published(tape: &Tape, route: Route) -> Published {
        let active: Active = settings(0.0, route).validate().unwrap();
        let mut state = Box::new(State::new(&active));
        for (index, steps) in tape.steps().chunks_exact(64).enumerate() {
            let sum = |of: fn(&Step) -> i32| steps.iter().map(of).sum();
            active.step(
                &mut state,
                &RawSample {
                    index: index as u32,
                    position_count: sum(|step| step.count),
                    force_code: sum(|step| i32::from(step.force)),
                    terminal_code: sum(|step| i32::from(step.terminal)),
                },
            );
        }
        active.publish(&state)
    }

    fn print(report: &Report) {
        for check in &report.checks {
            println!("{} {} {}", check.name, check.expected, check.found);
        }
    }

    fn failed(report: &Report) -> Vec<&'static str> {
        report.checks.iter().filter(|check| !check.passed()).map(|check| check.name).collect()
    }

    /// Parameters, judged.
    fn judged(device: Inerter) -> Report {
        let mut report = Report::default();
        parameters(&published(&at_best(device), Route::Force).estimate, &mut report).ok();
        print(&report);
        report
    }

    /// Both backlashes, judged.
    fn backlashes(tape: &Tape) -> Report {
        let mut report = Report::default();
        for route in [Route::Force, Route::Terminal] {
            backlash(&published(tape, route).detail, route, &mut report).ok();
        }
        print(&report);
        report
    }

    #[test]
    fn the_tape_alone_gives_the_truth() {
        for device in [truth(), worn()] {
            let tape = at_best(device);
            let all = |of: fn(&Step) -> u16| tape.steps().iter().all(|step| (300..3800).contains(&of(step)));
            assert!(all(|step| step.force) && all(|step| step.terminal), "the outputs do not reach the rails");
            assert!(tape.knots().iter().all(|knot| knot.advance.abs() < Knot::MAX_ADVANCE), "too fast for the outputs");
        }
        let report = judged(truth());
        assert_eq!((report.checks.len(), failed(&report)), (3, vec![]));
        let report = backlashes(&at_best(worn()));
        assert_eq!((report.checks.len(), failed(&report)), (2, vec![]));
    }

    #[test]
    fn another_device_is_told_by_the_parameter_that_differs() {
        for off in [-1.0, 1.0] {
            let Inerter { inertance_kg, viscous_n_s_per_m, coulomb_n, .. } = truth();
            let heavier = Inerter { inertance_kg: inertance_kg * (1.0 + 0.005 * off), ..truth() };
            let thicker = Inerter { viscous_n_s_per_m: viscous_n_s_per_m * (1.0 + 0.8 * off), ..truth() };
            let rougher = Inerter { coulomb_n: coulomb_n * (1.0 + 0.04 * off), ..truth() };
            for (device, check) in
                [(heavier, "inertance"), (thicker, "viscous friction"), (rougher, "Coulomb friction")]
            {
                assert_eq!(failed(&judged(device)), [check], "{off}");
            }
        }
    }

    #[test]
    fn another_backlash_is_told_by_either_way() {
        for backlash_m in [0.0, 0.95e-4, 1.05e-4] {
            let report = backlashes(&at_best(Inerter { backlash_m, ..worn() }));
            assert_eq!(failed(&report), ["backlash by the force", "backlash by the terminal"], "{backlash_m} m");
        }
    }

    #[test]
    fn a_backlash_by_the_other_way_or_none_does_not_pass() {
        let mut report = Report::default();
        let size = BacklashSize::Ok(Interval { value: 1e-4, u95: 1e-6 });
        let by_force = Detail { backlash: Backlash { size, ..Backlash::default() }, ..Detail::default() };
        assert_eq!(backlash(&by_force, Route::Force, &mut report), Ok(()));
        assert_eq!(backlash(&by_force, Route::Terminal, &mut report), Err(None));
        assert_eq!(backlash(&Detail::default(), Route::Force, &mut report), Err(None));
    }
}
