//! Valid settings, the way they are reported, and the quantities derived from them.

use inerter_core::{FrontEnd, Kind, Machine, RawSample, SettingInfo, Settings, SettingsError, State};

/// A value that differs from the default and is valid by itself.
fn another(info: &SettingInfo) -> f64 {
    match info.kind {
        Kind::Whole if info.default + 1.0 <= info.max => info.default + 1.0,
        Kind::Whole => info.default - 1.0,
        _ => 0.5 * (info.default + info.max.min(2.0 * info.default + 0.5)),
    }
}

#[test]
fn each_setting_is_set_and_read_by_its_name_and_no_other_changes() {
    let default = Settings::default();
    assert_eq!(default.values().to_vec(), Settings::TABLE.iter().map(|info| info.default).collect::<Vec<_>>());
    for (number, info) in Settings::TABLE.iter().enumerate() {
        let value = another(info);
        assert!(value != info.default, "{}", info.name);
        let mut settings = default;
        settings.set_by_name(info.name, value).unwrap();
        assert_eq!((Settings::find(info.name), settings.get(info.name)), (Some(number), Some(value)));
        for (other, (now, before)) in settings.values().into_iter().zip(default.values()).enumerate() {
            assert_eq!(now != before, other == number, "{}", info.name);
        }
        settings.set(number, info.default).unwrap();
        assert_eq!(settings, default);
    }
    assert_eq!(Settings::find("weight"), None);
    assert_eq!(default.get("weight"), None);
    assert_eq!({ default }.set_by_name("weight", 1.0), Err(SettingsError::Unknown));
    assert_eq!({ default }.set(Settings::COUNT, 1.0), Err(SettingsError::Unknown));
    let choices = |front_end: f64, sensor: f64, machine: f64| {
        let mut settings = default;
        for (name, value) in [("front_end", front_end), ("terminal_sensor", sensor), ("machine", machine)] {
            settings.set_by_name(name, value).unwrap();
        }
        (settings.front_end, settings.terminal_sensor, settings.machine)
    };
    assert_eq!(choices(0.0, 0.0, 0.0), (FrontEnd::Analogue, false, Machine::Linear));
    assert_eq!(choices(1.0, 1.0, 1.0), (FrontEnd::Ads131m04, true, Machine::Rotary));
}

#[test]
fn units_stand_at_the_ends_of_names() {
    assert_eq!(Settings::described().count(), Settings::COUNT);
    for (info, text) in Settings::described() {
        // "N s/m" is written "n_s_per_m", and 2 means squared.
        let unit = text.unit.to_lowercase().replace('/', "_per_").replace(' ', "_").replace('^', "");
        let is_scale =
            info.name.contains("_per_count") || info.name.contains("_per_code") || info.name.contains("terminal_code");
        assert!(is_scale || info.name.ends_with(&unit), "{} in {}", info.name, text.unit);
        assert!(!text.help.is_empty());
    }
}

/// The value is refused by itself, and together with all other settings.
#[track_caller]
fn refused(name: &'static str, value: f64) -> SettingsError {
    let error = { Settings::default() }.set_by_name(name, value).unwrap_err();
    let info = Settings::TABLE[Settings::find(name).unwrap()];
    assert_eq!(info.check(value).unwrap_err().to_string(), error.to_string());
    error
}

