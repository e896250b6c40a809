//! What the residual near rest shows of friction, and by how much the intervals must grow for it.
//!
//! Floats are allowed here: nothing is fed back to the signal path.
//!
//! A law whose residual has `E^2` more variance when the updates near rest are included carries an error of that size,
//! which averaging does not remove. If all of it resembled a regressor, the parameter would be wrong by
//! `Q = E sqrt(inv(A)_ii)`. The part that resembles it grows with the share that the error has in friction,
//! `Q_fc / fc`. The factors below, and twice what the parameter moves by between both fits, cover the simulated devices
//! of docs/tables/robustness.md. A presliding screw is a spring while it creeps. In a steady tone that looks exactly
//! like inertance; this part is of the size of `fc` over the acceleration.
//!
//! A residual that the force's noise and the encoder's steps do not explain may have two causes that widen the
//! intervals even where the law is not called broken. Where friction could hide in the other parameters, near and away
//! fit alike, and what is unexplained counts as friction. Where flanks part, it counts as their impacts, which repeat
//! with a periodic motion, and so does the error that they cause. Where it is unknown whether they part, both count.

use crate::budget::{Budget, Source};
use crate::constants;
use crate::detail::{Contact, Law, LawStatus, Misfit, Regime};
use crate::estimate::Interval;
use crate::fit::Fit;
use crate::ldl::UNKNOWNS;
use crate::math::{magnitude, sqrt};

/// Ratio of the residual variances, all over away, that Coulomb friction does not reach.
const RATIO: f32 = 1.5;
/// Ratio of the residual's variance to what is explained that noise and steps do not reach: 1.4 in the grid; 2.3 and
/// more with presliding at 15.9 Hz.
const UNEXPLAINED: f32 = 1.7;
/// The same where flanks may part, and it is not known that they do.
const UNEXPLAINED_IMPACTS: f32 = 1.4;
/// Margin on either ratio for chance [standard deviations].
const CHANCE: f32 = 3.0;
/// Relative variance of the noise's variance as found from the quartile of its differences, times their number:
/// `4 p (1 - p) / (q f(q))^2` with `p` = 1/4, the quartile `q` of a normal magnitude and the density `f` there.
const QUARTILE_CHANCE: f32 = 12.8;
/// Fewest observations away from rest for a verdict: twice those of a fit, as two residuals are compared.
pub(crate) const LEAST_OBSERVATIONS: f32 = 16.0;
/// Least fraction of the error that counts as resembling a regressor, and its growth with the error's share in
/// friction.
const ALIKE: (f32, f32) = (0.35, 1.3);
/// Twice the shift of Coulomb friction, as a fraction of the error, from which on it is Stribeck friction: that shows
/// 0.15 to 1.6, presliding 0.06.
const STRIBECK: f32 = 0.1;
const MOVED: f32 = constants::MOVED as f32;
/// Error of Coulomb friction per residual beyond which friction outside the law could hide in the other parameters: 28
/// at 15.9 Hz, where only the beginning of a steady tone distinguishes Coulomb from viscous friction, and over 6 from
/// 1.2 s on; under 5 for the other motions of the grid.
const HIDDEN: f32 = 6.0;
/// Spring of a creeping screw mistaken for inertance, per share in friction and `fc` over the rms of the acceleration.
const SPRING: f32 = 0.6;
/// How far a parameter may be off where the law is broken, per error that all of the unexplained residual would cause
/// if it resembled its regressor: the other parameters absorb part of what breaks the law. Load-dependent friction
/// reaches 3.1.
const REACH: f32 = 3.1;
/// Fraction of the force's mean square that impacts do not leave, as they act on the screw as well: they leave less
/// than 3 % of its rms even at a gap of 3 mm.
const BEYOND_IMPACTS: f32 = 0.1 * 0.1;
/// Fraction of the impacts' error that counts as resembling a regressor: in a motion that repeats itself every 2 s,
/// viscous friction scatters by 0.17 of all, at 1 and at 4 kHz; in a random one by 0.06, which the interval covers
/// anyway.
const IMPACTS: f32 = 0.4;

