//! The signal path as a sequence of events: sampling clock, converters, SPI, and the DMA transfers that they request.
//!
//! None of it is stepped while the core runs. When the core accesses a peripheral or an interrupt may be due,
//! `pipeline_advance` catches up: it processes every event in order, each at its own time. Until then the rings in RAM
//! stay unchanged. `pipeline_next_event` returns the earliest time at which an interrupt may be due; for a circular DMA
//! channel that is the next half or full transfer.
//!
//! Order within one cycle: the sampling clock's update first latches the encoder count by DMA, then triggers the
//! converters. A converter samples its pin at the aperture, and DMA transfers the result at the end of the conversion.
//! A DMA transfer takes no time. On the chip it takes some tens of nanoseconds, in which the encoder moves 1e-9 m at 20
//! mm/s.

use super::adc::{self, Signal, TRIGGER_TIM6, Unit};
use super::ads131m04::{CLKIN, CS, DRDY, Inputs, RESET};
use super::dac::TRIGGER_TIM7;
use super::dma::{CHANNELS, Channel, Direction, Transfer};
use super::dmamux::Request;
use super::gpio::Mode;
use super::jumpers::{FLOATING_V, Output};
use super::pin::Pin;
use super::spi::Frame;
use super::{BadAccess, Chip};
use crate::registers::{refuse, refuse_if};
use crate::{Cycles, Modelled, Registers, Unknown, Width};

/// SCK, MISO and MOSI of SPI2, and their alternate function (DS12288 table 13).
const WIRES: [Pin; 3] = [Pin::new('B', 13), Pin::new('B', 14), Pin::new('B', 15)];
const SPI2_FUNCTION: Mode = Mode::Alternate(5);
/// PA8 as TIM1_CH1.
const TIM1_FUNCTION: Mode = Mode::Alternate(6);

/// The earliest times of future requests.
#[derive(Clone, Copy, Debug)]
struct Pace {
    first: Cycles,
    second: Cycles,
    /// From the second request on.
    period: Cycles,
}

impl Pace {
    fn every(period: Cycles, first: Cycles) -> Self {
        Self { first, second: first + period, period }
    }

    /// Time of the `number`th request, counted from 1.
    fn nth(&self, number: u32) -> Cycles {
        if number <= 1 { self.first } else { self.second + u64::from(number - 2) * self.period }
    }
}

impl Chip {
    /// The fault of the signal path since the last call, if any. The path stops at a fault.
    pub fn take_fault(&mut self) -> Option<BadAccess> {
        self.path_fault.take()
    }

    /// Processes all events up to and including `now`.
    pub(crate) fn pipeline_advance(&mut self, now: Cycles) {
        while let Some(at) = self.next_step().filter(|at| *at <= now) {
            if self.path_fault.is_some() {
                return;
            }
            self.has_moved = true;
            if let Err(unknown) = self.step(at) {
                self.fault("signal path", 0, unknown);
            }
        }
        self.adc.advance(now);
    }

    /// Earliest time at which the signal path may raise an interrupt request, beside the events of its models; it may
    /// turn out too early.
    pub(crate) fn pipeline_next_event(&self) -> Option<Cycles> {
        if self.path_fault.is_some() {
            return None;
        }
        let edges = self.ads131m04.as_ref().and_then(|ads| ads.due);
        let converters = Unit::ALL.into_iter().filter(|unit| self.adc.interrupts_each(*unit));
        let triggers = converters.filter_map(|_| self.tim6.next_update());
        let channels = (0..2 * CHANNELS).filter_map(|channel| self.next_interrupt(channel));
        edges.into_iter().chain(triggers).chain(channels).min()
    }

    /// Earliest time at which the channel may raise its interrupt request.
    fn next_interrupt(&self, channel: usize) -> Option<Cycles> {
        let transfers = self.channel(channel).transfers_until_interrupt()?;
        Some(self.pace(Request::of(self.dmamux.request(channel))?)?.nth(transfers))
    }

