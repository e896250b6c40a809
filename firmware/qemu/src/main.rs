//! The instrument on QEMU's netduinoplus2: the same app, on a Cortex-M4F that needs no board.
//!
//! ```text
//! cargo build -p inerter-qemu --target thumbv7em-none-eabihf --profile firmware
//! qemu-system-arm -M netduinoplus2 -nographic -monitor none -serial tcp:127.0.0.1:PORT,server,nowait,nodelay \
//!     -semihosting-config enable=on,target=native,arg=inerter,arg=FILE \
//!     -kernel target/thumbv7em-none-eabihf/firmware/inerter-qemu
//! ```
//!
//! - *Link*: USART1, which `-serial` joins to a TCP port, `unix:PATH,server,nowait` or a `pty`. QEMU drops what arrives
//!   before the image has switched the USART on, so a host repeats its `Hello` until it is answered; and it always
//!   reads, as the machine stops while its output is not taken.
//! - *Samples*: `FILE` (default `samples.bin`), read by semihosting from the first `Start` on; see `source.rs`.
//!   Or injected over the link.
//! - *Exit*: `Reboot` prints the stack usage as one JSON line and ends QEMU with status 0. A panic or a fault prints
//!   its message on standard error and ends it with status 101.
//! - *Measuring*: `arg=inerter,arg=icount` with `-icount shift=6` counts instructions instead; see `icount.rs`.
//!
//! The clock is SysTick and so follows QEMU's virtual time, which with `-icount` is the instruction count.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod clock;
#[cfg(target_os = "none")]
mod executor;
#[cfg(target_os = "none")]
mod icount;
#[cfg(target_os = "none")]
mod image;
#[cfg(target_os = "none")]
mod semihosting;
#[cfg(target_os = "none")]
mod source;
#[cfg(target_os = "none")]
mod stack;
#[cfg(target_os = "none")]
mod usart;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!(
        "inerter-qemu runs in QEMU only. Build it for the target:\n    \
         cargo build -p inerter-qemu --target thumbv7em-none-eabihf --profile firmware"
    );
    std::process::exit(2);
}
