//! The calibration steps with a device: what they ask of a person, and the samples that they take.

use inerter_analysis::{
    calibrate::{
        CalibrateError, Finding, Point, Step,
        direction::{Known, direction, refuse_saturated},
        encoder, finding,
        force::{self, Load},
        load_cell,
        rest::{self, Of, Watch},
        rounded_up, timebase,
    },
    skew::{Skew, skew},
};
use inerter_core::{Machine, Settings};
use inerter_data::{
    json::rounded_s,
    names::description,
    replay::replay,
    run::Run,
    text::{force_text, value_text},
    words::interval_text,
};
use inerter_device::Device;
use inerter_wire::catalogue;

use super::{
    dialogue::Dialogue,
    listen::{Heard, each_batch},
};
use crate::error::Error;

/// Time beyond the window that a load may take to come to rest \[s\].
const PATIENCE_S: f64 = 20.0;
/// Time for which a screw must stand still while its position is read \[s\].
const STAND_S: f64 = 1.0;

/// A device, the person beside it, and the settings as they would become.
pub struct Station<'a> {
    /// The device; nothing is written to it here.
    pub device: &'a mut Device,
    pub dialogue: &'a mut dyn Dialogue,
    /// The settings that findings are based on: the device's own, with those accepted so far.
    pub settings: Settings,
    /// Whether the person can be asked to try again.
    pub may_ask: bool,
}

