//! Contents of a run's page.

use inerter_analysis::law::{Kernels, Law};
use inerter_analysis::rows::Row;
use inerter_analysis::{
    fit::{Beside, Products, directions},
    identify::Parameters,
    response::{self, Response},
    results::{Replayed, replayed},
    told::Told,
};
use inerter_core::{Change, Parameter, Reversal, Settings, Warning, WarningKind};
use inerter_data::{gated::Gated, replay::Outcome, run::Run, series::Series, settings::SettingsInputError};
use inerter_wire::{Estimated, EstimatorEvent};

/// Rows of the law per box, over the whole run and in the close-up.
const ROWS: usize = 2;
const CLOSE_ROWS: usize = 16;
/// Periods of the motion in the close-up.
const CLOSE_PERIODS: f64 = 5.0;

/// Contents of a run's page.
#[derive(Clone, Debug)]
pub struct Content {
    /// The run without its samples.
    pub run: Run,
    /// From its first sample to its last \[s\].
    pub duration_s: f64,
    /// Its result.
    pub replayed: Replayed,
    /// The estimates during the run, with their times \[s\].
    pub moments: Vec<(f64, Estimated)>,
    /// Accepted reversals with their times \[s\].
    pub reversals: Vec<(f64, Reversal)>,
    /// Changes of the device with their times \[s\].
    pub changes: Vec<(f64, Change)>,
    /// The estimator's warnings about samples, and their times \[s\].
    pub warnings: Vec<(f64, Warning)>,
    /// Sample faults that only the whole run shows.
    pub unseen: Vec<WarningKind>,
    /// The law as drawn: the fit to all motion since the last change.
    pub law: Law,
    /// Force and law over the whole run, or since the last change.
    pub rows: Vec<Row>,
    /// Force and law in a close-up around the middle.
    pub close: Vec<Row>,
    /// The measured frequency response.
    pub response: Response,
    /// The complete linear model.
    pub model: Parameters,
    /// Equivalent viscous friction of the dry friction in this motion \[N s/m\].
    pub equivalent_viscous: Option<f64>,
}

impl Content {
    /// Runs a run through the estimator; `progress` gets the completed fraction.
    pub fn of(mut run: Run, mut progress: impl FnMut(f64)) -> Result<Self, SettingsInputError> {
        let (mut moments, mut reversals) = (Vec::new(), Vec::new());
        let (mut changes, mut warnings) = (Vec::new(), Vec::new());
        let (settings, start_s, duration_s) = (run.settings, run.start_s, run.duration_s());
        let samples = run.samples.iter().copied().map(Ok::<_, SettingsInputError>);
        let replayed = replayed(&settings, start_s, samples, |t_s, event| {
            match *event {
                EstimatorEvent::Reversal(reversal) => reversals.push((t_s, reversal)),
                EstimatorEvent::Changed(change) => changes.push((t_s, change)),
                EstimatorEvent::Warned(warning) => warnings.push((t_s, warning)),
                EstimatorEvent::Estimate(estimated) => {
                    moments.push((t_s, estimated));
                    progress(0.5 * (t_s - start_s) / duration_s.max(1e-9));
                }
            }
            Ok(())
        })?;
        // The whole run shows more than its last minute, including faults that the estimator had no time to detect.
        let told: Vec<Warning> = warnings.iter().map(|(_, warning)| *warning).collect();
        let unseen = Gated::of(&run, &told).left_out;
        let unseen = unseen.into_iter().filter(|kind| told.iter().all(|warning| warning.kind != *kind)).collect();
        let mut series = Series::of(&run);
        run.samples = Vec::new();
        // Before the last change the device was different.
        let since_s = changes.last().map_or(start_s, |(t_s, _)| *t_s);
        series.cut_before(since_s);
        let outcome = &replayed.outcome;
        let law = drawn_law(outcome, &settings);
        let kernels = Kernels::new(outcome.estimate.bank, series.period_s);
        let all = (f64::NEG_INFINITY, f64::INFINITY);
        let rows = kernels.rows(&series, &settings, &law, all, ROWS);
        progress(0.7);
        let end_s = start_s + duration_s;
        let (middle_s, half_s) = ((since_s + end_s) / 2.0, close_s(outcome, end_s - since_s) / 2.0);
        let window = (middle_s - half_s, middle_s + half_s);
        let close = kernels.rows(&series, &settings, &law, window, CLOSE_ROWS);
        let response = response::measured(&series);
        let equivalent_viscous = response::equivalent_viscous(&series, law.coulomb_n);
        let model = model(outcome, &settings, &law);
        progress(1.0);
        Ok(Self {
            run,
            duration_s,
            replayed,
            moments,
            reversals,
            changes,
            warnings,
            unseen,
            law,
            rows,
            close,
            response,
            model,
            equivalent_viscous,
        })
    }

