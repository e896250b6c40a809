use super::*;

#[test]
fn all_kernels_are_odd_and_reproduce_polynomials() {
    for (bank, period_s) in [(Bank::Fast, 1e-3), (Bank::Slow, 1e-3), (Bank::Fast, 0.25e-3), (Bank::Fast, 0.01)] {
        let kernels = Kernels::new(bank, period_s);
        let middle = kernels.reach() + 3;
        let t = |at: usize| (at as f64 - middle as f64) * period_s;
        let cubic: Vec<f64> =
            (0..2 * middle + 1).map(|at| 7.0 + 5.0 * t(at) + 1.5 * t(at).powi(2) + 2.0 * t(at).powi(3)).collect();
        let of = |taps: &[f64]| {
            assert_eq!(taps.len() % 2, 1);
            around(taps, &cubic, middle)
        };
        assert!((of(&kernels.second) - 3.0).abs() < 1e-6);
        assert!((of(&kernels.third) - 12.0).abs() < 1e-3);
        assert!((of(&kernels.force) - 7.0).abs() < 0.05 && (of(&kernels.rate) - 5.0).abs() < 0.1);
    }
}
