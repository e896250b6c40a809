//! Streams of bytes made to break the device, and the required response.
//!
//! Terms:
//! - *stream*: the bytes that a device receives on its link after a start.
//! - *intact request*: a frame in the stream with a valid CRC that holds a request, known to the device or not.
//! - *probe*: a delimiter and three harmless requests that follow every stream.
//!
//! ```text
//! make -> stream -> device (the whole inerter-app on mock parts) -> Played -> judge -> findings -> shrink
//!   '--> corpus: small streams, each with the outcome that host and twin must share
//! ```
//!
//! Requirements for any stream: the device neither panics nor hangs. Each intact request gets one reply with its ID, in
//! order. A refused request changes nothing. The settings are those of the accepted requests, and flash contains those
//! of the last save. The device counts each damaged frame. Every frame that it sends can be decoded. It answers the
//! probe. Bytes on a link that is not in use have no effect.

mod corpus;
mod device;
mod judge;
mod make;
mod outcome;
mod requests;
mod shrink;

pub use corpus::{Item, corpus, made as made_corpus, outcomes, write as write_corpus};
pub use device::{Conditions, End, Link, Played, play, with_probe};
pub use judge::judge;
pub use make::{Stream, request, stream};
pub use requests::Requests;
pub use shrink::shrink;

/// What is wrong with the device's response to `stream`.
pub fn findings(stream: &[u8], conditions: &Conditions) -> Vec<String> {
    judge(stream, conditions, &play(stream, conditions))
}
