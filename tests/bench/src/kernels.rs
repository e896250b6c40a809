//! Matched kernels in f64 that give every channel the same gain and delay, at every sample.

/// One kernel for each kind of channel, all of one delay.
pub struct Kernels {
    /// Smooths a value taken at the sample: four boxes behind `[1 10 1]/12`.
    pub value: Kernel,
    /// Smooths an average over the sample: four boxes behind `[1 22 1]/24`.
    pub average: Kernel,
    /// First derivative of a value: three boxes and a difference behind `[-1 13 13 -1]/24`.
    pub slope: Kernel,
    /// Second derivative of a value: two boxes and two differences.
    pub curvature: Kernel,
    /// Samples under the longest.
    pub span: usize,
}

impl Kernels {
    /// Of a box of `length` samples at `rate_hz`.
    pub fn new(length: usize, rate_hz: f64) -> Self {
        let kernel = |correction: &[f64], boxes| kernel(correction, boxes, length, rate_hz);
        let all = [
            kernel(&[1.0 / 12.0, 10.0 / 12.0, 1.0 / 12.0], 4),
            kernel(&[1.0 / 24.0, 22.0 / 24.0, 1.0 / 24.0], 4),
            kernel(&[-1.0 / 24.0, 13.0 / 24.0, 13.0 / 24.0, -1.0 / 24.0], 3),
            kernel(&[1.0], 2),
        ];
        let span = all.iter().map(Vec::len).max().unwrap_or(0);
        let [value, average, slope, curvature] = all.map(|taps| Kernel { lead: (span - taps.len()) / 2, taps });
        Self { value, average, slope, curvature, span }
    }
}

/// One of [`Kernels`].
pub struct Kernel {
    taps: Vec<f64>,
    /// Samples by which it begins later than the longest.
    lead: usize,
}

impl Kernel {
    /// The filtered channel, with all kernels from `start` on.
    pub fn pass(&self, channel: &[f64], start: usize) -> f64 {
        // The newest sample meets the first tap.
        self.taps.iter().rev().zip(&channel[start + self.lead..]).map(|(tap, value)| tap * value).sum()
    }
}

/// A correction, `boxes` boxes and `4 - boxes` differences over one box.
fn kernel(correction: &[f64], boxes: usize, length: usize, rate_hz: f64) -> Vec<f64> {
    let average = vec![1.0 / length as f64; length];
    let mut difference = vec![0.0; length + 1];
    difference[0] = rate_hz / length as f64;
    difference[length] = -difference[0];
    let mut out = correction.to_vec();
    for _ in 0..boxes {
        out = convolve(&out, &average);
    }
    for _ in boxes..4 {
        out = convolve(&out, &difference);
    }
    out
}

/// The product of two polynomials: one kernel after another.
fn convolve(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; a.len() + b.len() - 1];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            out[i + j] += x * y;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quadratic has its exact velocity and acceleration, a constant itself, whatever the box.
    #[test]
    fn kernels_are_exact_on_polynomials() {
        let rate_hz = 1000.0;
        for length in [2, 4, 16] {
            let kernels = Kernels::new(length, rate_hz);
            let quadratic: Vec<f64> = (0..128).map(|n| 3.0 * f64::from(n * n)).collect();
            let constant = [10.0; 128];
            for start in 0..=128 - kernels.span {
                let middle = start as f64 + (kernels.span as f64 - 1.0) / 2.0;
                assert!((kernels.curvature.pass(&quadratic, start) / (6.0 * rate_hz * rate_hz) - 1.0).abs() < 1e-9);
                assert!((kernels.slope.pass(&quadratic, start) / (6.0 * rate_hz * middle) - 1.0).abs() < 1e-9);
                assert!((kernels.value.pass(&constant, start) - 10.0).abs() < 1e-12);
                assert!((kernels.average.pass(&constant, start) - 10.0).abs() < 1e-12);
            }
        }
    }

    /// All gains fall alike with the frequency: a sine keeps `a = -w^2 x` and `v = w x` through the kernels.
    #[test]
    fn gains_are_matched() {
        let (rate_hz, frequency_hz) = (1000.0, 15.0);
        let w = std::f64::consts::TAU * frequency_hz;
        let kernels = Kernels::new(16, rate_hz);
        let sine: Vec<f64> = (0..400).map(|n| (w * f64::from(n) / rate_hz).sin()).collect();
        let cosine: Vec<f64> = (0..400).map(|n| (w * f64::from(n) / rate_hz).cos()).collect();
        for start in (0..=400 - kernels.span).step_by(7) {
            let (x, y) = (kernels.value.pass(&sine, start), kernels.value.pass(&cosine, start));
            assert!((kernels.curvature.pass(&sine, start) + w * w * x).abs() < 1e-5 * w * w);
            assert!((kernels.slope.pass(&sine, start) - w * y).abs() < 1e-5 * w);
        }
    }
}
