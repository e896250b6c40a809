//! The methods that are compared, each driven update by update.

use crate::machine::{FORGETTING, MEMORY, Update, VARIANCE};
use flight_solver::rls::{ExitCode, InverseQrRls, RlsParallel};
use idsp::kalman::{Estimate, Observation, Transition};
use inerter_core::rls;
use nalgebra::{SVector, Vector1};

/// A way to estimate, driven update by update.
pub trait Method {
    /// Takes one update.
    fn update(&mut self, update: &Update);
    /// Parameters as they stand, in the order of the regressors.
    fn parameters(&self) -> [f64; 4];
    /// What the method itself says of its state.
    fn remark(&self) -> String {
        String::new()
    }
}

/// Textbook covariance form, kept symmetric, in f32 or f64.
macro_rules! textbook {
    ($name:ident, $float:ty) => {
        /// One textbook filter.
        pub struct $name {
            theta: [$float; 4],
            covariance: [[$float; 4]; 4],
            gated: bool,
        }

        impl $name {
            /// With or without the gate at rest.
            pub fn new(gated: bool) -> Self {
                let mut covariance = [[0.0; 4]; 4];
                for (i, row) in covariance.iter_mut().enumerate() {
                    row[i] = VARIANCE as $float;
                }
                Self { theta: [0.0; 4], covariance, gated }
            }
        }

        impl Method for $name {
            #[inline]
            fn update(&mut self, update: &Update) {
                if self.gated && !update.moving {
                    return;
                }
                let phi = update.phi.map(|value| value as $float);
                let dot = |a: &[$float; 4], b: &[$float; 4]| a.iter().zip(b).map(|(x, y)| x * y).sum::<$float>();
                let cross = self.covariance.map(|row| dot(&row, &phi));
                let gain = cross.map(|value| value / (FORGETTING as $float + dot(&phi, &cross)));
                let error = update.force as $float - dot(&phi, &self.theta);
                for i in 0..4 {
                    self.theta[i] += gain[i] * error;
                    // One triangle and its mirror: kept apart, the halves drift off each other and diverge.
                    for j in i..4 {
                        let value = (self.covariance[i][j] - gain[i] * cross[j]) / FORGETTING as $float;
                        self.covariance[i][j] = value;
                        self.covariance[j][i] = value;
                    }
                }
            }

            fn parameters(&self) -> [f64; 4] {
                self.theta.map(f64::from)
            }
        }
    };
}

textbook!(Textbook32, f32);
textbook!(Textbook64, f64);

/// `flight_solver::rls::RlsParallel`: covariance form with the crate's guards.
pub struct FlightCovariance {
    pub filter: RlsParallel<4, 1>,
    pub guarded: u64,
}

impl Method for FlightCovariance {
    #[inline]
    fn update(&mut self, update: &Update) {
        let phi = SVector::from(update.phi.map(|value| value as f32));
        let stats = self.filter.update(&phi, &Vector1::new(update.force as f32));
        self.guarded += u64::from(stats.exit_code == ExitCode::CovarianceExplosion);
    }

    fn parameters(&self) -> [f64; 4] {
        std::array::from_fn(|i| f64::from(self.filter.params()[(i, 0)]))
    }

    fn remark(&self) -> String {
        if self.guarded > 0 { format!("its guard acted {} times", self.guarded) } else { String::new() }
    }
}

/// `flight_solver::rls::InverseQrRls`: factor of the information matrix by Givens rotations.
pub struct FlightInverse(pub InverseQrRls<4, 1>);

impl Method for FlightInverse {
    #[inline]
    fn update(&mut self, update: &Update) {
        let phi = SVector::from(update.phi.map(|value| value as f32));
        self.0.update(&phi, &Vector1::new(update.force as f32));
    }

    fn parameters(&self) -> [f64; 4] {
        std::array::from_fn(|i| f64::from(self.0.params()[(i, 0)]))
    }
}

/// `idsp::kalman` with the parameters as a state that stands still; f32 as its users have it.
pub struct IdspKalman {
    estimate: Estimate<f32, 4>,
    /// A random walk of the parameters, or the covariance divided by the forgetting as RLS does.
    transition: Option<Transition<f32, 4>>,
}

impl IdspKalman {
    /// With the variances of a random walk per update, or with forgetting.
    pub fn new(walk: Option<[f64; 4]>) -> Self {
        let diagonal = |values: [f64; 4]| {
            let mut matrix = [[0.0; 4]; 4];
            for (i, row) in matrix.iter_mut().enumerate() {
                row[i] = values[i] as f32;
            }
            matrix
        };
        Self {
            estimate: Estimate::new([0.0; 4], diagonal([VARIANCE; 4])),
            transition: walk.map(|noise| Transition::identity(diagonal(noise))),
        }
    }
}

impl Method for IdspKalman {
    #[inline]
    fn update(&mut self, update: &Update) {
        match &self.transition {
            Some(transition) => transition.predict(&mut self.estimate),
            None => {
                for value in self.estimate.covariance.iter_mut().flatten() {
                    *value /= FORGETTING as f32;
                }
            }
        }
        let observation = Observation::new(update.phi.map(|value| value as f32), 1.0);
        observation.correct(&mut self.estimate, update.force as f32);
    }

    fn parameters(&self) -> [f64; 4] {
        self.estimate.state.map(f64::from)
    }
}

/// Binary places of our regressors `[a, v, s, 1, F]`: full scales of 8 m/s^2, 0.25 m/s, 2, 2 and 512 N.
const PLACES: [i32; 5] = [28, 33, 30, 30, 22];

/// Regressors as the instrument has them.
pub fn quantised(update: &Update) -> [i32; 5] {
    let [a, v, s, one] = update.phi;
    let mut out = [0; 5];
    for ((out, value), places) in out.iter_mut().zip([a, v, s, one, update.force]).zip(PLACES) {
        *out = (value * f64::powi(2.0, places)).round() as i32;
    }
    out
}

/// `inerter_core::rls`, as the instrument runs it for one bank: running averages and whole-run sums, held at rest.
#[derive(Default)]
pub struct Ours {
    recent: rls::Moments,
    whole: rls::Totals,
}

impl Ours {
    #[inline]
    /// Takes normalised regressors.
    pub fn take(&mut self, regressors: &[i32; 5]) {
        let products = rls::products(regressors);
        self.recent.update(&products, MEMORY);
        self.whole.update(&products);
    }
}

impl Method for Ours {
    fn update(&mut self, update: &Update) {
        if update.moving {
            self.take(&quantised(update));
        }
    }

    /// The solution of the averages, here in f64: the bench compares updates.
    fn parameters(&self) -> [f64; 4] {
        let averages = self.recent.averages();
        let at = |row: usize, column: usize| averages[rls::place(row.max(column), row.min(column))] as f64;
        let scaled = |row: usize, column: usize| at(row, column) / (at(row, row) * at(column, column)).sqrt();
        let matrix = nalgebra::SMatrix::<f64, 4, 4>::from_fn(scaled);
        let right = SVector::<f64, 4>::from_fn(|row, _| scaled(row, 4));
        let Some(solution) = matrix.try_inverse().map(|inverse| inverse * right) else { return [f64::NAN; 4] };
        std::array::from_fn(|i| solution[i] * (at(4, 4) / at(i, i)).sqrt() * f64::powi(2.0, PLACES[i] - PLACES[4]))
    }
}
