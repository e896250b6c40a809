use super::*;
use crate::identify::condition::uniform;

#[test]
fn the_band_of_a_whitened_residual_is_white() {
    let count = 4000;
    let noise = |place: usize, stream: u64| (uniform(place as u64, stream) - 0.5) * 12f64.sqrt();
    let noises = Noise { position: 1e-6, force: 2.0 };
    // The effect of the terminal's noise: 3 um on the encoder, 4 N on the force, half of it correlated.
    let disturbance = |stream: u64| -> (Vec<f64>, Vec<f64>) {
        let at = |place: usize| (noise(place, stream), noise(place, stream + 1));
        (0..count).map(at).map(|(one, other)| (3e-6 * one, 2.0 * one + 12f64.sqrt() * other)).unzip()
    };
    let disturbed: Vec<_> = (10..20).map(|stream| disturbance(2 * stream)).collect();
    let whitening = Whitening::new(count, 1e-3, 0, 20.0, noises, std::iter::empty(), &disturbed);
    let mut rows = vec![0.0; whitening.rows()];
    let (x, f) = disturbance(4);
    let position = x.iter().enumerate().map(|(place, x)| x + 1e-6 * noise(place, 1));
    let force = f.iter().enumerate().map(|(place, f)| f + 2.0 * noise(place, 2));
    whitening.whitened(position, force, &mut rows);
    let mean = rows.iter().map(|x| x * x).sum::<f64>() / rows.len() as f64;
    assert!((0.8..1.2).contains(&mean), "{mean}");
    let power = whitening.power(&rows);
    assert_eq!(power.len(), rows.len());
    assert!(power.iter().all(|power| (0.3..2.5).contains(power)));
    assert!(whitening.counts(2000) && !whitening.counts(0));
}
