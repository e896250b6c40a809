//! The program with firmware images, and with the settings saved by a device.

use std::{
    fs,
    io::{Read, Write},
    net::TcpListener,
    thread,
};

use crate::common::{device, done, elf_file, fails, frames, inerter, last, text};
use inerter_device::{Clock, Device, Target};
use inerter_wire::Command;

/// A serial number that no device has: devices plugged into this machine must not be touched.
const NOBODY: [&str; 2] = ["--serial", "no such device"];

#[test]
fn a_dry_run_says_what_would_be_written() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("i.elf"), elf_file::image(5000, "inerter 0.1.0", "c8a2d5a")).unwrap();
    let words = done(folder.path(), &["update", "i.elf", "--dry-run"]);
    assert_eq!(
        words,
        "i.elf: inerter 0.1.0 (c8a2d5a) for nucleo-g474re\nwould erase and write 5.0 KB in 4 pages:\n  \
         0x08000000 to 0x080017FF\n  0x08020000 to 0x080207FF\nsettings would be kept\n"
    );
    let line = last(&done(folder.path(), &["update", "i.elf", "--dry-run", "--json"]));
    assert_eq!((line.get("bytes").unwrap(), line.get("pages").unwrap()), (&5100.into(), &4.into()));
    assert_eq!(line.pointer("/extents/1/first").unwrap(), 0x0802_0000);
}

#[test]
fn images_that_do_not_fit_the_board_are_refused_by_either_way_before_a_device_is_looked_for() {
    let folder = tempfile::tempdir().unwrap();
    let code = elf_file::code(5000, "inerter 0.1.0", "c8a2d5a", "nucleo-g474re");
    let nameless = elf_file::code(5000, "", "", "");
    let with = |address, bytes: &[u8]| elf_file::elf(elf_file::ARM, &[(0x0800_0000, &code), (address, bytes)]);
    for (bytes, words) in [
        (elf_file::elf(62, &[(0x0800_0000, &code)]), "f is a program for a PC, not for the board's Arm Cortex-M4"),
        (with(0x0807_C000, &[0; 8]), "over the settings at 0x0807C000 to 0x08080000"),
        (with(0x0804_0000, &[0; 8]), "f has bytes for 0x08040000 to 0x08040008; the firmware lies in 0x08000000"),
        (elf_file::elf(elf_file::ARM, &[(0x0800_0000, &nameless)]), "f identifies its firmware in an unknown format"),
        (elf_file::elf(elf_file::ARM, &[(0x0800_0000, &[0; 64])]), "f cannot start on the board"),
    ] {
        fs::write(folder.path().join("f"), bytes).unwrap();
        let said = fails(folder.path(), &["update", "f", NOBODY[0], NOBODY[1]], 3);
        assert!(said.contains(words), "{said}");
        if cfg!(feature = "probe") {
            let said = fails(folder.path(), &["flash", "f", "--probe", "ffff:ffff:none"], 3);
            assert!(said.contains(words), "{said}");
        }
    }
}

#[test]
fn without_a_device_an_update_says_what_to_plug_in() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("i.elf"), elf_file::image(5000, "inerter 0.1.0", "c8a2d5a")).unwrap();
    let words = fails(folder.path(), &["update", "i.elf", NOBODY[0], NOBODY[1]], 5);
    // A container may have no USB.
    let expected = ["no instrumented inerter was found with serial no such device", "cannot be listed"];
    assert!(expected.iter().any(|expected| words.contains(expected)), "{words}");
    assert!(words.contains("help: "), "{words}");
}

#[cfg(feature = "probe")]
#[test]
fn without_a_probe_programming_says_what_to_plug_in() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("i.elf"), elf_file::image(5000, "inerter 0.1.0", "c8a2d5a")).unwrap();
    let words = fails(folder.path(), &["flash", "i.elf", "--probe", "ffff:ffff:none"], 5);
    assert!(words.contains("no debug probe"), "{words}");
    assert!(words.contains("--probe VID:PID:SERIAL") || words.contains("`inerter update`"), "{words}");
}

