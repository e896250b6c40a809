//! The shipping binary on the USB cable, with a normal host, a bad host and no host.
//!
//! The host is [`UsbHost`](inerter_twin::usb_host::UsbHost), in the device's time. In `linux.rs` a real kernel is the
//! host.

#[path = "../../src/fuzz/outcome.rs"]
mod outcome;

use crate::common::{self, Item, board, carried_by, causes, corpus, last_reset, opened, serial};
use inerter_app::wear::SAVES;
use inerter_core::Settings;
use inerter_needs::Random;
use inerter_plant::Excitation;
use inerter_twin::bench::{Bench, Rig};
use inerter_twin::chip::rcc::Reset;
use inerter_twin::machine::{Machine, shipping_image};
use inerter_twin::talk::Talk;
use inerter_twin::usb_host::serial::{line_coding, set_control_lines, set_line_coding};
use inerter_twin::usb_host::{Setup, Socket, Transfer, UsbError};
use inerter_twin::usb_link::UsbLink;
use inerter_twin::world::Still;
use inerter_wire::{
    Command, Done, Event, EventKind, Health, Hello, Measure, Record, Refusal, Reply, SettingsValues, Streams,
};
use outcome::outcome;

/// Time limit for a reply.
const REPLY_S: f64 = 0.5;

/// A moving rig, so that the encoded samples vary in length.
fn moving(seed: u64) -> Bench {
    Bench::new(Rig::new(Excitation::random(0.5, 15.0, 0.02, seed), 0.0)).expect("a rig that can be")
}

/// Sends Hello and returns the reply's record.
fn hello(link: &mut UsbLink<Machine>) -> Hello {
    let reply = link.request(Command::Hello, REPLY_S).expect("a reply to Hello");
    assert_eq!(reply.result, Ok(Done::Plain));
    let records = link.talk.records();
    let hello = records.iter().find_map(carried_by!(Record::Hello));
    hello.unwrap_or_else(|| panic!("no Hello among {records:?}")).clone()
}

fn done(link: &mut UsbLink<Machine>, command: Command) {
    let reply = link.request(command.clone(), REPLY_S).unwrap_or_else(|error| panic!("{command:?}: {error}"));
    assert_eq!(reply.result, Ok(Done::Plain), "{command:?}");
}

/// Sends Hello and switches all streams on.
fn streaming(link: &mut UsbLink<Machine>) {
    hello(link);
    done(link, Command::Streams(Streams::ALL));
}

fn settings(link: &mut UsbLink<Machine>) -> Settings {
    done(link, Command::ReadSettings);
    let values = link.talk.records().into_iter().find_map(carried_by!(Record::Settings));
    let reading = values.expect("settings").read(&Settings::default());
    assert_eq!((reading.unknown, reading.impossible, reading.missing), (0, 0, 0));
    reading.settings
}

/// The next `Health`, which comes once a second.
fn health(link: &mut UsbLink<Machine>) -> Health {
    done(link, Command::Streams(Streams { health: true, ..Streams::NONE }));
    for _ in 0..30 {
        link.listen(0.1).expect("the port is open");
        if let Some(health) = link.talk.records().into_iter().find_map(carried_by!(Record::Health)) {
            return health;
        }
    }
    panic!("no Health within three seconds");
}

/// The device has not restarted since [`board`] started it, by the chip's resets and by its own uptime.
fn has_run_through(link: &mut UsbLink<Machine>) {
    assert_eq!(causes(&link.socket), [Reset::Power, Reset::OptionBytes], "it started anew");
    let time_s = link.socket.time_s();
    let uptime_s = f64::from(health(link).uptime_s);
    assert!((uptime_s - time_s).abs() < 4.0, "up for {uptime_s} s of {time_s} s: it started anew");
}

