//! The core: unicorn executes the instructions; this module keeps time, enters and leaves exceptions, and sleeps.
//!
//! - *Time*: a hook before each block of instructions adds the number of instructions to the clock. It stops before the
//!   block if a peripheral event is due or an exception can be taken. Each access first advances the peripherals to its
//!   time.
//! - *Exceptions*: this module stacks and unstacks the frames, outside unicorn (ARM DDI 0403, B1.5.6 to B1.5.8). It
//!   stores the FPU frame at once whenever the FPU is in use, which a program cannot distinguish from lazy stacking.
//! - *Sleep*: time jumps to the next event.
//! - *Faults*: an access that nothing answers or an undefined instruction ends the run, unless [`Faults::Taken`].
//!
//! - *Protection*: the MPU regions become memory protections in unicorn; a change takes effect from the next block on.
//!
//! The core takes interrupts between blocks only, so up to about ten instructions later than the chip. Not modelled:
//! lazy stacking as such, tail chaining (return and entry cost 12 cycles each), flash wait states.
//! [`Cpu::count_cycles`] counts the cost of these, separately from the clock.

use crate::{
    Cycles, Unknown, Width,
    chip::{BadAccess, CCM_LEN, CCM_START, Chip, RAM_LEN, RAM_START, flash, rcc::Reset, rom},
    cycles::{Model, Range, timing},
    nvic::{HARD_FAULT, Masks, NMI, Nvic, Region, SV_CALL},
};
use unicorn_engine::{Arch, ArmCpuModel, HookType, MemType, Mode, Prot, RegisterARM as R, UcHookId, Unicorn, uc_error};

/// Cycles from an exception's request to its handler's first instruction, and for the return (DDI 0439, 3.9).
const EXCEPTION_CYCLES: Cycles = 12;
/// CONTROL: the process stack is in use; the FPU is in use.
const SPSEL: u32 = 1 << 1;
const FPCA: u32 = 1 << 2;
/// XPSR: the IT state of the following instructions.
const IT: u64 = 0x0600_fc00;
/// Unicorn's exception numbers (QEMU, target/arm/cpu.h).
const EXCP_SWI: u32 = 2;
const EXCP_BKPT: u32 = 7;
const EXCP_EXCEPTION_EXIT: u32 = 8;
/// A branch to an address from here on is an exception return.
const EXC_RETURN: u32 = 0xffff_ff00;
/// Start addresses of the parts of SRAM1 and SRAM2. SRAM1 has three parts (public firmware's reading of ES0430 2.2.7;
/// RM0440 2.4).
pub const SRAM_CUTS: [u32; 4] = [0x2000_0000, 0x2000_8000, 0x2001_0000, 0x2001_4000];
/// End of the last part.
const SRAM_END: u32 = 0x2001_8000;
/// What [`Stop`] calls an instruction fetch.
const EXECUTION: &str = "execution at";
const WFE: u16 = 0xbf20;
const SEV: u16 = 0xbf40;

/// What happens when the program faults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Faults {
    /// The run ends. A correct program never faults.
    #[default]
    EndTheRun,
    /// HardFault is taken, as on the chip.
    Taken,
}

/// Why a run ended early.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Stop {
    /// The program entered the boot loader in ROM.
    #[error("the program entered the boot loader in ROM")]
    Bootloader,
    /// The chip started with option bytes that select SRAM1.
    #[error("the option bytes select a boot from SRAM1")]
    Ram,
    /// Power failed during a flash operation, as the test requested.
    #[error("power failed during a flash operation")]
    PowerFailed,
    /// An access that no model handles.
    #[error("{0}")]
    Bus(BadAccess),
    /// A memory access that nothing answers.
    #[error("{what} {address:#010x}: unmapped address")]
    Unmapped {
        /// Read of, write to, execution at.
        what: &'static str,
        /// Address of the access.
        address: u32,
    },
    /// A memory access that the MPU forbids.
    #[error("{what} {address:#010x}: forbidden by the MPU")]
    Protected {
        /// Read of, write to, execution at.
        what: &'static str,
        /// Address of the access.
        address: u32,
    },
    /// An undefined instruction. A panic usually ends with one.
    #[error("undefined instruction")]
    Undefined,
    /// A breakpoint without a debugger.
    #[error("breakpoint")]
    Breakpoint,
    /// A fault while handling one.
    #[error("lock-up: a fault in a fault handler")]
    LockUp,
    /// An FPU instruction before CPACR enabled the FPU.
    #[error("FPU instruction while the FPU is disabled (CPACR)")]
    FloatingPointOff,
    /// An exception frame does not fit.
    #[error("exception frame at {0:#010x} is outside RAM or forbidden by the MPU")]
    Stack(u32),
    /// An exception return with no exception active.
    #[error("exception return {0:#010x} while no exception is active")]
    Return(u32),
    /// An error of the emulator itself.
    #[error("unicorn: {0}")]
    Emulator(String),
}

