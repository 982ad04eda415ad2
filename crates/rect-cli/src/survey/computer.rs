//! Describes a computer and its Bluetooth adapters, without addresses and names of people.
use std::{
    collections::BTreeMap,
    fs,
    io::Read,
    path::Path,
    process::{Command, Stdio},
    sync::mpsc,
    thread,
    time::Duration,
};

use serde::{Deserialize, Serialize};

/// Commands that describe the adapters, if they are installed: claimed features, PHYs and roles; chip and firmware; BlueZ.
const COMMANDS: [&[&str]; 5] = [
    &["bluetoothctl", "--version"],
    &["bluetoothctl", "show"],
    &["btmgmt", "info"],
    &["btmgmt", "phy"],
    &["hciconfig", "-a"],
];
/// Lines with these keys may name people or other devices.
const PRIVATE: [&str; 5] = ["name", "short name", "alias", "uuid", "class"];
/// How long a command may take; `btmgmt` waits for ever without a terminal on some systems.
const LIMIT: Duration = Duration::from_secs(2);
/// Largest output that is kept, in bytes.
const MAX_BYTES: u64 = 8192;
const HIDDEN: &str = "XX:XX:XX:XX:XX:XX";

/// A computer and its adapters.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Computer {
    /// The model, such as `Raspberry Pi 3 Model B Rev 1.2`.
    pub model: Option<String>,
    /// The operating system, such as `Debian GNU/Linux 12 (bookworm)`.
    pub system: Option<String>,
    pub kernel: Option<String>,
    pub architecture: String,
    pub adapters: Vec<Adapter>,
    /// The output of commands that describe the adapters.
    pub outputs: BTreeMap<String, String>,
}

/// A Bluetooth adapter.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Adapter {
    pub name: String,
    /// The kernel's driver, such as `btusb` or `hci_uart_bcm`.
    pub driver: Option<String>,
    /// Vendor and product of a USB adapter, such as `0a12:0001`.
    pub usb: Option<String>,
}

impl Computer {
    /// Describes this computer. `root` is the root of the file system, which tests replace.
    pub fn describe(root: &Path) -> Self {
        let model = ["proc/device-tree/model", "sys/class/dmi/id/product_name"];
        let system = text(root, "etc/os-release");
        let system = system
            .iter()
            .flat_map(|text| text.lines())
            .find_map(|line| line.strip_prefix("PRETTY_NAME="));
        let adapters = zenoh_link_ble_bluez::adapters(root);
        Self {
            model: model.iter().find_map(|path| text(root, path)),
            system: system.map(|name| name.trim_matches('"').to_owned()),
            kernel: text(root, "proc/sys/kernel/osrelease"),
            architecture: std::env::consts::ARCH.to_owned(),
            adapters: adapters
                .into_iter()
                .map(|name| adapter(root, name))
                .collect(),
            outputs: outputs(),
        }
    }
}

/// Returns the text of a small file without the ends that the device tree and the kernel add.
fn text(root: &Path, path: &str) -> Option<String> {
    let mut text = String::new();
    let file = fs::File::open(root.join(path)).ok()?;
    file.take(MAX_BYTES).read_to_string(&mut text).ok()?;
    let text = text.trim_matches(|c: char| c == '\0' || c.is_whitespace());
    (!text.is_empty()).then(|| text.to_owned())
}

fn adapter(root: &Path, name: String) -> Adapter {
    let device = root.join("sys/class/bluetooth").join(&name).join("device");
    let usb = |file: &str| text(&device, &format!("../{file}"));
    Adapter {
        driver: file_name(&device.join("driver")),
        usb: usb("idVendor")
            .zip(usb("idProduct"))
            .map(|(vendor, product)| format!("{vendor}:{product}")),
        name,
    }
}

/// Returns the name of the file to which a link leads.
fn file_name(link: &Path) -> Option<String> {
    let target = fs::canonicalize(link).ok()?;
    Some(target.file_name()?.to_string_lossy().into_owned())
}

fn outputs() -> BTreeMap<String, String> {
    let outputs = COMMANDS.iter().filter_map(|command| {
        let output = output(command)?;
        Some((command.join(" "), without_private_parts(&output)))
    });
    outputs.filter(|(_, output)| !output.is_empty()).collect()
}

/// Returns the output of a command; `None` if it is not installed, fails or takes too long.
fn output(command: &[&str]) -> Option<String> {
    let (program, arguments) = command.split_first()?;
    let mut child = Command::new(program)
        .args(arguments)
        // Without anything to read, `btmgmt` ends before it has answered.
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .ok()?;
    let stdout = child.stdout.take()?;
    let (sender, receiver) = mpsc::channel();
    thread::spawn(move || {
        let mut text = Vec::new();
        // An output that is not complete is still useful.
        let _ = stdout.take(MAX_BYTES).read_to_end(&mut text);
        let _ = sender.send(String::from_utf8_lossy(&text).into_owned());
    });
    let output = receiver.recv_timeout(LIMIT).ok();
    // Ends the command if it still runs; otherwise this has no effect.
    let _ = child.kill();
    let _ = child.wait();
    output
}

