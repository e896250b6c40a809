//! The catalogue compared with the types that it describes.

use crate::specification::fields_of;
use crate::values::{detail, estimate, health};
use inerter_core::{Detail, Estimate, Machine, Parameter, Parameters, RawSample, Settings};
use inerter_wire::catalogue::{FIELDS, Field, Group, fields, find, unit};
use inerter_wire::{Figure, Health, MAX_FIGURES, Measure, Measured, Quantity, catalogue};
use std::collections::BTreeSet;

fn paths(group: Group) -> Vec<&'static str> {
    fields(Machine::Linear, group).map(|field| field.path).collect()
}

/// Every field of every type is in the catalogue, by its name and in its order.
#[test]
fn covers_the_types() {
    assert_eq!(paths(Group::Parameter), fields_of::<Parameters>("Parameters"));
    assert_eq!(paths(Group::Sample), fields_of::<RawSample>("RawSample"));
    assert_eq!(paths(Group::Health), fields_of::<Health>("Health"));
    let mut plain = fields_of::<Estimate>("Estimate");
    plain.retain(|name| name != "recent" && name != "whole_run");
    assert_eq!(paths(Group::Estimate), plain);
    // In views, a field whose parts have a unit carries it in its name.
    let detail = fields_of::<Detail>("Detail").into_iter().map(|name| match name.as_str() {
        "band" => "band_hz".into(),
        "backlash" => "backlash_m".into(),
        _ => name,
    });
    assert_eq!(paths(Group::Detail), detail.collect::<Vec<_>>());
}

#[test]
fn words_are_fit_to_show() {
    let mut seen = BTreeSet::new();
    for Field { group, path, label, symbol, unit } in FIELDS.iter().copied() {
        assert!(seen.insert((format!("{group:?}"), path)), "{path} twice");
        assert!(!label.is_empty() && label.len() <= 40, "{path}");
        assert!(label.starts_with(char::is_uppercase), "{path}");
        let suffix = match unit {
            "kg" => "_kg",
            "Hz" => "_hz",
            "N/m" => "_n_per_m",
            "N s/m" => "_n_s_per_m",
            "N" => "_n",
            "m" => "_m",
            "s" => "_s",
            "1/1000" => "_permille",
            "bytes" => "_bytes",
            "KB" => "_kb",
            "cycles" => "_cycles",
            "µs" => "_us",
            "°C" => "_c",
            "" => "",
            other => panic!("{path}: unit {other}"),
        };
        assert!(path.ends_with(suffix), "{path} carries its unit");
        assert!(symbol.len() <= 3);
        assert_eq!(find(Machine::Linear, group, path).map(|field| field.label), Some(label));
    }
    assert_eq!(find(Machine::Linear, Group::Sample, "nothing"), None);
    // A setting and a quantity share a name only if the quantity can be set when it cannot be measured.
    let shared = FIELDS.iter().filter(|field| Settings::find(field.path).is_some());
    assert_eq!(shared.map(|field| field.path).collect::<Vec<_>>(), ["stiffness_n_per_m", "contact_damping_n_s_per_m"]);
}