/// The result of a run or of a step of the core, or the reason why the run ends.
pub type Ran<T = ()> = Result<T, Stop>;

/// A basic block of the program: it executes from its first instruction to its last.
#[derive(Clone, Copy, Debug, Default)]
struct Block {
    bytes: u32,
    instructions: u32,
    sends_event: bool,
}

impl Block {
    /// Decodes instruction lengths only: a halfword of 0xe800 or more starts a 32-bit instruction (DDI 0403, A5.1).
    fn decode(code: &[u8]) -> Self {
        let mut block = Self { bytes: code.len() as u32, ..Self::default() };
        let mut halves = timing::halves(code);
        while let Some(half) = halves.next() {
            block.instructions += 1;
            block.sends_event |= half == SEV;
            if half >= 0xe800 {
                halves.next();
            }
        }
        block
    }
}

/// Why unicorn returned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Pause {
    /// The core executed WFI, which makes unicorn return.
    #[default]
    Itself,
    /// An event or exception is due before the next block.
    Attention,
    /// WFE.
    Event,
    /// One of unicorn's exception numbers.
    Exception(u32),
}

/// State that the hooks share with the run loop.
pub struct Core {
    /// The chip around the core.
    pub chip: Chip,
    /// The registers on the private peripheral bus.
    pub nvic: Nvic,
    now: Cycles,
    /// Time of the next event.
    deadline: Cycles,
    /// End of the run.
    limit: Cycles,
    pause: Pause,
    asleep: Option<Sleep>,
    /// An exception is pending that only the masks may block.
    check: bool,
    stop: Option<Stop>,
    /// Address of the block in execution, and of the block with an access that no model handles.
    block: u32,
    failed: Option<u32>,
    /// An access that nothing answered, until its fault is handled.
    unmapped: Option<(&'static str, u32)>,
    blocks: Vec<Block>,
    /// Parts of SRAM1 and SRAM2 not written since the reset, if the first write to each is to be lost.
    untouched: [bool; SRAM_CUTS.len()],
    /// Writes to undo: address, and the old bytes.
    losing: Vec<(u32, Vec<u8>)>,
    /// Addresses of the lost writes since power-on that would have changed the memory.
    pub lost_writes: Vec<u32>,
    /// Addresses of the first write to each part.
    pub first_writes: Vec<u32>,
    /// Instructions executed since power-on.
    pub instructions: u64,
    /// Cycles spent asleep since power-on.
    pub slept: Cycles,
    /// Exceptions taken since power-on, by number.
    pub taken: [u64; 128],
    /// Maximum number of exceptions active at once.
    pub deepest: usize,
    /// The cycle model, if counting is enabled.
    model: Option<Box<Model>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sleep {
    /// WFE.
    Event,
    /// WFI.
    Interrupt,
}

impl Core {
    /// Updates the interrupt requests and the time of the next event.
    fn refresh(&mut self) {
        self.refresh_requests();
        self.refresh_deadline();
    }

    fn refresh_requests(&mut self) {
        self.nvic.set_lines(self.chip.irq_lines(), self.chip.nmi());
        self.nvic.advance(self.now);
        self.check = self.nvic.wants_attention();
    }

    fn refresh_deadline(&mut self) {
        let events = [self.chip.next_event(), self.nvic.next_event()];
        self.deadline = events.into_iter().flatten().min().map_or(self.limit, |event| event.min(self.limit));
    }

    /// Advances the peripherals to the current time.
    fn advance(&mut self) {
        self.chip.advance(self.now);
        if let Some(bad) = self.chip.take_fault() {
            self.stop.get_or_insert(Stop::Bus(bad));
        }
        if self.chip.flash.power_fails(self.now) {
            self.stop.get_or_insert(Stop::PowerFailed);
        }
        self.refresh();
    }

    fn after_access(&mut self, is_write: bool) {
        self.now += self.chip.flash.take_stall();
        if let Some(bad) = self.chip.take_fault() {
            self.stop.get_or_insert(Stop::Bus(bad));
        }
        self.refresh_requests();
        // A read of a register alone brings no event forward, and programs poll.
        if is_write || self.chip.has_moved {
            self.refresh_deadline();
        }
        if self.stop.is_some() || self.reset_wanted().is_some() {
            self.deadline = 0;
        }
    }

    fn reset_wanted(&self) -> Option<Reset> {
        if self.nvic.reset_wanted { Some(Reset::Software) } else { self.chip.reset_wanted() }
    }

    /// Writes this value to a bus or, if there is none, reads. Returns the word read; 0 for a write and for an access
    /// that no model handles.
    fn access(&mut self, address: u32, bytes: usize, value: Option<u32>) -> u32 {
        let Some(width) = Width::of(bytes) else { return 0 };
        let outcome = if is_private(address) {
            let outcome = match value {
                None => self.nvic.read(address, width, self.now),
                Some(value) => self.nvic.write(address, value, width, self.now).map(|()| 0),
            };
            outcome.map_err(|Unknown { what }| {
                let offset = address - PRIVATE;
                BadAccess { address, peripheral: "core", offset, width, value, what }
            })
        } else {
            self.chip.access(address, width, value, self.now)
        };
        let word = outcome.unwrap_or_else(|bad| {
            self.stop.get_or_insert(Stop::Bus(bad));
            self.failed.get_or_insert(self.block);
            0
        });
        self.model(|model, _| model.register(address));
        self.after_access(value.is_some());
        // A change of a region takes effect from the next block on.
        if value.is_some() && (MPU..MPU + 0x30).contains(&address) {
            self.deadline = 0;
        }
        word
    }

    /// Reads a vector. MEM_MODE selects the memory at address 0: flash, or the ROM, whose handlers are not modelled.
    fn vector(&self, address: u32) -> Option<u32> {
        let from_flash = address < flash::LEN as u32 && self.chip.syscfg.mem_mode() == 0;
        let word = self.code(if from_flash { flash::START + address } else { address }, 4)?;
        word.first_chunk().copied().map(u32::from_le_bytes)
    }

    fn code(&self, address: u32, len: u32) -> Option<&[u8]> {
        self.chip.bytes(address, len as usize)
    }

    /// Calls `tell` with the cycle model, if counting is enabled.
    fn model(&mut self, tell: impl FnOnce(&mut Model, &Self)) {
        if let Some(mut model) = self.model.take() {
            tell(&mut model, self);
            self.model = Some(model);
        }
    }

    /// Cycles spent awake since [`Cpu::count_cycles`].
    pub fn cycles(&self) -> Option<Range> {
        self.model.as_ref().map(|model| model.total(self.chip.transfers))
    }

    /// Returns a block of code, decoded once and then cached.
    fn look_up(&mut self, address: u32, bytes: u32) -> Block {
        let slot = (address.wrapping_sub(flash::START) / 2) as usize;
        if let Some(block) = self.blocks.get(slot).filter(|block| block.bytes == bytes) {
            return *block;
        }
        let block = self.code(address, bytes).map(Block::decode).unwrap_or_default();
        if let Some(place) = self.blocks.get_mut(slot) {
            *place = block;
        }
        block
    }
}

/// The private peripheral bus, and the part of it that the chip handles.
const PRIVATE: u32 = 0xe000_0000;
const DEBUG: u32 = 0xe004_2000;
/// The MPU.
const MPU: u32 = 0xe000_ed90;

fn is_private(address: u32) -> bool {
    address >= PRIVATE && !(DEBUG..DEBUG + 0x400).contains(&address)
}

/// The core with its chip.
pub struct Cpu {
    uc: Unicorn<'static, Core>,
    /// What happens when the program faults.
    pub faults: Faults,
    /// The regions last set in unicorn.
    regions: Vec<Region>,
    /// The hook that sees writes, until the first write to each part is lost.
    writes: Option<UcHookId>,
    /// The hook that sees accesses to memory, while cycles are counted.
    accesses: Option<UcHookId>,
}

/// Registers of an exception frame in ascending address order; return address and XPSR follow.
const FRAME: [R; 6] = [R::R0, R::R1, R::R2, R::R3, R::R12, R::LR];
/// S0 to S15, which unicorn numbers in this order.
const FLOATS: std::ops::Range<i32> = R::S0 as i32..R::S16 as i32;

impl From<uc_error> for Stop {
    fn from(error: uc_error) -> Self {
        Self::Emulator(format!("{error:?}"))
    }
}

impl Cpu {
    /// A core on this chip, whose flash is already loaded. Call [`Self::reset`] before running.
    pub fn new(chip: Chip) -> Ran<Self> {
        let core = Core {
            chip,
            nvic: Nvic::default(),
            now: 0,
            deadline: 0,
            limit: 0,
            pause: Pause::Itself,
            asleep: None,
            check: false,
            stop: None,
            block: 0,
            failed: None,
            unmapped: None,
            blocks: vec![Block::default(); flash::BANK / 2],
            untouched: [false; SRAM_CUTS.len()],
            first_writes: Vec::new(),
            losing: Vec::new(),
            lost_writes: Vec::new(),
            instructions: 0,
            slept: 0,
            taken: [0; 128],
            deepest: 0,
            model: None,
        };
        let mut uc = Unicorn::new_with_data(Arch::ARM, Mode::THUMB | Mode::MCLASS, core)?;
        uc.ctl_set_cpu_model(ArmCpuModel::CORTEX_M4 as i32)?;
        map(&mut uc)?;
        hook(&mut uc)?;
        Ok(Self { uc, faults: Faults::default(), regions: Vec::new(), writes: None, accesses: None })
    }

    /// Counts cycles from now on ([`Core::cycles`]), which about doubles the run time on the host.
    pub fn count_cycles(&mut self) -> Ran {
        self.count_no_cycles()?;
        let core = self.core_mut();
        core.model = Some(Box::new(Model::new(core.chip.transfers)));
        let seen = |uc: &mut Unicorn<Core>, _: MemType, address: u64, len: usize, _: i64| {
            uc.get_data_mut().model(|model, core| model.data(address as u32, len, &core.chip.flash.access()));
            // Before a hook call unicorn stores the IT state in XPSR, and its translated code would leave it set for
            // the next block.
            let status = uc.reg_read(R::XPSR).unwrap_or(0);
            status & IT == 0 || uc.reg_write(R::XPSR, status & !IT).is_ok()
        };
        let (accesses, end) = (HookType::MEM_READ | HookType::MEM_WRITE, RAM_START + RAM_LEN as u32 - 1);
        self.accesses = Some(self.uc.add_mem_hook(accesses, flash::START.into(), end.into(), seen)?);
        // Translated code does not call a newly added hook.
        self.forget_code()
    }

    /// Stops counting, so that the program runs fast again.
    pub fn count_no_cycles(&mut self) -> Ran {
        self.core_mut().model = None;
        let Some(hook) = self.accesses.take() else { return Ok(()) };
        self.uc.remove_hook(hook)?;
        self.forget_code()
    }

    /// The core and the chip.
    pub fn core(&self) -> &Core {
        self.uc.get_data()
    }

    /// The core and the chip, to be changed between runs.
    pub fn core_mut(&mut self) -> &mut Core {
        self.uc.get_data_mut()
    }

    /// Cycles since power-on.
    pub fn now(&self) -> Cycles {
        self.core().now
    }

    /// Value of a core register, given by its name or by unicorn's number.
    pub fn register(&self, register: impl Into<i32>) -> u32 {
        self.uc.reg_read(register).map_or(0, |value| value as u32)
    }

    /// Changes a register between runs.
    pub fn set(&mut self, register: impl Into<i32>, value: u32) -> Ran {
        Ok(self.uc.reg_write(register, u64::from(value))?)
    }

    /// Sets the flash size that the chip reports \[KB\].
    pub fn set_flash_kb(&mut self, kb: u16) -> Ran {
        Ok(self.uc.mem_write(rom::FLASH_KB_AT.into(), &kb.to_le_bytes())?)
    }

    /// Address of the instruction; after an access that no model handles, the start of the block that made it.
    pub fn pc(&self) -> u32 {
        self.core().failed.unwrap_or_else(|| self.register(R::PC) & !1)
    }

    fn masks(uc: &Unicorn<Core>) -> Masks {
        let read = |register: R| uc.reg_read(register).unwrap_or(0);
        Masks {
            primask: read(R::PRIMASK) & 1 != 0,
            faultmask: read(R::FAULTMASK) & 1 != 0,
            basepri: read(R::BASEPRI) as u8,
        }
    }

    /// Arms the erratum that loses the first write to each SRAM part, if it applies.
    fn lose_first_writes(&mut self) -> Ran {
        if !self.core().chip.errata().first_write_lost {
            return Ok(());
        }
        self.core_mut().untouched = [true; SRAM_CUTS.len()];
        if self.writes.is_none() {
            let end = u64::from(SRAM_END) - 1;
            let hook = |uc: &mut Unicorn<Core>, _: MemType, address: u64, len: usize, _: i64| {
                let (core, address) = (uc.get_data_mut(), address as u32);
                let which = SRAM_CUTS.partition_point(|start| *start <= address) - 1;
                if std::mem::take(&mut core.untouched[which]) {
                    core.first_writes.push(address);
                    // The write happens after this hook; it is undone before the next block.
                    core.losing.extend(core.chip.bytes(address, len).map(|old| (address, old.to_vec())));
                    core.deadline = 0;
                }
                true
            };
            self.writes = Some(self.uc.add_mem_hook(HookType::MEM_WRITE, RAM_START.into(), end, hook)?);
        }
        Ok(())
    }

    /// Undoes the writes that are lost.
    fn lose_write(&mut self) -> Ran {
        let core = self.core_mut();
        for (address, old) in std::mem::take(&mut core.losing) {
            let Some(place) = core.chip.ram_mut(address, old.len()) else { continue };
            let changed = *place != *old;
            place.copy_from_slice(&old);
            if changed {
                core.lost_writes.push(address);
            }
        }
        if core.untouched == [false; SRAM_CUTS.len()]
            && let Some(hook) = self.writes.take()
        {
            self.uc.remove_hook(hook)?;
        }
        Ok(())
    }

    /// Starts from the vectors in flash.
    pub fn reset(&mut self) -> Ran {
        self.lose_first_writes()?;
        let core = self.core_mut();
        core.nvic = Nvic::default();
        core.pause = Pause::Itself;
        // Thread mode first: the other registers depend on it.
        self.set(R::XPSR, 1 << 24)?;
        for register in [R::CONTROL, R::PRIMASK, R::FAULTMASK, R::BASEPRI, R::FPSCR] {
            self.set(register, 0)?;
        }
        self.set(R::LR, u32::MAX)?;
        self.jump()
    }

    /// Starts at the ROM's boot loader vectors, after a start that selects the ROM.
    pub fn enter_rom(&mut self) -> Ran {
        let [stack, start] = rom::VECTORS;
        self.set(R::SP, stack)?;
        self.set(R::PC, start)
    }

    /// Lets time pass without executing instructions.
    pub fn pass(&mut self, cycles: Cycles) -> Ran {
        let core = self.core_mut();
        core.now += cycles;
        core.limit = core.limit.max(core.now);
        core.advance();
        core.stop.take().map_or(Ok(()), Err)
    }

    /// Discards decoded and translated code after the program in flash has changed.
    pub fn forget_code(&mut self) -> Ran {
        let core = self.core_mut();
        core.blocks.fill(Block::default());
        core.model(|model, _| model.forget_code());
        Ok(self.uc.ctl_flush_tb()?)
    }

    /// Enters the program in flash as a boot loader does: SP and PC come from its vectors, everything else stays.
    pub fn jump(&mut self) -> Ran {
        let core = self.core_mut();
        (core.asleep, core.stop, core.failed, core.unmapped) = (None, None, None, None);
        let vector = |at: u32| core.vector(flash::START + at).unwrap_or(0);
        let (stack, start) = (vector(0), vector(4));
        self.set(R::SP, stack)?;
        self.set(R::PC, start | 1)
    }

    /// Runs until `until`: exactly if the core sleeps then, else to the end of the block. A reset request ends the run
    /// early.
    pub fn run(&mut self, until: Cycles) -> Ran<Option<Reset>> {
        self.core_mut().limit = until;
        loop {
            let core = self.core_mut();
            core.advance();
            self.sleep();
            let core = self.core_mut();
            if let Some(stop) = core.stop.take() {
                return Err(stop);
            }
            if let Some(reset) = core.reset_wanted() {
                return Ok(Some(reset));
            }
            if core.now >= until {
                return Ok(None);
            }
            if core.check {
                let masks = Self::masks(&self.uc);
                if let Some(exception) = self.core().nvic.takeable(masks) {
                    self.enter(exception)?;
                    self.core_mut().refresh();
                }
            }
            self.execute()?;
        }
    }

    /// Advances time from event to event while the core sleeps.
    fn sleep(&mut self) {
        let masks = Self::masks(&self.uc);
        let core = self.core_mut();
        while let Some(sleep) = core.asleep {
            let awake = match sleep {
                Sleep::Event => core.nvic.take_event() || core.nvic.takeable(masks).is_some(),
                Sleep::Interrupt => core.nvic.ends_wfi(masks),
            };
            if awake {
                core.asleep = None;
            }
            if awake || core.now >= core.limit || core.stop.is_some() {
                return;
            }
            let next = core.deadline.clamp(core.now, core.limit);
            core.slept += next - core.now;
            core.now = next;
            core.advance();
            if core.reset_wanted().is_some() {
                return;
            }
        }
    }

    /// Applies the MPU's regions to unicorn.
    fn protect(&mut self) -> Ran {
        let regions = self.core().nvic.regions(Self::masks(&self.uc));
        if regions == self.regions {
            return Ok(());
        }
        let everything = |region: &Region| Region { access: Prot::READ | Prot::WRITE, ..*region };
        let before: Vec<Region> = self.regions.iter().map(everything).collect();
        for region in before.iter().chain(&regions) {
            if !(RAM_START..RAM_START + RAM_LEN as u32).contains(&region.start) {
                return Err(Stop::Emulator("MPU region outside SRAM is not modelled".into()));
            }
            self.uc.mem_protect(region.start.into(), region.len.into(), region.access)?;
        }
        self.regions = regions;
        Ok(())
    }

    /// Runs unicorn until something must be handled.
    fn execute(&mut self) -> Ran {
        self.protect()?;
        self.core_mut().pause = Pause::Itself;
        let pc = self.register(R::PC);
        let outcome = self.uc.emu_start(u64::from(pc | 1), 0, 0, 0);
        if self.writes.is_some() {
            self.lose_write()?;
        }
        let pc = self.register(R::PC);
        let core = self.core_mut();
        let pause = std::mem::take(&mut core.pause);
        if core.stop.is_some() {
            return Ok(());
        }
        if pc >= EXC_RETURN || pause == Pause::Exception(EXCP_EXCEPTION_EXIT) {
            return self.leave(pc | 1);
        }
        if let Err(error) = outcome {
            return self.fault(error);
        }
        match pause {
            Pause::Attention => {}
            Pause::Event => core.asleep = (!core.nvic.take_event()).then_some(Sleep::Event),
            Pause::Itself => core.asleep = Some(Sleep::Interrupt),
            Pause::Exception(EXCP_SWI) => core.nvic.pend_system(SV_CALL),
            Pause::Exception(EXCP_BKPT) => return Err(Stop::Breakpoint),
            Pause::Exception(number) => return Err(Stop::Emulator(format!("exception {number}"))),
        }
        Ok(())
    }

    fn fault(&mut self, error: uc_error) -> Ran {
        let taken = self.faults == Faults::Taken;
        let regions = self.regions.clone();
        let core = self.core_mut();
        let stop = match (core.unmapped.take(), error) {
            (Some((what, address)), _) if regions.iter().any(|region| region.contains(address)) => {
                core.nvic.protection_fault(address, what == EXECUTION);
                Stop::Protected { what, address }
            }
            (Some((what, address)), _) => {
                core.nvic.bus_fault(address);
                Stop::Unmapped { what, address }
            }
            (None, uc_error::INSN_INVALID) => {
                core.nvic.undefined_instruction();
                Stop::Undefined
            }
            (None, error) => return Err(error.into()),
        };
        let masks = Self::masks(&self.uc);
        match taken {
            true if self.core().nvic.takeable(masks).is_some() => Ok(()),
            true => Err(Stop::LockUp),
            false => Err(stop),
        }
    }

    /// Stacks the frame of an exception and enters its handler (B1.5.6).
    fn enter(&mut self, exception: usize) -> Ran {
        let control = self.register(R::CONTROL);
        let thread = self.core().nvic.depth() == 0;
        let floats = control & FPCA != 0;
        let before = self.register(R::SP);
        let stack = before.wrapping_sub(if floats { 0x68 } else { 0x20 }) & !7;
        // Bit 9 records that the stack pointer was realigned to a multiple of eight.
        let status = self.register(R::XPSR) & !(1 << 9) | (before & 4) << 7;
        let mut frame: Vec<u32> = FRAME.iter().map(|&register| self.register(register)).collect();
        frame.extend([self.register(R::PC) & !1, status]);
        if floats {
            frame.extend(FLOATS.map(|register| self.register(register)));
            frame.extend([self.register(R::FPSCR), 0]);
        }
        let bytes: Vec<u8> = frame.iter().flat_map(|word| word.to_le_bytes()).collect();
        let masks = Self::masks(&self.uc);
        let core = self.core_mut();
        // A fault handler starts with the stack that caused the fault, whether or not the frame can be stored. This
        // model stores it.
        let into_fault = matches!(exception, NMI | HARD_FAULT);
        let forbids = |region: &Region| region.access & Prot::WRITE == Prot::NONE && region.contains(stack);
        if !into_fault && core.nvic.regions(masks).iter().any(forbids) {
            return Err(Stop::Stack(stack));
        }
        match core.chip.ram_mut(stack, bytes.len()) {
            Some(place) => place.copy_from_slice(&bytes),
            None => return Err(Stop::Stack(stack)),
        }
        self.set(R::SP, stack)?;
        let mode = match (thread, control & SPSEL != 0) {
            (true, true) => 0xd,
            (true, false) => 0x9,
            (false, _) => 0x1,
        };
        // The main stack first: in handler mode SPSEL can no longer be changed.
        self.set(R::CONTROL, control & !(SPSEL | FPCA))?;
        self.set(R::XPSR, 1 << 24 | exception as u32)?;
        self.set(R::LR, 0xffff_ffe0 | if floats { 0 } else { 0x10 } | mode)?;
        let core = self.core_mut();
        let vector = core.nvic.enter(exception);
        core.now += EXCEPTION_CYCLES;
        core.model(|model, core| model.enter(&core.chip.flash.access()));
        if let Some(count) = core.taken.get_mut(exception) {
            *count += 1;
        }
        core.deepest = core.deepest.max(core.nvic.depth());
        match core.vector(vector) {
            Some(handler) => self.set(R::PC, handler),
            None => Err(Stop::Unmapped { what: "vector at", address: vector }),
        }
    }

    /// Returns to the code that an exception interrupted (B1.5.8).
    fn leave(&mut self, exc_return: u32) -> Ran {
        let core = self.core_mut();
        let Some(ended) = core.nvic.leave() else { return Err(Stop::Return(exc_return)) };
        core.now += EXCEPTION_CYCLES;
        core.model(|model, _| model.leave());
        let floats = exc_return & 0x10 == 0;
        let process = exc_return & 0xf == 0xd;
        let to_thread = exc_return & 0x8 != 0;
        if to_thread != (core.nvic.depth() == 0) {
            return Err(Stop::Return(exc_return));
        }
        let stack = self.register(if process { R::PSP } else { R::SP });
        let words = if floats { 26 } else { 8 };
        let Some(bytes) = self.core().chip.bytes(stack, 4 * words) else { return Err(Stop::Stack(stack)) };
        let frame: Vec<u32> = bytes.as_chunks().0.iter().copied().map(u32::from_le_bytes).collect();
        let (pc, status) = (frame[6], frame[7]);
        let after = stack.wrapping_add(4 * words as u32 + if status & 1 << 9 != 0 { 4 } else { 0 });
        for (&register, &value) in FRAME.iter().zip(&frame) {
            self.set(register, value)?;
        }
        if floats {
            for (register, &value) in FLOATS.zip(&frame[8..]) {
                self.set(register, value)?;
            }
            self.set(R::FPSCR, frame[24])?;
        }
        if !process {
            self.set(R::SP, after)?;
        }
        // Unicorn's XPSR lacks the GE flags.
        self.set(R::XPSR, status & !(1 << 9))?;
        self.set(R::XPSR_NZCVQG, status)?;
        let control = self.register(R::CONTROL) & !(SPSEL | FPCA);
        let control = control | if floats { FPCA } else { 0 } | if process { SPSEL } else { 0 };
        self.set(R::CONTROL, control)?;
        if process {
            self.set(R::SP, after)?;
        }
        // A return from anything but NMI clears FAULTMASK.
        if ended != NMI {
            self.set(R::FAULTMASK, 0)?;
        }
        self.set(R::PC, pc | 1)
    }
}

/// Maps memories and buses.
fn map(uc: &mut Unicorn<'static, Core>) -> Result<(), uc_error> {
    let core = uc.get_data();
    let (code, ram) = (core.chip.flash.as_ptr(), core.chip.ram.as_ptr());
    // SAFETY: flash's memory is as long as two banks and lives as long as the chip, which unicorn's data owns; it is
    // reached through this pointer only while no reference into it exists (see `Ram`).
    unsafe { uc.mem_map_ptr(flash::START.into(), flash::BANK as u64, Prot::READ | Prot::EXEC, code.cast())? };
    // SAFETY: as above, of RAM_LEN bytes.
    unsafe { uc.mem_map_ptr(RAM_START.into(), RAM_LEN as u64, Prot::READ | Prot::WRITE, ram.cast())? };
    // SAFETY: the CCM SRAM is the last part of the RAM.
    let ccm = unsafe { ram.add(RAM_LEN - CCM_LEN) };
    // SAFETY: as above, of CCM_LEN bytes.
    unsafe { uc.mem_map_ptr(CCM_START.into(), CCM_LEN as u64, Prot::READ | Prot::WRITE, ccm.cast())? };
    uc.mem_map(rom::START.into(), rom::LEN as u64, Prot::READ | Prot::EXEC)?;
    uc.mem_write(rom::START.into(), &rom::bytes())?;
    // Bank 2, which may be busy; APB and AHB1; AHB2; the private peripheral bus.
    for (start, len) in [
        (flash::START + flash::BANK as u32, flash::BANK),
        (0x4000_0000, 0x1000_0000),
        (0x5000_0000, 0x0010_0000),
        (PRIVATE, 0x0010_0000),
    ] {
        uc.mmio_map(
            start.into(),
            len as u64,
            Some(move |uc: &mut Unicorn<Core>, offset: u64, bytes: usize| {
                u64::from(uc.get_data_mut().access(start + offset as u32, bytes, None))
            }),
            Some(move |uc: &mut Unicorn<Core>, offset: u64, bytes: usize, value: u64| {
                uc.get_data_mut().access(start + offset as u32, bytes, Some(value as u32));
            }),
        )?;
    }
    Ok(())
}

/// Called before a block: decides whether it may run, and adds its instructions to the clock.
fn before_block(uc: &mut Unicorn<Core>, address: u64, bytes: u32) {
    let address = address as u32;
    let core = uc.get_data();
    let mut pause = core.now >= core.deadline;
    if core.check && !pause {
        pause = core.nvic.takeable(Cpu::masks(uc)).is_some();
    }
    let core = uc.get_data();
    if !core.nvic.fpu_is_on() && uc.reg_read(R::CONTROL).is_ok_and(|control| control as u32 & FPCA != 0) {
        uc.get_data_mut().stop.get_or_insert(Stop::FloatingPointOff);
        pause = true;
    }
    if (rom::START..rom::CODE_END).contains(&address) {
        uc.get_data_mut().stop.get_or_insert(Stop::Bootloader);
        pause = true;
    }
    let core = uc.get_data_mut();
    if pause {
        core.pause = Pause::Attention;
        // The block does not run and the program counter stays on it. A failure of this call cannot be handled here.
        let _ = uc.emu_stop();
        return;
    }
    let block = core.look_up(address, bytes);
    core.block = address;
    core.now += Cycles::from(block.instructions);
    core.instructions += u64::from(block.instructions);
    core.model(|model, core| {
        if let Some(code) = core.code(address, bytes) {
            model.block(address, code, &core.chip.flash.access());
        }
    });
    if block.sends_event {
        core.nvic.event = true;
    }
}

fn hook(uc: &mut Unicorn<'static, Core>) -> Result<(), uc_error> {
    uc.add_block_hook(1, 0, before_block)?;
    // Unicorn calls this for WFE with the program counter after it, and for an undefined instruction with the program
    // counter on it.
    uc.add_insn_invalid_hook(|uc: &mut Unicorn<Core>| {
        let pc = uc.reg_read(R::PC).unwrap_or(0) as u32;
        let half = |core: &Core, at: u32| core.code(at, 2).and_then(|code| timing::halves(code).next());
        let core = uc.get_data();
        let undefined = half(core, pc).is_some_and(|half| half >> 8 == 0xde);
        if half(core, pc.wrapping_sub(2)) != Some(WFE) || undefined {
            return false;
        }
        uc.get_data_mut().pause = Pause::Event;
        uc.emu_stop().is_ok()
    })?;
    uc.add_intr_hook(|uc: &mut Unicorn<Core>, number: u32| {
        uc.get_data_mut().pause = Pause::Exception(number);
        let _ = uc.emu_stop();
    })?;
    uc.add_mem_hook(HookType::MEM_INVALID, 1, 0, |uc: &mut Unicorn<Core>, kind: MemType, address: u64, _, _| {
        let what = match kind {
            MemType::READ_UNMAPPED | MemType::READ_PROT => "read of",
            MemType::WRITE_UNMAPPED | MemType::WRITE_PROT => "write to",
            _ => EXECUTION,
        };
        // The fetch of an exception return address is not a fault.
        if (address as u32) < EXC_RETURN {
            uc.get_data_mut().unmapped = Some((what, address as u32));
        }
        false
    })?;
    Ok(())
}

#[cfg(test)]
mod programs;
#[cfg(test)]
mod tests;
