//! All that changes from sample to sample.

use crate::active::{Active, BankActive};
use crate::alignment::Alignment;
use crate::backlash::state::BacklashState;
use crate::bank::BankState;
use crate::change::Watch;
use crate::estimate::Bank;
use crate::feedback::Feedback;
use crate::gate::Rest;
use crate::kernel::Cascades;
use crate::line::DelayLine;
use crate::noise::Noise;
use crate::plausible::Plausible;
use crate::repeats::Repeats;
use crate::sign::{Sign, VelocityReversals};
use crate::trial::Trial;

/// What has been counted since the reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Samples taken.
    pub samples: u64,
    /// Jumps of the sample counter.
    pub discontinuities: u32,
    /// Samples that the jumps skipped.
    pub lost_samples: u64,
    /// Samples with a saturated force, and kernel outputs beyond full scale.
    pub saturated: u32,
}

/// All that changes from sample to sample.
#[derive(Clone, Debug)]
pub struct State {
    pub(crate) counters: Counters,
    pub(crate) plausible: Plausible,
    pub(crate) alignment: Alignment,
    pub(crate) line: DelayLine,
    pub(crate) rest: Rest,
    pub(crate) sign: Sign,
    pub(crate) velocity_reversals: VelocityReversals,
    pub(crate) cascades: Cascades,
    /// Consecutive good samples that have entered the cascades.
    pub(crate) good_samples: u32,
    pub(crate) noise: Noise,
    pub(crate) fast: BankState,
    pub(crate) slow: BankState,
    pub(crate) feedback: Feedback,
    pub(crate) backlash: BacklashState,
    pub(crate) watch: Watch,
    /// Bank of the last estimate.
    pub(crate) published: Bank,
    /// How far the law has been judged.
    pub(crate) trial: Trial,
    pub(crate) until_publish: u32,
    pub(crate) repeats: Repeats,
}

impl Default for State {
    fn default() -> Self {
        Self::empty()
    }
}

impl State {
    /// A state that has seen nothing and belongs to no settings yet: [`reset`](Self::reset) it before the first step.
    ///
    /// Constant, so that a `static` can hold it without using stack.
    pub const fn empty() -> Self {
        Self {
            counters: Counters { samples: 0, discontinuities: 0, lost_samples: 0, saturated: 0 },
            plausible: Plausible::new(),
            alignment: Alignment::new(),
            line: DelayLine::new(),
            rest: Rest::new(),
            sign: Sign::new(),
            velocity_reversals: VelocityReversals::new(),
            repeats: Repeats::new(),
            cascades: Cascades::new(),
            good_samples: 0,
            noise: Noise::new(),
            fast: BankState::new(),
            slow: BankState::new(),
            feedback: Feedback::NONE,
            backlash: BacklashState::new(),
            watch: Watch::new(),
            published: Bank::Fast,
            trial: Trial::Ahead,
            until_publish: 0,
        }
    }

    /// A state that has seen nothing.
    pub fn new(active: &Active) -> Self {
        let mut state = Self::empty();
        state.until_publish = active.signal.publish_samples;
        state
    }

    /// Forgets everything, in place.
    pub fn reset(&mut self, active: &Active) {
        let Self {
            counters,
            plausible,
            // Begins anew at the first sample.
            alignment: _,
            line,
            rest,
            sign,
            velocity_reversals,
            repeats,
            cascades,
            good_samples,
            noise,
            fast,
            slow,
            feedback,
            backlash,
            watch,
            published,
            trial,
            until_publish,
        } = self;
        *counters = Counters::default();
        *plausible = Plausible::new();
        line.reset();
        *rest = Rest::new();
        *sign = Sign::new();
        *velocity_reversals = VelocityReversals::new();
        repeats.reset();
        *cascades = Cascades::new();
        *good_samples = 0;
        *noise = Noise::new();
        fast.reset();
        slow.reset();
        *feedback = Feedback::NONE;
        backlash.reset();
        *watch = Watch::new();
        *published = Bank::Fast;
        *trial = Trial::Ahead;
        *until_publish = active.signal.publish_samples;
    }

    /// What has been counted since the reset.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// Index of the latest sample.
    pub fn last_index(&self) -> u32 {
        self.line.last_index
    }
}

impl Active {
    /// The configuration and state of a bank.
    pub(crate) fn bank<'a>(&'a self, state: &'a State, bank: Bank) -> (&'a BankActive, &'a BankState) {
        match bank {
            Bank::Fast => (&self.fast, &state.fast),
            Bank::Slow => (&self.slow, &state.slow),
        }
    }
}
