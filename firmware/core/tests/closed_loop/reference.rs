//! The estimator in f64, from the regressors on, as in a textbook.
//!
//! The regressors themselves are integers; core's own tests compare them with the direct convolution bit by bit. Here
//! they are reconstructed from the exact sums that core publishes: one update adds the product of two regressors to a
//! sum, and one of the regressors is the constant. Averages, sums, solution and choice of bank are computed
//! independently, in SI units, with only the settings from core.

use crate::linear::Cholesky;
use inerter_core::{Active, Bank, Estimate, Parameters, RawSample, Settings, State, Status};

/// Regressors `[a, v, s, 1, F]`.
const REGRESSORS: usize = 5;
/// Maximum differences: mt \[kg\], cf \[N s/m\], fc \[N\], F0 \[N\].
pub const BOUNDS: [f64; 4] = [1e-3, 1e-2, 2e-3, 2e-3];

type Matrix = [[f64; REGRESSORS]; REGRESSORS];

/// One bank's memories.
#[derive(Clone, Debug)]
struct Memory {
    bank: Bank,
    /// Length of the memory in updates.
    horizon: f64,
    /// Mean square of the encoder's steps in the acceleration.
    steps: f64,
    updates: u32,
    /// Column of the constant in core's sums, as read last.
    column: [i128; REGRESSORS],
    average: Matrix,
    sum: Matrix,
}

impl Memory {
    fn new(settings: &Settings, bank: Bank) -> Self {
        let box_s = match bank {
            Bank::Fast => 0.016,
            Bank::Slow => 0.064,
        };
        let (rate, step) = (settings.sample_rate_hz, settings.metres_per_count);
        // Two updates per box.
        let spacing = (rate * box_s / 2.0).round().max(1.0);
        let length = 2.0 * spacing;
        // A count's error is uniformly distributed. A box of M samples, differenced twice and summed twice, has a gain
        // of 8/3 M^3.
        let steps = step * step / 12.0 * 8.0 / 3.0 * length.powi(3) * (rate * rate / length.powi(4)).powi(2);
        let horizon = (settings.memory_s * rate / spacing).round();
        let zero = [[0.0; REGRESSORS]; REGRESSORS];
        Self { bank, horizon, steps, updates: 0, column: [0; REGRESSORS], average: zero, sum: zero }
    }

    /// Takes over core's update since the last call: at most one.
    fn follow(&mut self, active: &Active, state: &State) {
        let sums = active.sums(state, self.bank);
        if sums.updates == self.updates {
            return;
        }
        assert_eq!(sums.updates, self.updates + 1, "one update at a time");
        self.updates = sums.updates;
        // Products of the constant, which is the fourth regressor, with each regressor: row 3 up to the diagonal, then
        // row 4.
        let column = [6, 7, 8, 9, 13].map(|place: usize| sums.sums[place]);
        let constant = 2_f64.powi(30);
        let regressors: [f64; REGRESSORS] =
            std::array::from_fn(|i| (column[i] - self.column[i]) as f64 / constant * sums.units[i]);
        self.column = column;
        let gain = 1.0 / f64::from(self.updates).min(self.horizon);
        for ((averages, sums), a) in self.average.iter_mut().zip(&mut self.sum).zip(regressors) {
            for ((average, sum), b) in averages.iter_mut().zip(sums).zip(regressors) {
                *average += gain * (a * b - *average);
                *sum += a * b;
            }
        }
    }

    /// `[mt with the structure, cf, fc, F0]`, with `steps` of the acceleration's mean square attributed to the
    /// encoder's steps.
    fn solve(matrix: &Matrix, steps: f64) -> Option<[f64; 4]> {
        let mut inner: [[f64; 4]; 4] = std::array::from_fn(|row| std::array::from_fn(|column| matrix[row][column]));
        inner[0][0] -= steps;
        let right = std::array::from_fn(|row| matrix[row][4]);
        Some(Cholesky::of(&inner, 1e-13)?.solve(&right))
    }
}

