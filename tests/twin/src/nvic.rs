//! The registers on the private peripheral bus: interrupt controller, system control block, SysTick, MPU, cycle counter
//! (ARM DDI 0403, B3).
//!
//! This module tracks which exceptions are pending or active, and which the core may take. [`crate::cpu`] stacks the
//! frames and enforces the MPU regions ([`Nvic::regions`]). CPACR is storage; the FPU counts as off until it grants
//! full access. The fault registers hold the faults that [`crate::cpu`] reports.
//!
//! Glossary:
//! - *exception*: 2 NMI, 3 HardFault, 11 SVCall, 14 PendSV, 15 SysTick, 16 and up interrupts.
//! - *priority*: lower is more urgent: -2 NMI, -1 HardFault, 0 to 240 the rest in steps of 16 (four bits on this chip),
//!   [`THREAD`] when nothing is active.

use crate::registers::refuse;
use crate::{Cycles, Modelled, Storage, Unknown, Width};
use unicorn_engine::Prot;

/// Priority of thread mode, less urgent than any exception.
pub const THREAD: i32 = 256;
/// Number of interrupts of the chip.
const INTERRUPTS: usize = 102;
/// Exception number of NMI.
pub const NMI: usize = 2;
/// Exception number of HardFault.
pub const HARD_FAULT: usize = 3;
/// Exception number of SVCall.
pub const SV_CALL: usize = 11;
const PEND_SV: usize = 14;
const SYS_TICK: usize = 15;
const FIRST_INTERRUPT: usize = 16;
/// The exceptions below the interrupts, which are always enabled, and all that exist, as bits.
const SYSTEM: u128 = (1 << FIRST_INTERRUPT) - 1;
const EXISTING: u128 = (1 << (FIRST_INTERRUPT + INTERRUPTS)) - 1;

/// The four implemented priority bits.
const PRIORITY_BITS: u8 = 0xf0;

registers! { u32:
    // Requests a reset.
    AIRCR 0xd0c { SYSRESETREQ 2 },
    SCR 0xd10 { SEVONPEND 4 },
    CFSR 0xd28,
    HFSR 0xd2c,
    MMFAR 0xd34,
    BFAR 0xd38,
    CPACR 0xd88,
    // Enabled; also enabled in the handlers of NMI and HardFault; default memory map outside the regions.
    MPU_CTRL 0xd94 { MPU_ENABLE 0, MPU_IN_FAULTS 1, MPU_BACKGROUND 2 },
    MPU_RNR 0xd98,
    MPU_RBAR 0xd9c,
    DEMCR 0xdfc,
}
/// AIRCR: the key that a write must carry.
const VECTKEY: u32 = 0x05fa;
/// CPACR: full access to the FPU.
const FPU_ACCESS: u32 = 0xf << 20;

/// Interrupt priorities, and those of the exceptions 4 to 15, each a byte.
const IPR: u32 = 0x400;
const IPR_END: u32 = 0x468;
const SHPR: u32 = 0xd18;
const SHPR_END: u32 = 0xd24;
/// End of RASR and of the three aliases of RBAR and RASR.
const MPU_END: u32 = 0xdbc;
/// Number of MPU regions (PM0214 4.5).
const REGIONS: usize = 8;

/// Access that the MPU grants privileged code in an address range (B3.5.9).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First address.
    pub start: u32,
    /// Size \[bytes\].
    pub len: u32,
    /// What is granted.
    pub access: Prot,
}

impl Region {
    /// Whether it contains an address.
    pub fn contains(&self, address: u32) -> bool {
        address.wrapping_sub(self.start) < self.len
    }

