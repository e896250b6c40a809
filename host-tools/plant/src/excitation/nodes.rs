//! The motion at the integrator's nodes, computed efficiently: tones are rotating phasors, without a sine and cosine
//! per step.
//!
//! Nodes lie a whole number of steps after the last break (start or end of a segment or of its ramp), and on the
//! breaks. The phasors are recomputed every 64 steps, so rounding stays at 1e-14 of the amplitude.

use std::f64::consts::TAU;

use super::{Excitation, Point, Segment, Shape, Tone};

/// Steps between two recomputations of the phasors.
const REFRESH: u32 = 64;

/// The motion over one step: its values at both ends.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    pub start_s: f64,
    pub step_s: f64,
    pub first: Point,
    pub last: Point,
}

/// Walks through a motion step by step.
#[derive(Clone, Debug)]
pub(crate) struct Nodes {
    excitation: Excitation,
    step_s: f64,
    /// Starts and ends of segments and ramps, each with the segment that begins or continues there.
    breaks: Vec<(f64, Option<usize>)>,
    /// The latest break passed.
    current: usize,
    /// Steps since that break.
    count: u32,
    here: Point,
    phasors: Vec<Phasor>,
    /// Steps since the phasors were recomputed.
    age: u32,
}

#[derive(Clone, Copy, Debug)]
struct Phasor {
    rad_per_s: f64,
    sin: f64,
    cos: f64,
    step_sin: f64,
    step_cos: f64,
}

impl Nodes {
    /// Starts at time zero with this step.
    pub fn new(excitation: Excitation, step_s: f64) -> Self {
        let mut breaks = Vec::new();
        for (k, segment) in excitation.segments.iter().enumerate() {
            let (start, end, ramp) = (segment.start_s, segment.end_s(), segment.ramp_length_s());
            breaks.push((start, Some(k)));
            breaks.push((start + ramp, Some(k)));
            // No two breaks almost coincide: a step of that length would be dominated by rounding.
            if end < f64::INFINITY && end - ramp > start + ramp + 1e-6 {
                breaks.push((end - ramp, Some(k)));
            }
        }
        if excitation.duration_s() < f64::INFINITY {
            breaks.push((excitation.duration_s(), None));
        }
        let here = Point::default();
        let mut nodes = Self { excitation, step_s, breaks, current: 0, count: 0, here, phasors: Vec::new(), age: 0 };
        nodes.enter();
        nodes
    }

    /// Prepares the interval after the current break.
    fn enter(&mut self) {
        self.count = 0;
        self.refresh();
        self.here = self.evaluate(self.break_s(self.current));
    }

    /// The time of a break; infinite behind the last one.
    fn break_s(&self, number: usize) -> f64 {
        self.breaks.get(number).map_or(f64::INFINITY, |b| b.0)
    }

    fn refresh(&mut self) {
        self.age = 0;
        self.phasors = Vec::new();
        let Some(segment) = self.segment() else { return };
        let Shape::Tones(tones) = &segment.shape else { return };
        let local = self.break_s(self.current) + f64::from(self.count) * self.step_s - segment.start_s;
        let phasor = |tone: &Tone| {
            let rad_per_s = TAU * tone.frequency_hz;
            let (sin, cos) = (rad_per_s * local + tone.phase_rad).sin_cos();
            let (step_sin, step_cos) = (rad_per_s * self.step_s).sin_cos();
            Phasor { rad_per_s, sin: tone.amplitude_m * sin, cos: tone.amplitude_m * cos, step_sin, step_cos }
        };
        self.phasors = tones.iter().map(phasor).collect();
    }

    /// The motion at a break or any other time, from its formula, in the interval after the current break.
    fn evaluate(&self, t_s: f64) -> Point {
        self.segment().map_or_else(Point::default, |segment| segment.at(t_s))
    }

    /// The segment of the interval after the current break.
    fn segment(&self) -> Option<&Segment> {
        let &(_, segment) = self.breaks.get(self.current)?;
        self.excitation.segments.get(segment?)
    }

    /// The motion one whole step later.
    fn advance(&mut self, t_s: f64) -> Point {
        if self.phasors.is_empty() {
            return self.evaluate(t_s);
        }
        self.age += 1;
        if self.age >= REFRESH {
            self.refresh();
        } else {
            for p in &mut self.phasors {
                let sin = p.sin * p.step_cos + p.cos * p.step_sin;
                p.cos = p.cos * p.step_cos - p.sin * p.step_sin;
                p.sin = sin;
            }
        }
        let mut sum = Point::default();
        for p in &self.phasors {
            sum.x_m += p.sin;
            sum.v_m_per_s += p.rad_per_s * p.cos;
            sum.a_m_per_s2 -= p.rad_per_s * p.rad_per_s * p.sin;
        }
        self.segment().map_or(sum, |segment| segment.windowed(t_s - segment.start_s, sum))
    }

    /// The next step.
    pub fn next_node(&mut self) -> Node {
        let origin = self.break_s(self.current);
        let start_s = origin + f64::from(self.count) * self.step_s;
        let first = self.here;
        let next_break = self.break_s(self.current + 1);
        let regular = origin + (f64::from(self.count) + 1.0) * self.step_s;
        // A tiny remainder before a break joins the last step.
        if regular + 1e-3 * self.step_s >= next_break {
            let last = self.evaluate(next_break);
            self.current += 1;
            self.enter();
            return Node { start_s, step_s: next_break - start_s, first, last };
        }
        self.count += 1;
        self.here = self.advance(regular);
        if self.count == u32::MAX {
            // Half a month of steps without a break: restart the count here.
            let segment = self.breaks.get(self.current).and_then(|b| b.1);
            self.breaks.insert(self.current + 1, (regular, segment));
            self.current += 1;
            self.enter();
        }
        Node { start_s, step_s: self.step_s, first, last: self.here }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_follow_the_formula() {
        for text in ["random", "multi@3s;hold@1s;sine:3.2Hz:4mm@2.0005s;chirp:0.5-20Hz:5mm/s:5s", "fast"] {
            let motion = Excitation::parse(text, 11).unwrap();
            let mut nodes = Nodes::new(motion.clone(), 1e-3);
            let mut end = 0.0;
            while end < 15.0 {
                let node = nodes.next_node();
                assert!((node.start_s - end).abs() < 1e-12 && node.step_s > 0.0 && node.step_s < 1.1e-3);
                for (t, point) in [(node.start_s, node.first), (node.start_s + node.step_s, node.last)] {
                    let exact = motion.at(t);
                    assert!((point.x_m - exact.x_m).abs() < 1e-14, "{text} {t}");
                    assert!((point.v_m_per_s - exact.v_m_per_s).abs() < 1e-12, "{text} {t}");
                    assert!((point.a_m_per_s2 - exact.a_m_per_s2).abs() < 1e-10, "{text} {t}");
                }
                end = node.start_s + node.step_s;
            }
        }
    }
}
