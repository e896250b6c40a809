//! The paper's order: friction from the slowest file, everything else from the next ones; the fastest one validates.

use inerter_core::Settings;

use super::{
    IdentifyError, Validation,
    complete::{self, Fitted, State, Task, judged},
    parameters::{Name, Parameters},
    prepared::{Prepared, motion},
    uncertainty::Errors,
};

/// The result of the stages.
pub struct Stages {
    /// Fit of the second stage.
    pub fitted: Fitted,
    /// Its fitting task.
    pub task: Task,
    /// The stretches that it was fitted to.
    pub stretches: Vec<Prepared>,
    /// The result on the last file.
    pub validation: Option<Validation>,
}

/// Fits in stages. The friction found first is not fixed in the second stage, but enters it as prior knowledge with its
/// interval.
pub fn fit(
    settings: &Settings,
    stretches: &[Prepared],
    task: &Task,
    start: &Parameters,
    tick: &mut dyn FnMut(),
) -> Result<Stages, IdentifyError> {
    let mut files: Vec<usize> = stretches.iter().map(|prepared| prepared.file).collect();
    files.dedup();
    files.sort_by(|a, b| frequency_hz(stretches, *a).total_cmp(&frequency_hz(stretches, *b)));
    let (slowest, middle, last) = match files.as_slice() {
        [slowest, second] => (*slowest, vec![*second], None),
        [slowest, middle @ .., last] if !middle.is_empty() => (*slowest, middle.to_vec(), Some(*last)),
        _ => return Err(IdentifyError::Stages { files: files.len() }),
    };
    let of = |files: &[usize]| -> Vec<Prepared> {
        let chosen = stretches.iter().filter(|prepared| files.contains(&prepared.file));
        // Offsets are indexed by file from 0.
        let place = |file: usize| files.iter().position(|other| *other == file).unwrap_or(0);
        chosen.map(|prepared| Prepared { file: place(prepared.file), ..prepared.clone() }).collect()
    };
    let slow = of(&[slowest]);
    let only = Task { known: task.known, ..Task::default().with(Name::Coulomb, true, None) };
    let state = State::new(&slow, start);
    let friction = complete::fit(&slow, &only, &state, false, tick).ok_or(IdentifyError::Diverged)?;
    let u95 = Errors::of(&friction, &slow, settings).and_then(|errors| errors.u95(Name::Coulomb));
    let coulomb = friction.state.parameters.coulomb_n;
    let known = u95.filter(|u95| u95.is_finite() && *u95 > 0.0).map(|u95| (coulomb, u95 / 2.0));
    let rest = of(&middle);
    let task = task.clone().with(Name::Coulomb, true, known);
    let state = State::new(&rest, &Parameters { coulomb_n: coulomb, ..*start });
    let fitted = complete::fit(&rest, &task, &state, false, tick).ok_or(IdentifyError::Diverged)?;
    let validation = last.and_then(|last| {
        let stretches = of(&[last]);
        // Offset and zero belong to the rig at that time, not to the device.
        let state = State::new(&stretches, &fitted.state.parameters);
        let state =
            complete::fit(&stretches, &Task::default(), &state, true, tick).map_or(state, |fitted| fitted.state);
        judged(&stretches, &state, 0.0)
    });
    Ok(Stages { fitted, task, stretches: rest, validation })
}

/// Dominant frequency of the motion in a file: RMS velocity over RMS displacement \[Hz\].
fn frequency_hz(stretches: &[Prepared], file: usize) -> f64 {
    let (v, x) = motion(stretches.iter().filter(|prepared| prepared.file == file));
    if x > 0.0 { (v / x).sqrt() / std::f64::consts::TAU } else { 0.0 }
}