    /// Decodes RBAR and RASR; none if the region is disabled.
    fn decode(base: u32, attributes: u32) -> Modelled<Option<Self>> {
        if attributes & 1 == 0 {
            return Ok(None);
        }
        let size = attributes >> 1 & 0x1f;
        if !(9..31).contains(&size) || attributes & 0xff00 != 0 {
            return refuse("MPU regions below 1 KB, of 4 GB or with disabled subregions are not modelled");
        }
        let len = 2 << size;
        let access = match attributes >> 24 & 7 {
            0 => Prot::NONE,
            1..=3 => Prot::READ | Prot::WRITE,
            5..=7 => Prot::READ,
            _ => return refuse("MPU_RASR.AP: reserved"),
        };
        let execute = if access == Prot::NONE || attributes & 1 << 28 != 0 { Prot::NONE } else { Prot::EXEC };
        Ok(Some(Self { start: base & !(len - 1), len, access: access | execute }))
    }
}

/// The core's mask registers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Masks {
    /// PRIMASK: masks everything but NMI and HardFault.
    pub primask: bool,
    /// FAULTMASK: masks everything but NMI.
    pub faultmask: bool,
    /// BASEPRI: masks this priority and all less urgent ones; 0 masks nothing.
    pub basepri: u8,
}

#[derive(Clone, Copy, Debug)]
struct Active {
    exception: usize,
    priority: i32,
}

#[derive(Clone, Copy, Debug, Default)]
struct SysTick {
    control: u32,
    reload: u32,
    /// Time at which the counter was last, or will next be, loaded.
    since: Cycles,
    counted: bool,
}

impl SysTick {
    /// Cycles per count: 1 if HCLK clocks the counter, 8 if HCLK / 8 does.
    fn divider(&self) -> u64 {
        if self.control & 4 != 0 { 1 } else { 8 }
    }

    fn period(&self) -> u64 {
        (u64::from(self.reload) + 1) * self.divider()
    }

    fn runs(&self) -> bool {
        self.control & 1 != 0 && self.reload > 0
    }

    fn current(&self, now: Cycles) -> u32 {
        if !self.runs() {
            return 0;
        }
        let counts = (now.saturating_sub(self.since) / self.divider()) % (u64::from(self.reload) + 1);
        self.reload - counts as u32
    }

    /// Whether the counter has reached zero since the last call.
    fn advance(&mut self, now: Cycles) -> bool {
        if !self.runs() || now < self.since + self.period() {
            return false;
        }
        let periods = (now - self.since) / self.period();
        self.since += periods * self.period();
        self.counted = true;
        true
    }
}

/// The registers on the private peripheral bus.
#[derive(Clone, Debug)]
pub struct Nvic {
    /// Bits by exception number: enabled, pending, and requests that are high.
    enabled: u128,
    pending: u128,
    lines: u128,
    nmi_line: bool,
    active: Vec<Active>,
    /// By exception number.
    priorities: [u8; FIRST_INTERRUPT + INTERRUPTS],
    group: u32,
    vector_table: u32,
    storage: Storage,
    /// RBAR (without the region number) and RASR of each region.
    regions: [(u32, u32); REGIONS],
    systick: SysTick,
    cycle_counter_on: bool,
    /// Cycles by which the cycle counter lags behind the machine's clock.
    cycle_counter_lag: u32,
    /// The event register, which SEV sets.
    pub event: bool,
    /// What was pending at the last check; anything else that is pending is new.
    seen: u128,
    /// The program requested a reset.
    pub reset_wanted: bool,
}

impl Default for Nvic {
    fn default() -> Self {
        let plain = |offset| (offset, 0, u32::MAX);
        Self {
            enabled: SYSTEM,
            pending: 0,
            lines: 0,
            nmi_line: false,
            active: Vec::new(),
            priorities: [0; FIRST_INTERRUPT + INTERRUPTS],
            group: 0,
            vector_table: 0,
            storage: Storage::new(&[
                // SCR, CCR, SHCSR, fault status and address registers.
                (SCR, 0, 0x1e),
                (0xd14, 0x200, 0x31b),
                plain(0xd24),
                (CFSR, 0, 0),
                (HFSR, 0, 0),
                plain(0xd30),
                plain(MMFAR),
                plain(BFAR),
                // CPACR, MPU_TYPE, MPU_CTRL, MPU_RNR; the region registers are separate.
                (CPACR, 0, FPU_ACCESS),
                (0xd90, 0x800, 0),
                (MPU_CTRL, 0, 7),
                (MPU_RNR, 0, 0xff),
                // DHCSR, DEMCR: no debugger is attached.
                (0xdf0, 0, 0),
                plain(DEMCR),
                // FPCCR, FPCAR, FPDSCR, MVFR0, MVFR1.
                (0xf34, 0xc000_0000, 0xc000_0000),
                plain(0xf38),
                plain(0xf3c),
                (0xf40, 0x1011_0021, 0),
                (0xf44, 0x1100_0011, 0),
            ]),
            regions: [(0, 0); REGIONS],
            systick: SysTick::default(),
            cycle_counter_on: false,
            cycle_counter_lag: 0,
            event: false,
            seen: 0,
            reset_wanted: false,
        }
    }
}

