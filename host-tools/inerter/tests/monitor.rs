//! `inerter monitor` from outside: its screen on a pseudo-terminal, its page and its bridges, with a virtual device.

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream, UdpSocket},
    path::Path,
    process::Child,
    time::{Duration, Instant},
};

use crate::common::{self, device, device_of, done, fails, inerter, last, monitor::Monitor, setup, text};
use inerter_core::Machine;
use inerter_simulate::{Endpoint, VirtualDevice};
use serde_json::Value;
use tungstenite::{ClientRequestBuilder, Message, WebSocket};

/// Time limit for any event.
const LIMIT: Duration = Duration::from_secs(30);

fn connect(url: &str, origin: Option<&str>, protocol: Option<&str>) -> Result<WebSocket<TcpStream>, String> {
    let mut request = ClientRequestBuilder::new(url.parse().unwrap());
    if let Some(origin) = origin {
        request = request.with_header("Origin", origin);
    }
    if let Some(protocol) = protocol {
        request = request.with_sub_protocol(protocol);
    }
    let host = url.split('/').nth(2).unwrap();
    let stream = TcpStream::connect(host).unwrap();
    stream.set_read_timeout(Some(LIMIT)).unwrap();
    tungstenite::client(request, stream).map(|(socket, _)| socket).map_err(|error| error.to_string())
}

/// The status line and the rest of a server's response.
fn get(host: &str, path: &str, headers: &str) -> String {
    let mut stream = TcpStream::connect(host).unwrap();
    stream.set_read_timeout(Some(LIMIT)).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nConnection: close\r\n{headers}\r\n").unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    text(&answer)
}

