//! Runs the live programs for hours: a virtual device at 4 kHz with two recordings, the page and all bridges, and two
//! more devices with a recording each: the image in QEMU, and the board's image on the twin at 4 kHz.
//!
//! Nothing may be lost, no process may grow, the samples must agree with the time that was asked for and with the host's
//! clock, and each recording must give identical output in a replay and on a device. `target/soak/progress.tsv` has a
//! line for each measurement of the processes, so a run that was stopped early shows how far it got. The twin runs at
//! the lowest priority and does not catch up the time that it loses, so it may be slower than a board. Its samples are
//! compared with its own counter, and with a clock only to see that it took part.

mod kept;

use self::kept::{Kept, LEAST_H};
use crate::{
    commit::commit,
    firmware::{self, Image},
    monitor_load::{Look, MOST_MISSING, RATE_HZ, Running, SETTLED_S, announced, device, host_s, info, look, simulated},
    process, setup,
    table::{self, Row},
    tree,
    workspace::{self, Part},
};
use anyhow::{Context, Result, bail, ensure};
use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{BufRead, BufReader, Read, Write},
    net::{TcpStream, UdpSocket},
    path::{Path, PathBuf},
    process::{Child, ChildStdout, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
        mpsc::{Sender, channel},
    },
    thread,
    time::{Duration, Instant},
};

/// Samples per second of the image in QEMU.
const QEMU_RATE_HZ: f64 = 1000.0;
/// Allowed growth of a process after the first minute \[%\].
const GROWTH: f64 = 5.0;
/// What the index with which a recording ends may take beside that: a quarter of a kilobyte for each chunk of half a
/// second \[MB/s\].
const INDEX_MB_PER_S: f64 = 5e-4;
/// Allowed difference between the samples and the host's time from the first frame to the last \[s\]. Either of the two
/// may have arrived late: a virtual device that is less than a second late catches up. In between nothing may add up,
/// because the device samples by the same clock.
const APART_S: f64 = 1.0;
/// Allowed difference between the samples of the twin and its own counter, at the rate that was asked for \[s\].
const COUNTED_S: f64 = 0.01;
/// How many times slower than a board the twin may be. If it is slower, it has not taken part.
const SLOWER: f64 = 10.0;
/// The last part of a recording, which is also sent through a device \[s\].
const REPLAYED_S: f64 = 300.0;

/// The programs' standard error.
const WORDS: &str = "words.txt";
/// The measurements of the processes.
const PROGRESS: &str = "progress.tsv";

#[derive(clap::Args)]
pub struct Options {
    /// How long, in hours; 3 minutes by default
    #[arg(long, default_value_t = 0.05)]
    hours: f64,
    /// Leave out the image in QEMU and the board's image on the twin
    #[arg(long)]
    no_images: bool,
    /// Soak in portions, write each into docs/tables/soak.md, and continue until the table has so many hours
    #[arg(long, conflicts_with = "no_images")]
    keep: bool,
}

/// A watched process.
struct Watched {
    name: &'static str,
    process: PathBuf,
    looks: Vec<Look>,
    /// One that must end by itself.
    recorder: Option<Running>,
}

impl Watched {
    fn new(name: &'static str, pid: u32) -> Self {
        Self { name, process: PathBuf::from(format!("/proc/{pid}")), looks: Vec::new(), recorder: None }
    }

    fn recorder(name: &'static str, recorder: Running) -> Self {
        let watched = Self::new(name, recorder.0.id());
        Self { recorder: Some(recorder), ..watched }
    }
}

/// The simulator of the image; it stops its QEMU when it is told to terminate.
struct Simulator(Running);

impl Drop for Simulator {
    fn drop(&mut self) {
        // It may have ended already; one that ignores the signal is killed a moment later.
        let _ = Command::new("kill").arg(self.0.0.id().to_string()).status();
        let asked = Instant::now();
        while matches!(self.0.0.try_wait(), Ok(None)) && asked.elapsed() < Duration::from_secs(5) {
            thread::sleep(Duration::from_millis(20));
        }
    }
}

/// What was asked of a recording.
#[derive(Clone, Copy)]
struct Asked {
    rate_hz: f64,
    seconds: f64,
    /// Whether the device samples by a clock, or may be slower.
    keeps_time: bool,
}

/// Counted by other threads.
type Count = Arc<AtomicU64>;