#[test]
fn the_device_says_what_it_is() {
    let Some(mut link) = board(Still) else { return };
    let description = link.connect().expect("enumeration");
    assert_eq!((description.vendor, description.product_number), (0x1209, 0x0001));
    assert_eq!(description.manufacturer, "inerter");
    assert_eq!(description.product, "inerter");
    assert_eq!(description.serial, serial());
    assert_eq!(description.control_packet, 64);
    assert!(description.current_ma <= 500, "{} mA", description.current_ma);
    // The kernel's driver looks for a communication interface and a data interface.
    assert_eq!(description.interfaces.iter().map(|[_, class, ..]| *class).collect::<Vec<_>>(), [2, 10]);
    let (to_device, to_host) = description.serial_endpoints().expect("a serial port");
    for end in description.endpoints.iter().filter(|end| end.is_bulk) {
        assert_eq!(end.packet, 64);
        assert!([to_device, to_host].contains(&(end.address & 0xF)));
    }
    link.open().expect("opens");
    let hello = hello(&mut link);
    assert_eq!(hello.serial.as_str(), serial(), "one number for the port and the instrument");
}

#[test]
fn descriptors_come_in_the_length_that_is_asked_for() {
    let Some(mut link) = board(Still) else { return };
    link.connect().expect("enumeration");
    let UsbLink { socket, host, .. } = &mut link;
    for length in [1, 2, 8, 17, 18, 19, 64, 255] {
        let bytes = host.get_descriptor(socket, 1, 0, 0, length).expect("a device descriptor");
        assert_eq!(bytes.len(), usize::from(length).min(18));
    }
    let whole = host.get_descriptor(socket, 2, 0, 0, 0xFFFF).expect("a configuration");
    for length in [1, 9, 63, 64, 65, whole.len() as u16] {
        let bytes = host.get_descriptor(socket, 2, 0, 0, length).expect("a configuration");
        assert_eq!(bytes, whole[..whole.len().min(length.into())]);
    }
    assert_eq!(host.get_descriptor(socket, 3, 200, 0x409, 255), Err(UsbError::Stalled), "no such string");
    assert_eq!(host.get_descriptor(socket, 9, 0, 0, 255), Err(UsbError::Stalled), "no such kind");
}

#[test]
fn the_lines_of_the_serial_port_are_kept() {
    let Some(mut link) = board(Still) else { return };
    link.connect().expect("enumeration");
    let mut uart = common::SerialLink::default();
    let UsbLink { socket, host, .. } = &mut link;
    for baud in [1200, 115_200, 921_600] {
        set_line_coding(host, socket, baud).expect("taken");
        let [b0, b1, b2, b3] = baud.to_le_bytes();
        assert_eq!(line_coding(host, socket), Ok(vec![b0, b1, b2, b3, 0, 0, 8]));
    }
    for state in 0..4 {
        let terminal_ready = state & 1 != 0;
        set_control_lines(host, socket, terminal_ready, state & 2 != 0).expect("taken");
        // DTR alone opens the port, and the serial link answers while the port is closed.
        assert_eq!(uart.hello(socket), !terminal_ready, "lines {state:#04b}");
    }
}

#[test]
fn requests_for_nothing_and_requests_unknown_are_answered_at_once() {
    let Some(mut link) = board(Still) else { return };
    link.connect().expect("enumeration");
    let UsbLink { socket, host, .. } = &mut link;
    let request = |kind, request, value, length| Setup { kind, request, value, index: 0, length };
    let cases = [
        ("descriptor of no bytes", request(0x80, 6, 0x100, 0), Ok(vec![])),
        ("configuration of no bytes", request(0x80, 6, 0x200, 0), Ok(vec![])),
        ("status of no bytes", request(0x80, 0, 0, 0), Ok(vec![])),
        ("line coding of no bytes", request(0xA1, 0x21, 0, 0), Err(UsbError::Stalled)),
        ("unknown to the host", request(0xC0, 0x33, 0, 4), Err(UsbError::Stalled)),
        ("unknown to the host, no bytes", request(0xC0, 0x33, 0, 0), Err(UsbError::Stalled)),
        ("unknown without data", request(0x40, 0x33, 0, 0), Err(UsbError::Stalled)),
        ("no such class request", request(0x21, 0x7F, 0, 0), Err(UsbError::Stalled)),
        ("no such descriptor, no bytes", request(0x80, 6, 0x0900, 0), Err(UsbError::Stalled)),
    ];
    let coding = Setup { kind: 0x21, request: 0x20, value: 0, index: 0, length: 200 };
    assert_eq!(host.control(socket, coding, &[0; 200]), Err(UsbError::Stalled), "a line coding of 200 bytes");
    for (name, setup, expected) in cases {
        let before_s = socket.time_s();
        assert_eq!(host.control(socket, setup, &[]), expected, "{name}");
        let took_s = socket.time_s() - before_s;
        assert!(took_s < 0.05, "{name}: {took_s} s");
        assert_eq!(host.get_descriptor(socket, 1, 0, 0, 18).map(|bytes| bytes.len()), Ok(18), "after: {name}");
    }
}