#[test]
fn the_page_lets_in_only_who_has_its_address_and_shows_what_is_measured() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(2.0);
    let mut monitor = Monitor::start(folder.path(), device.name(), &["--web", "--record", "run.mcap"]);
    let url = monitor.next("view")["address"].as_str().unwrap().to_string();
    let host = url.split('/').nth(2).unwrap();
    let path = url.strip_prefix(&format!("http://{host}")).unwrap();
    let named = format!("Host: {host}\r\n");

    let page = get(host, path, &named);
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    assert!(page.contains("content-security-policy: default-src 'none'; script-src 'nonce-"), "{page}");
    // The page loads nothing from outside; the licence comment of uPlot names its home page.
    let outside = page.replace("https://github.com/leeoniya/uPlot", "");
    assert!(!outside.contains("https://") && !outside.contains(" src=") && !outside.contains("{nonce}"));

    for (path, headers) in [
        ("/", named.clone()),
        ("/00000000000000000000000000000000/", named.clone()),
        ("/00000000000000000000000000000000/live", named.clone()),
        (path, "Host: evil.example\r\n".into()),
        (path, format!("Host: evil.example:{}\r\n", host.rsplit(':').next().unwrap())),
        (path, format!("{named}Origin: http://evil.example\r\n")),
        (path, String::new()),
        (path, format!("{named}Host: evil.example\r\n")),
        (path, format!("Host: evil.example\r\n{named}")),
        (path, "Host: localhost:1; script-src *\r\n".into()),
    ] {
        let answer = get(host, path, &headers);
        assert!(answer.starts_with("HTTP/1.1 403") || answer.starts_with("HTTP/1.1 400"), "{path} {headers}: {answer}");
    }
    let live = format!("ws://{host}{path}live");
    assert!(connect(&live, Some("http://evil.example"), None).unwrap_err().contains("403"));

    let mut socket = connect(&live, Some(&format!("http://{host}")), None).unwrap();
    socket.send(Message::text("nonsense")).unwrap();
    socket.send(Message::text(r#"{"marker":"  bolt tightened\n "}"#)).unwrap();
    let mut seen = Vec::new();
    while !["begin", "device", "samples", "history", "estimate", "health", "marker"]
        .iter()
        .all(|kind| seen.iter().any(|value: &Value| value["kind"] == *kind))
    {
        if let Message::Text(text) = socket.read().unwrap() {
            seen.push(last(&text));
        }
        assert!(seen.len() < 3000, "{:?}", seen.last());
    }
    let of = |kind: &str| seen.iter().find(|value| value["kind"] == kind).unwrap();
    assert_eq!(of("marker")["text"], "bolt tightened");
    assert_eq!(of("begin")["recording"], "run.mcap");
    assert!(of("estimate")["inertance_kg"].get("status").is_some());
    assert!(seen.iter().any(|value| value["kind"] == "samples" && !value["t_s"].as_array().unwrap().is_empty()));
    assert_eq!(monitor.next("marker")["text"], "bolt tightened");

    // The recording contains the marker and can be read although the monitor is killed.
    drop(monitor);
    let bytes = std::fs::read(folder.path().join("run.mcap")).unwrap();
    assert!(bytes.windows(14).any(|window| window == b"bolt tightened"));
    done(folder.path(), &["info", "run.mcap", "--json"]);
}

#[test]
fn an_estimator_is_reset_from_the_page() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(2.0);
    let mut monitor = Monitor::start(folder.path(), device.name(), &["--web"]);
    let url = monitor.next("view")["address"].as_str().unwrap().replace("http://", "ws://");
    monitor.next("estimate");
    let mut socket = connect(&format!("{url}live"), None, None).unwrap();
    socket.send(Message::text(r#"{"reset_estimator":true}"#)).unwrap();
    assert_eq!(monitor.next("event")["code"], "estimator_reset");
}

#[test]
fn a_reset_is_refused_aloud_where_another_program_has_the_control() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(2.0);
    let target = inerter_device::Target::Tcp { address: device.name().into() };
    let _controller = inerter_device::Device::connect(&target, inerter_device::Clock::new(), || false).unwrap();
    let mut monitor = Monitor::start(folder.path(), device.name(), &["--web"]);
    let url = monitor.next("view")["address"].as_str().unwrap().replace("http://", "ws://");
    let mut socket = connect(&format!("{url}live"), None, None).unwrap();
    socket.send(Message::text(r#"{"reset_estimator":true}"#)).unwrap();
    let words = loop {
        if let Message::Text(text) = socket.read().unwrap() {
            let message = last(&text);
            if message["kind"] == "event" && message["trouble"] == true {
                break message["words"].as_str().unwrap().to_string();
            }
        }
    };
    assert!(words.contains("refused to reset its estimator: the device is busy"), "{words}");
}

#[test]
fn a_page_for_other_machines_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(2.0);
    let refused = |arguments: &[&str], code| {
        fails(folder.path(), &[&["monitor", "--connect", device.name()], arguments].concat(), code)
    };
    let words = refused(&["--web", "--bind", "0.0.0.0:0"], 2);
    assert!(
        words.contains("--bind 0.0.0.0:0 would offer the page to other machines") && words.contains("ssh -L"),
        "{words}"
    );
    let words = refused(&["--teleplot", "nowhere"], 2);
    assert!(words.contains("--teleplot nowhere is not an address") && words.contains("127.0.0.1:47269"), "{words}");
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    for arguments in [&["--web", "--bind", &address][..], &["--foxglove", &address]] {
        let words = refused(arguments, 8);
        assert!(words.contains(&format!("cannot listen at {address}")), "{words}");
    }
}

#[test]
fn other_machines_are_let_in_only_where_that_is_meant() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(2.0);
    let bridge = ["monitor", "--connect", device.name(), "--json", "--duration", "1", "--foxglove", "0.0.0.0:0"];
    for (command, option) in [(&bridge[..], "--foxglove"), (&["simulate", "--tcp", "0.0.0.0:0"], "--tcp")] {
        let words = fails(folder.path(), command, 2);
        assert!(
            words.contains(&format!("{option} 0.0.0.0:0 would let in other machines"))
                && words.contains("--allow-remote"),
            "{words}"
        );
    }
    let output = common::run(folder.path(), &[&bridge[..], &["--allow-remote"]].concat());
    // A file left in the folder must not enable remote access.
    std::fs::write(folder.path().join("inerter.toml"), "[simulate]\nallow_remote = true\n").unwrap();
    let words = fails(folder.path(), &["simulate", "--tcp", "0.0.0.0:0"], 4);
    assert!(words.contains("may not set `simulate.allow_remote`"), "{words}");
    let words = text(&output.stderr);
    assert!(output.status.success() && words.contains("any machine that reaches 0.0.0.0:0 can connect"), "{words}");
}

/// A socket that receives a bridge's packets, and its address.
fn listener() -> (UdpSocket, String) {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(LIMIT)).unwrap();
    let address = socket.local_addr().unwrap().to_string();
    (socket, address)
}

