//! The signals to play, and the resulting outputs.

use std::ops::Range;

use inerter_app::player::{Player, Step};
use inerter_wire::Knot;

/// Counts that the marker goes up and back, and the knots for each.
const MARKER: (i32, usize) = (400, 20);

/// Knots of rest at the beginning of a tape that has no marker.
pub const REST: usize = 192;

/// Knots, and the steps that the board makes of them.
#[derive(Clone, Debug)]
pub struct Tape {
    knots: Vec<Knot>,
    steps: Vec<Step>,
    player: Player,
    last: Knot,
}

impl Tape {
    /// Begins at rest, with an encoder marker that locates its samples.
    pub fn new() -> Self {
        let mut tape = Self::empty();
        let (counts, knots) = MARKER;
        let advance = (counts * 256 / knots as i32) as i16;
        tape.hold(20);
        tape.turn(advance, knots);
        tape.hold(10);
        tape.turn(-advance, knots);
        tape.hold(10);
        tape
    }

    /// Begins with [`REST`] knots at these voltages, without a marker \[sixteenths of a code\].
    pub fn from_rest(force: u16, terminal: u16) -> Self {
        let mut tape = Self::empty();
        tape.go(force, terminal, REST - 1);
        tape
    }

    fn empty() -> Self {
        Self {
            knots: Vec::new(),
            steps: Vec::new(),
            player: Player::new(),
            last: Knot { force: Knot::MIDDLE, terminal: Knot::MIDDLE, advance: 0 },
        }
    }

    /// Adds a knot.
    pub fn push(&mut self, knot: Knot) {
        self.player.head_for(&knot);
        self.steps.extend((0..Knot::STEPS).map(|_| self.player.step()));
        self.knots.push(knot);
        self.last = knot;
    }

    /// Holds for this many knots; returns their range.
    pub fn hold(&mut self, knots: usize) -> Range<usize> {
        self.turn(0, knots)
    }

    /// Moves the encoder uniformly.
    pub fn turn(&mut self, advance: i16, knots: usize) -> Range<usize> {
        let first = self.knots.len();
        for _ in 0..knots {
            self.push(Knot { advance, ..self.last });
        }
        first..self.knots.len()
    }

    /// Goes to these voltages in one knot, and holds them; returns the range of the held knots \[sixteenths of a
    /// code\].
    pub fn go(&mut self, force: u16, terminal: u16, knots: usize) -> Range<usize> {
        self.push(Knot { force, terminal, advance: 0 });
        self.hold(knots)
    }

    /// The knots.
    pub fn knots(&self) -> &[Knot] {
        &self.knots
    }

    /// The outputs, step by step.
    pub fn steps(&self) -> &[Step] {
        &self.steps
    }
}
