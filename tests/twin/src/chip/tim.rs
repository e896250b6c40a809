//! Timers with capture and compare: TIM1 to TIM5, TIM8, TIM15 to TIM17 (RM0440 sections 28 to 30).
//!
//! Modelled: up-counting with prescaler and preload, compare flags, the update flag and its sources, encoder modes,
//! input capture, capture of LSI by TIM5 with the input prescaler, and PWM as far as frequency and duty cycle. Refused:
//! down-counting and centre-aligned modes, slave modes other than the encoder modes, one-pulse mode, DMA.
//!
//! Glossary: *tick*: a clock of the counter, after the prescaler. *Update*: the counter restarts.

use super::rcc::LSI_HZ;
use crate::registers::{refuse, refuse_if};
use crate::{Cycles, Modelled, Registers, Storage, Width, chip::clocks::Clocks};

registers! { u32:
    CR1 0x00 { CEN 0, UDIS 1, URS 2, DIR 4, ARPE 7, UIFREMAP 11 },
    CR2 0x04,
    SMCR 0x08,
    DIER 0x0c,
    // Update; the same bit in DIER. Compare 1 to 4 are the next bits.
    SR 0x10 { UIF 0 },
    EGR 0x14,
    CCMR1 0x18,
    CCMR2 0x1c,
    CCER 0x20,
    CNT 0x24,
    PSC 0x28,
    ARR 0x2c,
    RCR 0x30,
    CCR1 0x34,
    CCR2 0x38,
    CCR3 0x3c,
    CCR4 0x40,
    // Main output enable, for timers with a break input.
    BDTR 0x44 { MOE 15 },
    TISEL 0x5c,
    AF1 0x60,
    AF2 0x64,
}

/// TISEL of TIM5: LSI.
const LSI: u32 = 1;

/// CR1 bits that the model implements: CEN, UDIS, URS, DIR, ARPE, CKD, UIFREMAP.
const CR1_KNOWN: u32 = CEN | UDIS | URS | DIR | ARPE | 3 << 8 | UIFREMAP;

/// The kind of a timer, which gives its bus and its features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// 32 bits, four channels: TIM2, TIM5.
    Wide,
    /// 16 bits, four channels: TIM3, TIM4.
    General,
    /// 16 bits, four channels, break input, on APB2: TIM1, TIM8.
    Advanced,
    /// 16 bits, two channels, break input, on APB2: TIM15.
    Small,
    /// 16 bits, one channel, break input, on APB2: TIM16, TIM17.
    Single,
}

impl Kind {
    fn channels(self) -> usize {
        match self {
            Self::Wide | Self::General | Self::Advanced => 4,
            Self::Small => 2,
            Self::Single => 1,
        }
    }

    /// Whether it has a break input and is clocked by APB2.
    fn has_break(self) -> bool {
        matches!(self, Self::Advanced | Self::Small | Self::Single)
    }
}

/// Output of a PWM channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pwm {
    /// PWM frequency \[Hz\].
    pub frequency_hz: f64,
    /// Duty cycle: fraction of the time that the output is high.
    pub duty: f64,
}

/// One timer.
#[derive(Clone, Debug)]
pub struct Tim {
    kind: Kind,
    storage: Storage,
    flags: u32,
    /// The counter value.
    pub count: u32,
    /// Active prescaler and period (shadow registers), which an update loads from the registers.
    prescaler: u32,
    period: u32,
    /// Core cycles per timer clock.
    cycles_per_clock: u64,
    clock_hz: f64,
    /// Time up to which the counter is valid, and timer clocks since its last tick.
    since: Cycles,
    remainder: u64,
    /// The encoder position when its edges were last counted.
    encoder: u32,
    /// Whether channel 1 can capture LSI: TIM5 (RM0440 table 294).
    takes_lsi: bool,
    hclk_hz: f64,
    /// The next edge of LSI \[cycles\], and the number of edges since the last capture.
    lsi_edge: f64,
    lsi_edges: u32,
}

