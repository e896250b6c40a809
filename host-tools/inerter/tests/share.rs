//! Several programs with one device: with a virtual one, and with one shared by `monitor --share`.

use std::{io::Write, net::TcpStream};

use crate::common::{done, fails, json_lines, last, monitor::Monitor, run, setup, text};
use inerter_device::{Clock, Device, DeviceError, Target};
use inerter_simulate::{Endpoint, VirtualDevice, share::MOST_READERS};
use inerter_wire::{Command, Frame, MAX_FRAME, Record, Refusal, Request, Streams, encode_request};

fn device_at(address: &str) -> VirtualDevice {
    VirtualDevice::start(&setup("random"), &Endpoint::Tcp(address.into()), 2.0).unwrap()
}

fn connect(address: &str) -> Device {
    Device::connect(&Target::Tcp { address: address.into() }, Clock::new(), || false).unwrap()
}

/// Receives until this many matching records have arrived.
fn receive(device: &mut Device, mut count: usize, of: impl Fn(&Record) -> bool) {
    while count > 0 {
        if let Some(received) = device.receive().unwrap()
            && let Frame::Message { message, .. } = &received.frame
        {
            count -= usize::from(of(message));
        }
    }
}

#[test]
fn two_programs_see_the_same_device_and_the_first_controls_it() {
    let folder = tempfile::tempdir().unwrap();
    let virtual_device = device_at("127.0.0.1:0");
    let address = virtual_device.name();
    let mut first = connect(address);
    first.stream(Streams { estimates: true, ..Streams::NONE }).unwrap();
    first.start_sampler().unwrap();

    let mut second = connect(address);
    assert_eq!((second.hello(), second.settings()), (first.hello(), first.settings()));
    second.stream(Streams { samples: true, ..Streams::NONE }).unwrap();
    receive(&mut second, 50, |record| matches!(record, Record::Samples(_)));
    let refused = second.request("a reset", Command::ResetEstimator).unwrap_err();
    assert!(matches!(refused, DeviceError::Refused { refusal: Refusal::Busy, .. }), "{refused}");
    first.request("a reset", Command::ResetEstimator).unwrap();
    receive(&mut first, 2, |record| {
        assert!(!matches!(record, Record::Samples(_)), "not asked for");
        matches!(record, Record::Estimate(_))
    });
    assert_eq!((first.counts().lost, second.counts().lost), (0, 0));

    // Complete programs can observe as well, and a recording loses nothing.
    let output = run(folder.path(), &["monitor", "--json", "--connect", address, "--duration", "2"]);
    assert!(output.status.success() && text(&output.stderr).contains("another program controls this device"));
    assert!(json_lines(&text(&output.stdout)).iter().any(|line| line["kind"] == "estimate"));
    done(folder.path(), &["record", "--connect", address, "--duration", "1", "-o", "run.mcap"]);
    let info = last(&done(folder.path(), &["info", "run.mcap", "--json"]));
    assert!(info["samples"].as_u64().unwrap() > 500, "{info}");
    assert_eq!((&info["lost_frames"], &info["lost_samples"]), (&0.into(), &0.into()), "{info}");
    let set = ["settings", "set", "--connect", address, "memory_s=7"];
    let words = fails(folder.path(), &set, 6);
    assert!(words.contains("another program may control the device"), "{words}");

    // The controlling program disconnects, and the next one takes control.
    drop((first, second));
    done(folder.path(), &set);
    let mut third = connect(address);
    assert_eq!(third.settings().memory_s, 7.0);
    third.request("a reset", Command::ResetEstimator).unwrap();
}

#[test]
fn who_never_reads_keeps_nobody_out() {
    let virtual_device = device_at("127.0.0.1:0");
    // The first client has control. It requests everything and reads nothing.
    let mut stuck = TcpStream::connect(virtual_device.name()).unwrap();
    let mut out = [0; MAX_FRAME];
    let request = Request { id: 9, command: Command::Streams(Streams::ALL) };
    let length = encode_request(&request, 0, &mut out).unwrap();
    stuck.write_all(&out[..length]).unwrap();
    let mut device = connect(virtual_device.name());
    device.stream(Streams::ALL).unwrap();
    receive(&mut device, 200, |record| matches!(record, Record::Samples(_)));
    assert_eq!(device.counts().lost, 0);
}

