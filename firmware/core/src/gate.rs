//! Which samples may teach the estimator something.
//!
//! A sample is *stuck* when the encoder stayed within a small span for 24 ms around it: the model does not hold while
//! dry friction carries the force, and nothing can be learnt from rest. The span is that of a window, not the
//! difference of its ends, so that a quick reversal is not taken for rest and a flickering count is.

use heapless::HistoryBuf;

/// Blocks in one window.
pub const BLOCKS: usize = 8;

#[derive(Clone, Copy, Debug)]
struct Span {
    least: i32,
    greatest: i32,
}

impl Span {
    fn join(self, other: Self) -> Self {
        Self { least: self.least.min(other.least), greatest: self.greatest.max(other.greatest) }
    }
}

/// How the window stands that a block closes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Block {
    /// Nothing moved in it.
    AtRest,
    /// Something did, or it is too short to tell.
    Moving,
}

/// Finds windows in which nothing moved.
#[derive(Clone, Debug)]
pub struct Rest {
    blocks: HistoryBuf<Span, BLOCKS>,
    current: Option<Span>,
    filled: u16,
    /// Where the present blocks count from: spans are of wrapping differences.
    origin: i32,
}

impl Rest {
    /// One that has seen nothing.
    pub const fn new() -> Self {
        Self { blocks: HistoryBuf::new(), current: None, filled: 0, origin: 0 }
    }

    /// Forgets all: what follows is not joined to what came before.
    pub fn reset(&mut self) {
        *self = Self::new();
    }

    /// Takes a position; tells of the window that it closes where a block ends here.
    ///
    /// `block` is the block length in samples, `limit` the span [counts / oversampling] that still is rest.
    pub fn push(&mut self, position_count: i32, block: u16, limit: u32) -> Option<Block> {
        if self.filled == 0 && self.blocks.is_empty() {
            self.origin = position_count;
        }
        let here = position_count.wrapping_sub(self.origin);
        let point = Span { least: here, greatest: here };
        let span = self.current.map_or(point, |span| span.join(point));
        self.filled = self.filled.saturating_add(1);
        if self.filled < block {
            self.current = Some(span);
            return None;
        }
        self.filled = 0;
        self.current = None;
        self.blocks.write(span);
        if self.blocks.len() < BLOCKS {
            return Some(Block::Moving);
        }
        let whole = self.blocks.as_slice().iter().copied().reduce(Span::join).unwrap_or(span);
        let at_rest = whole.greatest.abs_diff(whole.least) <= limit;
        // Keep differences small however far the screw travels.
        if here.unsigned_abs() > 1 << 30 {
            self.reset();
        }
        Some(if at_rest { Block::AtRest } else { Block::Moving })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rest_ends(positions: impl Iterator<Item = i32>, block: u16, limit: u32) -> usize {
        let mut rest = Rest::new();
        positions.filter(|&position| rest.push(position, block, limit) == Some(Block::AtRest)).count()
    }

    #[test]
    fn flicker_is_rest_and_a_quick_reversal_is_not() {
        assert_eq!(rest_ends((0..240).map(|n| 1000 + n % 2), 3, 2), 240 / 3 - 7);
        // A parabola of 0.5 count per sample^2 turning at 120.
        assert_eq!(rest_ends((0..240).map(|n| (n - 120) * (n - 120) / 4), 3, 2), 0);
    }

    #[test]
    fn wraps_with_the_counter() {
        assert_eq!(rest_ends((0..48).map(|n| i32::MAX.wrapping_add(n % 2)), 3, 2), 16 - 7);
        assert_eq!(rest_ends((0..480).map(|n| i32::MAX.wrapping_add(n)), 3, 2), 0);
    }
}
