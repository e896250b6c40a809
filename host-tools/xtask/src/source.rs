//! Rust source without its comments, strings and tests, as far as a rule about tokens needs it.

/// A float type or literal.
#[derive(Debug, PartialEq, Eq)]
pub struct Found {
    /// Line, from 1.
    pub line: usize,
    /// The token.
    pub token: String,
}

/// The source with comments, strings and character literals replaced by blanks; line breaks stay where they are.
pub fn code_only(text: &str) -> String {
    let bytes = text.as_bytes();
    let mut out = bytes.to_vec();
    let mut at = 0;
    while at < bytes.len() {
        let end = blank_end(bytes, at);
        if end > at {
            for byte in &mut out[at..end] {
                if *byte != b'\n' {
                    *byte = b' ';
                }
            }
            at = end;
        } else if is_word(bytes[at]) {
            // Over a whole word at once, so that the r of `for` starts no raw string.
            while at < bytes.len() && is_word(bytes[at]) {
                at += 1;
            }
        } else {
            at += 1;
        }
    }
    String::from_utf8_lossy(&out).into_owned()
}

/// End of the comment, string or character literal that starts at `at`, or `at` itself when none does.
fn blank_end(bytes: &[u8], at: usize) -> usize {
    let rest = &bytes[at..];
    if rest.starts_with(b"//") {
        return rest.iter().position(|&byte| byte == b'\n').map_or(bytes.len(), |length| at + length);
    }
    if rest.starts_with(b"/*") {
        let (mut depth, mut here) = (1, at + 2);
        while here < bytes.len() && depth > 0 {
            match bytes[here..] {
                [b'/', b'*', ..] => (depth, here) = (depth + 1, here + 2),
                [b'*', b'/', ..] => (depth, here) = (depth - 1, here + 2),
                _ => here += 1,
            }
        }
        return here;
    }
    let letters = rest.iter().take(2).take_while(|byte| matches!(byte, b'b' | b'c' | b'r')).count();
    let raw = letters > 0 && rest[letters - 1] == b'r';
    let hashes = rest[letters..].iter().take_while(|&&byte| byte == b'#').count();
    if rest.get(letters + hashes) == Some(&b'"') && (hashes == 0 || raw) {
        let mut here = at + letters + hashes + 1;
        while here < bytes.len() {
            if !raw && bytes[here] == b'\\' {
                here += 2;
            } else if bytes[here] == b'"'
                && bytes[here + 1..].iter().take_while(|&&byte| byte == b'#').count() >= hashes
            {
                return here + 1 + hashes;
            } else {
                here += 1;
            }
        }
        return bytes.len();
    }
    if rest[0] == b'\'' {
        // A lifetime has no closing quote after one character.
        if rest.get(1) == Some(&b'\\') {
            return rest.iter().skip(3).position(|&byte| byte == b'\'').map_or(bytes.len(), |length| at + length + 4);
        }
        // Bytes of the character, by its first one.
        let width = match rest.get(1) {
            Some(0xc0..=0xdf) => 2,
            Some(0xe0..=0xef) => 3,
            Some(0xf0..) => 4,
            _ => 1,
        };
        if rest.get(1 + width) == Some(&b'\'') {
            return at + width + 2;
        }
    }
    at
}

/// Code with the items under `#[cfg(test)]` blanked as well.
fn without_tests(code: &str) -> String {
    const MARK: &str = "#[cfg(test)]";
    let mut out = code.as_bytes().to_vec();
    let mut from = 0;
    while let Some(start) = code[from..].find(MARK).map(|place| from + place) {
        let mut depth = 0_usize;
        let mut end = out.len();
        for (place, byte) in code.bytes().enumerate().skip(start + MARK.len()) {
            match byte {
                b'{' => depth += 1,
                b'}' => depth = depth.saturating_sub(1),
                _ => {}
            }
            if depth == 0 && matches!(byte, b'}' | b';') {
                end = place + 1;
                break;
            }
        }
        for byte in &mut out[start..end] {
            if *byte != b'\n' {
                *byte = b' ';
            }
        }
        from = end;
    }
    String::from_utf8_lossy(&out).into_owned()
}