#[test]
fn values_out_of_range_are_refused_and_the_ends_are_not() {
    for info in Settings::TABLE {
        assert_eq!(info.check(info.min), Ok(()), "{}", info.name);
        assert_eq!(info.check(info.max), Ok(()), "{}", info.name);
        assert_eq!(info.check(info.default), Ok(()), "{}", info.name);
        for value in [info.min - 1.0, info.max + 1.0] {
            let wanted = SettingsError::OutOfRange { field: info.name, value, min: info.min, max: info.max };
            assert_eq!(refused(info.name, value), wanted);
        }
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(refused(info.name, value), SettingsError::NotFinite { field: info.name });
        }
        let half = info.min + 0.5;
        let wanted = (info.kind == Kind::Whole).then_some(SettingsError::NotWhole { field: info.name, value: half });
        assert_eq!(info.check(half).err().filter(|error| matches!(error, SettingsError::NotWhole { .. })), wanted);
        for (value, is_zero) in [(0.0, true), (9e-13, true), (-9e-13, true), (1e-12, false), (-1.1e-12, false)] {
            let wanted = (info.kind == Kind::NonZero && is_zero).then_some(SettingsError::Zero { field: info.name });
            assert_eq!(info.check(value).err().filter(|error| matches!(error, SettingsError::Zero { .. })), wanted);
        }
    }
    // A value written to a field without a check is refused too.
    let settings = Settings { memory_s: f64::NAN, ..Settings::default() };
    assert_eq!(settings.validate().err(), Some(SettingsError::NotFinite { field: "memory_s" }));
    let settings = Settings { oversampling: 1.5, ..Settings::default() };
    assert_eq!(settings.validate().err(), Some(SettingsError::NotWhole { field: "oversampling", value: 1.5 }));
}

#[test]
fn errors_name_the_field_and_what_is_allowed() {
    let told = |error: SettingsError| error.to_string();
    assert_eq!(told(SettingsError::Unknown), "no setting has this name");
    assert_eq!(told(refused("memory_s", f64::NAN)), "memory_s: the value is not a finite number");
    assert_eq!(told(refused("memory_s", 0.25)), "memory_s: 0.25 is outside 0.5 to 3600");
    assert_eq!(told(refused("oversampling", 2.5)), "oversampling: 2.5 is not a whole number");
    assert_eq!(told(refused("newtons_per_code", 0.0)), "newtons_per_code: must be at least 1e-12 in magnitude");
    let conflict = SettingsError::Conflict { field: "one", other: "another", rule: "both or none" };
    assert_eq!(told(conflict), "one and another: both or none");
    let not_offered = |offered| told(SettingsError::NotOffered { field: "sample_rate_hz", value: 3000.0, offered });
    assert_eq!(not_offered(&[]), "sample_rate_hz: the board does not offer 3000, but");
    assert_eq!(not_offered(&[1000.0]), "sample_rate_hz: the board does not offer 3000, but 1000");
    assert_eq!(not_offered(&[1e3, 2e3]), "sample_rate_hz: the board does not offer 3000, but 1000 and 2000");
    assert_eq!(not_offered(&[1e3, 2e3, 4e3]), "sample_rate_hz: the board does not offer 3000, but 1000, 2000 and 4000");
}

fn conflict(settings: Settings) -> Option<(&'static str, &'static str)> {
    match settings.validate() {
        Ok(_) => None,
        Err(SettingsError::Conflict { field, other, .. }) => Some((field, other)),
        Err(error) => panic!("{error}"),
    }
}

