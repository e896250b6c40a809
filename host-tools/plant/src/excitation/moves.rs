//! Point-to-point moves of a positioning axis: there and back, with a rest at either end.

/// Fraction of the acceleration time in which the acceleration rises, and in which it falls again.
const JERK_PART: f64 = 0.2;

/// Moves back and forth. The acceleration rises and falls linearly, so that it is continuous.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moves {
    /// Length of one move \[m\].
    pub stroke_m: f64,
    /// Velocity between the ramps \[m/s\]; a short move does not reach it.
    pub velocity_m_per_s: f64,
    /// Maximum acceleration \[m/s^2\].
    pub acceleration_m_per_s2: f64,
    /// Rest before each move \[s\].
    pub rest_s: f64,
}

/// The phases of a move.
struct Profile {
    /// Length of the acceleration's rise \[s\].
    rise_s: f64,
    /// Time at maximum acceleration \[s\].
    hold_s: f64,
    /// Time at maximum velocity \[s\].
    coast_s: f64,
    acceleration: f64,
}

impl Moves {
    fn profile(&self) -> Profile {
        // A ramp to the velocity v at the peak acceleration a has the mean acceleration a (1 - JERK_PART).
        let mean = self.acceleration_m_per_s2 * (1.0 - JERK_PART);
        let velocity = self.velocity_m_per_s.min((self.stroke_m * mean).sqrt());
        let ramp_s = velocity / mean;
        Profile {
            rise_s: JERK_PART * ramp_s,
            hold_s: ramp_s * (1.0 - 2.0 * JERK_PART),
            coast_s: self.stroke_m / velocity - ramp_s,
            acceleration: self.acceleration_m_per_s2,
        }
    }

    /// Displacement, velocity and acceleration at `t_s` after the start.
    pub(super) fn at(&self, t_s: f64) -> [f64; 3] {
        let profile = self.profile();
        let move_s = profile.duration_s();
        let period_s = 2.0 * (self.rest_s + move_s);
        let within = t_s.rem_euclid(period_s);
        let (is_back, within) = if within < 0.5 * period_s { (false, within) } else { (true, within - 0.5 * period_s) };
        let there = profile.at((within - self.rest_s).max(0.0).min(move_s));
        if !is_back {
            return there;
        }
        let [x, v, a] = there;
        [self.stroke_m - x, -v, -a]
    }

    /// Multiplies the length of the moves, in the same time.
    pub(super) fn scale(&mut self, factor: f64) {
        self.stroke_m *= factor;
        self.velocity_m_per_s *= factor;
        self.acceleration_m_per_s2 *= factor;
    }

    /// A rate that no part of it exceeds \[rad/s\]: that of a sine whose quarter is the acceleration's rise.
    pub(super) fn highest_rad_per_s(&self) -> f64 {
        0.5 * std::f64::consts::PI / self.profile().rise_s
    }
}

impl Profile {
    fn duration_s(&self) -> f64 {
        2.0 * (2.0 * self.rise_s + self.hold_s) + self.coast_s
    }

    fn at(&self, t_s: f64) -> [f64; 3] {
        let jerk = self.acceleration / self.rise_s;
        let parts = [
            (self.rise_s, jerk),
            (self.hold_s, 0.0),
            (self.rise_s, -jerk),
            (self.coast_s, 0.0),
            (self.rise_s, -jerk),
            (self.hold_s, 0.0),
            (self.rise_s, jerk),
        ];
        let (mut left, mut here) = (t_s, [0.0; 3]);
        for (length, jerk) in parts {
            let t = left.min(length);
            let [x, v, a] = here;
            here = [x + t * (v + t * (a / 2.0 + t * jerk / 6.0)), v + t * (a + t * jerk / 2.0), a + t * jerk];
            left -= t;
        }
        here
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_move_keeps_its_limits_and_arrives() {
        let long = Moves { stroke_m: 0.25, velocity_m_per_s: 0.3, acceleration_m_per_s2: 2.0, rest_s: 0.2 };
        let short = Moves { stroke_m: 0.01, ..long };
        for moves in [long, short] {
            let move_s = moves.profile().duration_s();
            let all = |place: usize| (0..=1000).map(move |k| moves.at(0.2 + f64::from(k) * 1e-3 * move_s)[place]);
            let most = |place: usize| all(place).fold(0.0, |most: f64, value| most.max(value.abs()));
            assert!((most(2) - 2.0).abs() < 1e-9);
            let velocity = most(1);
            assert!(if moves == long { (velocity - 0.3).abs() < 1e-9 } else { velocity < 0.3 }, "{velocity}");
            let (end, rest) = (moves.at(0.2 + move_s), moves.at(0.3 + move_s));
            for [x, v, _] in [end, rest] {
                assert!((x - moves.stroke_m).abs() < 1e-12 && v.abs() < 1e-9, "{x} {v}");
            }
            for k in 0..3000 {
                let (t, h) = (0.0013 + f64::from(k) * 0.00071, 1e-6);
                let (before, here, after) = (moves.at(t - h), moves.at(t), moves.at(t + h));
                let slope = |place: usize| (after[place] - before[place]) / (2.0 * h);
                assert!((slope(0) - here[1]).abs() < 1e-8 && (slope(1) - here[2]).abs() < 1e-4, "{t}: {here:?}");
            }
            let home = moves.at(2.0 * (0.2 + move_s) + 0.1);
            assert!(home[0].abs() < 1e-12 && home[1].abs() < 1e-9, "{home:?}");
        }
    }
}
