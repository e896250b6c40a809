//! Tables of records and commands: the one place where their numbers, names and meanings are written.

pub use crate::WIRE_VERSION;
use crate::{Command, Record};

/// One kind of message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Number on the wire.
    pub number: u32,
    /// Name in the code and in recordings.
    pub name: &'static str,
    /// Meaning in one line.
    pub doc: &'static str,
}

/// Every record, by number.
pub const RECORDS: &[Entry] = Record::TABLE;

/// Every command, by number.
pub const COMMANDS: &[Entry] = Command::TABLE;

/// Declares an enum of messages together with its [`Entry`] table.
///
/// Numbers are written out so that a line inserted in the middle fails to compile: they are the postcard
/// discriminants, and new lines go at the end.
macro_rules! messages {
    ($(#[$meta:meta])* enum $name:ident { $($number:literal $variant:ident $(($payload:ty))? $doc:literal;)+ }) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        pub enum $name {
            $(#[doc = $doc] $variant $(($payload))?,)+
        }

        impl $name {
            /// Number, name and meaning of every variant, by number.
            pub const TABLE: &'static [crate::protocol::Entry] = &[
                $(crate::protocol::Entry { number: $number, name: stringify!($variant), doc: $doc },)+
            ];

            /// Number on the wire.
            pub const fn number(&self) -> u32 {
                match self {
                    $(Self::$variant { .. } => $number,)+
                }
            }

            /// Name, as in the code and in recordings.
            pub const fn name(&self) -> &'static str {
                match self {
                    $(Self::$variant { .. } => stringify!($variant),)+
                }
            }
        }

        const _: () = {
            let mut place = 0;
            while place < $name::TABLE.len() {
                assert!($name::TABLE[place].number as usize == place, "numbers count up from 0 without a hole");
                place += 1;
            }
        };
    };
}
pub(crate) use messages;