/// The part of a residual that the force's noise, the encoder's steps and the settings' intervals explain.
pub(crate) struct Explained {
    /// Variance [N^2]; infinite before they are known.
    pub variance: f32,
    /// Variance of the residual's own variance, over that in a motion that never recurs: the steps recur with the
    /// motion.
    pub scatter: f32,
}

/// The regime of friction, and the systematic error that it causes in inertance, viscous and Coulomb friction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Assessment {
    pub regime: Regime,
    pub errors: [f32; 3],
    /// Whether enough was seen to judge friction.
    pub judged: bool,
}

impl Assessment {
    /// From the fits to all updates and to those away from rest, the mean squares of acceleration \[m^2/s^4\] and
    /// velocity \[m^2/s^2\], viscous friction as it would be published, what noise and steps explain of the residual,
    /// and how the flanks behave. `scatter` is the variance of the parameters' shifts over that for white noise.
    pub fn of(
        all: &Fit,
        away: &Fit,
        squares: [f32; 2],
        viscous: Interval,
        explained: &Explained,
        contact: Contact,
        scatter: f32,
    ) -> Self {
        let ratio = all.variance / explained.variance;
        let beyond = ratio - CHANCE * sqrt(2.0 * explained.scatter / all.freedom());
        let parts = matches!(contact, Contact::Backlash | Contact::Bouncing);
        let beside = (beyond > UNEXPLAINED && !parts).then_some(ratio);
        let mut assessment = Self::of_friction(all, away, squares, viscous, beside, scatter);
        // Where flanks are known to part, whatever is unexplained may be their impacts.
        if parts && ratio > 1.0 || contact.may_part() && beyond > UNEXPLAINED_IMPACTS {
            let per_error = IMPACTS * error_per_standard_error(all, ratio);
            for (error, standard) in assessment.errors.iter_mut().zip(all.errors) {
                *error = length(*error, per_error * standard);
            }
        }
        assessment
    }

    /// What friction does. `unexplained` is the residual's variance over what is explained, where there is no other
    /// cause.
    fn of_friction(
        all: &Fit,
        away: &Fit,
        [acceleration, velocity]: [f32; 2],
        viscous: Interval,
        unexplained: Option<f32>,
        scatter: f32,
    ) -> Self {
        let ([mt, cf, fc, _], [mt_away, cf_away, fc_away, _]) = (all.values, away.values);
        let ([mt_error, cf_error, fc_error, _], [_, _, fc_away_error, _]) = (all.errors, away.errors);
        let enough = away.observations >= LEAST_OBSERVATIONS && away.variance > 0.0;
        if !enough || !fc_error.is_finite() || !fc_away_error.is_finite() {
            return Self::default();
        }
        let (mt_moved, cf_moved, fc_moved) = (2.0 * (mt - mt_away), 2.0 * (cf - cf_away), 2.0 * (fc - fc_away));
        if fc > 0.0 && viscous.value + viscous.u95 < 0.0 {
            // Friction that falls with the velocity may also be mistaken for inertance.
            let inertance = length(mt_moved, viscous.value * sqrt(velocity / acceleration));
            return Self { regime: Regime::Stribeck, errors: [inertance, f32::INFINITY, f32::INFINITY], judged: true };
        }
        let near_rest = all.variance / away.variance;
        let chance = 2.0 / away.freedom() - 2.0 / all.freedom();
        let lawful = near_rest <= RATIO + CHANCE * sqrt(if chance > 0.0 { chance } else { 0.0 });
        let hidden = fc_error * fc_error * all.observations > HIDDEN * HIDDEN * all.variance;
        let unlawful = if lawful { unexplained.filter(|_| hidden) } else { Some(near_rest) };
        let Some(ratio) = unlawful else {
            return Self {
                regime: if hidden { Regime::Unknown } else { Regime::Coulomb },
                errors: if hidden { [0.0; 3] } else { beyond_chance(all, away, scatter) },
                judged: true,
            };
        };
        let per_error = error_per_standard_error(all, ratio);
        let (fc, fc_alike) = (magnitude(fc), fc_error * per_error);
        let (share, friction_n) = if fc_alike < fc { (fc_alike / fc, fc) } else { (1.0, fc_alike) };
        let alike = if ALIKE.0 > ALIKE.1 * share { ALIKE.0 } else { ALIKE.1 * share };
        // Friction that falls with the velocity looks like more Coulomb friction. Friction that reverses late does not,
        // and its spring lowers the inertance.
        let falls = fc_moved > STRIBECK * fc_alike && mt_moved > -2.0 * STRIBECK * mt_error * per_error;
        let spring = SPRING * share * friction_n / sqrt(acceleration);
        let (regime, spring) = match () {
            // Something is wrong, but what it is cannot be identified.
            () if lawful => (Regime::Unknown, spring),
            () if falls => (Regime::Stribeck, 0.0),
            () => (Regime::Presliding, spring),
        };
        let viscous = length(cf_moved, alike * cf_error * per_error);
        let errors = [length(mt_moved, spring), viscous, length(fc_moved, alike * fc_alike)];
        Self { regime, errors, judged: true }
    }

