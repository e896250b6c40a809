//! The firmware image in QEMU, fed by the plant through an ordinary file.
//!
//! QEMU itself serves the device's USART on the TCP port or pseudo-terminal. The image starts like a board that was
//! never configured: the program that boots it writes the simulated device's settings before other hosts connect.

use std::{
    fs::File,
    io::{self, BufRead, BufReader, Read, Write},
    net::TcpListener,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::{self, RecvTimeoutError},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use inerter_core::RawSample;
use tempfile::TempPath;

use crate::{
    device::Endpoint,
    error::SimulateError,
    operator::{Operator, Samples},
    setup::{Setup, raw},
};

/// Program to run.
const QEMU: &str = "qemu-system-arm";
/// Environment variable with the path of the image.
const IMAGE_VARIABLE: &str = "INERTER_QEMU_IMAGE";
/// The source tree that this program was compiled from. Not the current folder: an image in QEMU can run any command.
const SOURCES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
/// Where cargo puts the image, relative to the source tree.
const IMAGE_PATH: &str = "target/thumbv7em-none-eabihf/firmware/inerter-qemu";
/// Time for QEMU to start and the image to answer.
pub const START_TIME: Duration = Duration::from_secs(10);
/// Interval of checks whether the work should continue.
const LOOK: Duration = Duration::from_millis(100);
/// Interval between two appends of samples.
const FEED_EVERY: Duration = Duration::from_millis(5);

/// The image: as given, from `INERTER_QEMU_IMAGE`, or where cargo put it in the source tree.
pub fn find_image(given: Option<&Path>) -> Result<PathBuf, SimulateError> {
    let named = || std::env::var_os(IMAGE_VARIABLE).map(PathBuf::from).filter(|path| path.is_file());
    let path = given.map(Path::to_path_buf).or_else(named).unwrap_or_else(|| Path::new(SOURCES).join(IMAGE_PATH));
    if path.is_file() { Ok(path) } else { Err(SimulateError::NoImage) }
}

/// The version line of the installed QEMU; `None` if there is none.
pub fn qemu_version() -> Option<String> {
    let output = Command::new(QEMU).arg("--version").output().ok()?;
    String::from_utf8_lossy(&output.stdout).lines().next().map(str::to_string)
}

/// A running QEMU, and its file of samples.
type Running = Arc<Mutex<(Child, TempPath)>>;

/// All running ones.
static RUNNING: Mutex<Vec<Running>> = Mutex::new(Vec::new());

/// The data behind the lock are always consistent.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Stops every QEMU, for a program that ends at once.
pub fn end_qemu() {
    for running in locked(&RUNNING).drain(..) {
        let mut running = locked(&running);
        running.0.kill().ok();
        std::fs::remove_file(&running.1).ok();
    }
}

/// QEMU with the image; dropping it stops QEMU.
pub struct Qemu {
    running: Running,
    name: String,
    /// The thread that reads its standard error until the end; returns the last text.
    last_words: Option<JoinHandle<String>>,
    stop: Arc<AtomicBool>,
    feeder: Option<JoinHandle<io::Result<()>>>,
    /// The file of samples, until the plant starts.
    file: Option<File>,
}

impl Qemu {
    /// Boots the image, with its own default settings, at rest and with its sampler halted.
    ///
    /// A host misses no sample if it connects now, writes the set-up's settings, starts the sampler and only then lets
    /// the plant [`play`](Self::play). The image answers within [`START_TIME`].
    pub fn boot(image: &Path, endpoint: &Endpoint, interrupted: fn() -> bool) -> Result<Self, SimulateError> {
        let failed = |what: &str| {
            let what = what.to_string();
            move |source| SimulateError::Endpoint { what, source }
        };
        let samples = tempfile::Builder::new().prefix("inerter-samples-").tempfile();
        let (file, samples) = samples.map_err(failed("the file of samples"))?.into_parts();
        let serial = match endpoint {
            Endpoint::Tcp(address) => {
                let address = free_port(address).map_err(failed(&format!("the TCP port {address}")))?;
                (format!("tcp:{address},server=on,wait=off,nodelay=on"), Some(address))
            }
            Endpoint::Pty => ("pty".into(), None),
        };
        let semihosting = format!("enable=on,target=native,arg=inerter,arg={}", samples.display());
        let mut command = Command::new(QEMU);
        command.args(["-M", "netduinoplus2", "-display", "none", "-monitor", "none", "-serial", &serial.0]);
        command.args(["-semihosting-config", &semihosting, "-kernel"]).arg(image);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // Ctrl-C is for this program: it stops QEMU at the end of the work.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn().map_err(|source| SimulateError::NoQemu { source })?;
        let (sender, names) = mpsc::channel();
        listen(child.stdout.take(), sender.clone());
        let last_words = listen(child.stderr.take(), sender);
        let running = Arc::new(Mutex::new((child, samples)));
        locked(&RUNNING).push(running.clone());
        let stop = Arc::new(AtomicBool::new(false));
        let mut qemu = Self { running, name: String::new(), last_words, stop, feeder: None, file: Some(file) };
        qemu.name = match serial.1 {
            Some(address) => address,
            None => qemu.pty_name(&names, interrupted)?,
        };
        Ok(qemu)
    }

    /// Starts the plant, at `speed` times real time. Its samples wait until the sampler is started.
    pub fn play(&mut self, setup: &Setup, speed: f64) -> Result<(), SimulateError> {
        self.feed(setup.samples()?, setup.settings.sample_rate_hz, speed);
        Ok(())
    }

    /// The same for a device that an operator loads and moves; the motion of the set-up is the first one.
    pub fn play_with_operator(&mut self, setup: &Setup, speed: f64) -> Result<Operator, SimulateError> {
        let (samples, bench) = setup.handled()?;
        self.feed(samples, setup.settings.sample_rate_hz, speed);
        Ok(bench)
    }

    fn feed(&mut self, samples: Samples, rate_hz: f64, speed: f64) {
        let stop = self.stop.clone();
        if let Some(file) = self.file.take() {
            self.feeder = Some(thread::spawn(move || feed(samples, file, speed, rate_hz, &stop)));
        }
    }

    /// Address or pseudo-terminal to connect to.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns an error once QEMU has ended.
    pub fn check(&mut self) -> Result<(), SimulateError> {
        let status = locked(&self.running).0.try_wait();
        match status {
            Ok(Some(status)) => {
                let words = self.last_words.take().and_then(|listener| listener.join().ok());
                let message = words.filter(|words| !words.is_empty()).unwrap_or_else(|| "it printed nothing".into());
                Err(SimulateError::QemuEnded { status: status.to_string(), message })
            }
            _ => Ok(()),
        }
    }

    /// QEMU reports on one of its outputs which pseudo-terminal it created.
    fn pty_name(&mut self, names: &mpsc::Receiver<String>, interrupted: fn() -> bool) -> Result<String, SimulateError> {
        let started = Instant::now();
        loop {
            match names.recv_timeout(LOOK) {
                Ok(name) => return Ok(name),
                Err(_) if interrupted() => return Err(inerter_data::Error::Interrupted.into()),
                Err(RecvTimeoutError::Timeout) if started.elapsed() < START_TIME => {}
                Err(_) => {
                    self.check()?;
                    let message = "it made no terminal".into();
                    return Err(SimulateError::QemuEnded { status: "still running".into(), message });
                }
            }
        }
    }
}

impl Drop for Qemu {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        {
            let (child, _) = &mut *locked(&self.running);
            child.kill().ok();
            child.wait().ok();
        }
        let mut all = locked(&RUNNING);
        all.retain(|running| !Arc::ptr_eq(running, &self.running));
        drop(all);
        if let Some(feeder) = self.feeder.take() {
            feeder.join().ok();
        }
    }
}

