//! Init program of the Linux guest, and its command line tool.
//!
//! `inerter-guest serve HOST:PORT` runs the commands that the test at that address sends. `inerter-guest attach
//! HOST:PORT` attaches the device of a USB/IP server and prints the port of the virtual host controller.

use std::net::SocketAddr;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [what, address] = arguments.as_slice() else {
        eprintln!("usage: inerter-guest serve|attach ADDRESS:PORT");
        return ExitCode::from(2);
    };
    let Ok(address) = address.parse::<SocketAddr>() else {
        eprintln!("not an address and port: {address}");
        return ExitCode::from(2);
    };
    let result = match what.as_str() {
        "serve" => inerter_guest::serve(address),
        #[cfg(unix)]
        "attach" => inerter_guest::usbip::attach(address).map(|port| println!("{port}")),
        _ => {
            eprintln!("neither serve nor attach: {what}");
            return ExitCode::from(2);
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
