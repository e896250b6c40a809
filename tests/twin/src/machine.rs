//! The board running its firmware, for tests.
//!
//! ```no_run
//! use inerter_twin::{machine::Machine, world::Still};
//!
//! let image = std::fs::read("inerter-stm32g474")?;
//! let mut machine = Machine::new(&image, Still)?;
//! machine.run_for(0.1)?;
//! println!("{} instructions in 100 ms", machine.usage().instructions);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The same image, world and calls give a bit-identical run. The machine carries out resets that the chip requests and
//! records them ([`Machine::resets`]). Any other irregularity ends the run with [`Ended`].

use crate::{
    Board, Cycles, Width, World,
    boot_rom::{BootRom, LOOK_S},
    chip::{
        Chip,
        errata::Errata,
        flash::Boot,
        rcc::Reset,
        rom::{self, Left},
        rules::Rules,
    },
    cpu::{Cpu, Faults, Ran, Stop},
    cycles::Range,
    elf::{Elf, ElfError},
};
use std::path::PathBuf;
use unicorn_engine::RegisterARM;

/// The pattern with which cortex-m-rt paints the stack.
const PAINT: u32 = 0xcccc_cccc;

/// Why a machine cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The image cannot be read.
    #[error(transparent)]
    Elf(#[from] ElfError),
    /// A segment of the image lies outside flash.
    #[error("{len} bytes at {address:#010x} are outside flash")]
    Outside {
        /// First address of the segment.
        address: u32,
        /// Length of the segment \[bytes\].
        len: usize,
    },
    /// The core cannot be built.
    #[error(transparent)]
    Cpu(#[from] Stop),
}

/// The reason and place of an early end of a run.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{stop}, at {time_s:.6} s, pc {} (called from {})", named(pc), named(lr))]
pub struct Ended {
    /// The reason.
    pub stop: Stop,
    /// Location of the program (see [`Cpu::pc`]), and its function.
    pub pc: (u32, Option<Box<str>>),
    /// Return address of that function, if it is still in LR, and the function that it returns to.
    pub lr: (u32, Option<Box<str>>),
    /// Seconds since power-on.
    pub time_s: f64,
}

fn named((address, function): &(u32, Option<Box<str>>)) -> String {
    function.as_ref().map_or_else(|| format!("{address:#010x}"), |name| format!("{address:#010x} {name}"))
}

/// Activity of the core over a period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Usage {
    /// Length of the period \[s\].
    pub time_s: f64,
    /// Length of the period \[cycles\].
    pub cycles: Cycles,
    /// Cycles spent asleep.
    pub slept: Cycles,
    /// Instructions executed.
    pub instructions: u64,
    /// Cycles awake on the chip, by the cycle model ([`crate::cycles`]); none unless counting is enabled.
    pub awake: Option<Range>,
}

impl Usage {
    /// Fraction of the time that the core was awake.
    pub fn load(&self) -> f64 {
        1.0 - self.slept as f64 / self.cycles.max(1) as f64
    }

    /// Instructions per second.
    pub fn instructions_per_s(&self) -> f64 {
        self.instructions as f64 / self.time_s
    }

    /// Fraction of the time that the core is awake on the chip: lower and upper bound. None unless cycles are counted.
    pub fn load_on_the_chip(&self) -> Option<[f64; 2]> {
        let awake = self.awake?;
        Some([awake.least, awake.most].map(|cycles| cycles as f64 / self.cycles.max(1) as f64))
    }

    /// The activity since an earlier reading.
    pub fn since(&self, earlier: &Self) -> Self {
        Self {
            time_s: self.time_s - earlier.time_s,
            cycles: self.cycles - earlier.cycles,
            slept: self.slept - earlier.slept,
            instructions: self.instructions - earlier.instructions,
            awake: self.awake.zip(earlier.awake).map(|(now, earlier)| now.since(earlier)),
        }
    }
}

/// Stack usage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StackUse {
    /// Bytes from the start of the stack down to the lowest changed word.
    pub used: usize,
    /// Bytes available.
    pub available: usize,
}

/// The options in which two machines with the same image may differ.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// The circuit around the chip.
    pub board: Board,
    /// Seed of the RAM contents at power-on.
    pub seed: u64,
    /// Flash size that the chip reports \[KB\].
    pub flash_kb: u16,
    /// What happens when the program faults.
    pub faults: Faults,
    /// Errata in force.
    pub errata: Errata,
    /// How strictly the model treats violations by the program.
    pub rules: Rules,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            board: Board::NUCLEO,
            seed: 1,
            flash_kb: rom::FLASH_KB,
            faults: Faults::EndTheRun,
            errata: Errata::ALL,
            rules: Rules::Enforced,
        }
    }
}

