//! A real kernel and the shipping host program: Debian's Linux in QEMU attaches to the shipping binary over USB/IP.
//!
//! The twin runs in its own thread, in step with wall-clock time, and serves USB/IP on a loopback port. QEMU (TCG,
//! never KVM) boots the kernel and the programs that `cargo xtask guest` collected. The guest's network ends in this
//! process, so the guest reaches nothing else. The guest's init program connects back and runs the commands that the
//! test sends.
//!
//! At the end, `inerter update` installs another firmware over the same cable. A longer test has the self-test's visit
//! to update mode, updates that are interrupted or by Debian's dfu-util, another build and chips that are too small.
//!
//! Slow: two minutes, the longer one five. Skipped if the image or QEMU is missing.

use crate::common::{another, chip_with, configured, image_of_others, rig, serial};
use inerter_core::Settings;
use inerter_guest::{Ended, Guest};
use inerter_twin::bench::Bench;
use inerter_twin::chip::flash;
use inerter_twin::chip::rom::Left;
use inerter_twin::elf::Elf;
use inerter_twin::machine::{Machine, Options, image as image_of, shipping_image};
use inerter_twin::usbip::Server;
use inerter_twin::world::Still;
use inerter_wire::{Command as Request, MAX_FRAME, Streams, encode_request};
use serde_json::{Map, Value};
use std::collections::BTreeSet;
use std::io::Write;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const QEMU: &str = "qemu-system-x86_64";
/// From QEMU's start until the guest's init program connects, on a busy machine.
const BOOT: Duration = Duration::from_secs(60);
/// Time limit for a command that does not wait for anything.
const SOON: Duration = Duration::from_secs(20);
const MINUTE: Duration = Duration::from_secs(60);
/// Shell conditions: the device's port, a boot loader, and nothing is on the bus.
const PORT: &str = "ls /dev/ttyACM*";
const LOADER: &str = "dfu-util -l | grep -q 'Internal Flash'";
const GONE: &str = "! [ -d /sys/bus/usb/devices/1-1 ]";
/// Polling interval in the guest's shell.
const LOOK: &str = "usleep 20000";

type Order = Box<dyn FnOnce(&mut Server<Machine>) -> Next + Send>;

/// Whether the twin's thread continues.
enum Next {
    Serve,
    End,
}

/// The twin and its thread.
struct Twin {
    address: std::net::SocketAddr,
    orders: mpsc::Sender<Order>,
    thread: Option<JoinHandle<()>>,
}

impl Twin {
    /// A configured board on a moving rig.
    fn start(firmware: Vec<u8>) -> Self {
        Self::serve(move || {
            let rig = rig();
            let settings = rig.settings(1000.0);
            let bench = Bench::new(rig).expect("a rig that can be");
            configured(&firmware, Left::Running, bench, &settings).socket
        })
    }

    fn serve(machine: impl FnOnce() -> Machine + Send + 'static) -> Self {
        let (orders, ordered) = mpsc::channel::<Order>();
        let (tell, told) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            let mut server = Server::new(machine()).expect("a free port");
            tell.send(server.address().expect("bound")).expect("the test waits");
            server.run(|server| ordered.try_iter().any(|order| matches!(order(server), Next::End))).expect("serves");
        });
        let address = told.recv().expect("the twin starts");
        Self { address, orders, thread: Some(thread) }
    }

    /// Runs a closure in the twin's thread and waits for its result.
    fn order<T: Send + 'static>(&self, what: impl FnOnce(&mut Server<Machine>) -> T + Send + 'static) -> T {
        let (tell, told) = mpsc::channel();
        let order: Order = Box::new(move |server| {
            // The test waits for the reply below.
            let _ = tell.send(what(server));
            Next::Serve
        });
        self.orders.send(order).expect("the twin lives");
        told.recv().expect("the twin lives")
    }

    /// Flash pages erased so far.
    fn erased(&self) -> u64 {
        self.order(|server| server.socket.chip().flash.erased)
    }

    fn end(mut self) {
        let _ = self.orders.send(Box::new(|_| Next::End));
        if let Some(thread) = self.thread.take() {
            thread.join().expect("the twin ends well");
        }
    }
}

/// The QEMU process, killed when the test ends, whatever the outcome.
struct Qemu(Child);

