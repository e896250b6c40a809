//! Compares a device's behaviour with the required one.

use inerter_app::wear::{FACTORY_RESET, SAVES};
use inerter_core::Settings;
use inerter_wire::{Command, Done, Record, Refusal, Reply, SettingsValues, Source};

use super::{
    device::{Conditions, End, PROBE, Played, accepts, defaults, with_probe},
    requests::{Requests, restarts},
};

/// The expected state of the device after the accepted requests.
struct Model {
    settings: Settings,
    saved: Option<SettingsValues>,
    source: Source,
    /// The used part of the allowance for immediate saves.
    saves: u32,
}

impl Model {
    /// Whether `result` is a valid reply to `command`. Applies the changes that the command makes. `told` are the
    /// settings sent since the previous reply.
    fn takes(
        &mut self,
        command: Option<&Command>,
        result: &Result<Done, Refusal>,
        told: Option<&SettingsValues>,
    ) -> bool {
        let Some(command) = command else { return *result == Err(Refusal::Unsupported) };
        if let (Err(Refusal::Worn { .. }), Command::SaveSettings | Command::FactoryReset) = (result, command) {
            // The allowance recovers with time, which the model does not track.
            return self.saves + saves_of(command) > u32::from(SAVES);
        }
        let plain = *result == Ok(Done::Plain);
        self.saves += saves_of(command);
        match command {
            // The virtual device can neither measure itself nor play.
            Command::Measure(_) | Command::Play(_) => *result == Err(Refusal::Unsupported),
            Command::ReadSaved if self.saved.is_none() => *result == Err(Refusal::NothingSaved),
            Command::Hello
            | Command::ReadSettings
            | Command::ReadSaved
            | Command::Streams(_)
            | Command::ResetEstimator
            | Command::EnterDfu
            | Command::Reboot => plain,
            Command::WriteSettings(values) => match self.write(values) {
                Ok(settings) => {
                    self.settings = settings;
                    plain
                }
                Err(refusal) => *result == Err(refusal),
            },
            Command::SaveSettings => {
                self.saved = Some(SettingsValues::from(&self.settings));
                plain
            }
            Command::FactoryReset => {
                (self.settings, self.saved) = (defaults(), None);
                plain
            }
            Command::Tare => match self.source {
                Source::Stopped => *result == Err(Refusal::NoSamples),
                Source::Link => *result == Err(Refusal::Busy),
                Source::Sampler if plain => self.tare(told),
                Source::Sampler => *result == Err(Refusal::NoSamples),
            },
            Command::Start => {
                self.source = Source::Sampler;
                plain
            }
            Command::Stop => {
                self.source = Source::Stopped;
                plain
            }
            Command::Inject(samples) if samples.check().is_err() => *result == Err(Refusal::BadSamples),
            Command::Inject(_) => {
                self.source = Source::Link;
                matches!(result, Ok(Done::Injected { .. }) | Err(Refusal::QueueFull { .. }))
            }
            Command::InjectEnd if self.source != Source::Link => *result == Err(Refusal::NotInjecting),
            Command::InjectEnd => {
                self.source = Source::Stopped;
                matches!(result, Ok(Done::Injected { .. }))
            }
        }
    }

    fn write(&self, values: &SettingsValues) -> Result<Settings, Refusal> {
        let settings = values.write(&self.settings)?;
        let checked = settings.validate().map(|_| ()).and_then(|()| accepts(&settings));
        checked.map(|()| settings).map_err(|error| Refusal::of_setting(&error, u8::MAX))
    }

    /// A tare may change the zero of the force, and nothing else.
    fn tare(&mut self, told: Option<&SettingsValues>) -> bool {
        let read = told.map(|told| told.read(&defaults())).filter(|reading| reading.impossible == 0);
        let Some(zero) = read.map(|reading| reading.settings.force_zero_code) else { return false };
        self.settings.force_zero_code = zero;
        zero > self.settings.force_min_code && zero < self.settings.force_max_code
    }
}

/// Share of the allowance for immediate saves that a command uses.
fn saves_of(command: &Command) -> u32 {
    match command {
        Command::SaveSettings => 1,
        Command::FactoryReset => u32::from(FACTORY_RESET),
        _ => 0,
    }
}

/// Whether a successful command reports the settings.
fn tells(command: &Command) -> bool {
    matches!(command, Command::ReadSettings | Command::WriteSettings(_) | Command::Tare | Command::FactoryReset)
}

