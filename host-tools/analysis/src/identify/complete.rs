//! The complete model fitted to encoder and force together, driven by the terminal's displacement.
//!
//! Levenberg-Marquardt least squares of both whitened residuals ([`super::spectrum`]). Derivatives by central
//! differences of simulations, which are smooth in the parameters; offset, structure mass and zero of the encoder need
//! none. Prior knowledge (structure mass, skew) enters as one more observation each.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::{DMatrix, DVector, Dyn, Owned};

use super::{
    model::{Input, Node, Response, Start, delayed, load_cell, simpson, simulate},
    parameters::{Name, Parameters, SHARED},
    prepared::Prepared,
    result::Validation,
    spectrum::Whitening,
};
use crate::cores::on_cores;

/// A stretch with its weights and its simulation input, for devices close to one.
struct Weighed<'a> {
    prepared: &'a Prepared,
    input: Input,
    /// The terminal's acceleration as two-sample means, like those of the contact force.
    acceleration: Vec<f64>,
    /// The difference that averaging makes at the force jumps where the flanks meet.
    jumps: Vec<f64>,
    /// Repeated realisations of the effect of the terminal's noise on encoder and force.
    disturbed: Vec<Columns>,
    whitening: Whitening,
    start: Start,
}

impl Weighed<'_> {
    /// Displacement of the screw, and the load cell's force as means over two samples.
    fn predicted(&self, device: &Parameters) -> Columns {
        let response = simulate(device, &self.input, self.start);
        let cell = mean_cell(device, &response, &self.acceleration, self.prepared.period_s);
        (response.position_m, cell)
    }
}

/// Prior knowledge of a parameter: value and standard deviation.
pub type Known = (f64, f64);

/// The fitting task.
#[derive(Clone, Debug, Default)]
pub struct Task {
    /// Which of [`SHARED`] are fitted.
    pub free: [bool; 8],
    /// Prior knowledge of each.
    pub known: [Option<Known>; 8],
}

impl Task {
    /// Prior knowledge of a parameter.
    pub fn known_of(&self, name: Name) -> Option<Known> {
        self.known[name as usize]
    }

    /// With a parameter fitted or not, and its prior knowledge.
    pub fn with(mut self, name: Name, free: bool, known: Option<Known>) -> Self {
        (self.free[name as usize], self.known[name as usize]) = (free, known);
        self
    }
}

/// The result of a fit.
pub struct Fitted {
    /// Best values.
    pub state: State,
    /// Half the sum of squares of the whitened residuals.
    pub cost: f64,
    /// Whether the iteration converged.
    pub converged: bool,
    /// The fitted parameters.
    pub free: Vec<Name>,
    /// Rows of the whitened residual.
    pub residual: DVector<f64>,
    /// Derivatives of the whitened residual, columns as [`Fitted::free`], then offsets, then zeros.
    pub jacobian: DMatrix<f64>,
    /// Local mean square of the whitened residual around each row.
    pub power: Vec<f64>,
    /// Whitened force residual in the time domain.
    pub white: Vec<f64>,
    /// Whitened rows of repeated realisations of the effect of the terminal's noise on encoder and force.
    pub disturbed: Vec<DVector<f64>>,
    /// Weights of the stretches.
    whitenings: Vec<Whitening>,
}

impl Fitted {
    /// RMS ratio of the residual to what the noise explains.
    pub fn over_noise(&self) -> f64 {
        (2.0 * self.cost / self.residual.len().max(1) as f64).sqrt()
    }
}

struct Problem<'a> {
    stretches: &'a [Weighed<'a>],
    task: &'a Task,
    free: Vec<Name>,
    files: usize,
    base: Parameters,
    /// Steps of the numerical derivatives, in the order of [`SHARED`].
    steps: [f64; 8],
    values: DVector<f64>,
}

