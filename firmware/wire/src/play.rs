//! The self-test with jumpers: signals that a board generates for its own inputs at a host's request.
//!
//! Terms:
//! - *player*: the board's digital-to-analogue converters and its two encoder outputs, connected to its inputs by four
//!   jumpers.
//! - *step*: one period of the 64 kHz sampling clock: each output may change once.
//! - *knot*: the state of the outputs 64 steps after the previous knot; between knots they change linearly.

use heapless::Vec;
use serde::{Deserialize, Serialize};

/// What the player is to do. Each command is answered by `Done::Played` with a number of its own.
#[allow(clippy::large_enum_variant, reason = "cannot be boxed without an allocator")]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Play {
    /// Drive the outputs from now on: the sender has made sure that no rig is connected. Both voltages begin at half
    /// the range, and the count at 0.
    ///
    /// The outputs are released by `End`, by a restart, if no `Play` has come for a second, and if a transfer by DMA
    /// fails.
    Begin {
        /// Time from the sampling clock's event to a change of the outputs (ticks of the core's clock). The answer is
        /// the time actually set.
        phase_ticks: u16,
    },
    /// Continue with these; none is taken unless there is room for all. The answer is the number taken since `Begin`.
    Knots(Vec<Knot, { Knot::MAX_KNOTS }>),
    /// Count up at the greatest speed that the encoder's inputs must handle, regardless of knots; afterwards, start
    /// over with `Begin`. The answer is 0.
    Burst {
        /// Ticks of the core's clock from one edge to the next.
        edge_ticks: u16,
        /// Edges to put out, in units of 256.
        blocks: u16,
    },
    /// Release the outputs. The answer is how often knots came too late, so that the outputs stood still meanwhile; or
    /// [`Play::TRANSFER_FAILED`].
    End,
    /// The answer is the number of edges of the burst so far: all of them if it has stopped growing.
    Progress,
}

impl Play {
    /// Answer to [`Play::End`]: a transfer by DMA failed, and the outputs were released at once.
    pub const TRANSFER_FAILED: u32 = u32::MAX;
}

/// State of the outputs 64 steps later.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Knot {
    /// Force output, in sixteenths of a 12-bit code.
    pub force: u16,
    /// Terminal displacement output, likewise.
    pub terminal: u16,
    /// Counts since the previous knot, in 256ths; at most 64 counts either way, because a step has one edge.
    pub advance: i16,
}

impl Knot {
    /// Knots that one command can hold.
    pub const MAX_KNOTS: usize = 48;
    /// Steps from one knot to the next.
    pub const STEPS: u32 = 64;
    /// Greatest change of the count, in 256ths.
    pub const MAX_ADVANCE: i16 = 64 * 256;
    /// Half the range, in sixteenths of a code.
    pub const MIDDLE: u16 = 2048 * 16;

    /// Whether the outputs can follow this.
    pub fn is_possible(&self) -> bool {
        self.advance.unsigned_abs() <= Self::MAX_ADVANCE.unsigned_abs()
    }
}