impl Drop for Qemu {
    fn drop(&mut self) {
        // Both fail only if QEMU has already exited.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Linux, and the address of the twin it attaches to.
struct Linux {
    guest: Guest,
    _qemu: Qemu,
    twin: std::net::SocketAddr,
}

impl Linux {
    fn boot(image: &Path, log: &Path, twin: std::net::SocketAddr) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let port = listener.local_addr().expect("bound").port();
        let mut command = Command::new(QEMU);
        command
            .args(["-M", "pc", "-accel", "tcg", "-cpu", "qemu64", "-m", "256", "-nodefaults", "-display", "none"])
            .args(["-no-reboot", "-netdev", "user,id=net", "-device", "virtio-net-pci,netdev=net,romfile="])
            .arg("-kernel")
            .arg(image.join("vmlinux"))
            .arg("-initrd")
            .arg(image.join("initramfs"))
            .arg("-serial")
            .arg(format!("file:{}", log.display()))
            .arg("-append")
            .arg(format!("console=ttyS0 quiet panic=-1 nokaslr mitigations=off test=10.0.2.2:{port}"))
            .stdin(Stdio::null());
        let mut qemu = Qemu(command.spawn().expect("QEMU was there a moment ago"));
        let alive = || qemu.0.try_wait().is_ok_and(|ended| ended.is_none());
        let guest = Guest::accept(&listener, BOOT, alive).unwrap_or_else(|error| {
            let console = std::fs::read_to_string(log).unwrap_or_default();
            panic!("{error}; its console:\n{console}")
        });
        Self { guest, _qemu: qemu, twin }
    }

    fn run_within(&mut self, command: &str, within: Duration) -> Ended {
        self.guest.run(command, within).unwrap_or_else(|error| panic!("{command}: {error}"))
    }

    /// Runs a command that must succeed, and returns its output.
    fn run(&mut self, command: &str) -> String {
        self.succeed(command, SOON)
    }

    fn succeed(&mut self, command: &str, within: Duration) -> String {
        let ended = self.run_within(command, within);
        assert_eq!(ended.code, 0, "{command}: {}{}", ended.text(), ended.errors);
        ended.text()
    }

    /// Runs a command that must succeed and that prints one JSON object per line.
    fn json(&mut self, command: &str, within: Duration) -> Vec<Value> {
        objects(&self.succeed(command, within))
    }

    /// Waits until a shell condition holds.
    fn until(&mut self, condition: &str) {
        let ended = self.run_within(
            &format!("for n in $(seq 500); do if {condition}; then exit 0; fi; {LOOK}; done; exit 1"),
            MINUTE,
        );
        assert_eq!(ended.code, 0, "never: {condition}\n{}", self.run("dmesg | tail -20"));
    }

    /// Attaches the device and waits for its port.
    fn attach(&mut self, port: &str) {
        self.attach_another(self.twin, port);
    }

    fn attach_another(&mut self, twin: std::net::SocketAddr, port: &str) {
        self.run(&format!("inerter-guest attach 10.0.2.2:{}", twin.port()));
        self.until(&format!("[ -c {port} ]"));
    }
}

fn objects(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"))).collect()
}

fn of_kind<'a>(objects: &'a [Value], kind: &str) -> Vec<&'a Value> {
    objects.iter().filter(|object| object["kind"] == kind).collect()
}

/// Prints how long each part took.
struct Watch {
    start: Instant,
    last: Instant,
}

impl Watch {
    fn start() -> Self {
        Self { start: Instant::now(), last: Instant::now() }
    }

    fn lap(&mut self, what: &str) {
        println!("{:6.2} s  {what}", self.last.elapsed().as_secs_f64());
        self.last = Instant::now();
    }

    fn end(self) {
        println!("{:6.2} s  in all", self.start.elapsed().as_secs_f64());
    }
}

/// Where `cargo xtask guest` puts the image and the programs.
fn folder() -> PathBuf {
    let target = std::env::var_os("CARGO_TARGET_DIR").map(PathBuf::from);
    target.unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target")).join("guest")
}

/// The folder with the image if QEMU is installed too, else the reason why the test cannot run.
fn image() -> Result<PathBuf, String> {
    let image = folder();
    for file in ["vmlinux", "initramfs"] {
        if !image.join(file).is_file() {
            return Err(format!("no {}; `cargo xtask guest` makes it", image.join(file).display()));
        }
    }
    let there = Command::new(QEMU).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    if there.is_ok_and(|status| status.success()) { Ok(image) } else { Err(format!("no {QEMU}; `cargo xtask setup`")) }
}

/// Boots Linux beside a board with the shipping firmware.
fn boot(console: &str) -> Option<(Watch, Vec<u8>, Twin, Linux)> {
    let (image, firmware) = (inerter_needs::or_skip(image())?, shipping_image()?);
    let mut watch = Watch::start();
    let twin = Twin::start(firmware.clone());
    watch.lap("twin: started, set up");
    let linux = Linux::boot(&image, &tests_folder().join(console), twin.address);
    watch.lap("Linux: booted");
    Some((watch, firmware, twin, linux))
}

