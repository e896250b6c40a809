//! Why a file is not converted.

/// What keeps a file from being converted, in words.
pub type Error = Box<dyn std::error::Error + Send + Sync>;