    fn pace(&self, request: Request) -> Option<Pace> {
        let clock = |first: Cycles| Pace::every(self.tim6.period(), first);
        let of_unit = |unit: Unit| match (self.adc.due_of(unit), self.tim6.next_update()) {
            // One result may come at once, then one per trigger. Without a trigger, or in a longer sequence, results
            // may come at any time.
            (Some(due), Some(update)) if self.adc.is_single(unit) => {
                Some(Pace { first: due, ..clock(update - self.tim6.period()) })
            }
            (Some(due), _) => Some(Pace::every(0, due)),
            (None, update) if self.adc.is_single(unit) => update.map(clock),
            (None, update) => update.map(|update| Pace::every(0, update)),
        };
        match request {
            Request::Tim6Update => self.tim6.next_update().map(clock),
            // DAC requests come with the trigger of the same timer.
            Request::Tim7Update | Request::Dac1 | Request::Dac2 => {
                self.tim7.next_update().map(|first| Pace::every(self.tim7.period(), first))
            }
            Request::Adc(unit) => of_unit(unit),
            Request::Spi2Receive | Request::Spi2Transmit => {
                Some(Pace::every(self.spi2.frame_cycles(), self.spi2.due()?))
            }
        }
    }

    /// Time of the next event of the path, whether the core can observe it or not.
    fn next_step(&self) -> Option<Cycles> {
        let sources = [
            self.tim6.next_update(),
            self.tim7.next_update(),
            self.late.front().map(|(at, _)| *at),
            self.adc.due.map(|(end, _)| end),
            self.spi2.due(),
            self.ads131m04.as_ref().and_then(|ads| ads.due),
            self.dma[0].next_event(),
            self.dma[1].next_event(),
        ];
        sources.into_iter().flatten().min()
    }

    fn step(&mut self, at: Cycles) -> Modelled {
        self.dma.iter_mut().for_each(|dma| dma.advance(at));
        if self.tim6.next_update() == Some(at) {
            let trigger = self.tim6.update();
            // This transfer reads TIM2, which updates its counter to this time.
            self.serve_dma(at);
            if trigger {
                self.start_conversions(at)?;
            }
        }
        while let Some((_, unit)) = self.late.front().copied().filter(|(due, _)| *due <= at) {
            self.late.pop_front();
            self.adc.trigger_one(unit, TRIGGER_TIM6, at)?;
        }
        if self.tim7.next_update() == Some(at) {
            let trigger = self.tim7.update();
            self.serve_dma(at);
            if trigger {
                self.dac.iter_mut().for_each(|dac| dac.trigger(TRIGGER_TIM7, at));
            }
        }
        while let Some((_, unit)) = self.adc.due.filter(|(end, _)| *end <= at) {
            let (signal, aperture) = self.adc.looks_at(unit)?;
            let volts = self.volts(signal, aperture)?;
            self.adc.finish(unit, volts)?;
            self.serve_dma(at);
        }
        if let Some(frame) = self.spi2.frame.filter(|_| self.spi2.due() == Some(at)) {
            let answer = self.exchange(frame)?;
            self.spi2.finish(answer);
        }
        self.convert(at)?;
        self.serve_dma(at);
        Ok(())
    }

    /// Delivers the sampling clock's trigger to the converters, each with its injected delay.
    fn start_conversions(&mut self, at: Cycles) -> Modelled {
        if self.planted.late == [0; 2] {
            return self.adc.trigger(TRIGGER_TIM6, at);
        }
        let mut starts: Vec<_> = [Unit::One, Unit::Two].into_iter().zip(self.planted.late).collect();
        starts.sort_by_key(|(_, late)| *late);
        for (unit, late) in starts {
            match late {
                0 => self.adc.trigger_one(unit, TRIGGER_TIM6, at)?,
                _ => self.late.push_back((at + late, unit)),
            }
        }
        Ok(())
    }

    /// Exchanges a frame on SPI2; returns the received data.
    fn exchange(&mut self, frame: Frame) -> Modelled<u16> {
        let (mode, rate_hz) = (self.spi2.mode(), self.spi2.rate_hz(self.clocks.hclk_hz));
        // If the ADS131M04 is connected, the pins must be assigned to SPI2. If not, nothing drives MISO, which reads as
        // ones.
        refuse_if(
            self.ads131m04.is_some() && WIRES.iter().any(|pin| self.pin_mode(*pin) != SPI2_FUNCTION),
            "SPI2 is in use, but PB13, PB14, PB15 are not assigned to it",
        )?;
        let Some(ads) = &mut self.ads131m04 else { return Ok(u16::MAX) };
        let mut byte = |byte: u8| ads.exchange(byte, mode, rate_hz).map(u16::from);
        let [high, low] = frame.data.to_be_bytes();
        match frame.bits {
            8 => byte(low),
            16 => Ok(byte(high)? << 8 | byte(low)?),
            _ => refuse("frame size for the ADS131M04 is not a multiple of 8 bits"),
        }
    }

