//! The boards, one file each: pins, clocks and name.
//!
//! To add a board, add a file with the same items and a feature that selects it.

#[cfg(all(feature = "board-nucleo", feature = "board-weact"))]
compile_error!("choose one board: board-weact goes with --no-default-features");
#[cfg(not(any(feature = "board-nucleo", feature = "board-weact")))]
compile_error!("choose a board: board-nucleo or board-weact");

pub mod clock;
mod parts;

#[cfg(feature = "board-nucleo")]
mod nucleo;
#[cfg(all(feature = "board-weact", not(feature = "board-nucleo")))]
mod weact;

#[cfg(feature = "board-nucleo")]
pub use nucleo::{NAME, crystal, wire};
pub use parts::Parts;
#[cfg(all(feature = "board-weact", not(feature = "board-nucleo")))]
pub use weact::{NAME, crystal, wire};
