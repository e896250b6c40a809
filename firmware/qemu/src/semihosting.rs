//! Calls to the host through the debugger's breakpoint, which QEMU answers.
//!
//! A call stops the machine until the host has done it, so the file read here must be an ordinary one: its end comes
//! back at once as "no bytes". A FIFO works too, but holds up the whole machine until its writer writes.

use core::fmt::Write as _;
use cortex_m_semihosting::{hio, nr, syscall, syscall1};

/// Mode of `SYS_OPEN` for reading bytes.
const READ_BINARY: usize = 1;
/// Reason code of an ordinary exit.
const APPLICATION_EXIT: usize = 0x2_0026;
/// `SYS_EXIT_EXTENDED`: an exit that carries a status.
const EXIT_EXTENDED: usize = 0x20;

/// Ends QEMU with this exit status.
pub fn exit(status: u32) -> ! {
    let block = [APPLICATION_EXIT, status as usize];
    loop {
        // SAFETY: SYS_EXIT_EXTENDED reads the two words of `block`, which outlives the call.
        let _ = unsafe { syscall(EXIT_EXTENDED, &block) };
    }
}

/// Longest line, with its end, in bytes.
const LINE: usize = 1024;

/// Prints a line on QEMU's standard output, in one piece, so that nothing else comes between.
///
/// A line over 1023 bytes is cut.
pub fn print(line: core::fmt::Arguments) {
    let mut text = heapless::String::<LINE>::new();
    let _ = write!(text, "{line}");
    while text.len() >= LINE {
        text.pop();
    }
    let _ = text.push('\n');
    if let Ok(mut out) = hio::hstdout() {
        let _ = out.write_all(text.as_bytes());
    }
}

/// Prints a line on QEMU's standard error.
pub fn print_error(line: core::fmt::Arguments) {
    if let Ok(mut out) = hio::hstderr() {
        let _ = writeln!(out, "{line}");
    }
}

/// Copies the command line into `buffer` and returns what follows its first word, the program's name.
///
/// QEMU joins its `arg=` items by spaces. `None` when there is no second item, or the line does not fit.
pub fn argument(buffer: &mut [u8]) -> Option<&str> {
    let mut block = [buffer.as_mut_ptr() as usize, buffer.len()];
    // SAFETY: SYS_GET_CMDLINE writes at most `block[1]` bytes to `block[0]`, which is all of `buffer`, and the length
    // to `block[1]`. The pointer to `block` comes from a mutable borrow.
    let status = unsafe { syscall1(nr::GET_CMDLINE, block.as_mut_ptr() as usize) };
    if status != 0 {
        return None;
    }
    // SAFETY: the host changed the length behind the compiler's back.
    let length = unsafe { core::ptr::read_volatile(&block[1]) };
    let line = core::str::from_utf8(buffer.get(..length)?).ok()?;
    let (_, argument) = line.split_once(' ')?;
    let argument = argument.trim();
    (!argument.is_empty()).then_some(argument)
}

/// A file of the host, open for reading.
pub struct File {
    handle: usize,
}

impl File {
    /// Opens the file; `None` when the host cannot.
    pub fn open(path: &str) -> Option<Self> {
        let mut name = [0u8; 257];
        name.get_mut(..path.len())?.copy_from_slice(path.as_bytes());
        // The name must end in a zero.
        (path.len() < name.len()).then_some(())?;
        let block = [name.as_ptr() as usize, READ_BINARY, path.len()];
        // SAFETY: SYS_OPEN reads the zero-terminated name, which outlives the call.
        let handle = unsafe { syscall(nr::OPEN, &block) };
        (handle != usize::MAX).then_some(Self { handle })
    }

    /// Reads what is there, up to the length of `into`; 0 at the end of what was written so far.
    pub fn read(&mut self, into: &mut [u8]) -> usize {
        let block = [self.handle, into.as_mut_ptr() as usize, into.len()];
        // SAFETY: SYS_READ writes at most `into.len()` bytes to `into`.
        let missing = unsafe { syscall(nr::READ, &block) };
        into.len().saturating_sub(missing)
    }
}
