//! The front end in use, by the setting `front_end`.

use crate::converter::{self, Converter};
use crate::sampler::{self, Sampler};
use inerter_app::{Pace, SampleSource, SourceError};
use inerter_core::{RawSample, Settings, SettingsError};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FrontEnd {
    Analogue,
    Digital,
}

impl FrontEnd {
    fn of(settings: &Settings) -> Self {
        if settings.front_end == 0.0 { Self::Analogue } else { Self::Digital }
    }

    fn rates_hz(self) -> &'static [f64] {
        match self {
            Self::Analogue => sampler::RATES_HZ,
            Self::Digital => converter::RATES_HZ,
        }
    }
}

/// Whether the front end that they choose can do it.
pub fn accepts(settings: &Settings) -> Result<(), SettingsError> {
    let (value, offered) = (settings.sample_rate_hz, FrontEnd::of(settings).rates_hz());
    if offered.contains(&value) {
        Ok(())
    } else {
        Err(SettingsError::NotOffered { field: "sample_rate_hz", value, offered })
    }
}

/// Both front ends; one is in use.
pub struct Source {
    sampler: Sampler,
    converter: Converter,
    in_use: FrontEnd,
}

impl Source {
    /// The analogue one, halted.
    pub fn new(sampler: Sampler, converter: Converter) -> Self {
        Self { sampler, converter, in_use: FrontEnd::Analogue }
    }
}

impl SampleSource for Source {
    fn pace(&self) -> Pace {
        Pace::Live
    }

    async fn read(&mut self, into: &mut [RawSample]) -> Result<usize, SourceError> {
        match self.in_use {
            FrontEnd::Analogue => self.sampler.read(into).await,
            FrontEnd::Digital => self.converter.read(into).await,
        }
    }

    /// The sample counter goes on, whichever front end comes.
    async fn configure(&mut self, settings: &Settings) -> Result<(), SourceError> {
        self.halt().await;
        let index = match self.in_use {
            FrontEnd::Analogue => self.sampler.index(),
            FrontEnd::Digital => self.converter.index(),
        };
        self.in_use = FrontEnd::of(settings);
        match self.in_use {
            FrontEnd::Analogue => self.sampler.configure(settings, index),
            FrontEnd::Digital => self.converter.configure(settings, index).await,
        }
    }

    async fn halt(&mut self) {
        match self.in_use {
            FrontEnd::Analogue => self.sampler.halt(),
            FrontEnd::Digital => self.converter.halt(),
        }
    }
}