/// Steps of the numerical derivatives while the errors are unknown: a change of the force by about a thousandth.
fn first_steps(stretches: &[Prepared], device: &Parameters) -> [f64; 8] {
    let rms = |values: &mut dyn Iterator<Item = f64>| {
        let (sum, count) = values.fold((0.0, 0usize), |(sum, count), x| (sum + x * x, count + 1));
        (sum / count.max(1) as f64).sqrt()
    };
    let force = rms(&mut stretches.iter().flat_map(|s| s.force.iter().copied())).max(1e-3);
    let velocity = rms(&mut stretches.iter().flat_map(|s| s.smooth.nodes.iter().map(|node| node[1]))).max(1e-6);
    SHARED.map(|name| match name {
        Name::Inertance => 1e-4,
        Name::Stiffness => 1e-3,
        Name::Damping => 1e-2,
        Name::Coulomb => 1e-3 * force,
        Name::Viscous => (1e-3 * force / velocity).min(1e-2 * device.contact_damping_n_s_per_m.max(1.0)),
        Name::Backlash => 3e-3 * force / device.stiffness_n_per_m,
        Name::Structure => 1e-3 * device.inertance_kg,
        Name::Skew => 1e-6,
    })
}

impl Problem<'_> {
    fn decoded(&self, values: &DVector<f64>) -> Parameters {
        let mut parameters = self.base;
        for (name, value) in self.free.iter().zip(values.iter()) {
            let value = match name {
                name if name.is_logarithmic() => value.clamp(-60.0, 60.0).exp(),
                name if name.has_floor() => value.max(0.0),
                _ => *value,
            };
            *name.slot(&mut parameters) = value;
        }
        parameters
    }

    fn offset(&self, file: usize) -> f64 {
        self.values.get(self.free.len() + file).copied().unwrap_or_default()
    }

    fn zero(&self, stretch: usize) -> f64 {
        self.values[self.free.len() + self.files + stretch]
    }

    fn rows(&self) -> usize {
        self.stretches.iter().map(|stretch| stretch.whitening.rows()).sum::<usize>() + SHARED.len()
    }

    /// Derivative of the whitened residual of one stretch with respect to one column's parameter.
    fn column(&self, stretch: usize, column: usize, rows: &mut [f64]) {
        let weighed = &self.stretches[stretch];
        let shared = self.free.len();
        let count = weighed.prepared.force.len();
        let none = || std::iter::repeat_n(0.0, count);
        let period_s = weighed.prepared.period_s;
        if let Some(&name) = self.free.get(column) {
            let device = self.decoded(&self.values);
            let (step, value) = (self.steps[name as usize], self.values[column]);
            let down = if name.has_floor() && value < step { 0.0 } else { step };
            let at = |change: f64| {
                let mut values = self.values.clone();
                values[column] = if name.has_floor() { value.max(0.0) + change } else { value + change };
                self.decoded(&values)
            };
            if name == Name::Structure {
                let late = delayed(&weighed.acceleration, device.skew_s / period_s);
                weighed.whitening.whitened(none(), late.iter().map(|a| -a), rows);
                return;
            }
            let ((x_up, f_up), (x_down, f_down)) = (weighed.predicted(&at(step)), weighed.predicted(&at(-down)));
            let per = -1.0 / (step + down);
            let difference = |up: &[f64], down: &[f64]| -> Vec<f64> {
                up.iter().zip(down).map(|(up, down)| (up - down) * per).collect()
            };
            let (x, f) = (difference(&x_up, &x_down), difference(&f_up, &f_down));
            weighed.whitening.whitened(x.into_iter(), f.into_iter(), rows);
        } else if column == shared + weighed.prepared.file {
            weighed.whitening.whitened(none(), std::iter::repeat_n(-1.0, count), rows);
        } else if column == shared + self.files + stretch {
            weighed.whitening.whitened(std::iter::repeat_n(-1.0, count), none(), rows);
        }
    }
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_> {
    type ParameterStorage = Owned<f64, Dyn>;
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;

    fn set_params(&mut self, values: &DVector<f64>) {
        self.values.copy_from(values);
    }

    fn params(&self) -> DVector<f64> {
        self.values.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let device = self.decoded(&self.values);
        let mut rows = DVector::zeros(self.rows());
        let mut rest = rows.as_mut_slice();
        for (number, weighed) in self.stretches.iter().enumerate() {
            let mine = rest.split_off_mut(..weighed.whitening.rows())?;
            let offset_n = self.offset(weighed.prepared.file);
            let (position, cell) = weighed.predicted(&Parameters { offset_n, ..device });
            let zero = self.zero(number);
            let position = weighed.prepared.position.iter().zip(&position).map(|(x, predicted)| x - predicted - zero);
            let predicted = cell.iter().zip(&weighed.jumps).map(|(cell, jump)| cell + jump);
            let force = weighed.prepared.mean_force.iter().zip(predicted).map(|(f, predicted)| f - predicted);
            weighed.whitening.whitened(position, force, mine);
        }
        for (slot, (name, known)) in rest.iter_mut().zip(SHARED.into_iter().zip(self.task.known)) {
            if let (Some((value, deviation)), true) = (known, self.free.contains(&name)) {
                *slot = (name.of(&device) - value) / deviation;
            }
        }
        rows.iter().all(|row| row.is_finite()).then_some(rows)
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let rows = self.rows();
        let mut jacobian = DMatrix::zeros(rows, self.values.len());
        let mut work = Vec::new();
        for (number, column) in jacobian.as_mut_slice().chunks_mut(rows).enumerate() {
            let mut rest = column;
            for (stretch, weighed) in self.stretches.iter().enumerate() {
                work.push((number, stretch, rest.split_off_mut(..weighed.whitening.rows())?));
            }
            if let Some(&name) = self.free.get(number)
                && let Some((_, deviation)) = self.task.known_of(name)
            {
                rest[name as usize] = name.scale(&self.decoded(&self.values)) / deviation;
            }
        }
        // Columns are independent: as many in parallel as the machine has cores, up to four.
        on_cores(work, 4, |(column, stretch, rows)| self.column(stretch, column, rows));
        jacobian.iter().all(|value| value.is_finite()).then_some(jacobian)
    }
}