fn datagram(socket: &UdpSocket) -> String {
    let mut bytes = [0; 2000];
    let count = socket.recv(&mut bytes).unwrap();
    assert!(count <= 1432, "{count} bytes do not fit one packet");
    text(&bytes[..count])
}

#[test]
fn teleplot_and_plotjuggler_are_sent_samples_and_estimates() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(2.0);
    let ((teleplot, to_teleplot), (juggler, to_juggler)) = (listener(), listener());
    let _monitor =
        Monitor::start(folder.path(), device.name(), &["--teleplot", &to_teleplot, "--plotjuggler", &to_juggler]);
    let now_s = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs_f64();

    let mut names = std::collections::BTreeSet::new();
    while !["force_n", "position_m", "inertance_kg", "inertance_kg_u95"].iter().all(|name| names.contains(*name)) {
        let line = datagram(&teleplot);
        if line.starts_with('>') {
            continue;
        }
        // name:ms:value;ms:value§unit|g
        let (name, rest) = line.split_once(':').unwrap();
        let (points, unit) = rest.strip_suffix("|g").unwrap().split_once('§').unwrap();
        assert!(!unit.is_empty());
        let mut before = 0.0;
        for point in points.split(';') {
            let (time, value) = point.split_once(':').unwrap();
            let time: f64 = time.parse().unwrap();
            assert!(time > before && (time / 1e3 - now_s).abs() < 120.0, "{line}");
            assert!(value.parse::<f64>().is_ok_and(f64::is_finite), "{line}");
            before = time;
        }
        names.insert(name.to_string());
    }

    let (mut samples, mut estimates, mut before) = (0, 0, 0.0);
    while samples < 100 || estimates < 2 {
        let value: Value = serde_json::from_str(&datagram(&juggler)).unwrap();
        let time = value["timestamp"].as_f64().unwrap();
        assert!((time - now_s).abs() < 120.0, "{value}");
        if let Some(sample) = value.get("samples") {
            assert!(time > before && sample["force_n"].is_f64() && sample["position_m"].is_f64(), "{value}");
            assert!(sample.get("terminal_m").is_none(), "what is not known is left out: {value}");
            (samples, before) = (samples + 1, time);
        } else {
            assert!(value["estimate"]["inertance_kg"]["status"].is_string(), "{value}");
            estimates += 1;
        }
    }
}

