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
    /// Takes several updates, without a virtual call for each of them.
    fn updates(&mut self, updates: &[Update]) {
        updates.iter().for_each(|update| self.update(update));
    }
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
            pub fn new(tuning: &Tuning, gated: bool) -> Self {
                let covariance = diagonal([VARIANCE as $float; 4]);
                Self { theta: [0.0; 4], covariance, forgetting: tuning.forgetting as $float, gated }
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
    pub fn new(tuning: &Tuning, limited: bool) -> Self {
        let (mut guards, mut variance) = (CovarianceGuards::default(), VARIANCE as f32);
        if !limited {
            (guards.max_order_decrement, variance) = (0.0, 1e3);
        }
        Self { filter: RlsParallel::new(variance, tuning.forgetting as f32, guards), guarded: 0 }
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
    pub fn new(tuning: &Tuning) -> Self {
        Self(InverseQrRls::new(VARIANCE as f32, tuning.forgetting as f32))
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
    /// With a random walk, or with forgetting.
    pub fn new(tuning: &Tuning, walks: bool) -> Self {
        let walk = || Transition::identity(diagonal(tuning.walk.map(|one| one as f32)));
        Self {
            estimate: Estimate::new([0.0; 4], diagonal([VARIANCE as f32; 4])),
            transition: walks.then(walk),
            forgetting: tuning.forgetting as f32,
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

fn row(update: &Update) -> [f64; 5] {
    let [a, b, c, d] = update.phi;
    [a, b, c, d, update.target]
}

/// `inerter_core::rls`, as the instrument runs it for one bank: running averages and whole-run sums, held at rest.
pub struct Ours {
    tuning: Tuning,
    recent: rls::Moments,
    whole: rls::Totals,
}

impl Ours {
    /// Before any update.
    pub fn new(tuning: Tuning) -> Self {
        Self { tuning, recent: rls::Moments::default(), whole: rls::Totals::default() }
    }

    #[inline]
    /// Takes normalised regressors.
    pub fn take(&mut self, regressors: &[i32; 5]) {
        let products = rls::products(regressors);
        self.recent.update(&products, self.tuning.memory);
        self.whole.update(&products);
    }
}

impl Method for Ours {
    fn update(&mut self, update: &Update) {
        if update.moving {
            let regressors = self.tuning.quantised(update);
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
        let places = self.tuning.places;
        std::array::from_fn(|i| solution[i] * (at(4, 4) / at(i, i)).sqrt() * f64::powi(2.0, places[i] - places[4]))
    }

    fn remark(&self) -> String {
        "with whole-run sums; no update at rest".into()
    }
}

/// What a method is told beforehand.
#[derive(Clone, Copy, Debug)]
pub struct Tuning {
    /// Forgetting per update; 1 forgets nothing.
    pub forgetting: f64,
    /// A random walk that forgets as fast: its variances per update.
    pub walk: [f64; 4],
    /// For ours: binary places of the regressors and of the target.
    pub places: [i32; 5],
    /// For ours: updates that it remembers.
    pub memory: u32,
}

impl Tuning {
    /// For some regressors.
    pub fn of(updates: &[Update], forgetting: f64) -> Self {
        let count = updates.len() as f64;
        let walk = std::array::from_fn(|i| {
            let square = updates.iter().map(|update| update.phi[i] * update.phi[i]).sum::<f64>() / count;
            (1.0 - forgetting).powi(2) / square
        });
        // By the greatest of each regressor, as the settings give them to the instrument.
        let greatest = updates
            .iter()
            .map(row)
            .fold([f64::MIN_POSITIVE; 5], |greatest, row| std::array::from_fn(|i| greatest[i].max(row[i].abs())));
        let places = greatest.map(|value| 29 - value.log2().floor() as i32);
        // A float beyond the integers, as without forgetting, becomes the greatest integer.
        Self { forgetting, walk, places, memory: (1.0 - forgetting).recip().round() as u32 }
    }

    /// Regressors as the instrument has them.
    pub fn quantised(&self, update: &Update) -> [i32; 5] {
        let row = row(update);
        std::array::from_fn(|i| (row[i] * f64::powi(2.0, self.places[i])).round() as i32)
    }
}

/// A Rust method: its name and number formats in the first table, its name in the others (none if it is not in them),
/// and what makes one that has seen no data.
pub type Entry = (&'static str, &'static str, Option<&'static str>, fn(&Tuning) -> Box<dyn Method>);

/// The Rust methods, ours first. The random walk is a method of its own only if something is forgotten.
pub const METHODS: [Entry; 9] = [
    (OURS, "i32, i64", Some(OURS), |tuning| Box::new(Ours::new(*tuning))),
    ("textbook covariance RLS", "f32", Some("textbook covariance RLS, f32"), |tuning| {
        Box::new(Textbook32::new(tuning, false))
    }),
    ("textbook covariance RLS", "f64", Some("textbook covariance RLS, f64"), |tuning| {
        Box::new(Textbook64::new(tuning, false))
    }),
    ("textbook covariance RLS behind our gate", "f32", None, |tuning| Box::new(Textbook32::new(tuning, true))),
    ("`flight-solver` 0.2, `RlsParallel`", "f32", Some("`flight-solver`, `RlsParallel`"), |tuning| {
        Box::new(FlightCovariance::new(tuning, true))
    }),
    ("`flight-solver` 0.2, `RlsParallel`, order limit off, variance 1e3", "f32", Some(UNLIMITED), |tuning| {
        Box::new(FlightCovariance::new(tuning, false))
    }),
    ("`flight-solver` 0.2, `InverseQrRls`", "f32", Some("`flight-solver`, `InverseQrRls`"), |tuning| {
        Box::new(FlightInverse::new(tuning))
    }),
    ("`idsp` 0.23, `kalman`, covariance / 0.999", "f32", Some("`idsp`, `kalman`, forgetting"), |tuning| {
        Box::new(IdspKalman::new(tuning, false))
    }),
    ("`idsp` 0.23, `kalman`, random walk", "f32", Some(WALK), |tuning| Box::new(IdspKalman::new(tuning, true))),
];

/// Ours.
const OURS: &str = "ours: update (`inerter_core::rls`)";
/// The one whose guard is set not to act.
pub const UNLIMITED: &str = "`flight-solver`, `RlsParallel`, order limit off, variance 1e3";
/// The one with a random walk.
pub const WALK: &str = "`idsp`, `kalman`, random walk";
