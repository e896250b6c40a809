//! The report in f64: standard errors, budgets and law violations, by the formulas of docs/THEORY.md, 6. From core it
//! takes only the regressors, reconstructed from the exact sums, the settings, and the properties of the motion
//! (`Motion`).

use crate::linear::Cholesky;
use inerter_core::{Active, Bank, Motion, Settings, Source, State};

/// Regressors `[a, v, s, 1, F, F', |v|]` of each update of a bank, in SI.
pub struct Rows {
    bank: Bank,
    updates: u32,
    /// Sums of their products with the constant, as read last.
    column: [i128; 7],
    pub rows: Vec<[f64; 7]>,
}

impl Rows {
    pub fn new(bank: Bank) -> Self {
        Self { bank, updates: 0, column: [0; 7], rows: Vec::new() }
    }

    /// Takes over core's update since the last call: at most one.
    pub fn follow(&mut self, active: &Active, state: &State) {
        let sums = active.sums(state, self.bank);
        if sums.updates == self.updates || sums.updates == 0 {
            return;
        }
        if sums.updates < self.updates {
            // The memories have restarted.
            *self = Self::new(self.bank);
        }
        assert_eq!(sums.updates, self.updates + 1, "one update at a time");
        self.updates = sums.updates;
        let more = active.more_sums(state, self.bank);
        let [a, v, s, one, force] = sums.units;
        let units = [a, v, s, one, force, more.units[1], more.units[0]];
        // Products with the constant: row 3 of the triangle up to the diagonal, then force, its rate, and speed.
        let column =
            [sums.sums[6], sums.sums[7], sums.sums[8], sums.sums[9], sums.sums[13], more.sums[9], more.sums[3]];
        let grown = |i: usize| (column[i] - self.column[i]) as f64 * one;
        self.rows.push(std::array::from_fn(|i| grown(i) * units[i]));
        self.column = column;
    }
}

/// How a rig affects a bank's regressors.
#[derive(Clone, Copy)]
pub struct Kernel {
    /// Length of the box \[s\].
    pub box_s: f64,
    /// Samples between updates.
    pub spacing: f64,
    /// Mean square of the encoder's steps in the acceleration \[m^2/s^4\].
    pub steps: f64,
}

impl Kernel {
    pub fn of(settings: &Settings, bank: Bank) -> Self {
        let rate = settings.sample_rate_hz;
        let spacing = (rate * bank.box_s() / 2.0).round().max(1.0);
        let box_s = 2.0 * spacing / rate;
        let count = settings.metres_per_count;
        Self { box_s, spacing, steps: count * count / 12.0 * (8.0 / 3.0) / rate / box_s.powi(5) }
    }
}

/// The law fitted to rows.
pub struct Fit {
    pub values: [f64; 4],
    pub errors: [f64; 4],
    /// Diagonal of the inverse.
    pub inverse: [f64; 4],
    pub per_skew: [f64; 4],
    pub steps: [f64; 4],
    /// Variance of the residual \[N^2\].
    pub variance: f64,
    pub frequency_squared: f64,
    pub observations: f64,
    /// Mean square of the acceleration without the steps.
    pub acceleration_squared: f64,
    pub velocity_squared: f64,
}

/// Sum of the cubic B-spline's autocorrelation over its value at 0, in boxes.
const CORRELATION: f64 = 2.09;

