//! The uncertainty of the complete model's parameters.
//!
//! `U95 = sqrt((r^2 (3 se + model))^2 + pattern^2 + sum B^2)`, with `r` the ratio of the residual to what the noise
//! explains, if above 1. `se` is the larger of two: that from `inv(J'J) (J' P J) inv(J'J)`, with `P` the actual scatter
//! of the whitened residual around each frequency, so that a coloured residual widens the interval; and the scatter of
//! the parameters when noise like the terminal's own is added to its motion, because impacts make that noise large at
//! some moments and correlate the frequencies. `B` is the effect of an error of the force gain, the lead and the clock:
//! the response of the fit to that change of the data. A periodic motion repeats the encoder's steps, and averaging
//! does not remove them: *pattern* is twice the scatter of the parameters over different phases of the encoder within a
//! count.

use inerter_core::Settings;
use inerter_core::constants::COVERAGE;
use nalgebra::{DMatrix, DVector};

use super::{
    complete::{Fitted, Task, cost_with, counting, error_rows, prediction},
    parameters::{Name, Parameters},
    prepared::{Prepared, motion},
    result::{Correlation, Found, FoundStatus},
};
use crate::law::ends;

/// Number of encoder phases within a count that are tried.
const PHASES: usize = 8;
/// Correlation above which two parameters are reported together.
const TOGETHER: f64 = 0.9;
/// Relative interval above which a profile is computed.
const WEAK: f64 = 0.1;
/// Maximum number of profiles.
const MOST_PROFILES: usize = 3;

/// Backlash above which the flanks are assumed to part \[m\].
const LEAST_BACKLASH_M: f64 = 1e-6;
/// Factor on the standard error if flanks part and meet: the effect of the terminal's noise there is not proportional
/// to it (docs/tables/identify.md).
const IMPACTS: f64 = 2.0;
/// Ratio of the motion's frequency to the device's natural frequency below which the contact's deflection comes from
/// friction alone: it changes only where the screw reverses, and the encoder's steps are not noise there.
const SLOWEST: f64 = 0.02;

/// Errors of one fit.
pub struct Errors<'a> {
    fitted: &'a Fitted,
    stretches: &'a [Prepared],
    covariance: DMatrix<f64>,
    naive: DVector<f64>,
    /// Squares of the standard errors.
    variance: Vec<f64>,
    systematic: Vec<f64>,
}

impl<'a> Errors<'a> {
    /// `None` if the normal matrix cannot be inverted at all.
    pub fn of(fitted: &'a Fitted, stretches: &'a [Prepared], settings: &Settings) -> Option<Self> {
        let jacobian = &fitted.jacobian;
        // Normalised columns, so that units do not affect singularity.
        let lengths: Vec<f64> = jacobian.column_iter().map(|column| column.norm().max(1e-300)).collect();
        let mut scaled = jacobian.clone();
        scaled.column_iter_mut().zip(&lengths).for_each(|(mut column, length)| column /= *length);
        let unit =
            DMatrix::from_diagonal(&DVector::from_iterator(lengths.len(), lengths.iter().map(|length| 1.0 / length)));
        // A direction with an eigenvalue below 1e-12 gets an infinite interval, not a meaningless one.
        let eigen = scaled.tr_mul(&scaled).symmetric_eigen();
        let inverted = eigen.eigenvalues.map(|value| 1.0 / value.max(1e-12));
        let inverse = &eigen.eigenvectors * DMatrix::from_diagonal(&inverted) * eigen.eigenvectors.transpose();
        let inverse = &unit * inverse * &unit;
        let mut weighted = jacobian.clone();
        for (mut row, power) in weighted.row_iter_mut().zip(&fitted.power) {
            row *= power.sqrt();
        }
        let covariance = &inverse * weighted.tr_mul(&weighted) * &inverse;
        if !covariance.iter().all(|value| value.is_finite()) {
            return None;
        }
        let moved = |rows: DVector<f64>| -> DVector<f64> { &inverse * jacobian.tr_mul(&rows) };
        let still = |prepared: &Prepared| vec![0.0; prepared.force.len()];
        let about = |values: &[f64]| -> Vec<f64> {
            let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
            values.iter().map(|value| value - mean).collect()
        };
        let gain = moved(error_rows(stretches, fitted, &|_, prepared| {
            (still(prepared), prepared.force.iter().map(|force| force * settings.force_gain_u95).collect())
        }));
        let lead = moved(error_rows(stretches, fitted, &|_, prepared| {
            (about(&prepared.position).iter().map(|x| x * settings.lead_u95).collect(), still(prepared))
        }));
        let mut terminal = DVector::<f64>::zeros(lengths.len());
        for rows in &fitted.disturbed {
            terminal += moved(rows.clone()).map(|step| step * step) / fitted.disturbed.len() as f64;
        }
        let variance = covariance.diagonal().iter().zip(&terminal).map(|(a, b)| a.max(*b)).collect();
        let predicted = |(number, prepared): (usize, &Prepared)| prediction(&fitted.state, number, prepared).0;
        let predictions: Vec<Vec<f64>> = stretches.iter().enumerate().map(predicted).collect();
        let mut pattern = DVector::<f64>::zeros(lengths.len());
        for phase in 0..PHASES {
            let phase = phase as f64 / PHASES as f64;
            let steps = moved(error_rows(stretches, fitted, &|number, prepared| {
                let count = prepared.step_m;
                (
                    predictions[number]
                        .iter()
                        .map(|x| ((x / count + phase).floor() + 0.5 - phase) * count - x)
                        .collect(),
                    still(prepared),
                )
            }));
            pattern += steps.map(|step| step * step) / PHASES as f64;
        }
        let systematic = fitted
            .free
            .iter()
            .enumerate()
            .map(|(place, name)| {
                let scale = name.scale(&fitted.state.parameters);
                let clock = match name {
                    Name::Inertance => 2.0,
                    Name::Viscous | Name::Damping => 1.0,
                    _ => 0.0,
                };
                let clock = clock * settings.timebase_u95 * name.of(&fitted.state.parameters);
                let squares = gain[place].powi(2) + lead[place].powi(2) + 4.0 * pattern[place];
                (scale * scale * squares + clock * clock).sqrt()
            })
            .collect();
        Some(Self { fitted, stretches, naive: inverse.diagonal(), covariance, variance, systematic })
    }

