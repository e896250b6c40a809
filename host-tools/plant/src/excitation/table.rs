//! A motion given point by point, and a smooth curve through the points.
//!
//! It is a cubic spline that is at rest at both ends: displacement, velocity and acceleration are continuous, as on a
//! real shaker. Before the first point and after the last one the terminal rests.

use std::sync::Arc;

use super::point::Point;
use crate::{PlantError, table::check};

/// Minimum number of points: two intervals.
const FEWEST: usize = 3;
/// Maximum number of points: an hour at 4 kHz.
const MOST: usize = 1 << 24;
/// Allowed time between two points \[s\].
const PERIOD_S: (f64, f64) = (1e-6, 1.0);
/// Maximum displacement \[m\].
const DISPLACEMENT_M: f64 = 10.0;

/// Displacements at equal time steps.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Table {
    /// Time from point to point \[s\].
    pub period_s: f64,
    /// Displacement \[m\] and velocity \[m/s\] at each point.
    points: Arc<[(f64, f64)]>,
    factor: f64,
}

impl Table {
    /// The curve through these displacements \[m\].
    pub fn new(period_s: f64, displacements_m: &[f64]) -> Result<Self, PlantError> {
        check("period_s", period_s, PERIOD_S)?;
        check("points", displacements_m.len() as f64, (FEWEST as f64, MOST as f64))?;
        for x_m in displacements_m {
            check("displacement_m", *x_m, (-DISPLACEMENT_M, DISPLACEMENT_M))?;
        }
        let velocities = slopes(displacements_m).into_iter().map(|slope| slope / period_s);
        let points = displacements_m.iter().copied().zip(velocities).collect();
        let table = Self { period_s, points, factor: 1.0 };
        if let [first_m, .., last_m] = displacements_m
            && (first_m - last_m).abs() > 1e-6 * table.peak_m()
        {
            return Err(PlantError::Conflict {
                field: "the last displacement",
                other: "the first",
                rule: "they must be the same, as the terminal rests there before and after",
            });
        }
        Ok(table)
    }

    /// Its length \[s\].
    pub fn duration_s(&self) -> f64 {
        self.points.len().saturating_sub(1) as f64 * self.period_s
    }

    /// Multiplies the displacement by a factor.
    pub fn scale(&mut self, factor: f64) {
        self.factor *= factor;
    }

    /// The motion at a time after the first point, where the terminal is at zero.
    pub fn at(&self, t_s: f64) -> Point {
        let last = self.points.len().saturating_sub(2);
        let place = ((t_s / self.period_s).max(0.0) as usize).min(last);
        let ends = self.points.get(place).zip(self.points.get(place + 1));
        let Some((&(x0, v0), &(x1, v1))) = ends else { return Point::default() };
        let h = self.period_s;
        let u = (t_s / h - place as f64).clamp(0.0, 1.0);
        // Hermite's cubic: x = x0 + v0 h u + c u^2 + d u^3.
        let (c, d) = (3.0 * (x1 - x0) - h * (2.0 * v0 + v1), h * (v0 + v1) - 2.0 * (x1 - x0));
        Point {
            x_m: self.factor * (x0 + u * (v0 * h + u * (c + u * d)) - self.first_m()),
            v_m_per_s: self.factor * (v0 + u * (2.0 * c + 3.0 * d * u) / h),
            a_m_per_s2: self.factor * (2.0 * c + 6.0 * d * u) / (h * h),
        }
    }

    fn first_m(&self) -> f64 {
        self.points.first().map_or(0.0, |point| point.0)
    }

    fn peak_m(&self) -> f64 {
        self.points.iter().fold(0.0, |peak, point| f64::max(peak, (point.0 - self.first_m()).abs()))
    }
}

/// Slopes per point of the cubic spline with zero end slopes: `m[i-1] + 4 m[i] + m[i+1] = 3 (x[i+1] - x[i-1])`.
fn slopes(x: &[f64]) -> Vec<f64> {
    let inner = x.windows(3).map(|near| 3.0 * (near[2] - near[0]));
    // Thomas algorithm, elimination from the first point on.
    let mut swept: Vec<(f64, f64)> = vec![(0.0, 0.0)];
    let (mut above, mut right) = (0.0, 0.0);
    for value in inner {
        let pivot = 4.0 - above;
        (above, right) = (1.0 / pivot, (value - right) / pivot);
        swept.push((above, right));
    }
    let mut slopes = vec![0.0; x.len()];
    let mut after = 0.0;
    for (slope, (above, right)) in slopes.iter_mut().rev().skip(1).zip(swept.into_iter().rev()) {
        after = right - above * after;
        *slope = after;
    }
    slopes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Excitation;

    /// The points of a motion.
    fn points(motion: &Excitation, period_s: f64, duration_s: f64) -> Vec<f64> {
        let count = (duration_s / period_s).round() as u32;
        (0..=count).map(|k| motion.at(f64::from(k) * period_s).x_m).collect()
    }

    #[test]
    fn a_sampled_motion_is_the_motion() {
        let motion = Excitation::parse("tones:3.2Hz:4mm,15.9Hz:0.3mm@3s", 1).unwrap();
        let table = Excitation::table(1e-3, &points(&motion, 1e-3, 3.0)).unwrap();
        assert_eq!(table.duration_s(), 3.0);
        for k in 0..9000 {
            let t = 3.3e-4 * f64::from(k) + 1e-5;
            let (of_table, exact) = (table.at(t), motion.at(t));
            assert!((of_table.x_m - exact.x_m).abs() < 1e-9, "{t}: {of_table:?} {exact:?}");
            assert!((of_table.v_m_per_s - exact.v_m_per_s).abs() < 1e-6, "{t}: {of_table:?} {exact:?}");
            assert!((of_table.a_m_per_s2 - exact.a_m_per_s2).abs() < 5e-3, "{t}: {of_table:?} {exact:?}");
        }
        assert_eq!((table.at(-1.0), table.at(3.0)), (Point::default(), Point::default()));
    }

    #[test]
    fn it_is_smooth_and_at_rest_at_its_ends() {
        let table = Table::new(0.01, &[0.002, 0.003, -0.004, 0.001, 0.005, 0.002]).unwrap();
        assert_eq!((table.at(0.0).x_m, table.at(0.0).v_m_per_s), (0.0, 0.0));
        assert!(table.at(0.05).v_m_per_s.abs() < 1e-12 && table.at(0.05).x_m.abs() < 1e-12);
        for knot in 1..5 {
            let (before, after) = (table.at(0.01 * f64::from(knot) - 1e-9), table.at(0.01 * f64::from(knot) + 1e-9));
            assert!((before.x_m - after.x_m).abs() < 1e-8, "{before:?} {after:?}");
            assert!((before.v_m_per_s - after.v_m_per_s).abs() < 1e-5, "{before:?} {after:?}");
            assert!((before.a_m_per_s2 - after.a_m_per_s2).abs() < 1e-2, "{before:?} {after:?}");
        }
    }

    #[test]
    fn refusals_name_the_field() {
        let refused = |period_s: f64, x: &[f64]| Table::new(period_s, x).unwrap_err().to_string();
        assert!(refused(f64::NAN, &[0.0; 9]).contains("period_s"));
        assert!(refused(0.0, &[0.0; 9]).contains("period_s"));
        assert!(refused(1e-3, &[]).contains("points"));
        assert!(refused(1e-3, &[0.0, f64::INFINITY, 0.0]).contains("displacement_m"));
        assert!(refused(1e-3, &[0.0, 0.1, 0.2]).contains("the last displacement"));
    }
}