impl Nvic {
    /// Group priority of an exception, without the subpriority bits.
    fn priority(&self, exception: usize) -> i32 {
        match exception {
            NMI => -2,
            HARD_FAULT => -1,
            _ => self.group_priority(self.priorities[exception]),
        }
    }

    fn group_priority(&self, priority: u8) -> i32 {
        i32::from(priority) & !((2 << self.group) - 1)
    }

    /// Order of pending exceptions of equal group priority: subpriority, then exception number.
    fn order(&self, exception: usize) -> (i32, i32, usize) {
        (self.priority(exception), i32::from(self.priorities[exception]), exception)
    }

    fn active_exceptions(&self) -> u128 {
        self.active.iter().fold(0, |bits, active| bits | 1 << active.exception)
    }

    /// Pending exceptions. An interrupt whose request is still high becomes pending again when its handler ends.
    fn pending_exceptions(&self) -> u128 {
        self.pending | self.lines & !self.active_exceptions()
    }

    /// The most urgent exception that is pending and enabled, regardless of active exceptions and masks.
    fn candidate(&self) -> Option<usize> {
        let mut bits = self.pending_exceptions() & self.enabled;
        let numbers = std::iter::from_fn(|| {
            let number = (bits != 0).then(|| bits.trailing_zeros() as usize)?;
            bits &= bits - 1;
            Some(number)
        });
        numbers.min_by_key(|&exception| self.order(exception))
    }

    /// Execution priority of the core (B1.5.4).
    fn execution_priority(&self, masks: Masks) -> i32 {
        let active = self.active.iter().map(|active| active.priority).min().unwrap_or(THREAD);
        let base = if masks.basepri == 0 { THREAD } else { self.group_priority(masks.basepri) };
        let primask = if masks.primask { 0 } else { THREAD };
        let faultmask = if masks.faultmask { -1 } else { THREAD };
        active.min(base).min(primask).min(faultmask)
    }

    /// The exception that the core takes now, if any.
    pub fn takeable(&self, masks: Masks) -> Option<usize> {
        self.candidate().filter(|&exception| self.priority(exception) < self.execution_priority(masks))
    }

    /// Whether an exception is pending that only the masks may block.
    pub fn wants_attention(&self) -> bool {
        self.takeable(Masks::default()).is_some()
    }

    /// Whether WFI ends, which PRIMASK does not prevent.
    pub fn ends_wfi(&self, masks: Masks) -> bool {
        self.takeable(Masks { primask: false, ..masks }).is_some()
    }

    /// Sets the levels of the interrupt requests and of the NMI request.
    pub fn set_lines(&mut self, lines: u128, nmi: bool) {
        let lines = lines << FIRST_INTERRUPT;
        self.pending |= lines & !self.lines;
        self.lines = lines;
        if nmi && !self.nmi_line {
            self.pend_system(NMI);
        }
        self.nmi_line = nmi;
    }

    /// Makes an exception below 16 pending, for example one that an instruction causes.
    pub fn pend_system(&mut self, exception: usize) {
        self.pending |= 1 << exception;
    }