fn tests_folder() -> PathBuf {
    PathBuf::from(env!("CARGO_TARGET_TMPDIR"))
}

#[test]
fn a_real_kernel_and_the_real_program_measure_with_the_shipping_binary() {
    let Some((mut watch, firmware, twin, mut linux)) = boot("linux-console.txt") else { return };
    the_kernel_sees_the_device(&mut linux);
    watch.lap("plugged in, port there");
    a_fresh_terminal_echoes_and_nothing_happens(&mut linux, &twin);
    watch.lap("echo of a fresh terminal");
    the_program_finds_the_port(&mut linux);
    the_device_is_for_one(&mut linux);
    watch.lap("ports; a second import is refused");
    the_monitor_shows_the_estimates(&mut linux);
    watch.lap("monitor");
    a_recording_comes_home(&mut linux, &tests_folder());
    watch.lap("record, info, replay");
    the_port_opens_and_closes_twenty_times(&mut linux);
    watch.lap("20 x open and close");
    a_device_plugged_in_again_is_found_again(&mut linux, &twin);
    watch.lap("plugged in again under another name");
    a_power_cut_is_a_clear_error(&mut linux, &twin);
    watch.lap("power cut");
    the_program_brings_another_firmware(&mut linux, &firmware);
    watch.lap("inerter update");
    // A background attach of the last stage may still be running. End the twin first.
    twin.end();
    programs_of_others_are_served(&mut linux);
    watch.lap("programs of others");
    watch.end();
}

#[test]
#[ignore = "long: cargo xtask test --full"]
fn a_board_is_updated_over_a_real_kernel_however_it_is_interrupted() {
    let Some((mut watch, firmware, twin, mut linux)) = boot("linux-console-update.txt") else { return };
    the_self_test_goes_into_update_mode_and_back(&mut linux, &twin);
    watch.lap("selftest");
    dfu_util_brings_another_firmware(&mut linux, &twin, &firmware);
    watch.lap("dfu-util");
    an_update_that_is_cut_is_completed_by_the_next(&mut linux, &twin, &firmware);
    watch.lap("three updates that are cut");
    a_dfu_util_that_is_cut_has_written_the_vectors_first(&mut linux, &twin, &firmware);
    watch.lap("dfu-util that is cut");
    a_really_different_build_goes_there_and_back(&mut linux, &twin, &firmware);
    watch.lap("another build, and back");
    twin.end();
    a_chip_that_is_too_small_is_refused_whatever_the_rom_describes(&mut linux, &firmware);
    watch.lap("small chips");
    watch.end();
}

fn the_kernel_sees_the_device(linux: &mut Linux) {
    linux.attach("/dev/ttyACM0");
    let mut attribute = |name: &str| linux.run(&format!("cat /sys/bus/usb/devices/1-1/{name}")).trim().to_string();
    assert_eq!((attribute("idVendor"), attribute("idProduct")), ("1209".into(), "0001".into()));
    assert_eq!((attribute("manufacturer"), attribute("product")), ("inerter".into(), "inerter".into()));
    assert_eq!(attribute("serial"), serial());
    assert_eq!(attribute("speed"), "12", "full speed");
    assert!(linux.run("dmesg").contains("cdc_acm 1-1:1.0: ttyACM0: USB ACM device"));
}

/// The kernel echoes what the device sends until a program sets the terminal to raw mode. This test is harsher than
/// reality: it makes the device send while the echo is on.
fn a_fresh_terminal_echoes_and_nothing_happens(linux: &mut Linux, twin: &Twin) {
    let starts = twin.order(|server| server.socket.resets.len());
    assert!(linux.run("stty -F /dev/ttyACM0 -a").contains(" echo "), "a fresh terminal echoes");
    let mut talk = vec![0];
    for (id, command) in [(1, Request::Hello), (2, Request::Streams(Streams::ALL)), (3, Request::ReadSettings)] {
        let mut frame = [0; MAX_FRAME];
        let length = encode_request(&inerter_wire::Request { id, command }, id - 1, &mut frame).expect("fits");
        talk.extend_from_slice(&frame[..length]);
    }
    let octal: String = talk.iter().map(|byte| format!("\\{byte:03o}")).collect();
    let before = linux.run("stty -F /dev/ttyACM0 -echo raw; stty -F /dev/ttyACM0 sane; stty -F /dev/ttyACM0 -a");
    assert!(before.contains(" echo "), "{before}");
    linux.run(&format!("exec 3<>/dev/ttyACM0; printf '{octal}' >&3; sleep 2; exec 3>&-"));
    assert_eq!(twin.order(|server| server.socket.resets.len()), starts, "it restarted");
    uses_the_saved_settings(linux);
}

