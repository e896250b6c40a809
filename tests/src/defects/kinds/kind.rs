//! What a kind of defect is.

use crate::defects::{draw::Draw, scene::Scene};

/// Where a defect is, as far as making the run is concerned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// The plant does it.
    Device,
    /// The instruments, the sampling or the settings do.
    Rig,
}

/// What can be expected of the instrument.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// Something that samples can show.
    Defect,
    /// A scale that is wrong: every sample is as it would be of another device, so that nothing in them can tell.
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
    /// Causes and warnings that name it rightly, by their codes (docs/CLI.md).
    pub names: &'static [&'static str],
    /// Puts it into a scene; its size is drawn.
    pub make: fn(&mut Scene, &mut Draw),
}

/// A defect of the rig that samples can show.
pub const fn kind(name: &'static str, names: &'static [&'static str], make: fn(&mut Scene, &mut Draw)) -> Kind {
    Kind { name, place: Place::Rig, group: Group::Defect, names, make }
}
