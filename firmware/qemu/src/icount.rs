//! Counting instructions.
//!
//! With `-icount shift=S` QEMU's time advances by 2^S ns per instruction, so SysTick, at 168 MHz, counts instructions:
//! `0.168 * 2^S` ticks each, and exactly the same from run to run. The ratio is not assumed but measured on a series
//! of `nop`. `shift=6` gives 10.75 ticks an instruction and 1.5 million instructions between two wraps of the counter.
//!
//! A tone of 3.2 Hz and one of 15.9 Hz with friction and noise go through core at two sample rates. The result is one
//! line of JSON on standard output; all counts are instructions:
//!
//! - `step`: one ordinary sample. `publish`: a sample that publishes, including all that an ordinary one does.
//! - `contact`: one ordinary sample with both routes of the backlash at work. `reversal`: cost of an accepted reversal
//!   in the force's route, all passes over its flanks together: the same samples with a stiffness, less those without,
//!   divided by the accepted reversals.
//! - `solve`: what publishing adds, `publish` less `step` on average. `estimate`: `Active::publish` by itself: three
//!   solutions (recent, its part away from rest, whole run) with their intervals, and what goes with them.
//! - `state_bytes`, `active_bytes`, `app_bytes`: memory. `stack_used_bytes`: stack of this mode alone.

use crate::{semihosting, stack};
use core::fmt;
use core::hint::black_box;
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use inerter_app::App;
use inerter_core::{Active, RawSample, Route, Settings, State};

/// Width of SysTick's counter.
const COUNTER_MASK: u32 = 0x00FF_FFFF;
/// Seconds of signal per sample rate: enough for both banks to settle and to publish often.
const SECONDS: u32 = 20;
const RATES_HZ: [u32; 2] = [1_000, 4_000];

/// Ticks that a call took, less those of an empty one.
struct Meter {
    empty_ticks: u32,
    ticks_per_1000: u32,
}

impl Meter {
    fn new(mut systick: SYST) -> Self {
        systick.set_clock_source(SystClkSource::Core);
        systick.set_reload(COUNTER_MASK);
        systick.clear_current();
        systick.enable_counter();
        let (_, empty_ticks) = time(|| ());
        let (_, with_nops) = time(thousand_nops);
        let (_, with_twice) = time(|| {
            thousand_nops();
            thousand_nops();
        });
        // The difference is a thousand and nothing else.
        Self { empty_ticks, ticks_per_1000: with_twice.wrapping_sub(with_nops).max(1) }
    }

    fn count<R>(&self, act: impl FnOnce() -> R) -> (R, u32) {
        let (result, ticks) = time(act);
        let ticks = u64::from(ticks.saturating_sub(self.empty_ticks));
        let per_1000 = u64::from(self.ticks_per_1000);
        (result, ((ticks * 1_000 + per_1000 / 2) / per_1000) as u32)
    }
}

#[inline(always)]
fn time<R>(act: impl FnOnce() -> R) -> (R, u32) {
    let before = SYST::get_current();
    let result = act();
    let after = SYST::get_current();
    (result, before.wrapping_sub(after) & COUNTER_MASK)
}

#[inline(always)]
fn thousand_nops() {
    // SAFETY: does nothing, a thousand times.
    unsafe { core::arch::asm!(".rept 1000", "nop", ".endr", options(nomem, nostack, preserves_flags)) }
}

/// Least, greatest and mean of counts.
#[derive(Clone, Copy)]
struct Tally {
    count: u32,
    sum: u64,
    min: u32,
    max: u32,
}

impl Tally {
    const EMPTY: Self = Self { count: 0, sum: 0, min: u32::MAX, max: 0 };

    fn add(&mut self, instructions: u32) {
        self.count += 1;
        self.sum += u64::from(instructions);
        self.min = self.min.min(instructions);
        self.max = self.max.max(instructions);
    }

    fn mean(&self) -> u32 {
        let count = u64::from(self.count.max(1));
        ((self.sum + count / 2) / count) as u32
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { count, min, max, .. } = self;
        write!(f, r#"{{"count":{count},"min":{min},"mean":{},"max":{max}}}"#, self.mean())
    }
}

/// A tone in integers: a point on a circle, turned a little at every sample.
struct Tone {
    /// Turn per sample [2^-24 rad].
    turn: i64,
    /// Amplitude times cosine and sine [2^-16].
    x: i64,
    y: i64,
}

impl Tone {
    /// `microradians` of turn per sample, `amplitude` in whole units.
    fn new(microradians: i64, amplitude: i64) -> Self {
        Self { turn: (microradians << 24) / 1_000_000, x: 0, y: amplitude << 16 }
    }

    /// Displacement, then its rate in the same unit per radian.
    fn next(&mut self) -> (i32, i32) {
        self.x += (self.y * self.turn) >> 24;
        self.y -= (self.x * self.turn) >> 24;
        ((self.x >> 16) as i32, (self.y >> 16) as i32)
    }
}

/// The signal: 300 kg with 50 N of friction at the default scales, 2.44 um and 2 mN.
struct Signal {
    slow: Tone,
    fast: Tone,
    noise: u32,
    index: u32,
}

impl Signal {
    fn new(rate_hz: u32) -> Self {
        // 3.2 Hz and 4.16 mm, 15.9 Hz and 0.08 mm.
        let per_second = |microradians: i64| microradians / i64::from(rate_hz);
        Self {
            slow: Tone::new(per_second(20_106_193), 1_704),
            fast: Tone::new(per_second(99_902_647), 33),
            noise: 1,
            index: 0,
        }
    }

