//! Log lines for a probe, with feature `defmt`; nothing without it.

/// Logs a formatted line at a level: `log!(warn, "lost {} frames", n)`.
macro_rules! log {
    ($level:ident, $($part:expr),+ $(,)?) => {{
        #[cfg(feature = "defmt")]
        defmt::$level!($($part),+);
        #[cfg(not(feature = "defmt"))]
        let _ = ($(&$part),+);
    }};
}
pub(crate) use log;
