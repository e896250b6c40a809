//! Why a figure cannot be drawn.

use miette::Diagnostic;

/// Why a figure cannot be drawn.
#[derive(Clone, Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum PageError {
    /// The run has no data for it.
    #[error("{file}: there is no figure `{figure}`: {reason}")]
    #[diagnostic(code(inerter::page::not_shown), help("`inerter report` makes all figures that this run has"))]
    NotShown { file: String, figure: &'static str, reason: String },
    /// The output's name does not determine a format.
    #[error("{path} has neither the ending .svg nor .png")]
    #[diagnostic(code(inerter::page::format), help("end the name with .svg for print and pages, or with .png"))]
    Format { path: String },
}