impl Tim {
    /// A timer after reset.
    pub fn new(kind: Kind) -> Self {
        let mask = if kind == Kind::Wide { u32::MAX } else { 0xffff };
        // CR2, SMCR, DIER, CCMR1, CCER.
        let [cr2, smcr, dier, ccmr1, ccer] = match kind {
            Kind::Wide | Kind::General => [0x0200_00f8, 0x0331_fff7, 0x5f5f, 0x0101_ffff, 0xbbbb],
            Kind::Advanced => [0x02f5_fffd, 0x0331_ffff, 0x5f5f, 0x0101_ffff, 0x33_ffff],
            Kind::Small => [0x0200_07fd, 0x0131_00f7, 0x4747, 0x0101_ffff, 0xbf],
            Kind::Single => [0x30d, 0, 0x0303, 0x0001_00ff, 0xf],
        };
        let mut shared = vec![(CR1, 0, CR1_KNOWN), (CR2, 0, cr2), (DIER, 0, dier), (CCMR1, 0, ccmr1), (CCER, 0, ccer)];
        let mut others = vec![
            (PSC, 0, 0xffff),
            (ARR, mask, mask),
            (CCR1, 0, mask),
            // TISEL: other inputs than the pins are refused in `write`, except LSI.
            (TISEL, 0, if kind == Kind::Wide { 0xf } else { 0 }),
        ];
        if kind != Kind::Single {
            shared.push((SMCR, 0, smcr));
            others.push((CCR2, 0, mask));
        }
        if kind.channels() == 4 {
            shared.push((CCMR2, 0, ccmr1));
            others.extend([(CCR3, 0, mask), (CCR4, 0, mask)]);
        }
        if kind.has_break() {
            // No repetition counter; the break input at the pin is enabled after reset.
            let bdtr = if kind == Kind::Advanced { 0x3fff_ffff } else { 0x140f_ffff };
            let second = u32::from(kind == Kind::Advanced);
            shared.push((BDTR, 0, bdtr));
            others.extend([(RCR, 0, 0), (AF1, 1, 0xf), (AF2, second, 0xf * second)]);
        } else {
            others.extend([(AF1, 0, 0), (AF2, 0, 0)]);
        }
        Self {
            kind,
            storage: Storage::shared(&shared).and(Storage::new(&others)),
            flags: 0,
            count: 0,
            prescaler: 0,
            period: mask,
            cycles_per_clock: 1,
            clock_hz: 16e6,
            since: 0,
            remainder: 0,
            encoder: 0,
            takes_lsi: false,
            hclk_hz: 16e6,
            lsi_edge: 0.0,
            lsi_edges: 0,
        }
    }

    /// The same timer with LSI available on channel 1.
    pub fn with_lsi(self) -> Self {
        Self { takes_lsi: true, ..self }
    }

    /// Captures the edges of LSI up to `now`, one in as many as the input prescaler sets.
    fn capture_lsi(&mut self, now: Cycles) {
        let enabled = self.storage[CCER] & 1 != 0 && self.channel_mode(1) & 3 == 1;
        if self.storage[TISEL] & 0xf != LSI || !enabled {
            return;
        }
        while self.lsi_edge <= now as f64 {
            let at = self.lsi_edge.ceil() as Cycles;
            self.lsi_edge += self.hclk_hz / LSI_HZ;
            self.lsi_edges += 1;
            if self.lsi_edges >= 1 << (self.channel_mode(1) >> 2 & 3) {
                self.lsi_edges = 0;
                self.count_to(at);
                self.edge(1, true);
            }
        }
    }

    /// Advances the counter to `now`.
    fn count_to(&mut self, now: Cycles) {
        let elapsed = now.saturating_sub(self.since) + self.remainder;
        self.since = self.since.max(now);
        if !self.counting() {
            self.remainder = 0;
            return;
        }
        let mut ticks = elapsed / self.cycles_per_tick();
        self.remainder = elapsed % self.cycles_per_tick();
        // First up to the next update, which may change prescaler and period; then the rest.
        let until_update = self.round().saturating_sub(u64::from(self.count)).max(1);
        if ticks >= until_update {
            self.pass(until_update);
            ticks -= until_update;
            if self.storage[CR1] & UDIS == 0 {
                let left = ticks * self.cycles_per_tick() + self.remainder;
                self.update();
                self.flags |= UIF;
                ticks = left / self.cycles_per_tick();
                self.remainder = left % self.cycles_per_tick();
            }
        }
        self.pass(ticks);
    }

    fn mask(&self) -> u32 {
        if self.kind == Kind::Wide { u32::MAX } else { 0xffff }
    }

    /// In an encoder mode, the number of edges counted of the four per encoder period; none in other modes.
    fn encoder_edges(&self) -> Option<u32> {
        if self.kind == Kind::Single {
            return None;
        }
        match self.storage[SMCR] & 0x1_0007 {
            1 | 2 => Some(2),
            3 => Some(4),
            _ => None,
        }
    }

