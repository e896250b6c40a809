use std::collections::BTreeMap;

use inerter_core::{Changed, Friction, Reversal};

use super::*;
use crate::json::{BacklashJson, DetailJson, EstimateJson, EventJson, ReversalJson, json_line};

fn estimated(detail: Detail) -> Estimated {
    Estimated { detail: Some(detail), ..Estimated::default() }
}

fn detail() -> Detail {
    let parameter = |value, u95| Parameter::Ok(Interval { value, u95 });
    Detail {
        index: 7,
        band: Band { low_hz: 3.125, high_hz: 6.5 },
        backlash: Backlash {
            size: BacklashSize::Ok(Interval { value: 5e-5, u95: 2e-6 }),
            route: Route::Terminal,
            reversals: 130,
        },
        contact: Contact::Backlash,
        stiffness_n_per_m: parameter(2.1e6, 4e3),
        contact_damping_n_s_per_m: parameter(1200.0, 100.0),
        friction: Friction { reversal_ratio: Some(0.75), regime: Regime::Coulomb },
        changes: 1,
    }
}

fn settings(terminal_sensor: bool) -> Settings {
    Settings { terminal_sensor, ..Settings::default() }
}

#[test]
fn the_json_contract_holds_to_the_letter() {
    let head = r#""backlash_m":{"value":0.00005,"u95":0.000002,"status":"ok","reason":null,"reversals":130,"route":"terminal"}"#;
    let middle = r#""stiffness_n_per_m":{"value":2100000.0,"u95":4000.0,"status":"ok"},"contact_damping_n_s_per_m":{"value":1200.0,"u95":100.0,"status":"ok"}"#;
    let tail = r#""band_hz":[3.125,6.5],"contact":"backlash","friction":{"reversal_ratio":0.75,"regime":"coulomb"},"changes":1"#;
    assert_eq!(json_line(&DetailJson::new(&detail(), &settings(true))), format!("{{{head},{middle},{tail}}}"));
    // Without a sensor the contact's own parameters are left out.
    assert_eq!(json_line(&DetailJson::new(&detail(), &settings(false))), format!("{{{head},{tail}}}"));
    // In the same object as the estimate.
    let line = json_line(&EstimateJson::live(0.2, &estimated(detail()), &settings(false)));
    assert!(line.ends_with(&format!(r#""updates":0,{head},{tail}}}"#)), "{line}");
}

#[test]
fn what_is_not_known_is_null_with_its_reason() {
    let json = DetailJson::new(&Detail::default(), &settings(true));
    assert_eq!(json.band_hz, None);
    assert_eq!(json.stiffness_n_per_m.map(|parameter| parameter.status), Some("not_identifiable"));
    assert_eq!((&*json.contact, &*json.friction.regime, json.friction.reversal_ratio), ("unknown", "unknown", None));
    let backlash = json.backlash_m;
    assert_eq!(
        (backlash.value, backlash.status, backlash.reason.as_deref()),
        (None, "not_identifiable", Some("too_few_reversals"))
    );
    for (reason, code) in [
        (Reason::ForceNeverReverses, "force_never_reverses"),
        (Reason::TooFewReversals, "too_few_reversals"),
        (Reason::FlankTooShort, "flank_too_short"),
        (Reason::StiffnessUnknown, "stiffness_unknown"),
        (Reason::Scattered, "scattered"),
    ] {
        // Whatever else the device sends with it.
        let backlash = Backlash { size: BacklashSize::NotIdentifiable(reason), ..detail().backlash };
        let json = BacklashJson::from(backlash);
        assert_eq!((json.value, json.u95, json.reason.as_deref()), (None, None, Some(code)));
    }
    let below = BacklashJson::from(Backlash {
        size: BacklashSize::BelowU95(Interval { value: 5e-5, u95: 2e-6 }),
        ..detail().backlash
    });
    assert_eq!((below.value, below.status, below.reason), (Some(5e-5), "below_u95", None));
    let odd = Backlash { size: BacklashSize::Ok(Interval { value: f32::NAN, u95: f32::NAN }), ..detail().backlash };
    assert_eq!((BacklashJson::from(odd).value, BacklashJson::from(odd).u95), (None, None));
}

#[test]
fn reversals_and_changes_have_lines_of_their_own() {
    let reversal = Reversal { index: 9, value_m: 5.25e-5, error_m: 1.5e-6, route: Route::Force, rising: true };
    assert_eq!(
        json_line(&ReversalJson::new(Some(0.1 + 0.2), &reversal)),
        r#"{"kind":"reversal","t_s":0.3,"index":9,"value_m":0.0000525,"error_m":0.0000015,"route":"force","rising":true}"#
    );
    let change = Change { index: 9, parameter: Changed::Coulomb, before: 50.0, after: 80.25 };
    assert_eq!(
        change_words(Machine::Linear, &change),
        "the device has changed: coulomb friction from 50 to 80.25 N; the estimator restarts"
    );
    let event = EventJson::new(None, 9, &inerter_wire::EventKind::Changed(change), Machine::Linear);
    assert_eq!(
        json_line(&event),
        r#"{"kind":"event","t_s":null,"index":9,"code":"changed","event":"the device has changed: coulomb friction from 50 to 80.25 N; the estimator restarts","parameter":"coulomb_n","before":50.0,"after":80.25}"#
    );
    let paths = [Changed::Inertance, Changed::Viscous, Changed::Coulomb, Changed::Offset]
        .map(|parameter| changed_field(Machine::Linear, &Change { parameter, ..change }).path);
    assert_eq!(paths, ["inertance_kg", "viscous_n_s_per_m", "coulomb_n", "offset_n"]);
}

#[test]
fn a_person_sees_it_at_a_glance() {
    let truth = BTreeMap::from([("backlash_m".to_string(), "5e-5".to_string())]);
    let text = table(&estimated(detail()), &settings(true), Some(&truth));
    for words in
        ["Backlash             µm", "50.0 ± 2.0             50.0", "Contact stiffness    N/m", "2100000 ± 4000"]
    {
        assert!(text.contains(words), "{words} is not in:\n{text}");
    }
    let swapped = [("inertance_kg", "300.0"), ("changed_inertance_kg", "150.0")];
    let swapped = swapped.map(|(name, value)| (name.to_string(), value.to_string())).into();
    assert!(table(&Estimated::default(), &settings(false), Some(&swapped)).contains(" 300.0, then 150.0"));
    let words = "inertance observed from 3.12 to 6.50 Hz; 130 reversals by the terminal's sensor; contact: backlash at each reversal; \
                friction: Coulomb; the device has changed 1 time";
    assert!(text.ends_with(words), "{text}");
    // Normal states get no remark.
    assert!(row(1.0, &estimated(detail())).ends_with("50.0 ± 2.0                        at rest"));
    let odd = Detail {
        contact: Contact::Bouncing,
        friction: Friction { regime: Regime::Presliding, ..detail().friction },
        ..detail()
    };
    let moving = Estimate { moving: true, ..Estimate::default() };
    let misfit = Some(Misfit { ratio: 5.25, limit: 1.5 });
    let law = |status, misfit| Law { status, misfit, ..Law::default() };
    let broken = law(LawStatus::Broken, misfit);
    let odd = Estimated { estimate: moving, law: Some(broken), detail: Some(odd) };
    let row = row(1.0, &odd);
    assert!(row.ends_with("5.25      the flanks bounce, creeps before it slips (presliding), law broken"), "{row}");
    let words = "; law: broken (the residual is 5.2 times what noise and steps explain)";
    assert!(line(Machine::Linear, &odd).ends_with(words), "{}", line(Machine::Linear, &odd));
    let words = "holds (the residual is 5.2 times what noise and steps explain)";
    assert_eq!(law_text(&law(LawStatus::Holds, misfit)), words);
    assert_eq!(law_text(&Law::default()), "unknown");
    let words = "unknown (the residual is 5.2 times what noise and steps explain)";
    assert_eq!(law_text(&law(LawStatus::Unknown, misfit)), words);
    let below = Backlash { size: BacklashSize::BelowU95(Interval { value: 1e-6, u95: 2e-6 }), ..detail().backlash };
    assert_eq!(backlash_text(&below), "1.0 ± 2.0 (maybe none)");
    assert_eq!(backlash_text(&Backlash::default()), "too few reversals");
}
