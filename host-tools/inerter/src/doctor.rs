//! Why this machine cannot use a device: ports that cannot be opened, missing rules, versions.

use std::{fs, path::Path};

use inerter_device::{
    self, Clock, DEFAULT_BAUD, Device, DeviceError, Port, Target,
    board::{ST_VID, USB_VID},
    dfu::{self, DfuDevice},
    list,
    udev::install_rule,
    update::UpdateError,
};
use inerter_simulate::qemu_version;
use inerter_wire::WIRE_VERSION;
use miette::Diagnostic;
use serde::Serialize;

/// Where udev looks for rules.
const RULES: [&str; 4] = ["/etc/udev/rules.d", "/run/udev/rules.d", "/usr/lib/udev/rules.d", "/lib/udev/rules.d"];

/// State of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Condition {
    /// As it should be.
    Good,
    /// Not needed now, or only for some work.
    Warning,
    /// A device cannot be used in this state.
    Problem,
}

/// One thing that was checked.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Check {
    /// What was checked.
    pub topic: &'static str,
    /// Its state.
    pub condition: Condition,
    /// What was found.
    pub text: String,
    /// What to do about it, if anything.
    pub advice: Option<String>,
}

impl Check {
    /// A check that found no problem.
    pub fn good(topic: &'static str, text: impl Into<String>) -> Self {
        Self { topic, condition: Condition::Good, text: text.into(), advice: None }
    }

    fn warning(topic: &'static str, text: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { topic, condition: Condition::Warning, text: text.into(), advice: Some(advice.into()) }
    }

    fn of(topic: &'static str, error: &impl Diagnostic) -> Self {
        let advice = error.help().map(|help| help.to_string());
        Self { topic, condition: Condition::Problem, text: error.to_string(), advice }
    }
}

/// Checks everything; asks the connected devices, or only `target`, for their identity.
pub fn examine(target: Option<&Target>) -> Vec<Check> {
    let version = format!("inerter {}, wire version {WIRE_VERSION}", env!("CARGO_PKG_VERSION"));
    let mut checks = vec![Check::good("program", version)];
    match target {
        Some(target) => checks.push(asked(target)),
        None => checks.extend(plugged_in(&list())),
    }
    checks.extend(waiting(dfu::list(), dfu::may_open));
    if cfg!(target_os = "linux") {
        checks.push(rule(&RULES.map(Path::new)));
        checks.extend(modem_manager(Path::new("/proc")));
    }
    checks.push(match qemu_version() {
        Some(version) => Check::good("simulation", version),
        None => Check::warning(
            "simulation",
            "qemu-system-arm is not installed; only `inerter simulate --qemu` needs it",
            "install Debian's qemu-system-arm, or the package of that name elsewhere",
        ),
    });
    checks
}

/// All our devices that are plugged in; if none, the ports that exist.
pub fn plugged_in(ports: &[Port]) -> Vec<Check> {
    let ours: Vec<Check> = ports
        .iter()
        .filter(|port| port.inerter)
        .map(|port| asked(&Target::Port { port: port.port.clone(), baud: DEFAULT_BAUD }))
        .collect();
    if !ours.is_empty() {
        return ours;
    }
    let links: Vec<&str> = ports.iter().filter(|port| port.stlink).map(|port| port.port.as_str()).collect();
    let (text, advice) = match links.first() {
        Some(link) => (
            format!("no inerter over USB; an ST-Link is at {}", links.join(", ")),
            format!("it carries a NUCLEO's UART: inerter doctor --port {link}"),
        ),
        None => (
            format!("no inerter among {}", inerter_data::words::plural(ports.len() as u64, "serial port")),
            "plug in the board's own USB connector; a charging cable without data lines does not work".to_string(),
        ),
    };
    vec![Check::warning("device", text, advice)]
}

