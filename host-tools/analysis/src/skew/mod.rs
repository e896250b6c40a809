//! The skew of a run: the delay of the force relative to the position, with its uncertainty.
//!
//! Whole samples come from the residual of the law (`delay`), the rest from the coefficient of the force's rate in a
//! fit with the law and any further friction (`round`), repeated until nothing is left. Then neither the error of the
//! series that corrects it nor noise in that rate matters.

mod delay;
mod friction;
mod round;
mod rows;
mod signs;

use inerter_core::{Machine, Parameter, Settings};
use inerter_data::{
    names::description,
    replay::{Outcome, replay},
    run::Run,
    series::Series,
    settings::SettingsInputError,
    text::force_text,
};
use miette::Diagnostic;

use self::{
    delay::{MOST_S, delay_s},
    round::Round,
};
use crate::fit::FitError;

/// Fraction of the square of the force's rate that the other terms must leave, for a delay to be distinguished from
/// viscous friction: a tone of 15.9 Hz leaves 0.0004, two tones that are a tenth apart 0.005, a random motion 0.06 and
/// more.
const LEAST_LEFT: f64 = 0.002;
/// Maximum fraction of that which may be noise of the force.
const MOST_NOISE: f64 = 0.5;
/// Maximum width of the interval, in radians of the force's own frequency: beyond it a tenth of the inertance's force
/// could be friction.
const WIDEST_RAD: f64 = 0.1;
/// Fraction of the interval that may remain uncorrected, and maximum number of rounds.
const SETTLED: f64 = 0.02;
const MOST_ROUNDS: usize = 8;

/// Why a motion cannot identify the skew.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum SkewError {
    /// Too few samples are usable.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Fit(#[from] FitError),
    /// The force rate is proportional to the velocity.
    #[error(
        "{}",
        description(*machine, &format!(
            "this motion cannot identify a skew: the force changes in step with the velocity (only {:.2} % of the square of its \
             rate remains), as in a single tone, where a delay and viscous friction are indistinguishable",
            left * 100.0
        ))
    )]
    #[diagnostic(
        code(inerter::skew::tone),
        help("move with several frequencies at once: two tones, a random motion, or moves from point to point")
    )]
    SingleTone {
        /// Kind of the machine.
        machine: Machine,
        /// Fraction of the force rate's square that the other regressors leave.
        left: f64,
    },
    /// Noise dominates.
    #[error(
        "{}",
        description(*machine, &format!(
            "noise hides the skew in this motion: of a force of {} rms the law leaves {} unexplained, and the skew would be \
             uncertain by {:.2} ms",
            force_text(*machine, *force_rms_n),
            force_text(*machine, *residual_rms_n),
            u95_s * 1e3
        ))
    )]
    #[diagnostic(
        code(inerter::skew::noise),
        help("move harder, faster or for longer; `inerter calibrate load-cell` says how to reduce the force noise")
    )]
    TooNoisy {
        /// Kind of the machine.
        machine: Machine,
        /// Force, without its mean \[N\].
        force_rms_n: f64,
        /// RMS residual \[N\].
        residual_rms_n: f64,
        /// Half width that the interval would have \[s\].
        u95_s: f64,
    },
    /// The residual still falls at the end of the correctable range.
    #[error(
        "{}",
        description(*machine, &format!(
            "force and position are more than {:.0} ms apart, which is more than the setting skew_s can correct",
            MOST_S * 1e3
        ))
    )]
    #[diagnostic(
        code(inerter::skew::beyond),
        help(
            "look for a filter or a buffer in one of the channels, or for two clocks; shift a CSV by whole samples first"
        )
    )]
    Beyond {
        /// Kind of the machine.
        machine: Machine,
    },
    /// The force acts in the wrong direction, for any delay.
    #[error(
        "{}",
        description(*machine, "no skew gives a positive inertance: the force has the wrong sign")
    )]
    #[diagnostic(
        code(inerter::skew::backwards),
        help("change the sign of newtons_per_code or metres_per_count: `inerter calibrate direction`")
    )]
    Backwards {
        /// Kind of the machine.
        machine: Machine,
    },
    /// The settings cannot be used.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Settings(#[from] SettingsInputError),
}