/// What the views received.
#[derive(Clone, Default)]
struct Seen {
    page: Count,
    foxglove: Count,
    datagrams: Count,
    lines: Count,
    /// Lines that report a loss.
    losses: Count,
}

pub fn run(options: &Options) -> Result<()> {
    ensure!(cfg!(target_os = "linux"), "this reads /proc: it runs on Linux only");
    ensure!(
        options.hours >= LEAST_H,
        "--hours {}: at least {LEAST_H}, because shorter runs do not settle",
        options.hours
    );
    if !options.keep {
        return portion(options).map(drop);
    }
    let mut kept = Kept::read()?;
    while let Some(hours) = kept.next_h(options.hours) {
        kept.add(&commit(), hours, &portion(&Options { hours, ..*options })?)?;
    }
    Ok(())
}

/// One run of everything; returns its figures if all goals are met.
fn portion(options: &Options) -> Result<Vec<Row>> {
    let images = if options.no_images { None } else { Some(Images::build()?) };
    let program = workspace::installed()?;
    let folder = workspace::folder("soak")?;
    // Each run starts a new one.
    tree::write(folder.join(WORDS), "")?;
    let rows = soak(&program, images.as_ref(), &folder, options.hours * 3600.0)?;
    for row in &rows {
        let goal = row.goal.map(|goal| format!("at most {goal}")).unwrap_or_default();
        println!("  {:<52} {:>14.3} {:<3} {goal}", row.name, row.value, row.unit);
    }
    if options.no_images {
        println!("  left out by --no-images: the image in QEMU, and the board's image on the twin");
    }
    let missed = table::missed(&rows);
    ensure!(missed.is_empty(), "goals missed: {missed}; the measurements are in {}", folder.join(PROGRESS).display());
    Ok(rows)
}

/// The firmware, and what runs it.
struct Images {
    qemu: PathBuf,
    board: PathBuf,
    twin: PathBuf,
}

impl Images {
    fn build() -> Result<Self> {
        let systems = [&setup::ARM_QEMU, &setup::TWIN, &setup::CXX].map(setup::Need::System);
        setup::ensure(&[&[setup::Need::Firmware], &systems[..]].concat(), false)?;
        Ok(Self {
            qemu: firmware::build(Image::QEMU)?,
            board: firmware::build(Image::BOARD)?,
            twin: workspace::tested(Part::Twin, "inerter-twin-serve")?,
        })
    }
}

/// The board's image on the twin, and its address.
fn twin(images: &Images) -> Result<(Running, String)> {
    let mut command = Command::new("nice");
    command.args(["-n", "19"]).arg(&images.twin).args(["tcp", &RATE_HZ.to_string()]).arg(&images.board);
    announced(&mut command)
}