/// Every float type (`f32`, `f64`, also as a suffix) and float literal outside comments, strings and tests.
pub fn floats(text: &str) -> Vec<Found> {
    let code = without_tests(&code_only(text));
    let mut found = Vec::new();
    for (number, line) in code.lines().enumerate() {
        let bytes = line.as_bytes();
        let mut at = 0;
        while at < bytes.len() {
            if !is_word(bytes[at]) {
                at += 1;
                continue;
            }
            let start = at;
            while at < bytes.len() && is_word(bytes[at]) {
                at += 1;
            }
            let number_here = bytes[start].is_ascii_digit();
            // `1.0` and `1.` are floats; `1..2` is a range, `1.max(2)` a call and `t.0.1` fields of a tuple.
            let after_dot = start > 0 && bytes[start - 1] == b'.' && !line[..start].ends_with("..");
            if number_here && !after_dot && bytes.get(at) == Some(&b'.') {
                let next = bytes.get(at + 1).copied().unwrap_or(b' ');
                if next.is_ascii_digit() || !(is_word(next) || next == b'.') {
                    at += 1;
                    while at < bytes.len() && is_word(bytes[at]) {
                        at += 1;
                    }
                    found.push(Found { line: number + 1, token: line[start..at].to_owned() });
                    continue;
                }
            }
            let word = &line[start..at];
            let radix = word.starts_with("0x") || word.starts_with("0b") || word.starts_with("0o");
            let exponent = number_here && !radix && !after_dot && word.contains(['e', 'E']) && !word.contains("size");
            let suffix = number_here && !radix && (word.ends_with("f32") || word.ends_with("f64"));
            if matches!(word, "f32" | "f64") || exponent || suffix {
                found.push(Found { line: number + 1, token: word.to_owned() });
            }
        }
    }
    found
}

fn is_word(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'_' || byte >= 0x80
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tokens(text: &str) -> Vec<String> {
        floats(text).into_iter().map(|found| found.token).collect()
    }

    #[test]
    fn floats_in_code_are_found() {
        assert_eq!(tokens("let a: f32 = 1.0;"), ["f32", "1.0"]);
        assert_eq!(tokens("let a = 2f64 + 1e3 + 5.;"), ["2f64", "1e3", "5."]);
        assert_eq!(tokens("let a = b as f64;"), ["f64"]);
        assert_eq!(tokens("let a = 1.5e3_f32;"), ["1.5e3_f32"]);
    }

    #[test]
    fn integers_are_left_alone() {
        for text in [
            "1..2",
            "0..=9",
            "t.0.1",
            "pair.0",
            "1.max(2)",
            "0x1e5",
            "0xf32",
            "1_000usize",
            "self.f32_count",
            "1i64 << 62",
        ] {
            assert!(tokens(text).is_empty(), "{text}: {:?}", tokens(text));
        }
    }

    #[test]
    fn comments_strings_and_tests_do_not_count() {
        let text = "// f32\n/* 1.0 /* f64 */ */ fn a<'x>(b: &'x str, c: char) {}\n/// f32 in a doc\nconst S: &str = \"f64 1.0 \\\" f32\";\n\
            const R: &str = r#\"f32 \" 1.0\"#; const C: char = '\"'; const Q: char = '\\''; const U: char = 'µ';\n\
            #[cfg(test)]\nmod tests {\n fn a() { if true { let x = 1.0; } }\n}\nfn last() -> f32 {}\n";
        assert_eq!(floats(text), [Found { line: 10, token: "f32".into() }]);
    }

    #[test]
    fn lines_keep_their_numbers() {
        let text = "a\n\"two\nlines\"\n/* three\n*/ b";
        assert_eq!(code_only(text).lines().count(), text.lines().count());
    }

    #[test]
    fn a_file_cut_off_anywhere_is_survived() {
        let text = "fn a() { let b = r##\"x\"##; /* c */ 'd' '\\n' \"e\\\"\" b'f' }";
        for end in 0..text.len() {
            let _ = floats(&text[..end]);
        }
    }
}
