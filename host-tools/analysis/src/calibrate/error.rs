//! Why a calibration gives no result, and what to do about it.

use inerter_data::words::amount_text;
use miette::Diagnostic;

/// Samples, loads or displacements that give no setting.
#[derive(Clone, Debug, PartialEq, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum CalibrateError {
    /// Too few samples.
    #[error("{seconds:.1} s of samples are too few: {needed:.1} s are needed")]
    #[diagnostic(
        code(inerter::calibrate::short),
        help("measure longer (--duration), and check with `inerter monitor` that samples arrive")
    )]
    TooShort { seconds: f64, needed: f64 },

    /// The force is at a rail.
    #[error("the force code is at its limit{at}: {share:.0} % of the samples are saturated")]
    #[diagnostic(
        code(inerter::calibrate::saturated),
        help(
            "check the wiring of the load cell; if it is right, lower the load or the amplifier's gain, or shake less hard. \
            force_min_code and force_max_code are the limits"
        )
    )]
    Saturated { at: String, share: f64 },

    /// Faster than the full-scale settings.
    #[error("{share:.0} % of the samples are left out: {words}")]
    #[diagnostic(
        code(inerter::calibrate::full_scale),
        help("raise full scale beyond what the machine reaches, and retry")
    )]
    FullScale { share: f64, words: String },

    /// The force is not at rest.
    #[error(
        "the force does not settle{at}: it varies by {} {unit}; up to {} {unit} is allowed",
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

    /// The screw moves.
    #[error("the screw turns{at}: the encoder moved by {counts:.0} counts")]
    #[diagnostic(code(inerter::calibrate::moving), help("lock the screw, or hold it still, while this is measured"))]
    Moving { at: String, counts: f64 },

    /// Too few points.
    #[error("{count} {what} with {different} different values are too few for a scale")]
    #[diagnostic(
        code(inerter::calibrate::points),
        help("give at least three, with two different values, and return to the first: {example}")
    )]
    TooFewPoints { what: &'static str, count: usize, different: usize, example: &'static str },

    /// The reading does not change.
    #[error("the {what} hardly changes: by {change:.1} over all {of}; a scale needs at least {needed:.1}")]
    #[diagnostic(code(inerter::calibrate::unchanged), help("{help}"))]
    Unchanged { what: &'static str, of: &'static str, change: f64, needed: f64, help: &'static str },

    /// The reading rises for either sign.
    #[error("the force code {direction} for loads in both directions: pushing and pulling cannot be distinguished")]
    #[diagnostic(
        code(inerter::calibrate::both_ways),
        help(
            "were both loads put on the same side? If not, a wire of the cell (signal +, signal - or \
             supply) is swapped or loose, or the amplifier cannot go below zero. Check the sign of each stated load, then the wiring"
        )
    )]
    BothWays { direction: &'static str },

    /// The points are not on a line.
    #[error("the {what} do not lie on a line: they deviate by up to {percent:.1} % of the largest; {worst} fits worst")]
    #[diagnostic(
        code(inerter::calibrate::crooked),
        help(
            "was it typed right, with its unit and sign? If so, something touches, sticks or hits a stop there: check \
            and repeat"
        )
    )]
    Crooked { what: &'static str, percent: f64, worst: String },

    /// Counts and revolutions do not agree.
    #[error("{counts:.0} counts in {revolutions} revolutions are {per_revolution:.0} each, not {expected:.0}")]
    #[diagnostic(code(inerter::calibrate::counts), help("{help}"))]
    Counts { counts: f64, revolutions: f64, per_revolution: f64, expected: f64, help: &'static str },

    /// No whole number is close enough.
    #[error("{per_revolution:.1} counts per revolution, give or take {tolerance:.1}, fits many encoders")]
    #[diagnostic(
        code(inerter::calibrate::ambiguous),
        help("give the encoder's lines with --lines, or turn it through more revolutions, mark to mark")
    )]
    Ambiguous { per_revolution: f64, tolerance: f64 },

    /// Too little motion.
    #[error("this motion cannot identify the inertance: force and acceleration cannot be compared")]
    #[diagnostic(
        code(inerter::calibrate::motion),
        help("move the terminal back and forth by a few millimetres, several times a second, while this is measured")
    )]
    NoMotion,

    /// The scale of one of them is unknown.
    #[error("{0} is needed")]
    #[diagnostic(code(inerter::calibrate::missing), help("{1}"))]
    Missing(&'static str, &'static str),

    /// The measurement succeeded, but the result is bad.
    #[error("{} found", inerter_data::words::plural(*problems as u64, "problem"))]
    #[diagnostic(
        code(inerter::calibrate::unfit),
        help("each is listed above with what to do; nothing was changed on the device")
    )]
    Unfit { problems: usize },
}