#[test]
fn views_of_a_rotary_machine_have_its_names_and_units() {
    let folder = tempfile::tempdir().unwrap();
    let mut setup = setup("random");
    setup.settings.machine = Machine::Rotary;
    let device = device_of(&setup, 2.0);
    let ((teleplot, to_teleplot), (juggler, to_juggler)) = (listener(), listener());
    let bridges = ["--teleplot", &to_teleplot, "--plotjuggler", &to_juggler, "--foxglove", "127.0.0.1:0"];
    let mut monitor = Monitor::start(folder.path(), device.name(), &bridges);
    let url = std::iter::repeat_with(|| monitor.next("view")).find(|view| view["view"] == "Foxglove").unwrap();
    let url = url["address"].as_str().unwrap().to_string();
    let estimate = monitor.next("estimate");
    assert!(estimate["inertia_kg_m2"].is_object() && estimate["backlash_rad"].is_object(), "{estimate}");

    // name:ms:value;ms:value§unit|g
    let mut units = std::collections::BTreeMap::new();
    while !["torque_n_m", "angle_rad", "inertia_kg_m2", "residual_rms_n_m"].iter().all(|name| units.contains_key(*name))
    {
        let line = datagram(&teleplot);
        let (Some((name, _)), Some((_, unit))) = (line.split_once(':'), line.split_once('§')) else { continue };
        units.insert(name.to_string(), unit.to_string());
    }
    assert_eq!((units["torque_n_m"].as_str(), units["inertia_kg_m2"].as_str()), ("N m|g", "kg m²|g"));
    for linear in ["force_n", "position_m", "inertance_kg", "residual_rms_n"] {
        assert!(!units.contains_key(linear), "{units:?}");
    }
    loop {
        let value: Value = serde_json::from_str(&datagram(&juggler)).unwrap();
        if let Some(sample) = value.get("samples") {
            assert!(sample["torque_n_m"].is_f64() && sample.get("force_n").is_none(), "{value}");
        } else {
            assert!(value["estimate"]["inertia_kg_m2"]["status"].is_string(), "{value}");
            break;
        }
    }
    let (_, channels) = foxglove(&url);
    let schema = |topic: &str| -> Value {
        let channel = channels.iter().find(|channel| channel["topic"] == topic).unwrap();
        serde_json::from_str(channel["schema"].as_str().unwrap()).unwrap()
    };
    assert_eq!(schema("/samples")["properties"]["torque_n_m"]["description"], "Torque [N m]");
    assert!(schema("/estimate")["properties"]["inertia_kg_m2"].is_object());
    assert!(schema("/estimate")["properties"]["inertance_kg"].is_null());
}

/// A client of the Foxglove server, and all its channels.
fn foxglove(url: &str) -> (WebSocket<TcpStream>, Vec<Value>) {
    let mut socket = connect(&format!("{url}/"), None, Some("foxglove.sdk.v1")).unwrap();
    let mut channels: Vec<Value> = Vec::new();
    while channels.len() < 6 {
        if let Message::Text(text) = socket.read().unwrap() {
            let value = last(&text);
            if value["op"] == "advertise" {
                channels.extend(value["channels"].as_array().unwrap().iter().cloned());
            }
        }
    }
    (socket, channels)
}

#[test]
fn foxglove_is_served_to_known_pages_only() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(2.0);
    let arguments = ["--foxglove", "127.0.0.1:0", "--foxglove-origin", "https://plots.example"];
    let mut monitor = Monitor::start(folder.path(), device.name(), &arguments);
    let url = format!("{}/", monitor.next("view")["address"].as_str().unwrap());
    let protocol = Some("foxglove.sdk.v1");
    for origin in ["https://evil.example", "null", "http://localhost.evil.example", "http://app.foxglove.dev"] {
        let refused = connect(&url, Some(origin), protocol).unwrap_err();
        assert!(refused.contains("403"), "{origin}: {refused}");
    }
    for origin in ["https://app.foxglove.dev", "http://localhost:8080", "https://plots.example"] {
        connect(&url, Some(origin), protocol).unwrap();
    }
    connect(&url, None, Some("foxglove.websocket.v1")).unwrap();
    assert!(connect(&url, None, None).unwrap_err().contains("400"));
    let host = url.split('/').nth(2).unwrap();
    let upgrade = "Upgrade: websocket\r\nConnection: upgrade\r\nSec-WebSocket-Version: 13\r\n\
                   Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n";
    for (name, code) in [("evil.example", "403"), (host, "101")] {
        let mut stream = TcpStream::connect(host).unwrap();
        stream.set_read_timeout(Some(LIMIT)).unwrap();
        write!(stream, "GET / HTTP/1.1\r\nHost: {name}\r\n{upgrade}\r\n").unwrap();
        let mut answer = String::new();
        BufReader::new(stream).read_line(&mut answer).unwrap();
        assert!(answer.contains(code), "{name}: {answer}");
    }
}