/// The device uses the settings that the twin saved before Linux started.
fn uses_the_saved_settings(linux: &mut Linux) {
    let saved = rig().settings(1000.0);
    let values: Map<String, Value> =
        Settings::TABLE.iter().zip(saved.values()).map(|(info, value)| (info.name.into(), value.into())).collect();
    // Printed and read like the program's, because reading may round the last bit.
    let saved: Value = serde_json::from_str(&Value::Object(values).to_string()).expect("JSON");
    let said = linux.json("inerter settings get --json", SOON);
    assert_eq!(said[0]["settings"], saved);
}

fn the_program_finds_the_port(linux: &mut Linux) {
    let ports = linux.json("inerter ports --json", SOON);
    let ours: Vec<&Value> = ports.iter().filter(|port| port["inerter"] == true).collect();
    assert_eq!(ours.len(), 1, "{ports:?}");
    let port = ours[0];
    assert_eq!((&port["port"], &port["serial"]), (&"/dev/ttyACM0".into(), &serial().into()));
    assert_eq!((&port["vid"], &port["pid"]), (&0x1209.into(), &0x0001.into()));
}

fn the_device_is_for_one(linux: &mut Linux) {
    let address = linux.twin.port();
    let ended = linux.run_within(&format!("inerter-guest attach 10.0.2.2:{address}"), SOON);
    assert_ne!(ended.code, 0);
    assert!(ended.errors.contains("another client has the device"), "{}", ended.errors);
}

/// Allowed distance from the true value, in 95 % intervals. One value in twenty lies outside its own interval, and the
/// timing differs in every run.
const INTERVALS: f64 = 2.0;

/// The last estimate agrees with the true values within its own intervals.
fn is_right(estimate: &Value) {
    let rig = rig();
    let truth = [
        ("inertance_kg", rig.device.inertance_kg),
        ("viscous_n_s_per_m", rig.device.viscous_n_s_per_m),
        ("coulomb_n", rig.device.coulomb_n),
    ];
    for (name, truth) in truth {
        let parameter = &estimate["whole_run"][name];
        assert_eq!(parameter["status"], "ok", "{name}: {parameter}");
        let (value, u95) =
            (parameter["value"].as_f64().expect("a value"), parameter["u95"].as_f64().expect("an interval"));
        assert!((value - truth).abs() <= INTERVALS * u95, "{name} is {truth}, measured {value} +- {u95}");
        assert!(u95 > 0.0);
    }
    let inertance = &estimate["whole_run"]["inertance_kg"];
    assert!(inertance["u95"].as_f64() < Some(0.02 * truth[0].1), "{inertance}");
}

fn the_monitor_shows_the_estimates(linux: &mut Linux) {
    let said = linux.json("inerter monitor --json --duration 5", MINUTE);
    let device = of_kind(&said, "device");
    assert_eq!((&device[0]["serial"], &device[0]["port"]), (&serial().into(), &"/dev/ttyACM0".into()));
    let estimates = of_kind(&said, "estimate");
    // Ten of them if the twin keeps up with wall-clock time.
    assert!(estimates.len() >= 4, "{} estimates in five seconds", estimates.len());
    is_right(estimates[estimates.len() - 1]);
    let health = of_kind(&said, "health");
    assert_eq!(health.last().expect("health")["lost_samples"], 0);
}

fn a_recording_comes_home(linux: &mut Linux, folder: &Path) {
    let said = linux.json("inerter record --port /dev/ttyACM0 --json --force -o /tmp/run.mcap --duration 8", MINUTE);
    assert_eq!(said[said.len() - 1]["lost_frames"], 0, "{said:?}");
    let here = folder.join("linux-run.mcap");
    let file = linux.run_within("cat /tmp/run.mcap", SOON).output;
    std::fs::write(&here, file).expect("a folder for tests");
    let inerter = |command: &str| {
        let done = Command::new(program()).args([command, "--json"]).arg(&here).output().expect("the program");
        assert!(done.status.success(), "{command}: {}", String::from_utf8_lossy(&done.stderr));
        objects(&String::from_utf8_lossy(&done.stdout))
    };
    let info = inerter("info").remove(0);
    assert_eq!(
        (&info["ending"], &info["lost_frames"], &info["discontinuities"]),
        (&"closed".into(), &0.into(), &0.into())
    );
    assert_eq!(info["device"]["serial"], serial());
    // 8000 of them if the twin keeps up with wall-clock time.
    assert!(info["samples"].as_u64() >= Some(4000), "{info}");
    let replayed = inerter("replay");
    let replayed = &replayed[replayed.len() - 1];
    is_right(replayed);
    // The device has seen more of the motion than the recording contains.
    let inertance =
        |estimate: &Value, part: &str| estimate["whole_run"]["inertance_kg"][part].as_f64().expect("a number");
    let difference = inertance(replayed, "value") - inertance(&info["estimate"], "value");
    assert!(difference.abs() <= INTERVALS * inertance(replayed, "u95"), "{difference} kg between device and replay");
}

