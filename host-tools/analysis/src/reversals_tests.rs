use super::*;

const LAW: Law = Law { inertance_kg: 300.0, viscous_n_s_per_m: 30.0, coulomb_n: 50.0, offset_n: 3.0 };
const PERIOD_S: f64 = 1e-3;
const COUNT_M: f64 = 2.44e-6;

/// A screw that reverses at this time \[samples\] out of 200, first into the positive direction, with a force that
/// changes at this rate, and positions in whole counts.
fn stretch(at: f64, force_n: f64, rate_n_per_s: f64, phase: f64) -> Stretch {
    let samples = (0..200).map(|n| {
        let t = (f64::from(n) - at) * PERIOD_S;
        // Exact except for the viscous friction, which is small around a reversal.
        let net_n = |t: f64, friction_n: f64| (force_n - friction_n) * t * t / 2.0 + rate_n_per_s * t.powi(3) / 6.0;
        let x = net_n(t, LAW.coulomb_n * t.signum()) / LAW.inertance_kg;
        ((x / COUNT_M + phase).floor() * COUNT_M, force_n + rate_n_per_s * t + LAW.offset_n)
    });
    let (position_m, force_n) = samples.unzip();
    Stretch { position_m, force_n, ..Stretch::default() }
}

fn law() -> Law {
    Law { viscous_n_s_per_m: 0.0, ..LAW }
}

/// Compared with the short kernel alone, which is wrong by up to 100 us and more.
#[test]
fn a_reversal_is_located_between_the_samples() {
    let mut squares = 0.0;
    let mut mean = 0.0;
    let count = 100;
    for n in 0..count {
        let at = 100.0 + f64::from(n) * 0.618 % 1.0;
        let turns = Turns::of(&stretch(at, 600.0, 20_000.0, f64::from(n) * 0.414 % 1.0), PERIOD_S, &law());
        let near: Vec<&Reversal> = turns.reversals.iter().filter(|one| (one.at - at).abs() < 5.0).collect();
        let [found] = near.as_slice() else { panic!("{near:?}") };
        assert!(found.is_located && found.sign == 1.0);
        let off_s = (found.at - at) * PERIOD_S;
        squares += off_s * off_s / f64::from(count);
        mean += off_s / f64::from(count);
        // Signs are means over each sample, so their sum gives the same time.
        let sum: f64 = turns.signs[90..=110].iter().sum();
        assert!((sum - 2.0 * (100.0 - found.at)).abs() < 1e-9);
    }
    assert!(squares.sqrt() < 15e-6 && mean.abs() < 5e-6, "{:e} {mean:e}", squares.sqrt());
}

#[test]
fn what_moves_near_a_reversal_is_told_finer_than_by_samples() {
    let at = 100.3;
    let turns = Turns::of(&stretch(at, 600.0, 0.0, 0.5), PERIOD_S, &law());
    let (_, within) = turns.near.iter().find(|(n, _)| *n == 100).unwrap();
    assert!((within.iter().map(|(weight, _)| weight).sum::<f64>() - 1.0).abs() < 1e-12);
    for (_, moment) in within {
        let t = (moment.at - at) * PERIOD_S;
        let acceleration = (600.0 - LAW.coulomb_n * t.signum()) / LAW.inertance_kg;
        assert_eq!(moment.sign, t.signum());
        assert!((moment.velocity - acceleration * t).abs() < 1e-4, "{moment:?}");
        if t > 0.0 {
            assert!((moment.gone_m - acceleration * t * t / 2.0).abs() < 1e-6, "{moment:?}");
        }
    }
    // The parts of a sample before and after the reversal have their true weights.
    let sign: f64 = turns.means(|moment| moment.sign)[100];
    assert!((sign - turns.signs[100]).abs() < 1e-9);
}

#[test]
fn what_is_no_free_reversal_is_not_located() {
    // The force acts against the reversal.
    let mut against = stretch(100.0, 600.0, 0.0, 0.5);
    against.force_n.iter_mut().for_each(|force| *force = -*force);
    // Two reversals that are close together.
    let mut twice = stretch(100.0, 600.0, 0.0, 0.5);
    let turned: Vec<f64> = (0..200).map(|n| -((n as f64 - 100.0).powi(2) - 64.0) * (n as f64 - 100.0) * 2e-8).collect();
    twice.position_m = turned;
    // A law without inertance.
    let nothing = Law::default();
    for (stretch, law) in [(&against, law()), (&twice, law()), (&stretch(100.0, 600.0, 0.0, 0.5), nothing)] {
        let turns = Turns::of(stretch, PERIOD_S, &law);
        assert!(
            !turns.reversals.is_empty() && turns.reversals.iter().all(|one| !one.is_located),
            "{:?}",
            turns.reversals
        );
    }
}

#[test]
fn too_few_samples_are_no_motion() {
    for samples in 0..5 {
        let stretch = Stretch { position_m: vec![0.0; samples], force_n: vec![1.0; samples], ..Stretch::default() };
        let turns = Turns::of(&stretch, PERIOD_S, &law());
        assert_eq!((turns.signs.len(), turns.moments.len(), turns.reversals.len()), (samples, samples, 0));
    }
}