#[test]
fn settings_that_contradict_each_other_are_refused_at_the_limit() {
    let codes = |force_min_code, force_zero_code, force_max_code| {
        conflict(Settings { force_min_code, force_zero_code, force_max_code, ..Settings::default() })
    };
    assert_eq!(codes(-2.0, 0.0, 2.0), None);
    assert_eq!(codes(-1.0, 0.0, 1.0), None);
    for (least, greatest) in [(5.0, 5.0), (6.0, 5.0)] {
        assert_eq!(codes(least, 5.0, greatest), Some(("force_min_code", "force_max_code")));
    }
    for zero in [-2.0, -3.0, 2.0, 3.0] {
        assert_eq!(codes(-2.0, zero, 2.0), Some(("force_zero_code", "force_min_code and force_max_code")), "{zero}");
    }
    // 64 million counts in all readings of a sample together: at 1 kHz, 64e9 per second.
    let travel = |full_scale_velocity_m_per_s, oversampling, metres_per_count: f64| {
        conflict(Settings { full_scale_velocity_m_per_s, oversampling, metres_per_count, ..Settings::default() })
    };
    let refused = Some(("full_scale_velocity_m_per_s", "metres_per_count"));
    for sign in [1.0, -1.0] {
        assert_eq!(travel(6.3, 1.0, sign * 1e-10), None);
        assert_eq!(travel(6.5, 1.0, sign * 1e-10), refused);
        assert_eq!(travel(6.3, 2.0, sign * 2e-10), None);
        assert_eq!(travel(6.5, 2.0, sign * 2e-10), refused);
    }
    let faster = Settings { sample_rate_hz: 2000.0, full_scale_velocity_m_per_s: 12.6, ..Settings::default() };
    assert_eq!(conflict(Settings { metres_per_count: 1e-10, ..faster }), None);
    // A structure with a natural frequency of 62.5 Hz, one over the box of 16 ms.
    let structure = |structure_mass_kg, own_hz: f64| {
        let stiffness_n_per_m = structure_mass_kg * (own_hz * std::f64::consts::TAU).powi(2);
        conflict(Settings { structure_mass_kg, stiffness_n_per_m, ..Settings::default() })
    };
    for mass_kg in [0.5, 3.0] {
        assert_eq!(structure(mass_kg, 63.0), None);
        assert_eq!(structure(mass_kg, 62.0), Some(("stiffness_n_per_m", "structure_mass_kg")));
    }
    assert_eq!(conflict(Settings { stiffness_n_per_m: 1.0, ..Settings::default() }), None);
    assert_eq!(conflict(Settings { structure_mass_kg: 1.0, ..Settings::default() }), None);
}

#[test]
fn a_skew_is_whole_samples_and_less_than_half_of_one() {
    for sample_rate_hz in [50.0, 1000.0, 3906.25, 5000.0] {
        for part in -50..=50 {
            let skew_s = f64::from(part) * 1e-4;
            let (whole, rest) = Settings { sample_rate_hz, skew_s, ..Settings::default() }.skew_parts();
            assert!((f64::from(whole) / sample_rate_hz + rest - skew_s).abs() < 1e-12, "{skew_s} s");
            assert!(rest.abs() * sample_rate_hz <= 0.5 + 1e-9, "{skew_s} s: {rest}");
        }
    }
    let parts = |skew_s: f64| Settings { skew_s, ..Settings::default() }.skew_parts().0;
    assert_eq!([0.0014, 0.0016, -0.0014, -0.0016, 0.0].map(parts), [1, 2, -1, -2, 0]);
}

/// Estimates appear at the publish rate, at the sample that is due, with the correct counts.
#[test]
fn estimates_come_at_their_rate() {
    for (sample_rate_hz, publish_rate_hz, every) in
        [(1000.0, 5.0, 200), (1000.0, 10.0, 100), (4000.0, 0.1, 40_000), (50.0, 10.0, 5), (1000.0, 6.0, 167)]
    {
        let settings = Settings { sample_rate_hz, publish_rate_hz, ..Settings::default() };
        let active = settings.validate().unwrap();
        assert_eq!(*active.settings(), settings);
        let mut state = Box::new(State::new(&active));
        for n in 1..=2 * every {
            // Three samples are missing at the eleventh.
            let index = if n > 10 { n + 3 } else { n };
            let estimate = active.step(&mut state, &RawSample { index, ..RawSample::default() }).estimate();
            assert_eq!(estimate.is_some(), n % every == 0, "{n} of {every}");
            if let Some(estimate) = estimate {
                assert_eq!((estimate.index, state.last_index()), (index, index));
                let lost = if n > 10 { 3 } else { 0 };
                assert_eq!(estimate.elapsed_samples, u64::from(n + lost));
                assert!(!estimate.moving);
            }
        }
    }
}