#[test]
fn one_too_many_is_told_so() {
    let folder = tempfile::tempdir().unwrap();
    let virtual_device = device_at("127.0.0.1:0");
    // Silent clients keep nobody out.
    let _mute: Vec<TcpStream> = (0..MOST_READERS).map(|_| TcpStream::connect(virtual_device.name()).unwrap()).collect();
    let mut readers: Vec<Device> = (0..MOST_READERS).map(|_| connect(virtual_device.name())).collect();
    let words = fails(folder.path(), &["settings", "get", "--connect", virtual_device.name()], 5);
    assert!(words.contains("closed the connection before it sent anything") && !words.contains("went away"), "{words}");
    assert!(words.contains("close one of them"), "{words}");
    // One client leaves, and there is room as soon as this is noticed.
    readers.pop();
    while !run(folder.path(), &["settings", "get", "--connect", virtual_device.name()]).status.success() {}
}

#[test]
fn a_monitor_shares_its_device() {
    let folder = tempfile::tempdir().unwrap();
    let before = device_at("127.0.0.1:0");
    let address = before.name().to_string();
    let mut monitor = Monitor::start(folder.path(), &address, &["--share", "127.0.0.1:0", "--wait", "60"]);
    let view = monitor.next("view");
    assert_eq!(view["view"], "shared device");
    let shared = view["address"].as_str().unwrap().to_string();
    monitor.next("device");
    let mut reader = connect(&shared);
    assert_eq!(reader.hello().board.as_str(), "virtual");
    reader.stream(Streams::ALL).unwrap();
    receive(&mut reader, 20, |record| matches!(record, Record::Samples(_)));
    receive(&mut reader, 2, |record| matches!(record, Record::Estimate(_)));
    let refused = reader.request("a reset", Command::ResetEstimator).unwrap_err();
    assert!(matches!(refused, DeviceError::Refused { refusal: Refusal::Busy, .. }), "{refused}");
    assert_eq!(reader.counts().lost, 0);
    done(folder.path(), &["record", "--connect", &shared, "--duration", "1", "-o", "run.mcap"]);
    assert_eq!(last(&done(folder.path(), &["info", "run.mcap", "--json"]))["lost_samples"], 0);

    // The device disconnects, and so do its observers. When it returns, they may reconnect.
    drop(before);
    while reader.receive().is_ok() {}
    let _after = device_at(&address);
    monitor.next("device");
    let mut reader = connect(&shared);
    receive(&mut reader, 2, |record| matches!(record, Record::Estimate(_)));
}

#[test]
fn a_device_is_shared_with_other_machines_only_where_that_is_meant() {
    let folder = tempfile::tempdir().unwrap();
    let device = device_at("127.0.0.1:0");
    let monitor = ["monitor", "--connect", device.name(), "--json", "--duration", "1"];
    for address in ["0.0.0.0:0", "[::]:0"] {
        let words = fails(folder.path(), &[&monitor[..], &["--share", address]].concat(), 2);
        assert!(
            words.contains(&format!("--share {address} would let in other machines"))
                && words.contains("--allow-remote"),
            "{words}"
        );
    }
    for (arguments, host, is_told) in [
        (&["--share", "0.0.0.0:0", "--allow-remote"][..], "0.0.0.0:", true),
        (&["--share", "127.0.0.1:0", "--allow-remote"], "127.0.0.1:", false),
    ] {
        let output = run(folder.path(), &[&monitor[..], arguments].concat());
        let words = text(&output.stderr);
        assert!(output.status.success(), "{words}");
        let lines = json_lines(&text(&output.stdout));
        let view = lines.iter().find(|line| line["kind"] == "view").unwrap();
        assert!(view["address"].as_str().unwrap().starts_with(host), "{view}");
        assert_eq!(words.contains("any machine that reaches"), is_told, "{words}");
    }
    // A file left in the folder must not share the device with other machines.
    for (key, line) in [("share", "share = \"0.0.0.0:0\""), ("allow_remote", "allow_remote = true")] {
        std::fs::write(folder.path().join("inerter.toml"), format!("[monitor]\n{line}\n")).unwrap();
        let words = fails(folder.path(), &monitor, 4);
        assert!(words.contains(&format!("may not set `monitor.{key}`")), "{words}");
    }
}