    /// Ends the digital front end's conversion if it is due: DRDY falls, which latches the encoder count.
    fn convert(&mut self, at: Cycles) -> Modelled {
        let clocks = self.clocks;
        let Some(ads) = self.ads131m04.as_mut().filter(|ads| ads.due == Some(at)) else { return Ok(()) };
        ads.check_clock(clocks.hclk_hz)?;
        ads.convert(at, |cycles| clocks.seconds(cycles), self.world.as_mut());
        let ready = !ads.chip.drdy();
        self.latch_encoder(at);
        if ready {
            // If the last conversion was not read, DRDY goes high briefly.
            self.set_pin(DRDY, true, at);
            self.set_pin(DRDY, false, at);
        }
        Ok(())
    }

    /// Passes the pin levels to the digital front end.
    fn follow_pins(&mut self, now: Cycles) {
        if self.ads131m04.is_none() {
            return;
        }
        let inputs =
            Inputs { cs: self.pin_output(CS), reset: self.pin_output(RESET), clkin_cycles: self.clkin_cycles() };
        if let Some(ads) = &mut self.ads131m04 {
            ads.follow(inputs, now);
            let drdy = ads.chip.drdy();
            self.set_pin(DRDY, drdy, now);
        }
    }

    /// Core cycles per period of the output on PA8, rounded.
    fn clkin_cycles(&self) -> Option<Cycles> {
        let pwm = self.tim1.pwm(1).filter(|_| self.pin_mode(CLKIN) == TIM1_FUNCTION)?;
        Some((self.clocks.hclk_hz / pwm.frequency_hz).round() as Cycles).filter(|cycles| *cycles > 0)
    }

    fn volts(&mut self, signal: Signal, at: Cycles) -> Modelled<f64> {
        let time_s = self.seconds(at);
        let pin = match signal {
            Signal::Temperature => return Ok(adc::sensor_volts(self.world.temperature_c(time_s))),
            Signal::InternalReference => return Ok(adc::internal_reference_volts()),
            Signal::Battery => return Ok(adc::REFERENCE_V / 3.0),
            Signal::Pin(pin) => pin,
        };
        if self.pin_mode(pin) != Mode::Analog {
            refuse("conversion of a pin that is not in analogue mode")
        } else {
            self.input_volts(pin, at, time_s)
        }
    }

    /// Voltage at the force pin or the terminal pin \[V\].
    fn input_volts(&mut self, pin: Pin, at: Cycles, time_s: f64) -> Modelled<f64> {
        let (is_force, is_terminal) = (pin == self.board.force, pin == self.board.terminal);
        match (self.jumpers, is_force, is_terminal) {
            (Some(jumpers), true, _) => Ok(self.wire_volts(jumpers.force, at)),
            (Some(jumpers), _, true) => Ok(self.wire_volts(jumpers.terminal, at)),
            (None, true, _) => Ok(self.world.force_volts(time_s)),
            (None, _, true) => Ok(self.world.terminal_volts(time_s)),
            _ => refuse("conversion of a pin that is not connected"),
        }
    }

    fn wire_volts(&self, from: Option<Output>, at: Cycles) -> f64 {
        let dac = from.map(|output| &self.dac[output as usize]);
        dac.and_then(|dac| dac.volts(at)).unwrap_or(FLOATING_V)
    }

    /// Whether the injected fault loses this request.
    fn loses(&mut self, request: Request, now: Cycles) -> bool {
        let lost = self.planted.lost.is_some_and(|(which, after_s)| which == request && self.seconds(now) >= after_s);
        if lost {
            self.planted.lost = None;
        }
        lost
    }

