//! Contents of the page.

use inerter_analysis::{
    compare::{CompareError, Rig, Row, Side, compare},
    results::CompareJson,
};
use inerter_core::Machine;
use inerter_data::limits::{Judged, Limits};

use crate::page::Content;

/// Number of runs that are drawn: more colours could not be told apart with every kind of colour vision.
pub const DRAWN: usize = 5;

/// Runs side by side.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// The runs; the others are compared with the first. Those not drawn hold only what the tables show.
    pub runs: Vec<Content>,
    /// The same, as they were compared.
    pub sides: Vec<Side>,
    /// Whether each run was made on the first one's rig.
    pub rigs: Vec<Rig>,
    /// Parameters that at least one run identifies.
    pub rows: Vec<Row>,
    /// The verdicts of each run on limits; empty if there are none.
    pub within: Vec<Vec<Judged>>,
}

impl Comparison {
    /// From runs as they are read; `rig` applies to all but the first; without it the runs' own data decide.
    pub fn of<E: From<CompareError>>(
        runs: impl Iterator<Item = Result<Content, E>>,
        rig: Option<Rig>,
    ) -> Result<Self, E> {
        let light = |(number, content): (usize, Result<Content, E>)| {
            content.map(|content| if number < DRAWN { content } else { content.light() })
        };
        let runs = runs.enumerate().map(light).collect::<Result<Vec<_>, _>>()?;
        let sides: Vec<Side> = runs.iter().map(side).collect();
        let of = |other: &Side| rig.clone().unwrap_or_else(|| Rig::of(&sides[0], other));
        let others = sides.iter().skip(1).map(of);
        let rigs: Vec<Rig> = sides.first().map(|_| Rig::Same).into_iter().chain(others).collect();
        let rows = compare(&sides, &rigs)?;
        Ok(Self { runs, sides, rigs, rows, within: Vec::new() })
    }

    /// The same, with verdicts on limits.
    #[must_use]
    pub fn within(self, limits: &Limits) -> Self {
        Self { within: self.sides.iter().map(|side| side.told.within(limits)).collect(), ..self }
    }

    /// Kind of machine of all runs.
    pub fn machine(&self) -> Machine {
        self.sides.first().map_or(Machine::Linear, |side| side.settings.machine)
    }

    /// The rig that decides which interval of a run is shown; the first one's intervals are full if no other run shares
    /// its rig.
    pub fn shown_rig(&self, number: usize) -> &Rig {
        let others = || self.rigs.iter().skip(1);
        let is_alone = number == 0 && !others().any(Rig::is_shared);
        let rig = if is_alone { self.rigs.get(1) } else { self.rigs.get(number) };
        rig.unwrap_or(&Rig::Same)
    }

    /// For a person: the kind of intervals shown.
    pub fn words(&self) -> Vec<String> {
        let first = self.sides.first().map_or("", |side| side.name.as_str());
        let named = || self.sides.iter().zip(&self.rigs).skip(1);
        let shared = named().any(|(_, rig)| rig.is_shared()).then(|| {
            "Intervals are those for comparing runs on one rig: without the errors of force gain, lead and clock, which the runs share."
                .to_string()
        });
        let of_each = named().filter_map(|(side, rig)| match rig {
            Rig::Same => None,
            Rig::Assumed => Some(format!(
                "The files do not show whether {} was measured on the rig of {first}; this page assumes that it was. Use `--rigs several` if not.",
                side.name
            )),
            Rig::Other(reason) => {
                Some(format!("{} is from another rig than {first} ({reason}): its full intervals are used.", side.name))
            }
        });
        let verdict = "Each interval is for one difference; the verdicts allow for how many are tested.".to_string();
        shared.into_iter().chain(of_each).chain([verdict]).collect()
    }

    /// For a program.
    pub fn json(&self) -> CompareJson {
        let within = Some(self.within.as_slice()).filter(|within| !within.is_empty());
        CompareJson::new(&self.sides, &self.rigs, &self.rows, within)
    }
}

/// A run to be compared.
fn side(content: &Content) -> Side {
    Side {
        name: content.run.name.clone(),
        settings: content.run.settings,
        hello: content.run.hello.clone(),
        calibration: content.run.calibration.clone(),
        told: content.told(),
    }
}