/// A frame that announces a large size is refused before its content arrives.
#[test]
fn nobody_may_fill_the_memory_with_a_frame() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(2.0);
    let mut monitor = Monitor::start(folder.path(), device.name(), &["--web", "--foxglove", "127.0.0.1:0"]);
    for _ in 0..2 {
        let view = monitor.next("view");
        let address = view["address"].as_str().unwrap();
        let (url, protocol) = match address.strip_prefix("http://") {
            Some(page) => (format!("ws://{}live", page), None),
            None => (format!("{address}/"), Some("foxglove.sdk.v1")),
        };
        let mut socket = connect(&url, None, protocol).unwrap();
        // Final, binary, masked, with a length of 8 MiB.
        let head = [&[0x82, 0xff][..], &(8_u64 << 20).to_be_bytes(), &[0; 4], &[0; 100]].concat();
        socket.get_mut().write_all(&head).unwrap();
        let error = (0..300).find_map(|_| socket.read().err()).expect("what comes is not read");
        let waits = matches!(&error, tungstenite::Error::Io(error) if error.kind() == std::io::ErrorKind::WouldBlock);
        assert!(!waits, "{address} waits for the rest");
    }
}

#[test]
fn foxglove_finds_channels_with_schemas_and_their_messages() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(2.0);
    let mut monitor = Monitor::start(folder.path(), device.name(), &["--foxglove", "127.0.0.1:0"]);
    let url = monitor.next("view")["address"].as_str().unwrap().to_string();
    let (mut socket, channels) = foxglove(&url);
    let channel = |topic: &str| channels.iter().find(|channel| channel["topic"] == topic).unwrap();
    for topic in ["/samples", "/estimate", "/reversal", "/health", "/event", "/marker"] {
        assert_eq!(
            (&channel(topic)["encoding"], &channel(topic)["schemaEncoding"]),
            (&"json".into(), &"jsonschema".into())
        );
    }
    let schema: Value = serde_json::from_str(channel("/samples")["schema"].as_str().unwrap()).unwrap();
    assert_eq!(schema["properties"]["force_n"]["description"], "Force [N]");

    let ids: Vec<Value> = ["/samples", "/estimate"].iter().map(|topic| channel(topic)["id"].clone()).collect();
    let wanted = serde_json::json!({ "op": "subscribe", "subscriptions": [
        { "id": 1, "channelId": ids[0] }, { "id": 2, "channelId": ids[1] },
    ]});
    socket.send(Message::text(wanted.to_string())).unwrap();
    let mut counts = [0, 0];
    while counts[0] < 100 || counts[1] < 2 {
        let Message::Binary(bytes) = socket.read().unwrap() else { continue };
        // Opcode 1, subscription, time, then the message.
        if bytes.first() != Some(&1) {
            continue;
        }
        let subscription = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
        let value: Value = serde_json::from_slice(&bytes[13..]).unwrap();
        match subscription {
            1 => assert!(value["force_n"].is_f64() && value["t_s"].is_f64(), "{value}"),
            2 => assert_eq!(value["kind"], "estimate", "{value}"),
            other => panic!("subscription {other}"),
        }
        counts[subscription as usize - 1] += 1;
    }
}

/// A client without the token opens requests and never completes them, while few files may be open.
#[cfg(unix)]
#[test]
fn half_sent_requests_end_and_do_not_keep_the_device_from_coming_back() {
    let folder = tempfile::tempdir().unwrap();
    let before = device(2.0);
    let address = before.name().to_string();
    let mut command = std::process::Command::new("sh");
    command.args(["-c", "ulimit -n 64 && exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_inerter")]);
    command.args(["monitor", "--json", "--connect", &address, "--wait", "30", "--web", "--foxglove", "127.0.0.1:0"]);
    command.current_dir(folder.path()).stdin(std::process::Stdio::null()).stdout(std::process::Stdio::piped());
    let mut monitor = Monitor::spawn(command);
    let url = monitor.next("view")["address"].as_str().unwrap().to_string();
    let foxglove = monitor.next("view")["address"].as_str().unwrap().to_string();
    let [page, bridge] = [&url, &foxglove].map(|url| url.split('/').nth(2).unwrap());
    let half_sent: Vec<TcpStream> = [page, bridge]
        .into_iter()
        .flat_map(|host| (0..100).map(move |_| host))
        .map(|host| {
            let mut stream = TcpStream::connect(host).unwrap();
            stream.set_read_timeout(Some(LIMIT)).unwrap();
            // A client that was already turned away accepts no more data.
            stream.write_all(b"GET / HTTP/1.1\r\nHost: loc").ok();
            stream
        })
        .collect();
    // The page remains available.
    let path = url.strip_prefix(&format!("http://{page}")).unwrap();
    assert!(get(page, path, &format!("Host: {page}\r\n")).starts_with("HTTP/1.1 200"));
    monitor.next("device");
    drop(before);
    let _after = VirtualDevice::start(&setup("random"), &Endpoint::Tcp(address), 2.0).unwrap();
    monitor.next("device");
    for mut stream in half_sent {
        // The connection must be closed, not merely silent.
        if let Err(error) = stream.read_to_end(&mut Vec::new()) {
            assert_ne!(error.kind(), std::io::ErrorKind::WouldBlock, "a half-sent request stays");
        }
    }
}