/// Highest frequency that the fit uses \[Hz\]: beyond it the force contains noise and the ringing of impacts.
fn highest_hz(prepared: &Prepared, device: &Parameters) -> f64 {
    let least = (5.0 * device.own_hz()).max(2.0 * prepared.smooth.band_hz).max(100.0);
    least.min(0.45 / prepared.period_s)
}

/// Factor by which the first round inflates the terminal's noise. The device's resonance then has little weight: there
/// a stiffness error of a percent would hide everything else.
const CAUTION: f64 = 30.0;
/// Maximum rounds of weighting and fitting.
const MOST_ROUNDS: usize = 6;
/// The rounds end when no parameter moves by more than this fraction of its standard error.
const SETTLED: f64 = 0.2;
/// They also end when the cost changes by less than this fraction.
const STANDS: f64 = 1e-4;
/// Steps of the numerical derivatives, in standard errors.
const STEP: f64 = 3.0;

/// Number of noise realisations of the terminal.
const DISTURBED: u64 = 16;
/// A jump exceeds the force's noise by this factor.
const JUMP: f64 = 2.0;

/// Marks samples at a jump and on either side of it.
fn beside(jumps: &[f64], least: f64) -> impl Iterator<Item = bool> {
    let is_jump = move |place: usize| jumps.get(place).is_some_and(|jump| jump.abs() > least);
    (0..jumps.len()).map(move |place| is_jump(place) || is_jump(place + 1) || place.checked_sub(1).is_some_and(is_jump))
}

/// The load cell's force as means over two samples.
fn mean_cell(device: &Parameters, response: &Response, acceleration: &[f64], period_s: f64) -> Vec<f64> {
    let late = device.skew_s / period_s;
    load_cell(device, &delayed(&response.mean_n, late), &delayed(acceleration, late))
}

