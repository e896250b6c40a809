//! Tests the program as the guest's first script starts it, on this machine.

use inerter_guest::{Ended, Guest};
use std::net::TcpListener;
use std::process::{Command, Output};
use std::time::Duration;

fn program(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_inerter-guest"));
    command.args(arguments);
    command
}

fn output(arguments: &[&str]) -> Output {
    program(arguments).output().expect("it starts")
}

#[cfg(unix)]
#[test]
fn a_command_runs_at_the_other_end() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("bound").to_string();
    let mut other = program(&["serve", &address]).spawn().expect("it starts");
    let within = Duration::from_secs(10);
    let mut guest = Guest::accept(&listener, within, || true).expect("it calls");
    let ended = guest.run("printf 'a\\0b'; echo wrong >&2; exit 3", within).expect("it answers");
    assert_eq!(ended, Ended { code: 3, output: b"a\0b".to_vec(), errors: "wrong\n".into() });
    assert_eq!(guest.run("kill -9 $$", within).expect("it answers").code, 137);
    drop(guest);
    assert!(other.wait().expect("it was started").success(), "it ends with the test");
}

#[test]
fn what_it_is_not_asked_for_it_refuses() {
    for arguments in [&[][..], &["serve"], &["serve", "nowhere"], &["dance", "127.0.0.1:1"]] {
        let done = output(arguments);
        assert_eq!(done.status.code(), Some(2), "{arguments:?}");
        assert!(!done.stderr.is_empty(), "{arguments:?}");
    }
}

#[test]
fn a_test_that_is_not_there_is_an_error() {
    let address = TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr()).expect("a free port");
    let done = output(&["serve", &address.to_string()]);
    assert_eq!(done.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&done.stderr).starts_with("error: "));
}