    /// Executes pending DMA requests until none is left, after passing on triggers that a register write caused.
    pub(crate) fn serve_dma(&mut self, now: Cycles) {
        if self.tim6.take_trigger()
            && let Err(unknown) = self.adc.trigger(TRIGGER_TIM6, now)
        {
            self.fault("ADC", 0, unknown);
        }
        self.follow_pins(now);
        while self.path_fault.is_none() && Request::ALL.into_iter().any(|request| self.serve(request, now)) {}
    }

    fn is_requested(&self, request: Request) -> bool {
        match request {
            Request::Tim6Update => self.tim6.dma_request,
            Request::Tim7Update => self.tim7.dma_request,
            Request::Dac1 => self.dac[0].dma_request,
            Request::Dac2 => self.dac[1].dma_request,
            Request::Adc(unit) => self.adc.dma_request(unit),
            Request::Spi2Receive => self.spi2.receive_request(),
            Request::Spi2Transmit => self.spi2.transmit_request(),
        }
    }

    /// Executes one transfer if the request with this number is pending and an enabled channel is assigned to it;
    /// returns whether it did.
    fn serve(&mut self, (request, number): (Request, u8), now: Cycles) -> bool {
        if !self.is_requested(request) {
            return false;
        }
        if self.loses(request, now) {
            self.forget(request);
            return true;
        }
        for channel in 0..2 * CHANNELS {
            if self.dmamux.request(channel) != number {
                continue;
            }
            match self.channel(channel).transfer() {
                Ok(None) => {}
                Ok(Some(transfer)) => {
                    self.transfer(channel, &transfer, now);
                    self.acknowledge(request, channel);
                    self.has_moved = true;
                    return true;
                }
                Err(unknown) => self.fault("DMA", 0, unknown),
            }
        }
        false
    }

    /// Clears a served request. Reading the result clears an ADC's request.
    fn forget(&mut self, request: Request) {
        match request {
            Request::Tim6Update => self.tim6.dma_request = false,
            Request::Tim7Update => self.tim7.dma_request = false,
            Request::Dac1 => self.dac[0].dma_request = false,
            Request::Dac2 => self.dac[1].dma_request = false,
            _ => {}
        }
    }

    fn acknowledge(&mut self, request: Request, channel: usize) {
        self.forget(request);
        self.transfers += 1;
        let lap_ended = self.channel_mut(channel).complete();
        if let Request::Adc(unit) = request
            && lap_ended
        {
            self.adc.dma_end(unit);
        }
    }

    fn transfer(&mut self, channel: usize, transfer: &Transfer, now: Cycles) {
        if self.channel(channel).broken {
            return self.channel_mut(channel).fail();
        }
        let Transfer { peripheral, peripheral_width, memory, memory_width, direction } = *transfer;
        let size = memory_width.bytes() as usize;
        let outcome = match direction {
            Direction::ToMemory => self.bus(peripheral, peripheral_width, None, now).map(|value| {
                let bytes = (value & peripheral_width.mask()).to_le_bytes();
                match self.ram_mut(memory, size) {
                    Some(place) => place.copy_from_slice(&bytes[..size]),
                    None => self.channel_mut(channel).fail(),
                }
            }),
            Direction::ToPeripheral => {
                let mut bytes = [0; 4];
                match self.bytes(memory, size) {
                    Some(place) => bytes[..size].copy_from_slice(place),
                    None => return self.channel_mut(channel).fail(),
                }
                self.bus(peripheral, peripheral_width, Some(u32::from_le_bytes(bytes)), now).map(|_| ())
            }
        };
        if let Err(bad) = outcome {
            self.path_fault.get_or_insert(bad);
        }
    }

    fn channel(&self, number: usize) -> &Channel {
        &self.dma[number / CHANNELS].channels[number % CHANNELS]
    }

    fn channel_mut(&mut self, number: usize) -> &mut Channel {
        &mut self.dma[number / CHANNELS].channels[number % CHANNELS]
    }

    /// Stops the path at a fault with the register at this address, or 0 for none.
    pub(super) fn fault(&mut self, peripheral: &'static str, address: u32, Unknown { what }: Unknown) {
        let (offset, width) = (address & 0x3ff, Width::Word);
        self.path_fault.get_or_insert(BadAccess { address, peripheral, offset, width, value: None, what });
    }
}

