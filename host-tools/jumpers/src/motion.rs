//! The motion: a simulated inerter played at the inputs, and its parameters as the board finds them.

use crate::align::Line;
use crate::board::JumperError;
use crate::check::{Check, Report};
use crate::recording::Recording;
use crate::tape::Tape;
use crate::wires::Chain;
use inerter_core::{Estimate, Parameter, Settings};
use inerter_plant::{Excitation, Inerter, Plant};
use inerter_wire::Knot;

/// Of the preset motion, so that neither voltages nor counts come near what the outputs can do.
const SCALE: f64 = 0.35;
/// Length of the motion \[knots\]: 8 s.
const KNOTS: usize = 8_000;
/// Encoder: 10 mm of lead and 1024 lines \[m\].
const METRES_PER_COUNT: f64 = 2.44140625e-6;
/// Force of one conversion: 2 kN either way \[N\].
const NEWTONS_PER_CONVERSION: f64 = 1.0;
/// Terminal sensor of one conversion: 33 mm over the range \[m\].
const METRES_PER_CONVERSION: f64 = 0.033 / 4096.0;
/// Counts summed into a sample, and conversions.
const OVERSAMPLING: f64 = 64.0;
/// Code of no force and of no displacement.
const ZERO: f64 = 2048.0;
/// By how much the board's clock and this computer's may differ: a crystal is 1000 times better, and a packet is late.
const TIMEBASE: f64 = 5e-3;
/// Part of a parameter by which it may be off beyond its interval: what straight lines between knots leave.
const BEYOND: [f64; 3] = [0.001, 0.1, 0.02];

/// The device that is played.
pub fn truth() -> Inerter {
    Inerter::paper()
}

/// Settings that the board needs for the test.
pub fn settings(skew_s: f64) -> Settings {
    let device = truth();
    Settings {
        sample_rate_hz: 1_000.0,
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
        ..Settings::default()
    }
}

/// The code to put out for the code that a converter is to see \[sixteenths\].
fn through(line: &Line, seen: f64) -> u16 {
    ((seen - line.offset) / line.slope * 16.0).round().clamp(0.0, 65_535.0) as u16
}

/// The motion of the device as the outputs give it, each put out so that the converters see what the sensors would.
pub fn tape(chain: &Chain) -> Result<Tape, JumperError> {
    let broken = |error: inerter_plant::PlantError| JumperError::Link(error.to_string());
    let motion = Excitation::parse("multi", 11).map_err(broken)?.scaled(SCALE);
    let mut plant = Plant::new(truth(), motion).map_err(broken)?;
    let mut segment = plant.next_segment();
    let mut tape = Tape::new();
    tape.go(through(&chain.force, ZERO), through(&chain.terminal, ZERO), 10);
    let mut played = 0;
    for knot in 0..KNOTS {
        let t_s = knot as f64 * 1e-3;
        while segment.end_s() <= t_s {
            segment = plant.next_segment();
        }
        let now = segment.at(t_s);
        let force_n = now.force_n + truth().structure_mass_kg * now.a1_m_per_s2;
        // 256ths of a count; what rounding leaves comes with the next knot.
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

/// The board's clock against this computer's: samples a second by it, over 1000.
pub fn timebase(recording: &Recording) -> Check {
    let first = recording.samples.first().map_or(0, |sample| sample.index);
    let pairs = recording.came_s.iter().zip(&recording.samples);
    let line = Line::fit(pairs.map(|(came_s, sample)| (*came_s, f64::from(sample.index.wrapping_sub(first)))));
    let off = line.slope / 1_000.0 - 1.0;
    let cause = (off.abs() > TIMEBASE).then(|| {
        format!(
            "the board's clock is {:.1} % too {}: its crystal is another one than the firmware's board has, or does not start",
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

/// Widest interval that tells anything, as a part of the truth: some five times what a sound chain has.
const WIDEST: [f64; 3] = [0.002, 0.6, 0.01];

/// The estimates against the truth.
pub fn estimates(estimate: &Estimate, report: &mut Report) -> bool {
    let device = truth();
    let found = &estimate.whole_run;
    let wanted: [(&'static str, &str, Parameter, f64); 3] = [
        ("inertance", "kg", found.inertance_kg, device.inertance_kg),
        ("viscous friction", "N s/m", found.viscous_n_s_per_m, device.viscous_n_s_per_m),
        ("Coulomb friction", "N", found.coulomb_n, device.coulomb_n),
    ];
    let mut passed = true;
    for ((name, unit, parameter, truth), (beyond, widest)) in wanted.into_iter().zip(BEYOND.into_iter().zip(WIDEST)) {
        let (value, u95) = parameter
            .known()
            .map_or((f64::NAN, f64::NAN), |interval| (f64::from(interval.value), f64::from(interval.u95)));
        let good = (value - truth).abs() <= u95 + beyond * truth && u95 <= widest * truth;
        let cause = (!good).then(|| {
            "every part is sound, and what the board makes of them is not: please send this page to us".to_owned()
        });
        let expected = format!("{truth} {unit}, within the interval and {} %", beyond * 100.0);
        passed &= report.take(Check::new(name, expected, format!("{value:.2} +- {u95:.2} {unit}"), cause));
    }
    passed
}

#[cfg(test)]
mod tests {
    use super::*;
    use inerter_core::{Active, RawSample, State};

    /// The estimator alone, on what the tape's steps are: what the wires and the converters can at best give.
    #[test]
    fn the_tape_alone_gives_the_truth() {
        let line = Line { slope: 1.0, offset: 0.0, ..Line::default() };
        let tape = tape(&Chain { force: line, terminal: line, noise_lsb: 0.0 }).unwrap();
        let all =
            |of: fn(&inerter_app::player::Step) -> u16| tape.steps().iter().all(|step| (300..3800).contains(&of(step)));
        assert!(all(|step| step.force) && all(|step| step.terminal), "the outputs do not reach the rails");
        assert!(tape.knots().iter().all(|knot| knot.advance.abs() < Knot::MAX_ADVANCE), "too fast for the outputs");
        let active: Active = settings(0.0).validate().unwrap();
        let mut state = Box::new(State::new(&active));
        for (index, steps) in tape.steps().chunks_exact(64).enumerate() {
            let sum = |of: fn(&inerter_app::player::Step) -> i32| steps.iter().map(of).sum();
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
        let mut report = Report::default();
        let passed = estimates(&active.publish(&state).estimate, &mut report);
        for check in &report.checks {
            println!("{} {} {}", check.name, check.expected, check.found);
        }
        assert!(passed);
    }
}