    fn counting(&self) -> bool {
        self.storage[CR1] & CEN != 0 && self.encoder_edges().is_none()
    }

    /// Ticks of a full counter period.
    fn round(&self) -> u64 {
        u64::from(self.period) + 1
    }

    fn cycles_per_tick(&self) -> u64 {
        (u64::from(self.prescaler) + 1) * self.cycles_per_clock
    }

    /// Ticks until the counter next has this value, at least one.
    fn ticks_until(&self, value: u32) -> Option<u64> {
        let (round, value) = (self.round(), u64::from(value));
        if value >= round {
            return None;
        }
        let count = u64::from(self.count) % round;
        Some(if value > count { value - count } else { value + round - count })
    }

    fn ccr(channel: usize) -> u32 {
        CCR1 + 4 * (channel as u32 - 1)
    }

    /// Mode bits of a channel: CCxS in bits 0..1, OCxM in 4..6 and 16.
    fn channel_mode(&self, channel: usize) -> u32 {
        let register = if channel <= 2 { CCMR1 } else { CCMR2 };
        self.storage[register] >> (8 * ((channel - 1) % 2))
    }

    fn is_input(&self, channel: usize) -> bool {
        self.channel_mode(channel) & 3 != 0
    }

    /// Advances the counter by this many ticks with the active prescaler and period.
    fn pass(&mut self, ticks: u64) {
        for channel in 1..=self.kind.channels() {
            let reached = self.ticks_until(self.storage[Self::ccr(channel)]).is_some_and(|until| until <= ticks);
            if reached && !self.is_input(channel) {
                self.flags |= 1 << channel;
            }
        }
        let count = u64::from(self.count) + ticks;
        self.count = if count < self.round() { count as u32 } else { ((count - self.round()) % self.round()) as u32 };
    }

    fn update(&mut self) {
        self.prescaler = self.storage[PSC];
        self.period = self.storage[ARR];
    }

    /// Sets the position of the external encoder in edges (four per period, wrapping).
    pub fn set_encoder(&mut self, edges: u32) {
        let moved = edges.wrapping_sub(self.encoder) as i32;
        let Some(counted) = self.encoder_edges() else {
            self.encoder = edges;
            return;
        };
        let per_count = 4 / counted as i32;
        let steps = moved / per_count;
        if self.storage[CR1] & CEN == 0 {
            self.encoder = edges;
            return;
        }
        if steps == 0 {
            return;
        }
        self.encoder = self.encoder.wrapping_add((steps * per_count) as u32);
        // Each inverted input reverses the count direction.
        let inverted = (self.storage[CCER] >> 1 ^ self.storage[CCER] >> 5) & 1 != 0;
        let steps = i64::from(if inverted { -steps } else { steps });
        let unwrapped = i64::from(self.count) + steps;
        self.count = unwrapped.rem_euclid(self.round() as i64) as u32;
        if unwrapped != i64::from(self.count) {
            self.flags |= UIF;
        }
        let cr1 = self.storage[CR1];
        self.storage[CR1] = if steps < 0 { cr1 | DIR } else { cr1 & !DIR };
    }

    /// The input of a channel has an edge. A channel that captures this edge stores the counter value.
    pub fn edge(&mut self, channel: usize, rising: bool) {
        let enable = self.storage[CCER] >> (4 * (channel - 1));
        // CCxP and CCxNP: 00 rising, 01 falling, 11 both.
        let wanted = match enable >> 1 & 5 {
            0 => rising,
            1 => !rising,
            5 => true,
            _ => false,
        };
        if enable & 1 == 0 || self.channel_mode(channel) & 3 != 1 || !wanted {
            return;
        }
        self.storage[Self::ccr(channel)] = self.count;
        let flag = 1 << channel;
        if self.flags & flag != 0 {
            // The previous capture was not read: overcapture.
            self.flags |= flag << 8;
        }
        self.flags |= flag;
    }

    /// Level of the interrupt request of a timer with a single line.
    pub fn irq(&self) -> bool {
        self.irq_update() || self.irq_compare()
    }

    /// Level of the update interrupt request.
    pub fn irq_update(&self) -> bool {
        self.flags & self.storage[DIER] & UIF != 0
    }

    /// Level of the capture/compare interrupt request.
    pub fn irq_compare(&self) -> bool {
        self.flags & self.storage[DIER] & 0x1e != 0
    }