impl Station<'_> {
    fn listen(&mut self, seconds: f64, keep_samples: bool) -> Result<Heard, Error> {
        let mut heard = Heard::listen(self.device, self.dialogue, seconds, keep_samples)?;
        heard.run.settings = self.settings;
        Ok(heard)
    }

    /// Waits until force or screw has been at rest for `seconds`. If a person can be asked, they may try again.
    fn settle(&mut self, of: Of, seconds: f64, origin: Option<i32>, at: &str) -> Result<(rest::Level, i32), Error> {
        loop {
            let refusal = match self.settle_once(of, seconds, origin, at)? {
                Ok(level) => return Ok(level),
                Err(refusal) => refusal,
            };
            if self.may_ask {
                self.dialogue.explain(&refusal);
                if self.dialogue.choose("once more?", &["yes", "no"])? == 0 {
                    continue;
                }
            }
            return Err(refusal.into());
        }
    }

    fn settle_once(
        &mut self,
        of: Of,
        seconds: f64,
        origin: Option<i32>,
        at: &str,
    ) -> Result<Result<(rest::Level, i32), CalibrateError>, Error> {
        let mut watch = Watch::new(&self.settings, of, seconds, origin);
        let dialogue = &mut *self.dialogue;
        each_batch(self.device, |_, samples| {
            for sample in &samples {
                if watch.take(sample) && watch.level(at).is_ok() {
                    return Ok(true);
                }
            }
            let listened_s = watch.heard_s();
            let label = if listened_s < 2.0 * seconds { "measuring" } else { "waiting for rest" };
            dialogue.progress(label, (listened_s / seconds).min(0.99))?;
            Ok(listened_s >= seconds + PATIENCE_S)
        })?;
        self.dialogue.progress("measuring", 1.0)?;
        Ok(watch.level(at).map(|level| (level, watch.origin.unwrap_or(0))))
    }

    /// Diagnosis of the force channel.
    pub fn load_cell(&mut self, seconds: f64) -> Result<Finding, Error> {
        let heard = self.listen(seconds.max(load_cell::LEAST_S), true)?;
        let rate = timebase::rate(&heard.arrivals, self.settings.sample_rate_hz).ok();
        Ok(load_cell::diagnose(&heard.run, rate)?)
    }

    /// The code at zero force.
    pub fn zero(&mut self, seconds: f64) -> Result<Finding, Error> {
        let (level, _) = self.settle(Of::Force, seconds, None, "")?;
        Ok(rest::zero(&level, &self.settings))
    }

    /// The force scale from these loads, applied one after the other.
    pub fn force(&mut self, loads: &[Load], loads_u95: f64, seconds: f64) -> Result<Finding, Error> {
        let mut readings = Vec::new();
        for (place, load) in loads.iter().enumerate() {
            let what = match load.force_n {
                0.0 => "take all loads off".to_string(),
                newtons if newtons > 0.0 => format!("put {} on", load.name),
                _ => format!("put {} on, in the negative direction", load.name.trim_start_matches('-')),
            };
            self.dialogue.ask(&format!("load {} of {}: {what}, then press Enter", place + 1, loads.len()), "")?;
            let at = format!(" at load {} of {} ({})", place + 1, loads.len(), load.name);
            let (level, _) = self.settle(Of::Force, seconds, None, &at)?;
            let newtons = self.settings.newtons_per_code.abs();
            self.dialogue.say(&format!(
                "  code {:.1} ± {:.1} (± {} by the scale in use)",
                level.code.value,
                level.code.u95,
                force_text(self.settings.machine, level.code.u95 * newtons)
            ));
            readings.push((load.clone(), level));
        }
        Ok(force::force(&readings, loads_u95, &self.settings)?)
    }

    /// Counts while the screw is turned by hand.
    pub fn turns(&mut self, revolutions: f64) -> Result<f64, Error> {
        self.dialogue.ask("set the screw to a mark, let go, then press Enter", "")?;
        let (start, origin) = self.settle(Of::Position, STAND_S, None, " at the mark")?;
        let turn = format!(
            "turn it by {} revolutions in the {} direction, back to the mark, let go, then press Enter",
            revolutions.abs(),
            if revolutions < 0.0 { "negative" } else { "positive" }
        );
        self.dialogue.ask(&turn, "")?;
        let (end, _) = self.settle(Of::Position, STAND_S, Some(origin), " at the mark")?;
        let counts = (end.count.value - start.count.value) * revolutions.signum();
        self.dialogue.say(&format!("  {counts:.0} counts"));
        Ok(counts)
    }

    /// Counts at these displacements, approached one after the other.
    pub fn displacements(&mut self, metres: &[f64]) -> Result<Vec<Point>, Error> {
        let (mut points, mut origin) = (Vec::new(), None);
        for (place, &applied) in metres.iter().enumerate() {
            let question = match applied {
                0.0 => "go to zero on the gauge".to_string(),
                metres => format!("go to {:+.4} mm on the gauge", 1e3 * metres),
            };
            let question =
                format!("displacement {} of {}: {question}, hold still, then press Enter", place + 1, metres.len());
            self.dialogue.ask(&question, "")?;
            let at = format!(" at displacement {} of {}", place + 1, metres.len());
            let (level, first) = self.settle(Of::Position, STAND_S, origin, &at)?;
            origin = Some(first);
            self.dialogue.say(&format!("  {:.1} counts", level.count.value));
            points.push(Point { applied, reading: level.count });
        }
        Ok(points)
    }

    /// Whether force and position have the same positive direction.
    pub fn direction(&mut self, seconds: f64, known: Known) -> Result<Finding, Error> {
        direction_of(&self.listen(seconds, true)?.run, known)
    }

    /// The residual delay of the force, under the settings as they would become.
    pub fn skew(&mut self, seconds: f64) -> Result<Finding, Error> {
        skew_of(&self.listen(seconds, true)?.run)
    }

    /// The device's clock against this computer's.
    pub fn timebase(&mut self, seconds: f64, host_ppm: f64) -> Result<Finding, Error> {
        let heard = self.listen(seconds, false)?;
        let rate = timebase::rate(&heard.arrivals, self.settings.sample_rate_hz)?;
        Ok(timebase::timebase(&rate, &self.settings, host_ppm))
    }

    /// Scale of the position from a displacement, or from the lead if there is no gauge.
    pub fn encoder(&mut self, encoder: &EncoderPlan) -> Result<Finding, Error> {
        encoder.check()?;
        let mut turned = None;
        if let Some(revolutions) = encoder.revolutions {
            let counts = self.turns(revolutions)?;
            let per_revolution = encoder::counts_per_revolution(counts, revolutions, encoder.lines)?;
            self.dialogue.say(&format!("  {per_revolution:.0} counts per revolution, {} lines", per_revolution / 4.0));
            turned = Some((per_revolution, counts));
        }
        let per_revolution =
            turned.map(|(per_revolution, _)| per_revolution).or(encoder.lines.map(|lines| 4.0 * lines));
        let mut finding = match (encoder.lead_m, turned) {
            (Some(lead_m), Some((per_revolution, counts))) if encoder.displacements_m.is_empty() => {
                encoder::by_lead(lead_m, encoder.lead_u95, per_revolution, counts, &self.settings)
            }
            _ => {
                let points = self.displacements(&encoder.displacements_m)?;
                encoder::displacement(&points, encoder.gauge_u95_m, per_revolution, encoder.lead_m, &self.settings)?
            }
        };
        finding.measure("counts_per_revolution", per_revolution.unwrap_or(f64::NAN));
        Ok(finding)
    }
}

