//! The compared methods, each driven update by update.

use crate::machine::{Update, VARIANCE};
use flight_solver::rls::{CovarianceGuards, ExitCode, InverseQrRls, RlsParallel};
use idsp::kalman::{Estimate, Observation, Transition};
use inerter_core::rls;
use nalgebra::{SVector, Vector1};

/// A way to estimate, driven update by update.
pub trait Method {
    /// Takes one update.
    fn update(&mut self, update: &Update);
    /// Current parameters, in the order of the regressors.
    fn parameters(&self) -> [f64; 4];
    /// Their variances for a residual of unit variance, if the method offers them.
    fn variances(&self) -> Option<[f64; 4]> {
        None
    }
    /// What the method reports of its own state.
    fn remark(&self) -> String {
        String::new()
    }
}

fn diagonal<F: Copy + Default>(values: [F; 4]) -> [[F; 4]; 4] {
    let mut matrix = [[F::default(); 4]; 4];
    for (i, value) in values.into_iter().enumerate() {
        matrix[i][i] = value;
    }
    matrix
}

/// Textbook covariance form, kept symmetric, in f32 or f64.
macro_rules! textbook {
    ($name:ident, $float:ty) => {
        /// One textbook filter.
        pub struct $name {
            theta: [$float; 4],
            covariance: [[$float; 4]; 4],
            forgetting: $float,
            gated: bool,
        }

        impl $name {
            /// With or without the gate at rest.
            pub fn new(forgetting: f64, gated: bool) -> Self {
                let covariance = diagonal([VARIANCE as $float; 4]);
                Self { theta: [0.0; 4], covariance, forgetting: forgetting as $float, gated }
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
                let gain = cross.map(|value| value / (self.forgetting + dot(&phi, &cross)));
                let error = update.target as $float - dot(&phi, &self.theta);
                for i in 0..4 {
                    self.theta[i] += gain[i] * error;
                    // One triangle and its mirror: computed separately, the halves drift apart and diverge.
                    for j in i..4 {
                        let value = (self.covariance[i][j] - gain[i] * cross[j]) / self.forgetting;
                        self.covariance[i][j] = value;
                        self.covariance[j][i] = value;
                    }
                }
            }

            fn parameters(&self) -> [f64; 4] {
                self.theta.map(f64::from)
            }

            fn variances(&self) -> Option<[f64; 4]> {
                Some(std::array::from_fn(|i| f64::from(self.covariance[i][i])))
            }
        }
    };
}

textbook!(Textbook32, f32);
textbook!(Textbook64, f64);

/// `flight_solver::rls::RlsParallel`: covariance form with the crate's guards.
pub struct FlightCovariance {
    filter: RlsParallel<4, 1>,
    guarded: u64,
}

impl FlightCovariance {
    /// With the guards as the crate has them; or without the one that limits how fast the covariance falls, and with
    /// that of the initial variances 1e2 to 1e5 for which its error is least.
    pub fn new(forgetting: f64, limited: bool) -> Self {
        let (mut guards, mut variance) = (CovarianceGuards::default(), VARIANCE as f32);
        if !limited {
            (guards.max_order_decrement, variance) = (0.0, 1e3);
        }
        Self { filter: RlsParallel::new(variance, forgetting as f32, guards), guarded: 0 }
    }
}

impl Method for FlightCovariance {
    #[inline]
    fn update(&mut self, update: &Update) {
        let phi = SVector::from(update.phi.map(|value| value as f32));
        let stats = self.filter.update(&phi, &Vector1::new(update.target as f32));
        self.guarded += u64::from(stats.exit_code == ExitCode::CovarianceExplosion);
    }

    fn parameters(&self) -> [f64; 4] {
        std::array::from_fn(|i| f64::from(self.filter.params()[(i, 0)]))
    }

    fn variances(&self) -> Option<[f64; 4]> {
        Some(std::array::from_fn(|i| f64::from(self.filter.covariance()[(i, i)])))
    }

    fn remark(&self) -> String {
        let covariance = self.filter.covariance();
        let asymmetry = (covariance - covariance.transpose()).norm() / covariance.norm();
        match (self.guarded, asymmetry > 0.01) {
            (0, false) => String::new(),
            (0, true) => format!("its covariance is asymmetric by {:.0} %", 100.0 * asymmetry),
            (guarded, _) => format!("its guard acted {guarded} times"),
        }
    }
}

/// `flight_solver::rls::InverseQrRls`: factor of the information matrix by Givens rotations.
pub struct FlightInverse(InverseQrRls<4, 1>);

impl FlightInverse {
    /// With this forgetting.
    pub fn new(forgetting: f64) -> Self {
        Self(InverseQrRls::new(VARIANCE as f32, forgetting as f32))
    }
}

impl Method for FlightInverse {
    #[inline]
    fn update(&mut self, update: &Update) {
        let phi = SVector::from(update.phi.map(|value| value as f32));
        self.0.update(&phi, &Vector1::new(update.target as f32));
    }

    fn parameters(&self) -> [f64; 4] {
        std::array::from_fn(|i| f64::from(self.0.params()[(i, 0)]))
    }

    /// The factor is kept, and the covariance follows from it.
    fn variances(&self) -> Option<[f64; 4]> {
        let factor = self.0.info_factor().map(f64::from);
        let information = factor * factor.transpose();
        information.try_inverse().map(|covariance| std::array::from_fn(|i| covariance[(i, i)]))
    }
}