pub fn fit<'a>(rows: impl IntoIterator<Item = &'a [f64; 7]>, kernel: &Kernel, oversampling: f64) -> Fit {
    let (mut matrix, mut count) = ([[0.0; 7]; 7], 0.0);
    for row in rows {
        count += 1.0;
        for (sums, a) in matrix.iter_mut().zip(row) {
            sums.iter_mut().zip(row).for_each(|(sum, b)| *sum += a * b);
        }
    }
    matrix.iter_mut().flatten().for_each(|sum| *sum /= count);
    let inner: [[f64; 4]; 4] = std::array::from_fn(|i| std::array::from_fn(|k| matrix[i][k]));
    let column = |place: usize| std::array::from_fn(|i| matrix[i][place]);
    let factor = Cholesky::of(&inner, 1e-13).unwrap();
    let plain = factor.solve(&column(4));
    let explained = |x: &[f64; 4], place: usize| (0..4).map(|i| x[i] * matrix[i][place]).sum::<f64>();
    let observations = count / (2.0 * CORRELATION);
    let variance = (matrix[4][4] - explained(&plain, 4)) * observations / (observations - 4.0);
    let inverse = factor.inverse_diagonal();
    let errors = inverse.map(|inverse| (variance / observations * inverse).sqrt());
    let per_skew = factor.solve(&column(5));
    // Noise in the acceleration reduces its coefficient.
    let taken = factor.solve(&[kernel.steps, 0.0, 0.0, 0.0]);
    let all = taken.map(|by| plain[0] * by / (1.0 - taken[0]));
    let acceleration_squared = matrix[0][0] - kernel.steps;
    Fit {
        values: std::array::from_fn(|i| plain[i] + all[i] * 0.5 * (1.0 + 1.0 / oversampling)),
        errors,
        inverse,
        per_skew,
        steps: all.map(|all| 0.5 * all.abs()),
        variance,
        frequency_squared: acceleration_squared / matrix[1][1] * kernel.box_s.powi(2),
        observations,
        acceleration_squared,
        velocity_squared: matrix[1][1],
    }
}

/// Variance of a sum whose parts have the same counts as their cause.
fn together(one: f64, other: f64) -> f64 {
    (one.sqrt() + other.sqrt()).powi(2)
}

/// Scatter per standard error.
pub struct Scatter {
    pub noise_squared: f64,
    pub pattern: f64,
    pub tone: f64,
    pub places: f64,
    pub steps: f64,
    kernel: f64,
}

impl Scatter {
    pub fn of(fit: &Fit, kernel: &Kernel, settings: &Settings, motion: &Motion) -> Self {
        let oversampling = settings.oversampling;
        let [inertance, _, coulomb, _] = fit.values;
        let y = fit.frequency_squared;
        let passed = (1.0 + y / 12.0).powi(-4);
        let share = (inertance * inertance * kernel.steps / fit.variance).min(1.0);
        let kept = share / oversampling;
        let of_steps = (0.25 + 3.0 / 8.0 / CORRELATION * y * y * passed).min(1.0);
        let repeats = f64::from(motion.repeats);
        let pattern = of_steps * share * (repeats.min(8.0) - 1.0);
        let alike = f64::from(motion.low_squared / motion.frequency_squared).powi(4);
        let harmonics = (0.02 + 1.9 * y / (1.0 + 0.5 * y + 2.0 * y.powi(8))) * alike;
        let tone = harmonics * share * (repeats - 1.0);
        // Recurring reversals are placed from the same counts, within a kernel of 15 or 5 ms on either side.
        let count = settings.metres_per_count;
        let square = |half_s: f64| count * count / (6.0 * half_s.powi(3) * settings.sample_rate_hz);
        let greatest = 2.0 * f64::from(motion.acceleration_squared);
        let is_moved = greatest * 0.002_f64.powi(2) > 4.0 * square(0.005);
        let place = if is_moved { square(0.015) } else { square(0.005) };
        let part = fit.errors[0] * coulomb / (fit.variance * CORRELATION);
        let turns = greatest * inertance * inertance > (1.5 * coulomb).powi(2);
        let each = if turns { 4.0 * place * part * part / kernel.box_s.powi(2) } else { 0.0 };
        let places = each * f64::from(motion.reversals_again);
        Self {
            noise_squared: passed * (1.0 - kept) + of_steps * kept,
            pattern: together(pattern, places),
            tone: together(tone.max(pattern), places),
            places,
            steps: of_steps * share,
            kernel: passed,
        }
    }
}

/// Standard deviations of a normal distribution in a 95 % half width.
const K: f64 = 1.959_964;

