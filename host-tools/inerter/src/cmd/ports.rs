//! `inerter ports`: where devices can be reached.

use std::io::{self, Write};

use inerter_data::{
    json::json_line,
    output::{self, OutputError},
};
use inerter_device::{Port, dfu, list};

use super::{print::Kind, terminal::note};
use crate::Error;

/// List the serial ports of this machine, and devices in update mode.
///
/// Instrumented inerters come first and are marked with *, then ST-Links, which carry the UART of a NUCLEO; devices in
/// update mode, which wait for `inerter update`, come last. If there are none it prints only a note. With --json
/// one object per line:
/// {"kind":"port","port":"/dev/ttyACM0","inerter":true,"stlink":false,"product":..,"serial":..,"vid":..,"pid":..},
/// {"kind":"dfu","product":..,"serial":..,"vid":..,"pid":..}
#[derive(clap::Args)]
pub struct Args {
    /// Print JSON, one object per line
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let ports = list();
    // A machine on which USB devices cannot be listed still has its serial ports.
    let waiting = dfu::list().unwrap_or_default();
    print(&ports, &waiting, args.json, &mut io::stdout().lock())?;
    if ports.is_empty() && waiting.is_empty() && !args.json {
        note("this machine has no serial ports; `inerter simulate --pty` makes a simulated one");
    }
    Ok(())
}

/// Prints a line for each.
fn print(ports: &[Port], waiting: &[dfu::DfuDevice], json: bool, out: &mut impl Write) -> Result<(), OutputError> {
    let port = |port| if json { json_line(&Kind { kind: "port", of: port }) } else { port_line(port) };
    let device = |device| if json { json_line(&Kind { kind: "dfu", of: device }) } else { dfu_line(device) };
    ports.iter().map(port).chain(waiting.iter().map(device)).try_for_each(|line| output::line_to(out, line))
}

fn port_line(port: &Port) -> String {
    let usb = match (port.vid, port.pid) {
        (Some(vid), Some(pid)) => format!("{vid:04x}:{pid:04x}"),
        _ => String::new(),
    };
    let mark = if port.inerter { "*" } else { " " };
    let product = port.product.as_deref().unwrap_or_default();
    let product = if port.stlink { format!("{product} (ST-Link: UART)") } else { product.to_string() };
    line(mark, &port.port, &usb, &product, port.serial.as_deref())
}

fn dfu_line(device: &dfu::DfuDevice) -> String {
    let usb = format!("{:04x}:{:04x}", device.vid, device.pid);
    let product = device.product.as_deref().unwrap_or("STM32");
    line("+", "in update mode", &usb, product, Some(&device.serial))
}

fn line(mark: &str, port: &str, usb: &str, product: &str, serial: Option<&str>) -> String {
    format!("{mark} {port:<20} {usb:<9} {product:<28} {}", serial.unwrap_or_default()).trim_end().to_string()
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;
    use crate::hostile::{SHOWN, WORDS, board, printed, probe};

    #[test]
    fn a_line_says_what_is_there() {
        let port = Port {
            port: "/dev/ttyACM0".into(),
            inerter: true,
            stlink: false,
            product: Some("inerter".into()),
            serial: Some("205735883537".into()),
            vid: Some(0x1209),
            pid: Some(1),
        };
        let words = "* /dev/ttyACM0         1209:0001 inerter                      205735883537";
        assert_eq!(port_line(&port), words);
        let link = Port {
            inerter: false,
            stlink: true,
            product: Some("STLINK-V3".into()),
            serial: None,
            vid: Some(0x0483),
            pid: Some(0x374E),
            ..port
        };
        assert_eq!(port_line(&link), "  /dev/ttyACM0         0483:374e STLINK-V3 (ST-Link: UART)");
        let device = dfu::DfuDevice { product: None, serial: "205735883537".into(), vid: 0x0483, pid: 0xDF11 };
        let words = "+ in update mode       0483:df11 STM32                        205735883537";
        assert_eq!(dfu_line(&device), words);
        let json = json_line(&Kind { kind: "dfu", of: &device });
        assert_eq!(json, r#"{"kind":"dfu","product":null,"serial":"205735883537","vid":1155,"pid":57105}"#);
    }

    #[test]
    fn no_usb_device_writes_to_the_terminal_what_it_likes() {
        let (ports, waiting) = ([probe("/dev/ttyACM0")], [board()]);
        let [text, json] = printed(|json, out| print(&ports, &waiting, json, out));
        assert_eq!((text.lines().count(), text.matches(SHOWN).count()), (2, 4), "{text}");
        // In JSON the same escapes represent the text itself.
        let names = |line: &str| {
            let value: Value = serde_json::from_str(line).unwrap();
            (value["product"] == WORDS, value["serial"] == WORDS)
        };
        assert_eq!(json.lines().map(names).collect::<Vec<_>>(), [(true, true); 2], "{json}");
    }
}
