//! Communication with the chip.

use embedded_hal::digital::OutputPin;
use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::spi::SpiDevice;

use crate::config::{Config, MODE};
use crate::error::Error;
use crate::filter::Osr;
use crate::frame::{CHANNELS, Command, Damage, Frame, Reply, decode, word};
use crate::registers::{ID, ID_MASK, Register, Status};

/// SYNC/RESET held low for this many CLKIN periods is a reset; less is a resynchronisation.
pub(crate) const RESET_CLKIN: u32 = 2048;
/// From power or the end of a reset to the first frame \[us\]: 250 for power-on, 5 for the registers
/// (SBAS890, "Switching Characteristics", tPOR and tREGACQ), doubled.
const START_US: u32 = 510;
/// Conversions that the chip holds.
const FIFO_DEPTH: u32 = 2;

const NULL: Frame = Command::Null.frame();

/// One conversion of all channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conversion {
    /// Codes, 24 bits, sign extended: full scale is 1.2 V / gain.
    pub channels: [i32; CHANNELS],
    /// The chip's status when the frame began.
    pub status: Status,
    /// Whether the filter holds nothing from before the last set-up or resynchronisation.
    pub settled: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Not set up.
    Down,
    /// Converting, locked.
    Running,
    /// Standby, unlocked.
    Standby,
}

/// The chip behind an SPI device (mode 1, up to 25 MHz, chip select held for each transfer) and its SYNC/RESET pin.
///
/// Nothing blocks: all waiting is the SPI's and the delay's. **Cancel safety**: every future here may be dropped at any
/// point; the object stays usable. A dropped read may have consumed its conversion: treat it as lost and call
/// [`drain`](Self::drain). A dropped set-up leaves the chip not running: call [`init`](Self::init) again.
/// How a transfer that was cut off is handled is up to the transport; the chip drops a frame that ends early.
#[derive(Debug)]
pub struct Ads131m04<SPI, RESET> {
    spi: SPI,
    reset: RESET,
    config: Config,
    state: State,
    /// The last frame may have ended early: its future was dropped, or the SPI failed.
    cut_off: bool,
    /// Conversions still to be marked as not settled.
    unsettled: u32,
}

impl<SPI: SpiDevice, RESET: OutputPin> Ads131m04<SPI, RESET> {
    /// Takes the bus and the pin; does not talk to the chip yet.
    pub const fn new(spi: SPI, reset: RESET, config: Config) -> Self {
        Self { spi, reset, config, state: State::Down, cut_off: false, unsettled: Osr::SETTLING }
    }

    /// The configuration that the chip has, or will get.
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// Returns bus and pin. The chip stays as it is.
    pub fn release(self) -> (SPI, RESET) {
        (self.spi, self.reset)
    }

    /// Resets the chip by its pin, makes sure that it is an ADS131M04, writes every register, reads each back, turns
    /// both CRCs on and locks the interface. Takes about 4 ms. The clock at CLKIN must run.
    ///
    /// Encoder counts from before do not belong to conversions from after: reset the matched position.
    pub async fn init(&mut self, delay: &mut impl DelayNs) -> Result<(), Error<SPI::Error, RESET::Error>> {
        self.state = State::Down;
        self.config.check().map_err(Error::Config)?;
        self.reset.set_low().map_err(Error::Pin)?;
        // Half as long again as the chip requires.
        delay.delay_us((RESET_CLKIN * 3 / 2) * 1_000 / (self.config.clkin_hz / 1_000) + 1).await;
        self.reset.set_high().map_err(Error::Pin)?;
        delay.delay_us(START_US).await;

        // The acknowledge comes only once; a chip that has already sent it still shows RESET in its status.
        let response = self.exchange(NULL).await?.response;
        let status = Status(response);
        let acknowledged = response & 0xFFF0 == word::RESET_DONE;
        if acknowledged {
            if response != word::RESET_DONE | CHANNELS as u16 {
                return Err(Error::WrongChip { response });
            }
        } else if !status.is_plausible() || !status.was_reset() || status.locked() {
            return Err(Error::NotReset { response });
        }
        let response = self.ask(Command::Read(Register::Id)).await?;
        if response & ID_MASK != ID {
            return Err(Error::WrongChip { response });
        }
        self.write_all().await?;
        self.start().await
    }