    /// Records a bus fault at this address. It escalates to HardFault, as BusFault is never enabled here.
    pub fn bus_fault(&mut self, address: u32) {
        self.storage[BFAR] = address;
        // PRECISERR, BFARVALID.
        self.hard_fault(1 << 9 | 1 << 15);
    }

    /// Records an access that the MPU forbids. It escalates to HardFault, as MemManage is never enabled here.
    pub fn protection_fault(&mut self, address: u32, executing: bool) {
        // IACCVIOL, or DACCVIOL with MMARVALID.
        let status = if executing { 1 << 0 } else { 1 << 1 | 1 << 7 };
        if !executing {
            self.storage[MMFAR] = address;
        }
        self.hard_fault(status);
    }

    /// The regions that the MPU currently enforces, in ascending precedence. Empty while the MPU is off, and in fault
    /// handlers if it does not apply there.
    pub fn regions(&self, masks: Masks) -> Vec<Region> {
        let control = self.storage[MPU_CTRL];
        let in_fault = masks.faultmask || self.active.iter().any(|active| active.priority < 0);
        if control & MPU_ENABLE == 0 || in_fault && control & MPU_IN_FAULTS == 0 {
            return Vec::new();
        }
        // A region without a model was refused at the write.
        self.regions.iter().filter_map(|&(base, attributes)| Region::decode(base, attributes).ok().flatten()).collect()
    }

    /// Records an undefined instruction, which escalates to HardFault.
    pub fn undefined_instruction(&mut self) {
        self.hard_fault(1 << 16);
    }

    /// Records a fault's bits in CFSR, and its escalation.
    fn hard_fault(&mut self, status: u32) {
        self.storage[CFSR] |= status;
        // FORCED.
        self.storage[HFSR] |= 1 << 30;
        self.pend_system(HARD_FAULT);
    }

    /// Makes an exception active; returns the address of its vector.
    pub fn enter(&mut self, exception: usize) -> u32 {
        self.active.push(Active { exception, priority: self.priority(exception) });
        self.pending &= !(1 << exception);
        // Forget what is no longer pending: if it becomes pending again, it is new.
        self.seen &= self.pending_exceptions();
        self.event = true;
        self.vector_table + 4 * exception as u32
    }

    /// Ends the exception entered last.
    pub fn leave(&mut self) -> Option<usize> {
        self.event = true;
        self.active.pop().map(|active| active.exception)
    }

    /// Number of active exceptions.
    pub fn depth(&self) -> usize {
        self.active.len()
    }

    /// Clears the event register, on which WFE waits; returns its previous value.
    pub fn take_event(&mut self) -> bool {
        std::mem::take(&mut self.event)
    }

    /// Whether CPACR grants full access to the FPU.
    pub fn fpu_is_on(&self) -> bool {
        self.storage[CPACR] & FPU_ACCESS == FPU_ACCESS
    }

    /// Advances SysTick to `now` and detects newly pending exceptions.
    pub fn advance(&mut self, now: Cycles) {
        if self.systick.advance(now) && self.systick.control & 2 != 0 {
            self.pend_system(SYS_TICK);
        }
        let pending = self.pending_exceptions();
        let new = pending & !self.seen != 0;
        self.seen = pending;
        if new && self.storage[SCR] & SEVONPEND != 0 {
            self.event = true;
        }
    }

    /// Time of the next SysTick exception.
    pub fn next_event(&self) -> Option<Cycles> {
        (self.systick.runs() && self.systick.control & 2 != 0).then(|| self.systick.since + self.systick.period())
    }

    fn control_state(&self) -> u32 {
        // As in IPSR; 0 in thread mode.
        let running = self.active.last().map_or(0, |active| active.exception) as u32;
        let pending = self.candidate().unwrap_or(0) as u32;
        let interrupt = u32::from(self.pending_exceptions() & !SYSTEM != 0);
        let bit = |exception: usize, at: u32| ((self.pending >> exception) as u32 & 1) << at;
        let base = u32::from(self.active.len() <= 1) << 11;
        running | base | pending << 12 | interrupt << 22 | bit(SYS_TICK, 26) | bit(PEND_SV, 28) | bit(NMI, 31)
    }

