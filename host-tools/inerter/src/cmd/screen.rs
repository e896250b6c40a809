//! The block that `inerter monitor` redraws in a terminal.

use inerter::{
    output::{self, OutputError},
    report::{duration_text, plural, table},
};
use inerter_core::{Detail, Estimate, Settings};
use inerter_wire::Health;

/// What is known at the moment.
#[derive(Default)]
pub struct View {
    pub device: String,
    pub port: String,
    pub settings: Settings,
    pub estimate: Option<(f64, Estimate)>,
    pub detail: Option<Detail>,
    /// An estimate that is not shown yet.
    pub waiting: Option<Estimate>,
    /// The latest change of the device measured.
    pub change: Option<String>,
    pub health: Option<Health>,
    /// Frames that the device had dropped or not understood before we came.
    pub before: Option<(u32, u32)>,
    pub lost_frames: u64,
    pub message: Option<String>,
}

impl View {
    /// What the device says went wrong so far; `None` when nothing did.
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
        if list.is_empty() { None } else { Some(list.join(", ")) }
    }

    /// Time of a sample on the clock of the estimates; not known before the first of them.
    pub fn time_of(&self, index: u32) -> Option<f64> {
        let (t_s, estimate) = self.estimate?;
        let after = index.wrapping_sub(estimate.index).cast_signed();
        Some(t_s + f64::from(after) / self.settings.sample_rate_hz)
    }

    fn lines(&self) -> Vec<String> {
        let mut lines = vec![format!("{} at {}", self.device, self.port)];
        match &self.estimate {
            Some((t_s, estimate)) => {
                let motion = if estimate.moving { "moving" } else { "at rest" };
                lines.push(format!("{}, {motion}, residual {:.2} N", duration_text(*t_s), estimate.residual_rms_n));
                lines.push(String::new());
                let table = table(estimate, self.detail.as_ref(), &self.settings, None);
                lines.extend(table.lines().map(str::to_string));
                lines.extend(self.change.clone());
            }
            None => lines.push("waiting for the first estimate".into()),
        }
        lines.push(String::new());
        let mut health = vec![self.problems().unwrap_or_else(|| "nothing lost or saturated".into())];
        if self.lost_frames > 0 {
            health.push(format!("{} lost on the way", plural(self.lost_frames, "frame")));
        }
        if let Some(load) = self.health.and_then(|health| health.cpu_load_permille) {
            health.push(format!("processor {:.0} %", f64::from(load) / 10.0));
        }
        if let Some(temperature) = self.health.and_then(|health| health.temperature_c) {
            health.push(format!("{temperature:.0} °C"));
        }
        lines.push(health.join(", "));
        lines.push(self.message.clone().unwrap_or_else(|| "Ctrl-C ends".into()));
        lines
    }
}

/// A block of lines in the terminal.
#[derive(Default)]
pub struct Screen {
    height: usize,
}

impl Screen {
    /// Draws the view over the one before.
    pub fn draw(&mut self, view: &View) -> Result<(), OutputError> {
        let lines = view.lines();
        let up = if self.height == 0 { String::new() } else { format!("\x1b[{}A", self.height) };
        // Each line erases what stood behind its end, the last one all below.
        let body: String = lines.iter().map(|line| format!("{line}\x1b[K\n")).collect();
        self.height = lines.len();
        output::text(format!("{up}\r{body}\x1b[J"))?;
        output::flush()
    }
}
