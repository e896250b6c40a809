use super::*;

#[test]
fn the_band_of_a_whitened_residual_is_white() {
    // Force and encoder with nothing but their own noise, the terminal without.
    let count = 4000;
    let noise = |place: usize, stream: u64| {
        let mut z = (place as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(stream << 32);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64 - 0.5) * 12f64.sqrt()
    };
    let nodes = (0..count).map(|place| [1e-3 * (place as f64 * 0.02).sin(), 1e-2, 0.0]).collect();
    let smooth = Smooth { nodes, noise: 0.0, band_hz: 10.0 };
    let device = Parameters {
        inertance_kg: 300.0,
        stiffness_n_per_m: 2e6,
        contact_damping_n_s_per_m: 1e3,
        ..Parameters::default()
    };
    let noises = Noise { position: 1e-6, force: 2.0 };
    let whitening = Whitening::new(&smooth, 1e-3, 0, 20.0, noises, 1.0, &device);
    let mut rows = vec![0.0; whitening.rows()];
    let position = (0..count).map(|place| 1e-6 * noise(place, 1));
    let force = (0..count).map(|place| 2.0 * noise(place, 2));
    whitening.whitened(position, force, &mut rows);
    let mean = rows.iter().map(|x| x * x).sum::<f64>() / rows.len() as f64;
    assert!((0.8..1.2).contains(&mean), "{mean}");
    let power = whitening.power(&rows);
    assert_eq!(power.len(), rows.len());
    assert!(power.iter().all(|power| (0.3..2.5).contains(power)));
    assert!(whitening.counts(2000) && !whitening.counts(0));
}