/// The same program as in the guest, which was packed with this machine's libraries.
fn program() -> PathBuf {
    folder().join("inerter")
}

fn the_port_opens_and_closes_twenty_times(linux: &mut Linux) {
    let said = linux.json(
        "for n in $(seq 20); do inerter monitor --json --port /dev/ttyACM0 --duration 0.1 || exit 1; done",
        MINUTE,
    );
    assert_eq!(of_kind(&said, "device").len(), 20);
    assert!(of_kind(&said, "link").is_empty(), "frames lost: {said:?}");
}

fn a_device_plugged_in_again_is_found_again(linux: &mut Linux, twin: &Twin) {
    // One process keeps the old port open while another measures.
    linux.run("sleep 60 3<>/dev/ttyACM0 >/dev/null 2>&1 & echo $! >/tmp/holder");
    linux.run("inerter monitor --json --duration 15 >/tmp/said 2>/tmp/noted & echo $! >/tmp/monitor");
    linux.until("grep -q '\"estimate\"' /tmp/said");
    twin.order(Server::unplug);
    linux.until(GONE);
    linux.attach("/dev/ttyACM1");
    linux.until("[ $(grep -c '\"device\"' /tmp/said) = 2 ]");
    linux.until("tail -1 /tmp/said | grep -q '\"estimate\"'");
    let said = objects(&linux.run(
        "kill -INT $(cat /tmp/monitor); while [ -d /proc/$(cat /tmp/monitor) ]; do usleep 20000; done; cat /tmp/said",
    ));
    let ports: Vec<&Value> = of_kind(&said, "device").iter().map(|device| &device["port"]).collect();
    assert_eq!(ports, ["/dev/ttyACM0", "/dev/ttyACM1"]);
    let ports = linux.json("inerter ports --json", SOON);
    assert!(ports.iter().any(|port| port["inerter"] == true && port["port"] == "/dev/ttyACM1"), "{ports:?}");
    linux.run("kill $(cat /tmp/holder)");
}

fn a_power_cut_is_a_clear_error(linux: &mut Linux, twin: &Twin) {
    linux.run("(inerter record --wait 1 --json -o /tmp/cut.mcap >/tmp/said 2>/tmp/noted; echo $? >/tmp/code) >/dev/null 2>&1 &");
    linux.until("[ $(stat -c %s /tmp/cut.mcap) -gt 20000 ]");
    twin.order(|server| {
        server.socket.power_cut().expect("starts again");
        server.unplug();
    });
    linux.until("[ -s /tmp/code ]");
    assert_eq!(linux.run("cat /tmp/code").trim(), "6", "{}", linux.run("cat /tmp/noted"));
    let noted = linux.run("cat /tmp/noted");
    assert!(noted.contains("went away") && noted.contains("plug it in again"), "{noted}");
    let info = linux.json("inerter info --json /tmp/cut.mcap", SOON).remove(0);
    assert_eq!(info["ending"], "closed", "{info}");
    assert_eq!(info["discontinuities"], 0, "{info}");
    // Power and cable return. The device must publish estimates again.
    linux.until(GONE);
    linux.attach("/dev/ttyACM0");
    let said = linux.json("inerter monitor --json --duration 3", MINUTE);
    assert!(!of_kind(&said, "estimate").is_empty(), "{said:?}");
    uses_the_saved_settings(linux);
}