/// The address, with a port number that is free at the moment instead of 0.
fn free_port(address: &str) -> io::Result<String> {
    Ok(TcpListener::bind(address)?.local_addr()?.to_string())
}

/// Reads an output to its end and passes on the device names in it; returns the last text.
fn listen(output: Option<impl Read + Send + 'static>, names: mpsc::Sender<String>) -> Option<JoinHandle<String>> {
    let output = output?;
    Some(thread::spawn(move || {
        let mut last = String::new();
        for line in BufReader::new(output).lines().map_while(Result::ok) {
            let name = line.split_whitespace().find(|word| word.starts_with("/dev/")).map(str::to_string);
            // Once there is a name, nobody waits for another.
            name.map(|name| names.send(name).ok());
            // After its own error message QEMU prints registers.
            if !line.trim().is_empty() && !last.starts_with("qemu: fatal") {
                last = line;
            }
        }
        last
    }))
}

/// Mark after the last sample; the rest of its record may be missing.
pub const END_OF_SAMPLES: [u8; 4] = u32::MAX.to_le_bytes();

/// One sample as the image reads it.
pub fn sample_bytes(sample: &RawSample) -> [u8; 16] {
    let words = [sample.index, sample.position_count as u32, sample.force_code as u32, sample.terminal_code as u32];
    let mut bytes = [0; 16];
    for (place, word) in bytes.chunks_exact_mut(4).zip(words) {
        place.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

/// Appends samples when they are due, then the end mark.
fn feed(samples: Samples, mut file: File, speed: f64, rate_hz: f64, stop: &AtomicBool) -> io::Result<()> {
    let started = Instant::now();
    let mut portion = Vec::new();
    for sample in samples {
        let due_s = sample.t_s.max(1.0 / rate_hz) / speed;
        while started.elapsed().as_secs_f64() < due_s {
            if stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            file.write_all(&portion)?;
            portion.clear();
            thread::sleep(FEED_EVERY);
        }
        portion.extend_from_slice(&sample_bytes(&raw(&sample)));
    }
    portion.extend_from_slice(&END_OF_SAMPLES);
    portion.extend_from_slice(&[0; 12]);
    file.write_all(&portion)
}
