//! Full disks, read-only folders, and files that disappear while they are written.

use std::{
    fs,
    os::unix::{fs::PermissionsExt, process::CommandExt},
    process::{Command, Output, Stdio},
    sync::atomic::{AtomicUsize, Ordering},
    thread,
    time::{Duration, Instant},
};

use crate::{
    common::{done, inerter, text},
    scenario::{Scenario, device},
    writers::{each_writer, names},
};

/// Runs the command from a shell that executes `before` first.
fn in_shell(command: &Command, before: &str, shell: &[&str]) -> Output {
    let mut words = shell.to_vec();
    let script = format!("{before} exec \"$0\" \"$@\"");
    words.extend(["-c", &script]);
    let mut all = Command::new(words[0]);
    all.args(&words[1..]).arg(command.get_program()).args(command.get_args());
    all.current_dir(command.get_current_dir().unwrap()).stdin(Stdio::null()).output().unwrap()
}

fn must_fail(output: &Output, code: i32, what: &str) {
    assert_eq!(output.status.code(), Some(code), "{what}: {}", text(&output.stderr));
}

/// File sizes are limited: a write beyond the limit is an error, and by default the signal ends the program.
#[test]
#[ignore = "cargo xtask chaos"]
fn files_that_may_not_grow() {
    let mut scenario = Scenario::start(900);
    let limits = scenario.kills().div_ceil(20);
    let (device, failed, killed) = (device(), AtomicUsize::new(0), AtomicUsize::new(0));
    each_writer(device.name(), |writer, folder, whole| {
        let before = names(folder);
        let mut random = scenario.random(&writer.command.join(" "));
        let largest = whole.files.values().map(Vec::len).max().unwrap() as u64;
        for place in 0..limits.div_ceil(writer.cost.div_ceil(4)) * 2 {
            let (is_caught, was_there) = (place % 2 == 0, place % 4 > 1);
            if was_there {
                whole.earlier(folder);
            }
            let more: &[&str] = if was_there { &["--force"] } else { &[] };
            // Blocks of 512 bytes.
            let blocks = random.below(largest.div_ceil(512));
            let trap = if is_caught { "trap '' XFSZ;" } else { "" };
            let command = writer.run(folder, device.name(), more);
            let output = in_shell(&command, &format!("{trap} ulimit -f {blocks};"), &["sh"]);
            let what = format!("{:?} with files of {blocks} blocks", writer.command);
            if is_caught {
                must_fail(&output, 8, &what);
                failed.fetch_add(1, Ordering::Relaxed);
            } else {
                let is_ended = output.status.code().is_none() || output.status.code() == Some(8);
                assert!(is_ended, "{what}: {} {}", output.status, text(&output.stderr));
                killed.fetch_add(1, Ordering::Relaxed);
            }
            whole.check(folder, &before, was_there, !is_caught, &what);
        }
    });
    scenario.passed(&format!(
        "{} runs ended with exit code 8 and left no new file, {} were ended by the system; \
         no incomplete file, no earlier file lost",
        failed.into_inner(),
        killed.into_inner()
    ));
}

/// A small disk that is full, and one that is read-only.
#[test]
#[ignore = "cargo xtask chaos"]
fn full_disks() {
    let scenario = Scenario::start(600);
    let shell = ["unshare", "--user", "--map-root-user", "--mount", "sh"];
    let can = Command::new("unshare").args(["--user", "--map-root-user", "--mount", "true"]).output();
    if !can.is_ok_and(|output| output.status.success()) {
        inerter_needs::skip("a disk of its own needs `unshare --user --mount` (util-linux, user namespaces allowed)");
        return scenario.skipped("no user namespaces, so no small disk without root");
    }
    let (device, runs) = (device(), AtomicUsize::new(0));
    each_writer(device.name(), |writer, folder, whole| {
        let before = names(folder);
        let mut random = scenario.random(&writer.command.join(" "));
        let largest = whole.files.values().map(Vec::len).max().unwrap() as u64;
        fs::create_dir(folder.join("disk")).unwrap();
        for read_only in [false, true] {
            // Less space than its largest file needs.
            let room = random.below(largest / 1024 + 1);
            let earlier = whole.files.keys().map(String::as_str).collect::<Vec<_>>().join(" ");
            let remount = if read_only { "mount -o remount,ro disk;" } else { "" };
            let script = format!(
                "mount -t tmpfs -o size=64m none disk && cp -r *.mcap limits.toml store disk && cd disk && \
                 for name in {earlier}; do printf earlier > \"$name\"; done && \
                 free=$(df -k --output=avail . | tail -n 1) && \
                 head -c $(((free - {room}) * 1024)) /dev/zero > filling && cd .. && {remount} \
                 (cd disk; \"$0\" \"$@\"); code=$?; rm -f disk/filling; rm -rf left; cp -r disk left; exit $code; "
            );
            let command = writer.run(folder, device.name(), &["--force"]);
            let output = in_shell(&command, &script, &shell);
            let what = format!("{:?} with {room} KiB free, read-only: {read_only}", writer.command);
            let before: Vec<String> = before.iter().cloned().chain(["filling".to_string()]).collect();
            whole.check(&folder.join("left"), &before, true, false, &what);
            must_fail(&output, 8, &what);
            runs.fetch_add(1, Ordering::Relaxed);
        }
    });
    scenario.passed(&format!("{} runs, each ended with exit code 8 and left no new file", runs.into_inner()));
}

