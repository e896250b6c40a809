//! Whether the host program compiles for its users' other systems. Compiled, not run: no such machine is available
//! here.

use crate::{process, setup};
use anyhow::{Result, ensure};

/// One for each system; neither needs a linker or a C compiler for this check, even with all features.
const TARGETS: [&str; 2] = ["x86_64-pc-windows-gnu", "aarch64-apple-darwin"];

/// Checks the host program for each of them.
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
    ensure!(left.is_empty(), "not checked, as rustup could not add the target: {}", left.join(", "));
    println!("the program compiles for {}", TARGETS.join(" and "));
    Ok(())
}
