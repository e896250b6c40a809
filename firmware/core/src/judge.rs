//! What the residual near rest says of friction, and by how much the intervals must grow for it.
//!
//! Floats are allowed here: nothing flows back to the signal path.
//!
//! A law that fits worse by the variance `E^2` when the updates near rest are in carries an error of that size, which
//! no averaging removes. Were all of it alike to a regressor, the parameter would be wrong by `Q = E sqrt(inv(A)_ii)`.
//! The part that is alike grows with the share that the error has in friction, `Q_fc / fc`; its factors below, and
//! twice what the parameter moves by between both fits, cover the simulated devices of docs/tables/robustness.md. A
//! presliding screw is a spring while it creeps, which in a steady tone is inertance and nothing else: that part is
//! of the size of `fc` over the acceleration.

use crate::detail::Conduct;
use crate::estimate::{Parameter, Parameters, Status};
use crate::ldl::UNKNOWNS;
use crate::math::{magnitude, sqrt};
use crate::report::Fit;

/// Ratio of the residual variances, all over away, that Coulomb's friction does not reach.
const RATIO: f32 = 1.5;
/// Standard deviations of that ratio by chance alone, on top.
const CHANCE: f32 = 3.0;
/// Observations away from rest under which nothing is said.
const LEAST_OBSERVATIONS: f32 = 16.0;
/// Least part of the error that counts as alike to a regressor, and its growth with the error's share in friction.
const ALIKE: (f32, f32) = (0.35, 1.3);
/// Part of the error by which Stribeck's friction moves twice Coulomb's: 0.15 to 1.6 are seen, 0.06 with presliding.
const STRIBECK: f32 = 0.1;
/// Coulomb friction per residual beyond which an unlawful friction could hide in the others: 28 at 15.9 Hz, where a
/// steady tone tells Coulomb from viscous friction by its beginning only; under 5 for the other motions of the grid.
const HIDDEN: f32 = 10.0;
/// Spring of a creeping screw taken for inertance, per share in friction and `fc` over the rms of the acceleration.
const SPRING: f32 = 0.6;

/// What friction looks like, and the systematic error of inertance, viscous and Coulomb friction by it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Judgement {
    pub conduct: Conduct,
    pub errors: [f32; 3],
}

impl Judgement {
    /// From the fits to all updates and to those away from rest, the rms of acceleration \[m/s^2\] and velocity \[m/s\],
    /// and viscous friction as it would be published.
    pub fn of(all: &Fit, away: &Fit, [acceleration, velocity]: [f32; 2], viscous: &Parameter) -> Self {
        let ([mt, cf, fc, _], [mt_away, cf_away, fc_away, _]) = (all.values, away.values);
        let ([mt_error, cf_error, fc_error, _], [_, _, fc_away_error, _]) = (all.errors, away.errors);
        let enough = away.observations >= LEAST_OBSERVATIONS && away.variance > 0.0;
        if !enough || !fc_error.is_finite() || !fc_away_error.is_finite() {
            return Self::default();
        }
        let (mt_moved, cf_moved, fc_moved) = (2.0 * (mt - mt_away), 2.0 * (cf - cf_away), 2.0 * (fc - fc_away));
        if fc > 0.0 && viscous.value + viscous.u95 < 0.0 {
            // What falls with the velocity may as well be taken for inertance.
            let inertance = length(mt_moved, viscous.value * velocity / acceleration);
            return Self { conduct: Conduct::Stribeck, errors: [inertance, f32::INFINITY, f32::INFINITY] };
        }
        let ratio = all.variance / away.variance;
        let freedom = |fit: &Fit| fit.observations - UNKNOWNS as f32;
        let chance = 2.0 / freedom(away) - 2.0 / freedom(all);
        if ratio <= RATIO + CHANCE * sqrt(if chance > 0.0 { chance } else { 0.0 }) {
            let hidden = fc_error * fc_error * all.observations > HIDDEN * HIDDEN * all.variance;
            return Self { conduct: if hidden { Conduct::Unknown } else { Conduct::Coulomb }, errors: [0.0; 3] };
        }
        let per_error = sqrt(all.observations * (1.0 - 1.0 / ratio));
        let (fc, fc_alike) = (magnitude(fc), fc_error * per_error);
        let (share, friction_n) = if fc_alike < fc { (fc_alike / fc, fc) } else { (1.0, fc_alike) };
        let alike = if ALIKE.0 > ALIKE.1 * share { ALIKE.0 } else { ALIKE.1 * share };
        // Friction that falls with the velocity is alike to more of Coulomb's; friction that comes late is not, and its
        // spring takes from the inertance.
        let falls = fc_moved > STRIBECK * fc_alike && mt_moved > -2.0 * STRIBECK * mt_error * per_error;
        let (conduct, spring) = if falls {
            (Conduct::Stribeck, 0.0)
        } else {
            (Conduct::Presliding, SPRING * share * friction_n / acceleration)
        };
        let viscous = length(cf_moved, alike * cf_error * per_error);
        Self { conduct, errors: [length(mt_moved, spring), viscous, length(fc_moved, alike * fc_alike)] }
    }