/// Parameters, offsets of files and encoder zeros of stretches.
#[derive(Clone, Debug)]
pub struct State {
    /// Shared by all stretches.
    pub parameters: Parameters,
    /// Offsets of the files \[N\].
    pub offsets: Vec<f64>,
    /// Zeros of the stretches: encoder minus model \[m\].
    pub zeros: Vec<f64>,
}

impl State {
    /// A start with equal offsets for all files, and the screw centred on average.
    pub fn new(stretches: &[Prepared], parameters: &Parameters) -> Self {
        let files = stretches.iter().map(|stretch| stretch.file + 1).max().unwrap_or(0);
        Self {
            parameters: *parameters,
            offsets: vec![parameters.offset_n; files],
            zeros: stretches.iter().map(Prepared::zero).collect(),
        }
    }
}

/// The stretches with the weights that follow from a device.
///
/// With `jumps` the force jumps where the flanks meet are those of single samples, and their positions are fixed: if
/// they could move, the sum of squares would be a staircase. As means, the sum is smooth, but locates each jump only to
/// within a sample. The samples next to a jump are left out, because a microsecond decides on which side they are.
fn weigh<'a>(stretches: &'a [Prepared], state: &State, caution: f64, jumps: bool) -> Vec<Weighed<'a>> {
    let device = &state.parameters;
    let weigh = |(prepared, zero): (&'a Prepared, &f64)| {
        let period_s = prepared.period_s;
        let start = Start { position_m: prepared.begun.position_m - zero, ..prepared.begun };
        let moved = |nodes: &[Node]| {
            let input = Input::new(nodes, period_s, device);
            let response = simulate(device, &input, start);
            let acceleration = simpson(&input.acceleration);
            let cell = mean_cell(device, &response, &acceleration, period_s);
            (input, acceleration, response, cell)
        };
        let (input, acceleration, response, cell) = moved(&prepared.smooth.nodes);
        let jumps = if jumps && device.backlash_m > 0.0 {
            let means = delayed(&response.mean_n, device.skew_s / period_s);
            simpson(&response.force_n).iter().zip(means).map(|(sampled, mean)| sampled - mean).collect()
        } else {
            vec![0.0; input.len()]
        };
        let numbers = if prepared.smooth.noise > 0.0 { 0..DISTURBED } else { 0..0 };
        let disturbed: Vec<Columns> = numbers
            .map(|number| {
                let (_, _, other, other_cell) = moved(&prepared.smooth.disturbed(period_s, caution, number));
                let less = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect();
                (less(&other.position_m, &response.position_m), less(&other_cell, &cell))
            })
            .collect();
        let left_out = beside(&jumps, JUMP * prepared.noise.force);
        let highest_hz = highest_hz(prepared, device);
        let whitening = Whitening::new(
            input.len(),
            period_s,
            prepared.settling(),
            highest_hz,
            prepared.noise,
            left_out,
            &disturbed,
        );
        Weighed { prepared, acceleration, input, jumps, disturbed, whitening, start }
    };
    stretches.iter().zip(&state.zeros).map(weigh).collect()
}

/// One minimisation with fixed weights.
fn minimised<'a>(
    weighed: &'a [Weighed<'a>],
    task: &'a Task,
    state: &State,
    steps: [f64; 8],
) -> (Problem<'a>, f64, bool) {
    let free: Vec<Name> = SHARED.into_iter().filter(|name| task.free[*name as usize]).collect();
    let encoded = free.iter().map(|name| {
        let value = name.of(&state.parameters);
        if name.is_logarithmic() { value.max(f64::MIN_POSITIVE).ln() } else { value }
    });
    let values: Vec<f64> = encoded.chain(state.offsets.iter().copied()).chain(state.zeros.iter().copied()).collect();
    let problem = Problem {
        stretches: weighed,
        task,
        free,
        files: state.offsets.len(),
        base: state.parameters,
        steps,
        values: DVector::from_vec(values),
    };
    let (problem, report) =
        LevenbergMarquardt::new().with_ftol(1e-7).with_xtol(1e-6).with_patience(4).minimize(problem);
    (problem, report.objective_function, report.termination.was_successful())
}