    fn place(&self, name: Name) -> Option<usize> {
        self.fitted.free.iter().position(|other| *other == name)
    }

    /// The fitted parameters.
    fn parameters(&self) -> &Parameters {
        &self.fitted.state.parameters
    }

    /// Standard error in the parameter's unit.
    fn error(&self, place: usize) -> f64 {
        self.fitted.free[place].scale(self.parameters()) * self.variance[place].max(0.0).sqrt()
    }

    /// Half width of the interval.
    pub fn u95(&self, name: Name) -> Option<f64> {
        let place = self.place(name)?;
        let impacts = if self.parameters().backlash_m > LEAST_BACKLASH_M { IMPACTS } else { 1.0 };
        // A residual that noise does not explain need not average out.
        let doubt = self.fitted.over_noise().powi(2).max(1.0);
        let chance = (impacts * COVERAGE * self.error(place)).hypot(model_u95(name, self.parameters()));
        Some((doubt * chance).hypot(self.systematic[place]))
    }

    /// Half width of the interval of a file's offset.
    pub fn offset_u95(&self, file: usize, gain: f64, value: f64) -> Option<f64> {
        let error = self.variance.get(self.fitted.free.len() + file)?.max(0.0).sqrt();
        Some((COVERAGE * error).hypot(gain * value))
    }

    /// Correlations of the shared parameters.
    pub fn correlation(&self) -> Correlation {
        let names = &self.fitted.free;
        let count = names.len();
        let at = |row: usize, column: usize| self.covariance[(row, column)];
        let matrix = (0..count)
            .map(|row| {
                (0..count)
                    .map(|column| {
                        let both = at(row, row).sqrt() * at(column, column).sqrt();
                        if both > 0.0 { (at(row, column) / both).clamp(-1.0, 1.0) } else { 0.0 }
                    })
                    .collect()
            })
            .collect();
        Correlation { names: names.iter().map(|name| name.key()).collect(), matrix }
    }

    /// The parameter most correlated with this one, if the correlation is large.
    fn partner(&self, name: Name) -> Option<(Name, f64)> {
        let place = self.place(name)?;
        let correlation = self.correlation();
        let others = self.fitted.free.iter().zip(&correlation.matrix[place]).filter(|(other, _)| **other != name);
        let most = others.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
        (most.1.abs() > TOGETHER).then_some((*most.0, *most.1))
    }

