//! Batches of samples decode to exactly what was encoded.

use crate::frames;
use crate::reference::step;
use crate::values::{few_samples, longest_samples};
use inerter_core::RawSample;
use inerter_needs::Random;
use inerter_wire::*;
use proptest::prelude::*;

fn batch(payload: &[u8]) -> Samples {
    postcard::from_bytes(payload).unwrap()
}

fn all(samples: &Samples) -> Vec<Result<RawSample, DecodeError>> {
    samples.iter().collect()
}

/// Differences of any size, mostly small, including the extremes.
fn number() -> impl Strategy<Value = i32> {
    prop_oneof![4 => -100..100i32, 2 => any::<i32>(), 1 => Just(i32::MIN), 1 => Just(i32::MAX)]
}

fn sample() -> impl Strategy<Value = RawSample> {
    (number(), number(), number(), number()).prop_map(|(index, position_count, force_code, terminal_code)| RawSample {
        index: index as u32,
        position_count,
        force_code,
        terminal_code,
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 5000, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any samples survive encoding and decoding, in as many batches as necessary.
    #[test]
    fn any_samples_come_back(samples in prop::collection::vec(sample(), 0..100)) {
        let mut back = Vec::new();
        let mut left = &samples[..];
        while !left.is_empty() {
            let (batch, taken) = Samples::from_slice(left);
            prop_assert!(taken >= left.len().min(20), "20 samples always fit");
            prop_assert_eq!(batch.len(), taken);
            left = &left[taken..];
            match frames::read_all::<Record>(&frames::framed(&Record::Samples(batch), 0)).pop() {
                Some(Frame::Message { message: Record::Samples(batch), .. }) => {
                    for sample in &batch {
                        back.push(sample.unwrap());
                    }
                }
                other => prop_assert!(false, "{:?}", other),
            }
        }
        prop_assert_eq!(back, samples);
    }

    /// Decoding any content ends, after as many samples as it claims or after one error.
    #[test]
    fn any_content_ends(count: u8, data in prop::collection::vec(any::<u8>(), 0..=400)) {
        let length = frames::payload(&(data.len() as u32));
        let samples = batch(&[&[count][..], &length, &data].concat());
        let items = all(&samples);
        let good = items.iter().filter(|item| item.is_ok()).count();
        prop_assert!(good <= usize::from(count).min(32));
        match samples.check() {
            Ok(()) => prop_assert_eq!((items.len(), good), (usize::from(count), usize::from(count))),
            Err(error) => {
                prop_assert_eq!(items.len(), good + 1);
                prop_assert_eq!(items.last(), Some(&Err(error)));
            }
        }
        prop_assert_eq!(samples.iter().nth(items.len()), None);
    }
}

#[test]
fn bytes_are_as_described() {
    // Three samples, thirteen bytes: 3, -1, 0, 0; 0, +64, 0, 0; 1 missing, 0, 0, 0.
    let expected = [3, 13, 6, 1, 0, 0, 0, 0x80, 1, 0, 0, 2, 0, 0, 0];
    assert_eq!(frames::payload(&few_samples()), expected);
}

#[test]
fn counters_wrap() {
    let sample = |index, code| RawSample { index, position_count: code, force_code: code, terminal_code: code };
    let sent = [
        sample(u32::MAX - 1, i32::MAX),
        sample(u32::MAX, i32::MIN),
        sample(0, i32::MAX),
        sample(1, 0),
        sample(0, -1),
        sample(0, i32::MIN),
        sample(0x8000_0000, 1),
    ];
    let (samples, taken) = Samples::from_slice(&sent);
    assert_eq!(taken, sent.len());
    let back: Vec<RawSample> = samples.iter().map(Result::unwrap).collect();
    assert_eq!(back, sent);
}

#[test]
fn a_full_batch_refuses_and_stays() {
    let mut builder = Samples::builder();
    for index in 0..32 {
        builder.push(&RawSample { index, ..RawSample::default() }).unwrap();
    }
    assert_eq!(builder.push(&RawSample { index: 32, ..RawSample::default() }), Err(Full));
    assert_eq!((builder.len(), builder.is_empty()), (32, false));
    let full = builder.take();
    assert!(!full.is_empty() && Samples::from_slice(&[]).0.is_empty());
    assert_eq!((full.len(), all(&full).len(), full.check()), (32, 32, Ok(())));
    // The next batch is independent of this one.
    assert!(builder.is_empty());
    builder.push(&RawSample { index: 32, ..RawSample::default() }).unwrap();
    assert_eq!(all(&builder.take()), [Ok(RawSample { index: 32, ..RawSample::default() })]);

    let longest = longest_samples();
    assert!((20..32).contains(&longest.len()));
    assert_eq!(longest.check(), Ok(()));
}

/// A refused sample has no effect: one that fits is still accepted, and all decode.
#[test]
fn refusals_leave_no_trace() {
    let mut numbers = Random(6);
    for _ in 0..2000 {
        let mut builder = Samples::builder();
        let mut taken = Vec::new();
        for _ in 0..60 {
            let sample = RawSample {
                index: numbers.draw() as u32,
                position_count: step(&mut numbers),
                force_code: step(&mut numbers),
                terminal_code: step(&mut numbers),
            };
            if builder.push(&sample).is_ok() {
                taken.push(Ok(sample));
            }
        }
        assert_eq!(all(&builder.take()), taken);
    }
}

#[test]
fn malformed_content_is_named() {
    let zero = Ok(RawSample::default());
    for (payload, expected) in [
        (&[0, 0][..], vec![]),
        (&[1, 4, 0, 0, 0, 0], vec![zero]),
        (&[1, 0], vec![Err(DecodeError::Truncated)]),
        (&[1, 3, 0, 0, 0], vec![Err(DecodeError::Truncated)]),
        (&[1, 4, 0, 0, 0, 0x80], vec![Err(DecodeError::Truncated)]),
        (&[2, 4, 0, 0, 0, 0], vec![zero, Err(DecodeError::Truncated)]),
        (&[1, 5, 0, 0, 0, 0, 0], vec![zero, Err(DecodeError::TrailingBytes)]),
        (&[0, 1, 0], vec![Err(DecodeError::TrailingBytes)]),
        (&[33, 1, 0], vec![Err(DecodeError::TooMany)]),
        (&[255, 0], vec![Err(DecodeError::TooMany)]),
        (&[1, 5, 0xFF, 0xFF, 0xFF, 0xFF, 0x10], vec![Err(DecodeError::BadNumber)]),
        (&[1, 6, 0x80, 0x80, 0x80, 0x80, 0x80, 0x00], vec![Err(DecodeError::BadNumber)]),
    ] {
        assert_eq!(all(&batch(payload)), expected, "{payload:?}");
    }
    assert!(DecodeError::TooMany.to_string().contains("32"));
    assert!(Full.to_string().contains("send"));
}

/// The size of a real motion: the paper's 3.2 Hz test at 1 kHz, 2.44 um per count, 2 mN per code.
#[test]
fn real_motion_takes_few_bytes() {
    let mut noise = Random(7);
    let mut bytes = 0;
    let motion: Vec<RawSample> = (0..3200)
        .map(|index| {
            let phase = f64::from(index) * 1e-3 * std::f64::consts::TAU * 3.2;
            let ripple = noise.below(1000) as f64 - 500.0;
            RawSample {
                index,
                position_count: (4.16e-3 / 2.44e-6 * phase.sin()) as i32,
                force_code: (-250_000.0 * phase.sin() + ripple) as i32,
                terminal_code: 0,
            }
        })
        .collect();
    for part in motion.chunks(32) {
        let (samples, taken) = Samples::from_slice(part);
        assert_eq!(taken, 32);
        bytes += frames::framed(&Record::Samples(samples), 0).len();
    }
    let per_sample = bytes as f64 / motion.len() as f64;
    assert!((4.0..6.2).contains(&per_sample), "{per_sample} bytes a sample, framing included");
}