impl Problem<'_> {
    /// Largest change of a shared parameter since a state, in standard errors, and the standard errors.
    fn moved_from(&self, before: &State, jacobian: &DMatrix<f64>) -> (f64, Vec<(Name, f64)>) {
        let Some(covariance) = jacobian.tr_mul(jacobian).try_inverse() else { return (0.0, Vec::new()) };
        let now = self.decoded(&self.values);
        let errors = covariance.diagonal().map(|variance| variance.max(0.0).sqrt());
        let errors: Vec<(Name, f64)> = self.free.iter().copied().zip(errors.iter().copied()).collect();
        let moves = errors.iter().map(|(name, error)| {
            let (now, before) = (name.of(&now), name.of(&before.parameters));
            let step = if name.is_logarithmic() { (now / before).ln() } else { now - before };
            step.abs() / error.max(f64::MIN_POSITIVE)
        });
        (moves.fold(0.0, f64::max), errors)
    }

    fn state(&self) -> State {
        let mut parameters = self.decoded(&self.values);
        parameters.offset_n = self.offset(0);
        State {
            parameters,
            offsets: (0..self.files).map(|file| self.offset(file)).collect(),
            zeros: (0..self.stretches.len()).map(|stretch| self.zero(stretch)).collect(),
        }
    }
}

/// Fits the model from a roughly correct start. `is_near` skips the cautious first round.
pub fn fit(
    stretches: &[Prepared],
    task: &Task,
    start: &State,
    is_near: bool,
    tick: &mut dyn FnMut(),
) -> Option<Fitted> {
    let mut state = start.clone();
    let rounds: &[(f64, bool)] = if is_near { &[(1.0, true)] } else { &[(CAUTION, false), (1.0, false), (1.0, true)] };
    let first = first_steps(stretches, &start.parameters);
    let (mut steps, mut before) = (first, f64::INFINITY);
    for (number, (caution, jumps)) in
        rounds.iter().copied().chain(std::iter::repeat((1.0, true))).take(MOST_ROUNDS).enumerate()
    {
        let weighed = weigh(stretches, &state, caution, jumps);
        let (problem, cost, converged) = minimised(&weighed, task, &state, steps);
        tick();
        let jacobian = problem.jacobian()?;
        let (moved, errors) = problem.moved_from(&state, &jacobian);
        // Once the errors are known, so are steps within which the device is nearly linear.
        for (name, error) in errors {
            let first = first[name as usize];
            steps[name as usize] = (STEP * error).clamp(1e-2 * first, first);
        }
        let stands = (before - cost).abs() < STANDS * cost;
        before = cost;
        let residual = problem.residuals()?;
        state = problem.state();
        let free = problem.free;
        if number + 1 < MOST_ROUNDS && (number + 1 < rounds.len() || moved > SETTLED && !stands) {
            continue;
        }
        let (mut power, mut white) = (Vec::with_capacity(residual.len()), Vec::new());
        let mut rest = residual.as_slice();
        for weighed in &weighed {
            let mine = rest.split_off(..weighed.whitening.rows())?;
            power.extend(weighed.whitening.power(mine));
            white.extend(weighed.whitening.force_in_time(mine));
        }
        power.resize(residual.len(), 1.0);
        let disturbed = (0..DISTURBED as usize)
            .map(|number| {
                let each = weighed.iter().map(|weighed| (&weighed.whitening, weighed.disturbed.get(number)));
                whitened_rows(residual.len(), each)
            })
            .collect();
        let whitenings = weighed.into_iter().map(|weighed| weighed.whitening).collect();
        return Some(Fitted { state, cost, converged, free, residual, jacobian, power, white, disturbed, whitenings });
    }
    None
}

