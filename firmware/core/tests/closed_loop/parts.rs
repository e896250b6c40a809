//! The public functions from which a host computes an interval, and the accessors of results, each compared with its
//! formula.

use crate::rig::{calibrated, instruments, listen, shaken};
use inerter_core::{
    Backlash, BacklashSize, BacklashStatus, Contact, Detail, Found, Interval, MOST_REPEATS, Motion, Parameter, Reason,
    Scatter, Settings, Source, Spread, Status, Systematic, Unresolved, apart,
};
use inerter_plant::{Inerter, Sensors};

fn is_near(found: f32, wanted: f64, what: &str) {
    assert!((f64::from(found) - wanted).abs() <= 1e-4 * wanted.abs(), "{what}: {found} for {wanted}");
}

#[test]
fn a_parameter_has_a_value_where_its_status_says_so() {
    let interval = Interval { value: -4.0, u95: 1.5 };
    let of = |status| Parameter::new(interval, status);
    for (status, known, ok) in [
        (Status::Ok, Some(interval), Some(interval)),
        (Status::Held, Some(interval), None),
        (Status::NotIdentifiable, None, None),
    ] {
        let parameter = of(status);
        assert_eq!((parameter.status(), parameter.known(), parameter.ok()), (status, known, ok));
        assert_eq!((parameter.fitted(), parameter.u95()), (interval, 1.5));
        assert_eq!(parameter.value(), known.map(|known| known.value));
        assert_eq!(parameter.usable(), known);
        for endless in [f32::INFINITY, f32::NAN] {
            for interval in [Interval { value: endless, ..interval }, Interval { u95: endless, ..interval }] {
                assert_eq!(Parameter::new(interval, status), Parameter::NotIdentifiable(Unresolved::NOTHING));
            }
        }
    }
    let nothing = Parameter::default();
    assert_eq!(nothing.fitted(), Interval { value: 0.0, u95: f32::INFINITY });
    assert_eq!((nothing.status(), nothing.value()), (Status::NotIdentifiable, None));
    // Half of the value is the limit.
    for (value, u95, usable) in
        [(4.0, 1.9, true), (-4.0, 1.9, true), (4.0, 2.0, false), (-4.0, 2.1, false), (0.0, 0.0, false)]
    {
        assert_eq!(Parameter::Ok(Interval { value, u95 }).usable().is_some(), usable, "{value} {u95}");
    }
}

#[test]
fn a_gap_is_at_most_the_backlash_with_its_interval() {
    let backlash = |size| Backlash { size, ..Backlash::default() };
    let interval = Interval { value: 1e-4, u95: 3e-5 };
    let known = [backlash(BacklashSize::Ok(interval)), backlash(BacklashSize::BelowU95(interval))];
    let none = backlash(BacklashSize::NotIdentifiable(Reason::Scattered));
    assert_eq!(known.map(|known| known.known()), [Some(interval); 2]);
    assert_eq!(known.map(|known| known.status()), [BacklashStatus::Ok, BacklashStatus::BelowU95]);
    assert_eq!((none.known(), none.status()), (None, BacklashStatus::NotIdentifiable(Reason::Scattered)));
    for contact in [Contact::Unknown, Contact::Backlash, Contact::Bouncing] {
        assert!(contact.may_part());
        for known in known {
            is_near(contact.gap_m(&known), 1.3e-4, "gap");
        }
        assert_eq!(contact.gap_m(&none), f32::INFINITY);
        let below = backlash(BacklashSize::BelowU95(Interval { value: -5e-5, u95: 3e-5 }));
        assert_eq!(contact.gap_m(&below), 0.0);
    }
    for contact in [Contact::Closed, Contact::OneSided] {
        assert!(!contact.may_part());
        assert_eq!([known[0], known[1], none].map(|backlash| contact.gap_m(&backlash)), [0.0; 3]);
    }
}

/// 0.45 eps w^2 / a of the structure's mass, 5 % if that is unknown, and at most all of it.
#[test]
fn a_structure_across_a_gap_is_left_out_by_its_part() {
    is_near(apart(1e-4, 400.0, 4.0), 0.45 * 1e-4 * 400.0 / 2.0, "apart");
    assert_eq!(apart(0.0, 400.0, 4.0), 0.0);
    assert_eq!(apart(1.0, 400.0, 4.0), 1.0);
    for (gap, frequency, acceleration) in
        [(f32::INFINITY, 400.0, 4.0), (1e-4, 0.0, 4.0), (1e-4, 400.0, 0.0), (1e-4, 400.0, f32::INFINITY)]
    {
        is_near(apart(gap, frequency, acceleration), 0.05, "not known");
    }
}

fn motion() -> Motion {
    Motion {
        repeats: 20.0,
        apart: 0.03,
        frequency_squared: 500.0,
        low_squared: 450.0,
        acceleration_squared: 2.0,
        readings: 20_000.0,
        steady: 0.9,
        reversals_again: 300.0,
        friction_in_curvature: [2e-4, -3e-5],
    }
}

/// Steps that follow one pattern with the motion: bounded by a regressor that passes all of them; for friction, by
/// those of a tone's harmonics.
#[test]
fn what_a_pattern_does_to_a_difference_is_bounded() {
    for (repeats, further) in [(3.0, 1.0), (MOST_REPEATS, 1.0), (20.0, 19.0 / 7.0)] {
        for (low_squared, box_s) in [(450.0, 0.016), (490.0, 0.04), (200.0, 0.016)] {
            let motion = Motion { repeats, low_squared, ..motion() };
            let y = f64::from(low_squared * box_s * box_s);
            let alike = (f64::from(low_squared) / 500.0).powi(4);
            let harmonics = (0.02 + 1.9 * y / (1.0 + 0.5 * y + 2.0 * y.powi(8))) * alike;
            let any: f64 = further / 0.25;
            let friction = any.min(1.0 / harmonics);
            let found = motion.pattern_in_differences(box_s);
            for (found, wanted) in found.into_iter().zip([any, friction, friction, any]) {
                is_near(found, wanted, &format!("{repeats} {low_squared} {box_s}"));
            }
        }
    }
    let still = Motion { frequency_squared: 0.0, ..motion() };
    is_near(still.pattern_in_differences(0.016)[1], 19.0 / 7.0 / 0.25, "no frequency");
}

