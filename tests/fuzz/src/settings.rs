//! Settings as people write them: TOML files, assignments, backups, and accuracy requirements for a motion.
//!
//! Input: a byte (the kind of text), then the text.
//!
//! Properties: every accepted setting is valid, and writing it out gives the same value. The owner of a backup reads
//! back, whatever the device's name is. Every error can be displayed.

use inerter_core::{Machine, Settings};
use inerter_data::{
    backup,
    settings::{Overrides, SettingsInputError, to_toml},
    wants,
};
use inerter_wire::Hello;

use crate::{
    csv::shown,
    input::{Input, counted, seed},
    mcap::hello,
    scratch,
};

/// Checks an input.
pub fn check(mut input: Input) {
    match input.byte() % 4 {
        0 => check_file(input.rest()),
        1 => {
            let lines = String::from_utf8_lossy(input.rest());
            check_values(Overrides::from_inputs(None, &lines.lines().map(str::to_string).collect::<Vec<_>>()));
        }
        2 => {
            let machine = if input.byte() & 1 == 0 { Machine::Linear } else { Machine::Rotary };
            check_wants(&String::from_utf8_lossy(input.rest()), machine);
        }
        _ => check_backup(&mut input),
    }
}

fn check_file(text: &[u8]) {
    let file = scratch::file(text);
    let read = Overrides::from_inputs(Some(&file), &[]);
    assert_eq!(backup::read(&file).is_ok(), read.is_ok(), "a backup is a file of settings");
    check_values(read);
}

fn check_values(read: Result<Overrides, SettingsInputError>) {
    let Some(overrides) = shown(read) else { return };
    let mut settings = Settings::default();
    overrides.apply(&mut settings).expect("each value was checked");
    for info in Settings::TABLE {
        let value = settings.get(info.name).expect("a setting of the table");
        assert!(info.check(value).is_ok() && overrides.get(info.name).is_none_or(|given| given == value), "{info:?}");
    }
    assert_eq!(read_back(&to_toml(&settings)), settings);
}

fn read_back(text: &str) -> Settings {
    let (file, mut settings) = (scratch::file(text.as_bytes()), Settings::default());
    let overrides = Overrides::from_inputs(Some(&file), &[]).expect("what was written is read");
    overrides.apply(&mut settings).expect("what was written is valid");
    settings
}

fn check_wants(text: &str, machine: Machine) {
    if let Some(wants) = shown(wants::parse(text, machine, [300.0, 30.0, 50.0, 0.0])) {
        assert!(wants.iter().all(|want| want.place < 4 && want.u95 > 0.0 && want.u95.is_finite()), "{wants:?}");
    }
}

fn check_backup(input: &mut Input) {
    let mut text = || String::from_utf8_lossy(input.counted()).into_owned();
    let hello = Hello {
        firmware: Hello::text(&text()),
        git: Hello::text(&text()),
        board: Hello::text(&text()),
        serial: Hello::text(&text()),
        ..hello()
    };
    let settings = Settings { memory_s: 7.0, ..Settings::default() };
    let text = backup::text(&hello, &settings);
    let file = scratch::file(text.as_bytes());
    let read = backup::read(&file).expect("what was written is read");
    assert!(read.check_owner(&file, &hello).is_ok(), "{:?} of {text}", read.owner);
    assert_eq!(read_back(&text), settings);
}

/// Files that the program writes, and common mistakes.
pub fn seeds() -> Vec<Vec<u8>> {
    let whole = to_toml(&Settings { stiffness_n_per_m: 2.1e6, ..Settings::default() });
    let short: String = whole.lines().filter(|line| !line.starts_with('#')).map(|line| format!("{line}\n")).collect();
    let mut seeds = vec![seed(&[0], &whole), seed(&[0], &short)];
    for text in [
        "memory_s = 20\nskew_s = -1e-4\n",
        "# board: nucleo-g474re\n# serial: \"F-1\"\n\nmemory_s = 2_0\nmachine = 1 # rotary\n",
        "memory_s = 0x1F\nskew_s = +inf\n",
        "[settings]\nmemory_s.value = 20\n",
        "memory_s = \"20\"\n",
        "memory_s 20\n",
        "\"memory_s\" = 1979-05-27\r\n",
    ] {
        seeds.push(seed(&[0], text));
    }
    for line in short.lines() {
        seeds.push(seed(&[1], line));
    }
    seeds.push(seed(&[1], &short));
    for text in
        ["fc to 0.3 N, mt to 0.1 %", "Coulomb friction to 3e-1 N;cf to 2 N s/m", "mt to 1e-6 kg m2", "fd to zero"]
    {
        seeds.extend([0, 1].map(|machine| seed(&[2, machine], text)));
    }
    for texts in [["inerter 0.1.0", "c8a2d5a", "nucleo-g474re", "205735883537"], ["", " ", "\"", "\n\u{1b}é"]] {
        seeds.push(seed(&[3], texts.map(counted).concat()));
    }
    seeds
}