/// Once by command, and once by two presses of the button, which the program asks for on a terminal: here the guest's
/// console. Only the checks below are required: some of the others need a guest that keeps pace with wall-clock time.
fn the_self_test_goes_into_update_mode_and_back(linux: &mut Linux, twin: &Twin) {
    stay_plugged_in(linux);
    linux.run(
        "rm -f /tmp/code; (inerter selftest --without-jumpers --json </dev/ttyS0 >/tmp/said 2>/dev/ttyS0; \
         echo $? >/tmp/code) >/dev/null 2>&1 &",
    );
    let mut wait = |condition: &str| {
        linux.run_within(&format!("until {condition}; do {LOOK}; done"), 4 * MINUTE);
    };
    wait("grep -q '\"dfu\"' /tmp/said || [ -s /tmp/code ]");
    press(twin);
    wait("[ -s /tmp/code ]");
    let said = objects(&linux.run("cat /tmp/said"));
    for name in ["restart", "watchdog", "dfu", "double_reset", "restored"] {
        let check = said.iter().find(|check| check["name"] == name);
        assert_eq!(check.map(|check| &check["verdict"]), Some(&"pass".into()), "{said:?}");
    }
    unplug_no_more(linux);
}

/// Copies a file into the guest.
fn give(linux: &mut Linux, bytes: Vec<u8>, path: &str) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = listener.local_addr().expect("bound").port();
    let length = bytes.len();
    let giver = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().expect("the guest calls");
        stream.write_all(&bytes).expect("the guest takes it");
    });
    linux.run(&format!("nc 10.0.2.2 {port} </dev/null >{path}"));
    giver.join().expect("no panic");
    assert_eq!(linux.run(&format!("stat -c %s {path}")).trim(), length.to_string());
}

/// Attaches again and again in the background, like a USB port in which the device stays plugged.
fn stay_plugged_in(linux: &mut Linux) {
    let address = linux.twin.port();
    linux.run(&format!(
        "(while :; do inerter-guest attach 10.0.2.2:{address}; usleep 100000; done) >/dev/null 2>&1 & echo $! >/tmp/plug"
    ));
}

fn unplug_no_more(linux: &mut Linux) {
    linux.run("kill $(cat /tmp/plug)");
}

/// The running firmware measures correctly with the settings saved before.
fn measures_as(linux: &mut Linux, firmware: &str) {
    linux.until(PORT);
    let said = linux.json("inerter monitor --json --duration 5", MINUTE);
    let device = of_kind(&said, "device");
    assert!(device[0]["firmware"].as_str().is_some_and(|name| name.starts_with(firmware)), "{device:?}");
    let estimates = of_kind(&said, "estimate");
    is_right(estimates.last().expect("an estimate"));
}

/// Installs the given firmware with our program; `what` names the case.
fn update(linux: &mut Linux, what: &str) {
    let ended = linux.run_within("inerter update /tmp/new.elf", 2 * MINUTE);
    assert_eq!(ended.code, 0, "{what}: {}{}{}", ended.text(), ended.errors, linux.run("dmesg | tail -20"));
}

fn the_program_brings_another_firmware(linux: &mut Linux, firmware: &[u8]) {
    give(linux, another(firmware, b'8'), "/tmp/new.elf");
    stay_plugged_in(linux);
    update(linux, "plugged in");
    measures_as(linux, "inerter 8.");
    unplug_no_more(linux);
}

/// The command given in docs/HARDWARE.md.
const DFU_UTIL: &str = "dfu-util -d 0483:df11 -a 0 -s 0x08000000:leave -D /tmp/new.bin";

/// An image as a flat binary, as it lies in flash.
fn plain(image: &[u8]) -> Vec<u8> {
    let elf = Elf::parse(image).expect("an ELF");
    let mut bytes = Vec::new();
    for (address, segment) in &elf.segments {
        let start = (address - flash::START) as usize;
        bytes.resize(bytes.len().max(start + segment.len()), 0xFF);
        bytes[start..start + segment.len()].copy_from_slice(segment);
    }
    bytes
}

/// Two presses of the button.
fn press(twin: &Twin) {
    twin.order(|server| {
        for pause_s in [0.1, 0.1] {
            server.socket.reset().expect("starts");
            server.socket.run_for(pause_s).expect("runs");
        }
        // The hub sees the device disconnect.
        server.unplug();
    });
}

/// Two presses of the button: the device enters update mode.
fn press_twice(linux: &mut Linux, twin: &Twin) {
    press(twin);
    stay_plugged_in(linux);
    linux.until(LOADER);
}

fn is_erased(flash: &flash::Flash, page: usize) -> bool {
    flash.bytes()[page * flash::PAGE..][..flash::PAGE].iter().all(|byte| *byte == 0xFF)
}