    /// The budgets with these errors added.
    pub fn widen(&self, mut budgets: [Budget; UNKNOWNS]) -> [Budget; UNKNOWNS] {
        for (budget, error) in budgets.iter_mut().zip(self.errors) {
            *budget = budget.and(Source::Model, error);
        }
        budgets
    }
}

/// Whether the law holds, judged by what noise and steps explain of the residual, the number of differences from which
/// the noise was found, how the flanks behave, and the mean square of the filtered force with its offset \[N^2\], which
/// is evaluated where they may part.
pub(crate) fn law(
    fit: &Fit,
    explained: &Explained,
    differences: u32,
    contact: Contact,
    force_square: impl FnOnce() -> f32,
) -> Law {
    let Explained { variance, scatter } = *explained;
    if !(fit.freedom() > 0.0 && variance.is_finite() && variance > 0.0) {
        return Law::default();
    }
    let chance = sqrt(2.0 * scatter / fit.freedom() + QUARTILE_CHANCE / differences as f32);
    let (ratio, limit) = (fit.variance / variance, UNEXPLAINED + CHANCE * chance);
    let is_known = fit.observations >= LEAST_OBSERVATIONS;
    let may_be_impacts = contact.may_part() || !is_known;
    let status = match () {
        () if ratio <= limit => LawStatus::Holds,
        () if !may_be_impacts || fit.variance > BEYOND_IMPACTS * force_square() => LawStatus::Broken,
        () => LawStatus::Unknown,
    };
    if !is_known && status != LawStatus::Broken {
        return Law::default();
    }
    Law { status, misfit: Some(Misfit { ratio: sqrt(ratio), limit: sqrt(limit) }), ..Law::default() }
}

/// What the parameters move by between both fits beyond chance, where the law is true: the fit to a part of the data
/// scatters around the fit to all by the difference of their variances (Hausman).
fn beyond_chance(all: &Fit, away: &Fit, scatter: f32) -> [f32; 3] {
    core::array::from_fn(|i| {
        let moved = all.values[i] - away.values[i];
        let chance = away.errors[i] * away.errors[i] - all.errors[i] * all.errors[i];
        MOVED * sqrt(moved * moved - scatter * chance)
    })
}

/// How far what breaks the law may have moved each parameter \[standard errors\]; 0 if it is not broken.
pub(crate) fn reach(law: &Law, fit: &Fit) -> f32 {
    match law.misfit {
        Some(Misfit { ratio, .. }) if law.status == LawStatus::Broken => {
            REACH * error_per_standard_error(fit, ratio * ratio)
        }
        _ => 0.0,
    }
}

