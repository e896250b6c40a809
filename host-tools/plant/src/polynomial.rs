//! Polynomials on the unit interval, and the first point where one crosses zero from above.
//!
//! Coefficients are in ascending order: `p[0] + p[1] u + ...` with `u` in 0 to 1.

/// Coefficients of the solution on one segment: degree 10.
pub(crate) const LENGTH: usize = 11;

/// Bisections before two roots count as one: the remaining interval is then below the spacing of `f64`.
const DEPTH: u32 = 52;

pub(crate) type Polynomial = [f64; LENGTH];

/// Value at `u`.
#[inline]
pub(crate) fn value(p: &[f64], u: f64) -> f64 {
    p.iter().rev().fold(0.0, |sum, &c| sum * u + c)
}

/// Derivative with respect to `u`, at `u`.
#[inline]
pub(crate) fn slope(p: &[f64], u: f64) -> f64 {
    p.iter().enumerate().skip(1).rev().fold(0.0, |sum, (k, &c)| sum * u + k as f64 * c)
}

/// Second derivative with respect to `u`, at `u`.
#[inline]
pub(crate) fn curvature(p: &[f64], u: f64) -> f64 {
    p.iter().enumerate().skip(2).rev().fold(0.0, |sum, (k, &c)| sum * u + (k * (k - 1)) as f64 * c)
}

/// The same curve with its origin moved to `origin` and `scale` as the new unit.
pub(crate) fn rebase<const N: usize>(p: &[f64; N], origin: f64, scale: f64) -> [f64; N] {
    let mut q = *p;
    for first in 0..N {
        for k in (first..N - 1).rev() {
            q[k] += origin * q[k + 1];
        }
    }
    let mut power = 1.0;
    for c in &mut q {
        *c *= power;
        power *= scale;
    }
    q
}

/// First `u` in 0 to 1 where the curve crosses from positive to negative; 0 if it does so at the start.
///
/// The caller guarantees that the curve starts positive or at zero: a start at or below zero is the previous event's
/// location with its rounding error, and counts as zero. Then the first nonzero derivative decides.
pub(crate) fn first_fall(p: &Polynomial) -> Option<f64> {
    let mut p = *p;
    if p[0] <= 0.0 {
        let lead = p.iter().skip(1).position(|&c| c != 0.0)? + 1;
        if p[lead] < 0.0 {
            return Some(0.0);
        }
        p.copy_within(lead.., 0);
        p[LENGTH - lead..].fill(0.0);
    }
    first_root(&p, DEPTH)
}

fn first_root(p: &Polynomial, depth: u32) -> Option<f64> {
    // On 0 to 1 a curve lies above its start plus its negative coefficients.
    if p[0] + p[1..].iter().map(|c| c.min(0.0)).sum::<f64>() > 0.0 {
        return None;
    }
    let end: f64 = p.iter().sum();
    let steepest: f64 = p[1] + (2..LENGTH).map(|k| (k as f64 * p[k]).max(0.0)).sum::<f64>();
    if steepest < 0.0 {
        return (end <= 0.0).then(|| falling_root(p));
    }
    if depth == 0 {
        return (end <= 0.0).then_some(1.0);
    }
    let left = rebase(p, 0.0, 0.5);
    if let Some(u) = first_root(&left, depth - 1) {
        return Some(0.5 * u);
    }
    let right = rebase(&left, 1.0, 1.0);
    if right[0] <= 0.0 {
        return Some(0.5);
    }
    first_root(&right, depth - 1).map(|u| 0.5 + 0.5 * u)
}

/// The root of a curve that decreases throughout, from positive to not positive: Newton's method kept inside a bracket.
fn falling_root(p: &Polynomial) -> f64 {
    let (mut low, mut high, mut u) = (0.0, 1.0, 0.5);
    for _ in 0..100 {
        let y = value(p, u);
        if y > 0.0 {
            low = u;
        } else {
            high = u;
        }
        let newton = u - y / slope(p, u);
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - u).abs() <= f64::EPSILON * u || next <= low || next >= high {
            return next;
        }
        u = next;
    }
    u
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn from_roots(roots: &[f64], factor: f64) -> Polynomial {
        let mut p = [0.0; LENGTH];
        p[0] = factor;
        for &root in roots {
            for k in (1..LENGTH).rev() {
                p[k] = p[k - 1] - root * p[k];
            }
            p[0] *= -root;
        }
        p
    }

    #[test]
    fn two_roots_close_together_are_not_missed() {
        let p = from_roots(&[0.4, 0.4 + 1e-6], 1.0);
        assert!((first_fall(&p).unwrap() - 0.4).abs() < 1e-8);
    }

    #[test]
    fn touching_from_above_is_no_fall() {
        let p = from_roots(&[0.5, 0.5], 1.0);
        let mut shifted = p;
        shifted[0] += 1e-12;
        assert_eq!(first_fall(&shifted), None);
    }

    #[test]
    fn a_start_on_zero_is_left_by_its_first_derivative() {
        let mut p = [0.0; LENGTH];
        p[2] = 1.0;
        p[3] = -2.0;
        assert!((first_fall(&p).unwrap() - 0.5).abs() < 1e-15);
        p[2] = -1.0;
        assert_eq!(first_fall(&p), Some(0.0));
        assert_eq!(first_fall(&[0.0; LENGTH]), None);
    }

    proptest! {
        #[test]
        fn first_root_is_the_least(mut roots in prop::collection::vec(-1.0f64..2.0, 1..6)) {
            roots.sort_by(f64::total_cmp);
            let apart = roots.windows(2).all(|pair| pair[1] - pair[0] > 1e-2);
            prop_assume!(apart && roots.iter().all(|r| r.abs() > 1e-2 && (r - 1.0).abs() > 1e-2));
            let mut p = from_roots(&roots, 1.0);
            if p[0] < 0.0 { p.iter_mut().for_each(|c| *c = -*c); }
            let expected = roots.iter().copied().find(|r| (0.0..=1.0).contains(r));
            match (first_fall(&p), expected) {
                (Some(found), Some(root)) => prop_assert!((found - root).abs() < 1e-9),
                (found, expected) => prop_assert_eq!(found, expected),
            }
        }
    }
}