    /// A read on the private peripheral bus, 0xE000_0000 and up.
    pub fn read(&mut self, address: u32, width: Width, now: Cycles) -> Modelled<u32> {
        let word = match address & !3 {
            0xe000_1000 => 0x4000_0000 | u32::from(self.cycle_counter_on),
            0xe000_1004 => self.cycle_count(now),
            0xe000_e000..0xe000_f000 => self.read_scs(address & 0xffc, now)?,
            _ => return Err(Unknown::REGISTER),
        };
        Ok(width.part(word, address))
    }

    fn cycle_count(&self, now: Cycles) -> u32 {
        if self.cycle_counter_on { (now as u32).wrapping_sub(self.cycle_counter_lag) } else { self.cycle_counter_lag }
    }

    fn read_scs(&mut self, register: u32, now: Cycles) -> Modelled<u32> {
        // The word of a set of interrupts, 32 bits each.
        let word = |set: u128| (set >> shift(register)) as u32;
        Ok(match register {
            0x004 => 3,
            0x010 => self.systick.control | u32::from(std::mem::take(&mut self.systick.counted)) << 16,
            0x014 => self.systick.reload,
            0x018 => self.systick.current(now),
            0x01c => 0x8000_0000,
            0x100..0x110 | 0x180..0x190 => word(self.enabled),
            0x200..0x210 | 0x280..0x290 => word(self.pending_exceptions()),
            0x300..0x310 => word(self.active_exceptions()),
            IPR..IPR_END | SHPR..SHPR_END => {
                let priorities = self.priorities.iter().skip(first_priority(register)).take(4);
                priorities.zip([0, 8, 16, 24]).fold(0, |word, (byte, at)| word | u32::from(*byte) << at)
            }
            0xd00 => 0x410f_c241,
            0xd04 => self.control_state(),
            0xd08 => self.vector_table,
            AIRCR => 0xfa05_0000 | self.group << 8,
            MPU_RBAR..MPU_END => {
                let number = self.region();
                let (base, attributes) = self.regions[number];
                if register & 4 == MPU_RBAR & 4 { base | number as u32 } else { attributes }
            }
            _ => self.storage.load(register)?,
        })
    }

    /// A write on the private peripheral bus.
    pub fn write(&mut self, address: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        match address & !3 {
            0xe000_1000 => {
                let count = self.cycle_count(now);
                self.cycle_counter_on = value & 1 != 0;
                self.set_cycle_count(count, now);
                // All other bits are for profiling.
                if value & !1 & 0x0fff_ffff != 0 {
                    return refuse("DWT: only CYCCNT is modelled");
                }
                Ok(())
            }
            0xe000_1004 => {
                self.set_cycle_count(value, now);
                Ok(())
            }
            // The lock access register of the DWT, which an M4 does not have.
            0xe000_1fb0 => Ok(()),
            0xe000_e000..0xe000_f000 => self.write_scs(address & 0xfff, value, width, now),
            _ => Err(Unknown::REGISTER),
        }
    }

    /// The region that RBAR and RASR access.
    fn region(&self) -> usize {
        self.storage[MPU_RNR] as usize % REGIONS
    }

    /// A write to RBAR or RASR, or to one of their three aliases.
    fn write_region(&mut self, register: u32, value: u32) -> Modelled {
        let is_base = register & 4 == MPU_RBAR & 4;
        // VALID: the write includes the region number.
        if is_base && value & 1 << 4 != 0 {
            self.storage[MPU_RNR] = value & 0xf;
        }
        let number = self.region();
        let region = &mut self.regions[number];
        if is_base {
            region.0 = value & !0x1f;
        } else {
            region.1 = value;
        }
        Region::decode(region.0, region.1).map(|_| ())
    }

    fn set_cycle_count(&mut self, count: u32, now: Cycles) {
        self.cycle_counter_lag = if self.cycle_counter_on { (now as u32).wrapping_sub(count) } else { count };
    }

