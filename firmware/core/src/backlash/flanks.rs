//! The contact's stretch, and which flank each sample touches.
//!
//! The stretch is exact for a force that is linear between samples. A sample is firm when the smoothed force exceeds
//! both an eighth of its peak over the last seconds of motion and the limit of its noise, with and without the
//! estimated offset: what the estimator calls an offset may be a load, and a load that keeps the screw on one flank
//! must not pass for two flanks. Classification waits for the guard: samples within 4 ms (or seven times the lag) of a
//! change are on neither flank.

use crate::qformat::{Term, shift_right};

/// Fraction bits of the stretch.
const FRACTION: u32 = 12;
/// Fraction bits of smoothed force, peak and noise: a force has 25 bits.
const FORCE_BITS: u32 = 5;

/// Greatest magnitude of a force [codes]: it is clamped to this.
const MOST: i32 = (1 << 24) - 1;

/// One sample as it arrives, in the device's own direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Newest {
    /// Sample counter.
    pub index: u32,
    /// Encoder position [codes], wrapping.
    pub position: i32,
    /// Force [codes], its zero subtracted.
    pub force: i32,
    /// Terminal displacement [codes].
    pub terminal: i32,
    /// Whether the force can be trusted.
    pub good: bool,
    /// Whether samples are missing before this one.
    pub broken: bool,
    /// Offset of the force [codes] from the last estimate.
    pub offset: i32,
}

/// Settings of the flanks.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FlankActive {
    /// Fraction of the stretch that is kept from the last sample.
    pub kept: Term,
    /// Stretch [2^-FRACTION units] per code of this sample's force, and of the last one's.
    pub by_force: [Term; 2],
    /// Right shift from position codes to units.
    pub position_shift: i8,
    /// Right shift of the stretch for the memory.
    pub stretch_shift: u8,
    /// Weight of a new force in the smoothed one [2^-16].
    pub smoothing: i32,
    /// Right shifts of the noise's and the peak's memory.
    pub noise_shift: u8,
    pub peak_shift: u8,
    /// Travel [codes] that counts as motion, and the samples for which it does.
    pub travel: u32,
    pub moving: u32,
    /// Samples left out on either side of a change.
    pub guard: u8,
}

impl FlankActive {
    pub const FRACTION: u32 = FRACTION;
    pub const FORCE_BITS: u32 = FORCE_BITS;
}

/// The contact as of the newest sample.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Touch {
    /// Position [units], wrapping.
    pub position: i32,
    /// Position and stretch [units], wrapping.
    pub reach: i32,
    /// Stretch, shifted for the memory.
    pub stretch: i16,
    /// Flank that the sample `guard` ago touches: -1, 0, 1.
    pub classified: i8,
    /// Whether a flank is met at this sample.
    pub landed: bool,
}

/// State of the contact.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Flanks {
    started: bool,
    /// Whether there is a sample before this one, joined or not.
    placed: bool,
    position_code: i32,
    /// Travel since the first sample [codes].
    position: i64,
    stretch: i64,
    forces: [i32; 2],
    smoothed: i32,
    pub noise: i32,
    peak: i32,
    /// Where the screw last was in motion [codes], for how long it still counts as moving, and whether it ever did.
    mark: i32,
    moving: u32,
    has_moved: bool,
    /// Flank of the newest sample before classification, and for how many samples it has been the same.
    side: i8,
    run: u32,
    /// Last flank touched; 0 once the force has vanished since.
    held: i8,
}

impl Flanks {
    /// Nothing seen.
    pub const fn new() -> Self {
        Self {
            started: false,
            placed: false,
            position_code: 0,
            position: 0,
            stretch: 0,
            forces: [0; 2],
            smoothed: 0,
            noise: 0,
            peak: 0,
            mark: 0,
            moving: 0,
            has_moved: false,
            side: 0,
            run: 0,
            held: 0,
        }
    }

    /// Samples are missing: the next sample is not joined to the last.
    pub fn interrupt(&mut self) {
        self.started = false;
        (self.side, self.run) = (0, 0);
    }

    /// Twice the rms of the stretch's noise, as caused by the force's noise [units].
    pub fn stretch_noise(&self, active: &FlankActive) -> u32 {
        let [now, then] = active.by_force;
        let noise = i64::from(self.noise);
        let noise = now.of(noise).saturating_abs().saturating_add(then.of(noise).saturating_abs());
        (noise >> (FRACTION + FORCE_BITS)).clamp(0, 1 << 16) as u32
    }

