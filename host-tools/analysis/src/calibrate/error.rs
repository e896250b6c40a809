//! Why a calibration says nothing, and what to do about it.

use inerter_data::words::amount_text;
use miette::Diagnostic;

/// Samples, loads or displacements from which no setting follows.
#[derive(Clone, Debug, PartialEq, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum CalibrateError {
    /// Too few samples.
    #[error("{seconds:.1} s of samples are too few: {needed:.1} s are needed")]
    #[diagnostic(
        code(inerter::calibrate::short),
        help("listen longer (--duration), and see with `inerter monitor` that samples come")
    )]
    TooShort { seconds: f64, needed: f64 },

    /// At a rail.
    #[error("the force code stands at its limit{at}: {share:.0} % of the samples are saturated")]
    #[diagnostic(
        code(inerter::calibrate::saturated),
        help(
            "check the wiring of the load cell; else lower the load or the amplifier's gain, or shake less hard. force_min_code and \
            force_max_code say where the limits are"
        )
    )]
    Saturated { at: String, share: f64 },

    /// Faster than the estimator was set to expect.
    #[error("{share:.0} % of the samples are left out: {words}")]
    #[diagnostic(code(inerter::calibrate::full_scale), help("set what the machine reaches, with room, and try again"))]
    FullScale { share: f64, words: String },

    /// Not at rest.
    #[error(
        "the force does not come to rest{at}: it wanders by {} {unit}, {} {unit} are allowed",
        amount_text(*wander, 3),
        amount_text(*allowed, 3)
    )]
    #[diagnostic(
        code(inerter::calibrate::unsteady),
        help(
            "let the load hang still, switch drives off, let the amplifier warm up for a quarter of an hour, and try \
            again"
        )
    )]
    Unsteady { at: String, wander: f64, allowed: f64, unit: &'static str },

    /// The screw turns.
    #[error("the screw turns{at}: the encoder moved by {counts:.0} counts")]
    #[diagnostic(code(inerter::calibrate::moving), help("lock the screw, or hold it still, while this is measured"))]
    Moving { at: String, counts: f64 },

    /// Too few points.
    #[error("{count} {what} of {different} different sizes are too few for a scale")]
    #[diagnostic(
        code(inerter::calibrate::points),
        help("give at least three, of two sizes, and come back to the first one: {example}")
    )]
    TooFewPoints { what: &'static str, count: usize, different: usize, example: &'static str },

    /// Nothing happens.
    #[error("the {what} hardly changes: by {change:.1} over all {of}, and {needed:.1} are needed to tell a scale")]
    #[diagnostic(code(inerter::calibrate::unchanged), help("{help}"))]
    Unchanged { what: &'static str, of: &'static str, change: f64, needed: f64, help: &'static str },

    /// Up for either sign.
    #[error("the force code {direction} for loads of either direction: pushing and pulling are not told apart")]
    #[diagnostic(
        code(inerter::calibrate::both_ways),
        help(
            "were both loads put on the same side? If not, a wire is swapped or loose: signal + and - of the cell, \
            or its supply, \
             or the amplifier has no room below zero. Check the sign of each load as given, then the wiring"
        )
    )]
    BothWays { direction: &'static str },

    /// Not a line.
    #[error(
        "the {what} do not lie on a line: they miss it by up to {percent:.1} % of the greatest; {worst} fits worst"
    )]
    #[diagnostic(
        code(inerter::calibrate::crooked),
        help(
            "was it typed right, with its unit and sign? Else something touches, sticks or hits a stop: look at it \
            there and repeat it"
        )
    )]
    Crooked { what: &'static str, percent: f64, worst: String },

    /// Counts and revolutions do not agree.
    #[error("{counts:.0} counts in {revolutions} revolutions are {per_revolution:.0} each, and not {expected:.0}")]
    #[diagnostic(code(inerter::calibrate::counts), help("{help}"))]
    Counts { counts: f64, revolutions: f64, per_revolution: f64, expected: f64, help: String },

    /// No whole number is near enough.
    #[error("{per_revolution:.1} counts per revolution, give or take {tolerance:.1}, may be any of many encoders")]
    #[diagnostic(
        code(inerter::calibrate::ambiguous),
        help("give the encoder's lines with --lines, or turn it by more revolutions, mark to mark")
    )]
    Ambiguous { per_revolution: f64, tolerance: f64 },

    /// No motion to speak of.
    #[error("this motion does not show the inertance: force and acceleration cannot be compared")]
    #[diagnostic(
        code(inerter::calibrate::motion),
        help("move the terminal to and fro by some millimetres, several times a second, while this is measured")
    )]
    NoMotion,

    /// The scale of one of them is unknown.
    #[error("{0} is needed")]
    #[diagnostic(code(inerter::calibrate::missing), help("{1}"))]
    Missing(&'static str, &'static str),

    /// The measurement is there, and it is bad.
    #[error("{} found", inerter_data::words::plural(*problems as u64, "problem"))]
    #[diagnostic(
        code(inerter::calibrate::unfit),
        help("each one says above what to do; nothing was changed on the device")
    )]
    Unfit { problems: usize },
}