/// Residuals assumed to be white: noise through the kernel, without the steps.
#[test]
fn white_residuals_scatter_by_their_standard_error() {
    let settings = Settings { force_gain_u95: 0.01, lead_u95: 0.002, skew_u95_s: 1e-5, ..Settings::default() };
    let systematic = Systematic::of(&settings);
    let found = Found { value: 300.0, error: 0.4, per_skew: 2e3, steps: 0.1 };
    let spread: Spread =
        Scatter::white(300.0, 55.0).in_motion(&Motion { steady: 0.0, reversals_again: 0.0, ..motion() });
    let budgets = [
        systematic.inertance(&found, &spread, &motion()),
        systematic.viscous(&found, &spread, &motion()),
        systematic.coulomb(&found, &spread, &motion()),
        systematic.offset(&found, &spread),
    ];
    for (i, budget) in budgets.iter().enumerate() {
        is_near(budget.standard_error(), 0.4, "noise");
        is_near(budget.given_u95(Source::Gain), 3.0, "gain");
        is_near(budget.given_u95(Source::Skew), 0.02, "skew");
        is_near(budget.scatter_freedom(), 55.0, "freedom");
        is_near(budget.given_u95(Source::Lead), if i < 2 { 0.6 } else { 0.0 }, "lead");
        if i > 0 {
            is_near(budget.given_u95(Source::Encoder), 0.1, "encoder");
        }
        // The sum of both squares is the part that differs from sample to sample.
        let (noise, encoder) =
            (f64::from(budget.standard_error()), f64::from(budget.given_u95(Source::Encoder)) / 1.959_964);
        is_near(budget.fit_square(), noise * noise + encoder * encoder, "fit");
    }
}

/// From the formula: `4 fc^2 <v^2>` over the places, `mt`'s own squared error over variance and correlation, per
/// squared box.
#[test]
fn the_places_of_reversals_cost_what_their_counts_leave_open() {
    let settings = Settings { metres_per_count: 4e-6, sample_rate_hz: 2000.0, ..Settings::default() };
    let systematic = Systematic::of(&settings);
    let of = |coulomb: f32, acceleration_squared: f32| {
        systematic.places([300.0, coulomb], 0.05, 0.2, 0.016 * 0.016, acceleration_squared)
    };
    let velocity_square = |half_s: f64| 4e-6_f64.powi(2) / (6.0 * half_s.powi(3) * 2000.0);
    let wanted = |coulomb: f64, half_s: f64| {
        4.0 * velocity_square(half_s) * (0.05 * coulomb / (0.2 * 2.09)).powi(2) / 0.016_f64.powi(2)
    };
    is_near(of(50.0, 2.0), wanted(50.0, 0.015), "moved by the long kernel");
    // So slow that the short kernel's place is out of reach: 2 a^2 (2 ms)^2 under four times its square.
    let slowest = 4.0 * velocity_square(0.005) / 0.002_f64.powi(2) / 2.0;
    is_near(of(5.0, 1.02 * slowest as f32), wanted(5.0, 0.015), "just moved");
    is_near(of(5.0, 0.98 * slowest as f32), wanted(5.0, 0.005), "left where the short kernel puts it");
    // Friction may hold the screw at 1.5 times its level and less.
    let holds = (1.5 * 50.0 / 300.0_f64).powi(2) / 2.0;
    assert_eq!(of(50.0, 0.98 * holds as f32), 0.0);
    is_near(of(50.0, 1.02 * holds as f32), wanted(50.0, 0.015), "turns freely");
    assert_eq!(systematic.places([300.0, 50.0], 0.05, 0.0, 2.56e-4, 2.0), 0.0);
}

/// A host derives the same properties of the motion from a record as the estimator, except for the counts.
#[test]
fn a_motion_by_the_detail_is_that_of_the_estimator() {
    for backlash_m in [0.0, 100e-6] {
        let device = Inerter { backlash_m, ..Inerter::paper() };
        let sensors = Sensors { sample_rate_hz: 1000.123, ..instruments(3) };
        let settings = Settings { memory_s: 100.0, ..calibrated(&device, &sensors) };
        let heard = listen(&settings, &shaken(&device, "random", 10.0, &sensors));
        let (own, detail): (Motion, Detail) = (heard.active.motion(&heard.state), heard.last.detail);
        let by_detail = Motion::of(&detail, heard.state.repeats());
        assert_eq!(by_detail.repeats, own.repeats);
        assert_eq!((by_detail.frequency_squared, by_detail.low_squared), (own.frequency_squared, own.low_squared));
        assert_eq!((by_detail.steady, by_detail.reversals_again), (0.0, 0.0));
        let gap = f64::from(detail.contact.gap_m(&detail.backlash));
        if backlash_m == 0.0 {
            assert_eq!((by_detail.apart, own.apart), (0.0, 0.0));
        } else {
            assert!((90e-6..130e-6).contains(&gap), "{gap}");
            is_near(by_detail.apart, 0.05, "unknown");
            let wanted = 0.45 * gap * f64::from(own.frequency_squared) / f64::from(own.acceleration_squared).sqrt();
            is_near(own.apart, wanted, "apart");
        }
    }
}