/// Everything wrong with the device's response.
pub fn judge(stream: &[u8], conditions: &Conditions, played: &Played) -> Vec<String> {
    let mut findings: Vec<String> =
        played.faults.iter().map(|fault| format!("sent what is no record: {fault}")).collect();
    let requests = Requests::read(&with_probe(stream));
    if conditions.deaf {
        findings.extend(judge_deaf(played, &requests));
        return findings;
    }
    let source = if conditions.sampling { Source::Sampler } else { Source::Stopped };
    let mut model = Model { settings: defaults(), saved: None, source, saves: 0 };
    let mut due = requests.intact.iter();
    let mut told: Option<&SettingsValues> = None;
    let mut restarted = false;
    for record in &played.records {
        match record {
            Record::Settings(values) => told = Some(values),
            Record::Saved(values) if model.saved.as_ref() != Some(values) => {
                findings.push(format!("it says that {values:?} is saved"));
            }
            Record::Reply(Reply { id, result }) => {
                let Some((expected, command)) = due.next() else {
                    findings.push(format!("a reply to {id} that nobody waits for: {result:?}"));
                    break;
                };
                let command = command.as_ref();
                if id != expected {
                    findings.push(format!("a reply to {id} where one to {expected} is due ({command:?})"));
                    break;
                }
                if !model.takes(command, result, told) {
                    findings.push(format!("request {id}, {command:?}, was answered by {result:?}"));
                    break;
                }
                let settings = SettingsValues::from(&model.settings);
                let tells = result.is_ok() && command.is_some_and(tells);
                match told.take() {
                    Some(_) if result.is_err() => {
                        findings.push(format!("request {id} was refused and changed settings"))
                    }
                    Some(values) if *values != settings => {
                        findings
                            .push(format!("after request {id} the settings are {values:?} instead of {settings:?}"));
                    }
                    None if tells => findings.push(format!("request {id}, {command:?}, told no settings")),
                    _ => {}
                }
                restarted |= result.is_ok() && command.is_some_and(restarts);
            }
            _ => {}
        }
    }
    match &played.end {
        End::Running if restarted => findings.push("a restart was promised and did not come".into()),
        End::Running => {
            if findings.is_empty()
                && let Some((id, command)) = due.next()
            {
                findings.push(format!("request {id}, {command:?}, got no reply"));
            }
            findings.extend(judge_health(played, requests.bad_frames, false));
        }
        End::Restarted(_) if restarted => {}
        other => findings.push(format!("ended: {other:?}")),
    }
    if findings.is_empty() && played.kept != Ok(model.saved.clone()) {
        findings.push(format!("flash keeps {:?} instead of {:?}", played.kept, model.saved));
    }
    findings
}

/// A host that does not read misses replies without knowing which. The device must respond again once the host reads.
fn judge_deaf(played: &Played, requests: &Requests) -> Option<String> {
    let mut due = requests.intact.iter();
    let replies: Vec<u16> = played.replies().map(|reply| reply.id).collect();
    if let Some(id) = replies.iter().find(|&&id| !due.any(|(expected, _)| *expected == id)) {
        return Some(format!("a reply to {id} that nobody waits for"));
    }
    match &played.end {
        End::Restarted(_) if requests.replies() < requests.intact.len() => None,
        End::Running if !replies.ends_with(&PROBE.map(|(id, _)| id)) => Some("the probe got no reply".into()),
        End::Running => judge_health(played, requests.bad_frames, true),
        other => Some(format!("ended: {other:?}")),
    }
}

/// Compares the last health record, which the probe requested, with the reader's counts.
fn judge_health(played: &Played, bad_frames: u32, deaf: bool) -> Option<String> {
    let health = played.records.iter().rev().find_map(|record| match record {
        Record::Health(health) => Some(health),
        _ => None,
    });
    let Some(health) = health else { return Some("no health record".into()) };
    // A host cannot notice frames dropped before the first frame that it reads.
    let unseen = if deaf { health.dropped_frames.saturating_sub(played.counts.lost) } else { 0 };
    if health.dropped_frames != played.counts.lost + unseen {
        return Some(format!("{} frames dropped, {} missing", health.dropped_frames, played.counts.lost));
    }
    (health.bad_frames != bad_frames)
        .then(|| format!("{} bad frames counted instead of {bad_frames}", health.bad_frames))
}
