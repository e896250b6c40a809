//! What arguments are read as.

use clap::builder::PossibleValuesParser;
use inerter_view::page::Kind;

/// The name of a figure.
pub fn figure() -> PossibleValuesParser {
    PossibleValuesParser::new(Kind::ALL.map(Kind::name))
}
