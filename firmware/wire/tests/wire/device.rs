//! The device's identity, capabilities and reports.

use inerter_wire::*;
use std::collections::BTreeSet;
use std::fmt::Display;

#[test]
fn texts_are_cut_at_the_edge_of_a_character() {
    assert_eq!(Hello::text::<4>("a\u{b5}b").as_str(), "a\u{b5}b");
    assert_eq!(Hello::text::<4>("abc\u{b5}").as_str(), "abc");
    assert_eq!(Hello::text::<0>("a").as_str(), "");
}

#[test]
fn sets_of_capabilities_hold_what_was_put_in_once_or_twice() {
    let set = Capabilities::DFU.with(Capabilities::STORE).with(Capabilities::DFU);
    assert!(set.contains(Capabilities::DFU) && set.contains(Capabilities::STORE));
    assert!(set.contains(Capabilities::NONE) && !Capabilities::NONE.contains(set));
    assert!(!Capabilities::DFU.contains(set));
}

/// Their texts, each of its own.
fn texts<T: Display, const N: usize>(all: [T; N]) -> [String; N] {
    let texts = all.map(|one| one.to_string());
    assert_eq!(BTreeSet::from(texts.clone()).len(), N);
    texts
}

/// Every cause and fault has its own text, and each fault says what to do or what applies in the meantime.
#[test]
fn causes_and_faults_are_told_apart() {
    let causes = texts([
        ResetCause::PowerOn,
        ResetCause::Pin,
        ResetCause::Software,
        ResetCause::Watchdog,
        ResetCause::WindowWatchdog,
        ResetCause::LowPower,
        ResetCause::OptionBytes,
        ResetCause::Panic,
        ResetCause::Unknown,
    ]);
    assert!(causes.iter().all(|text| !text.is_empty()), "{causes:?}");
    let faults = texts([
        Fault::SamplerOverrun,
        Fault::SourceUnreadable,
        Fault::Store,
        Fault::SavedSettings,
        Fault::Watchdog,
        Fault::NewerSettings,
        Fault::ForeignSettings,
        Fault::SamplerMisaligned,
        Fault::SettingsLeft,
    ]);
    assert!(faults.iter().all(|text| text.contains([':', ','])), "{faults:?}");
}

/// The advice is to update the older of the two ends.
#[test]
fn advice_names_the_older_end() {
    let advice = |theirs| VersionAdvice { theirs }.to_string();
    let newer = advice(WIRE_VERSION + 2);
    assert!(newer.contains("program") && newer.contains(&(WIRE_VERSION + 2).to_string()), "{newer}");
    let older = advice(WIRE_VERSION - 1);
    assert!(older.contains("firmware") && older.contains(&WIRE_VERSION.to_string()), "{older}");
}

/// One edge per step: at most 64 counts between knots in either direction, and not a 256th more.
#[test]
fn knots_go_as_far_as_one_edge_a_step_and_no_farther() {
    let by = |advance| Knot { advance, ..Knot::default() }.is_possible();
    let most = 64 * 256;
    for (advance, is_possible) in
        [(0, true), (most, true), (-most, true), (most + 1, false), (-most - 1, false), (i16::MIN, false)]
    {
        assert_eq!(by(advance), is_possible, "{advance}");
    }
    assert_eq!(2 * u32::from(Knot::MIDDLE), 4096 * 16, "half of 12 bits, in sixteenths");
}