/// Removes colours, addresses, and the lines that may name people or other devices.
fn without_private_parts(output: &str) -> String {
    let mut lines = Vec::new();
    for line in output.lines() {
        let line = without_colours(line);
        let key = line
            .split([':', ' ', '='])
            .find(|part| !part.trim().is_empty());
        let key = key.map(|key| key.trim().to_lowercase()).unwrap_or_default();
        let is_private = PRIVATE.iter().any(|private| *private == key) || key == "short";
        if !is_private {
            lines.push(without_addresses(&line));
        }
    }
    lines.join("\n").trim_end().to_owned()
}

fn without_colours(line: &str) -> String {
    let mut plain = String::new();
    let mut characters = line.chars();
    while let Some(character) = characters.next() {
        if character != '\u{1b}' {
            plain.push(character);
            continue;
        }
        // An escape sequence ends with a letter.
        for character in characters.by_ref() {
            if character.is_ascii_alphabetic() {
                break;
            }
        }
    }
    plain.replace(|c: char| c.is_control() && c != '\t', "")
}

/// Replaces Bluetooth addresses.
fn without_addresses(line: &str) -> String {
    let mut text = line.to_owned();
    let is_address = |bytes: &[u8]| {
        let places = bytes.iter().enumerate();
        places.into_iter().all(|(at, byte)| match at % 3 {
            2 => matches!(byte, b':' | b'-' | b'_'),
            _ => byte.is_ascii_hexdigit(),
        })
    };
    let mut at = 0;
    while at + HIDDEN.len() <= text.len() {
        if is_address(&text.as_bytes()[at..at + HIDDEN.len()]) {
            text.replace_range(at..at + HIDDEN.len(), HIDDEN);
            at += HIDDEN.len();
        } else {
            at += 1;
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outputs_name_nobody() {
        let shown = "Controller B8:27:EB:12:34:56 (public)\n\tName: Anna's laptop\n\tAlias: anna\n\tRoles: central\n\
                     \u{1b}[0;94m\tAddressType: public\u{1b}[0m\n\tUUID: Generic (00001800-0000-1000-8000-00805f9b34fb)\n";
        assert_eq!(
            without_private_parts(shown),
            "Controller XX:XX:XX:XX:XX:XX (public)\n\tRoles: central\n\tAddressType: public"
        );
        let other = "hci0: addr b8-27-eb-12-34-56 version 7 manufacturer 15 class 0x000000 é\nname raspberrypi\nshort name \n";
        assert_eq!(
            without_private_parts(other),
            "hci0: addr XX:XX:XX:XX:XX:XX version 7 manufacturer 15 class 0x000000 é"
        );
    }

    #[test]
    fn describes_what_the_files_of_linux_say() {
        let root = tempfile::tempdir().expect("a folder");
        let files = [
            ("proc/device-tree/model", "Raspberry Pi 3 Model B Rev 1.2\0"),
            (
                "etc/os-release",
                "ID=debian\nPRETTY_NAME=\"Debian GNU/Linux 12\"\n",
            ),
            ("proc/sys/kernel/osrelease", "6.1.0-25-arm64\n"),
            ("sys/class/bluetooth/hci0/idVendor", "0a12\n"),
            ("sys/class/bluetooth/hci0/idProduct", "0001\n"),
            ("sys/class/bluetooth/hci0/device/type", ""),
            ("sys/class/bluetooth/hci0:64/type", ""),
        ];
        for (path, text) in files {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().expect("a folder")).expect("made");
            fs::write(path, text).expect("written");
        }
        let computer = Computer::describe(root.path());
        assert_eq!(
            computer.model.as_deref(),
            Some("Raspberry Pi 3 Model B Rev 1.2")
        );
        assert_eq!(computer.system.as_deref(), Some("Debian GNU/Linux 12"));
        assert_eq!(computer.kernel.as_deref(), Some("6.1.0-25-arm64"));
        let adapter = Adapter {
            name: "hci0".to_owned(),
            driver: None,
            usb: Some("0a12:0001".to_owned()),
        };
        assert_eq!(computer.adapters, [adapter]);
        assert_eq!(Computer::describe(&root.path().join("none")).model, None);
    }

    #[test]
    fn a_command_that_does_not_end_is_ended() {
        assert_eq!(output(&["sleep", "1000"]), None);
        assert_eq!(output(&["no-such-program"]), None);
    }
}
