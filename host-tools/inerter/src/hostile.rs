//! Untrusted text, for tests.

/// Writes the clipboard, forges a line, changes the writing direction, sets a colour with a single character, and hides
/// a character by itself and one behind a letter.
pub const WORDS: &str = "\u{1b}]52;c;aGk=\u{7}\nforged\u{202e}\u{9b}31m\u{200b}x\u{e0041}";

/// The same as it may reach a terminal.
pub const SHOWN: &str = r"\u001b]52;c;aGk=\u0007\nforged\u202e\u009b31m\u200bx\udb40\udc41";