#[test]
fn endpoints_that_do_not_exist_are_never_halted() {
    let Some(mut link) = board(Still) else { return };
    link.connect().expect("enumeration");
    let UsbLink { socket, host, .. } = &mut link;
    for endpoint in [0x07u8, 0x08, 0x0F, 0x87, 0x88, 0x8F, 0xFF] {
        // The device may accept or refuse, but it must answer. CLEAR_FEATURE, then SET_FEATURE.
        for request in [1, 3] {
            let halt = Setup { kind: 2, request, value: 0, index: endpoint.into(), length: 0 };
            let answer = host.control(socket, halt, &[]);
            assert!(matches!(answer, Ok(_) | Err(UsbError::Stalled)), "{endpoint:#04x}: {answer:?}");
        }
        let status = Setup { kind: 0x82, request: 0, value: 0, index: endpoint.into(), length: 2 };
        let answer = host.control(socket, status, &[]);
        assert!(answer == Ok(vec![0, 0]) || answer == Err(UsbError::Stalled), "{endpoint:#04x}: {answer:?}");
        assert_eq!(host.get_descriptor(socket, 1, 0, 0, 18).map(|bytes| bytes.len()), Ok(18), "{endpoint:#04x}");
    }
    link.open().expect("opens");
    hello(&mut link);
}

#[test]
fn random_requests_do_not_stop_the_device() {
    let Some(mut link) = board(Still) else { return };
    link.connect().expect("enumeration");
    let mut random = Random(7);
    for _ in 0..1500 {
        let mut bytes = std::array::from_fn(|_| random.draw() as u8);
        // Only lengths and recipients that the host's control transfer can have, and no SET_ADDRESS.
        bytes[7] = 0;
        bytes[0] &= 0xE3;
        if bytes[0] & 0x60 == 0 && bytes[1] == 5 {
            continue;
        }
        let setup = Setup::from_bytes(bytes);
        let data = vec![bytes[2]; setup.length.into()];
        let UsbLink { socket, host, .. } = &mut link;
        let number = host.submit(Transfer::Control(setup, data));
        let end_s = socket.time_s() + 0.02;
        while host.take_done(number).is_none() && socket.time_s() < end_s {
            host.service(socket).expect("the device goes on");
        }
        host.cancel(number);
    }
    link.unplug();
    link.plug_in().expect("enumeration");
    has_run_through(&mut link);
}

#[test]
fn a_configuration_set_again_and_halts_cleared_lose_nothing() {
    let Some(mut link) = board(Still) else { return };
    let description = link.connect().expect("enumeration");
    let (to_device, to_host) = description.serial_endpoints().expect("a serial port");
    link.open().expect("opens");
    // With an odd and with an even number of packets in each direction.
    for _ in 0..2 {
        hello(&mut link);
        link.close().expect("closes");
        link.host.configure(&mut link.socket, description.configuration).expect("taken");
        link.open().expect("opens");
        hello(&mut link);
        link.host.clear_halt(&mut link.socket, to_device).expect("taken");
        link.host.clear_halt(&mut link.socket, to_host | 0x80).expect("taken");
        hello(&mut link);
        assert_eq!(link.talk.lost, 0);
    }
}

#[test]
fn nothing_comes_before_the_host_has_spoken() {
    let Some(mut link) = opened(Still) else { return };
    assert_eq!(
        link.receive(3.0).expect("the port is open"),
        [0_u8; 0],
        "a fresh terminal echoes: the device must wait"
    );
    streaming(&mut link);
    assert!(link.receive(1.0).expect("the port is open").len() > 1000);
    link.close().expect("closes");
    link.open().expect("opens");
    assert_eq!(link.receive(1.0).expect("the port is open"), [0_u8; 0], "each opening begins anew");
}