/// Squared standard uncertainties of the four parameters from all sources except the model, in the order of
/// [`Source::ALL`].
pub fn budgets(fit: &Fit, scatter: &Scatter, settings: &Settings, motion: &Motion) -> [[f64; 9]; 4] {
    let stated = |u95: f64| (u95 / K).powi(2);
    let [inertance, ..] = fit.values;
    let own = f64::from(motion.acceleration_squared);
    let count = (settings.metres_per_count * f64::from(motion.low_squared)).powi(2) * scatter.kernel / (2.0 * own);
    let by_readings = (f64::from(motion.repeats) - 1.0) / (6.0 * f64::from(motion.readings));
    // zeta(3) / pi^4
    let amplitude = count * (by_readings + 1.202_057 / std::f64::consts::PI.powi(4) * count.sqrt());
    let amplitude = amplitude * f64::from(motion.steady).powi(2);
    let compliance = if settings.stiffness_n_per_m > 0.0 { 1.0 / settings.stiffness_n_per_m } else { 0.0 };
    let compliance_u95 = match settings.stiffness_u95_n_per_m {
        _ if compliance == 0.0 => f64::INFINITY,
        0.0 => 0.01 * compliance,
        stated => stated * compliance * compliance,
    };
    let (mass, high) = (settings.structure_mass_kg, f64::from(motion.frequency_squared));
    let stretch = inertance.abs() * high;
    std::array::from_fn(|i| {
        let error_squared = fit.errors[i].powi(2);
        let mut squares = [0.0; 9];
        let mut and = |source: Source, square: f64| squares[source as usize] += square;
        and(Source::Noise, scatter.noise_squared * error_squared);
        let repeated = match i {
            0 => (scatter.pattern * error_squared)
                .max(together(inertance.powi(2) * amplitude, scatter.places * error_squared)),
            3 => scatter.pattern * error_squared,
            _ => scatter.tone * error_squared,
        };
        and(Source::Encoder, repeated + stated(fit.steps[i]));
        and(Source::Skew, stated(fit.per_skew[i] * settings.skew_u95_s));
        and(Source::Gain, stated(fit.values[i] * settings.force_gain_u95));
        if i < 2 {
            and(Source::Lead, stated(fit.values[i] * settings.lead_u95));
            and(Source::Timebase, stated((2 - i) as f64 * fit.values[i] * settings.timebase_u95));
        }
        if i == 0 {
            and(Source::Structure, stated((1.0 - stretch * compliance) * settings.structure_mass_u95_kg));
            and(Source::Structure, stated(f64::from(motion.apart) * mass));
            and(Source::Stiffness, stated((mass * stretch * compliance_u95).min(1.5 * mass)));
        } else if i < 3 && mass > 0.0 {
            let curved = f64::from(motion.friction_in_curvature[i - 1]);
            let lag = settings.contact_damping_n_s_per_m * compliance;
            let per_compliance = mass * (curved + 2.0 * lag * high * fit.per_skew[i]);
            // With a contact of unknown stiffness, the device's natural frequency is at least 5 Hz.
            let loosest = 1.5 / (inertance.abs() * high.max((std::f64::consts::TAU * 5.0).powi(2)));
            and(Source::Stiffness, stated(per_compliance * compliance_u95.min(loosest)));
        }
        squares
    })
}

/// Shift of the three parameters beyond chance when updates near rest are left out, as a half width.
pub fn moved(
    rows: &[[f64; 7]],
    all: &Fit,
    scatter: &Scatter,
    kernel: &Kernel,
    oversampling: f64,
    repeats: f64,
) -> [f64; 3] {
    let mut square = 0.0;
    let mut away = Vec::new();
    for (n, row) in rows.iter().enumerate() {
        square += row[1] * row[1];
        // Half of the velocity's rms so far.
        if row[1] * row[1] >= square / (n + 1) as f64 / 4.0 {
            away.push(*row);
        }
    }
    let away = fit(&away, kernel, oversampling);
    let by_chance = scatter.noise_squared + scatter.steps * (repeats - 1.0);
    std::array::from_fn(|i| {
        let moved = all.values[i] - away.values[i];
        let chance = away.errors[i].powi(2) - all.errors[i].powi(2);
        1.4 * (moved * moved - by_chance * chance).max(0.0).sqrt()
    })
}
