//! What sums of the regressors could identify, before there is a force: for planned motions.

use inerter_core::Settings;
use inerter_core::constants::{BOXES_VARIANCE, ROUNDING};

use super::{ACCELERATION, FitError, LAW, Products, Solution, VELOCITY};

impl Products {
    /// The sums multiplied by a factor.
    pub(crate) fn times(mut self, factor: f64) -> Self {
        self.sums.iter_mut().flatten().for_each(|sum| *sum *= factor);
        self.updates *= factor;
        self
    }

    /// What was added after other sums of the same run; all of it if the sums were restarted.
    pub(crate) fn since(self, before: &Self) -> Self {
        if self.updates < before.updates { self } else { self.and(&before.times(-1.0)) }
    }

    /// Number of updates in the sums.
    pub(crate) fn updates(&self) -> f64 {
        self.updates
    }

    /// Number of position readings in them.
    pub(crate) fn readings(&self, settings: &Settings) -> f64 {
        self.updates * self.box_s(settings) / 2.0 * settings.sample_rate_hz * settings.oversampling
    }

    /// Mean squares of the acceleration \[m^2/s^4\] and of the velocity \[m^2/s^2\].
    pub(crate) fn mean_squares(&self) -> [f64; 2] {
        [self.mean_square(ACCELERATION), self.mean_square(VELOCITY)]
    }

    /// Mean square that force noise and the encoder's steps explain \[N^2\].
    fn explained(&self, inertance_kg: f64, force_noise_n: f64, settings: &Settings) -> f64 {
        let white = BOXES_VARIANCE / (self.box_s(settings) * settings.sample_rate_hz);
        let square = force_noise_n.powi(2) + ROUNDING * settings.newtons_per_code.powi(2);
        white * square + inertance_kg.powi(2) * self.steps_square(settings)
    }

    /// Mean square residual of the law beyond what force noise and the encoder's steps explain.
    pub(crate) fn beyond_explained(
        &self,
        inertance_kg: f64,
        force_noise_n: f64,
        settings: &Settings,
    ) -> Result<f64, FitError> {
        let left = self.solve(LAW)?.residual_square;
        Ok(left / self.explained(inertance_kg, force_noise_n, settings))
    }

    /// The expected uncertainty of the law `[mt, cf, fc, F0]` if these are the true values, and the residual's mean
    /// square is this multiple of what force noise and the encoder's steps explain; nothing for the inertance if the
    /// steps dominate it.
    pub(crate) fn expected(
        &self,
        law: [f64; 4],
        force_noise_n: f64,
        times: f64,
        settings: &Settings,
    ) -> Result<Solution<4>, FitError> {
        let mut solution = self.solve(LAW)?;
        let [inertance_kg, ..] = law;
        solution.values = law;
        solution.scatter.inertance_kg = inertance_kg as f32;
        solution.rest_on(times * self.explained(inertance_kg, force_noise_n, settings));
        self.weigh_steps(&mut solution, LAW, settings);
        if self.correct_for_steps(&mut solution, inertance_kg, settings).is_err() {
            solution.steps[ACCELERATION] = f64::INFINITY;
        }
        // True values need no correction.
        solution.values = law;
        Ok(solution)
    }
}