#[test]
fn a_full_packet_is_followed_by_another() {
    let (mut full, mut closed) = (0, 0);
    // The motions repeat, and each gives only a few batches that end with a full packet. The first that show it are
    // enough.
    for seed in 3..7 {
        let Some((full_here, closed_here)) = full_packets(seed) else { return };
        full += full_here;
        closed += closed_here;
        if full > 100 && closed > 0 {
            return;
        }
    }
    panic!("{full} full packets, {closed} of them closed by an empty one");
}

/// Number of full packets within 20 s of this motion, and how many of them were followed by an empty one.
fn full_packets(seed: u64) -> Option<(usize, usize)> {
    let mut link = board(moving(seed))?;
    link.connect().expect("enumeration");
    let description = link.host.description.as_ref().expect("enumerated");
    let (to_device, to_host) = description.serial_endpoints().expect("a serial port");
    let UsbLink { socket, host, .. } = &mut link;
    set_control_lines(host, socket, true, true).expect("taken");
    let mut talk = Talk::default();
    for command in [Command::Hello, Command::Streams(Streams::ALL)] {
        let (_, bytes) = talk.request(command);
        host.write(socket, to_device, &bytes, 1.0).1.expect("taken");
    }
    // One packet per transfer, with its time of arrival.
    let (mut packets, end_s) = (Vec::new(), socket.time_s() + 20.0);
    while socket.time_s() < end_s {
        match host.read(socket, to_host, 64, 0.1) {
            Ok(packet) => {
                talk.take(&packet);
                packets.push((socket.time_s(), packet.len()));
            }
            Err(UsbError::Late) => {}
            Err(error) => panic!("{error}"),
        }
    }
    let (mut full, mut closed) = (0, 0);
    for pair in packets.windows(2) {
        let [(at_s, length), (next_s, next)] = *pair else { unreachable!("windows of two") };
        if length == 64 {
            full += 1;
            closed += usize::from(next == 0);
            assert!(next_s - at_s < 2e-3, "after a full packet nothing for {} s", next_s - at_s);
        }
    }
    assert_eq!((talk.lost, talk.counts().corrupt()), (0, 0));
    Some((full, closed))
}

#[test]
fn a_suspended_device_sleeps_and_goes_on() {
    let Some(mut link) = opened(Still) else { return };
    hello(&mut link);
    done(&mut link, Command::Streams(Streams { samples: true, ..Streams::NONE }));
    for seconds in [0.0, 5.0] {
        link.listen(0.3).expect("the port is open");
        link.host.suspend(&mut link.socket).expect("runs");
        assert!(link.socket.usb().sleeps());
        link.socket.run_for(seconds).expect("runs");
        link.host.resume(&mut link.socket).expect("wakes");
        assert!(!link.socket.usb().sleeps());
        assert_eq!(link.receive(0.2).expect("the port is open").len(), 0, "mute until the host speaks again");
        hello(&mut link);
        done(&mut link, Command::Streams(Streams { samples: true, ..Streams::NONE }));
    }
    has_run_through(&mut link);
}

/// Resets the bus and opens the port again.
fn begin_anew(link: &mut UsbLink<Machine>) {
    link.host.reset(&mut link.socket).expect("attached");
    link.host.enumerate(&mut link.socket).expect("enumeration");
    link.open().expect("opens");
}

#[test]
fn a_reset_of_the_bus_takes_the_device_back_to_its_beginning() {
    let Some(mut link) = opened(Still) else { return };
    streaming(&mut link);
    for listen_s in [0.0, 0.0101, 0.2] {
        link.listen(listen_s).expect("the port is open");
        begin_anew(&mut link);
        assert_eq!(link.receive(0.1).expect("the port is open"), [0_u8; 0]);
        streaming(&mut link);
    }
    // A suspended device too.
    link.host.suspend(&mut link.socket).expect("runs");
    begin_anew(&mut link);
    has_run_through(&mut link);
}

#[test]
fn a_cable_pulled_out_at_any_moment_can_be_put_back() {
    let Some(mut link) = board(Still) else { return };
    let mut random = Random(11);
    for _ in 0..25 {
        link.plug_in().expect("enumeration");
        streaming(&mut link);
        // With a request and the stream in progress, at any moment between two packets.
        let (_, bytes) = link.talk.request(Command::ReadSettings);
        let description = link.host.description.as_ref().expect("enumerated");
        let to_device = description.serial_endpoints().expect("a serial port").0;
        link.host.submit(Transfer::Out(to_device, bytes, false));
        for _ in 0..random.below(400) {
            link.host.service(&mut link.socket).expect("the device goes on");
        }
        link.unplug();
        link.socket.run_for(random.below(300) as f64 * 1e-3).expect("runs");
    }
    link.plug_in().expect("enumeration");
    has_run_through(&mut link);
}

