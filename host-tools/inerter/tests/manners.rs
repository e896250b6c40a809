//! The program as a guest on a user's machine: its report on the machine, flags from a file, completions, manuals.

use std::fs;

use crate::common::{done, fails, inerter, json_lines, text};

#[test]
fn the_doctor_says_what_is_in_the_way_and_ends_with_code_5() {
    let folder = tempfile::tempdir().unwrap();
    let output = inerter(folder.path(), &["doctor", "--json", "--port", "/dev/no-such-port"]).output().unwrap();
    assert_eq!(output.status.code(), Some(5));
    let checks = json_lines(&text(&output.stdout));
    let topic = |topic: &str| checks.iter().find(|check| check["topic"] == topic).unwrap();
    assert_eq!(topic("program")["condition"], "good");
    let device = topic("device");
    assert_eq!(device["condition"], "problem");
    assert!(device["text"].as_str().unwrap().contains("/dev/no-such-port") && device["advice"].is_string(), "{device}");
    assert!(checks.iter().all(|check| check["kind"] == "check" && check["topic"] != "flags"));
    assert!(text(&output.stderr).contains("1 problem found"));
    let rule = done(folder.path(), &["doctor", "--udev-rule"]);
    assert!(rule.contains("ATTRS{idVendor}==\"1209\"") && rule.contains("ATTR{idVendor}==\"0483\""), "{rule}");
}

#[test]
fn flags_come_from_a_file_unless_they_are_typed() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("inerter.toml"), "duration = 2\n[simulate]\nseed = 3\n").unwrap();
    let lines = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap().lines().count() - 1;
    done(folder.path(), &["simulate", "-o", "a.csv"]);
    assert_eq!(lines("a.csv"), 2000);
    done(folder.path(), &["simulate", "--duration", "1", "-o", "b.csv"]);
    assert_eq!(lines("b.csv"), 1000);
    fs::write(folder.path().join("other.toml"), "[simulate]\nduration = 3\noutput = \"c.csv\"\n").unwrap();
    done(folder.path(), &["--config", "other.toml", "simulate"]);
    assert_eq!(lines("c.csv"), 3000);
    let status =
        inerter(folder.path(), &["simulate", "-o", "d.csv"]).env("INERTER_CONFIG", "other.toml").output().unwrap();
    assert!(status.status.success());
    assert_eq!(lines("d.csv"), 3000);
}

#[test]
fn a_mistake_in_the_file_of_flags_is_named_before_anything_is_done() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("inerter.toml"), "[record]\ndurations = 2\n").unwrap();
    let words = fails(folder.path(), &["record", "-o", "x.mcap", "--connect", "127.0.0.1:1"], 4);
    assert!(
        words.contains("there is no flag of record `durations`") && words.contains("did you mean `duration`?"),
        "{words}"
    );
    let words = fails(folder.path(), &["ports", "--config", "nowhere.toml"], 3);
    assert!(words.contains("nowhere.toml cannot be read"), "{words}");
    // The help must not depend on the file.
    assert!(done(folder.path(), &["--help"]).contains("Usage"));
}

#[test]
fn every_command_has_a_manual_page_and_every_shell_its_completions() {
    let folder = tempfile::tempdir().unwrap();
    done(folder.path(), &["man", "-o", "man"]);
    assert!(fails(folder.path(), &["man", "-o", "man"], 8).contains("exists already"));
    done(folder.path(), &["man", "-o", "man", "--force"]);
    let help = done(folder.path(), &["--help"]);
    let commands = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    for command in commands.filter_map(command_of).filter(|name| *name != "help") {
        let page = folder.path().join(format!("man/inerter-{command}.1"));
        assert!(fs::read_to_string(&page).is_ok_and(|page| page.contains(".TH")), "{}", page.display());
    }
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = done(folder.path(), &["completions", shell]);
        assert!(script.contains("metres-per-count") && script.contains("doctor"), "{shell}");
    }
}

/// The command at the beginning of a line of the help. Other lines continue the line before.
fn command_of(line: &str) -> Option<&str> {
    line.strip_prefix("  ").filter(|rest| !rest.starts_with(' '))?.split_whitespace().next()
}
