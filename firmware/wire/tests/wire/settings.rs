//! Settings exchanged between ends of different versions.

use inerter_core::{Settings, SettingsError};
use inerter_wire::*;

/// Every setting by its number.
const NAMES: &[&str] = &[
    "sample_rate_hz",
    "metres_per_count",
    "oversampling",
    "newtons_per_code",
    "force_zero_code",
    "force_min_code",
    "force_max_code",
    "metres_per_terminal_code",
    "structure_mass_kg",
    "structure_mass_u95_kg",
    "stiffness_n_per_m",
    "contact_damping_n_s_per_m",
    "skew_s",
    "skew_u95_s",
    "force_gain_u95",
    "lead_u95",
    "timebase_u95",
    "memory_s",
    "stuck_displacement_m",
    "publish_rate_hz",
    "full_scale_velocity_m_per_s",
    "full_scale_acceleration_m_per_s2",
    "front_end",
    "stiffness_u95_n_per_m",
    "terminal_sensor",
    "machine",
];

fn values(pairs: &[(u8, f64)]) -> SettingsValues {
    SettingsValues(pairs.iter().map(|&(number, value)| SettingValue { number, value }).collect())
}

fn number(name: &str) -> u8 {
    Settings::find(name).unwrap() as u8
}

fn changed() -> Settings {
    let mut settings = Settings::default();
    settings.set_by_name("structure_mass_kg", 1.515).unwrap();
    settings.set_by_name("metres_per_count", -1e-6).unwrap();
    settings
}

#[test]
fn all_settings_there_and_back() {
    let sent = SettingsValues::from(&changed());
    assert_eq!(sent.0.len(), Settings::COUNT);
    let reading = sent.read(&Settings::default());
    assert_eq!(reading, Reading { settings: changed(), unknown: 0, impossible: 0, missing: 0 });
    assert_eq!(sent.write(&Settings::default()), Ok(changed()));
}

#[test]
fn every_setting_has_its_number() {
    for (place, info) in Settings::TABLE.iter().enumerate() {
        let mut sent = SettingsValues::default();
        sent.push_by_name(info.name, info.default).unwrap();
        assert_eq!(sent.0[..], [SettingValue { number: place as u8, value: info.default }]);
    }
    // Recordings refer to these numbers forever. Append new names at the end, here too.
    let names: Vec<&str> = Settings::TABLE.iter().map(|info| info.name).collect();
    assert_eq!(names, NAMES);
}

#[test]
fn only_what_differs() {
    let difference = SettingsValues::difference(&changed(), &Settings::default());
    assert_eq!(difference, values(&[(number("metres_per_count"), -1e-6), (number("structure_mass_kg"), 1.515)]));
    assert_eq!(difference.write(&Settings::default()), Ok(changed()));
    assert!(SettingsValues::difference(&changed(), &changed()).0.is_empty());
}

#[test]
fn a_newer_device_is_read_without_what_is_new() {
    let mut sent = SettingsValues::from(&changed());
    for number in [Settings::COUNT as u8, 200, 255] {
        sent.0.push(SettingValue { number, value: f64::NAN }).unwrap();
    }
    let reading = sent.read(&Settings::default());
    assert_eq!(reading, Reading { settings: changed(), unknown: 3, impossible: 0, missing: 0 });
}

#[test]
fn an_older_device_is_read_over_the_base() {
    let reading = values(&[(number("structure_mass_kg"), 3.0)]).read(&changed());
    assert_eq!(reading.missing, Settings::COUNT - 1);
    assert_eq!(reading.settings.structure_mass_kg, 3.0);
    assert_eq!(reading.settings.metres_per_count, -1e-6);
}