/// Minimum cost with one parameter fixed, and all weights from the best fit.
pub fn cost_with(stretches: &[Prepared], task: &Task, best: &State, held: Option<(Name, f64)>) -> Option<f64> {
    let weighed = weigh(stretches, best, 1.0, true);
    let (mut task, mut state) = (task.clone(), best.clone());
    if let Some((name, value)) = held {
        *name.slot(&mut state.parameters) = value;
        task.free[name as usize] = false;
    }
    let (_, cost, _) = minimised(&weighed, &task, &state, first_steps(stretches, &best.parameters));
    cost.is_finite().then_some(cost)
}

/// The model's prediction for a stretch with this number: displacement as the encoder reads it \[m\], and the load
/// cell's force \[N\].
pub fn prediction(state: &State, number: usize, prepared: &Prepared) -> Columns {
    let zero = state.zeros[number];
    let device = Parameters { offset_n: state.offsets[prepared.file], ..state.parameters };
    let input = Input::new(&prepared.smooth.nodes, prepared.period_s, &device);
    let start = Start { position_m: prepared.begun.position_m - zero, ..prepared.begun };
    let response = simulate(&device, &input, start);
    let acceleration = delayed(&input.acceleration, device.skew_s / prepared.period_s);
    let cell = load_cell(&device, &response.force_n, &acceleration);
    (response.position_m.iter().map(|x| x + zero).collect(), cell)
}

/// Samples of a stretch that count fully.
pub fn counting(prepared: &Prepared) -> std::ops::Range<usize> {
    let count = prepared.force.len();
    let end = ((0.1 / prepared.period_s) as usize).min(count / 8);
    prepared.settling() + end..count - end
}

/// How well a model explains the rest of each stretch after its fitted part.
pub fn judged(stretches: &[Prepared], state: &State, fitted: f64) -> Option<Validation> {
    let (mut left, mut all, mut count) = (0.0, 0.0, 0usize);
    for (number, prepared) in stretches.iter().enumerate() {
        let (_, force) = prediction(state, number, prepared);
        let range = counting(prepared);
        let from = range.start.max((fitted * prepared.force.len() as f64) as usize);
        let offset_n = state.offsets[prepared.file];
        let pairs = prepared.force.iter().zip(&force).take(range.end).skip(from);
        for (measured, predicted) in pairs {
            left += (measured - predicted).powi(2);
            all += (measured - offset_n).powi(2);
            count += 1;
        }
    }
    (count > 0 && all > 0.0).then(|| Validation {
        fitted,
        residual_rms_n: (left / count as f64).sqrt(),
        explained: 1.0 - left / all,
    })
}

/// Displacement and force of each sample.
pub type Columns = (Vec<f64>, Vec<f64>);

/// Whitened rows of a change in the measured values, stretch by stretch: the signature of a systematic measurement
/// error.
pub fn error_rows(
    stretches: &[Prepared],
    fitted: &Fitted,
    change: &dyn Fn(usize, &Prepared) -> Columns,
) -> DVector<f64> {
    let changes: Vec<Columns> =
        stretches.iter().enumerate().map(|(number, prepared)| change(number, prepared)).collect();
    whitened_rows(fitted.residual.len(), fitted.whitenings.iter().zip(changes.iter().map(Some)))
}

/// Whitened rows, stretch by stretch, `count` in total.
fn whitened_rows<'a>(
    count: usize,
    stretches: impl Iterator<Item = (&'a Whitening, Option<&'a Columns>)>,
) -> DVector<f64> {
    let mut rows = DVector::zeros(count);
    let mut rest = rows.as_mut_slice();
    for (whitening, columns) in stretches {
        let Some(mine) = rest.split_off_mut(..whitening.rows()) else { break };
        if let Some((position, force)) = columns {
            whitening.whitened(position.iter().copied(), force.iter().copied(), mine);
        }
    }
    rows
}