    /// Output of a channel; none unless it is an enabled PWM output.
    pub fn pwm(&self, channel: usize) -> Option<Pwm> {
        let enabled = self.storage[CCER] >> (4 * (channel - 1)) & 5 != 0;
        let gated = self.kind.has_break() && self.storage[BDTR] & MOE == 0;
        let high_first = match self.channel_mode(channel) >> 4 & 0x1007 {
            6 => true,
            7 => false,
            _ => return None,
        };
        if !self.counting() || !enabled || gated {
            return None;
        }
        let ticks = (u64::from(self.storage[Self::ccr(channel)])).min(self.round());
        let part = ticks as f64 / self.round() as f64;
        let frequency_hz = self.clock_hz / (f64::from(self.prescaler) + 1.0) / self.round() as f64;
        Some(Pwm { frequency_hz, duty: if high_first { part } else { 1.0 - part } })
    }
}

impl Registers for Tim {
    fn word(&mut self, register: u32, _: Cycles) -> Modelled<u32> {
        let channel = (register.wrapping_sub(CCR1) / 4 + 1) as usize;
        Ok(match register {
            SR => self.flags,
            EGR => 0,
            CNT => {
                let copy = self.storage[CR1] & UIFREMAP != 0;
                if copy { self.count & !(1 << 31) | (self.flags & UIF) << 31 } else { self.count }
            }
            CCR1..=CCR4 if channel <= self.kind.channels() && self.is_input(channel) => {
                // A captured value, which hardware has written.
                self.flags &= !(1 << channel);
                self.storage[register]
            }
            _ => self.storage.load(register)?,
        })
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        self.advance(now);
        match offset & !3 {
            // Writing 0 clears a flag, writing 1 has no effect.
            SR => self.flags &= width.replace(u32::MAX, offset, value),
            EGR => {
                refuse_if(value & !1 != 0, "EGR: only UG is modelled")?;
                if value & 1 != 0 && self.storage[CR1] & UDIS == 0 {
                    self.update();
                    self.count = 0;
                    self.remainder = 0;
                    if self.storage[CR1] & URS == 0 {
                        self.flags |= UIF;
                    }
                }
            }
            CNT => self.count = width.replace(self.count, offset, value) & self.mask(),
            CR1 => {
                refuse_if(value & !CR1_KNOWN != 0, "one-pulse, centre-aligned or dithering mode is not modelled")?;
                self.storage.store(offset, value, width)?;
                refuse_if(value & DIR != 0 && self.encoder_edges().is_none(), "down-counting is not modelled")?;
            }
            SMCR => {
                self.storage.store(offset, value, width)?;
                refuse_if(
                    self.storage[SMCR] & 0x1_0007 != 0 && self.encoder_edges().is_none(),
                    "SMS: only encoder modes are modelled",
                )?;
            }
            DIER => {
                refuse_if(value & 0x5f00 != 0, "DMA requests of this timer are not modelled")?;
                self.storage.store(offset, value, width)?;
            }
            TISEL if value != 0 && (!self.takes_lsi || value != LSI) => {
                return refuse("TISEL: only LSI on TIM5 is modelled");
            }
            register => {
                self.storage.store(offset, value, width)?;
                if register == CCER {
                    self.lsi_edge = now as f64 + self.hclk_hz / LSI_HZ;
                    self.lsi_edges = 0;
                }
                if register == ARR && self.storage[CR1] & ARPE == 0 {
                    self.period = self.storage[ARR];
                }
            }
        }
        Ok(())
    }

    fn next_event(&self) -> Option<Cycles> {
        let waited = self.storage[DIER] & !self.flags & 0x1f;
        if waited == 0 || !self.counting() {
            return None;
        }
        let update = (waited & UIF != 0).then(|| self.round().saturating_sub(u64::from(self.count)).max(1));
        let compare = (1..=self.kind.channels())
            .filter(|&channel| waited >> channel & 1 != 0 && !self.is_input(channel))
            .filter_map(|channel| self.ticks_until(self.storage[Self::ccr(channel)]));
        let ticks = update.into_iter().chain(compare).min()?;
        Some(self.since + ticks * self.cycles_per_tick() - self.remainder)
    }

    fn advance(&mut self, now: Cycles) {
        self.capture_lsi(now);
        self.count_to(now);
    }

    fn reset(&mut self, now: Cycles) {
        self.storage.reset();
        *self = Self {
            storage: self.storage.clone(),
            cycles_per_clock: self.cycles_per_clock,
            clock_hz: self.clock_hz,
            since: now,
            encoder: self.encoder,
            takes_lsi: self.takes_lsi,
            hclk_hz: self.hclk_hz,
            ..Self::new(self.kind)
        };
    }

