//! The description of a kind of defect.

use crate::defects::{draw::Draw, scene::Scene};

/// Whether the instrument can be expected to detect it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// A defect that the samples can show.
    Defect,
    /// A wrong scale: another device would give exactly the same samples, so no analysis of them can show it.
    Scale,
}

/// One kind of defect.
pub struct Kind {
    /// Name in the table.
    pub name: &'static str,
    /// Whether it can be detected.
    pub group: Group,
    /// Codes of the causes and warnings that name it correctly (docs/CLI.md).
    pub names: &'static [&'static str],
    /// Puts the defect into a scene, with a random size.
    pub make: fn(&mut Scene, &mut Draw),
}

/// A defect that the samples can show.
pub const fn kind(name: &'static str, names: &'static [&'static str], make: fn(&mut Scene, &mut Draw)) -> Kind {
    Kind { name, group: Group::Defect, names, make }
}