/// The board with its firmware.
pub struct Machine {
    /// The core with its interrupt controller.
    pub cpu: Cpu,
    /// The image's symbols.
    pub elf: Elf,
    seed: u64,
    /// Time and cause of every start so far, power-on included.
    pub resets: Vec<(f64, Reset)>,
    /// Level of BOOT0. It takes effect at the next start if the option bytes select the pin.
    pub boot0: bool,
    /// How the boot loader leaves, if the machine simulates it: once entered, it waits for firmware on USB. If none,
    /// entering the boot loader ends the run.
    pub rom_leaves: Option<Left>,
    /// The boot loader, while it runs.
    rom: Option<BootRom>,
}

impl Machine {
    /// A NUCLEO board with the image in flash, just powered on.
    pub fn new(image: &[u8], world: impl World + 'static) -> Result<Self, StartError> {
        Self::with(image, Options::default(), world)
    }

    /// A board with the image in flash, just powered on.
    pub fn with(image: &[u8], options: Options, world: impl World + 'static) -> Result<Self, StartError> {
        let elf = Elf::parse(image)?;
        let mut chip = Chip::new(options.board, Box::new(world));
        chip.set_errata(options.errata);
        chip.set_rules(options.rules);
        for (address, bytes) in &elf.segments {
            if !chip.flash.load(*address, bytes) {
                return Err(StartError::Outside { address: *address, len: bytes.len() });
            }
        }
        let mut cpu = Cpu::new(chip)?;
        cpu.faults = options.faults;
        cpu.set_flash_kb(options.flash_kb)?;
        cpu.core_mut().chip.flash.size_kb = options.flash_kb;
        let mut machine =
            Self { cpu, elf, seed: options.seed, resets: Vec::new(), boot0: false, rom_leaves: None, rom: None };
        machine.power_cut()?;
        Ok(machine)
    }

    /// Seconds since power was first applied.
    pub fn time_s(&self) -> f64 {
        self.chip().seconds(self.now())
    }

    /// Cycles since power was first applied.
    pub fn now(&self) -> Cycles {
        self.cpu.now()
    }

    /// The chip.
    pub fn chip(&self) -> &Chip {
        &self.cpu.core().chip
    }

    /// The chip, to be changed between runs.
    pub fn chip_mut(&mut self) -> &mut Chip {
        &mut self.cpu.core_mut().chip
    }

    /// Runs until a time in seconds since power-on.
    pub fn run_until(&mut self, time_s: f64) -> Result<(), Ended> {
        loop {
            // The clock frequencies may have changed since the last slice.
            let until = self.chip().clocks.cycle_at(time_s);
            if until <= self.now() {
                return Ok(());
            }
            // The number of cycles in a second changes while the program sets up the clock tree.
            let slice = until.min(self.now() + SLICE);
            if self.rom.is_some() {
                self.look_into_rom(until).map_err(|stop| self.ended(stop))?;
                continue;
            }
            match self.cpu.run(slice) {
                Ok(None) => {}
                Ok(Some(cause)) => self.reset_by(cause).map_err(|stop| self.ended(stop))?,
                Err(Stop::Bootloader) if self.rom_leaves.is_some() => self.rom = Some(BootRom::default()),
                Err(stop) => return Err(self.ended(stop)),
            }
        }
    }

    /// Runs for a time in seconds.
    pub fn run_for(&mut self, length_s: f64) -> Result<(), Ended> {
        self.run_until(self.time_s() + length_s)
    }

    /// Runs in steps of `step_s` until a condition holds or `limit_s` has passed; returns whether it holds.
    pub fn run_until_that(
        &mut self,
        limit_s: f64,
        step_s: f64,
        mut holds: impl FnMut(&mut Self) -> bool,
    ) -> Result<bool, Ended> {
        let end = self.time_s() + limit_s;
        while !holds(self) {
            if self.time_s() >= end {
                return Ok(false);
            }
            self.run_for(step_s)?;
        }
        Ok(true)
    }

    fn ended(&self, stop: Stop) -> Ended {
        let place = |address: u32| (address, self.elf.function_at(address & !1).map(Into::into));
        let lr = self.cpu.register(RegisterARM::LR);
        Ended { stop, pc: place(self.cpu.pc()), lr: place(lr), time_s: self.time_s() }
    }

    /// Whether the boot loader is running.
    pub fn is_in_rom(&self) -> bool {
        self.rom.is_some()
    }

    fn look_into_rom(&mut self, until: Cycles) -> Ran {
        let now = self.now();
        let look = self.chip().clocks.cycles_in(LOOK_S).max(1);
        self.cpu.pass(look.min(until - now))?;
        let now = self.now();
        let Some(mut rom) = self.rom.take() else { return Ok(()) };
        rom.look(self.chip_mut(), now);
        match self.rom_leaves.filter(|_| rom.left) {
            Some(left) => {
                self.cpu.forget_code()?;
                self.leave_rom(left)
            }
            None => {
                self.rom = Some(rom);
                Ok(())
            }
        }
    }

