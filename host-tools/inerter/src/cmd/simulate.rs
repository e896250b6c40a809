//! `inerter simulate`: a simulated inerter in a simulated rig.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::Duration,
};

use inerter_data::{
    output,
    words::{duration_text, plural},
};
use inerter_device::{DEFAULT_BAUD, Device, Target};
use inerter_plant::Inerter;
use inerter_simulate::{
    Described, Endpoint, Motion, Operator, Qemu, START_TIME, Setup, SimulateError, VirtualDevice, file, find_image,
};
use miette::Diagnostic;
use serde_json::{Value, json};

use super::{
    args::{SettingsArgs, note_exposed},
    plant::SimulatedArgs,
    print::print_json,
    terminal::{self, Progress},
};
use crate::{Error, monitor::address::check_exposed};

/// Simulate an inerter in a rig, as a file or as a live device.
///
/// With -o a recording (.mcap) or CSV (.csv) is written as fast as possible. With --tcp or --pty a live device runs
/// until Ctrl-C: the firmware's own code on this machine, or, with --qemu, the firmware image in QEMU. Connect to it
/// with monitor, record or send. With --bench, lines of standard input apply loads and turn the screw, to try
/// calibrate without a rig: start with --excite hold. The device's settings are those of a perfect calibration; --set
/// changes them.
///
/// Motions for --excite: slow, mid, fast (the paper's tests), multi, random, two; sine:3.2Hz:4.16mm,
/// tones:0.8Hz:8mm,6.4Hz:0.8mm, multi:0.5-15Hz:20mm/s, random:0.5-15Hz:20mm/s, chirp:0.1-20Hz:5mm/s:60s,
/// moves:0.25m:0.3m/s:2m/s2:0.2s (back and forth, with a rest before each), hold; and sequences such as
/// mid@20s;hold@5s;random@20s. A rotary machine also takes rad, deg, rad/s, rpm and rad/s2.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("where").required(true).multiple(false))]
pub struct Args {
    /// Write a recording (.mcap) or a CSV (.csv)
    #[arg(short, long, value_name = "FILE", group = "where")]
    output: Option<PathBuf>,
    /// Replace the file if it exists
    #[arg(long, requires = "output")]
    force: bool,
    /// Run a live device on this TCP address, e.g. 127.0.0.1:7878; port 0 takes any free one
    #[arg(long, value_name = "HOST:PORT", group = "where")]
    tcp: Option<String>,
    /// Allow an address of --tcp that other machines can reach
    #[arg(long, requires = "tcp")]
    allow_remote: bool,
    /// Run a live device on a pseudo-terminal, like a board on a serial port
    #[arg(long, group = "where")]
    pty: bool,
    /// Run the firmware image in QEMU instead of the firmware's code on this machine
    #[arg(long, conflicts_with = "output")]
    qemu: bool,
    /// Firmware image for --qemu [default: INERTER_QEMU_IMAGE, or the source tree's]
    #[arg(long, value_name = "FILE", requires = "qemu")]
    image: Option<PathBuf>,
    /// Stop the motion after this many seconds [default for a file: the motion's own, else 20]
    #[arg(long, value_name = "SECONDS", value_parser = super::args::seconds, allow_negative_numbers = true)]
    duration: Option<Duration>,
    /// Speed of a live device, as a multiple of real time
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = speed, conflicts_with = "output")]
    speed: f64,
    /// Start the motion only when a host connects with monitor or record
    #[arg(long, conflicts_with_all = ["output", "qemu"])]
    wait: bool,
    /// Apply the loads and motions given on standard input, one per line: load NEWTONS, mass KG, move METRES, turn
    /// REVOLUTIONS, shake MOTION
    #[arg(long, conflicts_with_all = ["output", "wait", "change_at"])]
    bench: bool,
    /// Force on the load cell in addition to the motion, such as a weight's
    #[arg(long, value_name = "NEWTONS", default_value_t = 0.0, allow_negative_numbers = true)]
    load: f64,
    /// Device to start from: paper, worn (0.1 mm of backlash), preloaded (three times the friction), presliding
    /// (friction reverses over 50 um) or stribeck (friction is 1.3 times as great at rest)
    #[arg(long, value_name = "NAME", default_value = "paper")]
    preset: String,
    /// Motion of the terminal
    #[arg(long, value_name = "MOTION", default_value = "random", conflicts_with = "motion")]
    excite: String,
    /// Motion of the terminal point by point: a CSV with t_s and terminal_m, as `inerter plan -o` writes it
    #[arg(long, value_name = "FILE.csv")]
    motion: Option<PathBuf>,
    /// Seed of motion and noise
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
    /// Change the device at this time, as --change says
    #[arg(long, value_name = "SECONDS", requires = "change")]
    change_at: Option<f64>,
    /// One parameter of the device after the change, e.g. inertance_kg=150; may be repeated
    #[arg(long, value_name = "NAME=VALUE", requires = "change_at")]
    change: Vec<String>,
    /// Print JSON: the address of a live device, or what was written
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: SettingsArgs,
    #[command(flatten)]
    plant: SimulatedArgs,
}