#[cfg(test)]
mod tests {
    use super::super::clocks::Clocks;
    use super::*;
    use crate::Width::{Byte, Word};
    use crate::chip::adc::{CODES, Quality, REFERENCE_V};
    use crate::chip::ads131m04::Ads131m04;
    use crate::{Board, World};

    const HCLK_HZ: f64 = 168e6;
    const PERIOD: Cycles = 2625;
    /// From the update to the aperture: (2.125 + 24.5) clocks of four cycles.
    const APERTURE: Cycles = 107;
    /// From the update to the end of the conversion.
    const RESULT: Cycles = 157;
    /// Time at which the timer is enabled.
    const START: Cycles = 100_000;
    const TIM2_CNT: u32 = 0x4000_0024;
    const POSITIONS: u32 = 0x2000_0000;
    const FORCES: u32 = 0x2000_1000;
    const TERMINALS: u32 = 0x2000_2000;
    const ENTRIES: u32 = 16;

    /// Signals that encode the time of the read: 1 V per millisecond, one count per cycle.
    struct Ramp;

    impl World for Ramp {
        fn encoder(&mut self, time_s: f64) -> u32 {
            (time_s * HCLK_HZ).round() as u32
        }
        fn force_volts(&mut self, time_s: f64) -> f64 {
            time_s * 1e3 % REFERENCE_V
        }
        fn terminal_volts(&mut self, time_s: f64) -> f64 {
            REFERENCE_V - time_s * 1e3 % REFERENCE_V
        }
        fn bridge_volts(&mut self, time_s: f64) -> f64 {
            time_s
        }
    }

    fn write(chip: &mut Chip, address: u32, value: u32, now: Cycles) {
        chip.write(address, value, Word, now).unwrap();
    }

    /// Rings, converters and timer set up as in the firmware, except for the last write. One difference: the ADC clock
    /// is HCLK / 4, which has the same trigger latency at every phase.
    fn chip() -> Chip {
        let mut chip = Chip::new(Board::NUCLEO, Box::new(Ramp));
        let clocks =
            Clocks { hclk_hz: HCLK_HZ, timer1_hz: HCLK_HZ, timer2_hz: HCLK_HZ, pclk1_hz: HCLK_HZ, ..Clocks::POWER_ON };
        chip.adc.set_quality(Quality::IDEAL);
        let now = 0;
        // All clocks on; the encoder pins assigned to TIM2 in encoder mode.
        for (address, value) in [
            (0x4002_1048, u32::MAX),
            (0x4002_104C, u32::MAX),
            (0x4002_1058, u32::MAX),
            (0x4002_1060, u32::MAX),
            (0x4800_0000, 0xABFF_FFFF),
            (0x4800_0024, 1 << 28),
            (0x4800_0400, 0xFFFF_FEBF),
            (0x4800_0420, 1 << 12),
            (0x4000_0008, 3),
            (0x4000_0000, 1),
        ] {
            write(&mut chip, address, value, now);
        }
        // Enabling the clocks has recomputed the frequencies from the registers.
        chip.use_clocks(clocks, now);
        for (n, (request, peripheral, memory, ccr)) in [
            (8, TIM2_CNT, POSITIONS, 2 << 8 | 2 << 10),
            (5, 0x5000_0040, FORCES, 1 << 8 | 1 << 10),
            // Half and complete interrupts on the channel that finishes last.
            (36, 0x5000_0140, TERMINALS, 1 << 8 | 1 << 10 | 1 << 2 | 1 << 1),
        ]
        .into_iter()
        .enumerate()
        {
            let channel = 0x4002_0008 + 0x14 * n as u32;
            write(&mut chip, 0x4002_0800 + 4 * n as u32, request, now);
            write(&mut chip, channel + 0x4, ENTRIES, now);
            write(&mut chip, channel + 0x8, peripheral, now);
            write(&mut chip, channel + 0xC, memory, now);
            write(&mut chip, channel, ccr | 1 << 7 | 1 << 5 | 1, now);
        }
        write(&mut chip, 0x5000_0308, 3 << 16, now);
        for (base, channel) in [(0x5000_0000, 1), (0x5000_0100, 2)] {
            let enable = 1 << 28;
            write(&mut chip, base + 0x08, 0, now);
            write(&mut chip, base + 0x08, enable, now);
            write(&mut chip, base + 0x08, enable | 1, 4000);
            write(&mut chip, base + 0x14, 3 << (3 * channel), 5000);
            write(&mut chip, base + 0x30, channel << 6, 5000);
            // DMA, circular, TIM6_TRGO rising.
            write(&mut chip, base + 0x0C, 3 | TRIGGER_TIM6 << 5 | 1 << 10, 5000);
            write(&mut chip, base + 0x08, enable | 1 | 4, 5000);
        }
        write(&mut chip, 0x4000_1004, 2 << 4, 5000);
        write(&mut chip, 0x4000_102C, PERIOD as u32 - 1, 5000);
        write(&mut chip, 0x4000_100C, 1 << 8, 5000);
        chip
    }

