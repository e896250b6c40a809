//! Flags for the parameters of a device, and of its instruments if they are simulated too.

use std::collections::BTreeMap;

use clap::{ArgMatches, Command, FromArgMatches};
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::bench_sensors;

/// One flag per parameter of the device, and of the instruments if they are simulated too, from the plant's own tables.
pub struct PlantArgs<const SIMULATED: bool> {
    /// The given values, by name.
    pub given: BTreeMap<String, f64>,
}

/// Parameters of a device and its instruments.
pub type SimulatedArgs = PlantArgs<true>;
/// Expected parameters of a device.
pub type ExpectedArgs = PlantArgs<false>;

impl<const SIMULATED: bool> PlantArgs<SIMULATED> {
    fn fields() -> impl Iterator<Item = (&'static str, &'static inerter_plant::FieldInfo)> {
        let heading = if SIMULATED { "Simulated device" } else { "Expected device" };
        let device = Inerter::TABLE.iter().map(move |field| (heading, field));
        let instruments = Sensors::TABLE.iter().filter(|_| SIMULATED);
        device.chain(instruments.map(|field| ("Simulated instruments", field)))
    }

    fn default_of(field: &inerter_plant::FieldInfo) -> f64 {
        bench_sensors().get(field.name).unwrap_or(field.default)
    }
}

impl<const SIMULATED: bool> clap::Args for PlantArgs<SIMULATED> {
    fn augment_args(command: Command) -> Command {
        Self::fields().fold(command, |command, (heading, field)| {
            let default = if SIMULATED { format!(" [{:?}]", Self::default_of(field)) } else { String::new() };
            let unit = if field.unit.is_empty() { "NUMBER" } else { field.unit };
            command.arg(
                clap::Arg::new(field.name)
                    .long(field.name.replace('_', "-"))
                    .value_name(unit)
                    .value_parser(clap::value_parser!(f64))
                    .allow_hyphen_values(true)
                    .help_heading(heading)
                    .help(format!("{}{default}", field.help))
                    .hide_short_help(heading.ends_with("instruments")),
            )
        })
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl<const SIMULATED: bool> FromArgMatches for PlantArgs<SIMULATED> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let value = |name: &str| matches.get_one::<f64>(name).map(|value| (name.to_string(), *value));
        Ok(Self { given: Self::fields().filter_map(|(_, field)| value(field.name)).collect() })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}
