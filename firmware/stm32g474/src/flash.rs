//! The settings' pages: the last 16 KB of the second flash bank.
//!
//! The program runs from the first bank, so sampling, estimating and sending continue during a write; only the writing
//! task waits. Offsets count from the first of these pages, so nothing else can be reached.
//!
//! Each double word has its own ECC. One that a power failure left half written may read as a double error, which
//! raises NMI: the handler notes it, and the read returns an error. The handler attributes it to the settings if they
//! are being read (`READING`), because ECCR may hold anything after a write or erase was cut short (ES0430 2.2.3). They
//! are read without the data cache, which would return the damaged data again without an NMI.
//!
//! Source: RM0440 3 (dual bank: pages of 2 KB). The data cache stays off while a bank is written and the other is read:
//! ES0430, "data cache might be corrupted during flash memory read-while-write operation".

use core::sync::atomic::{AtomicBool, Ordering};
use core::{mem, ptr};
use cortex_m::asm::dsb;
use cortex_m_rt::exception;
use embassy_stm32::pac::flash::regs::Sr;
use embassy_stm32::pac::{FLASH, RCC};
use embassy_time::{Duration, Instant, Timer};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};

/// Address of the first page.
const START: usize = 0x0807_C000;
/// Its page number in the second bank.
const FIRST_PAGE: u32 = 120;
const PAGE: usize = 2048;
const PAGES: usize = 8;
/// Bytes of all pages.
pub const SIZE: u32 = (PAGE * PAGES) as u32;
/// Bytes written at once, with a common ECC.
const DOUBLE_WORD: usize = 8;

/// Flash of the chip in KB (RM0440, device electronic signature). The smaller members of the family lack these pages.
const FLASH_SIZE: *const u16 = 0x1FFF_75E0 as *const u16;
const NEEDED_KB: u16 = 512;

/// Keys of the control register (RM0440, 3.3.5).
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
/// A double word takes 82 us, a page 22 ms (DS12288, table 50).
const WRITE_POLL: Duration = Duration::from_micros(50);
const ERASE_POLL: Duration = Duration::from_millis(1);
const LIMIT: Duration = Duration::from_millis(100);

/// Whether the settings' pages are being read.
static READING: AtomicBool = AtomicBool::new(false);
/// Whether a double error has occurred since this was last cleared.
static DAMAGED: AtomicBool = AtomicBool::new(false);
/// Whether its flag was found before its NMI arrived.
static LATE: AtomicBool = AtomicBool::new(false);

/// The pages. There is only one instance.
pub struct Pages {
    _private: (),
}

impl Pages {
    /// Must be created only once.
    pub const fn new() -> Self {
        Self { _private: () }
    }

    /// Waits for an operation that an abandoned future may have left behind, and prepares the next one.
    async fn begin(&mut self) -> Result<(), NorFlashErrorKind> {
        wait(WRITE_POLL).await?;
        FLASH.cr().modify(|w| {
            w.set_pg(false);
            w.set_per(false);
        });
        clear_errors();
        unlock();
        FLASH.acr().modify(|w| w.set_dcen(false));
        Ok(())
    }

    /// Ends an operation, whatever its result.
    async fn end(&mut self, poll: Duration) -> Result<(), NorFlashErrorKind> {
        let waited = wait(poll).await;
        let errors = clear_errors();
        FLASH.cr().modify(|w| {
            w.set_pg(false);
            w.set_per(false);
            w.set_lock(true);
        });
        // The cache still holds the old contents.
        FLASH.acr().modify(|w| w.set_dcrst(true));
        FLASH.acr().modify(|w| w.set_dcrst(false));
        FLASH.acr().modify(|w| w.set_dcen(true));
        waited?;
        if errors.0 == 0 { Ok(()) } else { Err(NorFlashErrorKind::Other) }
    }
}

/// Waits until the flash is idle.
async fn wait(poll: Duration) -> Result<(), NorFlashErrorKind> {
    let begun = Instant::now();
    while FLASH.sr().read().bsy() {
        if begun.elapsed() > LIMIT {
            return Err(NorFlashErrorKind::Other);
        }
        Timer::after(poll).await;
    }
    Ok(())
}

/// Unlocks the control register, if it is locked: writing a key to an unlocked register is a bus fault.
pub fn unlock() {
    if FLASH.cr().read().lock() {
        for key in KEYS {
            FLASH.keyr().write_value(key);
        }
    }
}

/// Clears the errors of operations, by writing 1 to each; returns them.
pub fn clear_errors() -> Sr {
    let now = FLASH.sr().read();
    let mut errors = Sr(0);
    errors.set_operr(now.operr());
    errors.set_progerr(now.progerr());
    errors.set_wrperr(now.wrperr());
    errors.set_pgaerr(now.pgaerr());
    errors.set_sizerr(now.sizerr());
    errors.set_pgserr(now.pgserr());
    errors.set_miserr(now.miserr());
    errors.set_fasterr(now.fasterr());
    FLASH.sr().write_value(errors);
    errors
}

