//! Names the commit that the image is built from.

use std::process::Command;

/// Digits of the commit's name: a fixed number, so that the size of the image does not depend on it.
const DIGITS: usize = 12;

fn main() {
    let short = format!("--short={DIGITS}");
    let commit = Command::new("git")
        .args(["rev-parse", &short, "HEAD"])
        .output()
        .ok()
        .filter(|output| output.status.success())
        .and_then(|output| String::from_utf8(output.stdout).ok())
        .and_then(|commit| commit.trim().get(..DIGITS).map(str::to_owned))
        .unwrap_or_else(|| "0".repeat(DIGITS));
    println!("cargo:rustc-env=INERTER_GIT={commit}");
    println!("cargo:rerun-if-changed=../../.git/logs/HEAD");
}
