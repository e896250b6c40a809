//! A connected device: its estimates as they arrive, and recordings.

use std::{
    collections::{BTreeMap, VecDeque},
    path::PathBuf,
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use inerter_core::Settings;
use inerter_data::{
    json::{EstimateJson, machine_json_line},
    recording::{End, Recorder},
    settings, text,
};
use inerter_device::{
    DEFAULT_BAUD, Received, Target,
    live::{LinkEvent, Live},
};
use inerter_wire::{EstimatorEvent, Event, EventKind, Frame, Hello, Pairing, Record, Streams};
use pyo3::{exceptions::PyValueError, prelude::*};

use crate::{
    error::Failure,
    run::{Given, by_name},
    watch::watch,
};

/// A connection to one device; `close` ends it.
#[pyclass(frozen, module = "inerter")]
pub struct Device {
    name: String,
    identity: BTreeMap<String, String>,
    conversation: Mutex<Option<Conversation>>,
}

/// State of an open connection.
struct Conversation {
    live: Live,
    settings: Settings,
    pairing: Pairing,
    /// Estimates that have not been requested yet.
    waiting: VecDeque<String>,
    /// The device has no more samples.
    has_ended: bool,
}

/// Result of one poll of the link.
enum Look {
    Estimate(String),
    /// Nothing new.
    Nothing,
    End,
}

/// Connects to a device by its port, its TCP address or its serial number, or to the only one that is plugged in.
#[pyfunction]
pub fn connect(
    py: Python<'_>,
    port: Option<String>,
    address: Option<String>,
    serial: Option<String>,
    baud: Option<u32>,
    wait_s: f64,
) -> PyResult<Device> {
    let wait = Duration::try_from_secs_f64(wait_s)
        .map_err(|_| PyValueError::new_err(format!("wait_s must be a number from 0 on, not {wait_s}")))?;
    let target = match (port, address) {
        (Some(port), _) => Target::Port { port, baud: baud.unwrap_or(DEFAULT_BAUD) },
        (None, Some(address)) => Target::Tcp { address },
        (None, None) => Target::Usb { serial },
    };
    watch(py, None, move |_| {
        let live = Live::connect(target, Streams::ALL, wait, || false)?;
        let device = live.device();
        let hello = device.map(|device| device.hello().clone());
        let identity = hello.into_iter().flat_map(|hello| {
            let Hello { board, serial, firmware, git, .. } = &hello;
            let texts = [("board", board.as_str()), ("serial", serial), ("firmware", firmware), ("git", git)];
            texts.map(|(name, text)| (name.to_string(), text.to_string()))
        });
        Ok(Device {
            name: device.map(|device| device.name().to_string()).unwrap_or_default(),
            identity: identity.collect(),
            conversation: Mutex::new(Some(Conversation {
                settings: device.map(|device| *device.settings()).unwrap_or_default(),
                live,
                pairing: Pairing::new(),
                waiting: VecDeque::new(),
                has_ended: false,
            })),
        })
    })
}

#[pymethods]
impl Device {
    /// Its port or address.
    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// Board, serial number and firmware.
    #[getter]
    fn identity(&self) -> BTreeMap<String, String> {
        self.identity.clone()
    }

    /// The settings in use, by name.
    #[getter]
    fn settings(&self, py: Python<'_>) -> PyResult<Given> {
        Ok(py.detach(|| self.with(|conversation| Ok(by_name(&conversation.settings))))?)
    }

    /// The next estimate, as a line of `inerter monitor --json`; none once the device has no more samples.
    fn next_estimate(&self, py: Python<'_>) -> PyResult<Option<String>> {
        loop {
            match py.detach(|| self.with(|conversation| conversation.look(|_| Ok(()))))? {
                Look::Estimate(line) => return Ok(Some(line)),
                Look::End => return Ok(None),
                Look::Nothing => py.check_signals()?,
            }
        }
    }

    /// Records until the device has no more samples, for `seconds`, or until Ctrl-C; the file keeps what arrived by
    /// then. `calibration` is a settings file that holds the rig's calibration.
    fn record(
        &self,
        py: Python<'_>,
        path: PathBuf,
        duration_s: f64,
        replace: bool,
        calibration: Option<PathBuf>,
    ) -> PyResult<()> {
        let calibration = calibration.as_deref().map(settings::calibration).transpose();
        let calibration = calibration.map_err(Failure::from)?;
        let duration = Duration::try_from_secs_f64(duration_s).unwrap_or(Duration::MAX);
        let begin = || {
            self.with(|conversation| {
                let mut recorder = Recorder::create(&path, replace)?;
                if let Some(device) = conversation.live.device() {
                    recorder.describe(device.hello(), device.settings())?;
                }
                calibration.iter().try_for_each(|calibration| recorder.calibrated(calibration))?;
                // Estimates from before the recording are not in the file.
                conversation.waiting.clear();
                Ok(recorder)
            })
        };
        let mut recorder = py.detach(begin)?;
        let started = Instant::now();
        let mut take = |conversation: &mut Conversation| {
            let now_ns = conversation.live.now_ns();
            let look = conversation.look(|received| match received {
                Some(received) => Ok(recorder.frame(received.time_ns, &received.bytes)?),
                None => Ok(recorder.quiet(now_ns)?),
            })?;
            conversation.waiting.clear();
            Ok(look)
        };
        let mut listen = || -> PyResult<()> {
            while started.elapsed() < duration {
                if let Look::End = py.detach(|| self.with(&mut take))? {
                    break;
                }
                py.check_signals()?;
            }
            Ok(())
        };
        let ended = listen();
        let reason = ended.as_ref().err().map_or_else(|| "finished".to_string(), ToString::to_string);
        let lost_frames = self.with(|conversation| Ok(conversation.live.lost_frames())).unwrap_or(0);
        let closed = py.detach(|| recorder.close(&End { reason, lost_frames }));
        ended?;
        Ok(closed.map_err(Failure::from)?)
    }

    /// Closes the connection.
    fn close(&self, py: Python<'_>) {
        // Dropped without holding the GIL: closing may wait for the port.
        py.detach(|| drop(self.conversation.lock().unwrap_or_else(PoisonError::into_inner).take()));
    }
}

impl Device {
    fn with<T>(&self, ask: impl FnOnce(&mut Conversation) -> Result<T, Failure>) -> Result<T, Failure> {
        let mut conversation = self.conversation.lock().unwrap_or_else(PoisonError::into_inner);
        let open = conversation.as_mut();
        ask(open.ok_or_else(|| Failure::Python(PyValueError::new_err("the device is closed")))?)
    }
}

impl Conversation {
    /// Polls the link once; `heard` gets each frame as received, or `None` if there was none.
    fn look(&mut self, heard: impl FnOnce(Option<&Received>) -> Result<(), Failure>) -> Result<Look, Failure> {
        if let Some(line) = self.waiting.pop_front() {
            return Ok(Look::Estimate(line));
        }
        match self.live.next()? {
            LinkEvent::Received(received) => {
                if !received.bytes.is_empty() {
                    heard(Some(&received))?;
                }
                if let Frame::Message { message, .. } = &received.frame {
                    self.take(message);
                }
            }
            // The last raw samples may arrive after the event.
            LinkEvent::Quiet if self.has_ended => return Ok(Look::End),
            LinkEvent::Quiet => {
                heard(None)?;
                let late = self.pairing.flush();
                late.iter().for_each(|event| self.keep(event));
            }
            LinkEvent::Away { .. } | LinkEvent::Back => {}
        }
        Ok(self.waiting.pop_front().map_or(Look::Nothing, Look::Estimate))
    }

    fn take(&mut self, message: &Record) {
        for event in self.pairing.take(message) {
            self.keep(&event);
        }
        match message {
            Record::Event(Event { kind: EventKind::SourceEnded, .. }) => self.has_ended = true,
            Record::Settings(values) => self.settings = values.read(&self.settings).settings,
            _ => {}
        }
    }

    fn keep(&mut self, event: &EstimatorEvent) {
        if let EstimatorEvent::Estimate(estimated) = event {
            let t_s = text::elapsed_s(&estimated.estimate, self.settings.sample_rate_hz);
            let line = EstimateJson::live(t_s, estimated, &self.settings);
            self.waiting.push_back(machine_json_line(self.settings.machine, &line));
        }
    }
}