    /// Resets the chip for this cause.
    pub fn reset_by(&mut self, cause: Reset) -> Ran {
        let (now, time_s) = (self.now(), self.time_s());
        self.resets.push((time_s, cause));
        self.chip_mut().reset(cause, now);
        if self.rom.take().is_some() {
            self.cpu.forget_code()?;
        }
        self.cpu.reset()?;
        match self.chip().flash.boots(self.boot0) {
            Boot::Flash => Ok(()),
            Boot::EitherBank => self.leave_rom(Left::Running),
            Boot::Rom => self.cpu.enter_rom(),
            Boot::Ram => Err(Stop::Ram),
        }
    }

    /// Resets the chip with the reset button.
    pub fn reset(&mut self) -> Ran {
        self.reset_by(Reset::Pin)
    }

    /// Makes the ROM's boot loader jump to the program, as its "leave" and "go" commands do.
    pub fn leave_rom(&mut self, left: Left) -> Ran {
        let noise = rom::noise();
        self.chip_mut().ram.bytes_mut()[..noise.len()].copy_from_slice(&noise);
        for &(address, value) in left.writes() {
            // Longer than the start-up of any oscillator that the boot loader enables.
            self.cpu.pass(1_000)?;
            let now = self.now();
            let core = self.cpu.core_mut();
            let written = match address {
                0xe000_0000.. => core.nvic.write(address, value, Width::Word, now).is_ok(),
                _ => core.chip.write(address, value, Width::Word, now).is_ok(),
            };
            assert!(written, "the ROM wrote a register that is not modelled: {address:#010x}");
        }
        if left.is_masked() {
            self.cpu.set(RegisterARM::PRIMASK, 1)?;
            self.cpu.set(RegisterARM::CONTROL, 2)?;
        }
        self.cpu.jump()
    }

    /// Removes and restores power. Flash keeps its contents; RAM contents are undefined.
    pub fn power_cut(&mut self) -> Ran {
        self.seed = self.seed.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
        let seed = self.seed;
        self.chip_mut().lose_power(seed);
        self.reset_by(Reset::Power)
    }

    /// The core's activity since power was first applied.
    pub fn usage(&self) -> Usage {
        let core = self.cpu.core();
        Usage {
            time_s: self.time_s(),
            cycles: self.now(),
            slept: core.slept,
            instructions: core.instructions,
            awake: core.cycles(),
        }
    }

    /// Sends bytes from the computer on the serial link.
    pub fn serial_send(&mut self, bytes: &[u8]) {
        let now = self.now();
        self.chip_mut().serial_send(bytes, now);
    }

    /// Bytes that the computer on the serial link received since the last call.
    pub fn serial_take(&mut self) -> Vec<u8> {
        let now = self.now();
        self.chip_mut().serial_take(now)
    }

    /// Peak stack usage since the last start, from the stack paint of cortex-m-rt.
    ///
    /// None for an image without cortex-m-rt's stack symbols.
    pub fn stack_high_water(&self) -> Option<StackUse> {
        let end = self.elf.symbol("_stack_end")?;
        let start = self.elf.symbol("_stack_start")?;
        let len = start.checked_sub(end)? as usize;
        let words = self.chip().bytes(end, len)?;
        let untouched = words.chunks_exact(4).take_while(|word| **word == PAINT.to_le_bytes()).count() * 4;
        Some(StackUse { used: len - untouched, available: len })
    }
}

/// Maximum time over which the frequencies are assumed constant: 1 ms at 16 MHz.
const SLICE: Cycles = 16_000;

/// Reads the image named by an environment variable, or else the one built by `cargo build --release`. If there is
/// none, the test is skipped ([`inerter_needs::or_skip`]).
pub fn image(variable: &str, built: &str) -> Option<Vec<u8>> {
    read(std::env::var_os(variable).map_or_else(|| built_here(built), PathBuf::from))
}

/// The same, from a folder named by an environment variable.
pub fn image_in(variable: &str, built: &str) -> Option<Vec<u8>> {
    let own = built_here(built);
    let named = std::env::var_os(variable).map(PathBuf::from).zip(own.file_name().map(PathBuf::from));
    read(named.map_or(own, |(folder, name)| folder.join(name)))
}

fn built_here(built: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../target/thumbv7em-none-eabihf").join(built)
}

fn read(path: PathBuf) -> Option<Vec<u8>> {
    let read = std::fs::read(&path);
    inerter_needs::or_skip(
        read.map_err(|error| format!("{}: {error}; `cargo xtask build-firmware` makes it", path.display())),
    )
}

/// The shipping image (see [`image`]).
pub fn shipping_image() -> Option<Vec<u8>> {
    image("INERTER_STM32_ELF", "release/inerter-stm32g474")
}
