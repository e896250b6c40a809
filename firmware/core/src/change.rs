//! Detects changes of the device itself: a swapped flywheel, a failing lubricant, a changed ratio.
//!
//! Glossary: a *block* is half a second of motion (two seconds in the slow bank, and longer until it is informative),
//! fitted by itself from the growth of the exact sums; the *reference* is the recent memory as it stood three blocks
//! earlier. A block *deviates* in a parameter when it differs from the reference by more than
//!
//! - [`ERRORS`] standard errors of both together,
//! - [`SCATTERS`] times what blocks have deviated by so far, which includes whatever the law leaves out of a real
//!   machine,
//! - a fraction of the value that matters ([`LEAST_PART`]): less is drift, which the memory follows.
//!
//! Two blocks in a row that deviate alike are a change; a knock deviates once. A change is found within three blocks.
//! Both memories then restart, so that no estimate is an average over two devices.
//! Floats, as in `report`: basic arithmetic gives the same bits on every machine.

use crate::active::{Active, Scales};
use crate::bank::BankState;
use crate::constants::UPDATES_PER_BOX;
use crate::detail::{Change, Changed};
use crate::estimate::Bank;
use crate::fit::{Fit, Knowledge, fit};
use crate::ldl::UNKNOWNS;
use crate::math::{magnitude, sqrt};
use crate::rls::PRODUCTS;

/// Length of a block in either bank [boxes]: 0.5 s and 2 s.
const BLOCK_BOXES: u32 = 32;
/// Standard errors within which a block agrees: its own errors come from 15 observations only.
const ERRORS: f32 = 6.0;
/// A block agrees within this many times the usual (rms) deviation of blocks.
const SCATTERS: f32 = 6.0;
/// Least change that matters: fractions of inertance, viscous and Coulomb friction, and for the offset a fraction of
/// Coulomb friction.
const LEAST_PART: [f32; UNKNOWNS] = [0.02, 0.3, 0.1, 0.2];
/// Factor on that fraction until [`EXPERIENCE`] blocks have shown how blocks scatter.
const UNSURE: f32 = 3.0;
/// Blocks after which their scatter is known.
const EXPERIENCE: u16 = 6;
/// Blocks over which the scatter is averaged.
const LONGEST_EXPERIENCE: u16 = 64;
/// A block grows until its standard error is below this many times what matters.
const SHARP: f32 = 2.0;
/// Longest block, in multiples of the least length.
const LONGEST_BLOCK: u32 = 64;
/// Memories kept: the block before last may already be half of another device, so what was learnt from it is not used.
const LAG: usize = 3;

/// The unknowns in their order.
const PARAMETERS: [Changed; UNKNOWNS] = [Changed::Inertance, Changed::Viscous, Changed::Coulomb, Changed::Offset];

/// Watches for changes.
#[derive(Clone, Debug)]
pub(crate) struct Watch {
    bank: Bank,
    /// Sums and updates at the start of this block.
    sums: [i128; PRODUCTS],
    updates: u32,
    /// Updates of this block at which it is next examined.
    next_look: u32,
    /// The memory at the ends of the last blocks, the latest last, and how many there are. All zeros at the start, as
    /// is every part of the state: a board need not fill it from flash.
    references: [Fit; LAG],
    referenced: u8,
    /// Mean square of what blocks deviated by.
    scatter: [f32; UNKNOWNS],
    /// Number of blocks in that mean.
    blocks: u16,
    /// Deviation of the last block, where it was too great to agree.
    suspicion: [f32; UNKNOWNS],
    /// The memories are forgotten with the next update; until then, what they knew of the device before can be read.
    begins_anew: bool,
    /// Changes since the reset.
    pub count: u32,
}

impl Watch {
    /// Nothing seen.
    pub const fn new() -> Self {
        Self {
            bank: Bank::Fast,
            sums: [0; PRODUCTS],
            updates: 0,
            next_look: 0,
            references: [Fit::NONE; LAG],
            referenced: 0,
            scatter: [0.0; UNKNOWNS],
            blocks: 0,
            suspicion: [0.0; UNKNOWNS],
            begins_anew: false,
            count: 0,
        }
    }

    /// Restarts: what came before says nothing about what follows.
    pub fn forget(&mut self) {
        *self = Self { count: self.count, ..Self::new() };
    }

    fn begin_block(&mut self, memories: &BankState) {
        self.sums = *memories.whole.sums();
        self.updates = memories.whole.updates();
        self.next_look = BLOCK_BOXES * UPDATES_PER_BOX;
    }

