//! Streams that a host sends to a device, by [`inerter_tests::fuzz`].
//!
//! Input: two bytes (the conditions; bit 7 of the first one selects payloads instead of a stream), then the stream, or
//! payloads as in [`wire`].
//!
//! Property: [`inerter_tests::fuzz::judge`] finds nothing wrong.

use inerter_tests::fuzz::{Conditions, Link, corpus, findings, stream};
use inerter_wire::Request;

use crate::{
    input::{Input, seed},
    wire,
};

const PAYLOADS: u8 = 0x80;

/// Checks an input.
pub fn check(mut input: Input) {
    let (kind, portion) = (input.byte(), input.byte());
    let conditions = Conditions {
        portion: [64, 1, 3, 17, 200, 4_096, 1 + usize::from(portion)][usize::from(portion) % 7],
        sampling: kind & 1 == 0,
        link: [Link::First, Link::Second, Link::Single, Link::First][usize::from(kind >> 1 & 3)],
        deaf: kind & 8 != 0,
    };
    let bytes = wire::stream::<Request>(input, kind & PAYLOADS != 0);
    let findings = findings(&bytes, &conditions);
    assert!(findings.is_empty(), "{conditions:?}: {findings:#?}");
}

/// The corpus of the tests, and streams from fixed seeds.
pub fn seeds() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    let streams = corpus().expect("tests/corpus").into_iter().map(|item| item.bytes);
    let streams = streams.chain((0..40).map(|seed| stream(seed).bytes)).filter(|stream| stream.len() < 3_000);
    for (number, stream) in (0u8..).zip(streams) {
        seeds.push(seed(&[number & 0x0F, number], &stream));
        seeds.push(seed(&[PAYLOADS | number & 0x0F, number], wire::payloads(&stream)));
    }
    seeds
}
