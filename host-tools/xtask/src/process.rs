//! Starting other programs, with errors that name the command.

use anyhow::{Context, Result, anyhow, ensure};
use std::{
    cell::Cell,
    ffi::OsStr,
    fs::File,
    io::{self, Read},
    path::Path,
    process::{Child, Command, ExitStatus, Stdio},
    thread,
    time::{Duration, Instant},
};
use wait4::Wait4;

thread_local! {
    static SPENT: Cell<Duration> = const { Cell::new(Duration::ZERO) };
}

/// CPU time of the programs that this thread has run to their end without a limit; on Unix including their children.
pub fn spent() -> Duration {
    SPENT.get()
}

/// Adds what another thread has [`spent`] to this one's.
pub fn count(time: Duration) {
    SPENT.set(SPENT.get() + time);
}

/// Waits for the end.
fn ended(mut child: Child) -> io::Result<ExitStatus> {
    let ended = child.wait4()?;
    count(ended.rusage.utime + ended.rusage.stime);
    Ok(ended.status)
}

/// Waits for the end, and kills the program at the limit. Its CPU time is not counted, as only a wait without a limit
/// tells it.
fn ended_within(mut child: Child, limit: Duration) -> io::Result<ExitStatus> {
    let start = Instant::now();
    while start.elapsed() <= limit {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        thread::sleep(Duration::from_millis(20));
    }
    // Both calls fail only if the program has just ended by itself.
    let _ = child.kill();
    let _ = child.wait();
    Err(io::Error::other(format!("it was still running after {} s and was ended", limit.as_secs())))
}

/// The cargo that started this program.
pub fn cargo() -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.current_dir(crate::tree::root());
    command
}

/// The compiler that belongs to [`cargo`].
pub fn rustc() -> Command {
    Command::new(std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into()))
}

/// The system for which [`rustc`] compiles.
pub fn host_tuple() -> Result<String> {
    Ok(output(rustc().args(["--print", "host-tuple"]))?.trim().to_owned())
}

/// The command as typed in a shell.
pub fn shown(command: &Command) -> String {
    let quote = |text: &OsStr| {
        let text = text.to_string_lossy().into_owned();
        if text.is_empty() || text.contains([' ', '"', '$']) { format!("'{text}'") } else { text }
    };
    let program = command.get_program();
    let name = Path::new(program).file_name().unwrap_or(program);
    std::iter::once(quote(name)).chain(command.get_args().map(quote)).collect::<Vec<_>>().join(" ")
}

/// Starts a program.
pub fn spawn(command: &mut Command) -> Result<Child> {
    command.spawn().with_context(|| format!("cannot start `{}`", shown(command)))
}

/// Runs a program to its end; its output goes where this program's does. Fails if that program fails.
pub fn run(command: &mut Command) -> Result<()> {
    let status = ended(spawn(command)?).with_context(|| format!("waiting for `{}`", shown(command)))?;
    ensure!(status.success(), "`{}` failed ({status})", shown(command));
    Ok(())
}

/// The same, after a line with the command.
pub fn run_shown(command: &mut Command) -> Result<()> {
    println!("  $ {}", shown(command));
    run(command)
}

/// The same, with all output in a file.
pub fn run_into(command: &mut Command, file: &Path) -> Result<()> {
    let out = File::create(file).with_context(|| format!("cannot write {}", file.display()))?;
    let errors = out.try_clone().with_context(|| format!("cannot write {}", file.display()))?;
    run(command.stdin(Stdio::null()).stdout(out).stderr(errors))
}

/// Runs to the end and returns what was printed; errors stay on the terminal.
pub fn output(command: &mut Command) -> Result<String> {
    printed(command, ended)
}

/// The same with a time limit, at which the program is killed.
pub fn output_within(command: &mut Command, limit: Duration) -> Result<String> {
    printed(command, |child| ended_within(child, limit))
}

/// What a program prints until its end, for which `wait` waits.
fn printed(command: &mut Command, wait: impl FnOnce(Child) -> io::Result<ExitStatus>) -> Result<String> {
    let mut child = spawn(command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::inherit()))?;
    let mut pipe = child.stdout.take().context("no pipe to the program's output")?;
    let reader = thread::spawn(move || {
        let mut bytes = Vec::new();
        pipe.read_to_end(&mut bytes).map(|_| bytes)
    });
    let status = wait(child).with_context(|| format!("waiting for `{}`", shown(command)))?;
    ensure!(status.success(), "`{}` failed ({status})", shown(command));
    let bytes = reader.join().map_err(|_| anyhow!("reading what `{}` prints panicked", shown(command)))??;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// The version line of a program that may be missing.
pub fn version(program: impl AsRef<OsStr>) -> Option<String> {
    first_line(Command::new(program).arg("--version"))
}

/// First line printed by a program that may be missing.
pub fn first_line(command: &mut Command) -> Option<String> {
    let done = command.stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    String::from_utf8_lossy(&done.stdout).lines().next().filter(|_| done.status.success()).map(str::to_owned)
}

/// A line above a step's own output.
pub fn heading(name: &str) {
    println!("\n== {name} {}", "=".repeat(76_usize.saturating_sub(name.len())));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_shown_as_typed() {
        let mut command = Command::new("/usr/bin/cargo");
        command.args(["test", "--", "a b"]);
        assert_eq!(shown(&command), "cargo test -- 'a b'");
    }

    #[test]
    fn a_program_that_is_not_there_is_named() {
        let error = run(&mut Command::new("no-such-program-4711")).unwrap_err();
        assert!(format!("{error:#}").contains("no-such-program-4711"));
    }

    #[cfg(unix)]
    #[test]
    fn processor_time_is_counted_by_thread() {
        let before = spent();
        let there = std::thread::spawn(|| {
            let work = "i=0; while [ $i -lt 100000 ]; do i=$((i+1)); done";
            run(Command::new("sh").args(["-c", work])).map(|()| spent())
        });
        let there = there.join().unwrap().unwrap();
        assert!(there > Duration::from_millis(1), "{there:?}");
        assert_eq!(spent(), before);
        count(there);
        assert_eq!(spent(), before + there);
        assert_eq!(output(Command::new("sh").args(["-c", "echo one; exit 0"])).unwrap(), "one\n");
        assert!(output(Command::new("sh").args(["-c", "exit 3"])).unwrap_err().to_string().contains("exit status: 3"));
    }

    #[cfg(unix)]
    #[test]
    fn a_program_that_hangs_is_ended() {
        // The second one closes its output first.
        for script in ["exec sleep 30", "exec sleep 30 >&-"] {
            let error = output_within(Command::new("sh").args(["-c", script]), Duration::from_millis(50)).unwrap_err();
            assert!(format!("{error:#}").contains("still running"), "{error:#}");
        }
    }
}
