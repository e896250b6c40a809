//! Measured force and law, row by row, for figures.

use inerter_core::{Settings, constants::REST_WINDOW_S};
use inerter_data::series::{Series, Stretch};

use crate::{
    law::{Kernels, Law, Measured, around, stands},
    reversals::Turns,
};

/// Measured force and law at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Time \[s\].
    pub t_s: f64,
    /// Displacement of the screw \[m\].
    pub position_m: f64,
    /// Measured force \[N\].
    pub force_n: f64,
    /// Force by the law \[N\]; NaN where the screw is at rest, because static friction follows no law.
    pub law_n: f64,
}

impl Kernels {
    /// Rows of all stretches between two times \[s\], with this many per box.
    pub fn rows(
        &self,
        series: &Series,
        settings: &Settings,
        law: &Law,
        (from_s, to_s): (f64, f64),
        per_box: usize,
    ) -> Vec<Row> {
        let spacing = (self.box_samples / per_box).max(1);
        // The structure moves with the screw.
        let moved = Law { inertance_kg: law.inertance_kg + settings.structure_mass_kg, ..*law };
        let mut rows = Vec::new();
        for stretch in &series.aligned(settings).stretches {
            let margin_s = (self.reach() + 2) as f64 * self.period_s;
            let first = ((from_s - stretch.start_s - margin_s) / self.period_s).floor().max(0.0) as usize;
            let last = ((to_s - stretch.start_s + margin_s) / self.period_s).ceil().max(0.0) as usize;
            let last = last.min(stretch.force_n.len());
            let (Some(position), Some(force)) = (stretch.position_m.get(first..last), stretch.force_n.get(first..last))
            else {
                continue;
            };
            let start_s = stretch.start_s + first as f64 * self.period_s;
            let piece =
                Stretch { start_s, position_m: position.to_vec(), force_n: force.to_vec(), terminal_m: Vec::new() };
            let signs = Turns::of(&piece, self.period_s, &moved).signs;
            let middles = (self.reach()..piece.force_n.len().saturating_sub(self.reach())).step_by(spacing);
            let new = middles.map(|middle| self.row(&piece, &signs, settings, law, middle));
            rows.extend(new.filter(|row| (from_s..=to_s).contains(&row.t_s)));
            // A line across missing samples would show something that was not measured.
            rows.push(Row { t_s: f64::NAN, position_m: f64::NAN, force_n: f64::NAN, law_n: f64::NAN });
        }
        rows
    }

    fn row(&self, piece: &Stretch, signs: &[f64], settings: &Settings, law: &Law, middle: usize) -> Row {
        let Measured { force_n, velocity, acceleration, stretch } = self.measured(piece, settings, middle);
        let law_n = law.inertance_kg * acceleration
            + law.viscous_n_s_per_m * velocity
            + law.coulomb_n * around(&self.sign, signs, middle)
            + law.offset_n
            + settings.structure_mass_kg * (acceleration + stretch);
        let half = (REST_WINDOW_S / 2.0 / self.period_s).ceil() as usize;
        let near = piece.position_m.get(middle.saturating_sub(half)..middle + half + 1).unwrap_or(&piece.position_m);
        Row {
            t_s: piece.start_s + middle as f64 * self.period_s,
            position_m: around(&self.force, &piece.position_m, middle),
            force_n,
            law_n: if stands(near, settings) { f64::NAN } else { law_n },
        }
    }
}
