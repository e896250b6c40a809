//! Whatever a host may send: streams of bytes made to break the device, and how it must respond.
//!
//! Terms:
//! - *stream*: the bytes that a device receives on its link after a start.
//! - *intact request*: a frame in the stream with a valid CRC that holds a request, known to the device or not.
//! - *probe*: a delimiter and three harmless requests that end every stream.
//!
//! ```text
//! make -> stream -> device (the whole inerter-app on mock parts) -> Played -> judge -> findings -> shrink
//!   '--> corpus: small streams, each with the outcome that host and twin must share
//! ```
//!
//! What must hold for any stream: the device neither panics nor hangs; each intact request gets one reply with its id,
//! in order; a refused one changes nothing; the settings are those of the requests that were carried out, and flash
//! keeps those of the last save; each damaged frame is counted; every frame that comes out can be decoded; the probe is
//! answered. What arrives on a link that is not in use has no effect.

mod corpus;
mod device;
mod judge;
mod make;
mod outcome;
mod requests;
mod shrink;

pub use corpus::{Expected, Item, corpus, made as made_corpus, write as write_corpus};
pub use device::{Conditions, End, Link, Played, play, with_probe};
pub use judge::judge;
pub use make::{Stream, stream};
pub use outcome::outcome;
pub use requests::Requests;
pub use shrink::shrink;

/// What is wrong with the device's response to `stream`.
pub fn findings(stream: &[u8], conditions: &Conditions) -> Vec<String> {
    judge(stream, conditions, &play(stream, conditions))
}