    /// Compares a block with the reference; returns what changed most, its value before and since.
    fn compare(&mut self, block: &Fit) -> Option<(Changed, f32, f32)> {
        if usize::from(self.referenced) < LAG {
            return None;
        }
        let reference = self.references[0];
        let matters = matters(&reference);
        let mut deviation = [0.0; UNKNOWNS];
        let mut suspicion = [0.0; UNKNOWNS];
        let mut strongest = (1.0, None);
        let sure = if self.blocks < EXPERIENCE { UNSURE } else { 1.0 };
        for i in 0..UNKNOWNS {
            let (new, old) = (block.values[i], reference.values[i]);
            let (new_error, old_error) = (block.errors[i], reference.errors[i]);
            if !new_error.is_finite() || !old_error.is_finite() {
                continue;
            }
            let limit = (ERRORS * sqrt(new_error * new_error + old_error * old_error))
                .max(SCATTERS * sqrt(self.scatter[i]))
                .max(sure * matters[i]);
            deviation[i] = new - old;
            let strength = magnitude(deviation[i]) / limit;
            if strength > 1.0 {
                suspicion[i] = deviation[i];
                if self.suspicion[i] * deviation[i] > 0.0 && strength > strongest.0 {
                    strongest = (strength, Some((PARAMETERS[i], old, new)));
                }
            }
        }
        if strongest.1.is_some() {
            return strongest.1;
        }
        // A suspicion that was not confirmed is part of how this machine scatters.
        self.blocks = (self.blocks + 1).min(LONGEST_EXPERIENCE);
        let alone = core::mem::replace(&mut self.suspicion, suspicion);
        let deviations = deviation.into_iter().zip(suspicion).zip(alone).zip(matters);
        for (scatter, (((deviation, suspicion), alone), matters)) in self.scatter.iter_mut().zip(deviations) {
            let agreed = if suspicion == 0.0 { deviation } else { 0.0 };
            // Limited to what matters: a block across a change must not hide the change.
            let [agreed, alone] = [agreed, alone].map(|value| magnitude(value).min(matters));
            *scatter += (agreed * agreed + alone * alone - *scatter) / f32::from(self.blocks);
        }
        None
    }

    /// Whether a change was found at the last update, so that the memories must be forgotten.
    pub fn begins_anew(&mut self) -> bool {
        let begins_anew = core::mem::take(&mut self.begins_anew);
        if begins_anew {
            self.forget();
        }
        begins_anew
    }

    /// Takes the memories of the published bank after an update; returns a change if the block that ends here shows
    /// one. Estimate and sums are still those of before: the memories restart with the next update.
    pub fn push(&mut self, active: &Active, bank: Bank, memories: &BankState, index: u32) -> Option<Change> {
        let length = memories.whole.updates().wrapping_sub(self.updates);
        let least = BLOCK_BOXES * UPDATES_PER_BOX;
        if self.bank != bank || length > 2 * LONGEST_BLOCK * least {
            self.forget();
            self.bank = bank;
            self.begin_block(memories);
            return None;
        }
        if length < self.next_look {
            return None;
        }
        let config = match bank {
            Bank::Fast => &active.fast,
            Bank::Slow => &active.slow,
        };
        self.look(&config.scales, memories, length).map(|(parameter, before, after)| {
            let structure = match parameter {
                Changed::Inertance => active.settings.structure_mass_kg as f32,
                Changed::Viscous | Changed::Coulomb | Changed::Offset => 0.0,
            };
            self.begins_anew = true;
            self.count = self.count.saturating_add(1);
            Change { index, parameter, before: before - structure, after: after - structure }
        })
    }

    /// Examines the block of `length` updates, and ends it if it is informative.
    #[inline(never)]
    fn look(&mut self, scales: &Scales, memories: &BankState, length: u32) -> Option<(Changed, f32, f32)> {
        let least = BLOCK_BOXES * UPDATES_PER_BOX;
        self.next_look += least;
        let knowledge = Knowledge::between(&self.sums, memories.whole.sums(), length);
        let block = fit(&knowledge, scales)?;
        // A block across the change has a great residual, but must end all the same.
        let usual = self.references[LAG - 1].variance.min(block.variance);
        let part = if usual > 0.0 { sqrt(usual / block.variance) } else { 1.0 };
        if !tells(self.bank, &block, part) && length < LONGEST_BLOCK * least {
            return None;
        }
        let changed = self.compare(&block);
        if changed.is_none() {
            if let Some(memory) = fit(&Knowledge::recent(memories), scales) {
                let [_, second, third] = self.references;
                self.references = [second, third, memory];
                self.referenced = self.referenced.saturating_add(1);
            }
            self.begin_block(memories);
        }
        changed
    }
}

/// Whether the parameter for which a bank is used, inertance or friction, would be known to less than [`SHARP`] times
/// what matters if the errors were `part` of what they are.
fn tells(bank: Bank, fit: &Fit, part: f32) -> bool {
    let ([inertance, _, coulomb, _], [inertance_matters, _, coulomb_matters, _]) = (fit.errors, matters(fit));
    match bank {
        Bank::Fast => inertance * part < SHARP * inertance_matters,
        Bank::Slow => coulomb * part < SHARP * coulomb_matters,
    }
}

/// The least change of each parameter that matters, by the values of `fit`.
fn matters(fit: &Fit) -> [f32; UNKNOWNS] {
    let [inertance, viscous, coulomb, _] = fit.values.map(magnitude);
    let [of_inertance, of_viscous, of_coulomb, of_offset] = LEAST_PART;
    [of_inertance * inertance, of_viscous * viscous, of_coulomb * coulomb, of_offset * coulomb]
}
