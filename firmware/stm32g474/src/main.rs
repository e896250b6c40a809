//! The program: see the library of the same name.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
#[cortex_m_rt::entry]
fn main() -> ! {
    inerter_stm32g474::run()
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!(
        "inerter-stm32g474 runs on the STM32G474 only. Build it for the target:\n    \
         cd firmware/stm32g474 && cargo build --release"
    );
    std::process::exit(2);
}
