//! Fewer points with the same appearance: minimum and maximum per column, or one point per cell of a grid.

use std::ops::Range;

/// A line with increasing x, thinned to at most two points in each of `columns` between the ends of `range`; other
/// lines are unchanged. Points must be finite.
pub fn line(points: &[(f64, f64)], range: &Range<f64>, columns: usize) -> Vec<(f64, f64)> {
    let runs_right = points.windows(2).all(|pair| matches!(pair, [(before, _), (after, _)] if before <= after));
    let width = (range.end - range.start) / columns as f64;
    if points.len() <= 2 * columns || !runs_right || width <= 0.0 {
        return points.to_vec();
    }
    let mut thin: Vec<(f64, f64)> = Vec::with_capacity(2 * columns);
    let mut rest = points;
    while let Some((x, _)) = rest.first() {
        let column = ((x - range.start) / width).floor();
        let end = range.start + (column + 1.0) * width;
        // At least one, despite rounding of the column's end.
        let count = rest.partition_point(|(x, _)| *x < end).max(1);
        let (these, others) = rest.split_at(count);
        thin.extend(extremes(these));
        rest = others;
    }
    thin
}

/// Minimum and maximum in their original order.
fn extremes(points: &[(f64, f64)]) -> impl Iterator<Item = (f64, f64)> + use<> {
    let by_value = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
    let (least, greatest) = (points.iter().min_by(by_value), points.iter().max_by(by_value));
    let pair = match (least, greatest) {
        (Some(least), Some(greatest)) if least == greatest => [Some(*least), None],
        (Some(least), Some(greatest)) if least.0 <= greatest.0 => [Some(*least), Some(*greatest)],
        (least, greatest) => [greatest.copied(), least.copied()],
    };
    pair.into_iter().flatten()
}

/// A line in pixels without the points that stay in the cell of the previous one, nor those in the middle of a straight
/// segment.
pub fn pixels(points: impl Iterator<Item = (i32, i32)>, cell: i32) -> Vec<(i32, i32)> {
    let mut kept: Vec<(i32, i32)> = Vec::new();
    let mut last = None;
    for point in points {
        match kept.as_slice() {
            [.., before] if (point.0 - before.0).abs() < cell && (point.1 - before.1).abs() < cell => {}
            [.., first, second] if on_a_line(*first, *second, point) => {
                kept.pop();
                kept.push(point);
            }
            _ => kept.push(point),
        }
        last = Some(point);
    }
    // The end point stays.
    if let Some(last) = last.filter(|last| kept.last() != Some(last)) {
        kept.push(last);
    }
    kept
}

/// Whether the middle point lies between the others on a straight line in one direction.
fn on_a_line(first: (i32, i32), middle: (i32, i32), last: (i32, i32)) -> bool {
    let (ax, ay) = (i64::from(middle.0 - first.0), i64::from(middle.1 - first.1));
    let (bx, by) = (i64::from(last.0 - middle.0), i64::from(last.1 - middle.1));
    ax * by == ay * bx && ax * bx + ay * by > 0
}