/// Values beside the paths of their fields.
fn shown<T>(values: impl Iterator<Item = (&'static Field, T)>) -> Vec<(&'static str, T)> {
    values.map(|(field, value)| (field.path, value)).collect()
}

#[test]
fn values_stand_beside_their_fields() {
    let fitted = |(field, value): (&'static Field, Parameter)| (field, value.value());
    assert_eq!(
        shown(catalogue::parameters(Machine::Linear, &estimate().recent).map(fitted)),
        [
            ("inertance_kg", Some(299.5)),
            ("viscous_n_s_per_m", Some(31.25)),
            ("coulomb_n", Some(50.0)),
            ("offset_n", None)
        ]
    );

    assert_eq!(
        shown(catalogue::estimate(Machine::Linear, &estimate())),
        [
            ("index", 20_000.0),
            ("elapsed_samples", 5e9),
            ("bank", 1.0),
            ("moving", 1.0),
            ("residual_rms_n", 1.0),
            ("updates", 300.0)
        ]
    );

    let contact = shown(catalogue::contact(Machine::Linear, &detail()).map(fitted));
    assert_eq!(contact, [("stiffness_n_per_m", Some(2.1e6)), ("contact_damping_n_s_per_m", Some(1200.0))]);

    let raw = RawSample { index: 1, position_count: -2, force_code: 3, terminal_code: -4 };
    let sample = shown(catalogue::sample(&raw));
    assert_eq!(sample, [("index", 1.0), ("position_count", -2.0), ("force_code", 3.0), ("terminal_code", -4.0)]);

    assert_eq!(
        shown(catalogue::health(&health())),
        [
            ("index", Some(20_000.0)),
            ("uptime_s", Some(20.0)),
            ("dropped_frames", Some(3.0)),
            ("bad_frames", Some(1.0)),
            ("lost_samples", Some(5e9)),
            ("discontinuities", Some(2.0)),
            ("overruns", Some(1.0)),
            ("saturated", Some(7.0)),
            ("cpu_load_permille", Some(125.0)),
            ("stack_free_bytes", Some(4096.0)),
            ("temperature_c", Some(36.5)),
        ]
    );
    assert!(catalogue::health(&Health::default()).skip(8).all(|(_, value)| value.is_none()));
}

/// A rotary machine has the same quantities in the same order, with its own terms and units.
#[test]
fn machines_differ_in_words_and_units_alone() {
    let pairs = |group| fields(Machine::Linear, group).zip(fields(Machine::Rotary, group));
    for group in [Group::Parameter, Group::Estimate, Group::Detail, Group::Signal, Group::Health] {
        assert_eq!(fields(Machine::Rotary, group).count(), paths(group).len());
        for (linear, rotary) in pairs(group) {
            assert_eq!(find(Machine::Rotary, group, linear.path), Some(rotary));
            assert_eq!(rotary.unit, unit(Machine::Rotary, linear.unit), "{}", linear.path);
            assert_eq!(linear.unit, unit(Machine::Linear, linear.unit));
        }
    }
    assert_eq!(find(Machine::Rotary, Group::Parameter, "inertance_kg").map(|field| field.path), Some("inertia_kg_m2"));
    assert_eq!(unit(Machine::Rotary, "Hz"), "Hz");
    let units: Vec<_> = catalogue::contact_fields(Machine::Rotary).map(|field| field.unit).collect();
    assert_eq!(units, ["N m/rad", "N m s"]);
}

/// Each quantity has the index of its number and its own name.
#[test]
fn figures_stand_beside_their_fields() {
    let snake = |quantity: Quantity| {
        let mut path = String::new();
        for letter in format!("{quantity:?}").chars() {
            let begins = letter.is_uppercase() || letter.is_ascii_digit() && path.ends_with(char::is_alphabetic);
            path.extend((begins && !path.is_empty()).then_some('_'));
            path.extend(letter.to_lowercase());
        }
        path
    };
    let all = [
        Quantity::DeviceId,
        Quantity::FlashKb,
        Quantity::Package,
        Quantity::OptionBytes,
        Quantity::OptionBytesWanted,
        Quantity::ResetFlags,
        Quantity::StackBytes,
        Quantity::StackFreeBytes,
        Quantity::SavesLeft,
        Quantity::CoreHz,
        Quantity::UsbFrames,
        Quantity::UsbFramesCycles,
        Quantity::LsiPeriods,
        Quantity::LsiPeriodsCycles,
        Quantity::ClockUs,
        Quantity::ClockUsCycles,
        Quantity::ClockControl,
        Quantity::RecoveryStatus,
        Quantity::ReferenceCode,
        Quantity::ReferenceFactoryCode,
        Quantity::TemperatureCode,
        Quantity::TemperatureFactory30Code,
        Quantity::TemperatureFactory130Code,
        Quantity::WorkUs,
        Quantity::IdleUs,
        Quantity::SamplingCycles,
        Quantity::EstimatingCycles,
        Quantity::TelemetryCycles,
        Quantity::CommandsCycles,
        Quantity::UsbCycles,
        Quantity::SupervisingCycles,
    ];
    assert_eq!(all.map(snake).to_vec(), paths(Group::Measured));
    let mut measured = Measured::new(Measure::Chip);
    measured.push(Quantity::FlashKb, 512);
    let _ = measured.figures.push(Figure { quantity: u8::MAX, value: 7 });
    assert_eq!(shown(catalogue::measured(&measured)), [("flash_kb", 512)]);
    assert_eq!((measured.get(Quantity::FlashKb), measured.get(Quantity::Package)), (Some(512), None));
    measured.push(Quantity::FlashKb, 512);
    assert_eq!(measured.get(Quantity::FlashKb), None, "two figures of one quantity say nothing");
    (0..2 * MAX_FIGURES).for_each(|_| measured.push(Quantity::Package, 1));
    assert_eq!(measured.figures.len(), MAX_FIGURES);
}
