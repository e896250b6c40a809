//! Which samples the estimator may learn from.
//!
//! A sample is *stuck* when the encoder stayed within a small span for 24 ms around it: the model does not hold while
//! dry friction carries the force, and rest contains no information. The span is that of the whole window, not the
//! difference of its ends, so that a quick reversal does not count as rest and a flickering count does.

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

/// State of the window that a block completes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Block {
    /// Nothing moved in it.
    AtRest,
    /// Something did, or there is not yet a whole window.
    Moving,
}

/// Finds windows in which nothing moved.
#[derive(Clone, Debug)]
pub struct Rest {
    blocks: HistoryBuf<Span, BLOCKS>,
    current: Option<Span>,
    filled: u16,
    /// Zero of the present blocks' positions: spans are of wrapping differences.
    origin: i32,
}

impl Rest {
    /// Nothing seen.
    pub const fn new() -> Self {
        Self { blocks: HistoryBuf::new(), current: None, filled: 0, origin: 0 }
    }

    /// Forgets everything: what follows is not joined to what came before.
    pub fn reset(&mut self) {
        *self = Self::new();
    }

    /// Takes a position; where a block ends here, returns the state of the window that it completes.
    ///
    /// `block` is the block length in samples, `limit` the greatest span [counts / oversampling] that counts as rest.
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

    /// A screw that has travelled further than a difference of 31 bits, and then flickers by one count there.
    #[test]
    fn rest_is_found_however_far_the_screw_has_travelled() {
        let far = |n: i32| if n < 30 { n << 26 } else { i32::MAX.wrapping_add(n % 2) };
        assert_eq!(rest_ends((0..270).map(far), 3, 2), 240 / 3 - 7);
    }

    #[test]
    fn a_window_begins_anew_after_a_reset_and_its_limit_counts_as_rest() {
        let mut rest = Rest::new();
        // A span of 3 counts in each window.
        let mut ends = |n: i32, limit: u32| match n {
            100 => {
                rest.reset();
                0
            }
            _ => usize::from(rest.push(50 + 3 * (n % 2), 1, limit) == Some(Block::AtRest)),
        };
        assert_eq!((0..100).map(|n| ends(n, 3)).sum::<usize>(), 100 - 7);
        assert_eq!((100..108).map(|n| ends(n, 3)).sum::<usize>(), 0);
        assert_eq!((108..118).map(|n| ends(n, 3)).sum::<usize>(), 10);
        assert_eq!((118..128).map(|n| ends(n, 2)).sum::<usize>(), 0);
    }
}
