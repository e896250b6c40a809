//! Serves the simulated board, running the shipping binary, as a USB device over the network.
//!
//! ```text
//! inerter-twin-usbip [ELF]
//! ```
//!
//! The board is on a moving rig and runs in step with wall-clock time until Ctrl-C. Any Linux with `vhci_hcd` can
//! attach it: `modprobe vhci-hcd` and then, with the printed port, `usbip --tcp-port PORT attach -r 127.0.0.1 -b 1-1`.

use inerter_plant::Excitation;
use inerter_twin::bench::{Bench, Rig};
use inerter_twin::machine::Machine;
use inerter_twin::usb_link::UsbLink;
use inerter_twin::usbip::Server;
use std::error::Error;
use std::process::ExitCode;

/// Path to which `cargo build --release` in firmware/stm32g474 writes the image.
const ELF: &str = "target/thumbv7em-none-eabihf/release/inerter-stm32g474";
/// Time for the firmware to start.
const START_S: f64 = 0.5;

fn serve(path: &str) -> Result<(), Box<dyn Error>> {
    let elf =
        std::fs::read(path).map_err(|error| format!("{path}: {error}; make it with `cargo xtask build-firmware`"))?;
    let rig = Rig::new(Excitation::random(0.5, 15.0, 0.02, 1), START_S);
    let settings = rig.settings(1000.0);
    let mut machine = Machine::new(&elf, Bench::new(rig)?)?;
    machine.run_for(START_S)?;
    let mut link = UsbLink::new(machine);
    link.set_up(&settings)?;
    let mut server = Server::new(link.socket)?;
    println!("{}", server.address()?);
    server.run(|_| false)?;
    Ok(())
}

fn main() -> ExitCode {
    let path = std::env::args().nth(1).unwrap_or_else(|| ELF.into());
    match serve(&path) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