#[test]
fn a_device_that_cannot_enter_update_mode_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(20.0);
    fs::write(folder.path().join("i.elf"), elf_file::image(5000, "inerter 0.1.0", "c8a2d5a")).unwrap();
    let words = fails(folder.path(), &["update", "i.elf", "--connect", device.name()], 3);
    assert!(words.contains("the image is for the board nucleo-g474re, the device is a virtual"), "{words}");
    let words = fails(folder.path(), &["update", "i.elf", "--force", "--connect", device.name()], 6);
    assert!(words.contains("cannot enter update mode by itself"), "{words}");
}

#[test]
fn settings_are_shown_changed_saved_and_forgotten() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(20.0);
    let link = ["--connect", device.name()];
    let settings = |arguments: &[&str]| inerter(folder.path(), &[&["settings"], arguments, &link].concat());
    let output = |arguments: &[&str]| settings(arguments).output().unwrap();
    let value = |name: &str| {
        let all = last(&text(&output(&["get", "--json"]).stdout));
        all.pointer(&format!("/settings/{name}")).unwrap().as_f64().unwrap()
    };
    let reboot = || {
        let mut device =
            Device::connect(&Target::Tcp { address: device.name().into() }, Clock::new(), || false).unwrap();
        device.request("to restart", Command::Reboot).unwrap();
    };
    assert_eq!(value("memory_s"), 30.0);

    // `--settings` accepts the output of `get`.
    fs::write(folder.path().join("all.toml"), output(&["get"]).stdout).unwrap();
    let same = output(&["set", "--settings", "all.toml"]);
    assert_eq!((text(&same.stdout), same.status.code()), (String::new(), Some(0)));
    assert!(text(&same.stderr).contains("nothing has changed"), "{}", text(&same.stderr));

    let changed = output(&["set", "memory_s=12", "skew_s=2e-6"]);
    let printed = text(&changed.stdout);
    assert!(printed.contains("memory_s = 12.0   # was 30.0") && printed.lines().count() == 2, "{printed}");
    assert!(text(&changed.stderr).contains("`inerter settings save` keeps them"), "{}", text(&changed.stderr));
    assert_eq!(value("memory_s"), 12.0);
    reboot();
    assert_eq!(value("memory_s"), 30.0, "not saved, so forgotten");

    assert!(text(&output(&["set", "memory_s=12", "--save"]).stderr).contains("survive a restart"));
    assert!(output(&["tare"]).status.success());
    assert!(output(&["save"]).status.success());
    reboot();
    assert_eq!(value("memory_s"), 12.0, "saved");

    let unasked = output(&["factory-reset"]);
    assert_eq!(unasked.status.code(), Some(2));
    assert!(text(&unasked.stderr).contains("add --yes; nothing was changed"), "{}", text(&unasked.stderr));
    assert_eq!(value("memory_s"), 12.0);
    let reset = output(&["factory-reset", "--yes"]);
    assert!(text(&reset.stdout).contains("memory_s = 30.0   # was 12.0"), "{}", text(&reset.stdout));
    reboot();
    assert_eq!(value("memory_s"), 30.0);
}

#[test]
fn a_setting_that_cannot_be_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(20.0);
    let link = ["--connect", device.name()];
    for (assignments, words) in [
        (&["memory_s=12", "memori_s=1"][..], "there is no setting `memori_s`"),
        (&["memory_s=12", "skew_s=fast"], "`fast` is not a number"),
        (&["memory_s=12", "structure_mass_kg=-1"], "structure_mass_kg"),
    ] {
        let said = fails(folder.path(), &[&["settings", "set"], assignments, &link].concat(), 4);
        assert!(said.contains(words), "{said}");
    }
    let all = last(&done(folder.path(), &[&["settings", "get", "--json"], &link[..]].concat()));
    assert_eq!(all.pointer("/settings/memory_s").unwrap(), 30.0);
}

#[test]
fn firmware_of_another_wire_version_is_updated_by_hand() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("i.elf"), elf_file::image(5000, "inerter 0.1.0", "c8a2d5a")).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let server = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.write_all(&[frames::foreign_hello(), vec![0]].concat()).unwrap();
        // Until the host disconnects.
        stream.read_to_end(&mut Vec::new()).ok();
    });
    let words = fails(folder.path(), &["update", "i.elf", "--connect", &address], 6);
    assert!(words.contains("cannot be asked to enter update mode: it speaks wire version 7"), "{words}");
    assert!(words.contains("hold BOOT0"), "{words}");
    server.join().unwrap();
}