#[test]
fn an_enumeration_cut_short_can_be_done_again() {
    let Some(mut link) = board(Still) else { return };
    let descriptor = |kind: u16, length| Setup { kind: 0x80, request: 6, value: kind << 8, index: 0, length };
    for packets in 0..40 {
        link.host.plug(&mut link.socket).expect("attached");
        for reset in [true, false] {
            link.host.submit(Transfer::Control(descriptor(1, 18), vec![]));
            link.host.submit(Transfer::Control(descriptor(2, 255), vec![]));
            link.host.submit(Transfer::Control(Setup { kind: 0, request: 5, value: 3, index: 0, length: 0 }, vec![]));
            for _ in 0..packets {
                link.host.service(&mut link.socket).expect("the device goes on");
            }
            if reset {
                link.host.reset(&mut link.socket).expect("attached");
            } else {
                link.unplug();
            }
        }
    }
    link.plug_in().expect("enumeration");
    hello(&mut link);
}

#[test]
fn a_host_that_stops_reading_costs_frames_and_nothing_else() {
    let Some(mut link) = opened(Still) else { return };
    hello(&mut link);
    let before = health(&mut link).dropped_frames;
    done(&mut link, Command::Streams(Streams::ALL));
    link.listen(0.5).expect("the port is open");
    // The host's program hangs: its driver's buffers fill up, then the endpoint.
    link.socket.run_for(6.0).expect("runs");
    link.listen(0.5).expect("the port is open");
    let lost = link.talk.lost;
    let missing: u32 = samples_missing(&link.talk.records());
    assert!(lost > 100, "only {lost} frames lost in six seconds");
    assert!(missing > 1000, "samples in the lost frames: {missing}");
    let after = health(&mut link).dropped_frames;
    assert!(u64::from(after - before) >= lost, "{lost} frames lost, {before} to {after} counted by the device");
    has_run_through(&mut link);
}

/// Samples missing between those received.
fn samples_missing(records: &[Record]) -> u32 {
    let mut last = None;
    let mut missing = 0;
    for record in records {
        let Record::Samples(samples) = record else { continue };
        for sample in samples.iter() {
            let sample = sample.expect("sound samples");
            missing += last.map_or(0, |last: u32| sample.index.wrapping_sub(last).wrapping_sub(1));
            last = Some(sample.index);
        }
    }
    missing
}

#[test]
fn noise_is_counted_and_obeyed_by_nobody() {
    let Some(mut link) = opened(Still) else { return };
    let before = settings(&mut link);
    let mut random = Random(23);
    for _ in 0..400 {
        let bytes = random.bytes(150);
        let count = 1 + random.below(150);
        assert_eq!(link.send(&bytes[..count], 1.0), Ok(count), "the device takes whatever comes");
    }
    link.send(&[0], 1.0).expect("taken");
    assert_eq!(settings(&mut link), before);
    assert!(health(&mut link).bad_frames > 50);
    has_run_through(&mut link);
}

#[test]
fn the_corpus_leads_to_the_same_replies_as_on_the_host() {
    // Check before starting the threads: they do not have the test's name, which the skip message needs.
    if shipping_image().is_none() {
        return;
    }
    let corpus = corpus();
    assert!(corpus.len() > 20, "only {} streams", corpus.len());
    std::thread::scope(|scope| {
        for part in corpus.chunks(corpus.len().div_ceil(4)) {
            scope.spawn(|| part.iter().for_each(leads_to_its_replies));
        }
    });
}

