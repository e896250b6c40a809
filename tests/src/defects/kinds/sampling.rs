//! Defects of the sampling: lost, repeated or swapped samples, and bad clocks.

use super::kind::{Kind, kind};
use inerter_core::RawSample;

pub const KINDS: [Kind; 8] = [
    kind("lost samples, with a gap in the index", &[], |scene, draw| {
        let often = draw.between(0.003, 0.1);
        scene.on_samples(move |samples, draw| samples.retain(|_| !draw.happens(often)));
    }),
    kind("lost bursts, with a gap in the index", &[], |scene, draw| {
        let (length_s, every_s) = (draw.between(0.01, 0.5), draw.between(1.5, 6.0));
        let rate = scene.instruments.sensors.sample_rate_hz;
        scene.on_samples(move |samples, draw| {
            let phase = draw.unit();
            samples.retain(|sample| ((f64::from(sample.index) / rate / every_s + phase).fract()) * every_s > length_s);
        });
    }),
    kind("lost samples, without a gap in the index", &[], |scene, draw| {
        let often = draw.between(0.0003, 0.01);
        scene.on_samples(move |samples, draw| {
            samples.retain(|_| !draw.happens(often));
            samples.iter_mut().zip(0..).for_each(|(sample, index)| sample.index = index);
        });
    }),
    kind("samples that are sent twice", &[], |scene, draw| {
        let often = draw.between(0.001, 0.03);
        scene.on_samples(move |samples, draw| {
            for n in 1..samples.len() {
                if draw.happens(often) {
                    samples[n] = RawSample { index: samples[n].index, ..samples[n - 1] };
                }
            }
        });
    }),
    kind("samples that change places", &[], |scene, draw| {
        let often = draw.between(0.001, 0.03);
        scene.on_samples(move |samples, draw| {
            for n in 1..samples.len() {
                if draw.happens(often) {
                    let (a, b) = (samples[n - 1], samples[n]);
                    samples[n - 1] = RawSample { index: a.index, ..b };
                    samples[n] = RawSample { index: b.index, ..a };
                }
            }
        });
    }),
    kind("a clock that drifts", &["drift"], |scene, draw| {
        let (part, duration_s) = (draw.sign() * draw.between(0.005, 0.05), scene.seen.duration_s);
        // The clock is right on average, so that this is not a wrong scale.
        scene.instruments.clock = Some(Box::new(move |t_s, _| t_s + part * t_s * (t_s / duration_s - 1.0)));
    }),
    kind("a clock that trembles", &[], |scene, draw| {
        let rms_s = draw.between(10e-6, 200e-6);
        scene.instruments.clock = Some(Box::new(move |t_s, draw| t_s + rms_s * draw.noise()));
    }),
    kind("a clock that jumps", &[], |scene, draw| {
        let (by_s, at_s) = (draw.between(2e-3, 50e-3), draw.within(0.2, 0.8) * scene.seen.duration_s);
        scene.instruments.clock = Some(Box::new(move |t_s, _| if t_s > at_s { t_s + by_s } else { t_s }));
    }),
];