fn soak(program: &Path, images: Option<&Images>, folder: &Path, seconds: f64) -> Result<Vec<Row>> {
    let started = Instant::now();
    let (device, address) = device(program)?;
    let mut watched = vec![Watched::new("virtual device", device.0.id())];

    let seen = Seen::default();
    let (teleplot, plotjuggler) = (datagrams(&seen)?, datagrams(&seen)?);
    let record = ["monitor", "--json", "--connect", &address, "--record", "monitor.mcap"];
    let serve = ["--web", "--bind", "127.0.0.1:0", "--share", "127.0.0.1:0", "--foxglove", "127.0.0.1:0"];
    let send = ["--teleplot", &teleplot, "--plotjuggler", &plotjuggler];
    let mut monitor = start(program, folder, seconds, &[&record[..], &serve, &send].concat())?;
    let output = monitor.0.stdout.take().context("no pipe to the monitor")?;
    watched.push(Watched::recorder("monitor", monitor));
    let (sender, views) = channel();
    let counted = seen.clone();
    thread::spawn(move || listen(output, &sender, &counted));
    let mut places = BTreeMap::new();
    while ["page", "shared device", "Foxglove"].into_iter().any(|view| !places.contains_key(view)) {
        let (view, place) =
            views.recv_timeout(Duration::from_secs(20)).context("the monitor does not print where its views are")?;
        places.insert(view, place);
    }
    look_on(&format!("{}live", places["page"]), "", &[], &seen.page)?;
    look_on(&places["Foxglove"], "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n", &subscriptions(), &seen.foxglove)?;

    // The other programs start later and end earlier.
    let record = ["record", "-o", "beside.mcap", "--connect", &places["shared device"]];
    watched.push(Watched::recorder("recorder beside", start(program, folder, seconds - 10.0, &record)?));

    let asked = |rate_hz, seconds| Asked { rate_hz, seconds, keeps_time: true };
    let mut recordings =
        vec![("monitor.mcap", asked(RATE_HZ, seconds)), ("beside.mcap", asked(RATE_HZ, seconds - 10.0))];
    let mut devices = None;
    if let Some(images) = images {
        let (simulator, address) = simulated(program, &["--qemu", "--image", &images.qemu.to_string_lossy()])?;
        let pid = simulator.0.id();
        let simulator = Simulator(simulator);
        watched.push(Watched::new("simulator of the image", pid));
        watched.push(Watched::new("QEMU", child_of(pid).context("no QEMU process below its simulator")?));
        let (twin, twins_address) = twin(images)?;
        watched.push(Watched::new("twin", twin.0.id()));
        let rest_s = (seconds - started.elapsed().as_secs_f64()).max(5.0);
        for (name, file, address, asked) in [
            ("recorder of the image", "qemu.mcap", &address, asked(QEMU_RATE_HZ, rest_s)),
            (
                "recorder of the twin",
                "twin.mcap",
                &twins_address,
                Asked { keeps_time: false, ..asked(RATE_HZ, rest_s) },
            ),
        ] {
            recordings.push((file, asked));
            let record = ["record", "-o", file, "--connect", address];
            watched.push(Watched::recorder(name, start(program, folder, rest_s, &record)?));
        }
        devices = Some((simulator, twin));
    }
    watch(&mut watched, &seen, folder, started, seconds)?;
    drop(devices);

    let mut rows: Vec<Row> = watched.iter().flat_map(memory).collect();
    let count = |name: &str, count: &AtomicU64| Row::new(name, count.load(Relaxed) as f64, "");
    rows.extend([
        count("lines of the monitor", &seen.lines),
        count("lines of the monitor that report a loss", &seen.losses).at_most(0.0),
        count("bytes that the page was sent", &seen.page),
        count("bytes that Foxglove was sent", &seen.foxglove),
        count("datagrams to Teleplot and PlotJuggler", &seen.datagrams),
    ]);
    for views in [&seen.page, &seen.datagrams, &seen.lines] {
        ensure!(views.load(Relaxed) > 0, "one of the views received nothing");
    }
    // Its channel list is only a few kB; each sample is a message.
    let sent = seen.foxglove.load(Relaxed) as f64;
    ensure!(sent > RATE_HZ * seconds, "Foxglove was sent only {sent} bytes");
    for (name, asked) in recordings {
        let info = info(program, folder, name)?;
        rows.extend(recorded(&info, name)?);
        rows.extend(in_time(&info, name, asked)?);
        rows.push(replayed(program, folder, name, &info, &address)?);
    }
    Ok(rows)
}

/// Starts our program with these arguments, for so long.
fn start(program: &Path, folder: &Path, seconds: f64, arguments: &[&str]) -> Result<Running> {
    let path = folder.join(WORDS);
    let words = File::options().create(true).append(true).open(&path);
    let words = words.with_context(|| format!("cannot write {}", path.display()))?;
    let mut command = Command::new(program);
    command.args(arguments).args(["--force", "--duration", &seconds.to_string()]);
    command.current_dir(folder).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(words);
    process::spawn(&mut command).map(Running)
}

/// The first child of a process.
fn child_of(pid: u32) -> Option<u32> {
    fs::read_to_string(format!("/proc/{pid}/task/{pid}/children")).ok()?.split_whitespace().next()?.parse().ok()
}

/// Counts lines until the end; passes on the addresses of the views.
fn listen(output: ChildStdout, views: &Sender<(String, String)>, seen: &Seen) {
    for line in BufReader::new(output).lines().map_while(Result::ok) {
        seen.lines.fetch_add(1, Relaxed);
        let Ok(line) = serde_json::from_str::<Value>(&line) else { continue };
        match (line["kind"].as_str(), line["view"].as_str(), line["address"].as_str()) {
            (Some("view"), Some(view), Some(address)) => {
                // Fails if nobody waits for it any more.
                let _ = views.send((view.to_owned(), address.to_owned()));
            }
            (Some("link"), ..) => {
                seen.losses.fetch_add(1, Relaxed);
            }
            _ => {}
        }
    }
}

