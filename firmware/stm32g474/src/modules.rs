// Included by the two programs, which have the same modules.

#[cfg(target_os = "none")]
mod adc;
#[cfg(target_os = "none")]
mod boards;
#[cfg(target_os = "none")]
mod clkin;
#[cfg(target_os = "none")]
mod clocks;
#[cfg(target_os = "none")]
mod converter;
#[cfg(target_os = "none")]
mod defaults;
#[cfg(target_os = "none")]
mod executor;
#[cfg(target_os = "none")]
mod flash;
#[cfg(target_os = "none")]
mod identity;
#[cfg(target_os = "none")]
mod image;
#[cfg(target_os = "none")]
mod led;
#[cfg(target_os = "none")]
mod lpuart;
#[cfg(target_os = "none")]
mod options;
#[cfg(target_os = "none")]
mod panic;
#[cfg(target_os = "none")]
mod platform;
#[cfg(target_os = "none")]
mod ready;
#[cfg(target_os = "none")]
mod reset;
#[cfg(target_os = "none")]
mod rings;
#[cfg(target_os = "none")]
mod sampler;
#[cfg(target_os = "none")]
mod source;
#[cfg(target_os = "none")]
mod spi;
#[cfg(target_os = "none")]
mod stack;
#[cfg(target_os = "none")]
mod temperature;
#[cfg(target_os = "none")]
mod usb;
#[cfg(target_os = "none")]
mod watchdog;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!(
        "inerter-stm32g474 runs on the STM32G474 only. Build it for the target:\n    \
         cd firmware/stm32g474 && cargo build --release"
    );
    std::process::exit(2);
}