/// The skew of a run, and its effect on the fit.
#[derive(Clone, Copy, Debug)]
pub struct Skew {
    /// Total delay of the force relative to the position \[s\].
    pub skew_s: f64,
    /// Delay beyond the skew in use \[s\].
    pub left_s: f64,
    /// Half width of its 95 % interval \[s\].
    pub u95_s: f64,
    /// Viscous friction with the skew in use \[N s/m\], for the whole run.
    pub viscous_before: Parameter,
    /// Viscous friction with the skew found corrected \[N s/m\].
    pub viscous_after: Parameter,
    /// Residual of the law with the skew in use, and with the skew found corrected, rms \[N\].
    pub residual_rms_n: [f64; 2],
    /// Force without its mean, rms \[N\].
    pub force_rms_n: f64,
}

impl Skew {
    /// Whether it improves on the skew in use: a delay beyond its interval remains, or the interval is the smaller one.
    pub fn is_better_than(&self, settings: &Settings) -> bool {
        self.left_s.abs() > self.u95_s || self.u95_s < settings.skew_u95_s
    }
}

/// Finds the skew of a run with this outcome of the estimator.
pub fn skew(run: &Run, outcome: &Outcome) -> Result<Skew, SkewError> {
    let series = Series::of(run);
    let settings = &run.settings;
    let machine = settings.machine;
    let skew_s = delay_s(&series, settings, outcome.estimate.bank);
    let mut run = Run { settings: Settings { skew_s: skew_s.unwrap_or(settings.skew_s), ..*settings }, ..run.clone() };
    let round = |run: &Run| -> Result<Round, SkewError> { Ok(Round::of(&replayed(run)?, &series, &run.settings)?) };
    let mut found = round(&run)?;
    for _ in 0..MOST_ROUNDS {
        let skew_s = (run.settings.skew_s + found.left_s).clamp(-MOST_S, MOST_S);
        let is_left = found.left_s.abs() > SETTLED * found.u95_s;
        if !is_left || skew_s == run.settings.skew_s {
            break;
        }
        run.settings.skew_s = skew_s;
        found = round(&run)?;
    }
    check(&found, machine)?;
    if skew_s.is_none() {
        return Err(SkewError::Backwards { machine });
    }
    if found.left_s.abs() > found.u95_s {
        return Err(SkewError::Beyond { machine });
    }
    // The part that could not be corrected, at the end of the range.
    found.u95_s += found.left_s.abs();
    let skew_s = run.settings.skew_s;
    run.settings.skew_u95_s = found.u95_s;
    let after = replayed(&run)?;
    Ok(Skew {
        skew_s,
        left_s: skew_s - settings.skew_s,
        u95_s: found.u95_s,
        viscous_before: outcome.estimate.whole_run.viscous_n_s_per_m,
        viscous_after: after.estimate.whole_run.viscous_n_s_per_m,
        residual_rms_n: [outcome, &after].map(|outcome| f64::from(outcome.estimate.residual_rms_n)),
        force_rms_n: found.force_rms_n,
    })
}

fn replayed(run: &Run) -> Result<Outcome, SkewError> {
    replay(run, |_, _| Ok(()))
}

/// Rejects what a motion cannot identify.
fn check(found: &Round, machine: Machine) -> Result<(), SkewError> {
    let Round { u95_s, left, noise, residual_rms_n, force_rms_n, frequency, .. } = *found;
    let is_wide = u95_s * frequency > WIDEST_RAD || u95_s > MOST_S;
    if noise > MOST_NOISE || is_wide && left > LEAST_LEFT {
        return Err(SkewError::TooNoisy { machine, force_rms_n, residual_rms_n, u95_s });
    }
    if left < LEAST_LEFT {
        return Err(SkewError::SingleTone { machine, left });
    }
    Ok(())
}