    fn set_clocks(&mut self, clocks: &Clocks) {
        self.hclk_hz = clocks.hclk_hz;
        self.clock_hz = if self.kind.has_break() { clocks.timer2_hz } else { clocks.timer1_hz };
        self.cycles_per_clock = (clocks.hclk_hz / self.clock_hz).round().max(1.0) as u64;
    }

    fn unwritten_reads(&self) -> Vec<u32> {
        self.storage.unwritten_reads()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::{read, refuses, write};

    /// Prescaler 16, enabled at cycle 100.
    fn time_driver() -> Tim {
        let mut tim = Tim::new(Kind::Small);
        write(&mut tim, PSC, 15, 0);
        write(&mut tim, CR1, URS, 0);
        write(&mut tim, EGR, 1, 0);
        write(&mut tim, CR1, 0, 0);
        write(&mut tim, CCR1, 0x8000, 0);
        write(&mut tim, DIER, 3, 0);
        write(&mut tim, CR1, CEN, 100);
        tim
    }

    #[test]
    fn counts_ticks_and_wraps() {
        let mut tim = time_driver();
        assert_eq!(read(&mut tim, SR, 100), 0, "URS keeps the update by software quiet");
        assert_eq!(read(&mut tim, CNT, 100 + 15), 0);
        assert_eq!(read(&mut tim, CNT, 100 + 16), 1);
        assert_eq!(read(&mut tim, CNT, 100 + 16 * 0x1_0005 + 3), 5);
        assert_eq!(read(&mut tim, SR, 100 + 16 * 0x1_0005 + 3) & 3, 3);
    }

    #[test]
    fn events_are_where_the_flags_rise() {
        let mut tim = time_driver();
        let half = 100 + 16 * 0x8000;
        assert_eq!(tim.next_event(), Some(half));
        tim.advance(half - 1);
        assert!(!tim.irq());
        assert_eq!(tim.next_event(), Some(half), "also from a point between ticks");
        tim.advance(half);
        assert!(tim.irq());
        write(&mut tim, SR, !2, half);
        assert!(!tim.irq());
        let whole = 100 + 16 * 0x1_0000;
        assert_eq!(tim.next_event(), Some(whole));
        tim.advance(whole);
        assert!(tim.irq());
        write(&mut tim, SR, 0, whole);
        assert_eq!(tim.next_event(), Some(whole + 16 * 0x8000));
    }

    #[test]
    fn small_steps_end_where_one_large_one_does() {
        let (mut one, mut many) = (time_driver(), time_driver());
        let end = 100 + 16 * 200_000 + 7;
        one.advance(end);
        for now in (100..end).step_by(7919).chain([end]) {
            many.advance(now);
        }
        assert_eq!((one.count, one.flags, one.remainder), (many.count, many.flags, many.remainder));
    }

    #[test]
    fn tim5_times_the_32_khz_oscillator() {
        let mut tim = Tim::new(Kind::Wide).with_lsi();
        tim.set_clocks(&Clocks { hclk_hz: 168e6, timer1_hz: 168e6, ..Clocks::POWER_ON });
        write(&mut tim, TISEL, LSI, 0);
        // The captured input, one edge in eight.
        write(&mut tim, CCMR1, 1 | 3 << 2, 0);
        write(&mut tim, CCER, 1, 0);
        write(&mut tim, CR1, CEN, 0);
        let eight = 8 * 5250;
        assert_eq!(read(&mut tim, SR, eight - 1) & 2, 0);
        assert_eq!(read(&mut tim, SR, eight + 3) & 0x202, 2);
        assert_eq!(read(&mut tim, CCR1, eight + 90), eight as u32);
        assert_eq!(read(&mut tim, SR, eight + 91) & 2, 0);
        assert_eq!(read(&mut tim, SR, 3 * eight + 9) & 0x202, 0x202, "one was missed");
        assert_eq!(read(&mut tim, CCR1, 3 * eight + 10), 3 * eight as u32);
        for mut tim in [tim.clone(), Tim::new(Kind::Wide)] {
            assert!(refuses(&mut tim, TISEL, 2, 0));
        }
        assert!(Tim::new(Kind::Wide).write(TISEL, LSI, Width::Word, 0).is_err());
    }

    #[test]
    fn a_new_prescaler_waits_for_the_update() {
        let mut tim = Tim::new(Kind::General);
        write(&mut tim, ARR, 99, 0);
        write(&mut tim, CR1, CEN, 0);
        write(&mut tim, PSC, 1, 50);
        assert_eq!(read(&mut tim, CNT, 99), 99);
        assert_eq!(read(&mut tim, CNT, 100), 0);
        assert_eq!(read(&mut tim, CNT, 103), 1, "half as fast now");
    }

    #[test]
    fn encoder_counts_both_ways_over_the_end() {
        let mut tim = Tim::new(Kind::Wide);
        tim.set_encoder(1000);
        write(&mut tim, SMCR, 3, 0);
        write(&mut tim, CR1, CEN, 0);
        tim.set_encoder(1005);
        assert_eq!((read(&mut tim, CNT, 0), read(&mut tim, CR1, 0) & DIR), (5, 0));
        tim.set_encoder(998);
        assert_eq!((read(&mut tim, CNT, 0), read(&mut tim, CR1, 0) & DIR), (u32::MAX - 1, DIR));
        write(&mut tim, CNT, 7, 0);
        tim.set_encoder(999);
        assert_eq!(read(&mut tim, CNT, 10_000), 8, "a written count holds, and no clock moves it");
        tim.set_encoder(999u32.wrapping_add(u32::MAX));
        assert_eq!(tim.count, 7, "the encoder's own wrap is one step back");
    }

    #[test]
    fn encoder_with_half_the_edges_or_an_inverted_input() {
        let mut tim = Tim::new(Kind::Wide);
        write(&mut tim, SMCR, 1, 0);
        write(&mut tim, CR1, CEN, 0);
        tim.set_encoder(3);
        assert_eq!(tim.count, 1);
        tim.set_encoder(4);
        assert_eq!(tim.count, 2);
        write(&mut tim, CCER, 1 << 1, 0);
        tim.set_encoder(6);
        assert_eq!(tim.count, 1);
    }

    #[test]
    fn capture_takes_the_count_on_its_edge_only() {
        let mut tim = Tim::new(Kind::Wide);
        write(&mut tim, SMCR, 3, 0);
        write(&mut tim, CCMR2, 1, 0);
        write(&mut tim, CCER, 1 << 8 | 1 << 9, 0);
        write(&mut tim, DIER, 1 << 3, 0);
        write(&mut tim, CR1, CEN, 0);
        tim.set_encoder(42);
        tim.edge(3, true);
        assert!(!tim.irq());
        tim.edge(3, false);
        assert!(tim.irq());
        tim.set_encoder(50);
        tim.edge(3, false);
        assert_eq!(read(&mut tim, SR, 0) & 0x1e00, 1 << 11);
        assert_eq!(read(&mut tim, 0x3c, 0), 50);
        assert!(!tim.irq(), "reading the captured value clears the flag");
    }

    #[test]
    fn pwm_frequency() {
        let mut tim = Tim::new(Kind::Advanced);
        tim.set_clocks(&Clocks { hclk_hz: 168e6, timer2_hz: 168e6, ..Clocks::POWER_ON });
        write(&mut tim, ARR, 20, 0);
        write(&mut tim, CCR1, 10, 0);
        write(&mut tim, CCMR1, 6 << 4, 0);
        write(&mut tim, CCER, 1, 0);
        write(&mut tim, CR1, CEN, 0);
        assert_eq!(tim.pwm(1), None, "the outputs are off");
        write(&mut tim, BDTR, MOE, 0);
        assert_eq!(tim.pwm(1), Some(Pwm { frequency_hz: 8e6, duty: 10.0 / 21.0 }));
    }

    #[test]
    fn what_is_not_modelled_is_said() {
        let mut tim = Tim::new(Kind::General);
        assert!(refuses(&mut tim, CR1, 1 << 5, 0), "centre-aligned");
        assert!(refuses(&mut tim, SMCR, 4, 0), "reset by trigger");
        assert!(refuses(&mut tim, DIER, 1 << 8, 0), "DMA");
        assert!(tim.read(0x3dc, Width::Word, 0).is_err(), "DMA burst");
    }

    #[test]
    fn fields_are_metapacs() {
        fields_agree!("TIM1", "CR1", CEN, UDIS, URS, DIR, ARPE, UIFREMAP);
        fields_agree!("TIM1", "SR", UIF);
        fields_agree!("TIM1", "DIER", UIE = UIF, CCIE = UIF << 1);
        fields_agree!("TIM1", "BDTR", MOE);
    }
}