    /// Takes a sample.
    #[inline]
    pub fn push(&mut self, active: &FlankActive, sample: &Newest) -> Touch {
        let code = sample.force.clamp(-MOST, MOST);
        if !self.started {
            self.started = true;
            if !self.placed {
                (self.placed, self.position_code) = (true, sample.position);
            }
            self.forces = [code; 2];
            self.smoothed = code << FORCE_BITS;
            self.mark = sample.position;
            if !self.has_moved {
                // Before the first motion a force may be an offset, and its noise is not yet known.
                self.noise = code.abs() << FORCE_BITS;
            }
        }
        let travel = sample.position.wrapping_sub(self.position_code);
        self.position_code = sample.position;
        self.position = self.position.wrapping_add(i64::from(travel));
        let position = shift_right(self.position, active.position_shift) as i32;

        let [last, before] = self.forces;
        self.forces = [code, last];
        let [now, then] = active.by_force;
        let by_force = now.of(i64::from(code)).saturating_add(then.of(i64::from(last)));
        self.stretch = active.kept.of(self.stretch).saturating_add(by_force);
        let stretch = self.stretch >> FRACTION;

        let bend = (code - 2 * last + before).abs().min(MOST) << FORCE_BITS;
        self.noise += (bend - self.noise) >> active.noise_shift;
        let force = code << FORCE_BITS;
        self.smoothed += ((i64::from(force - self.smoothed) * i64::from(active.smoothing)) >> 16) as i32;
        // At rest nothing shows how strong a firm contact would be, so the peak does not decay.
        self.moving = self.moving.saturating_sub(1);
        if sample.position.wrapping_sub(self.mark).unsigned_abs() > active.travel {
            (self.mark, self.moving, self.has_moved) = (sample.position, active.moving, true);
        }
        if self.moving > 0 {
            self.peak -= self.peak >> active.peak_shift;
        }
        self.peak = self.peak.max(force.abs() - 2 * self.noise);

        // The mean bend of white noise is 1.95 times its rms.
        let clear = (self.peak >> 3).max(2 * self.noise).max(1 << FORCE_BITS);
        let without_offset = self.smoothed - (sample.offset.clamp(-MOST / 2, MOST / 2) << FORCE_BITS);
        let side = match () {
            () if !sample.good || !self.has_moved => 0,
            () if self.smoothed.min(without_offset) > clear => 1,
            () if self.smoothed.max(without_offset) < -clear => -1,
            () => 0,
        };
        let changed = side != self.side;
        self.run = if changed { 1 } else { self.run.saturating_add(1) };
        self.side = side;
        // A slow force flickers around its limit, and a landing rings: a flank lands again only after the force has
        // vanished.
        let landed = side != 0 && side != self.held;
        if side != 0 {
            self.held = side;
        } else if self.smoothed.abs().min(without_offset.abs()) < (self.peak >> 6).max(self.noise) {
            self.held = 0;
        }
        let firm = self.run > 2 * u32::from(active.guard);
        Touch {
            position,
            reach: position.wrapping_add(stretch as i32),
            stretch: (stretch >> active.stretch_shift).clamp(i64::from(i16::MIN), i64::from(i16::MAX)) as i16,
            classified: if firm { side } else { 0 },
            landed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;
    use inerter_needs::Random;
    use std::vec::Vec;

    const RATE_HZ: f64 = 1000.0;

    /// What is told of each sample, and the flank that it seemed to touch by itself.
    fn told(force: impl Fn(u32) -> i32, offset: i32, count: u32) -> (u32, Vec<(Touch, i8)>) {
        let settings = Settings { sample_rate_hz: RATE_HZ, stiffness_n_per_m: 2e6, ..Settings::default() };
        let active = settings.validate().unwrap().backlash.flanks;
        let mut flanks = Flanks::new();
        let mut touch = |index: u32| {
            let sample = Newest {
                index,
                position: index as i32,
                force: force(index),
                terminal: 0,
                good: true,
                broken: false,
                offset,
            };
            (flanks.push(&active, &sample), flanks.side)
        };
        (u32::from(active.guard), (0..count).map(&mut touch).collect())
    }

    /// A sample touches a flank for certain if all within the guard on either side of it do.
    #[test]
    fn a_sample_is_firm_with_all_within_the_guard() {
        // Flanks of 5 to 18 samples, with flights of 1 to 6.
        let force = |n: u32| {
            let (turn, within) = (n / 24, n % 24);
            let sign = if turn.is_multiple_of(2) { 1 } else { -1 };
            if within < 5 + turn % 14 || within >= 10 + turn % 14 { sign * 40_000 } else { 0 }
        };
        let (guard, told) = told(force, 0, 3000);
        assert_eq!(guard, 4);
        let mut firm = [0, 0, 0];
        for n in 100..told.len() {
            let around = &told[n - 2 * guard as usize..=n];
            let sides = around.iter().map(|(_, side)| *side);
            let side = around[0].1;
            let wanted = if sides.clone().all(|each| each == side) { side } else { 0 };
            assert_eq!(told[n].0.classified, wanted, "{n}");
            firm[(wanted + 1) as usize] += 1;
        }
        assert!(firm.iter().all(|count| *count > 100), "{firm:?}");
    }

    /// Touched is what exceeds an eighth of the peak, and landed on what has been left until under a 64th of it.
    #[test]
    fn a_flank_is_touched_beyond_an_eighth_of_the_peak_and_left_under_a_64th() {
        for (low, touches, lands_again) in
            [(1.0 / 7.0, true, false), (1.0 / 9.0, false, false), (1.0 / 40.0, false, false), (1.0 / 90.0, false, true)]
        {
            for sign in [1, -1] {
                // Ten times a second to its least and back: in between the peak forgets a twentieth.
                let force = |n: u32| {
                    let wave = 0.5 + 0.5 * (core::f64::consts::TAU * f64::from(n) / 100.0).cos();
                    let part = if n < 1000 { 1.0 } else { low + (1.0 - low) * wave };
                    sign * (1e6 * part) as i32
                };
                let (_, told) = told(force, 0, 4000);
                let side = sign as i8;
                let landings = told.iter().skip(1000).filter(|(touch, _)| touch.landed).count();
                assert_eq!(landings, if lands_again { 30 } else { 0 }, "{low} {sign}");
                for n in (1050..4000).step_by(100) {
                    assert_eq!([told[n].1, told[n + 45].1], [if touches { side } else { 0 }, side], "{low} {sign} {n}");
                }
                // What may be an offset is no flank by itself.
                let (_, offset) = self::told(force, sign * 2_000_000, 4000);
                assert!(offset.iter().all(|(touch, _)| touch.classified != side), "{low} {sign}");
            }
        }
    }

    fn active() -> FlankActive {
        let settings = Settings { sample_rate_hz: RATE_HZ, stiffness_n_per_m: 2e6, ..Settings::default() };
        settings.validate().unwrap().backlash.flanks
    }

    fn newest(index: u32, position: i32, force: i32) -> Newest {
        Newest { index, position, force, terminal: 0, good: true, broken: false, offset: 0 }
    }

    /// Before the first motion a force may be an offset, and counts as noise. The noise has an eighth of a second of
    /// memory, 64 samples: after 64 ln 2 of them half of it is forgotten, and the force exceeds twice of what is left.
    #[test]
    fn a_first_force_is_noise_until_half_of_it_is_forgotten() {
        for sign in [1_i8, -1] {
            let (_, told) = told(|_| i32::from(sign) * 40_000, 0, 200);
            let first = told.iter().position(|(_, side)| *side != 0).unwrap();
            assert!((43..=46).contains(&first), "{first}");
            assert!(told[first..].iter().all(|(_, side)| *side == sign), "{sign}");
        }
    }

    /// A force of one code touches nothing, one of two does.
    #[test]
    fn a_force_within_a_code_touches_nothing() {
        for (code, wanted) in [(1, 0), (-1, 0), (2, 1), (-2, -1)] {
            let (_, told) = told(|_| code, 0, 400);
            assert!(told[200..].iter().all(|(_, side)| *side == wanted), "{code}");
        }
    }

    /// Motion is more than 8 counts of travel; before it, no flank is touched.
    #[test]
    fn no_flank_is_touched_before_the_first_motion() {
        let active = active();
        for (travel, moves) in [(8, false), (-8, false), (9, true), (-9, true)] {
            let mut flanks = Flanks::new();
            for index in 0..300 {
                let position = 12_345 + if index % 2 == 0 { 0 } else { travel };
                flanks.push(&active, &newest(index, position, 40_000));
            }
            assert_eq!(flanks.side, i8::from(moves), "{travel}");
        }
    }

    /// After missing samples a flank is touched at once, beyond an eighth of the old peak, and firm after the guard on
    /// both sides. The force's jump in between is no noise. A sample that cannot be trusted touches nothing.
    #[test]
    fn a_flank_is_met_again_after_missing_samples() {
        let active = active();
        let mut flanks = Flanks::new();
        for index in 0..1200 {
            if index == 1000 {
                flanks.interrupt();
            }
            let force = if index < 1000 { 40_000 } else { -6000 };
            let noise = flanks.noise;
            let sample = Newest { good: index != 1100, ..newest(index, index as i32, force) };
            let touch = flanks.push(&active, &sample);
            assert!(index == 0 || flanks.noise <= noise, "{index}");
            if index < 100 {
                continue;
            }
            let (side, firm) = match index {
                ..1000 => (1, true),
                1000..1008 => (-1, false),
                1100 => (0, false),
                1101..1109 => (-1, false),
                _ => (-1, true),
            };
            assert_eq!((flanks.side, touch.classified), (side, if firm { side } else { 0 }), "{index}");
        }
    }

    /// A force that is gone touches for two more samples: the time constant is one, and `e^-2` exceeds an eighth.
    #[test]
    fn the_force_is_smoothed_over_a_millisecond() {
        for sign in [1_i8, -1] {
            let (_, told) = told(|n| if n < 1000 { i32::from(sign) * 1_000_000 } else { 0 }, 0, 1010);
            let sides: Vec<i8> = told[999..1004].iter().map(|(_, side)| *side).collect();
            assert_eq!(sides, [sign, sign, sign, 0, 0]);
        }
    }

    /// In motion the peak is forgotten over 1024 samples, so that a twelfth of it touches after `1024 ln(12 / 8)`. At
    /// rest it is not, but for the quarter of a second that still counts as motion.
    #[test]
    fn the_peak_is_forgotten_in_motion_alone() {
        let active = active();
        for rests in [true, false] {
            let mut flanks = Flanks::new();
            for index in 0..8000_u32 {
                let position = index.min(if rests { 1000 } else { 8000 }) as i32;
                let force = if index < 1000 { 1_200_000 } else { 100_000 };
                flanks.push(&active, &newest(index, position, force));
                match index {
                    1010..1390 => assert_eq!(flanks.side, 0, "{index}"),
                    1450.. => assert_eq!(flanks.side, i8::from(!rests), "{index}"),
                    _ => (),
                }
            }
        }
    }

    /// A force that alternates by `a` around `F` bends by `4 a`. Its peak is `F + a` less twice that, and only a force
    /// of more than twice that touches.
    #[test]
    fn the_noise_is_the_bend_and_lowers_the_peak() {
        let active = active();
        let after = |force: i32, by: i32| {
            let mut flanks = Flanks::new();
            for index in 0..4001 {
                let code = force + if index % 2 == 0 { by } else { -by };
                flanks.push(&active, &newest(index, index as i32, code));
            }
            (flanks.noise, flanks.peak, flanks.side)
        };
        assert_eq!(after(1_000_000, 10_000), (40_000 << 5, 930_000 << 5, 1));
        assert_eq!(after(1_000_000, 100_000).2, 1);
        assert_eq!(after(1_000_000, 150_000).2, 0);
    }

    /// White noise bends by 1.954 times its rms, on the mean of its magnitude.
    #[test]
    fn white_noise_is_known_by_its_bend() {
        let active = active();
        let mut random = Random(9);
        let (mut flanks, mut sum) = (Flanks::new(), 0.0);
        for index in 0..21_000 {
            flanks.push(&active, &newest(index, index as i32, (500.0 * random.normal()) as i32));
            sum += if index < 1000 { 0.0 } else { f64::from(flanks.noise) / 32.0 };
        }
        let ratio = sum / 20_000.0 / 500.0;
        assert!((ratio / 1.954 - 1.0).abs() < 0.03, "{ratio}");
    }

    /// The stretch's noise is the force's over the stiffness, by the magnitudes of its two weights: all of it without a
    /// lag, `1 - e^(-1 / lag)` with one of 0.57 samples, and 1.6 times it with a lead of 0.3.
    #[test]
    fn the_stretchs_noise_is_the_forces() {
        for (contact_damping_n_s_per_m, skew_s, part) in
            [(0.0, 0.0, 1.0), (1140.0, 0.0, 1.0 - (-1.0 / 0.57_f64).exp()), (0.0, 3e-4, 1.6)]
        {
            let settings =
                Settings { stiffness_n_per_m: 2e6, contact_damping_n_s_per_m, skew_s, ..Settings::default() };
            let backlash = settings.validate().unwrap().backlash;
            let units = 20_000.0 * settings.newtons_per_code / 2e6 / f64::from(backlash.unit_m);
            let of = |noise: i32| Flanks { noise, ..Flanks::new() }.stretch_noise(&backlash.flanks);
            assert!((f64::from(of(20_000 << 5)) - units * part).abs() < 2.0, "{part}");
            assert_eq!((of(0), of(i32::MAX)), (0, 1 << 16), "{part}");
        }
    }
}
