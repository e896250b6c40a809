//! The linker's scripts: the root's memory, and that of the log.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rustc-link-search={}/../../../..", env!("CARGO_MANIFEST_DIR"));
    println!("cargo:rustc-link-arg=-Tdefmt.x");
}
