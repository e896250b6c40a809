//! The front end in use, selected by the setting `front_end`.

use crate::converter::{self, Converter};
use crate::sampler::{self, Sampler};
use inerter_app::{Pace, SampleSource, SourceError};
use inerter_core::{FrontEnd, RawSample, Settings, SettingsError};

fn rates_hz(front_end: FrontEnd) -> &'static [f64] {
    match front_end {
        FrontEnd::Analogue => sampler::RATES_HZ,
        FrontEnd::Ads131m04 => converter::RATES_HZ,
    }
}

/// Whether the front end selected by the settings supports them.
pub fn accepts(settings: &Settings) -> Result<(), SettingsError> {
    let (value, offered) = (settings.sample_rate_hz, rates_hz(settings.front_end));
    if !offered.contains(&value) {
        return Err(SettingsError::NotOffered { field: "sample_rate_hz", value, offered });
    }
    if settings.front_end == FrontEnd::Ads131m04 && settings.force_min_code >= 0.0 {
        let rule = "the digital front end's codes have a sign: rails -8388608 and 8388607";
        return Err(SettingsError::Conflict { field: "front_end", other: "force_min_code", rule });
    }
    Ok(())
}

/// Both front ends; one is in use.
pub struct Source {
    sampler: Sampler,
    converter: Converter,
    /// `None` until the first is chosen.
    in_use: Option<FrontEnd>,
}

impl Source {
    /// A source that is halted.
    pub fn new(sampler: Sampler, converter: Converter) -> Self {
        Self { sampler, converter, in_use: None }
    }
}

impl SampleSource for Source {
    fn pace(&self) -> Pace {
        Pace::Live
    }

    async fn read(&mut self, into: &mut [RawSample]) -> Result<usize, SourceError> {
        match self.in_use {
            Some(FrontEnd::Analogue) => self.sampler.read(into).await,
            Some(FrontEnd::Ads131m04) => self.converter.read(into).await,
            None => Err(SourceError::Unreadable),
        }
    }

    /// The sample counter continues, whichever front end follows; one index is skipped, because the samples before and
    /// after are not consecutive.
    async fn configure(&mut self, settings: &Settings) -> Result<(), SourceError> {
        self.halt().await;
        let index = match self.in_use {
            Some(FrontEnd::Analogue) => self.sampler.index().wrapping_add(1),
            Some(FrontEnd::Ads131m04) => self.converter.index().wrapping_add(1),
            None => 0,
        };
        self.in_use = Some(settings.front_end);
        match settings.front_end {
            FrontEnd::Analogue => self.sampler.configure(settings, index),
            FrontEnd::Ads131m04 => self.converter.configure(settings, index).await,
        }
    }

    async fn halt(&mut self) {
        match self.in_use {
            Some(FrontEnd::Analogue) => self.sampler.halt(),
            Some(FrontEnd::Ads131m04) => self.converter.halt(),
            None => {}
        }
    }
}