    fn running() -> Chip {
        let mut chip = chip();
        write(&mut chip, 0x4000_1000, 1, START);
        chip
    }

    fn ring<const N: usize>(chip: &Chip, address: u32, entry: u32) -> [u8; N] {
        let bytes = chip.bytes(address + entry * N as u32, N).unwrap();
        bytes.try_into().unwrap()
    }

    fn position(chip: &Chip, entry: u32) -> u32 {
        u32::from_le_bytes(ring(chip, POSITIONS, entry))
    }

    fn left(chip: &mut Chip) -> [u32; 3] {
        [0, 1, 2].map(|n| chip.dma[0].read(0x0C + 0x14 * n, Word, 0).unwrap())
    }

    #[test]
    fn three_rings_fill_in_step_each_at_its_own_moment() {
        let mut chip = running();
        let end = START + 10 * PERIOD + RESULT;
        chip.advance(end - 1);
        assert_eq!(left(&mut chip), [6, 7, 7]);
        chip.advance(end);
        assert_eq!(left(&mut chip), [6, 6, 6]);
        for entry in 0..10 {
            let update = START + PERIOD * u64::from(entry + 1);
            assert_eq!(u64::from(position(&chip, entry)), update);
            let volts = Ramp.force_volts((update + APERTURE) as f64 / HCLK_HZ);
            let code = (volts / REFERENCE_V * CODES).round() as u16;
            assert_eq!(u16::from_le_bytes(ring(&chip, FORCES, entry)), code);
            assert_eq!(u16::from_le_bytes(ring(&chip, TERMINALS, entry)), 4096 - code);
        }
        assert_eq!(chip.take_fault(), None);
    }

    #[test]
    fn the_interrupt_is_foretold_to_the_cycle_and_nothing_happens_before() {
        let mut chip = running();
        let mut now = START;
        for half in 1..=6 {
            let mut looks = 0;
            while !chip.dma[0].channels[2].irq() {
                now = chip.next_event().unwrap();
                chip.advance(now);
                looks += 1;
            }
            assert_eq!(now, START + half * PERIOD * u64::from(ENTRIES / 2) + RESULT);
            assert!(looks <= 2, "{looks} stops for one interrupt");
            write(&mut chip, 0x4002_0004, 0xF << 8, now);
        }
    }

    #[test]
    fn it_does_not_matter_how_often_one_looks() {
        let run = |step: Cycles| {
            let mut chip = running();
            chip.adc.set_quality(Quality { noise_lsb: 2.0, ..Quality::default() });
            let end = START + 3 * PERIOD * u64::from(ENTRIES) + 1000;
            let mut now = START;
            while now < end {
                now = (now + step).min(end);
                chip.advance(now);
            }
            (chip.bytes(POSITIONS, 0x3000).unwrap().to_vec(), left(&mut chip), chip.dma[0].clone().read(0, Word, 0))
        };
        assert_eq!(run(1_000_000), run(37));
    }

    #[test]
    fn an_update_before_the_start_puts_the_converters_one_ahead() {
        // As with a driver that forces an update while the converters wait: a result without a position.
        let mut chip = chip();
        write(&mut chip, 0x4000_1000, 1 << 2, START - 5000);
        write(&mut chip, 0x4000_1014, 1, START - 5000);
        write(&mut chip, 0x4000_1000, 1, START);
        chip.advance(START + 4 * PERIOD + RESULT);
        assert_eq!(left(&mut chip), [12, 11, 11]);
    }