    /// Writes another configuration into the running chip, without a reset.
    ///
    /// If this fails the chip is not running: call [`init`](Self::init).
    pub async fn configure(&mut self, config: Config) -> Result<(), Error<SPI::Error, RESET::Error>> {
        config.check().map_err(Error::Config)?;
        if self.state != State::Running {
            return Err(Error::NotRunning);
        }
        self.state = State::Down;
        self.config = config;
        self.ask(Command::Unlock).await?;
        self.write_all().await?;
        self.start().await
    }

    /// Reads one conversion. Call it once for each DRDY edge, before the next.
    ///
    /// Checks the frame's CRC, that the chip accepted the frame before, that it is still locked, was not reset, did not
    /// restart and has a new conversion on each channel.
    pub async fn read(&mut self) -> Result<Conversion, Error<SPI::Error, RESET::Error>> {
        let (status, channels) = self.status().await?;
        if !status.all_ready() {
            return Err(Error::NotReady { status });
        }
        let settled = self.unsettled == 0;
        self.unsettled = self.unsettled.saturating_sub(1);
        Ok(Conversion { channels, status, settled })
    }

    /// Reads until the chip holds nothing, and returns the number of conversions discarded.
    ///
    /// Right after a [`read`](Self::read) it must be 0, which takes one frame; more means that the frames had fallen
    /// behind the edges, and the conversions since the last check were late. If a DRDY edge came while this ran, its
    /// conversion may still be in the chip: call it again.
    pub async fn drain(&mut self) -> Result<u32, Error<SPI::Error, RESET::Error>> {
        for lost in 0..=FIFO_DEPTH + 1 {
            let (status, _) = self.status().await?;
            if !status.any_ready() {
                return Ok(lost);
            }
        }
        Err(Error::TooSlow)
    }

    /// Brings frames and DRDY edges in step again after damage, loss or a pause, and returns the number of conversions
    /// discarded.
    ///
    /// Empties the two-deep output buffer, as in SBAS890, "Collecting Data for the First Time or After a Pause in Data
    /// Collection". The other way given there, a pulse on SYNC/RESET, is not used: a pulse that an interrupt stretches
    /// to 2048 clocks is a reset, and it would move the instants of all later conversions. A chip that was reset or
    /// changed is set up again, as by [`init`](Self::init). The rule about DRDY edges of [`drain`](Self::drain)
    /// applies.
    pub async fn resynchronise(&mut self, delay: &mut impl DelayNs) -> Result<u32, Error<SPI::Error, RESET::Error>> {
        if self.state == State::Standby {
            return Err(Error::NotRunning);
        }
        let mut lost = 0;
        // Each cause is tolerated once per frame that may carry it.
        for _ in 0..4 {
            match self.drain().await {
                Ok(more) => return Ok(lost + more),
                Err(Error::CommandCrc | Error::FrameCrc { .. }) => lost += 1,
                Err(Error::Resynchronised { .. }) => self.unsettled = Osr::SETTLING,
                Err(Error::WasReset { .. } | Error::SetupChanged { .. } | Error::NotRunning) => {
                    self.init(delay).await?;
                }
                Err(error) => return Err(error),
            }
        }
        self.init(delay).await?;
        Ok(lost + self.drain().await?)
    }

    /// Stops converting to save power. [`wake_up`](Self::wake_up) resumes.
    pub async fn standby(&mut self) -> Result<(), Error<SPI::Error, RESET::Error>> {
        if self.state != State::Running {
            return Err(Error::NotRunning);
        }
        self.state = State::Down;
        self.ask(Command::Unlock).await?;
        self.ask(Command::Standby).await?;
        self.state = State::Standby;
        Ok(())
    }