/// Flash of the chip in KB.
pub fn size_kb() -> u16 {
    // SAFETY: a constant of the chip, in its system memory.
    unsafe { ptr::read(FLASH_SIZE) }
}

/// Whether the chip has the pages.
pub fn is_there() -> bool {
    size_kb() >= NEEDED_KB && FLASH.optr().read().dbank()
}

/// The address of `offset`, if the chip has the pages and `length` bytes lie within them, aligned to `unit`.
fn check(offset: u32, length: usize, unit: usize) -> Result<usize, NorFlashErrorKind> {
    if !is_there() {
        return Err(NorFlashErrorKind::Other);
    }
    let offset = offset as usize;
    let end = offset.checked_add(length).ok_or(NorFlashErrorKind::OutOfBounds)?;
    if end <= SIZE as usize && offset.is_multiple_of(unit) && length.is_multiple_of(unit) {
        Ok(START + offset)
    } else {
        Err(NorFlashErrorKind::OutOfBounds)
    }
}

impl ErrorType for Pages {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Pages {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let start = check(offset, bytes.len(), Self::READ_SIZE)? as *const u8;
        // It is already off, and must stay off, if an abandoned future has left an operation behind.
        let cached = FLASH.acr().read().dcen();
        FLASH.acr().modify(|w| w.set_dcen(false));
        DAMAGED.store(false, Ordering::SeqCst);
        READING.store(true, Ordering::SeqCst);
        for (place, byte) in bytes.iter_mut().enumerate() {
            // SAFETY: within the settings' pages, as checked, which nothing else uses.
            *byte = unsafe { ptr::read_volatile(start.wrapping_add(place)) };
        }
        // By now the NMI has come, or its flag shows that it will.
        dsb();
        if clear_double_error() {
            LATE.store(true, Ordering::SeqCst);
            DAMAGED.store(true, Ordering::SeqCst);
        }
        READING.store(false, Ordering::SeqCst);
        FLASH.acr().modify(|w| w.set_dcen(cached));
        if DAMAGED.load(Ordering::SeqCst) { Err(NorFlashErrorKind::Other) } else { Ok(()) }
    }

    fn capacity(&self) -> usize {
        SIZE as usize
    }
}

impl NorFlash for Pages {
    const WRITE_SIZE: usize = DOUBLE_WORD;
    const ERASE_SIZE: usize = PAGE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        let length = to.checked_sub(from).ok_or(NorFlashErrorKind::OutOfBounds)? as usize;
        check(from, length, PAGE)?;
        for page in from / PAGE as u32..to / PAGE as u32 {
            self.begin().await?;
            FLASH.cr().modify(|w| {
                w.set_per(true);
                w.set_bker(true);
                w.set_pnb((FIRST_PAGE + page) as u8);
            });
            FLASH.cr().modify(|w| w.set_strt(true));
            self.end(ERASE_POLL).await?;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        let start = check(offset, bytes.len(), DOUBLE_WORD)? as *mut u32;
        let (words, _) = bytes.as_chunks::<{ mem::size_of::<u32>() }>();
        let (pairs, _) = words.as_chunks::<2>();
        for (place, [low, high]) in pairs.iter().enumerate() {
            self.begin().await?;
            FLASH.cr().modify(|w| w.set_pg(true));
            let place = start.wrapping_add(2 * place);
            // SAFETY: a whole double word within the settings' pages, as checked; both words, in this order, are what
            // starts the operation.
            unsafe {
                ptr::write_volatile(place, u32::from_le_bytes(*low));
                dsb();
                ptr::write_volatile(place.wrapping_add(1), u32::from_le_bytes(*high));
            }
            dsb();
            self.end(WRITE_POLL).await?;
        }
        Ok(())
    }
}

/// Returns whether a double error was found, and clears it. Writing 1 clears the flag, set or not.
fn clear_double_error() -> bool {
    let ecc = FLASH.eccr().read();
    let mut clear = ecc;
    clear.set_eccc(false);
    clear.set_eccd(true);
    FLASH.eccr().write_value(clear);
    ecc.eccd()
}

/// The crystal has stopped, or there is a double error in flash.
#[exception]
unsafe fn NonMaskableInt() {
    if RCC.cifr().read().cssf() {
        RCC.cicr().write(|w| w.set_cssc(true));
        panic!("the crystal has stopped");
    }
    let address = FLASH.eccr().read().addr_ecc();
    let found = clear_double_error();
    if !found {
        // The reader of the settings has already cleared the flag.
        assert!(LATE.swap(false, Ordering::SeqCst), "NMI without a cause");
    } else if READING.load(Ordering::SeqCst) {
        DAMAGED.store(true, Ordering::SeqCst);
    } else {
        panic!("the program in flash is damaged at {address:x}");
    }
}