    /// The result for a parameter.
    pub fn judged(&self, name: Name, task: &Task) -> Found {
        let value = name.of(self.parameters());
        let known = task.known_of(name);
        let Some(u95) = self.u95(name) else {
            let u95 = known.map(|(_, deviation)| 2.0 * deviation);
            return Found { value: Some(value), u95, status: FoundStatus::Given, ..Found::default() };
        };
        let found = Found::known(value, u95);
        let symbol = name.words();
        let cannot = || match self.partner(name) {
            Some((other, correlation)) => Found::unknown(format!(
                "this motion cannot separate {symbol} from {} (correlation {correlation:.2})",
                other.words()
            )),
            None => Found::unknown(format!("this motion hardly depends on {symbol}: {value:.3e} within {u95:.1e}")),
        };
        let slow = self.is_slow();
        match name {
            Name::Stiffness | Name::Damping if slow => Found::unknown(format!(
                "the motion is too slow for {symbol}: the contact's force changes only where the screw reverses"
            )),
            Name::Structure | Name::Skew => match known {
                Some((_, deviation)) if self.place(name).is_some_and(|at| self.error(at) > 0.7 * deviation) => {
                    Found { status: FoundStatus::Given, ..found }
                }
                Some(_) => found,
                None if name == Name::Skew && u95 > 20e-6 => cannot(),
                None => self.bound(name, found, cannot),
            },
            Name::Backlash => {
                let steps = self.stretches.iter().map(|prepared| prepared.step_m).fold(0.0, f64::max);
                let u95 = if slow { u95.hypot(steps) } else { u95 };
                let found = Found::known(value, u95);
                let (low, high) = span(self.stretches);
                let reverses = low < 0.0 && high > 0.0;
                let stretch = (high - low) / self.parameters().stiffness_n_per_m;
                match () {
                    () if !reverses => Found::unknown("the force never changes sign: one flank carries all the force"),
                    () if u95 > 0.5 * stretch && u95 > value => cannot(),
                    () if value < u95 => Found { status: FoundStatus::BelowU95, ..found },
                    () => found,
                }
            }
            _ => self.bound(name, found, cannot),
        }
    }

    /// A value smaller than its interval is a bound, unless another parameter may take its place.
    fn bound(&self, name: Name, found: Found, cannot: impl Fn() -> Found) -> Found {
        let found = found.bounded();
        if found.status == FoundStatus::BelowU95 && self.partner(name).is_some() { cannot() } else { found }
    }

    /// Parameters for which a quadratic approximation may fail, weakest first.
    pub fn weak(&self) -> Vec<Name> {
        let mut weak: Vec<(Name, f64)> = self
            .fitted
            .free
            .iter()
            .filter(|name| !matches!(name, Name::Structure | Name::Skew))
            .filter_map(|name| {
                let relative = self.u95(*name)? / name.of(self.parameters()).abs().max(1e-300);
                (relative > WEAK || self.partner(*name).is_some()).then_some((*name, relative))
            })
            .collect();
        weak.sort_by(|a, b| b.1.total_cmp(&a.1));
        weak.into_iter().map(|(name, _)| name).take(MOST_PROFILES).collect()
    }

    /// Ends of the interval where the sum of squares, with all other parameters refitted, has grown by as much as at
    /// the end of a quadratic one's interval. The systematic part is added.
    pub fn profile(&self, name: Name, task: &Task) -> Option<[f64; 2]> {
        let place = self.place(name)?;
        let value = name.of(self.parameters());
        let error = self.error(place);
        let coloured = self.variance[place] / self.naive[place];
        let wanted = COVERAGE * COVERAGE * coloured;
        let cost = |held| cost_with(self.stretches, task, &self.fitted.state, held);
        let least = cost(None)?;
        let end = |side: f64| -> Option<f64> {
            let mut distance = COVERAGE * error;
            for _ in 0..3 {
                let at = value + side * distance;
                if at <= 0.0 {
                    // Friction and backlash cannot be negative.
                    return Some(0.0);
                }
                let grown = 2.0 * (cost(Some((name, at)))? - least).max(0.0);
                let factor = (wanted / grown.max(1e-3 * wanted)).sqrt();
                distance *= factor;
                if (0.95..1.05).contains(&factor) {
                    break;
                }
            }
            Some((value + side * distance.hypot(self.systematic[place])).max(0.0))
        };
        Some([end(-1.0)?, end(1.0)?])
    }

    /// Whether the motion is far slower than the device.
    fn is_slow(&self) -> bool {
        let (v, x) = motion(self.stretches.iter());
        let p = self.parameters();
        v < SLOWEST * SLOWEST * x * p.stiffness_n_per_m / p.inertance_kg
    }
}

/// Errors that averaging does not remove, measured on simulated devices (docs/tables/identify.md): impacts between
/// samples, a terminal motion that is not quite smooth.
fn model_u95(name: Name, p: &Parameters) -> f64 {
    match name {
        Name::Inertance => 2e-4 * p.inertance_kg,
        Name::Stiffness => 5e-4 * p.stiffness_n_per_m,
        Name::Damping => 5e-3 * p.contact_damping_n_s_per_m,
        Name::Viscous => 1.5e-3 * p.contact_damping_n_s_per_m,
        Name::Coulomb => 3e-3 * p.coulomb_n,
        Name::Backlash => 2e-7,
        Name::Structure | Name::Skew => 0.0,
    }
}

/// Approximate minimum and maximum force of the contact.
fn span(stretches: &[Prepared]) -> (f64, f64) {
    ends(stretches.iter().flat_map(|prepared| {
        prepared.force.iter().skip(counting(prepared).start).take(counting(prepared).len()).copied()
    }))
}
