//! What sums of the regressors could tell, before there is a force: for motions that are planned.

use inerter_core::Settings;
use inerter_core::constants::{BOXES_VARIANCE, ROUNDING};

use super::{ACCELERATION, FitError, LAW, Products, Solution, VELOCITY};

impl Products {
    /// So many times the sums.
    pub(crate) fn times(mut self, factor: f64) -> Self {
        self.sums.iter_mut().flatten().for_each(|sum| *sum *= factor);
        self.updates *= factor;
        self
    }

    /// What came after other sums of the same run; all of it where the sums began anew.
    pub(crate) fn since(self, before: &Self) -> Self {
        if self.updates < before.updates { self } else { self.and(&before.times(-1.0)) }
    }

    /// Updates that were summed.
    pub(crate) fn updates(&self) -> f64 {
        self.updates
    }

    /// Readings of the position in them.
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

    /// Mean square that the law leaves over what force noise and the encoder's steps explain of it.
    pub(crate) fn beyond_explained(
        &self,
        inertance_kg: f64,
        force_noise_n: f64,
        settings: &Settings,
    ) -> Result<f64, FitError> {
        let left = self.solve(LAW)?.residual_square;
        Ok(left / self.explained(inertance_kg, force_noise_n, settings))
    }

    /// What the law `[mt, cf, fc, F0]` can be told by where this is what is true, and so many times the mean square is
    /// left over that force noise and the encoder's steps explain; nothing of the inertance where the steps swallow it.
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
        // What is true is not corrected.
        solution.values = law;
        Ok(solution)
    }
}