/// An address whose datagrams are counted.
fn datagrams(seen: &Seen) -> Result<String> {
    let socket = UdpSocket::bind("127.0.0.1:0").context("no UDP port")?;
    let address = socket.local_addr().context("no UDP port")?.to_string();
    let count = seen.datagrams.clone();
    thread::spawn(move || {
        let mut some = [0; 65536];
        while socket.recv(&mut some).is_ok() {
            count.fetch_add(1, Relaxed);
        }
    });
    Ok(address)
}

/// Opens a view's WebSocket, as a browser does, sends this message, and counts what arrives.
fn look_on(url: &str, header: &str, message: &[u8], count: &Count) -> Result<()> {
    let (_, place) = url.split_once("://").with_context(|| format!("no address of a view: {url}"))?;
    let (host, path) = place.split_once('/').unwrap_or((place, ""));
    let mut stream = TcpStream::connect(host).with_context(|| format!("the view at {url} cannot be reached"))?;
    write!(
        stream,
        "GET /{path} HTTP/1.1\r\nHost: {host}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n{header}\r\n"
    )?;
    let mut head = [0; 12];
    stream.read_exact(&mut head)?;
    ensure!(head.ends_with(b"101"), "the view at {url} refuses: {}", String::from_utf8_lossy(&head));
    stream.write_all(message)?;
    let count = count.clone();
    thread::spawn(move || {
        let mut some = [0; 65536];
        while let Ok(length @ 1..) = stream.read(&mut some) {
            count.fetch_add(length as u64, Relaxed);
        }
    });
    Ok(())
}

/// A WebSocket frame that subscribes to more channels of Foxglove's server than there are.
fn subscriptions() -> Vec<u8> {
    let all: Vec<Value> = (0..16).map(|channel| json!({ "id": channel, "channelId": channel })).collect();
    let text = json!({ "op": "subscribe", "subscriptions": all }).to_string();
    // A final text fragment; a length of two bytes follows; the mask is zero and changes nothing.
    let length = (text.len() as u16).to_be_bytes();
    [&[0x81, 0x80 | 126], &length[..], &[0; 4], text.as_bytes()].concat()
}

/// Measures all processes until the recorders are done, and logs each measurement.
fn watch(watched: &mut [Watched], seen: &Seen, folder: &Path, started: Instant, seconds: f64) -> Result<()> {
    let path = folder.join(PROGRESS);
    let mut progress = File::create(&path).with_context(|| format!("cannot write {}", path.display()))?;
    let names: Vec<&str> = watched.iter().map(|watched| watched.name).collect();
    writeln!(progress, "seconds\tlines\tlosses\t{}", names.join(" [MB]\t") + " [MB]")?;
    println!("soaking for {seconds:.0} s; each look goes to {}", path.display());
    let every = Duration::from_secs_f64((seconds / 100.0).clamp(1.0, 60.0));
    let mut are_open = true;
    while are_open {
        thread::sleep(every);
        let mut line = format!("{:.0}", started.elapsed().as_secs_f64());
        for count in [&seen.lines, &seen.losses] {
            line += &format!("\t{}", count.load(Relaxed));
        }
        for watched in &mut *watched {
            let found = look(&watched.process, started);
            line += &found.map_or("\t-".to_owned(), |look| format!("\t{:.2}", look.memory_mb));
            watched.looks.extend(found);
        }
        writeln!(progress, "{line}")?;
        are_open = false;
        for Watched { name, recorder, .. } in &mut *watched {
            if let Some(running) = recorder {
                are_open |= !has_ended(name, &mut running.0)?;
            }
        }
        ensure!(
            started.elapsed().as_secs_f64() <= seconds + 120.0,
            "some of the programs were still running two minutes after they should have ended"
        );
    }
    Ok(())
}

fn has_ended(name: &str, child: &mut Child) -> Result<bool> {
    match child.try_wait().with_context(|| format!("waiting for the {name}"))? {
        None => Ok(false),
        Some(status) if status.success() => Ok(true),
        Some(status) => bail!("the {name} failed ({status}); its output is in target/soak/{WORDS}"),
    }
}

