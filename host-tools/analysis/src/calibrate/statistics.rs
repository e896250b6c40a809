//! Means and straight lines, with uncertainties that account for correlated samples.

/// A mean and the half width of its 95 % interval.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mean {
    /// The mean.
    pub value: f64,
    /// Half width of its 95 % interval.
    pub u95: f64,
}

/// Student's t factor for a 95 % interval.
pub fn student(freedom: usize) -> f64 {
    const FIRST: [f64; 10] = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228];
    match freedom.checked_sub(1).and_then(|place| FIRST.get(place)) {
        Some(factor) => *factor,
        None if freedom == 0 => f64::INFINITY,
        // First terms of the Cornish-Fisher expansion: within 1e-3 from 10 on (Abramowitz and Stegun, 26.7.5).
        None => {
            let freedom = freedom as f64;
            1.960 + 2.372 / freedom + 2.823 / freedom.powi(2) + 2.556 / freedom.powi(3)
        }
    }
}

/// Mean of block means, each block longer than the correlation time: drift, oscillation and mains count as scatter.
pub fn mean_of_blocks(blocks: &[f64]) -> Mean {
    let count = blocks.len().max(1) as f64;
    let value = blocks.iter().sum::<f64>() / count;
    let squares: f64 = blocks.iter().map(|block| (block - value).powi(2)).sum();
    let deviation = (squares / (count - 1.0).max(1.0) / count).sqrt();
    let factor = student(blocks.len().saturating_sub(1));
    Mean { value, u95: if deviation > 0.0 { factor * deviation } else { 0.0 } }
}

/// A straight line by least squares.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Straight {
    pub slope: f64,
    pub at_zero: f64,
    /// Half width of the slope's 95 % interval, from the scatter.
    pub slope_u95: f64,
}

impl Straight {
    /// The line through points `(x, y)`; `None` if they have only one x.
    pub fn through(points: &[(f64, f64)]) -> Option<Self> {
        let count = points.len() as f64;
        let mean_x = points.iter().map(|(x, _)| x).sum::<f64>() / count;
        let mean_y = points.iter().map(|(_, y)| y).sum::<f64>() / count;
        let (xx, xy) = points
            .iter()
            .fold((0.0, 0.0), |(xx, xy), (x, y)| (xx + (x - mean_x) * (x - mean_x), xy + (x - mean_x) * (y - mean_y)));
        if xx.is_nan() || xx <= 0.0 {
            return None;
        }
        let slope = xy / xx;
        let at_zero = mean_y - slope * mean_x;
        let left: f64 = points.iter().map(|(x, y)| (y - at_zero - slope * x).powi(2)).sum();
        let freedom = points.len().saturating_sub(2);
        let deviation = (left / freedom.max(1) as f64 / xx).sqrt();
        let slope_u95 = if freedom == 0 { f64::INFINITY } else { student(freedom) * deviation };
        Some(Self { slope, at_zero, slope_u95 })
    }

    pub fn at(&self, x: f64) -> f64 {
        self.at_zero + self.slope * x
    }
}

/// Root sum of squares.
pub fn together<const N: usize>(parts: [f64; N]) -> f64 {
    parts.iter().map(|part| part * part).sum::<f64>().sqrt()
}

/// Rounds to this many significant digits.
pub fn rounded(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits.saturating_sub(1)).parse().unwrap_or(value)
}

/// Rounds an uncertainty up to two significant digits.
pub fn rounded_up(u95: f64) -> f64 {
    let near = rounded(u95, 2);
    if near >= u95 { near } else { rounded(u95 * 1.05, 2) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn students_factor_falls_to_that_of_the_normal_distribution() {
        assert_eq!((student(1), student(9)), (12.706, 2.262));
        assert!((student(20) - 2.086).abs() < 1e-3 && (student(11) - 2.201).abs() < 1e-3);
        assert!(student(0).is_infinite() && (student(1_000_000) - 1.96).abs() < 1e-4);
    }

    #[test]
    fn a_line_through_exact_points_is_exact_and_one_x_gives_none() {
        let line = Straight::through(&[(0.0, 1.0), (1.0, 3.0), (2.0, 5.0)]).unwrap();
        assert!((line.slope - 2.0).abs() < 1e-12 && (line.at(10.0) - 21.0).abs() < 1e-9 && line.slope_u95 < 1e-9);
        assert!(Straight::through(&[(1.0, 1.0), (1.0, 3.0)]).is_none() && Straight::through(&[]).is_none());
        assert!(Straight::through(&[(0.0, 1.0), (1.0, 3.0)]).unwrap().slope_u95.is_infinite());
    }

    #[test]
    fn an_uncertainty_is_rounded_up() {
        assert_eq!(rounded_up(0.001_01), 0.0011);
        assert_eq!(rounded_up(0.0011), 0.0011);
        assert_eq!(rounded_up(9.96), 10.0);
        assert_eq!(rounded_up(0.0), 0.0);
        assert!(rounded_up(4.21e-7) >= 4.21e-7);
    }
}
