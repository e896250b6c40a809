//! Recordings of real machines, which are stored outside the project.

use std::path::PathBuf;

use inerter_data::{
    Error, csv,
    replay::{self, Outcome},
    run::Run,
    settings::Overrides,
};

/// One recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Recording {
    /// A ball-screw positioning axis; force from the motor current.
    Emps,
    /// A rack-and-pinion inerter, ratio r0.
    LodzSymmetric,
    /// The same machine at ratio r16.
    LodzAsymmetric,
    /// A friction damper with no mass behind its backlash, in a load frame.
    Arts,
}

impl Recording {
    /// Path within the folder of recordings, and metres per encoder count.
    fn parts(self) -> (&'static str, f64) {
        match self {
            Self::Emps => ("emps/emps.csv", 50e-9),
            Self::LodzSymmetric => ("lodz/sym_r0.csv", 1e-6),
            Self::LodzAsymmetric => ("lodz/asym_r16.csv", 1e-6),
            Self::Arts => ("arts/1hz_20lb.csv", 1e-6),
        }
    }

    /// The path of the file. If there is no folder of recordings, the test is skipped.
    ///
    /// # Panics
    /// If `INERTER_DATA` is set or the default folder exists, and the file is missing.
    pub fn path(self) -> Option<PathBuf> {
        let path = folder()?.join(self.parts().0);
        assert!(
            path.is_file(),
            "the folder of recordings lacks {}; docs/DATA.md says where it comes from",
            path.display()
        );
        Some(path)
    }

    /// The run, with the encoder's resolution reduced by this factor.
    pub fn run(self, coarser: i64) -> Option<Result<Run, Error>> {
        self.path().map(|path| -> Result<Run, Error> {
            let mut table = csv::read(&path)?;
            for count in &mut table.encoder_count {
                *count = count.div_euclid(coarser);
            }
            let mut overrides = Overrides::default();
            overrides.set("metres_per_count", self.parts().1 * coarser as f64, "the recording")?;
            csv::to_run(table, &overrides)
        })
    }
}

/// The folder in `INERTER_DATA`, relative to the root, else `../shared/data`.
fn folder() -> Option<PathBuf> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..");
    if let Some(named) = std::env::var_os("INERTER_DATA").filter(|named| !named.is_empty()) {
        return Some(root.join(named));
    }
    let beside = root.join("../shared/data");
    if beside.is_dir() {
        return Some(beside);
    }
    inerter_needs::skip("no recordings of real machines; docs/DATA.md says where they come from");
    None
}

/// The result of replaying the run with the library.
pub fn replayed(run: &Run) -> Result<Outcome, Error> {
    replay::replay(run, |_, _| Ok(()))
}