/// Cuts the power as soon as this holds, during an update. Without vectors, or with half an image, the chip cannot start
/// from flash. The BOOT0 pin brings it back into the ROM.
fn cut_once(linux: &mut Linux, twin: &Twin, holds: impl Fn(&Machine) -> bool + Copy + Send + 'static) {
    let cut = move |server: &mut Server<Machine>| {
        let is_now = holds(&server.socket);
        if is_now {
            server.socket.boot0 = true;
            server.socket.power_cut().expect("starts again");
            server.socket.boot0 = false;
            server.unplug();
        }
        is_now
    };
    while !twin.order(cut) {
        let ended = linux.run("cat /tmp/ended 2>/dev/null || true");
        assert!(ended.is_empty(), "it ended before the cut: {}", linux.run("cat /tmp/said"));
    }
}

/// dfu-util erases all pages and then writes in address order. If it is interrupted, it leaves the new vectors in front
/// of an incomplete image.
fn a_dfu_util_that_is_cut_has_written_the_vectors_first(linux: &mut Linux, twin: &Twin, firmware: &[u8]) {
    let new = another(firmware, b'6');
    let last = *pages(&new).last().expect("a page");
    give(linux, plain(&new), "/tmp/new.bin");
    give(linux, new, "/tmp/new.elf");
    press_twice(linux, twin);
    linux.run(&format!("rm -f /tmp/ended; ({DFU_UTIL} >/tmp/said 2>&1; echo $? >/tmp/ended) >/dev/null 2>&1 &"));
    let before = twin.erased();
    cut_once(linux, twin, move |machine| {
        let flash = &machine.chip().flash;
        flash.erased > before && !is_erased(flash, 0) && is_erased(flash, last)
    });
    linux.until("[ -s /tmp/ended ]");
    linux.until(LOADER);
    update(linux, "dfu-util was cut");
    measures_as(linux, "inerter 6.");
    unplug_no_more(linux);
}

fn dfu_util_brings_another_firmware(linux: &mut Linux, twin: &Twin, firmware: &[u8]) {
    give(linux, plain(&another(firmware, b'9')), "/tmp/new.bin");
    press_twice(linux, twin);
    let ended = linux.run_within(DFU_UTIL, 2 * MINUTE);
    let said = ended.text() + &ended.errors;
    assert!(said.contains("File downloaded successfully"), "{said}");
    measures_as(linux, "inerter 9.");
    unplug_no_more(linux);
}

/// Power fails at three stages: after only the page of the vectors is erased, in the middle, and after all pages are
/// erased and all but the vectors written.
fn an_update_that_is_cut_is_completed_by_the_next(linux: &mut Linux, twin: &Twin, firmware: &[u8]) {
    let mut stages = Vec::new();
    for (part, digit) in [(0.0, b'6'), (0.5, b'7'), (1.0, b'8')] {
        let new = another(firmware, digit);
        let written = pages(&new);
        let wanted = 1 + ((written.len() - 1) as f64 * part) as u64;
        let last = *written.last().expect("a page");
        give(linux, new, "/tmp/new.elf");
        stay_plugged_in(linux);
        linux.until(PORT);
        linux.run(
            "rm -f /tmp/ended; (inerter update /tmp/new.elf >/tmp/said 2>&1; echo $? >/tmp/ended) >/dev/null 2>&1 &",
        );
        let before = twin.erased();
        cut_once(linux, twin, move |machine| {
            let flash = &machine.chip().flash;
            // At the last stage, the last page is written and the vectors are not.
            let is_staged = is_erased(flash, 0) && (part < 1.0 || !is_erased(flash, last));
            machine.is_in_rom() && flash.erased - before >= wanted && is_staged
        });
        stages.push((twin.erased() - before, wanted, written.len() as u64));
        linux.until("[ -s /tmp/ended ]");
        assert_eq!(linux.run("cat /tmp/ended").trim(), "6", "{}", linux.run("cat /tmp/said"));
        linux.until(LOADER);
        update(linux, &format!("cut at {part}"));
        measures_as(linux, &format!("inerter {}.", char::from(digit)));
        unplug_no_more(linux);
    }
    println!("         cut when so many pages were erased of all: {stages:?}");
    // The three cuts happened at three different stages: the twin polls often enough to stop within a fifth of the
    // pages.
    let near = |(done, wanted, all): &(u64, u64, u64)| done - wanted <= all / 5;
    assert!(stages.iter().all(near), "{stages:?}");
}

/// The flash pages that the image occupies, in ascending order.
fn pages(image: &[u8]) -> Vec<usize> {
    let elf = Elf::parse(image).expect("an ELF");
    let page = |address: usize| (address - flash::START as usize) / flash::PAGE;
    let of = |(start, bytes): &(u32, Vec<u8>)| page(*start as usize)..=page(*start as usize + bytes.len() - 1);
    elf.segments.iter().flat_map(of).collect::<BTreeSet<usize>>().into_iter().collect()
}