    #[test]
    fn a_channel_kept_off_the_bus_loses_positions_and_the_rings_part() {
        let mut chip = running();
        chip.dma[0].channels[0].stalled_until = Some(START + 3 * PERIOD + 10);
        chip.advance(START + 8 * PERIOD + RESULT);
        // Three updates fall into the stall. Only one of their requests is pending at its end, and is served late.
        assert_eq!(left(&mut chip), [10, 8, 8]);
        assert_eq!(u64::from(position(&chip, 0)), START + 3 * PERIOD + 10, "read when the bus is free");
    }

    #[test]
    fn a_converters_channel_kept_off_the_bus_is_an_overrun_and_the_ring_stands() {
        let mut chip = running();
        chip.dma[0].channels[2].stalled_until = Some(START + 3 * PERIOD + 10);
        chip.advance(START + 8 * PERIOD + RESULT);
        assert_eq!(left(&mut chip), [8, 8, 16]);
        let flags = |chip: &mut Chip, base: u32| chip.adc.read(base, Word, START).unwrap() & 1 << 4;
        assert_eq!((flags(&mut chip, 0x000), flags(&mut chip, 0x100)), (0, 1 << 4));
    }

    #[test]
    fn a_ring_outside_memory_is_a_transfer_error() {
        let mut chip = chip();
        write(&mut chip, 0x4002_0008 + 0x28, 0, START);
        write(&mut chip, 0x4002_0008 + 0x34, 0x3000_0000, START);
        write(&mut chip, 0x4002_0008 + 0x28, 1 << 8 | 1 << 10 | 1 << 7 | 1 << 5 | 1 << 3 | 1, START);
        write(&mut chip, 0x4000_1000, 1, START);
        chip.advance(START + 2 * PERIOD);
        assert!(chip.dma[0].channels[2].irq() && !chip.dma[0].channels[2].is_enabled());
        // The other kind of error: the bus refuses a transfer.
        write(&mut chip, 0x4002_0004, 8 << 8, START);
        write(&mut chip, 0x4002_0008 + 0x34, TERMINALS, START);
        write(&mut chip, 0x4002_0008 + 0x28, 1 << 8 | 1 << 10 | 1 << 7 | 1 << 5 | 1 << 3 | 1, START);
        chip.dma[0].channels[2].broken = true;
        chip.advance(START + 4 * PERIOD);
        assert!(chip.dma[0].channels[2].irq() && !chip.dma[0].channels[2].is_enabled());
    }

    #[test]
    fn a_request_for_a_register_that_is_not_there_ends_the_run() {
        let mut chip = chip();
        write(&mut chip, 0x4002_0008, 0, START);
        write(&mut chip, 0x4002_0010, 0x4000_03F0, START);
        write(&mut chip, 0x4002_0008, 2 << 8 | 2 << 10 | 1, START);
        write(&mut chip, 0x4000_1000, 1, START);
        chip.advance(START + 2 * PERIOD);
        assert_eq!(chip.take_fault().map(|bad| bad.address), Some(0x4000_03F0));
    }

    #[test]
    fn bytes_over_spi_by_dma_both_ways_end_in_one_interrupt() {
        let mut chip = chip();
        let (sent, received) = (0x2000_3000, 0x2000_4000);
        chip.ram_mut(sent, 18).unwrap().copy_from_slice(&[7; 18]);
        let dma2 = 0x4002_0408;
        for (n, (request, memory, ccr)) in [(12, received, 1 << 1), (13, sent, 1 << 4)].into_iter().enumerate() {
            let channel = dma2 + 0x14 * n as u32;
            write(&mut chip, 0x4002_0820 + 4 * n as u32, request, 0);
            write(&mut chip, channel + 0x4, 18, 0);
            write(&mut chip, channel + 0x8, 0x4000_380C, 0);
            write(&mut chip, channel + 0xC, memory, 0);
            write(&mut chip, channel, ccr | 1 << 7 | 1, 0);
        }
        write(&mut chip, 0x4000_3804, 7 << 8 | 1 << 12 | 3, 0);
        let mode = 1 << 2 | 1 << 8 | 1 << 9 | 1 | 3 << 3;
        write(&mut chip, 0x4000_3800, mode | 1 << 6, 1000);
        let frame = 16 * 8;
        let mut now = 1000;
        let mut stops = 0;
        while !chip.dma[1].channels[0].irq() {
            now = chip.next_event().unwrap();
            chip.advance(now);
            stops += 1;
        }
        assert_eq!((now, stops), (1000 + 18 * frame, 1));
        assert_eq!(chip.bytes(received, 18).unwrap(), [0xFF; 18]);
    }