    /// Converts again after [`standby`](Self::standby).
    pub async fn wake_up(&mut self) -> Result<(), Error<SPI::Error, RESET::Error>> {
        if self.state != State::Standby {
            return Err(Error::NotRunning);
        }
        self.state = State::Down;
        self.ask(Command::Wakeup).await?;
        self.start().await
    }

    /// Writes every register of the set-up and reads each back.
    async fn write_all(&mut self) -> Result<(), Error<SPI::Error, RESET::Error>> {
        for (register, wrote) in self.config.registers() {
            self.write(register, wrote).await?;
        }
        self.write(Register::Mode, MODE).await
    }

    async fn write(&mut self, register: Register, wrote: u16) -> Result<(), Error<SPI::Error, RESET::Error>> {
        self.ask(Command::Write(register, wrote)).await?;
        let read = self.ask(Command::Read(register)).await?;
        if read == wrote { Ok(()) } else { Err(Error::NotKept { register, wrote, read }) }
    }

    /// Locks, checks the status, and begins to count settling conversions.
    async fn start(&mut self) -> Result<(), Error<SPI::Error, RESET::Error>> {
        self.ask(Command::Lock).await?;
        let status = Status(self.ask(Command::Null).await?);
        if status.was_reset() {
            return Err(Error::WasReset { status });
        }
        if !status.locked() || !status.is_plausible() {
            return Err(Error::SetupChanged { status });
        }
        self.unsettled = Osr::SETTLING;
        self.state = State::Running;
        Ok(())
    }

    /// Exchanges one frame with no command and checks the status that comes with it.
    async fn status(&mut self) -> Result<(Status, [i32; CHANNELS]), Error<SPI::Error, RESET::Error>> {
        if self.state != State::Running {
            return Err(Error::NotRunning);
        }
        if self.cut_off {
            // Takes the chip's error report about it.
            self.exchange(NULL).await?;
        }
        let reply = self.exchange(NULL).await?;
        let status = Status(reply.response);
        let reset_done = reply.response & 0xFFF0 == word::RESET_DONE;
        if reset_done || (status.is_plausible() && status.was_reset()) {
            self.state = State::Down;
            return Err(Error::WasReset { status });
        }
        if !status.locked() || !status.is_plausible() {
            self.state = State::Down;
            return Err(Error::SetupChanged { status });
        }
        if status.input_crc_error() {
            return Err(Error::CommandCrc);
        }
        // Writing the registers sets both flags; when the chip does so is not specified.
        if self.unsettled == 0 {
            if status.registers_changed() {
                self.state = State::Down;
                return Err(Error::SetupChanged { status });
            }
            if status.resynchronised() {
                self.unsettled = Osr::SETTLING;
                return Err(Error::Resynchronised { status });
            }
        }
        Ok((status, reply.channels))
    }

    /// Sends a command and fetches its response, which is checked if it is known beforehand.
    async fn ask(&mut self, command: Command) -> Result<u16, Error<SPI::Error, RESET::Error>> {
        self.exchange(command.frame()).await?;
        let response = self.exchange(NULL).await?.response;
        match command.acknowledge() {
            Some(expected) if expected != response => Err(Error::Refused { command: command.word(), response }),
            _ => Ok(response),
        }
    }

    /// One frame each way.
    async fn exchange(&mut self, mut frame: Frame) -> Result<Reply, Error<SPI::Error, RESET::Error>> {
        self.cut_off = true;
        self.spi.transfer_in_place(&mut frame).await.map_err(Error::Spi)?;
        self.cut_off = false;
        decode(&frame).map_err(|damage| match damage {
            Damage::Silent { high } => Error::NoChip { high },
            Damage::Crc { received, computed } => Error::FrameCrc { received, computed },
        })
    }
}