/// Memory of a process, and its growth since the first minute: the peak in the second half of that time compared with
/// the peak in the first half, because a search for causes briefly allocates much memory every few seconds. What the
/// index of its recording may take is no growth.
fn memory(watched: &Watched) -> Vec<Row> {
    let looks = &watched.looks;
    let last_s = looks.last().map_or(0.0, |look| look.at_s);
    let settled_s = SETTLED_S.min(last_s / 2.0);
    let middle_s = (settled_s + last_s) / 2.0;
    let most = |from_s: f64, to_s: f64| {
        let there = looks.iter().filter(|look| (from_s..=to_s).contains(&look.at_s));
        there.map(|look| look.memory_mb).reduce(f64::max).unwrap_or(f64::NAN)
    };
    let index_mb = watched.recorder.as_ref().map_or(0.0, |_| INDEX_MB_PER_S * (last_s - middle_s));
    let grown = (most(middle_s, last_s) / (most(settled_s, middle_s) + index_mb) - 1.0) * 100.0;
    vec![
        Row::new(format!("{}: memory, maximum", watched.name), most(0.0, last_s), "MB"),
        Row::new(format!("{}: grown after the first minute", watched.name), grown, "%").at_most(GROWTH),
    ]
}

/// A figure of a recording in the output of `inerter info`.
fn figure(info: &Value, name: &str, key: &str) -> Result<f64> {
    table::number(info, key, format_args!("the output of `inerter info` for {name}"))
}

/// The samples of a recording, and what was lost of them.
fn recorded(info: &Value, name: &str) -> Result<Vec<Row>> {
    let row = |what: &str, key: &str| -> Result<Row> {
        Ok(Row::new(format!("{name}: {what}"), figure(info, name, key)?, ""))
    };
    Ok(vec![
        row("samples", "samples")?,
        row("samples lost", "lost_samples")?.at_most(0.0),
        row("discontinuities", "discontinuities")?.at_most(0.0),
        row("frames lost", "lost_frames")?.at_most(0.0),
    ])
}

/// What is missing from the time that was asked for, and how far samples and the host's clock are apart; for a device
/// that may be slower than a clock, how much slower it was, and how far samples and its own counter are apart.
fn in_time(info: &Value, name: &str, asked: Asked) -> Result<Vec<Row>> {
    let lasted_s = figure(info, name, "samples")? / asked.rate_hz;
    let row = |what: &str, value: f64, unit| Row::new(format!("{name}: {what}"), value, unit);
    Ok(if asked.keeps_time {
        let missing = (1.0 - lasted_s / asked.seconds).max(0.0) * 100.0;
        vec![
            row("missing of the time asked for", missing, "%").at_most(MOST_MISSING),
            row("samples and the host's clock apart", (lasted_s - host_s(info)?).abs(), "s").at_most(APART_S),
        ]
    } else {
        vec![
            row("times slower than a board", asked.seconds / lasted_s, "").at_most(SLOWER),
            row("samples and the device's counter apart", (lasted_s - figure(info, name, "duration_s")?).abs(), "s")
                .at_most(COUNTED_S),
        ]
    })
}

/// How many lines differ between a replay of the recording's last part and a device that receives it.
fn replayed(program: &Path, folder: &Path, name: &str, info: &Value, device: &str) -> Result<Row> {
    let from_s = (info["duration_s"].as_f64().unwrap_or(0.0) - REPLAYED_S).max(0.0).to_string();
    let said = |arguments: &[&str]| {
        let text = process::output(Command::new(program).current_dir(folder).args(arguments))?;
        text.lines().map(plain).collect::<Result<Vec<Value>>>()
    };
    said(&["cut", name, "--from", &from_s, "-o", "part.mcap", "--force"])?;
    let replayed = said(&["replay", "part.mcap", "--json"])?;
    let sent = said(&["send", "part.mcap", "--json", "--connect", device])?;
    ensure!(replayed.len() >= 10, "{name}: the replay printed only {} lines", replayed.len());
    let same = replayed.iter().zip(&sent).filter(|(one, other)| one == other).count();
    let differ = replayed.len().max(sent.len()) - same;
    Ok(Row::new(format!("{name}: of {} replayed lines, others than a device's", replayed.len()), differ as f64, "")
        .at_most(0.0))
}

