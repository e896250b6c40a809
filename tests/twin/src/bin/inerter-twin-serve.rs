//! Serves a simulated board that runs the shipping binary.
//!
//! ```text
//! inerter-twin-serve tcp|usbip [RATE_HZ [ELF]]
//! ```
//!
//! The board is on a moving rig and samples at 1 kHz, or at the given rate, until Ctrl-C. While it is in use it runs in
//! step with wall-clock time, or slower on a slow computer. The printed address is for
//! - `tcp`: `inerter monitor --connect ADDRESS`, or any other command;
//! - `usbip`: any Linux with `vhci_hcd`: `modprobe vhci-hcd`, then, with the port of the address,
//!   `usbip --tcp-port PORT attach -r 127.0.0.1 -b 1-1`.

use inerter_plant::Excitation;
use inerter_twin::bench::{Bench, Rig};
use inerter_twin::machine::Machine;
use inerter_twin::usb_link::UsbLink;
use inerter_twin::{tcp, usbip};
use std::error::Error;
use std::process::ExitCode;

/// Path to which `cargo build --release` in firmware/stm32g474 writes the image.
const ELF: &str = "target/thumbv7em-none-eabihf/release/inerter-stm32g474";
/// Time for the firmware to start.
const START_S: f64 = 0.5;
const USAGE: &str = "usage: inerter-twin-serve tcp|usbip [RATE_HZ [ELF]]";

/// How the board is reached.
enum Way {
    Tcp,
    Usbip,
}

fn serve(arguments: &[&str]) -> Result<(), Box<dyn Error>> {
    let (way, rate_hz, path) = match *arguments {
        [way] => (way, "1000", ELF),
        [way, rate_hz] => (way, rate_hz, ELF),
        [way, rate_hz, path] => (way, rate_hz, path),
        _ => return Err(USAGE.into()),
    };
    let way = match way {
        "tcp" => Way::Tcp,
        "usbip" => Way::Usbip,
        _ => return Err(USAGE.into()),
    };
    let rate_hz: f64 = rate_hz.parse().map_err(|error| format!("RATE_HZ {rate_hz}: {error}; {USAGE}"))?;
    let elf =
        std::fs::read(path).map_err(|error| format!("{path}: {error}; make it with `cargo xtask build-firmware`"))?;
    let rig = Rig::new(Excitation::random(0.5, 15.0, 0.02, 1), START_S);
    let settings = rig.settings(rate_hz);
    let mut machine = Machine::new(&elf, Bench::new(rig)?)?;
    machine.run_for(START_S)?;
    let mut link = UsbLink::new(machine);
    link.set_up(&settings)?;
    match way {
        Way::Tcp => {
            let listener = tcp::listener()?;
            println!("{}", listener.local_addr()?);
            tcp::serve(&mut link, &listener, || false)?;
        }
        Way::Usbip => {
            let mut server = usbip::Server::new(link.socket)?;
            println!("{}", server.address()?);
            server.run(|_| false)?;
        }
    }
    Ok(())
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match serve(&arguments.iter().map(String::as_str).collect::<Vec<_>>()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
