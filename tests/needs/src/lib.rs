//! What the tests of several crates need: random numbers, and a word from each test that cannot run.
//!
//! Where an image, a program or a recording is missing, a test is *skipped*: it returns early, and its name and the
//! reason go to standard error and into the list that `cargo xtask test` prints at its end. What that command makes or
//! installs itself is *required* there: its absence fails.

mod random;

pub use random::Random;

use std::{
    env,
    ffi::OsString,
    fs::OpenOptions,
    io::{self, Write},
    path::{Path, PathBuf},
};

/// Variable with the file to which each skipped test appends a line.
pub const LIST: &str = "INERTER_SKIPPED";

/// Variable that makes a failure of what would be a skip; any value but the empty one.
pub const REQUIRED: &str = "INERTER_REQUIRED";

/// What was found; otherwise nothing, and the running test is reported as skipped.
///
/// # Panics
/// Where nothing was found and [`REQUIRED`] is set.
pub fn or_skip<T>(found: Result<T, String>) -> Option<T> {
    match found {
        Ok(found) => Some(found),
        Err(reason) => {
            assert!(set(REQUIRED).is_none(), "{reason}");
            skip(&reason);
            None
        }
    }
}

/// The value of a variable, unless it is empty.
fn set(variable: &str) -> Option<OsString> {
    env::var_os(variable).filter(|value| !value.is_empty())
}

/// Reports the running test as skipped: on standard error and in the list.
///
/// # Panics
/// Where the list cannot be written: the skip would be lost.
pub fn skip(reason: &str) {
    let name = running_test();
    // Not `eprintln`: the test harness swallows what a passing test prints. Nobody may read standard error.
    let _ = writeln!(io::stderr(), "skipped: {name} ({reason})");
    if let Some(list) = set(LIST) {
        self::list(Path::new(&list), &name, reason)
            .unwrap_or_else(|error| panic!("cannot write {}: {error}", list.display()));
    }
}

/// Adds a line to a list.
pub fn list(list: &Path, name: &str, reason: &str) -> io::Result<()> {
    // In one call, as many tests write at once.
    let line = format!("{name} ({})\n", reason.replace('\n', " "));
    OpenOptions::new().create(true).append(true).open(list)?.write_all(line.as_bytes())
}

/// Test program and test: the harness names the thread of each test by it.
fn running_test() -> String {
    let program = env::args_os().next().map(PathBuf::from).unwrap_or_default();
    let program = program.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    // Cargo ends the name with a hash.
    let program = program.rsplit_once('-').map_or(program.as_str(), |(name, _)| name);
    let thread = std::thread::current();
    format!("{program}: {}", thread.name().unwrap_or("a thread without a name"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{
        fs,
        process::{self, Command, Output},
    };

    #[test]
    fn the_running_test_is_named() {
        assert_eq!(running_test(), "inerter_needs: tests::the_running_test_is_named");
    }

    #[test]
    fn a_line_for_each_skip() {
        let list = env::temp_dir().join(format!("inerter-needs-{}", process::id()));
        super::list(&list, "a", "two\nlines").unwrap();
        super::list(&list, "b", "no image").unwrap();
        let text = fs::read_to_string(&list).unwrap();
        fs::remove_file(&list).unwrap();
        assert_eq!(text, "a (two lines)\nb (no image)\n");
    }

    /// Not a test of its own: what the next one starts as another process.
    #[test]
    fn needs_something_where_asked_to() {
        if env::var_os("INERTER_NEEDS_NOTHING_FOUND").is_some() {
            assert_eq!(or_skip::<()>(Err("nothing found".into())), None);
        }
        assert_eq!(or_skip(Ok(1)), Some(1));
    }

    fn without(required: &str, list: &Path) -> Output {
        Command::new(env::current_exe().unwrap())
            .args(["--exact", "tests::needs_something_where_asked_to"])
            .env("INERTER_NEEDS_NOTHING_FOUND", "1")
            .env(REQUIRED, required)
            .env(LIST, list)
            .output()
            .unwrap()
    }

    #[test]
    fn a_skip_is_told_and_listed_and_fails_where_it_is_required() {
        let list = env::temp_dir().join(format!("inerter-needs-list-{}", process::id()));
        let skipped = without("", &list);
        let line = "inerter_needs: tests::needs_something_where_asked_to (nothing found)";
        assert!(skipped.status.success());
        assert!(String::from_utf8_lossy(&skipped.stderr).contains(&format!("skipped: {line}")));
        assert_eq!(fs::read_to_string(&list).unwrap(), format!("{line}\n"));
        fs::remove_file(&list).unwrap();
        assert!(!without("1", &list).status.success());
        assert!(!list.exists());
    }
}