/// The image whose task hangs after five seconds: different code under the same name.
fn a_really_different_build_goes_there_and_back(linux: &mut Linux, twin: &Twin, firmware: &[u8]) {
    let Some(other) = image_of("INERTER_STM32_HANG_ELF", "release/inerter-stm32g474-hang") else { return };
    let differing = pages(firmware).len().abs_diff(pages(&other).len());
    assert!(differing > 0 || code(firmware) != code(&other), "another layout");
    for (build, name) in [(&other[..], "hang"), (firmware, "back")] {
        give(linux, build.to_vec(), "/tmp/new.elf");
        stay_plugged_in(linux);
        linux.until(PORT);
        // The watchdog restarts the other build every ten seconds. Attempts during a restart fail at once, so one
        // restart may use up several.
        let ended = linux.run_within(
            "for n in $(seq 20); do inerter update /tmp/new.elf && exit 0; sleep 1; done; exit 1",
            4 * MINUTE,
        );
        assert_eq!(ended.code, 0, "{name}: {}{}", ended.text(), ended.errors);
        // Both builds have the same name, so only the flash tells them apart.
        let flash = twin.order(|server| server.socket.chip().flash.bytes().to_vec());
        for (start, bytes) in &Elf::parse(build).expect("an ELF").segments {
            let at = (start - flash::START) as usize;
            assert!(flash[at..][..bytes.len()] == bytes[..], "{name}: not in flash at {start:#010x}");
        }
        unplug_no_more(linux);
    }
    stay_plugged_in(linux);
    measures_as(linux, "inerter 0.");
    unplug_no_more(linux);
}

/// All bytes of an image, segment after segment.
fn code(image: &[u8]) -> Vec<u8> {
    let elf = Elf::parse(image).expect("an ELF");
    elf.segments.iter().flat_map(|(_, bytes)| bytes.clone()).collect()
}

/// The ROM describes the layout of the die, with 512 KB in two banks. The host must go by what the chip itself reports.
fn a_chip_that_is_too_small_is_refused_whatever_the_rom_describes(linux: &mut Linux, firmware: &[u8]) {
    const DBANK: u32 = 1 << 22;
    give(linux, firmware.to_vec(), "/tmp/new.elf");
    for (flash_kb, one_bank, said) in [(128, false, "128 KB"), (512, true, "single bank")] {
        let firmware = firmware.to_vec();
        let twin = Twin::serve(move || {
            let options = Options { flash_kb, ..Options::default() };
            let mut machine = Machine::with(&firmware, options, Still).expect("the binary");
            machine.rom_leaves = Some(Left::Running);
            if one_bank {
                let options = machine.chip().flash.options();
                machine.chip_mut().flash.set_options(options & !DBANK);
            }
            machine.boot0 = true;
            machine.power_cut().expect("starts");
            machine
        });
        linux.run(&format!("inerter-guest attach 10.0.2.2:{}", twin.address.port()));
        linux.until(LOADER);
        let ended = linux.run_within("inerter update /tmp/new.elf", SOON);
        assert_ne!(ended.code, 0);
        assert!(ended.errors.contains(said), "{}", ended.errors);
        assert_eq!(twin.erased(), 0);
        twin.order(Server::unplug);
        linux.until(GONE);
        twin.end();
    }
}

/// Echo programs on third-party drivers, on a host that we did not write either. One answers in capitals, one with each
/// letter raised by one.
fn programs_of_others_are_served(linux: &mut Linux) {
    linux.until("! ls /dev/ttyACM*");
    for (name, maker, answer) in [("usb-serial", "Fake company", "TWIN"), ("hal2-usb", "Others", "uxjo")] {
        let Some(image) = image_of_others(name) else { return };
        let twin = Twin::serve(move || chip_with(&image, Still));
        linux.attach_another(twin.address, "/dev/ttyACM0");
        assert_eq!(linux.run("cat /sys/class/tty/ttyACM0/device/../manufacturer").trim(), maker);
        linux.run("stty -F /dev/ttyACM0 raw -echo");
        let ended = linux.run_within("exec 3<>/dev/ttyACM0; printf twin >&3; head -c 4 <&3", SOON);
        assert_eq!(ended.text(), answer, "{name}: {}", linux.run("dmesg | tail -20"));
        twin.order(Server::unplug);
        linux.until("! ls /dev/ttyACM*");
        twin.end();
    }
}