/// A line without what only a replay adds.
fn plain(line: &str) -> Result<Value> {
    let mut value: Value = serde_json::from_str(line).with_context(|| format!("no JSON: {line}"))?;
    if let Some(object) = value.as_object_mut() {
        for key in ["final", "samples", "discontinuities", "lost_samples", "saturated", "uncertainty", "warnings"] {
            object.remove(key);
        }
    }
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_counts_from_the_first_minute() {
        let mut watched = Watched::new("device", 1);
        let memory_mb = |at_s: f64| if at_s < 60.0 { 5.0 } else { 10.0 + at_s * 0.01 };
        let look = |at_s: f64| Look { at_s, processor_s: 0.0, memory_mb: memory_mb(at_s) };
        watched.looks = (0..40).map(|place| look(f64::from(place) * 5.0)).collect();
        let rows = memory(&watched);
        assert!((rows[0].value - 11.95).abs() < 1e-9 && (rows[1].value - 6.222).abs() < 0.01, "{rows:?}");
        // An hour in which a recorder grows by its index, and one in which it grows by twice as much.
        let child = process::spawn(&mut Command::new("true")).unwrap();
        let mut recorder = Watched::recorder("recorder", Running(child));
        for (per_s, is_growth) in [(INDEX_MB_PER_S, false), (2.0 * INDEX_MB_PER_S, true)] {
            let look = |at_s: f64| Look { at_s, processor_s: 0.0, memory_mb: 10.0 + per_s * at_s };
            recorder.looks = (0..720).map(|place| look(f64::from(place) * 5.0)).collect();
            assert_eq!(memory(&recorder)[1].value > GROWTH, is_growth, "{per_s}");
        }
        // Without a measurement nothing is verified.
        watched.looks.clear();
        assert!(memory(&watched)[1].value.is_nan());
    }

    #[test]
    fn a_recording_is_judged_by_the_hosts_clock_and_the_time_asked_for() {
        // From 1 Hz of samples for 100 s; each recording is without a gap, by the device's own counter.
        let asked = Asked { rate_hz: 1.0, seconds: 100.0, keeps_time: true };
        let missed = |samples: u64, host_s: u64| {
            let first_ns = 1_700_000_000_000_000_000_u64;
            let info = json!({
                "samples": samples, "first_ns": first_ns, "last_ns": first_ns + host_s * 1_000_000_000,
            });
            table::missed(&in_time(&info, "run", asked).unwrap())
        };
        assert_eq!(missed(100, 100), "");
        assert_eq!(missed(96, 96), "");
        assert_eq!(missed(90, 90), "run: missing of the time asked for");
        for samples in [97, 103] {
            assert_eq!(missed(samples, 100), "run: samples and the host's clock apart");
        }
        assert!(in_time(&json!({ "samples": 100 }), "run", asked).is_err());
    }

    #[test]
    fn a_slow_device_takes_part_at_the_rate_asked_for() {
        let asked = Asked { rate_hz: 4000.0, seconds: 100.0, keeps_time: false };
        let missed = |samples: u64, duration_s: f64| {
            let info = json!({ "samples": samples, "duration_s": duration_s });
            table::missed(&in_time(&info, "run", asked).unwrap())
        };
        assert_eq!(missed(200_000, 50.0), "");
        assert_eq!(missed(8000, 2.0), "run: times slower than a board");
        assert_eq!(missed(0, 0.0), "run: times slower than a board");
        // At 1 kHz.
        assert_eq!(missed(50_000, 50.0), "run: samples and the device's counter apart");
    }

    #[test]
    fn nothing_may_be_lost() {
        let info = json!({ "samples": 100, "lost_samples": 1, "discontinuities": 1, "lost_frames": 1 });
        let rows = recorded(&info, "run").unwrap();
        assert_eq!(table::missed(&rows), "run: samples lost, run: discontinuities, run: frames lost");
        assert!(recorded(&json!({ "samples": 100 }), "run").is_err());
    }

    #[test]
    fn a_replay_and_a_device_are_compared_without_what_one_adds() {
        let replayed = plain(r#"{"kind":"estimate","final":true,"t_s":1.0,"samples":7,"uncertainty":{}}"#).unwrap();
        assert_eq!(replayed, plain(r#"{"kind":"estimate","t_s":1.0}"#).unwrap());
        assert!(plain("half a li").is_err());
    }
}