#[cfg(unix)]
mod screen {
    use super::*;
    use crate::{
        common::{firmware, foreign_words, terminal::drawn},
        hostile::{WORDS, hostile},
    };
    use inerter_wire::{Event, EventKind, Hello, Record};
    use rustix::{
        fs::{Mode, OFlags},
        pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
        termios::{Winsize, tcgetattr, tcsetwinsize},
    };
    use std::{fs::File, process::Stdio, sync::mpsc, thread};

    /// A monitor on a terminal of its own.
    struct Screen {
        child: Child,
        keys: File,
        terminal: File,
        pictures: mpsc::Receiver<Vec<u8>>,
        /// Since the last wait.
        seen: String,
        /// Since the start.
        all: Vec<u8>,
    }

    impl Screen {
        fn start(folder: &Path, address: &str, arguments: &[&str]) -> Self {
            let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
            grantpt(&master).unwrap();
            unlockpt(&master).unwrap();
            let name = ptsname(&master, Vec::new()).unwrap();
            let terminal =
                File::from(rustix::fs::open(name.as_c_str(), OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap());
            let size = Winsize { ws_row: 24, ws_col: 80, ws_xpixel: 0, ws_ypixel: 0 };
            tcsetwinsize(&terminal, size).unwrap();
            let mut command = inerter(folder, &[&["monitor", "--connect", address], arguments].concat());
            command.env("TERM", "xterm-256color");
            command
                .stdin(Stdio::from(terminal.try_clone().unwrap()))
                .stdout(Stdio::from(terminal.try_clone().unwrap()));
            let child = command.spawn().unwrap();
            let keys = File::from(master);
            let mut output = keys.try_clone().unwrap();
            let (sender, pictures) = mpsc::channel();
            thread::spawn(move || {
                let mut bytes = [0; 4096];
                while let Ok(count) = output.read(&mut bytes) {
                    if sender.send(bytes[..count].to_vec()).is_err() {
                        break;
                    }
                }
            });
            Self { child, keys, terminal, pictures, seen: String::new(), all: Vec::new() }
        }

        fn press(&mut self, keys: &str) {
            self.keys.write_all(keys.as_bytes()).unwrap();
        }

        /// Takes what is drawn within this time; false if nothing is.
        fn look(&mut self, within: Duration) -> bool {
            let Ok(bytes) = self.pictures.recv_timeout(within) else { return false };
            self.seen += &text(&bytes);
            self.all.extend(bytes);
            true
        }

        /// Waits until a word has been drawn since the last wait. Blanks that were already there are not drawn again.
        fn until(&mut self, word: &str) {
            let started = Instant::now();
            while !self.seen.contains(word) {
                assert!(started.elapsed() < LIMIT, "`{word}` was not drawn: {:?}", self.seen);
                self.look(Duration::from_millis(100));
            }
            self.seen.clear();
        }

        /// Waits for the end. The terminal settings must be restored, and nothing foreign may have been drawn.
        fn ended(mut self, before: &rustix::termios::Termios, code: i32) -> String {
            let started = Instant::now();
            let status = loop {
                if let Some(status) = self.child.try_wait().unwrap() {
                    break status;
                }
                assert!(started.elapsed() < LIMIT, "the monitor does not end");
                thread::sleep(Duration::from_millis(10));
            };
            let mut words = String::new();
            self.child.stderr.take().unwrap().read_to_string(&mut words).unwrap();
            assert_eq!(status.code(), Some(code), "{words}");
            let after = tcgetattr(&self.terminal).unwrap();
            assert_eq!(after.local_modes, before.local_modes, "the terminal still takes keys one by one");
            // On a busy machine what was drawn last arrives late.
            while self.look(Duration::from_millis(200)) || !text(&self.all).contains("\x1b[?1049l") {
                assert!(started.elapsed() < LIMIT, "the terminal still shows the screen");
            }
            assert_eq!(foreign_words(&drawn(&text(&self.all))), None);
            words
        }
    }