#[test]
fn values_that_only_later_firmware_takes_are_left_out() {
    let sent = [(number("front_end"), 7.0), (number("memory_s"), f64::NAN), (number("structure_mass_kg"), 3.0)];
    let reading = values(&sent).read(&changed());
    assert_eq!(reading.settings, Settings { structure_mass_kg: 3.0, ..changed() });
    assert_eq!((reading.unknown, reading.impossible, reading.missing), (0, 2, Settings::COUNT - 3));
}

#[test]
fn a_write_is_taken_whole_or_refused_by_number() {
    let mass = number("structure_mass_kg");
    for (pairs, number, fault) in [
        (&[(Settings::COUNT as u8, 1.0)][..], Settings::COUNT as u8, SettingFault::Unknown),
        (&[(mass, 1.0), (255, 1.0)], 255, SettingFault::Unknown),
        (&[(mass, f64::NAN)], mass, SettingFault::NotFinite),
        (&[(mass, f64::INFINITY)], mass, SettingFault::NotFinite),
        (&[(mass, -1.0)], mass, SettingFault::OutOfRange),
        (&[(number("oversampling"), 1.5)], number("oversampling"), SettingFault::NotWhole),
        (&[(number("metres_per_count"), 0.0)], number("metres_per_count"), SettingFault::Zero),
        (&[(mass, 1.0), (mass, 2.0)], mass, SettingFault::Repeated),
    ] {
        assert_eq!(values(pairs).write(&Settings::default()), Err(Refusal::BadSetting { number, fault }));
    }
    assert_eq!(values(&[]).write(&changed()), Ok(changed()));
}

#[test]
fn names_are_checked_before_sending() {
    let mut sent = SettingsValues::default();
    assert_eq!(sent.push_by_name("structure_mass", 1.0), Err(SettingsError::Unknown));
    assert!(matches!(sent.push_by_name("memory_s", f64::NAN), Err(SettingsError::NotFinite { field: "memory_s" })));
    assert!(sent.0.is_empty());
    // The later of two values wins, so that a request never repeats a setting.
    sent.push_by_name("memory_s", 5.0).unwrap();
    sent.push_by_name("memory_s", 6.0).unwrap();
    assert_eq!(sent, values(&[(number("memory_s"), 6.0)]));
}

#[test]
fn refusals_name_the_setting_and_the_next_step() {
    let text = |number, fault| Refusal::BadSetting { number, fault }.to_string();
    let memory = number("memory_s");
    assert_eq!(text(memory, SettingFault::OutOfRange), "memory_s: the value is outside 0.5 to 3600");
    assert_eq!(
        text(memory, SettingFault::Conflict(number("publish_rate_hz"))),
        "memory_s: the value contradicts publish_rate_hz: change one of the two"
    );
    assert_eq!(
        text(250, SettingFault::Unknown),
        "setting number 250: the device has no such setting: update its firmware"
    );
    assert_eq!(text(250, SettingFault::OutOfRange), "setting number 250: the value is outside its range");
}

#[test]
fn errors_of_validation_keep_their_field() {
    let field = "memory_s";
    let number = number(field);
    for (error, fault) in [
        (SettingsError::NotFinite { field }, SettingFault::NotFinite),
        (SettingsError::OutOfRange { field, value: 0.0, min: 0.5, max: 3600.0 }, SettingFault::OutOfRange),
        (SettingsError::NotWhole { field, value: 0.5 }, SettingFault::NotWhole),
        (SettingsError::Zero { field }, SettingFault::Zero),
        (SettingsError::Conflict { field, other: "sample_rate_hz", rule: "" }, SettingFault::Conflict(0)),
        (SettingsError::NotOffered { field, value: 3.0, offered: &[1.0, 2.0] }, SettingFault::NotOffered),
    ] {
        assert_eq!(Refusal::of_setting(&error, 99), Refusal::BadSetting { number, fault });
    }
    let unknown = Refusal::of_setting(&SettingsError::Unknown, 99);
    assert_eq!(unknown, Refusal::BadSetting { number: 99, fault: SettingFault::Unknown });
}