    fn next(&mut self) -> RawSample {
        let (slow, slow_rate) = self.slow.next();
        let (fast, fast_rate) = self.fast.next();
        // Force codes per count: 300 kg * (2 pi f)^2 * 2.44 um / 2 mN, and friction along the velocity.
        let inertial = -148 * slow - 3_655 * fast;
        let friction = 25_000 * (slow_rate * 20 + fast_rate * 100).signum();
        self.noise = self.noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let noise = (self.noise >> 22) as i32 - 512;
        let index = self.index;
        self.index += 1;
        let force_code = inertial + friction + noise;
        let position_count = slow + fast;
        // In 0.1 um: 2.44 um a count, 2 mN on 2.1e6 N/m, and half of 100 um of backlash.
        let terminal_code = position_count * 24 + force_code / 105 + 500 * force_code.signum();
        RawSample { index, position_count, force_code, terminal_code }
    }
}

struct Result {
    step: Tally,
    publish: Tally,
    estimate: Tally,
    /// Accepted reversals.
    reversals: u32,
}

impl Result {
    /// Instructions of all samples.
    fn total(&self) -> u64 {
        self.step.sum + self.publish.sum
    }
}

/// One sample rate: without the backlash, and with both routes.
struct Rate {
    plain: Result,
    contact: Result,
    reversal: u64,
}

fn measure(meter: &Meter, active: &Active, state: &mut State, rate_hz: u32) -> Result {
    let mut signal = Signal::new(rate_hz);
    let mut result = Result { step: Tally::EMPTY, publish: Tally::EMPTY, estimate: Tally::EMPTY, reversals: 0 };
    for _ in 0..SECONDS * rate_hz {
        let sample = black_box(signal.next());
        let (output, instructions) = meter.count(|| black_box(active.step(state, &sample)));
        if output.published.is_some() {
            result.publish.add(instructions);
            let (_, instructions) = meter.count(|| black_box(active.publish(state)));
            result.estimate.add(instructions);
        } else {
            result.step.add(instructions);
        }
        result.reversals += u32::from(output.reversal.is_some_and(|reversal| reversal.route == Route::Force));
    }
    result
}

fn measure_rate(meter: &Meter, state: &mut State, rate_hz: u32) -> Rate {
    let plain = Settings { sample_rate_hz: f64::from(rate_hz), ..Settings::default() };
    let sensed = Settings { terminal_sensor: true, ..plain };
    let both = Settings { stiffness_n_per_m: 2.1e6, contact_damping_n_s_per_m: 1200.0, ..sensed };
    let [plain, sensed, contact] = [plain, sensed, both].map(|settings| match settings.validate() {
        Ok(active) => {
            state.reset(&active);
            measure(meter, &active, state, rate_hz)
        }
        Err(_) => panic!("the settings of the measurement are not valid"),
    });
    let reversal = contact.total().saturating_sub(sensed.total()) / u64::from(contact.reversals.max(1));
    Rate { plain, contact, reversal }
}

/// Measures and prints.
#[inline(never)]
pub fn run(systick: SYST, state: &mut State) {
    let meter = Meter::new(systick);
    let mut results = [None, None];
    for (place, rate_hz) in results.iter_mut().zip(RATES_HZ) {
        *place = Some(measure_rate(&meter, state, rate_hz));
    }
    let rates = RATES_HZ.iter().zip(&results).filter_map(|(rate_hz, result)| result.as_ref().map(|r| (*rate_hz, r)));
    semihosting::print(format_args!(
        r#"{{"kind":"icount","ticks_per_1000_instructions":{},"rates":[{}],"state_bytes":{},"active_bytes":{},"app_bytes":{},"stack_used_bytes":{},"stack_bytes":{}}}"#,
        meter.ticks_per_1000,
        Rates(rates),
        size_of::<State>(),
        size_of::<Active>(),
        size_of::<App>(),
        stack::total_bytes() - stack::free_bytes(),
        stack::total_bytes(),
    ));
}

/// Objects, with commas between them.
struct Rates<I>(I);

impl<'a, I: Iterator<Item = (u32, &'a Rate)> + Clone> fmt::Display for Rates<I> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, (rate_hz, Rate { plain, contact, reversal })) in self.0.clone().enumerate() {
            let comma = if place > 0 { "," } else { "" };
            let Result { step, publish, estimate, .. } = plain;
            let solve = publish.mean().saturating_sub(step.mean());
            write!(
                f,
                r#"{comma}{{"sample_rate_hz":{rate_hz},"step":{step},"publish":{publish},"solve":{solve},"estimate":{estimate},"contact":{},"reversal":{reversal},"reversals":{}}}"#,
                contact.step, contact.reversals
            )?;
        }
        Ok(())
    }
}