    /// What it reports about each parameter: as [`Replayed::told`], with sample faults found from the whole run.
    pub fn told(&self) -> Told {
        let are_wrong = self.replayed.wrong_samples() > 0 || !self.unseen.is_empty();
        Told::new(&self.replayed.outcome, &self.replayed.judged, are_wrong)
    }

    /// The same without the data for figures.
    #[must_use]
    pub fn light(self) -> Self {
        let response = Response { points: Vec::new(), ..self.response };
        let (moments, reversals, rows, close) = Default::default();
        Self { moments, reversals, rows, close, response, ..self }
    }

    /// RMS of the law's residual over all rows \[N\], and the fraction of the force's variance that the law explains.
    pub fn residual(&self) -> Option<(f64, f64)> {
        let moving: Vec<&Row> =
            self.rows.iter().filter(|row| row.law_n.is_finite() && row.force_n.is_finite()).collect();
        let n = moving.len() as f64;
        let mean = moving.iter().map(|row| row.force_n).sum::<f64>() / n;
        let (left, all) = moving.iter().fold((0.0, 0.0), |(left, all), row| {
            (left + (row.force_n - row.law_n).powi(2), all + (row.force_n - mean).powi(2))
        });
        (n > 2.0 && all > 0.0).then(|| ((left / n).sqrt(), 1.0 - left / all))
    }

    /// The true value of a simulated device's parameter, by name, at the end of the run.
    pub fn truth(&self, name: &str) -> Option<f64> {
        self.later_truth(name).map(|(_, value)| value).or_else(|| self.first_truth(name))
    }

    /// The same before the change.
    pub fn first_truth(&self, name: &str) -> Option<f64> {
        self.run.truth.as_ref()?.get(name)?.parse().ok()
    }

    /// The change of a true value: when \[s\], and to what.
    pub fn later_truth(&self, name: &str) -> Option<(f64, f64)> {
        Some((self.first_truth("change_at_s")?, self.first_truth(&format!("changed_{name}"))?))
    }
}

/// The fit to all motion since the last change: its values belong together, even those without a valid interval of
/// their own.
fn drawn_law(outcome: &Outcome, settings: &Settings) -> Law {
    let (sums, more) = outcome.sums();
    let fitted =
        Products::of(sums, more).and_then(|products| directions(&products, settings, &Beside::of(outcome), None));
    let parameters = fitted.map_or(outcome.estimate.whole_run, |fit| fit.symmetric);
    let value = |parameter: Parameter| {
        Some(f64::from(parameter.fitted().value)).filter(|value| value.is_finite()).unwrap_or(0.0)
    };
    Law {
        inertance_kg: value(parameters.inertance_kg),
        viscous_n_s_per_m: value(parameters.viscous_n_s_per_m),
        coulomb_n: value(parameters.coulomb_n),
        offset_n: value(parameters.offset_n),
    }
}

/// Length of a close-up with a few periods of the motion \[s\].
fn close_s(outcome: &Outcome, duration_s: f64) -> f64 {
    let low_hz = f64::from(outcome.detail.band.low_hz);
    let wanted_s = if low_hz > 0.0 { CLOSE_PERIODS / low_hz } else { 2.0 };
    wanted_s.clamp(0.25, 120.0).min(duration_s)
}

fn model(outcome: &Outcome, settings: &Settings, law: &Law) -> Parameters {
    let contact = |measured: Parameter, set: f64| {
        measured.usable().filter(|found| found.value > 0.0).map_or(set, |found| f64::from(found.value))
    };
    Parameters {
        inertance_kg: law.inertance_kg,
        viscous_n_s_per_m: law.viscous_n_s_per_m,
        stiffness_n_per_m: contact(outcome.detail.stiffness_n_per_m, settings.stiffness_n_per_m),
        contact_damping_n_s_per_m: contact(
            outcome.detail.contact_damping_n_s_per_m,
            settings.contact_damping_n_s_per_m,
        ),
        structure_mass_kg: settings.structure_mass_kg,
        skew_s: settings.skew_s,
        ..Parameters::default()
    }
}

#[cfg(test)]
#[path = "content_tests.rs"]
mod tests;