    #[test]
    fn keys_mark_pause_and_quit_and_the_terminal_is_given_back() {
        let folder = tempfile::tempdir().unwrap();
        let device = device(2.0);
        let mut screen = Screen::start(folder.path(), device.name(), &["--record", "run.mcap"]);
        let before = tcgetattr(&screen.terminal).unwrap();
        screen.until("inertance");
        screen.press("?");
        screen.until("Keys");
        screen.press("x");
        screen.press("m");
        screen.until("Enter");
        screen.press("bolt\r");
        screen.press("5");
        screen.until("marker:");
        screen.press(" ");
        screen.until("PAUSED");
        screen.press("q");
        screen.ended(&before, 0);
        let info = last(&done(folder.path(), &["info", "run.mcap", "--json"]));
        assert_eq!(
            (&info["ending"], &info["lost_frames"], &info["discontinuities"]),
            (&"closed".into(), &0.into(), &0.into())
        );
        let bytes = std::fs::read(folder.path().join("run.mcap")).unwrap();
        assert!(bytes.windows(4).any(|window| window == b"bolt"));
    }

    #[test]
    fn a_device_that_is_lost_and_an_interrupt_give_the_terminal_back() {
        let folder = tempfile::tempdir().unwrap();
        let device = device(2.0);
        let mut screen = Screen::start(folder.path(), device.name(), &["--wait", "0.3", "--record", "run.mcap"]);
        let before = tcgetattr(&screen.terminal).unwrap();
        screen.until("inertance");
        drop(device);
        let words = screen.ended(&before, 6);
        assert!(words.contains("went away"), "{words}");
        let info = last(&done(folder.path(), &["info", "run.mcap", "--json"]));
        assert_eq!(info["ending"], "closed");

        let device = super::device(2.0);
        let mut screen = Screen::start(folder.path(), device.name(), &[]);
        let before = tcgetattr(&screen.terminal).unwrap();
        screen.until("inertance");
        let process = rustix::process::Pid::from_child(&screen.child);
        rustix::process::kill_process(process, rustix::process::Signal::TERM).unwrap();
        screen.ended(&before, 0);
    }

    /// The hostile device, which also sends another panic with each report on its health.
    fn panicking(record: &Record) -> Vec<Vec<u8>> {
        let mut payloads = hostile(record);
        if let Record::Health(health) = record {
            let kind = EventKind::Panicked(Hello::text(&format!("{WORDS}{}", health.index)));
            payloads.push(firmware::payload(&Record::Event(Event { index: health.index, kind })));
        }
        payloads
    }

    #[test]
    fn no_device_draws_what_it_likes() {
        let folder = tempfile::tempdir().unwrap();
        let device = device(2.0);
        let mut screen = Screen::start(folder.path(), &firmware::before(device.name(), panicking), &[]);
        let before = tcgetattr(&screen.terminal).unwrap();
        // The name of the board in the heading, that of the firmware with the health, and the panics.
        screen.until(r"\u001b]52;c;aGk=\u0007\nforged\u202e");
        screen.press("4");
        screen.until("clock:");
        screen.press("5");
        screen.until(r"\u001b]52;c;aGk=\u0007");
        screen.press("q");
        screen.ended(&before, 0);
    }
}