    fn write_scs(&mut self, register: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        let set = u128::from(value) << shift(register);
        let by_byte = matches!(register, IPR..IPR_END | SHPR..SHPR_END);
        if width != Width::Word && !by_byte {
            return Err(Unknown::WIDTH);
        }
        match register {
            0x010 => {
                if value & 1 != 0 && self.systick.control & 1 == 0 {
                    self.systick.since = now;
                }
                self.systick.control = value & 7;
            }
            0x014 => self.systick.reload = value & 0xff_ffff,
            0x018 => {
                self.systick.since = now;
                self.systick.counted = false;
            }
            0x100..0x110 => self.enabled |= set & EXISTING,
            0x180..0x190 => self.enabled &= !set,
            0x200..0x210 => self.pending |= set & EXISTING,
            0x280..0x290 => self.pending &= !set,
            IPR..IPR_END | SHPR..SHPR_END => {
                let priorities = self.priorities.iter_mut().skip(first_priority(register));
                for (priority, byte) in priorities.zip(value.to_le_bytes()).take(width.bytes() as usize) {
                    *priority = byte & PRIORITY_BITS;
                }
            }
            0xd04 => {
                let bit = |at: u32, exception: usize| u128::from(value >> at & 1) << exception;
                self.pending |= bit(31, NMI) | bit(28, PEND_SV) | bit(26, SYS_TICK);
                self.pending &= !(bit(27, PEND_SV) | bit(25, SYS_TICK));
            }
            0xd08 => self.vector_table = value & !0x7f,
            AIRCR => {
                if value >> 16 != VECTKEY {
                    return refuse("AIRCR written without VECTKEY");
                }
                self.group = value >> 8 & 7;
                self.reset_wanted |= value & SYSRESETREQ != 0;
            }
            // Writing 1 clears a bit.
            CFSR | HFSR => self.storage[register] &= !value,
            0xf00 => self.pending |= 1_u128 << (value & 0x7f) << FIRST_INTERRUPT & EXISTING,
            // Cache and branch predictor maintenance. An M4 has neither.
            0xf50..=0xf78 => {}
            MPU_CTRL if value & MPU_ENABLE != 0 && value & MPU_BACKGROUND == 0 => {
                return refuse("MPU without PRIVDEFENA is not modelled");
            }
            MPU_RBAR..MPU_END => self.write_region(register, value)?,
            _ => {
                self.storage.store(register, value, width)?;
            }
        }
        Ok(())
    }
}

/// Place, in a set of exceptions, of the interrupts that a register holds.
fn shift(register: u32) -> u32 {
    FIRST_INTERRUPT as u32 + 32 * ((register & 0xf) / 4)
}