    #[test]
    fn a_pin_that_is_not_analogue_ends_the_run() {
        let mut chip = running();
        write(&mut chip, 0x4800_0000, 0xABFF_FFFC, START);
        chip.advance(START + 2 * PERIOD);
        assert!(chip.take_fault().is_some_and(|bad| bad.what.contains("analogue")));
    }

    /// The digital front end with CLKIN at 8 MHz. SPI2 is on its pins; PB12 and PB11 are high outputs. PB10 is
    /// TIM2_CH3, which captures falling edges. PA8 is TIM1_CH1, with a period of 21 cycles from cycle 5000 on.
    fn digital() -> Chip {
        let mut chip = chip();
        chip.ads131m04 = Some(Ads131m04::new([0.0; 4], 0));
        for (address, value) in [
            (0x4800_0418, 3 << 11),
            (0x4800_0400, 0xA965_FEBF),
            (0x4800_0424, 0x5550_0100),
            (0x4000_001C, 1),
            (0x4000_0020, 3 << 8),
            (0x4000_3804, 7 << 8 | 1 << 12),
            (0x4800_0000, 0xABFE_FFFF),
            (0x4800_0024, 1 << 28 | 6),
            (0x4001_2C2C, 20),
            (0x4001_2C34, 10),
            (0x4001_2C18, 6 << 4),
            (0x4001_2C20, 1),
            (0x4001_2C44, 1 << 15),
            (0x4001_2C14, 1),
            (0x4001_2C00, 1),
            (0x4000_3800, 1 << 2 | 1 << 8 | 1 << 9 | 1 | 3 << 3 | 1 << 6),
        ] {
            write(&mut chip, address, value, 5000);
        }
        chip
    }

    #[test]
    fn data_ready_latches_the_count_and_a_frame_brings_the_conversion() {
        let mut chip = digital();
        let period = 2048 * 21;
        for n in 1..6 {
            let edge = 5000 + n * period;
            chip.advance(edge - 1);
            assert_eq!(chip.read(0x4000_0010, Word, edge - 1).unwrap() & 1 << 3, 0);
            chip.advance(edge);
            assert_eq!(chip.read(0x4000_003C, Word, edge), Ok(edge as u32));
            // A frame read by software.
            let mut now = edge + 100;
            write(&mut chip, 0x4800_0428, 1 << 12, now);
            let bytes: Vec<u8> = (0..18)
                .map(|_| {
                    chip.write(0x4000_380C, 0, Byte, now).unwrap();
                    now += 16 * 8;
                    chip.read(0x4000_380C, Byte, now).unwrap() as u8
                })
                .collect();
            write(&mut chip, 0x4800_0418, 1 << 12, now);
            let volts = f64::from(i32::from_be_bytes([bytes[3], bytes[4], bytes[5], 0]) >> 8) / 8_388_608.0 * 1.2;
            let middle_s = (edge as f64 - 21.0 * 3070.0) / HCLK_HZ;
            if n > 2 {
                assert!((volts - middle_s).abs() < 2e-7, "{volts} {middle_s}");
            }
        }
        assert_eq!(chip.take_fault(), None);
    }

    #[test]
    fn a_front_end_whose_wires_are_not_the_buses_ends_the_run() {
        let mut chip = digital();
        write(&mut chip, 0x4800_0400, 0xFFFF_FEBF, 6000);
        chip.write(0x4000_380C, 0, Byte, 6000).unwrap();
        chip.advance(10_000);
        assert!(chip.take_fault().is_some_and(|bad| bad.what.contains("PB13")));
    }
}
