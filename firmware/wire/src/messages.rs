//! What a kind of message is, and how the enums of messages are declared.

/// Version of the numbers and layouts in this crate. It changes only when an existing one changes its meaning, not when
/// something is added at the end of a list.
pub const WIRE_VERSION: u16 = 1;

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

/// Declares an enum of messages together with its [`Entry`] table.
///
/// Numbers are written out so that a line inserted in the middle fails to compile: they are the postcard discriminants.
/// New lines go at the end.
macro_rules! messages {
    ($(#[$meta:meta])* enum $name:ident { $($number:literal $variant:ident $(($(#[$form:meta])* $payload:ty))? $doc:literal;)+ }) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        pub enum $name {
            $(#[doc = $doc] $variant $(($(#[$form])* $payload))?,)+
        }

        impl $name {
            /// Number, name and meaning of every variant, by number.
            pub const TABLE: &'static [crate::messages::Entry] = &[
                $(crate::messages::Entry { number: $number, name: stringify!($variant), doc: $doc },)+
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

/// What to do about a device or recording with another wire version.
pub struct VersionAdvice {
    /// The other end's version.
    pub theirs: u16,
}

impl core::fmt::Display for VersionAdvice {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        if self.theirs > WIRE_VERSION {
            write!(f, "use a newer `inerter` program: one that speaks wire version {}", self.theirs)
        } else {
            write!(f, "update the firmware of the device to one that speaks wire version {WIRE_VERSION}")
        }
    }
}
