//! Why a recording cannot be used.

use std::path::PathBuf;

use inerter_wire::{VersionAdvice, WIRE_VERSION};
use miette::Diagnostic;

/// A recording that cannot be used at all; one that is merely truncated is read up to the cut.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum RecordingError {
    /// The file cannot be read.
    #[error("{path} cannot be read: {source}", path = path.display())]
    #[diagnostic(code(inerter::input::read), help("check the name and that you may read the file"))]
    Read { path: PathBuf, source: std::io::Error },

    /// The file is not MCAP.
    #[error("{file} is not a recording: it does not begin like an MCAP file")]
    #[diagnostic(
        code(inerter::recording::kind),
        help(
            "give a file made by `inerter record` or `inerter simulate`; CSV files are for `inerter replay` and `inerter send`"
        )
    )]
    WrongKind { file: String },

    /// MCAP, but without our channel.
    #[error("{file} is an MCAP file, but it has no channel `raw` with frames of an inerter")]
    #[diagnostic(
        code(inerter::recording::channel),
        help(
            "give a file made by `inerter record` or `inerter simulate`; was this one cut off within its first second?"
        )
    )]
    NoChannel { file: String },

    /// The file has been compressed.
    #[error("{file} has chunks compressed with {compression}, which this program cannot read")]
    #[diagnostic(
        code(inerter::recording::compression),
        help("unpack it first: mcap decompress {file} -o unpacked.mcap")
    )]
    Compressed { file: String, compression: String },

    /// No samples.
    #[error("{file} holds no samples")]
    #[diagnostic(
        code(inerter::recording::samples),
        help("`inerter info {file}` shows what it holds; was the recording stopped at once?")
    )]
    NoSamples { file: String },

    /// No settings.
    #[error("{file} holds no settings: the scales of counts and codes are unknown")]
    #[diagnostic(
        code(inerter::recording::settings),
        help("give them with --settings FILE.toml, or at least --metres-per-count and --set newtons_per_code=NEWTONS")
    )]
    NoSettings { file: String },

    /// Recorded from a device of another wire version.
    #[error("{file} was recorded from a device that speaks wire version {version}; this program speaks {WIRE_VERSION}")]
    #[diagnostic(code(inerter::wire::version), help("{}", VersionAdvice { theirs: *version }))]
    ForeignVersion { file: String, version: u16 },

    /// The range contains nothing.
    #[error("{file} has no samples from {from_s} s to {}: it is {duration_s:.3} s long", end(*to_s))]
    #[diagnostic(
        code(inerter::recording::range),
        help("give --from and --to in seconds since the first sample, with --from below --to")
    )]
    EmptyRange { file: String, from_s: f64, to_s: f64, duration_s: f64 },

    /// Cannot be joined: of different devices.
    #[error("{file} was recorded from the device with serial number {serial}, {other} from {other_serial}")]
    #[diagnostic(code(inerter::recording::device), help("merge recordings of one device; analyse these one by one"))]
    OtherDevice { file: String, serial: String, other: String, other_serial: String },

    /// Cannot be joined: the numbers have different meanings.
    #[error("the setting {setting} is {value} in {file} and {other_value} in {other}")]
    #[diagnostic(
        code(inerter::recording::setting),
        help("merge recordings with the same settings; analyse these one by one")
    )]
    OtherSetting { setting: &'static str, file: String, value: f64, other: String, other_value: f64 },

    /// Cannot be joined: recorded at the same time.
    #[error("{file} and {other} overlap by {overlap_s:.3} s of the host's time: they cannot be joined")]
    #[diagnostic(
        code(inerter::recording::overlap),
        help("is one of them a copy or a part of the other? simulated recordings all begin at time 0")
    )]
    Overlap { file: String, other: String, overlap_s: f64 },
}

/// The end of a range, which may be open.
fn end(to_s: f64) -> String {
    if to_s.is_finite() { format!("{to_s} s") } else { "its end".into() }
}
