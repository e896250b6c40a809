use super::*;
use crate::{
    text::{is_trouble, value_text},
    words::{amount_text, interval_text, rounded_text},
};
use inerter_core::{Estimate, Interval, LawStatus, Misfit};

fn estimate() -> Estimated {
    let parameter = |value, u95, status| Parameter::new(Interval { value, u95 }, status);
    let recent = Parameters {
        inertance_kg: parameter(299.4906, 0.12, Status::Ok),
        viscous_n_s_per_m: parameter(31.4, 2.5, Status::Held),
        coulomb_n: parameter(0.0, f32::INFINITY, Status::NotIdentifiable),
        offset_n: parameter(f32::NAN, f32::NAN, Status::Ok),
    };
    Estimate { recent, whole_run: recent, moving: true, residual_rms_n: 1.5, updates: 7, ..Estimate::default() }.into()
}

#[test]
fn the_json_contract_holds_to_the_letter() {
    let four = r#""inertance_kg":{"value":299.4906,"u95":0.12,"status":"ok"},"viscous_n_s_per_m":{"value":31.4,"u95":2.5,"status":"held"},"coulomb_n":{"value":null,"u95":null,"status":"not_identifiable"},"offset_n":{"value":null,"u95":null,"status":"not_identifiable"}"#;
    let tail = r#""moving":true,"bank":"fast","residual_rms_n":1.5,"updates":7"#;
    let counters = Counters { samples: 10, discontinuities: 1, lost_samples: 2, saturated: 3 };
    assert_eq!(
        json_line(&EstimateJson::last(20.0, &estimate(), &Settings::default(), Some(counters))),
        format!(
            r#"{{"kind":"estimate","final":true,"t_s":20.0,"whole_run":{{{four}}},{four},{tail},"samples":10,"discontinuities":1,"lost_samples":2,"saturated":3}}"#
        )
    );
    assert_eq!(
        json_line(&EstimateJson::live(0.2, &estimate(), &Settings::default())),
        format!(r#"{{"kind":"estimate","t_s":0.2,"whole_run":{{{four}}},{four},{tail}}}"#)
    );
    let head = r#""moving":true,"bank":"fast","residual_rms_n":1.5"#;
    for (law, text) in [
        (Law::default(), r#"{"status":"unknown","ratio":null,"limit":null}"#),
        (
            Law { status: LawStatus::Broken, misfit: Some(Misfit { ratio: 5.25, limit: 1.5 }), ..Law::default() },
            r#"{"status":"broken","ratio":5.25,"limit":1.5}"#,
        ),
    ] {
        assert_eq!(
            json_line(&EstimateJson::live(0.2, &Estimated { law: Some(law), ..estimate() }, &Settings::default())),
            format!(r#"{{"kind":"estimate","t_s":0.2,"whole_run":{{{four}}},{four},{head},"law":{text},"updates":7}}"#)
        );
    }
}

#[test]
fn health_in_json_uses_the_catalogues_names() {
    let health = Health { index: 5, lost_samples: 3, temperature_c: Some(31.5), ..Health::default() };
    let json = health_json(&health);
    assert_eq!(json.get("kind").and_then(|kind| kind.as_str()), Some("health"));
    assert_eq!(json.get("lost_samples").and_then(|lost| lost.as_i64()), Some(3));
    assert_eq!(json.get("temperature_c").and_then(|value| value.as_f64()), Some(31.5));
    assert!(json.get("cpu_load_permille").is_some_and(|value| value.is_null()));
}

#[test]
fn digits_follow_the_interval() {
    let text = |value, u95| value_text(&Parameter::Ok(Interval { value, u95 }));
    assert_eq!(text(299.4906, 0.12), "299.49 ± 0.12");
    assert_eq!(text(203.5, 14.0), "204 ± 14");
    assert_eq!(text(203.5, 1400.0), "200 ± 1400");
    assert_eq!(text(0.01234, 0.00056), "0.01234 ± 0.00056");
    assert_eq!(text(5.0, f32::INFINITY), "5.0000");
    assert_eq!(interval_text(2_100_034.0, 10_753.0), "2100000 ± 11000");
    assert_eq!(interval_text(-1_249.0, 99.6), "-1249 ± 100");
    assert_eq!(rounded_text(1.013_5e-3, 4.2e-5), "0.001014");
    // A small axis.
    assert_eq!(interval_text(2.000_24e-4, 1.04e-6), "(2.000 ± 0.010)e-4");
    assert_eq!(interval_text(-3.1e-9, 6.6e-9), "(-3.1 ± 6.6)e-9");
    assert_eq!(interval_text(0.0, 2e-12), "(0.0 ± 2.0)e-12");
    assert_eq!([rounded_text(2.000_24e-4, 1.04e-6), rounded_text(1.04e-6, 1.04e-6)], ["2.000e-4", "1.0e-6"]);
    assert_eq!(
        [1.823, 0.3845, 0.0312, 7.3e-5, 6.2e-7, 0.0].map(|value| amount_text(value, 2)),
        ["1.82", "0.38", "0.031", "0.000073", "6.2e-7", "0.00"]
    );
}

#[test]
fn codes_are_those_of_the_contract() {
    use inerter_core::{Bank, Contact, Regime, Route};
    assert_eq!([Bank::Fast, Bank::Slow].map(|bank| code(&bank)), ["fast", "slow"]);
    assert_eq!([Route::Force, Route::Terminal].map(|route| code(&route)), ["force", "terminal"]);
    let laws = [LawStatus::Unknown, LawStatus::Holds, LawStatus::Broken].map(|status| code(&status));
    assert_eq!(laws, ["unknown", "holds", "broken"]);
    let contacts = [Contact::Unknown, Contact::OneSided, Contact::Closed, Contact::Backlash, Contact::Bouncing];
    let contacts = contacts.map(|contact| code(&contact));
    assert_eq!(contacts, ["unknown", "one_sided", "closed", "backlash", "bouncing"]);
    let regimes = [Regime::Unknown, Regime::Coulomb, Regime::Presliding, Regime::Stribeck].map(|regime| code(&regime));
    assert_eq!(regimes, ["unknown", "coulomb", "presliding", "stribeck"]);
}

#[test]
fn events_have_a_code_for_programs_and_words_for_people() {
    use inerter_wire::{EventKind, Fault, Hello, ResetCause, Source};
    for (kind, code, words, trouble) in [
        (EventKind::Started, "started", "the device has started", false),
        (EventKind::SourceChanged(Source::Link), "source_changed.link", "samples now come from: link", false),
        (EventKind::Fault(Fault::NewerSettings), "fault.newer_settings", "from a newer firmware", true),
        (EventKind::Fault(Fault::ForeignSettings), "fault.foreign_settings", "another program's", true),
        (EventKind::Fault(Fault::SamplerMisaligned), "fault.sampler_misaligned", "ran apart", true),
        (EventKind::Fault(Fault::SettingsLeft), "fault.settings_left", "left alone", true),
        (EventKind::ResetBy(ResetCause::PowerOn), "reset_by.power_on", "started by power", false),
        (EventKind::ResetBy(ResetCause::Pin), "reset_by.pin", "the reset pin", false),
        (EventKind::ResetBy(ResetCause::WindowWatchdog), "reset_by.window_watchdog", "the window watchdog", true),
        (EventKind::Panicked(Hello::text("at app.rs:7")), "panicked", "at app.rs:7", true),
    ] {
        assert_eq!(event_code(&kind), code);
        assert!(event_words(Machine::Linear, &kind).contains(words), "{}", event_words(Machine::Linear, &kind));
        assert_eq!(is_trouble(&kind), trouble, "{kind:?}");
    }
}
