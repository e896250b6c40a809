//! Whether the residual is white noise: the Ljung-Box test, Biometrika 65 (1978).

use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::result::Whiteness;
use crate::law::mean;

/// Number of lags tested.
const LAGS: usize = 20;
/// Minimum number of values for a result.
const LEAST: usize = 200;

/// Tests consecutive numbers that would be independent if the noise were white.
pub fn whiteness(residual: &[f64]) -> Option<Whiteness> {
    let count = residual.len();
    if count < LEAST {
        return None;
    }
    let mean = mean(residual);
    let square: f64 = residual.iter().map(|x| (x - mean).powi(2)).sum();
    let statistic: f64 = (1..=LAGS)
        .map(|lag| {
            let product: f64 =
                residual.iter().zip(residual.iter().skip(lag)).map(|(a, b)| (a - mean) * (b - mean)).sum();
            (product / square).powi(2) / (count - lag) as f64
        })
        .sum::<f64>()
        * (count * (count + 2)) as f64;
    let p = ChiSquared::new(LAGS as f64).ok()?.sf(statistic);
    (statistic.is_finite() && p.is_finite()).then_some(Whiteness { lags: LAGS, statistic, p })
}

#[cfg(test)]
mod tests {
    use inerter_needs::Random;

    use super::*;

    #[test]
    fn noise_is_white_and_a_wave_is_not() {
        let mut random = Random(1);
        let white: Vec<f64> = (0..2000).map(|_| random.share() - 0.5).collect();
        let found = whiteness(&white).unwrap();
        assert!((1e-3..0.999).contains(&found.p), "{found:?}");
        let coloured: Vec<f64> = white.iter().enumerate().map(|(n, x)| x + 0.2 * (n as f64 * 0.3).sin()).collect();
        assert!(whiteness(&coloured).unwrap().p < 1e-6);
        assert_eq!(whiteness(&white[..100]), None);
        assert_eq!(whiteness(&[1.0; 500]), None);
    }
}