/// `idsp::kalman` with the parameters as a constant state; f32, as its users have it.
pub struct IdspKalman {
    estimate: Estimate<f32, 4>,
    /// A random walk of the parameters, or the covariance divided by the forgetting as RLS does.
    transition: Option<Transition<f32, 4>>,
    forgetting: f32,
}

impl IdspKalman {
    /// With the variances of a random walk per update, or with forgetting.
    pub fn new(forgetting: f64, walk: Option<[f64; 4]>) -> Self {
        Self {
            estimate: Estimate::new([0.0; 4], diagonal([VARIANCE as f32; 4])),
            transition: walk.map(|noise| Transition::identity(diagonal(noise.map(|one| one as f32)))),
            forgetting: forgetting as f32,
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
                    *value /= self.forgetting;
                }
            }
        }
        let observation = Observation::new(update.phi.map(|value| value as f32), 1.0);
        observation.correct(&mut self.estimate, update.target as f32);
    }

    fn parameters(&self) -> [f64; 4] {
        self.estimate.state.map(f64::from)
    }

    fn variances(&self) -> Option<[f64; 4]> {
        Some(std::array::from_fn(|i| f64::from(self.estimate.covariance[i][i])))
    }
}

/// How our update is set up for some regressors.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    /// Binary places of the regressors and of the target.
    places: [i32; 5],
    /// Updates that it remembers.
    memory: u32,
}

impl Scale {
    /// Places by the greatest of each regressor, as the settings give them to the instrument.
    pub fn of(updates: &[Update], forgetting: f64) -> Self {
        let greatest = updates
            .iter()
            .map(row)
            .fold([f64::MIN_POSITIVE; 5], |greatest, row| std::array::from_fn(|i| greatest[i].max(row[i].abs())));
        let places = greatest.map(|value| 29 - value.log2().floor() as i32);
        // A float beyond the integers, as without forgetting, becomes the greatest integer.
        Self { places, memory: (1.0 - forgetting).recip().round() as u32 }
    }

    /// Regressors as the instrument has them.
    pub fn quantised(&self, update: &Update) -> [i32; 5] {
        let row = row(update);
        std::array::from_fn(|i| (row[i] * f64::powi(2.0, self.places[i])).round() as i32)
    }
}

fn row(update: &Update) -> [f64; 5] {
    let [a, b, c, d] = update.phi;
    [a, b, c, d, update.target]
}

/// `inerter_core::rls`, as the instrument runs it for one bank: running averages and whole-run sums, held at rest.
pub struct Ours {
    scale: Scale,
    recent: rls::Moments,
    whole: rls::Totals,
}

impl Ours {
    /// Before any update.
    pub fn new(scale: Scale) -> Self {
        Self { scale, recent: rls::Moments::default(), whole: rls::Totals::default() }
    }

    #[inline]
    /// Takes normalised regressors.
    pub fn take(&mut self, regressors: &[i32; 5]) {
        let products = rls::products(regressors);
        self.recent.update(&products, self.scale.memory);
        self.whole.update(&products);
    }
}

impl Method for Ours {
    fn update(&mut self, update: &Update) {
        if update.moving {
            let regressors = self.scale.quantised(update);
            self.take(&regressors);
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
        let places = self.scale.places;
        std::array::from_fn(|i| solution[i] * (at(4, 4) / at(i, i)).sqrt() * f64::powi(2.0, places[i] - places[4]))
    }
}

/// Makes a method that has seen no data, from its tuning.
pub type Fresh = fn(&Tuning) -> Box<dyn Method>;

/// What a method is told beforehand.
#[derive(Clone, Copy, Debug)]
pub struct Tuning {
    /// Forgetting per update; 1 forgets nothing.
    pub forgetting: f64,
    /// A random walk that forgets as fast: its variances per update.
    pub walk: [f64; 4],
    /// For ours.
    pub scale: Scale,
}

impl Tuning {
    /// For some regressors.
    pub fn of(updates: &[Update], forgetting: f64) -> Self {
        let count = updates.len() as f64;
        let walk = std::array::from_fn(|i| {
            let square = updates.iter().map(|update| update.phi[i] * update.phi[i]).sum::<f64>() / count;
            (1.0 - forgetting).powi(2) / square
        });
        Self { forgetting, walk, scale: Scale::of(updates, forgetting) }
    }
}

/// The Rust methods for the reports, ours first. The random walk is a method of its own only if something is forgotten.
pub const METHODS: [(&str, Fresh); 8] = [
    ("ours: update (`inerter_core::rls`)", |tuning| Box::new(Ours::new(tuning.scale))),
    ("textbook covariance RLS, f32", |tuning| Box::new(Textbook32::new(tuning.forgetting, false))),
    ("textbook covariance RLS, f64", |tuning| Box::new(Textbook64::new(tuning.forgetting, false))),
    ("`flight-solver`, `RlsParallel`", |tuning| Box::new(FlightCovariance::new(tuning.forgetting, true))),
    (UNLIMITED, |tuning| Box::new(FlightCovariance::new(tuning.forgetting, false))),
    ("`flight-solver`, `InverseQrRls`", |tuning| Box::new(FlightInverse::new(tuning.forgetting))),
    ("`idsp`, `kalman`, forgetting", |tuning| Box::new(IdspKalman::new(tuning.forgetting, None))),
    (WALK, |tuning| Box::new(IdspKalman::new(tuning.forgetting, Some(tuning.walk)))),
];

/// The one whose guard is set not to act.
pub const UNLIMITED: &str = "`flight-solver`, `RlsParallel`, order limit off, variance 1e3";
/// The one with a random walk.
pub const WALK: &str = "`idsp`, `kalman`, random walk";
