//! The self-test with jumpers: what a host asks a board to put out at its own inputs.
//!
//! Terms:
//! - *player*: the board's converters back to volts and its two encoder outputs, led to its inputs by four jumpers.
//! - *step*: a period of the sampling clock's rate, 64 kHz: each output may change once.
//! - *knot*: what the outputs have reached 64 steps after the knot before; between the two they go in a straight line.

use heapless::Vec;
use serde::{Deserialize, Serialize};

/// What the player is to do. Each is answered by `Done::Played` with a number of its own.
#[allow(clippy::large_enum_variant, reason = "cannot be boxed without an allocator")]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Play {
    /// Drive the outputs from now on: whoever sends this has made sure that no rig is connected. Both voltages begin at half
    /// the range, at the count 0.
    ///
    /// The outputs are let go by `End`, by a restart, when no `Play` has come for a second, and when a transfer by DMA
    /// fails.
    Begin {
        /// From the sampling clock's event to a change of the outputs (ticks of the core's clock). The answer is what it came
        /// to be.
        phase_ticks: u16,
    },
    /// Go on with these; none is taken where not all find room. The answer is the number taken since `Begin`.
    Knots(Vec<Knot, { Knot::MAX_KNOTS }>),
    /// Count up as fast as the encoder's inputs must bear, with no regard to knots, and begin anew afterwards. The answer is 0.
    Burst {
        /// Ticks of the core's clock from one edge to the next.
        edge_ticks: u16,
        /// Edges to put out, in units of 256.
        blocks: u16,
    },
    /// Let the outputs go. The answer is how often knots came too late, so that the outputs stood meanwhile; or
    /// [`Play::TRANSFER_FAILED`].
    End,
    /// The answer is the number of edges of the burst so far; all, where it has not grown.
    Progress,
}

impl Play {
    /// Answer to [`Play::End`]: a transfer by DMA failed, and the outputs were let go at once.
    pub const TRANSFER_FAILED: u32 = u32::MAX;
}

/// Where the outputs are to be 64 steps later.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Knot {
    /// Of the force, in sixteenths of a code of 12 bits.
    pub force: u16,
    /// Of the terminal displacement, the same.
    pub terminal: u16,
    /// Counts from the knot before, in 256ths; at most 64 counts either way, as a step has one edge.
    pub advance: i16,
}

impl Knot {
    /// Knots that one command can hold.
    pub const MAX_KNOTS: usize = 48;
    /// Steps from one knot to the next.
    pub const STEPS: u32 = 64;
    /// The greatest change of the count, in 256ths.
    pub const MAX_ADVANCE: i16 = 64 * 256;
    /// Half the range, in sixteenths of a code.
    pub const MIDDLE: u16 = 2048 * 16;

    /// Whether the outputs can do this.
    pub fn is_possible(&self) -> bool {
        self.advance.unsigned_abs() <= Self::MAX_ADVANCE.unsigned_abs()
    }
}
