//! Properties that must hold for any external input, in a form that libFuzzer can search.
//!
//! Each module is a target: `check` takes an input and panics if a property fails, and `seeds` returns realistic inputs
//! to start from. `cargo xtask fuzz` compiles the programs in `src/bin` with coverage counters and runs them. `cargo
//! test` checks the seeds and the committed corpora.
//!
//! ```text
//! seeds -> corpus/TARGET (packed, committed) -> libFuzzer -> inputs of new coverage -> corpus (`--keep`)
//!                                                        '-> findings (target/fuzz/TARGET)
//! ```

pub mod commands;
pub mod csv;
pub mod dfuse;
pub mod estimator;
pub mod flags;
pub mod image;
mod input;
pub mod mcap;
pub mod requests;
mod scratch;
pub mod settings;
pub mod wire;

pub use input::Input;

// The shared test files of inerter-device expect this name.
use inerter_device::board;

use std::{env, fs, path::PathBuf, process::exit};

/// If this names a folder, a target writes its seeds there and exits.
pub const SEEDS: &str = "INERTER_FUZZ_SEEDS";

/// Makes a libFuzzer program from the module of this name.
#[macro_export]
macro_rules! target {
    ($name:ident) => {
        libfuzzer_sys::fuzz_target!(init: $crate::write_seeds($crate::$name::seeds), |input: &[u8]| {
            $crate::$name::check($crate::Input(input))
        });
    };
}

/// Writes the seeds and exits, if [`SEEDS`] is set.
pub fn write_seeds(seeds: fn() -> Vec<Vec<u8>>) {
    let Some(folder) = env::var_os(SEEDS).map(PathBuf::from) else { return };
    for (number, seed) in seeds().iter().enumerate() {
        if let Err(error) = fs::write(folder.join(format!("seed-{number:03}")), seed) {
            eprintln!("{}: {error}", folder.display());
            exit(1);
        }
    }
    exit(0);
}

#[cfg(test)]
mod tests {
    /// Inputs of a packed corpus: each is preceded by its length (u32, little-endian).
    fn unpacked(mut packed: &[u8]) -> Vec<&[u8]> {
        let mut inputs = Vec::new();
        while let Some((length, rest)) = packed.split_first_chunk() {
            let (input, rest) = rest.split_at(u32::from_le_bytes(*length) as usize);
            inputs.push(input);
            packed = rest;
        }
        inputs
    }

    macro_rules! seeds_and_corpora_hold {
        ($($name:ident)+) => {$(
            #[test]
            fn $name() {
                let seeds = crate::$name::seeds();
                let corpus = unpacked(include_bytes!(concat!("../corpus/", stringify!($name))));
                assert!(seeds.len() > 3 && corpus.len() > 3);
                seeds.iter().map(Vec::as_slice).chain(corpus).map(crate::Input).for_each(crate::$name::check);
                crate::$name::check(crate::Input(&[]));
            }
        )+};
    }

    seeds_and_corpora_hold!(commands csv dfuse estimator flags image mcap requests settings wire);
}
