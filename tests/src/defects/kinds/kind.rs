//! What a kind of defect is.

use crate::defects::{draw::Draw, scene::Scene};

/// Where a defect is, as far as it matters for making the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// The plant makes it.
    Device,
    /// The instruments, the sampling or the settings make it.
    Rig,
}

/// What can be expected of the instrument.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// Something that samples can show.
    Defect,
    /// A wrong scale: every sample is as another device would give it, so nothing in the samples can show it.
    Scale,
}

/// One kind of defect.
pub struct Kind {
    /// Name in the table.
    pub name: &'static str,
    /// Where it is.
    pub place: Place,
    /// What can be expected.
    pub group: Group,
    /// Causes and warnings that name it correctly, by their codes (docs/CLI.md).
    pub names: &'static [&'static str],
    /// Puts it into a scene; its size is drawn.
    pub make: fn(&mut Scene, &mut Draw),
}

/// A defect of the rig that samples can show.
pub const fn kind(name: &'static str, names: &'static [&'static str], make: fn(&mut Scene, &mut Draw)) -> Kind {
    Kind { name, place: Place::Rig, group: Group::Defect, names, make }
}