/// A folder that belongs to another user.
#[test]
#[ignore = "cargo xtask chaos"]
fn folders_of_others() {
    let scenario = Scenario::start(600);
    // Root may write everywhere, so the program runs as nobody.
    let nobody = rustix::process::getuid().is_root().then_some(65534);
    let (device, runs) = (device(), AtomicUsize::new(0));
    let tried = tempfile::tempdir().unwrap();
    fs::set_permissions(tried.path(), fs::Permissions::from_mode(0o755)).unwrap();
    let as_another = |mut command: Command| {
        if let Some(nobody) = nobody {
            command.uid(nobody).gid(nobody);
        }
        command.output()
    };
    if !as_another(inerter(tried.path(), &["--version"])).is_ok_and(|output| output.status.success()) {
        inerter_needs::skip("user 65534 cannot start the program where it lies");
        return scenario.skipped("root may write everywhere, and nobody cannot start the program");
    }
    each_writer(device.name(), |writer, folder, whole| {
        let before = names(folder);
        for was_there in [false, true] {
            if was_there {
                whole.earlier(folder);
            }
            fs::set_permissions(folder, fs::Permissions::from_mode(0o555)).unwrap();
            let more: &[&str] = if was_there { &["--force"] } else { &[] };
            let output = as_another(writer.run(folder, device.name(), more)).unwrap();
            let what = format!("{:?} in a folder of another", writer.command);
            must_fail(&output, 8, &what);
            assert!(text(&output.stderr).contains("ermission denied"), "{what}: {}", text(&output.stderr));
            fs::set_permissions(folder, fs::Permissions::from_mode(0o755)).unwrap();
            whole.check(folder, &before, was_there, false, &what);
            runs.fetch_add(1, Ordering::Relaxed);
        }
    });
    scenario.passed(&format!("{} runs, each ended with exit code 8 and changed no file", runs.into_inner()));
}

/// Another program removes the file being written, or creates something under its name.
#[test]
#[ignore = "cargo xtask chaos"]
fn files_that_vanish() {
    let mut scenario = Scenario::start(900);
    let times = scenario.kills().div_ceil(5);
    let (device, refused, whole_ones) = (device(), AtomicUsize::new(0), AtomicUsize::new(0));
    each_writer(device.name(), |writer, folder, whole| {
        let before = names(folder);
        let mut random = scenario.random(&writer.command.join(" "));
        for place in 0..times.div_ceil(writer.cost) {
            let mut child = writer.run(folder, device.name(), &[]).stdout(Stdio::null()).spawn().unwrap();
            let started = Instant::now();
            let is_part = |name: &String| name.starts_with('.') && name.ends_with(".part");
            while !names(folder).iter().any(is_part) && child.try_wait().unwrap().is_none() {
                assert!(started.elapsed() < Duration::from_secs(60), "{:?} writes nothing", writer.command);
                thread::sleep(Duration::from_micros(300));
            }
            thread::sleep(whole.took.mul_f64(random.below(200) as f64 * 1e-3));
            let mut mine = None;
            if place % 2 == 0 {
                for part in names(folder).iter().filter(|name| is_part(name)) {
                    // The file may just have been renamed.
                    fs::remove_file(folder.join(part)).ok();
                }
            } else {
                let name = whole.files.keys().next().unwrap();
                let made = fs::OpenOptions::new().write(true).create_new(true).open(folder.join(name));
                if let Ok(mut file) = made {
                    std::io::Write::write_all(&mut file, b"mine").unwrap();
                    mine = Some(folder.join(name));
                }
            }
            let output = child.wait_with_output().unwrap();
            let what = format!("{:?}, disturbance {place}", writer.command);
            assert!(matches!(output.status.code(), Some(0 | 8)), "{what}: {} {}", output.status, text(&output.stderr));
            if let Some(mine) = mine {
                assert_eq!(fs::read(&mine).unwrap(), b"mine", "{what}");
                fs::remove_file(mine).unwrap();
            }
            let count = whole.check(folder, &before, false, false, &what);
            assert!(
                output.status.code() == Some(8) || count == whole.files.len(),
                "{what}: done, and not all is there"
            );
            let counted = if output.status.success() { &whole_ones } else { &refused };
            counted.fetch_add(1, Ordering::Relaxed);
        }
    });
    let refused = refused.into_inner();
    assert!(refused > 0);
    scenario.passed(&format!(
        "{refused} runs ended with exit code 8, {} had finished before; none replaced another program's file",
        whole_ones.into_inner()
    ));
}

/// The disk of a recording is full: everything written before can be read.
#[test]
#[ignore = "cargo xtask chaos"]
fn recordings_on_full_disks() {
    let mut scenario = Scenario::start(300);
    let limits = scenario.kills().div_ceil(20);
    let device = device();
    let mut random = scenario.random("recordings");
    let mut readable = 0;
    for place in 0..limits * 2 {
        let folder = tempfile::tempdir().unwrap();
        let blocks = random.below(300);
        let command = [&["record", "-o"][..], &["monitor", "--plain", "--record"]][place as usize % 2];
        let command =
            inerter(folder.path(), &[command, &["run.mcap", "--connect", device.name(), "--duration", "20"]].concat());
        let output = in_shell(&command, &format!("trap '' XFSZ; ulimit -f {blocks};"), &["sh"]);
        must_fail(&output, 8, &format!("a recording of {blocks} blocks"));
        if folder.path().join("run.mcap").metadata().unwrap().len() > 20_000 {
            done(folder.path(), &["info", "run.mcap", "--json"]);
            readable += 1;
        }
    }
    assert!(readable > 0, "no recording came as far as its frames");
    scenario.passed(&format!(
        "{} recordings ended with exit code 8; all {readable} that have frames can be opened",
        limits * 2
    ));
}
