//! Whether the host program compiles for its users' other systems, and everything with the oldest compiler that the
//! manifest promises. Compiled, not run: no such machine is available here.

use crate::{process, setup};
use anyhow::{Result, ensure};

/// One for each system; neither needs a linker or a C compiler for this check, even with all features.
const TARGETS: [&str; 2] = ["x86_64-pc-windows-gnu", "aarch64-apple-darwin"];

/// As in the root's manifest.
const OLDEST: &str = env!("CARGO_PKG_RUST_VERSION");

/// Checks the host program for each of them, and the main workspace with the oldest compiler.
pub fn run() -> Result<()> {
    let mut left = Vec::new();
    for target in TARGETS {
        println!("{target}: `rustup target add {target}`, then `cargo check`");
        if let Err(error) = setup::rustup(&["target", "add", target]) {
            left.push(format!("{target} ({error})"));
            continue;
        }
        process::run(process::cargo().args(["check", "--locked", "-p", "inerter", "--target", target]))?;
    }
    match setup::rustup(&["toolchain", "install", OLDEST, "--profile", "minimal"]) {
        Ok(()) => setup::rustup(&["run", OLDEST, "cargo", "check", "--locked", "--workspace", "--all-targets"])?,
        Err(error) => left.push(format!("Rust {OLDEST} ({error})")),
    }
    ensure!(left.is_empty(), "not checked, as rustup could not add it: {}", left.join(", "));
    println!("the program compiles for {}, and everything with Rust {OLDEST}", TARGETS.join(" and "));
    Ok(())
}