/// A new device receives the stream and must give the bad frames and replies listed in the corpus.
fn leads_to_its_replies(item: &Item) {
    let Some(mut link) = opened(Still) else { return };
    let mut replies = String::new();
    let mut hear = |link: &mut UsbLink<Machine>, for_s| {
        let heard = link.listen(for_s).is_ok();
        let before = replies.len();
        for record in link.talk.records() {
            if let Record::Reply(Reply { id, result }) = record {
                replies += &format!("{id} {}\n", outcome(&result));
            }
        }
        heard && replies.len() > before
    };
    for portion in item.portions(64) {
        // A device that restarts disconnects.
        if link.send(portion, 5.0).is_err() {
            break;
        }
        hear(&mut link, 0.0);
    }
    while hear(&mut link, 0.7) {}
    let (bad_frames, expected) = item.expected.split_once('\n').expect("two parts");
    assert_eq!(replies, expected, "{}: {} frames lost", item.name, link.talk.lost);
    if !item.restarts() {
        link.close().expect("closes");
        link.open().expect("opens");
        hello(&mut link);
        assert_eq!(format!("bad_frames {}", health(&mut link).bad_frames), bad_frames, "{}", item.name);
    }
}

#[test]
fn a_terminal_that_echoes_changes_nothing() {
    let Some(mut link) = opened(Still) else { return };
    let before = settings(&mut link);
    done(&mut link, Command::Streams(Streams::ALL));
    let mut echoed = 0;
    for _ in 0..500 {
        let bytes = link.receive(0.01).expect("the port is open");
        link.talk.take(&bytes);
        echoed += bytes.len();
        assert_eq!(link.send(&bytes, 1.0), Ok(bytes.len()));
    }
    assert!(echoed > 5000, "only {echoed} bytes");
    let strangers: Vec<Record> = link
        .talk
        .records()
        .into_iter()
        .filter(|record| {
            let changed = |kind: &EventKind| matches!(kind, EventKind::SettingsChanged | EventKind::EstimatorReset);
            matches!(record, Record::Reply(_) | Record::Hello(_) | Record::Settings(_))
                || matches!(record, Record::Event(Event { kind, .. }) if changed(kind))
        })
        .collect();
    assert_eq!(strangers, [], "the device obeyed what it had said itself");
    assert_eq!(settings(&mut link), before);
    has_run_through(&mut link);
}

#[test]
fn a_port_opened_again_finds_no_end_of_the_conversation_before() {
    let Some(mut link) = board(Still) else { return };
    link.connect().expect("enumeration");
    // With a packet in transit, and with one that a full terminal did not fetch.
    for (closed_s, full) in [(0.0, false), (0.0, true), (0.001, false), (0.001, true), (0.05, true), (2.0, true)] {
        link.open().expect("opens");
        streaming(&mut link);
        link.listen(0.25).expect("the port is open");
        if full {
            link.stop_reading();
            link.socket.run_for(0.2).expect("runs");
        }
        link.close().expect("closes");
        link.socket.run_for(closed_s).expect("runs");
        link.open().expect("opens");
        assert_eq!(link.receive(0.3).expect("the port is open"), [0_u8; 0], "closed for {closed_s} s");
        // The first data received is the answer.
        let (id, bytes) = link.talk.request(Command::Hello);
        link.send(&bytes, 1.0).expect("taken");
        link.listen(0.1).expect("the port is open");
        assert_eq!(link.talk.counts().corrupt(), 0, "closed for {closed_s} s");
        assert!(link.talk.reply(id).is_some());
        link.close().expect("closes");
    }
}

#[test]
fn the_serial_link_lives_while_usb_is_closed() {
    let Some(mut link) = board(Still) else { return };
    let mut uart = common::SerialLink::default();
    assert!(uart.hello(&mut link.socket), "nothing plugged in");
    link.connect().expect("enumeration");
    assert!(uart.hello(&mut link.socket), "plugged in, closed");
    link.open().expect("opens");
    hello(&mut link);
    assert!(!uart.hello(&mut link.socket), "USB is open: it alone is served");
    hello(&mut link);
    link.close().expect("closes");
    assert!(uart.hello(&mut link.socket), "closed again");
    link.open().expect("opens");
    hello(&mut link);
    link.host.suspend(&mut link.socket).expect("runs");
    assert!(uart.hello(&mut link.socket), "suspended");
    link.host.resume(&mut link.socket).expect("wakes");
    hello(&mut link);
    link.unplug();
    link.socket.run_for(0.3).expect("runs");
    assert!(uart.hello(&mut link.socket), "pulled out");
}

