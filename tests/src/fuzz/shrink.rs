//! Shrinks a stream while it still shows the failure.

use inerter_wire::DELIMITER;

/// Maximum number of trials.
const TRIALS: u32 = 2_000;

/// Removes frames, then bytes, as long as the rest is still `wrong`.
pub fn shrink(stream: &[u8], mut wrong: impl FnMut(&[u8]) -> bool) -> Vec<u8> {
    let mut trials = 0;
    let mut wrong = |bytes: &[u8]| {
        trials += 1;
        trials <= TRIALS && wrong(bytes)
    };
    let frames = stream.split_inclusive(|&byte| byte == DELIMITER).map(<[u8]>::to_vec).collect();
    let frames = without(frames, &mut |frames: &[Vec<u8>]| wrong(&frames.concat()));
    without(frames.concat(), &mut wrong)
}

/// Removes ever shorter parts of a list while the rest is still `wrong`.
fn without<T: Clone>(mut list: Vec<T>, wrong: &mut impl FnMut(&[T]) -> bool) -> Vec<T> {
    let mut part = list.len().div_ceil(2).max(1);
    loop {
        let mut place = 0;
        while place < list.len() {
            let mut less = list.clone();
            less.drain(place..(place + part).min(less.len()));
            if wrong(&less) {
                list = less;
            } else {
                place += part;
            }
        }
        if part == 1 {
            return list;
        }
        part = part.div_ceil(2);
    }
}
