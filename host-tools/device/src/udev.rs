//! The udev rules that let a user open a device on Linux.

use crate::board::{ST_VID, USB_PID, USB_VID};

/// Path of our rule.
const RULE_FILE: &str = "/etc/udev/rules.d/70-inerter.rules";

/// The udev rule that lets the logged-in user open a device, and keeps other programs off its port.
pub fn udev_rule() -> String {
    format!(
        "# Instrumented inerter: its serial port, which is no modem, its update mode and ST-Links.\n\
         SUBSYSTEM==\"tty\", ATTRS{{idVendor}}==\"{USB_VID:04x}\", ATTRS{{idProduct}}==\"{USB_PID:04x}\", MODE=\"0660\", \
         GROUP=\"dialout\", TAG+=\"uaccess\", ENV{{ID_MM_DEVICE_IGNORE}}=\"1\"\n\
         SUBSYSTEM==\"usb\", ATTR{{idVendor}}==\"{ST_VID:04x}\", MODE=\"0660\", \
         GROUP=\"plugdev\", TAG+=\"uaccess\"\n"
    )
}

/// How our udev rule is installed.
pub fn install_rule() -> String {
    format!(
        "inerter doctor --udev-rule | sudo tee {RULE_FILE} && sudo udevadm control --reload && sudo udevadm trigger"
    )
}

/// The rule that lets the logged-in user open a USB device.
pub fn udev_help(vid: &str, pid: &str) -> String {
    let product = if pid.is_empty() { String::new() } else { format!(", ATTR{{idProduct}}==\"{pid}\"") };
    format!(
        "allow it once: echo 'SUBSYSTEM==\"usb\", ATTR{{idVendor}}==\"{vid}\"{product}, MODE=\"0660\", \
         GROUP=\"plugdev\", TAG+=\"uaccess\"' | sudo tee /etc/udev/rules.d/70-inerter.rules && sudo udevadm control \
         --reload && sudo udevadm trigger; then run the same command again"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rule_names_both_devices() {
        let rule = udev_rule();
        assert!(rule.contains("\"1209\"") && rule.contains("\"0001\"") && rule.contains("\"0483\""));
        assert_eq!(rule.lines().count(), 3);
    }
}
