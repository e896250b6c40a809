//! Limits how often a host may write the flash: a flood of saves must not wear it out.
//!
//! After a long pause a device accepts [`SAVES`] at once, then one every two minutes. A factory reset costs as much as
//! [`FACTORY_RESET`] saves, since it erases a whole ring of pages, whereas only one save in seven erases a page
//! ([`store`](crate::store)). So a flood of requests takes longer than a year to use up the flash's 280 000 saves. A
//! restart by command, or by a watchdog reset that a host requested, does not refill the allowance; nor does a visit to
//! update mode by command, provided that the ROM does not overwrite the word that holds it. Other starts refill it.

use embassy_time::{Duration, Instant};

/// Saves that a device accepts at once.
pub const SAVES: u8 = 40;
/// Time after which it accepts one more.
const EACH: Duration = Duration::from_secs(120);
/// Cost of a factory reset, in saves: 280 000 saves wear both rings as much as 20 000 factory resets.
pub const FACTORY_RESET: u8 = 14;

/// The remaining saves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Allowance {
    /// When the full allowance will be available again.
    full_at: Instant,
}

impl Allowance {
    /// The full allowance.
    pub(crate) const FULL: Self = Self { full_at: Instant::MIN };

    /// With this many left now.
    pub(crate) fn with_left(left: u8, now: Instant) -> Self {
        Self { full_at: now + EACH * u32::from(SAVES.saturating_sub(left)) }
    }

    /// Whole saves left.
    pub(crate) fn left(self, now: Instant) -> u8 {
        let spent = self.spent(now).as_ticks().div_ceil(EACH.as_ticks());
        SAVES.saturating_sub(u8::try_from(spent).unwrap_or(u8::MAX))
    }

    /// Takes `saves`, or returns in how many seconds they will be available. Never more than [`SAVES`].
    pub(crate) fn take(&mut self, saves: u8, now: Instant) -> Result<(), u16> {
        let spent = self.spent(now) + EACH * u32::from(saves);
        match spent.checked_sub(EACH * u32::from(SAVES)) {
            Some(missing) if missing > Duration::MIN => {
                let wait_s = missing.as_ticks().div_ceil(embassy_time::TICK_HZ);
                Err(u16::try_from(wait_s).unwrap_or(u16::MAX))
            }
            _ => {
                self.full_at = now + spent;
                Ok(())
            }
        }
    }

    fn spent(self, now: Instant) -> Duration {
        self.full_at.saturating_duration_since(now)
    }
}

#[cfg(test)]
mod tests {
    use super::{Allowance, EACH, FACTORY_RESET, SAVES};
    use embassy_time::{Duration, Instant};

    const NOW: Instant = Instant::from_secs(1_000);

    #[test]
    fn a_flood_gets_the_first_saves_and_then_one_at_a_time() {
        let mut allowance = Allowance::FULL;
        let (mut taken, mut now) = (0, NOW);
        while now < NOW + Duration::from_secs(86_400) {
            taken += u32::from(allowance.take(1, now).is_ok());
            now += Duration::from_millis(700);
        }
        assert_eq!(taken, u32::from(SAVES) + 86_400 / EACH.as_secs() as u32 - 1);
        // 280 000 saves are the endurance of the flash.
        assert!(EACH * 280_000 > Duration::from_secs(365 * 86_400));
    }

    #[test]
    fn a_refusal_tells_when_to_come_back() {
        let mut allowance = Allowance::with_left(0, NOW);
        assert_eq!(allowance.take(1, NOW), Err(120));
        let later = NOW + Duration::from_millis(60_500);
        assert_eq!(allowance.take(1, later), Err(60));
        assert_eq!(allowance.take(FACTORY_RESET, later), Err(60 + 13 * 120));
        assert_eq!(allowance.take(1, later + Duration::from_secs(60)), Ok(()));
    }

    #[test]
    fn what_is_left_outlives_a_restart_and_no_more() {
        let mut allowance = Allowance::FULL;
        assert_eq!(allowance.left(NOW), SAVES);
        for _ in 0..7 {
            allowance.take(1, NOW).unwrap();
        }
        let later = NOW + Duration::from_secs(1);
        assert_eq!(allowance.left(later), SAVES - 7);
        let begun = Instant::from_secs(0);
        assert_eq!(Allowance::with_left(allowance.left(later), begun).left(begun), SAVES - 7);
        assert_eq!(Allowance::with_left(u8::MAX, begun), Allowance { full_at: begun }, "a word that means nothing");
    }
}
