//! `inerter ports`: the serial ports of this machine.

use inerter::{Error, device, output, report::json_line};
use serde::Serialize;

/// List the serial ports of this machine.
///
/// Instrumented inerters come first and are marked with *.
/// Prints nothing but a note when there are none. With --json one object a line:
/// {"kind":"port","port":"/dev/ttyACM0","inerter":true,"product":..,"serial":..,"vid":..,"pid":..}
#[derive(clap::Args)]
pub struct Args {
    /// Print JSON, one object a line
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct PortJson<'a> {
    kind: &'static str,
    #[serde(flatten)]
    port: &'a device::Port,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let ports = device::list();
    for port in &ports {
        if args.json {
            output::line(json_line(&PortJson { kind: "port", port }))?;
            continue;
        }
        let usb = match (port.vid, port.pid) {
            (Some(vid), Some(pid)) => format!("{vid:04x}:{pid:04x}"),
            _ => String::new(),
        };
        let mark = if port.inerter { "*" } else { " " };
        let (product, serial) =
            (port.product.as_deref().unwrap_or_default(), port.serial.as_deref().unwrap_or_default());
        output::line(format!("{mark} {:<20} {usb:<9} {product:<28} {serial}", port.port).trim_end())?;
    }
    if ports.is_empty() && !args.json {
        super::terminal::note("this machine has no serial ports; `inerter simulate --pty` makes a simulated one");
    }
    Ok(())
}
