//! The firmware image in QEMU, which receives all of its samples at once.

use std::{
    fs,
    net::TcpListener,
    path::PathBuf,
    process::{Child, Command, Stdio},
    sync::{Mutex, MutexGuard},
    time::{Duration, Instant},
};

use inerter_core::{Estimate, RawSample, Settings};
use inerter_device::{Clock, Device, DeviceError, Target};
use inerter_simulate::{END_OF_SAMPLES, sample_bytes};
use inerter_wire::{EventKind, Frame, Record, Streams};

use crate::grid::Error;

const QEMU: &str = "qemu-system-arm";
/// Time limit for the first answer after the start.
const START_TIME: Duration = Duration::from_secs(20);
/// A run has failed after this time without a record.
const SILENCE: Duration = Duration::from_secs(20);

/// The image made by `cargo xtask build-firmware`, if it can run; otherwise the test is skipped
/// ([`inerter_needs::or_skip`]).
pub fn image() -> Option<PathBuf> {
    inerter_needs::or_skip(find_image())
}

fn find_image() -> Result<PathBuf, String> {
    let path = match std::env::var_os("INERTER_QEMU_IMAGE") {
        Some(path) => PathBuf::from(path),
        None => PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../target/thumbv7em-none-eabihf/firmware/inerter-qemu"),
    };
    if !path.is_file() {
        return Err(format!("no image {}; `cargo xtask build-firmware` makes it", path.display()));
    }
    match Command::new(QEMU).arg("--version").stdout(Stdio::null()).status() {
        Ok(_) => Ok(path),
        Err(error) => Err(format!("{QEMU} cannot be run ({error}); `cargo xtask setup` installs it")),
    }
}

/// One machine at a time: the time limits assume that it has a processor of its own.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// A running QEMU with its file of samples; dropping it ends QEMU.
pub struct Machine {
    child: Child,
    address: String,
    samples: PathBuf,
    _turn: MutexGuard<'static, ()>,
}

impl Machine {
    /// Boots the image; the sampler will read these samples once it is started.
    pub fn boot(image: &PathBuf, samples: &[RawSample]) -> Result<Self, Error> {
        let turn = ONE_AT_A_TIME.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let address = TcpListener::bind("127.0.0.1:0")?.local_addr()?.to_string();
        let file = std::env::temp_dir().join(format!("inerter-{}.samples", address.replace(':', "-")));
        let mut bytes: Vec<u8> = samples.iter().flat_map(sample_bytes).collect();
        bytes.extend(END_OF_SAMPLES);
        fs::write(&file, bytes)?;
        let child = Command::new(QEMU)
            .args(["-M", "netduinoplus2", "-display", "none", "-monitor", "none", "-serial"])
            .arg(format!("tcp:{address},server=on,wait=off,nodelay=on"))
            .arg("-semihosting-config")
            .arg(format!("enable=on,target=native,arg=inerter,arg={}", file.display()))
            .arg("-kernel")
            .arg(image)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()?;
        Ok(Self { child, address, samples: file, _turn: turn })
    }

    /// Connects to the image.
    pub fn connect(&mut self) -> Result<Device, Error> {
        let started = Instant::now();
        loop {
            let target = Target::Tcp { address: self.address.clone() };
            match Device::connect(&target, Clock::new(), || false) {
                Ok(device) => return Ok(device),
                Err(DeviceError::Connect { .. } | DeviceError::TurnedAway { .. } | DeviceError::Vanished { .. })
                    if started.elapsed() < START_TIME =>
                {
                    if let Some(status) = self.child.try_wait()? {
                        return Err(format!("QEMU ended: {status}").into());
                    }
                    std::thread::sleep(Duration::from_millis(20));
                }
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// The exit status, once QEMU has ended by itself.
    pub fn wait(&mut self) -> Result<i32, Error> {
        let started = Instant::now();
        loop {
            match self.child.try_wait()? {
                Some(status) => return status.code().ok_or_else(|| "QEMU was killed".into()),
                None if started.elapsed() > SILENCE => return Err("QEMU does not end".into()),
                None => std::thread::sleep(Duration::from_millis(10)),
            }
        }
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
        fs::remove_file(&self.samples).ok();
    }
}

/// All records that the device sends until its samples end.
pub fn until_the_end(device: &mut Device) -> Result<Vec<Record>, Error> {
    let mut records = Vec::new();
    let mut heard = Instant::now();
    loop {
        let Some(received) = device.receive()? else {
            if heard.elapsed() > SILENCE {
                return Err(format!("silent after {} records", records.len()).into());
            }
            continue;
        };
        heard = Instant::now();
        match received.frame {
            Frame::Message { message: Record::Event(event), .. } if event.kind == EventKind::SourceEnded => {
                return Ok(records);
            }
            Frame::Message { message, .. } => records.push(message),
            other => return Err(format!("{BAD_FRAME}: {other:?}").into()),
        }
    }
}

/// Start of the error message for a frame that arrived damaged.
const BAD_FRAME: &str = "a bad frame";
/// A fault is reported after this many damaged runs in a row.
const RUNS: usize = 3;

/// A run in which every frame arrived whole. A few runs in a hundred have a damaged frame; the cause is unknown, but
/// QEMU stalling on a busy machine is suspected. Such a run is reported and repeated.
pub fn undisturbed<T>(mut run: impl FnMut() -> Result<T, Error>) -> Result<T, Error> {
    for _ in 1..RUNS {
        match run() {
            Err(error) if error.to_string().starts_with(BAD_FRAME) => println!("{error}; once more"),
            result => return result,
        }
    }
    run()
}

/// All estimates of a run over the samples in the file; the last one is the final estimate.
pub fn measure(image: &PathBuf, settings: &Settings, samples: &[RawSample]) -> Result<Vec<Estimate>, Error> {
    undisturbed(|| {
        let mut machine = Machine::boot(image, samples)?;
        let mut device = machine.connect()?;
        device.stream(Streams { estimates: true, ..Streams::NONE })?;
        device.write_settings(settings)?;
        device.start_sampler()?;
        Ok(estimates(&until_the_end(&mut device)?))
    })
}

/// The estimates among the records.
pub fn estimates(records: &[Record]) -> Vec<Estimate> {
    let of = |record: &Record| if let Record::Estimate(estimate) = record { Some(*estimate) } else { None };
    records.iter().filter_map(of).collect()
}