/// Core's estimator and the textbook, side by side.
pub struct Pair {
    active: Active,
    state: Box<State>,
    fast: Memory,
    slow: Memory,
    /// Largest difference of each parameter so far.
    pub greatest: [f64; 4],
    /// Number of values compared.
    pub compared: u64,
}

impl Pair {
    /// Both in their initial state.
    pub fn new(settings: &Settings) -> Result<Self, inerter_core::SettingsError> {
        let active = settings.validate()?;
        let state = Box::new(State::new(&active));
        let [fast, slow] = [Bank::Fast, Bank::Slow].map(|bank| Memory::new(settings, bank));
        Ok(Self { active, state, fast, slow, greatest: [0.0; 4], compared: 0 })
    }

    /// Processes a sample, and compares whenever core publishes.
    pub fn step(&mut self, sample: &RawSample) -> Option<Estimate> {
        let published = self.active.step(&mut self.state, sample).estimate();
        self.fast.follow(&self.active, &self.state);
        self.slow.follow(&self.active, &self.state);
        if let Some(estimate) = &published {
            self.compare(estimate);
        }
        published
    }

    /// Number of updates of the fast bank.
    pub fn updates(&self) -> u32 {
        self.fast.updates
    }

    /// Whether every difference is within its bound.
    pub fn agrees(&self) -> bool {
        self.greatest.iter().zip(BOUNDS).all(|(greatest, bound)| *greatest <= bound)
    }

    fn compare(&mut self, estimate: &Estimate) {
        let recent = self.chosen(|memory| (memory.average, 1.0), 2000.0);
        let whole = self.chosen(|memory| (memory.sum, f64::from(memory.updates)), 500.0);
        self.note(&estimate.recent, recent);
        self.note(&estimate.whole_run, whole);
    }

    /// The solution of the selected bank. The fast bank is selected if the acceleration's mean square exceeds 2000
    /// times its steps, or `among` times while the slow bank passes less than a tenth of it, or if the slow bank has no
    /// update. With `among` = 2000 the second condition adds nothing.
    fn chosen(&self, matrix: impl Fn(&Memory) -> (Matrix, f64), among: f64) -> Option<[f64; 4]> {
        let [fast, slow] = [&self.fast, &self.slow].map(|memory| {
            let (matrix, count) = matrix(memory);
            matrix[0][0] / count.max(1.0)
        });
        let clear = fast / self.fast.steps;
        let is_fast = clear > 2000.0 || clear > among && slow < 0.1 * fast || self.slow.updates == 0;
        let memory = if is_fast { &self.fast } else { &self.slow };
        let (matrix, count) = matrix(memory);
        let [none, all] = [0.0, memory.steps * count].map(|steps| Memory::solve(&matrix, steps));
        // For sums of readings, a fraction of the steps' error applies.
        let part = 0.5 * (1.0 + 1.0 / self.active.settings().oversampling);
        none.zip(all).map(|(none, all)| std::array::from_fn(|i| none[i] + part * (all[i] - none[i])))
    }

    fn note(&mut self, found: &Parameters, reference: Option<[f64; 4]>) {
        let structure = self.active.settings().structure_mass_kg;
        let found = [&found.inertance_kg, &found.viscous_n_s_per_m, &found.coulomb_n, &found.offset_n];
        // Core omits what it cannot distinguish. The textbook has no answer then.
        if found.iter().any(|parameter| parameter.u95().is_infinite()) {
            return;
        }
        for (i, parameter) in found.into_iter().enumerate() {
            if parameter.status() == Status::NotIdentifiable {
                continue;
            }
            let reference = reference.map_or(f64::NAN, |values| values[i] - if i == 0 { structure } else { 0.0 });
            let difference = (f64::from(parameter.fitted().value) - reference).abs();
            self.compared += 1;
            // NaN also counts as a difference.
            if difference.is_nan() || difference > self.greatest[i] {
                self.greatest[i] = if difference.is_nan() { f64::INFINITY } else { difference };
            }
        }
    }
}