fn speed(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "a number is needed, for example 10".to_string())?;
    if (0.01..=1000.0).contains(&value) { Ok(value) } else { Err("the factor must lie between 0.01 and 1000".into()) }
}

fn setup(args: &Args) -> Result<Setup, Error> {
    let described = Described {
        preset: args.preset.clone(),
        given: args.plant.given.clone(),
        motion: match &args.motion {
            Some(path) => Motion::File(path.clone()),
            None => Motion::Named(args.excite.clone()),
        },
        seed: args.seed,
        duration_s: args.duration.map(|duration| duration.as_secs_f64()),
        load_n: args.load,
        change: args.change_at.map(|at_s| changed(&args.change).map(|values| (at_s, values))).transpose()?,
        overrides: args.settings.overrides()?,
    };
    Ok(if args.output.is_some() { described.ending() } else { described.setup() }?)
}

/// Changed parameters of the device, each as NAME=VALUE.
fn changed(texts: &[String]) -> Result<BTreeMap<String, f64>, SimulateError> {
    let one = |text: &String| {
        let (name, value) = text.split_once('=')?;
        Some((name.trim().to_string(), value.trim().parse().ok()?))
    };
    texts.iter().map(|text| one(text).ok_or_else(|| SimulateError::Change { text: text.clone() })).collect()
}

pub fn run(args: &Args) -> Result<(), Error> {
    let setup = setup(args)?;
    match (&args.output, &args.tcp) {
        (Some(path), _) => to_file(args, &setup, path),
        (None, Some(address)) => {
            check_exposed("--tcp", address, args.allow_remote)?;
            note_exposed(address);
            live(args, &setup, &Endpoint::Tcp(address.clone()))
        }
        (None, None) => live(args, &setup, &Endpoint::Pty),
    }
}

fn to_file(args: &Args, setup: &Setup, path: &Path) -> Result<(), Error> {
    let duration_s = setup.duration_s.unwrap_or_default();
    let mut progress = Progress::new("simulating", (duration_s * 1e3) as u64);
    terminal::catch_interrupts();
    let advance = |t_s: f64| {
        progress.set((t_s * 1e3) as u64);
        terminal::go_on()
    };
    let file = path.display();
    let settings = file::write(setup, path, args.force, advance)?;
    progress.done();
    let samples = (duration_s * setup.settings.sample_rate_hz).ceil() as u64;
    if args.json {
        return print_json(
            &json!({ "kind": "simulated", "file": file.to_string(), "duration_s": duration_s, "truth": truth(setup) }),
        );
    }
    terminal::say(format!(
        "{file}: {} of motion `{}`, {} at {} Hz",
        duration_text(duration_s),
        setup.excite,
        plural(samples, "sample"),
        setup.settings.sample_rate_hz
    ));
    // A device such as /dev/null cannot be read back.
    if path.is_file() {
        let settings = settings.map_or(String::new(), |toml| format!(" --settings {}", toml.display()));
        terminal::say(format!("look at it with: inerter replay {file}{settings}"));
    }
    Ok(())
}