    /// Widens the intervals; a parameter that is no longer known is not identifiable.
    pub fn widen(&self, parameters: &mut Parameters, widest: f32) {
        let Parameters { inertance_kg, viscous_n_s_per_m, coulomb_n, .. } = parameters;
        for (parameter, error) in [inertance_kg, viscous_n_s_per_m, coulomb_n].into_iter().zip(self.errors) {
            if parameter.status == Status::NotIdentifiable || error == 0.0 {
                continue;
            }
            parameter.u95 = length(parameter.u95, error);
            if !parameter.u95.is_finite() {
                *parameter = Parameter { value: 0.0, u95: f32::INFINITY, status: Status::NotIdentifiable };
            } else if parameter.u95 > widest * magnitude(parameter.value) {
                parameter.status = Status::NotIdentifiable;
            }
        }
    }
}

fn length(a: f32, b: f32) -> f32 {
    sqrt(a * a + b * b)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fit of the reference device's random motion, as moved by so much and with this residual \[N\].
    fn fit(moved: [f32; 3], residual: f32, observations: f32) -> Fit {
        let values = [299.5 + moved[0], 31.4 + moved[1], 50.0 + moved[2], 3.0];
        let error = residual / sqrt(observations);
        Fit {
            values,
            errors: [0.17 * error, 28.0 * error, 2.6 * error, error],
            variance: residual * residual,
            observations,
        }
    }

    fn judged(all: Fit, away: Fit) -> Judgement {
        let viscous = Parameter { value: all.values[1], u95: 3.0 * all.errors[1], status: Status::Ok };
        Judgement::of(&all, &away, [5.0, 0.02], &viscous)
    }

    #[test]
    fn friction_is_called_by_its_residual_and_by_what_moves() {
        let away = |residual| fit([0.0; 3], residual, 370.0);
        let coulomb = judged(fit([0.0, 0.1, -0.02], 0.39, 600.0), away(0.38));
        assert_eq!(coulomb, Judgement { conduct: Conduct::Coulomb, errors: [0.0; 3] });
        let presliding = judged(fit([-0.3, 7.8, -0.9], 6.46, 600.0), away(3.07));
        assert_eq!(presliding.conduct, Conduct::Presliding);
        let stribeck = judged(fit([0.003, -5.9, 0.6], 0.66, 600.0), away(0.39));
        assert_eq!(stribeck.conduct, Conduct::Stribeck);
        assert!(stribeck.errors[0] < 0.01 && stribeck.errors[1] > 11.8 && stribeck.errors[2] > 1.2);
        let falling = judged(fit([0.0, -100.0, 5.0], 0.4, 600.0), away(0.4));
        assert_eq!((falling.conduct, falling.errors[2]), (Conduct::Stribeck, f32::INFINITY));
        // The same ratio by chance, of few observations.
        assert_eq!(judged(fit([0.0; 3], 0.5, 32.0), fit([0.0; 3], 0.38, 22.0)).conduct, Conduct::Coulomb);
        assert_eq!(judged(fit([0.0; 3], 5.0, 50.0), fit([0.0; 3], 0.4, 15.0)), Judgement::default());
        let mut tone = fit([0.0; 3], 0.39, 600.0);
        tone.errors[2] *= 10.0;
        assert_eq!(judged(tone, away(0.38)).conduct, Conduct::Unknown);
    }

    #[test]
    fn intervals_only_grow_and_give_up_past_the_widest() {
        let known = |value, u95| Parameter { value, u95, status: Status::Ok };
        let before = Parameters {
            inertance_kg: known(300.0, 0.3),
            viscous_n_s_per_m: known(31.4, 4.0),
            coulomb_n: known(50.0, 2.5),
            offset_n: known(3.0, 0.1),
        };
        let mut same = before;
        Judgement::default().widen(&mut same, 0.5);
        assert_eq!(same, before);
        let mut wide = before;
        Judgement { conduct: Conduct::Stribeck, errors: [0.4, 20.0, f32::INFINITY] }.widen(&mut wide, 0.5);
        assert_eq!(wide.inertance_kg, known(300.0, 0.5));
        assert!((wide.viscous_n_s_per_m.u95 - 20.396).abs() < 1e-3);
        assert_eq!(wide.viscous_n_s_per_m.status, Status::NotIdentifiable);
        assert_eq!((wide.coulomb_n.status, wide.coulomb_n.u95), (Status::NotIdentifiable, f32::INFINITY));
        assert_eq!(wide.offset_n, before.offset_n);
    }
}
