//! Names the commit that the image is built from, and passes what the linker needs beyond `link.x`.

use std::process::Command;

/// Digits of the commit hash: a fixed number, so that the size of the image does not depend on it.
const DIGITS: usize = 12;

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    String::from_utf8(output.stdout).ok()
}

fn main() {
    let commit = git(&["rev-parse", &format!("--short={DIGITS}"), "HEAD"])
        .and_then(|commit| commit.trim().get(..DIGITS).map(str::to_owned))
        .unwrap_or_else(|| "0".repeat(DIGITS));
    println!("cargo:rustc-env=INERTER_GIT={commit}");
    println!("cargo:rerun-if-changed=../../.git/logs/HEAD");
    // Not on the host, where the crate is only a line of advice.
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
        // Merges identical functions.
        println!("cargo:rustc-link-arg-bins=--icf=all");
    }
}
