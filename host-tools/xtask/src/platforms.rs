//! Whether the program compiles for the other systems that its users have. Compiled, not run: there is no such machine
//! here.

use crate::{process, setup};
use anyhow::{Result, bail};

/// One for each system; neither needs a linker or a C compiler to be checked, with all features either.
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
    if !left.is_empty() {
        bail!("not checked, for want of a target that rustup could add: {}", left.join(", "));
    }
    println!("the program compiles for {}", TARGETS.join(" and "));
    Ok(())
}
