//! The source of the samples: a recording, read again for each pass, or a CSV, held in memory.

use std::{
    collections::BTreeMap,
    ops::Range,
    path::{Path, PathBuf},
    sync::Arc,
};

use inerter_core::{RawSample, Settings};

use crate::{
    calibration::Calibration,
    csv,
    error::Error,
    open::{is_recording, open},
    recording::{self, Extent, HELLO_METADATA, Marker, TRUTH_METADATA},
    run::Run,
    series::{Converter, Point},
    settings::Overrides,
};

/// Samples one after the other.
pub type Samples = Box<dyn Iterator<Item = Result<RawSample, Error>> + Send>;

/// A sample as it was received, and in SI units.
pub type Row = (RawSample, Point);

/// Rows one after the other.
pub type Rows = Box<dyn Iterator<Item = Result<Row, Error>> + Send>;

/// Samples and what is known about them; those of a recording are never held in memory.
#[derive(Clone, Debug)]
pub struct Source {
    /// Name for messages: the file.
    pub name: String,
    /// Settings that the samples were taken with, including the user's overrides.
    pub settings: Settings,
    /// Time of the first sample \[s\].
    pub start_s: f64,
    /// What was repaired or found missing while reading.
    pub notes: Vec<String>,
    /// The device, when known.
    pub device: Option<BTreeMap<String, String>>,
    /// The calibration of its rig, if known.
    pub calibration: Option<Calibration>,
    /// The true parameters of a simulated device.
    pub truth: Option<BTreeMap<String, String>>,
    /// The extent of the samples.
    pub extent: Extent,
    /// Remarks made during the recording.
    pub markers: Vec<Marker>,
    /// Host time of the first frame \[ns\]; 0 if unknown.
    pub first_ns: u64,
    samples: Origin,
}

#[derive(Clone, Debug)]
enum Origin {
    Recording(PathBuf),
    Held(Arc<Vec<RawSample>>),
}

impl Source {
    /// Opens a recording or a CSV, distinguished by their first bytes, and reads it once; `progress` gets the bytes of
    /// a recording read so far.
    pub fn open(path: &Path, overrides: &Overrides, progress: impl FnMut(u64)) -> Result<Self, Error> {
        if !is_recording(path)? {
            return Ok(Self::held(csv::to_run(csv::read(path)?, overrides)?));
        }
        let mut summary = recording::summary_watched(path, progress)?;
        let settings = recording::usable_settings(path, &summary, overrides)?;
        let (calibration, trouble) = recording::calibration(path, &summary, overrides);
        summary.notes.extend(trouble);
        let metadata = &mut summary.contents.metadata;
        Ok(Self {
            name: path.display().to_string(),
            settings,
            start_s: 0.0,
            device: metadata.remove(HELLO_METADATA),
            truth: metadata.remove(TRUTH_METADATA),
            calibration,
            notes: summary.notes,
            extent: summary.extent,
            markers: summary.markers,
            first_ns: summary.contents.span_ns.map_or(0, |(first, _)| first),
            samples: Origin::Recording(path.into()),
        })
    }

    /// Samples already in memory; nothing is known about the device except the true parameters of a simulated one.
    pub fn held(run: Run) -> Self {
        Self {
            name: run.name,
            settings: run.settings,
            start_s: run.start_s,
            notes: run.notes,
            device: None,
            calibration: run.calibration,
            truth: run.truth,
            extent: Extent::of(&run.samples),
            markers: Vec::new(),
            first_ns: 0,
            samples: Origin::Held(Arc::new(run.samples)),
        }
    }

    /// The run with its samples in memory; `overrides` are those that it was opened with.
    pub fn whole(&self, overrides: &Overrides) -> Result<Run, Error> {
        match &self.samples {
            Origin::Recording(path) => Ok(Run { name: self.name.clone(), ..open(path, overrides)? }),
            Origin::Held(samples) => Ok(Run {
                name: self.name.clone(),
                settings: self.settings,
                samples: samples.to_vec(),
                start_s: self.start_s,
                notes: self.notes.clone(),
                calibration: self.calibration.clone(),
                truth: self.truth.clone(),
                ..Run::default()
            }),
        }
    }

    /// The recording, unless the samples are in memory.
    pub fn recording(&self) -> Option<&Path> {
        match &self.samples {
            Origin::Recording(path) => Some(path),
            Origin::Held(_) => None,
        }
    }

    /// The samples in order.
    pub fn samples(&self) -> Result<Samples, Error> {
        // Samples that are added meanwhile to a recording still being written do not count.
        let most = usize::try_from(self.extent.samples).unwrap_or(usize::MAX);
        Ok(match &self.samples {
            Origin::Recording(path) => Box::new(recording::samples(path)?.take(most)),
            Origin::Held(samples) => {
                let samples = samples.clone();
                Box::new((0_usize..).map_while(move |place| samples.get(place).copied()).map(Ok))
            }
        })
    }

    /// The samples whose time since the first one lies in `range_s` \[s\], in SI.
    pub fn rows(&self, range_s: Range<f64>) -> Result<Rows, Error> {
        let periods = |t_s: f64| (t_s * self.settings.sample_rate_hz - 1e-6).ceil().max(0.0) as u64;
        let (start, end) = (periods(range_s.start), periods(range_s.end));
        let mut converter = Converter::new(&self.settings);
        let rows = self.samples()?.map(move |sample| sample.map(|sample| (sample, converter.point(&sample))));
        let rows = rows.take_while(move |row| !row.as_ref().is_ok_and(|(_, point)| point.elapsed >= end));
        Ok(Box::new(rows.filter(move |row| !row.as_ref().is_ok_and(|(_, point)| point.elapsed < start))))
    }

    /// Time of a sample \[s\].
    pub fn time_s(&self, elapsed: u64) -> f64 {
        self.start_s + elapsed as f64 / self.settings.sample_rate_hz
    }

    /// Time from the first sample to the last \[s\], missing samples included.
    pub fn duration_s(&self) -> f64 {
        self.extent.periods as f64 / self.settings.sample_rate_hz
    }
}
