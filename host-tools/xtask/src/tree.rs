//! The source tree: where it is, and what in it is built for the board's chip.

use std::path::{Path, PathBuf};

/// The triple of every Cortex-M4F image.
pub const FIRMWARE_TARGET: &str = "thumbv7em-none-eabihf";

/// Packages that are built for the target only.
pub const FIRMWARE_PACKAGES: &[&str] = &["inerter-qemu", "inerter-stm32g474"];

/// The workspace's root folder.
pub fn root() -> PathBuf {
    // This file's crate is two folders below the root. The run-time variable comes first, so that a moved tree works.
    let here = std::env::var_os("CARGO_MANIFEST_DIR")
        .map(PathBuf::from)
        .filter(|path| path.ends_with("host-tools/xtask"))
        .unwrap_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")));
    here.ancestors().nth(2).map(Path::to_path_buf).unwrap_or(here)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_root_holds_the_workspace() {
        assert!(root().join("memory.x").is_file());
    }
}