/// Who answers at this target.
fn asked(target: &Target) -> Check {
    match Device::connect(target, Clock::new(), || false) {
        Ok(device) => {
            let hello = device.hello();
            let text = format!(
                "{} (serial {}) at {}: {}, wire version {}, {} Hz",
                hello.board,
                hello.serial,
                device.name(),
                hello.firmware,
                hello.wire_version,
                hello.sample_rate_hz
            );
            Check::good("device", text)
        }
        Err(error @ DeviceError::Permission { .. }) => {
            let check = Check::of("device", &error);
            Check {
                advice: check.advice.map(|advice| format!("{advice}; or install the rule: {}", install_rule())),
                ..check
            }
        }
        Err(error) => Check::of("device", &error),
    }
}

/// Devices in update mode, and whether this user may open them.
pub fn waiting(
    found: Result<Vec<DfuDevice>, UpdateError>,
    may_open: impl Fn(&DfuDevice) -> Result<(), UpdateError>,
) -> Vec<Check> {
    let check = |device: &DfuDevice| match may_open(device) {
        Ok(()) => Check::warning(
            "update mode",
            format!("a device (serial {}) is waiting for firmware", device.serial),
            "load firmware with `inerter update FILE`, or reset the device",
        ),
        Err(error) => Check::of("update mode", &error),
    };
    match found {
        Ok(devices) => devices.iter().map(check).collect(),
        Err(error) => vec![Check { condition: Condition::Warning, ..Check::of("update mode", &error) }],
    }
}

fn rule(folders: &[&Path]) -> Check {
    let needed = [USB_VID, ST_VID].map(|vendor| format!("{vendor:04x}"));
    let files = folders.iter().filter_map(|folder| fs::read_dir(folder).ok()).flatten().flatten();
    let found = files
        .filter_map(|file| Some((file.path(), fs::read_to_string(file.path()).ok()?)))
        .find(|(_, text)| needed.iter().all(|number| text.to_lowercase().contains(number)));
    match found {
        Some((path, _)) => Check::good("udev rule", path.display().to_string()),
        None => Check::warning(
            "udev rule",
            "none for the inerter: updating needs one, and ModemManager may hold a port just after it is plugged in",
            install_rule(),
        ),
    }
}

/// ModemManager probes every new port for a modem.
fn modem_manager(proc: &Path) -> Option<Check> {
    let runs = fs::read_dir(proc)
        .ok()?
        .flatten()
        .any(|process| fs::read_to_string(process.path().join("comm")).is_ok_and(|name| name.trim() == "ModemManager"));
    runs.then(|| {
        Check::warning(
            "ModemManager",
            "is running, and opens each new serial port for some seconds unless a rule says that it is not a modem",
            "install the udev rule above, which says so",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rule_is_found_by_what_it_says() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("none");
        fs::write(folder.path().join("60-other.rules"), "ATTRS{idVendor}==\"0483\", ATTRS{idProduct}==\"df11\"\n")
            .unwrap();
        let check = rule(&[&missing, folder.path()]);
        assert_eq!(check.condition, Condition::Warning);
        assert!(check.advice.unwrap().contains("inerter doctor --udev-rule | sudo tee"));
        fs::write(folder.path().join("70-mine.rules"), inerter_device::udev::udev_rule()).unwrap();
        let check = rule(&[&missing, folder.path()]);
        assert_eq!(check.condition, Condition::Good);
        assert!(check.text.ends_with("70-mine.rules"));
    }

    #[test]
    fn modem_manager_is_seen_among_the_processes() {
        let proc = tempfile::tempdir().unwrap();
        fs::create_dir(proc.path().join("17")).unwrap();
        fs::write(proc.path().join("17/comm"), "bash\n").unwrap();
        assert_eq!(modem_manager(proc.path()), None);
        fs::create_dir(proc.path().join("18")).unwrap();
        fs::write(proc.path().join("18/comm"), "ModemManager\n").unwrap();
        assert_eq!(modem_manager(proc.path()).unwrap().condition, Condition::Warning);
    }

    #[test]
    fn a_port_that_is_not_there_is_a_problem_with_advice() {
        let check = asked(&Target::Port { port: "/dev/no-such-port".into(), baud: 9600 });
        assert_eq!(check.condition, Condition::Problem);
        assert!(check.text.contains("/dev/no-such-port") && check.advice.is_some());
    }
}