/// The exception whose priority is at this place of NVIC_IPR or of SHPR, which begins with exception 4.
fn first_priority(register: u32) -> usize {
    if register < SHPR { FIRST_INTERRUPT + (register - IPR) as usize } else { 4 + (register - SHPR) as usize }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OPEN: Masks = Masks { primask: false, faultmask: false, basepri: 0 };

    fn write(nvic: &mut Nvic, register: u32, value: u32) {
        nvic.write(0xe000_e000 + register, value, Width::Word, 0).expect("modelled access");
    }

    fn read(nvic: &mut Nvic, register: u32, now: Cycles) -> u32 {
        nvic.read(0xe000_e000 + register, Width::Word, now).expect("modelled access")
    }

    /// Interrupts 5 (priority 0x60) and 6 (priority 0x20), both enabled.
    fn two() -> Nvic {
        let mut nvic = Nvic::default();
        write(&mut nvic, 0x100, 3 << 5);
        prioritise(&mut nvic, 5, 0x6f);
        prioritise(&mut nvic, 6, 0x20);
        nvic
    }

    fn prioritise(nvic: &mut Nvic, interrupt: u32, priority: u32) {
        nvic.write(0xe000_e000 + IPR + interrupt, priority, Width::Byte, 0).expect("modelled access");
    }

    #[test]
    fn the_more_urgent_goes_first_and_interrupts_the_other() {
        let mut nvic = two();
        write(&mut nvic, 0xf00, 5);
        assert_eq!(nvic.takeable(OPEN), Some(21));
        assert_eq!(nvic.enter(21), 84);
        assert_eq!(nvic.takeable(OPEN), None);
        write(&mut nvic, 0x200, 3 << 5);
        assert_eq!(nvic.takeable(OPEN), Some(22), "6 interrupts 5; 5 does not interrupt itself");
        nvic.enter(22);
        assert_eq!((nvic.depth(), nvic.takeable(OPEN)), (2, None));
        assert_eq!(read(&mut nvic, 0x300, 0), 3 << 5);
        assert_eq!(nvic.leave(), Some(22));
        assert_eq!(nvic.takeable(OPEN), None);
        nvic.leave();
        assert_eq!(nvic.takeable(OPEN), Some(21), "5 was pended again while it ran");
    }

    #[test]
    fn equal_priorities_go_by_number_and_do_not_interrupt() {
        let mut nvic = two();
        write(&mut nvic, 0x404, 0);
        write(&mut nvic, 0x200, 3 << 5);
        assert_eq!(nvic.takeable(OPEN), Some(21));
        nvic.enter(21);
        assert_eq!(nvic.takeable(OPEN), None);
    }

    #[test]
    fn groups_order_without_interrupting() {
        let mut nvic = two();
        // PRIGROUP leaves two bits for the group: 0x60 and 0x40 are in the same group.
        write(&mut nvic, 0xd0c, VECTKEY << 16 | 5 << 8);
        prioritise(&mut nvic, 6, 0x40);
        write(&mut nvic, 0x200, 3 << 5);
        assert_eq!(nvic.takeable(OPEN), Some(22));
        write(&mut nvic, 0x280, 2 << 5);
        nvic.enter(21);
        write(&mut nvic, 0x200, 2 << 5);
        assert_eq!(nvic.takeable(OPEN), None);
    }

    #[test]
    fn masks() {
        let mut nvic = two();
        write(&mut nvic, 0x200, 1 << 5);
        assert_eq!(nvic.takeable(Masks { primask: true, ..OPEN }), None);
        assert!(nvic.wants_attention() && nvic.ends_wfi(Masks { primask: true, ..OPEN }));
        assert_eq!(nvic.takeable(Masks { basepri: 0x60, ..OPEN }), None);
        assert_eq!(nvic.takeable(Masks { basepri: 0x70, ..OPEN }), Some(21));
        nvic.set_lines(0, true);
        assert_eq!(nvic.takeable(Masks { primask: true, faultmask: true, basepri: 0x10 }), Some(NMI));
    }

    #[test]
    fn a_line_comes_back_until_it_falls() {
        let mut nvic = two();
        nvic.set_lines(1 << 5, false);
        nvic.enter(21);
        assert_eq!(read(&mut nvic, 0x200, 0), 0, "served");
        nvic.leave();
        assert_eq!(nvic.takeable(OPEN), Some(21), "the handler did not clear the cause");
        nvic.enter(21);
        nvic.set_lines(0, false);
        nvic.leave();
        assert_eq!(nvic.takeable(OPEN), None);
    }

    #[test]
    fn a_pending_interrupt_is_an_event_once() {
        let mut nvic = two();
        nvic.set_lines(1 << 9, false);
        nvic.advance(0);
        assert!(!nvic.take_event(), "without SEVONPEND");
        write(&mut nvic, SCR, SEVONPEND);
        nvic.advance(0);
        assert!(!nvic.take_event(), "it was pending before");
        nvic.set_lines(1 << 9 | 1 << 10, false);
        nvic.advance(0);
        assert!(nvic.take_event(), "also one that is not enabled");
        nvic.advance(0);
        assert!(!nvic.take_event());
        // Served and raised again: newly pending.
        write(&mut nvic, 0x100, 1 << 9);
        nvic.enter(25);
        nvic.set_lines(0, false);
        nvic.leave();
        nvic.take_event();
        nvic.advance(0);
        nvic.set_lines(1 << 9, false);
        nvic.advance(0);
        assert!(nvic.take_event());
    }

    #[test]
    fn systick_counts_down_and_interrupts() {
        let mut nvic = Nvic::default();
        write(&mut nvic, 0x014, 99);
        write(&mut nvic, 0x010, 7);
        assert_eq!((read(&mut nvic, 0x018, 0), read(&mut nvic, 0x018, 30)), (99, 69));
        assert_eq!(nvic.next_event(), Some(100));
        nvic.advance(99);
        assert_eq!(nvic.takeable(OPEN), None);
        nvic.advance(100);
        assert_eq!(nvic.takeable(OPEN), Some(SYS_TICK));
        assert_eq!(read(&mut nvic, 0x010, 100), 0x1_0007);
        assert_eq!(read(&mut nvic, 0x010, 100), 7, "reading clears the flag");
        assert_eq!(nvic.next_event(), Some(200));
    }

    #[test]
    fn the_cycle_counter_can_be_set_and_stopped() {
        let mut nvic = Nvic::default();
        let mut at = |address: u32, value: u32, now| nvic.write(0xe000_1000 + address, value, Width::Word, now);
        assert_eq!(at(0, 1, 1000), Ok(()));
        assert_eq!(at(4, 0, 2000), Ok(()));
        assert_eq!(nvic.read(0xe000_1004, Width::Word, 2345), Ok(345));
        nvic.write(0xe000_1000, 0, Width::Word, 2400).expect("modelled access");
        assert_eq!(nvic.read(0xe000_1004, Width::Word, 9999), Ok(400));
    }

    #[test]
    fn the_protection_unit_has_regions_outside_of_the_handlers_of_faults() {
        let mut nvic = Nvic::default();
        write(&mut nvic, 0xd98, 2);
        write(&mut nvic, 0xd9c, 0x2000_4000);
        write(&mut nvic, 0xda0, 1 << 28 | 9 << 1 | 1);
        assert_eq!(nvic.regions(OPEN), [], "it is off");
        assert!(nvic.write(0xe000_ed94, 1, Width::Word, 0).is_err(), "no access to anything else");
        write(&mut nvic, 0xd94, 5);
        let region = Region { start: 0x2000_4000, len: 1024, access: Prot::NONE };
        assert_eq!(nvic.regions(OPEN), [region]);
        assert!(region.contains(0x2000_43ff) && !region.contains(0x2000_4400));
        assert_eq!((read(&mut nvic, 0xd9c, 0), read(&mut nvic, 0xda0, 0)), (0x2000_4002, 0x1000_0013));
        assert_eq!(nvic.regions(Masks { faultmask: true, ..OPEN }), []);
        nvic.protection_fault(0x2000_4004, false);
        assert_eq!((read(&mut nvic, MMFAR, 0), read(&mut nvic, CFSR, 0)), (0x2000_4004, 0x82));
        nvic.enter(HARD_FAULT);
        assert_eq!(nvic.regions(OPEN), []);
        nvic.leave();
        assert!(nvic.write(0xe000_eda0, 4 << 1 | 1, Width::Word, 0).is_err(), "32 bytes");
    }

    #[test]
    fn reset_and_unit_access() {
        let mut nvic = Nvic::default();
        assert!(nvic.write(0xe000_ed0c, 4, Width::Word, 0).is_err(), "without the key");
        write(&mut nvic, 0xd0c, VECTKEY << 16 | SYSRESETREQ);
        assert!(nvic.reset_wanted);
        assert!(!nvic.fpu_is_on());
        write(&mut nvic, CPACR, 0xf << 20);
        assert!(nvic.fpu_is_on());
        nvic.bus_fault(0x1234);
        assert_eq!((read(&mut nvic, BFAR, 0), read(&mut nvic, HFSR, 0)), (0x1234, 1 << 30));
        assert_eq!(nvic.takeable(OPEN), Some(HARD_FAULT));
    }
}