#[test]
fn settings_written_over_usb_hold() {
    let Some(mut link) = opened(Still) else { return };
    let before = settings(&mut link);
    let wanted = Settings { memory_s: before.memory_s * 2.0, ..before };
    done(&mut link, Command::WriteSettings(SettingsValues::difference(&wanted, &before)));
    assert_eq!(settings(&mut link), wanted);
    link.unplug();
    link.plug_in().expect("enumeration");
    hello(&mut link);
    assert_eq!(settings(&mut link), wanted, "plugged in again");
}

/// From a reset until the firmware has a port again, also after the watchdog's four seconds \[s\].
const BACK_S: f64 = 6.0;

/// Saves alternating settings until the device refuses. Returns the number of saves accepted and the time to wait
/// \[s\].
fn flood(link: &mut UsbLink<Machine>) -> (u32, u16) {
    let before = settings(link);
    for taken in 0..=2 * u32::from(SAVES) {
        let wanted = Settings { memory_s: 10.0 + f64::from(taken % 2), ..before };
        done(link, Command::WriteSettings(SettingsValues::difference(&wanted, &before)));
        match link.request(Command::SaveSettings, 2.0).expect("a reply").result {
            Ok(Done::Plain) => {}
            Err(Refusal::Worn { wait_s }) => return (taken, wait_s),
            other => panic!("save {taken}: {other:?}"),
        }
    }
    panic!("a flood is not refused");
}

/// Runs `go`, which restarts or disconnects the device, and connects to it again.
fn after(link: &mut UsbLink<Machine>, go: impl FnOnce(&mut UsbLink<Machine>)) {
    go(link);
    link.unplug();
    link.socket.run_for(BACK_S).unwrap_or_else(|ended| panic!("{ended}"));
    link.plug_in().expect("enumeration");
}

/// A host can restart the device by command as often as it likes, so a restart must not renew the saves.
#[test]
fn a_flood_of_saves_is_refused_and_no_restart_that_a_host_orders_helps() {
    let all = u32::from(SAVES);
    let Some(mut link) = opened(Still) else { return };
    let (taken, wait_s) = flood(&mut link);
    assert!((all..all + 2).contains(&taken) && (60..=120).contains(&wait_s), "{taken} saves, {wait_s} s to wait");
    let kept = link.socket.chip().flash.contents();
    for (command, cause) in [
        (Command::Reboot, Reset::Software),
        (Command::Reboot, Reset::Software),
        (Command::Measure(Measure::Hang), Reset::Watchdog),
    ] {
        after(&mut link, |link| {
            // The device may disconnect before it replies.
            let _ = link.request(command.clone(), 0.2);
        });
        assert_eq!(last_reset(&link.socket), cause, "{command:?}");
        let (taken, wait_s) = flood(&mut link);
        assert!(taken == 0 && (100..=120).contains(&wait_s), "{command:?}: {taken} saves, {wait_s} s to wait");
    }
    assert!(link.socket.chip().flash.contents() == kept, "nothing was written meanwhile");
    // One more save every two minutes, also in a run that began with none.
    done(&mut link, Command::Stop);
    let (_, wait_s) = flood(&mut link);
    link.listen(f64::from(wait_s)).expect("the port is open");
    let (taken, wait_s) = flood(&mut link);
    assert!(taken == 1 && wait_s > 100, "{taken} saves, {wait_s} s to wait");
}

/// Power-on, the button and a probe's reset renew all saves: nobody does those by the hundred.
#[test]
fn other_starts_begin_with_all_saves() {
    let Some(mut link) = opened(Still) else { return };
    let all = u32::from(SAVES);
    type Start = fn(&mut Machine);
    let starts: [(&str, Start); 3] = [
        ("power", |machine| machine.power_cut().expect("starts")),
        ("button", |machine| machine.reset().expect("starts")),
        ("probe", |machine| machine.reset_by(Reset::Software).expect("starts")),
    ];
    for (name, start) in starts {
        let (taken, _) = flood(&mut link);
        assert!((all..all + 2).contains(&taken), "before {name}: {taken} saves");
        after(&mut link, |link| {
            link.unplug();
            start(&mut link.socket);
        });
    }
    let (taken, _) = flood(&mut link);
    assert!((all..all + 2).contains(&taken), "{taken} saves");
}
