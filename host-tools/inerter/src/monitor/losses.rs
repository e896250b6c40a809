//! Errors on the device and losses in transit, for a person.

use inerter_data::words::plural;
use inerter_wire::Health;

/// The note when frames of an unknown kind arrive.
pub const UNKNOWN_FRAMES: &str =
    "the device sends frames of a kind unknown to this program; a newer version may show more";

/// Counts since this program connected.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Losses {
    /// The latest health.
    pub health: Option<Health>,
    /// Frames that the device had dropped or not understood before this program connected.
    before: Option<(u32, u32)>,
    /// Frames lost in transit.
    pub lost_frames: u64,
    /// Frames dropped because this program does not know their contents.
    pub unknown_frames: u64,
}

impl Losses {
    /// Starts over for another device, or the same one restarted.
    pub fn begin(&mut self) {
        self.before = None;
    }

    /// The latest health.
    pub fn health(&mut self, health: Health) {
        self.before.get_or_insert((health.dropped_frames, health.bad_frames));
        self.health = Some(health);
    }

    /// Errors that the device has reported so far; `None` if there were none.
    pub fn problems(&self) -> Option<String> {
        let health = self.health?;
        let (dropped, bad) = self.before.unwrap_or_default();
        let list: Vec<String> = [
            (health.lost_samples, "sample", "lost"),
            (health.overruns.into(), "sampler overrun", ""),
            (health.saturated.into(), "saturated sample", ""),
            (health.dropped_frames.saturating_sub(dropped).into(), "frame", "dropped by the device"),
            (health.bad_frames.saturating_sub(bad).into(), "frame", "not understood by the device"),
        ]
        .into_iter()
        .filter(|(count, ..)| *count > 0)
        .map(|(count, thing, what)| format!("{} {what}", plural(count, thing)).trim_end().to_string())
        .collect();
        (!list.is_empty()).then(|| list.join(", "))
    }

    /// Whether nothing was lost or saturated, on the device or in transit.
    pub fn is_clean(&self) -> bool {
        self.lost_frames == 0 && self.problems().is_none()
    }

    /// One line: errors, processor load, temperature.
    pub fn line(&self) -> String {
        let mut parts = vec![self.problems().unwrap_or_else(|| "nothing lost or saturated".into())];
        if self.lost_frames > 0 {
            parts.push(format!("{} lost on the way", plural(self.lost_frames, "frame")));
        }
        if self.unknown_frames > 0 {
            parts.push(format!("{} of unknown kind left out", plural(self.unknown_frames, "frame")));
        }
        if let Some(load) = self.health.and_then(|health| health.cpu_load_permille) {
            parts.push(format!("processor {:.0} %", f64::from(load) / 10.0));
        }
        if let Some(temperature) = self.health.and_then(|health| health.temperature_c) {
            parts.push(format!("{temperature:.0} °C"));
        }
        parts.join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_happened_since_we_came_is_told() {
        let mut losses = Losses::default();
        let health = Health { dropped_frames: 7, bad_frames: 1, ..Health::default() };
        losses.health(health);
        assert!(losses.is_clean());
        assert_eq!(losses.line(), "nothing lost or saturated");
        losses.unknown_frames = 3;
        assert!(losses.is_clean(), "what a newer firmware says besides is no loss");
        losses.health(Health { dropped_frames: 9, saturated: 1, cpu_load_permille: Some(345), ..health });
        losses.lost_frames = 2;
        losses.unknown_frames = 1;
        assert_eq!(
            losses.line(),
            "1 saturated sample, 2 frames dropped by the device, 2 frames lost on the way, 1 frame of unknown kind left \
             out, processor 34 %"
        );
        assert!(!losses.is_clean());
    }
}
