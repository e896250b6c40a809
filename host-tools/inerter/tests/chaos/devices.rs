//! Every command with every kind of misbehaving device.

use std::{
    collections::BTreeMap,
    io::Write,
    os::unix::process::ExitStatusExt,
    process::ExitStatus,
    sync::{
        Mutex,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use inerter_core::Settings;
use inerter_wire::{Command, Done, FrameReader, Record, Reply, Request, SettingsValues};
use rustix::process::{Pid, Signal, kill_process};

use crate::{
    common::{
        firmware::{framed, payload},
        unruly::{COMMANDS, MANNERS, Manner, Unruly, Visit, hello, prepared, requests},
    },
    scenario::{AT_ONCE, MOST_KB, Scenario, each},
};

/// Time to end after a signal or after the device disconnects.
const END_TIME: Duration = Duration::from_secs(5);
/// A program that still runs after this further time hangs.
const HANG_TIME: Duration = Duration::from_secs(60);

/// The worst values seen, and where.
#[derive(Default)]
struct Worst(Mutex<BTreeMap<&'static str, (u64, String)>>);

impl Worst {
    fn see(&self, of: &'static str, value: u64, what: &str) {
        let mut all = self.0.lock().unwrap();
        let worst = all.entry(of).or_default();
        if value > worst.0 {
            *worst = (value, what.into());
        }
    }

    fn words(self) -> String {
        let all = self.0.into_inner().unwrap();
        let words: Vec<String> = all.iter().map(|(of, (value, what))| format!("{of} {value} ({what})")).collect();
        words.join(", ")
    }
}

/// The signal ends these commands without a handler.
fn has_no_handler(command: &[&str]) -> bool {
    ["settings", "doctor"].contains(&command[0])
}

/// Each pair runs twice: once a signal arrives, once the device disconnects. The command must then end with one of our
/// exit codes, with little memory, and without printing any control sequence of the device.
#[test]
#[ignore = "cargo xtask chaos"]
fn unruly() {
    let scenario = Scenario::start(2400);
    let mut pairs: Vec<_> =
        MANNERS.iter().flat_map(|manner| COMMANDS.iter().map(move |command| (*manner, *command))).collect();
    let mut random = scenario.random("order");
    for place in (1..pairs.len()).rev() {
        pairs.swap(place, random.below(place + 1));
    }
    let visits: Vec<_> =
        pairs.into_iter().flat_map(|(manner, command)| [(manner, command, false), (manner, command, true)]).collect();
    let (seen, late, faults) = (Seen::default(), Mutex::new(Vec::new()), Mutex::new(Vec::new()));
    each(&visits, AT_ONCE, |visit| match meet(&scenario, *visit, &seen) {
        Ok(()) => {}
        Err(wrong) if wrong.is_only_late => late.lock().unwrap().push(*visit),
        Err(wrong) => faults.lock().unwrap().push(wrong.words),
    });
    // A busy machine may starve a program: one that was late, and nothing else, gets a second visit without other load.
    // All other faults count at once.
    let (late, mut faults) = (late.into_inner().unwrap(), faults.into_inner().unwrap());
    faults.extend(late.iter().filter_map(|visit| meet(&scenario, *visit, &seen).err()).map(|wrong| wrong.words));
    assert!(faults.is_empty(), "{} faults:\n{}", faults.len(), faults.join("\n"));
    scenario.passed(&format!(
        "{} behaviours x {} commands; {} runs ended by themselves, {} were late and repeated; maxima: {}",
        MANNERS.len(),
        COMMANDS.len(),
        seen.by_itself.into_inner(),
        late.len(),
        seen.worst.words()
    ));
}

/// Results over all visits.
#[derive(Default)]
struct Seen {
    worst: Worst,
    by_itself: AtomicUsize,
}

/// What was wrong with a visit.
struct Wrong {
    words: String,
    /// The program was slow, and nothing else was wrong.
    is_only_late: bool,
}

/// One command with one device, which then disconnects, or else a signal arrives.
fn meet(
    scenario: &Scenario,
    (manner, command, goes): (Manner, &'static [&'static str], bool),
    seen: &Seen,
) -> Result<(), Wrong> {
    let folder = prepared();
    let what = format!("{} at {manner:?}", command.join(" "));
    let mut random = scenario.random(&format!("{what}, {goes}"));
    let device = Unruly::start(manner, scenario.seed);
    // Waiting for a device to return is not a hang.
    let at_once = |word: &&'static str| if goes && *word == "60" && command.contains(&"--wait") { "0" } else { *word };
    let command: Vec<&str> = command.iter().map(at_once).collect();
    let mut visit = Visit::start(folder.path(), &command, &device.address);
    let started = Instant::now();
    while device.guests() == 0 && started.elapsed() < Duration::from_secs(30) && visit.goes_on(Duration::ZERO) {
        thread::sleep(Duration::from_millis(2));
    }
    let is_running = visit.goes_on(Duration::from_millis(random.below(1500)));
    let (mut within, mut sent) = (END_TIME, None);
    let how = match (is_running, goes) {
        (false, _) => "by itself",
        (true, true) => {
            device.go();
            // Without `--wait`, `monitor` waits 10 s.
            if command.contains(&"monitor") && !command.contains(&"--wait") {
                within += Duration::from_secs(10);
            }
            // The self-test waits 25 s for a board that it has restarted.
            if command.contains(&"selftest") {
                within += Duration::from_secs(30);
            }
            "after the device went"
        }
        (true, false) => {
            let signal = [Signal::TERM, Signal::INT, Signal::HUP][random.below(3)];
            let signal = if has_no_handler(&command) { Signal::TERM } else { signal };
            kill_process(Pid::from_child(&visit.child), signal).unwrap();
            sent = Some(signal);
            "after a signal"
        }
    };
    // One that has not reached its device yet may have no handler yet.
    let by_system = has_no_handler(&command) || device.guests() == 0;
    let told = Instant::now();
    let is_late = visit.goes_on(within);
    let status = visit.ended(if is_late { HANG_TIME } else { Duration::ZERO });
    let took_ms = told.elapsed().as_millis() as u64;
    let (most_kb, foreign) = visit.end();
    // The device may notice its guest only now.
    while device.guests() == 0 && !is_running && told.elapsed() < END_TIME {
        thread::sleep(Duration::from_millis(2));
    }
    let ended_well = |status: ExitStatus| match status.code() {
        Some(code) => matches!(code, 0..=10 | 130),
        None => by_system && sent.is_some_and(|sent| status.signal() == Some(sent.as_raw())),
    };
    let (mut late, mut faults) = (Vec::new(), Vec::new());
    match status {
        None => faults.push("hangs".to_string()),
        Some(status) if !ended_well(status) => faults.push(status.to_string()),
        Some(_) if is_late => late.push("ended late".to_string()),
        Some(_) => {}
    }
    if most_kb > MOST_KB {
        faults.push(format!("{most_kb} kB"));
    }
    faults.extend(foreign.map(|foreign| format!("said {foreign:?}")));
    if device.guests() == 0 {
        // One that has ended by itself was not late.
        let to = if is_running { &mut late } else { &mut faults };
        to.push("never came".to_string());
    }
    let is_only_late = faults.is_empty();
    faults.extend(late);
    if !faults.is_empty() {
        return Err(Wrong { words: format!("{what} {how}: {}", faults.join(", ")), is_only_late });
    }
    seen.by_itself.fetch_add(usize::from(!is_running), Ordering::Relaxed);
    seen.worst.see("memory in kB", most_kb, &what);
    match how {
        "after a signal" => seen.worst.see("ms to end after a signal", took_ms, &what),
        "after the device went" => seen.worst.see("ms to end after the device disconnected", took_ms, &what),
        _ => {}
    }
    Ok(())
}

/// Memory does not grow with the amount of data that a device sends.
#[test]
#[ignore = "cargo xtask chaos"]
fn floods() {
    let scenario = Scenario::start(600);
    let floods = [
        Manner::Noise,
        Manner::Samples,
        Manner::Introduced,
        Manner::Repeating,
        Manner::EndlessFrame,
        Manner::ReplyFlood,
        Manner::HelloFlood,
        Manner::RestartFlood,
        Manner::HealthFlood,
        Manner::EventFlood,
        Manner::WarningFlood,
        Manner::UnknownRecords,
        Manner::RandomRecords,
        Manner::Mutated,
        Manner::LongestFrames,
        Manner::IndexCircle,
        Manner::IndexLeaps,
        Manner::EstimatesNan,
    ];
    let commands: [&[&str]; 6] = [
        &["monitor", "--json", "--record", "run.mcap", "--force"],
        &["monitor", "--plain", "--share", "127.0.0.1:0", "--web", "--bind", "127.0.0.1:0"],
        &["record", "-o", "run.mcap", "--force"],
        &["send", "sent.mcap"],
        &["calibrate", "zero", "--duration", "3600"],
        &["calibrate", "timebase", "--duration", "3600"],
    ];
    let pairs: Vec<_> =
        floods.iter().flat_map(|manner| commands.iter().map(move |command| (*manner, *command))).collect();
    let worst = Worst::default();
    each(&pairs, AT_ONCE, |(manner, command)| {
        let (folder, device) = (prepared(), Unruly::start(*manner, scenario.seed));
        let mut visit = Visit::start(folder.path(), command, &device.address);
        let what = format!("{} at {manner:?}", command.join(" "));
        let is_running = visit.goes_on(Duration::from_secs(8));
        if is_running {
            kill_process(Pid::from_child(&visit.child), Signal::TERM).unwrap();
        }
        let status = visit.ended(END_TIME).unwrap_or_else(|| panic!("{what} goes on"));
        assert!(matches!(status.code(), Some(0..=10 | 130)), "{what}: {status}");
        let (most_kb, foreign) = visit.end();
        assert_eq!(foreign, None, "{what}");
        worst.see("memory in kB", most_kb, &what);
        assert!(most_kb < MOST_KB, "{what}: {most_kb} kB");
    });
    scenario.passed(&format!(
        "{} floods x {} commands for 8 s; maximum: {}",
        floods.len(),
        commands.len(),
        worst.words()
    ));
}

/// The connection closes after each possible number of bytes of a conversation.
#[test]
#[ignore = "cargo xtask chaos"]
fn cut_off() {
    let scenario = Scenario::start(900);
    let folder = prepared();
    let commands: [&[&str]; 4] = [
        &["settings", "get"],
        &["settings", "set", "memory_s=12"],
        &["settings", "tare"],
        &["settings", "backup", "k.toml", "--force"],
    ];
    let (runs, longest) = (AtomicU64::new(0), AtomicUsize::new(0));
    for command in commands {
        let (next, complete) = (AtomicUsize::new(0), AtomicUsize::new(0));
        thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    loop {
                        let count = next.fetch_add(1, Ordering::Relaxed);
                        // The whole conversation has taken place.
                        if complete.load(Ordering::Relaxed) > 0 || count > 4000 {
                            break;
                        }
                        let device = Unruly::behaving(move |host, _| {
                            terse(host, count);
                        });
                        let mut visit = Visit::start(folder.path(), command, &device.address);
                        let status = visit.ended(END_TIME);
                        let (most_kb, foreign) = visit.end();
                        let code = status.and_then(|status| status.code());
                        assert!(matches!(code, Some(0..=10)), "{command:?} cut off after {count} bytes: {code:?}");
                        assert_eq!(foreign, None, "{command:?} cut off after {count} bytes");
                        assert!(most_kb < MOST_KB, "{command:?} cut off after {count} bytes: {most_kb} kB");
                        complete.fetch_add(usize::from(code == Some(0)), Ordering::Relaxed);
                        longest.fetch_max(count, Ordering::Relaxed);
                        runs.fetch_add(1, Ordering::Relaxed);
                    }
                });
            }
        });
        assert!(complete.into_inner() > 0, "{command:?} was never done");
    }
    scenario.passed(&format!("{} connections cut off, after 0 to {} bytes", runs.into_inner(), longest.into_inner()));
}

/// Answers everything, and closes the connection after this many bytes.
fn terse(mut host: std::net::TcpStream, mut count: usize) -> Option<()> {
    let (mut reader, mut sequence) = (FrameReader::<Request>::new(), 0);
    loop {
        for Request { id, command } in requests(&mut host, &mut reader)? {
            let content = match command {
                Command::Hello => Some(Record::Hello(hello())),
                Command::ReadSettings => Some(Record::Settings(SettingsValues::from(&Settings::default()))),
                _ => None,
            };
            for record in content.into_iter().chain([Record::Reply(Reply { id, result: Ok(Done::Plain) })]) {
                let bytes = framed(&payload(&record), sequence);
                sequence += 1;
                host.write_all(bytes.get(..count).unwrap_or(&bytes)).ok()?;
                count = count.checked_sub(bytes.len())?;
            }
        }
    }
}