/// Error of a parameter if all of the unexplained part of the residual resembles its regressor, per standard error;
/// `ratio` is the residual's variance over that of its lawful part.
fn error_per_standard_error(fit: &Fit, ratio: f32) -> f32 {
    sqrt(fit.observations * (1.0 - 1.0 / ratio))
}

fn length(a: f32, b: f32) -> f32 {
    sqrt(a * a + b * b)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fit of the reference device's random motion, with the parameters moved by so much and with this residual \[N\].
    fn fit(moved: [f32; 3], residual: f32, observations: f32) -> Fit {
        let values = [299.5 + moved[0], 31.4 + moved[1], 50.0 + moved[2], 3.0];
        let error = residual / sqrt(observations);
        Fit {
            values,
            errors: [0.17 * error, 28.0 * error, 2.6 * error, error],
            variance: residual * residual,
            observations,
            ..Fit::NONE
        }
    }

    fn assessed(all: Fit, away: Fit) -> Assessment {
        assessed_beside(all, away, f32::INFINITY, Contact::Closed)
    }

    /// With this much of the residual's variance explained \[N^2\].
    fn assessed_beside(all: Fit, away: Fit, explained: f32, contact: Contact) -> Assessment {
        let viscous = Interval { value: all.values[1], u95: 3.0 * all.errors[1] };
        let explained = Explained { variance: explained, scatter: 1.0 };
        Assessment::of(&all, &away, [25.0, 4e-4], viscous, &explained, contact, 1.0)
    }

    #[test]
    fn friction_is_called_by_its_residual_and_by_what_moves() {
        let away = |residual| fit([0.0; 3], residual, 370.0);
        let coulomb = assessed(fit([0.0, 0.1, -0.02], 0.39, 600.0), away(0.38));
        assert_eq!(coulomb, Assessment { regime: Regime::Coulomb, errors: [0.0; 3], judged: true });
        let presliding = assessed(fit([-0.3, 7.8, -0.9], 6.46, 600.0), away(3.07));
        assert_eq!(presliding.regime, Regime::Presliding);
        let stribeck = assessed(fit([0.003, -5.9, 0.6], 0.66, 600.0), away(0.39));
        assert_eq!(stribeck.regime, Regime::Stribeck);
        assert!(stribeck.errors[0] < 0.01 && stribeck.errors[1] > 11.8 && stribeck.errors[2] > 1.2);
        // A spring that lowers the inertance, by more than all of the unexplained residual may, is no falling friction.
        let alike = 0.17 * 0.66 * sqrt(1.0 - (0.39 / 0.66) * (0.39 / 0.66));
        for (lowered, regime) in [(0.9, Regime::Stribeck), (1.1, Regime::Presliding)] {
            let moved = [-lowered * STRIBECK * alike, -5.9, 0.6];
            assert_eq!(assessed(fit(moved, 0.66, 600.0), away(0.39)).regime, regime, "{lowered}");
        }
        let falling = assessed(fit([0.0, -100.0, 5.0], 0.4, 600.0), away(0.4));
        assert_eq!((falling.regime, falling.errors[2]), (Regime::Stribeck, f32::INFINITY));
        // The same ratio by chance, from few observations.
        assert_eq!(assessed(fit([0.0; 3], 0.5, 32.0), fit([0.0; 3], 0.38, 22.0)).regime, Regime::Coulomb);
        let early = assessed(fit([0.0; 3], 5.0, 50.0), fit([0.0; 3], 0.4, 15.0));
        assert_eq!(early, Assessment::default());
        let mut tone = fit([0.0; 3], 0.39, 600.0);
        tone.errors[2] *= 10.0;
        assert_eq!(assessed(tone, away(0.38)).regime, Regime::Unknown);
    }

    #[test]
    fn what_noise_and_steps_do_not_explain_widens_where_it_may_harm() {
        let explained = 0.38 * 0.38;
        let away = |residual| fit([0.0; 3], residual, 460.0);
        let tone = |residual| {
            let mut tone = fit([0.0; 3], residual, 600.0);
            tone.errors[1] *= 8.0;
            tone.errors[2] *= 11.0;
            tone
        };
        let unknown = Assessment { judged: true, ..Assessment::default() };
        assert_eq!(assessed_beside(tone(0.45), away(0.45), explained, Contact::Closed), unknown);
        // Presliding over 50 um at 15.9 Hz lowers the inertance by 0.68 kg, raises viscous friction by 25 N s/m and
        // lowers Coulomb friction by 5 N.
        let hidden = assessed_beside(tone(0.76), away(0.76), explained, Contact::Closed);
        assert_eq!(hidden.regime, Regime::Unknown);
        let [inertance, viscous, coulomb] = hidden.errors;
        assert!((0.68..3.0).contains(&inertance) && viscous > 25.0 && (5.0..20.0).contains(&coulomb), "{hidden:?}");
        // The same with parting flanks: there is no spring.
        let parts = assessed_beside(tone(0.76), away(0.76), explained, Contact::Backlash);
        assert!(parts.errors[0] < 0.1 && parts.errors[1] > 20.0, "{parts:?}");
        // If nothing is known of the flanks, it may be both.
        let both = assessed_beside(tone(0.76), away(0.76), explained, Contact::Unknown);
        for ((both, hidden), parts) in both.errors.into_iter().zip(hidden.errors).zip(parts.errors) {
            assert_eq!(both, length(hidden, parts));
        }
        // Where friction cannot hide, only flanks count: by 0.17, 28 and 2.6 per newton, times the part that resembles
        // the regressor.
        let lawful = Assessment { regime: Regime::Coulomb, judged: true, ..Assessment::default() };
        let random = |contact| assessed_beside(fit([0.0; 3], 1.7, 600.0), away(1.7), explained, contact);
        assert_eq!(random(Contact::Closed), lawful);
        for (error, per_newton) in random(Contact::Backlash).errors.into_iter().zip([0.17, 28.0, 2.6]) {
            assert!((error / (1.657 * IMPACTS * per_newton) - 1.0).abs() < 0.01, "{error}");
        }
    }

    #[test]
    fn budgets_only_grow() {
        let before = [0.15, 2.0, 1.2, 0.05].map(|error| Budget::of_scatter(error, 600.0));
        assert_eq!(Assessment::default().widen(before), before);
        let assessment = Assessment { regime: Regime::Stribeck, errors: [0.4, 20.0, f32::INFINITY], judged: true };
        let wide = assessment.widen(before).map(|budget| budget.u95());
        for (wide, (before, error)) in wide.into_iter().zip(before.into_iter().zip([0.4, 20.0])) {
            assert!((wide / length(before.u95(), error) - 1.0).abs() < 2e-3, "{wide}");
        }
        assert_eq!((wide[2], wide[3]), (f32::INFINITY, before[3].u95()));
    }

    #[test]
    fn what_no_impact_leaves_breaks_the_law_whatever_the_flanks_do() {
        let status = |residual: f32, observations: f32, contact: Contact| {
            let explained = Explained { variance: 1.0, scatter: 1.0 };
            law(&fit([0.0; 3], residual, observations), &explained, 10_000, contact, || 1e4)
        };
        for contact in [Contact::Unknown, Contact::Backlash, Contact::Bouncing] {
            let of = |residual| status(residual, 600.0, contact).status;
            assert_eq!([1.0, 9.0, 11.0].map(of), [LawStatus::Holds, LawStatus::Unknown, LawStatus::Broken]);
        }
        assert_eq!(
            [1.0, 9.0].map(|residual| status(residual, 600.0, Contact::Closed).status),
            [LawStatus::Holds, LawStatus::Broken]
        );
        // With few observations, the only verdict is that the law is broken, by a residual that no impact leaves.
        for contact in [Contact::Unknown, Contact::Closed] {
            assert_eq!([1.0, 9.0].map(|residual| status(residual, 10.0, contact)), [Law::default(); 2]);
            assert_eq!(status(11.0, 10.0, contact).status, LawStatus::Broken);
        }
        let explained = Explained { variance: f32::INFINITY, scatter: 1.0 };
        assert_eq!(law(&fit([0.0; 3], 11.0, 600.0), &explained, 0, Contact::Closed, || 1e4), Law::default());
        assert_eq!(
            law(&Fit::UNKNOWN, &Explained { variance: 1.0, scatter: 1.0 }, 10_000, Contact::Closed, || 1e4),
            Law::default()
        );
    }

    /// A shift of friction between both fits that is within their scatter does not count; a greater one does.
    #[test]
    fn what_moves_beyond_chance_counts() {
        let away = fit([0.0; 3], 0.39, 400.0);
        // The standard deviation of the shift, if the law were true.
        let all = fit([0.0; 3], 0.39, 600.0);
        let usual = sqrt(away.errors[2] * away.errors[2] - all.errors[2] * all.errors[2]);
        let errors = |moved: f32| assessed(fit([0.0, 0.0, moved], 0.39, 600.0), away).errors;
        assert_eq!(errors(0.9 * usual), [0.0; 3]);
        assert!((errors(3.0 * usual)[2] / (MOVED * sqrt(8.0) * usual) - 1.0).abs() < 0.01);
    }

    /// The three errors, and half a percent for what single precision and rounded constants lose.
    #[track_caller]
    fn are_near(found: [f32; 3], wanted: [f64; 3]) {
        for (found, wanted) in found.into_iter().zip(wanted) {
            assert!((f64::from(found) - wanted).abs() <= 0.005 * wanted, "{found} for {wanted}");
        }
    }

    /// By hand: all of the unexplained residual would move the parameters by 0.17, 28 and 2.6 per newton. Twice what
    /// they move by and the part that resembles a regressor add by squares; the spring of a creeping screw moves the
    /// inertance.
    #[test]
    fn errors_are_what_moves_and_what_resembles_a_regressor() {
        let beyond = |all: f64, away: f64| (all * all - away * away).sqrt();
        let stribeck = assessed(fit([0.25, -5.9, 0.6], 0.66, 600.0), fit([0.0; 3], 0.39, 370.0));
        let per_newton = beyond(0.66, 0.39);
        are_near(
            stribeck.errors,
            [0.5, 11.8_f64.hypot(0.35 * 28.0 * per_newton), 1.2_f64.hypot(0.35 * 2.6 * per_newton)],
        );
        // Friction of 49.1 N, and an acceleration of 5 m/s^2.
        let presliding = assessed(fit([-0.3, 7.8, -0.9], 6.46, 600.0), fit([0.0; 3], 3.07, 370.0));
        let per_newton = beyond(6.46, 3.07);
        let coulomb = 2.6 * per_newton;
        let alike = 1.3 * coulomb / 49.1;
        assert!(alike > 0.35);
        are_near(
            presliding.errors,
            [
                0.6_f64.hypot(0.6 * coulomb / 5.0),
                15.6_f64.hypot(alike * 28.0 * per_newton),
                1.8_f64.hypot(alike * coulomb),
            ],
        );
        // Where the error may be all of friction, and more: 75 of 50 N.
        let all = assessed(fit([0.0; 3], 35.0, 600.0), fit([0.0; 3], 20.0, 370.0));
        let per_newton = beyond(35.0, 20.0);
        assert_eq!(all.regime, Regime::Presliding);
        are_near(all.errors, [0.6 * 2.6 * per_newton / 5.0, 1.3 * 28.0 * per_newton, 1.3 * 2.6 * per_newton]);
        // Viscous friction of -68.6 N s/m, at 0.02 m/s over 5 m/s^2.
        let falling = assessed(fit([0.0, -100.0, 5.0], 0.4, 600.0), fit([0.0, -100.0, 5.0], 0.4, 600.0));
        assert_eq!((falling.regime, falling.errors[1]), (Regime::Stribeck, f32::INFINITY));
        assert!((falling.errors[0] / (68.6 * 0.02 / 5.0) - 1.0).abs() < 0.005, "{}", falling.errors[0]);
        // The same within its interval, or where Coulomb friction is negative, is no falling friction.
        for moved in [[0.0, -32.0, 0.0], [0.0, -100.0, -60.0]] {
            let calm = assessed(fit(moved, 0.4, 600.0), fit(moved, 0.4, 600.0));
            assert_eq!((calm.regime, calm.errors), (Regime::Coulomb, [0.0; 3]), "{moved:?}");
        }
    }

    #[test]
    fn verdicts_on_friction_change_at_their_limits() {
        // By chance, the variances of 28 and 18 degrees of freedom differ by three times
        // sqrt(2 / 18 - 2 / 28) = 0.199: up to 1.5 + 0.598 is lawful.
        let chance = |ratio: f32| assessed(fit([0.0; 3], 0.38 * sqrt(ratio), 32.0), fit([0.0; 3], 0.38, 22.0)).regime;
        assert_eq!([2.05, 2.15].map(chance), [Regime::Coulomb, Regime::Presliding]);
        // Where Coulomb friction moves by more than a tenth of what all of the unexplained residual may, it falls.
        let alike = 2.6 * sqrt(0.66 * 0.66 - 0.39 * 0.39);
        for (part, regime) in [(0.9, Regime::Presliding), (1.1, Regime::Stribeck)] {
            let moved = [0.0, 0.0, 0.5 * part * 0.1 * alike];
            assert_eq!(assessed(fit(moved, 0.66, 600.0), fit([0.0; 3], 0.39, 370.0)).regime, regime, "{part}");
        }
        // Friction could hide where its error per residual is above 6.
        for (error, regime) in [(5.9, Regime::Coulomb), (6.1, Regime::Unknown)] {
            let mut all = fit([0.0; 3], 0.39, 600.0);
            all.errors[2] = error * 0.39 / sqrt(600.0);
            assert_eq!(assessed(all, fit([0.0; 3], 0.39, 370.0)).regime, regime, "{error}");
        }
        // 16 observations away from rest suffice, if they leave a residual and the fits know friction.
        let all = fit([0.0; 3], 0.39, 600.0);
        let away = |observations: f32, residual: f32| fit([0.0; 3], residual, observations);
        assert!(assessed(all, away(16.0, 0.39)).judged);
        assert_eq!(assessed(all, away(15.9, 0.39)), Assessment::default());
        assert_eq!(assessed(all, away(370.0, 0.0)), Assessment::default());
        let endless = |mut fit: Fit| {
            fit.errors[2] = f32::INFINITY;
            fit
        };
        assert_eq!(assessed(endless(all), away(370.0, 0.39)), Assessment::default());
        assert_eq!(assessed(all, endless(away(370.0, 0.39))), Assessment::default());
    }

    /// Of 54 observations 50 are free: the residual's variance scatters by `sqrt(2 scatter / 50)`, and three times that
    /// is chance.
    #[test]
    fn what_is_unexplained_counts_from_its_limit_on() {
        let errors = |ratio: f32, scatter: f32, contact: Contact| {
            let mut tone = fit([0.0; 3], 2.0, 54.0);
            tone.errors[2] *= 11.0;
            let explained = Explained { variance: 4.0 / ratio, scatter };
            let viscous = Interval { value: 31.4, u95: 1.0 };
            let away = fit([0.0; 3], 2.0, 40.0);
            Assessment::of(&tone, &away, [25.0, 4e-4], viscous, &explained, contact, 1.0).errors
        };
        for (below, above, scatter, contact) in [
            // 1.7 + 0.6 and 1.7 + 1.2 where flanks are closed.
            (2.25, 2.35, 1.0, Contact::Closed),
            (2.85, 2.95, 4.0, Contact::Closed),
            // 1.4 + 0.6 and 1.4 + 1.2 where they may part.
            (1.95, 2.05, 1.0, Contact::Unknown),
            (2.55, 2.65, 4.0, Contact::Unknown),
            // 1 where they do.
            (0.98, 1.02, 1.0, Contact::Backlash),
            (0.98, 1.02, 1.0, Contact::Bouncing),
        ] {
            assert_eq!(errors(below, scatter, contact), [0.0; 3], "{below}, {contact:?}");
            assert!(errors(above, scatter, contact).into_iter().all(|error| error > 0.0), "{above}, {contact:?}");
        }
    }

    /// The square of the limit is 1.7, and three times the chance of residual and noise.
    #[test]
    fn the_law_is_judged_by_the_chance_of_residual_and_noise() {
        let judged = |residual: f32, observations: f32, explained: f32, scatter: f32, differences: u32| {
            let explained = Explained { variance: explained, scatter };
            law(&fit([0.0; 3], residual, observations), &explained, differences, Contact::Closed, || 1e4)
        };
        for (scatter, differences) in [(1.0_f32, 10_000_u32), (4.0, 100)] {
            let chance = 2.0 * f64::from(scatter) / 596.0 + 12.8 / f64::from(differences);
            let limit = (1.7 + 3.0 * chance.sqrt()).sqrt();
            for (part, status) in [(0.99, LawStatus::Holds), (1.01, LawStatus::Broken)] {
                // Half a newton is explained.
                let law = judged((part * 0.5 * limit) as f32, 600.0, 0.25, scatter, differences);
                let misfit = law.misfit.unwrap();
                assert_eq!(law.status, status, "{part} of {limit}");
                assert!((f64::from(misfit.ratio) / (part * limit) - 1.0).abs() < 1e-4, "{misfit:?}");
                assert!((f64::from(misfit.limit) / limit - 1.0).abs() < 1e-4, "{misfit:?} for {limit}");
            }
        }
        assert_eq!(judged(1.0, 16.0, 1.0, 1.0, 10_000).status, LawStatus::Holds);
        assert_eq!(judged(1.0, 15.9, 1.0, 1.0, 10_000), Law::default());
        // Nothing is explained: there is nothing to judge by.
        assert_eq!(judged(1.0, 600.0, 0.0, 1.0, 10_000), Law::default());
    }

    /// Three times the lawful residual: eight ninths of the variance are unexplained.
    #[test]
    fn what_breaks_the_law_reaches_as_far_as_its_part_of_the_residual() {
        let misfit = Some(Misfit { ratio: 3.0, limit: 1.4 });
        let of = |status| reach(&Law { status, misfit, ..Law::default() }, &fit([0.0; 3], 1.0, 450.0));
        assert!((of(LawStatus::Broken) / (3.1 * 20.0) - 1.0).abs() < 1e-5);
        assert_eq!([of(LawStatus::Holds), of(LawStatus::Unknown)], [0.0; 2]);
        let unjudged = Law { status: LawStatus::Broken, misfit: None, ..Law::default() };
        assert_eq!(reach(&unjudged, &fit([0.0; 3], 1.0, 450.0)), 0.0);
    }

    /// Where what the fits share recurs, the shifts scatter by as much more.
    #[test]
    fn what_recurs_widens_the_chance_of_a_shift() {
        let (away, all) = (fit([0.0; 3], 0.39, 400.0), fit([0.0; 3], 0.39, 600.0));
        let usual = sqrt(away.errors[2] * away.errors[2] - all.errors[2] * all.errors[2]);
        let explained = Explained { variance: f32::INFINITY, scatter: 1.0 };
        let viscous = Interval { value: 31.4, u95: 1.0 };
        let error = |moved: f32| {
            let all = fit([0.0, 0.0, moved * usual], 0.39, 600.0);
            Assessment::of(&all, &away, [25.0, 4e-4], viscous, &explained, Contact::Closed, 4.0).errors[2]
        };
        assert_eq!(error(1.9), 0.0);
        assert!((error(3.0) / (MOVED * sqrt(9.0 - 4.0) * usual) - 1.0).abs() < 0.01);
    }
}