/// How to find the scale of the position.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EncoderPlan {
    /// Revolutions to turn by hand; `None` skips the turning.
    pub revolutions: Option<f64>,
    /// Lines per revolution according to the encoder's label.
    pub lines: Option<f64>,
    /// Lead according to the data sheet \[m\].
    pub lead_m: Option<f64>,
    /// Its relative uncertainty.
    pub lead_u95: f64,
    /// Gauge readings to approach, one after the other; empty without a gauge \[m\].
    pub displacements_m: Vec<f64>,
    /// Uncertainty of the gauge \[m\].
    pub gauge_u95_m: f64,
}

impl EncoderPlan {
    /// Rejects a plan that cannot give a scale, before anybody turns anything.
    pub fn check(&self) -> Result<(), CalibrateError> {
        match (self.lead_m, self.revolutions) {
            _ if !self.displacements_m.is_empty() => Ok(()),
            (None, _) => Err(CalibrateError::Missing(
                "a lead or a displacement",
                "give --displacement with what a gauge shows, or --lead from the screw's data sheet with --revolutions",
            )),
            (_, None) => Err(CalibrateError::Missing(
                "a turn by hand",
                "give --revolutions: without it neither the counts nor the direction of the encoder are known",
            )),
            _ => Ok(()),
        }
    }
}

/// Describes a skew for a person.
pub fn skew_words(found: &Skew, machine: Machine) -> [String; 3] {
    let [before_n, after_n] = found.residual_rms_n;
    let force = |force_n| force_text(machine, force_n);
    let words = [
        format!("the force has a remaining delay of {} µs", interval_text(1e6 * found.left_s, 1e6 * found.u95_s)),
        format!(
            "viscous friction: {1} {0} as it is, {2} {0} without that delay",
            catalogue::unit(machine, "N s/m"),
            value_text(&found.viscous_before),
            value_text(&found.viscous_after)
        ),
        format!(
            "of a force of {} rms the law leaves {} unexplained as it is, {} without that delay",
            force(found.force_rms_n),
            force(before_n),
            force(after_n)
        ),
    ];
    words.map(|words| description(machine, &words))
}

/// Whether force and position have the same positive direction in a run.
pub fn direction_of(run: &Run, known: Known) -> Result<Finding, Error> {
    let outcome = replay(run, |_, _| Ok::<(), Error>(()))?;
    Ok(direction(run, &outcome, known)?)
}

/// The residual delay of the force in a run, as a finding.
fn skew_of(run: &Run) -> Result<Finding, Error> {
    let outcome = replay(run, |_, _| Ok::<(), Error>(()))?;
    refuse_saturated(&outcome, run)?;
    let found = skew(run, &outcome)?;
    let mut finding = Finding::new(Step::Skew);
    finding.measure("left_s", found.left_s);
    skew_words(&found, run.settings.machine).into_iter().for_each(|words| finding.say(words));
    if found.is_better_than(&run.settings) {
        finding.set_with("skew_s", rounded_s(found.skew_s), found.u95_s);
        finding.set("skew_u95_s", rounded_s(rounded_up(found.u95_s)));
    } else {
        let text = "nothing to change: this motion cannot improve on the skew in use";
        finding.remark(finding::Level::Note, "known", text);
    }
    Ok(finding)
}