fn truth(setup: &Setup) -> Value {
    let names = Inerter::TABLE.iter().map(|field| field.name);
    let mut truth: Value = names.zip(setup.parameters.values()).collect();
    if let Some((at_s, _)) = setup.later {
        truth["change_at_s"] = at_s.into();
        truth["changed"] = setup.changes().collect();
    }
    truth
}

/// A running simulated device of either kind.
enum Running {
    Virtual(VirtualDevice),
    Qemu(Qemu),
}

/// The image in QEMU, with the settings of the simulated device and its sampler running: a device in a rig.
fn in_qemu(setup: &Setup, image: &Path, endpoint: &Endpoint) -> Result<Qemu, Error> {
    let mut qemu = Qemu::boot(image, endpoint, terminal::interrupted)?;
    let name = qemu.name().to_string();
    let target = match endpoint {
        Endpoint::Tcp(_) => Target::Tcp { address: name },
        Endpoint::Pty => Target::Port { port: name, baud: DEFAULT_BAUD },
    };
    let alive = || qemu.check().map_err(Error::from);
    Device::connect_starting(&target, START_TIME, &setup.settings, terminal::interrupted, alive)?.start_sampler()?;
    Ok(qemu)
}

fn live(args: &Args, setup: &Setup, endpoint: &Endpoint) -> Result<(), Error> {
    terminal::catch_interrupts();
    let image = args.qemu.then(|| find_image(args.image.as_deref())).transpose()?;
    let (mut running, bench) = match (&image, args.bench) {
        (Some(image), with_operator) => {
            let mut qemu = in_qemu(setup, image, endpoint)?;
            let bench = if with_operator {
                Some(qemu.play_with_operator(setup, args.speed)?)
            } else {
                qemu.play(setup, args.speed)?;
                None
            };
            (Running::Qemu(qemu), bench)
        }
        (None, true) => {
            let (device, bench) = VirtualDevice::with_operator(setup, endpoint, args.speed)?;
            (Running::Virtual(device), Some(bench))
        }
        (None, false) => {
            let start = if args.wait { VirtualDevice::waiting } else { VirtualDevice::start };
            (Running::Virtual(start(setup, endpoint, args.speed)?), None)
        }
    };
    if let Some(bench) = bench {
        // The thread ends with the program: nothing else interrupts a read of standard input.
        std::thread::spawn(move || listen_to(&bench));
    }
    let name = match &running {
        Running::Virtual(device) => device.name(),
        Running::Qemu(qemu) => qemu.name(),
    };
    let (key, flag) = match endpoint {
        Endpoint::Tcp(_) => ("address", "--connect"),
        Endpoint::Pty => ("port", "--port"),
    };
    if args.json {
        print_json(&json!({ "kind": "ready", key: name, "truth": truth(setup) }))?;
    } else {
        let device = &setup.parameters;
        output::line(format!(
            "simulated inerter of {} kg, {} N s/m, {} N, motion `{}`, at {name} until Ctrl-C",
            device.inertance_kg, device.viscous_n_s_per_m, device.coulomb_n, setup.excite
        ))?;
        output::line(format!("connect to it with: inerter monitor {flag} {name}"))?;
    }
    output::flush()?;
    while !terminal::interrupted() {
        if let Running::Qemu(qemu) = &mut running {
            qemu.check()?;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    Ok(())
}

/// Executes the commands from standard input until it ends.
fn listen_to(bench: &Operator) {
    for line in std::io::stdin().lines().map_while(Result::ok).filter(|line| !line.trim().is_empty()) {
        if let Err(error) = bench.obey(&line) {
            terminal::note(format!("{error}; {}", error.help().map(|help| help.to_string()).unwrap_or_default()));
        }
    }
}
