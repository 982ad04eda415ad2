//! Checks the Bluetooth of this computer by reading the files of Linux that describe it.
use std::{
    fs,
    path::{Path, PathBuf},
};

use super::{is_simulated, Finding};

/// Runs all checks. `root` is the root of the file system, which tests replace. `used` are the adapters of the Bluetooth listeners of
/// the router, if it answers: without one, or with those of the simulated air, the Bluetooth of this computer does not matter.
pub fn findings(root: &Path, used: Option<&[String]>) -> Vec<Finding> {
    let system = System { root };
    let mut findings = vec![system.kernel()];
    if let Some(used) = used.filter(|used| is_simulated(used)) {
        let used = used.join(", ");
        findings.push(Finding::good(
            "adapter",
            format!("{used}, of the simulated air"),
        ));
        return findings;
    }
    let adapters = zenoh_link_ble_bluez::adapters(root);
    let has_adapter = !adapters.is_empty();
    if used.is_some_and(<[String]>::is_empty) && !has_adapter {
        let what = "none, and the configuration of the router has no Bluetooth listener";
        findings.push(Finding::good("adapter", what));
        return findings;
    }
    findings.push(system.adapter(&adapters));
    findings.extend(system.rfkill());
    if has_adapter {
        findings.extend([
            system.bluetoothd(),
            system.rights(),
            system.timing(&adapters),
        ]);
    }
    findings
}

struct System<'a> {
    root: &'a Path,
}

impl System<'_> {
    fn kernel(&self) -> Finding {
        let release = self.text("proc/sys/kernel/osrelease");
        let release = release.trim();
        let version = self.text("proc/version");
        // Debian's release, such as 6.1.0-42-amd64, does not contain the version of the kernel. The package version does.
        let package = debian_package(&version);
        let mut versions = [Some(release), package].into_iter().flatten();
        let is_6_1_192 = versions.any(|version| numbers(version).starts_with(&[6, 1, 192]));
        let kernel = match package {
            Some(package) => format!("Linux {release} (Debian {package})"),
            None => format!("Linux {release}"),
        };
        let advice = "install another kernel (docs/reference/kernels.md)";
        match *numbers(release).as_slice() {
            _ if is_6_1_192 => Finding::wrong(
                "kernel",
                format!("{kernel} breaks Bluetooth until the next boot when a link is lost"),
                advice,
            ),
            [5, 10, 0, build] if build >= 46 => Finding::wrong(
                "kernel",
                format!("{kernel} stops every Bluetooth link after some 100 kB"),
                advice,
            ),
            [major, minor, ..] if (major, minor) < (5, 10) => Finding::poor(
                "kernel",
                format!("{kernel} is older than what RECT is tested with, 5.10"),
                "update the system if links are unstable",
            ),
            _ => Finding::good("kernel", kernel),
        }
    }

    fn adapter(&self, adapters: &[String]) -> Finding {
        const ABOUT: &str = "adapter";
        if !adapters.is_empty() {
            return Finding::good(ABOUT, adapters.join(", "));
        }
        for config in ["boot/firmware/config.txt", "boot/config.txt"] {
            let text = self.text(config);
            let line = text
                .lines()
                .map(str::trim)
                .find(|line| line.starts_with("dtoverlay=") && line.contains("disable-bt"));
            if let Some(line) = line {
                return Finding::wrong(
                    ABOUT,
                    format!("`{line}` in /{config} switches Bluetooth off, as on a KIPR Wombat"),
                    "replace that line by the two lines `dtoverlay=pi3-miniuart-bt` and `core_freq=250` and reboot, or plug in a USB Bluetooth dongle",
                );
            }
        }
        Finding::wrong(
            ABOUT,
            "there is no Bluetooth adapter",
            "plug one in; `dmesg | grep -i bluetooth` shows whether the kernel recognises it. Without one, use an adapter \
             of the simulated air (`rect air`), named sim-...",
        )
    }

    fn rfkill(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        for name in self.names("sys/class/rfkill") {
            let about = PathBuf::from("sys/class/rfkill").join(name);
            let is = |file: &str, text: &str| self.text(about.join(file)).trim() == text;
            if !is("type", "bluetooth") {
                continue;
            }
            if is("hard", "1") {
                findings.push(Finding::wrong(
                    "rfkill",
                    "Bluetooth is switched off by a hardware switch",
                    "turn on the switch of the computer",
                ));
            } else if is("soft", "1") {
                findings.push(Finding::wrong(
                    "rfkill",
                    "Bluetooth is blocked",
                    "`sudo rfkill unblock bluetooth`",
                ));
            }
        }
        findings
    }

    fn bluetoothd(&self) -> Finding {
        const ABOUT: &str = "bluetoothd";
        let runs = self.names("proc").into_iter().any(|process| {
            let is_process = process.bytes().all(|byte| byte.is_ascii_digit());
            is_process && self.text(format!("proc/{process}/comm")).trim() == "bluetoothd"
        });
        if runs {
            return Finding::good(ABOUT, "bluetoothd is running");
        }
        Finding::wrong(
            ABOUT,
            "bluetoothd is not running",
            "`sudo apt install bluez`, then `sudo systemctl enable --now bluetooth`",
        )
    }

    fn rights(&self) -> Finding {
        const ABOUT: &str = "rights";
        let status = self.text("proc/self/status");
        let numbers = |key: &str| -> Vec<u32> {
            let line = status.lines().find_map(|line| line.strip_prefix(key));
            let numbers = line.unwrap_or_default().split_whitespace();
            numbers.filter_map(|number| number.parse().ok()).collect()
        };
        // The IDs are real, effective, saved and file system; the second one counts.
        if numbers("Uid:").get(1) == Some(&0) {
            return Finding::good(ABOUT, "root may use Bluetooth");
        }
        let groups = self.text("etc/group");
        let bluetooth = groups.lines().find_map(|line| {
            let mut fields = line.split(':');
            (fields.next() == Some("bluetooth")).then(|| fields.nth(1)?.parse().ok())?
        });
        match bluetooth {
            Some(group) if numbers("Groups:").contains(&group) => {
                Finding::good(ABOUT, "this user is in the group bluetooth")
            }
            _ => Finding::wrong(
                ABOUT,
                "this user is not in the group bluetooth",
                "`sudo usermod -aG bluetooth $USER`, and log in again",
            ),
        }
    }

    fn timing(&self, adapters: &[String]) -> Finding {
        const ABOUT: &str = "timing";
        let not_set = adapters
            .iter()
            .find(|adapter| !zenoh_link_ble_bluez::is_timing_configured(self.root, adapter));
        let Some(adapter) = not_set else {
            return Finding::good(ABOUT, "connection interval and supervision timeout are set");
        };
        let by_service = format!("rect-bluetooth@{adapter}.service");
        let advice = if self
            .root
            .join("usr/lib/systemd/system/rect-bluetooth@.service")
            .exists()
        {
            format!("`sudo systemctl restart {by_service}`; `systemctl status {by_service}` shows what failed")
        } else {
            "`sudo cp config/bluetooth.conf /etc/bluetooth/main.conf && sudo systemctl restart bluetooth`".to_owned()
        };
        Finding::poor(
            ABOUT,
            format!(
                "{adapter}: connection interval and supervision timeout have BlueZ's defaults: links are slower and less \
                 stable"
            ),
            advice,
        )
    }

    fn text(&self, path: impl AsRef<Path>) -> String {
        fs::read_to_string(self.root.join(path)).unwrap_or_default()
    }

    fn names(&self, folder: &str) -> Vec<String> {
        let entries = fs::read_dir(self.root.join(folder));
        let names = entries.into_iter().flatten().flatten();
        names
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .collect()
    }
}

/// Returns the numbers of a kernel's version, up to the first part that does not begin with a digit.
fn numbers(version: &str) -> Vec<u32> {
    version
        .split(|c: char| !c.is_ascii_digit())
        .map_while(|number| number.parse().ok())
        .collect()
}

/// Returns the version of Debian's kernel package in the content of `/proc/version`, such as `6.1.192-1`, without its
/// epoch.
fn debian_package(version: &str) -> Option<&str> {
    // The compiler, before the build number, has a package version, too.
    let (_, build) = version.rsplit_once('#')?;
    let (_, package) = build.split_once(" Debian ")?;
    let package = package.split_whitespace().next()?;
    Some(package.split_once(':').map_or(package, |(_, rest)| rest))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Verdict;

    /// Returns the findings on a healthy computer with these files changed.
    fn computer(files: &[(&str, &str)]) -> Vec<Finding> {
        let root = tempfile::tempdir().expect("a folder");
        let healthy = [
            ("proc/sys/kernel/osrelease", "6.1.0-25-arm64\n"),
            ("sys/class/bluetooth/hci0/type", ""),
            ("sys/class/bluetooth/hci0:64/type", ""),
            ("sys/class/rfkill/rfkill0/type", "bluetooth\n"),
            ("sys/class/rfkill/rfkill0/soft", "0\n"),
            ("proc/321/comm", "bluetoothd\n"),
            (
                "proc/self/status",
                "Uid:\t1000\t1000\t1000\t1000\nGroups:\t20 112 \n",
            ),
            ("etc/group", "root:x:0:\nbluetooth:x:112:pi\n"),
            (
                "etc/bluetooth/main.conf",
                include_str!("../../../config/bluetooth.conf"),
            ),
        ];
        for (path, text) in healthy.iter().chain(files) {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().expect("a folder")).expect("made");
            fs::write(path, text).expect("written");
        }
        // The text `(none)` stands for a missing file.
        for (path, _) in files.iter().filter(|(_, text)| *text == "(none)") {
            fs::remove_file(root.path().join(path)).expect("removed");
            let folder = root.path().join(path);
            let _ = fs::remove_dir(folder.parent().expect("a folder"));
        }
        findings(root.path(), None)
    }

    fn not_good(findings: &[Finding]) -> Vec<String> {
        let bad = findings.iter().filter(|f| f.verdict != Verdict::Good);
        bad.map(|f| {
            format!(
                "{}: {} -> {}",
                f.about,
                f.what,
                f.advice.clone().unwrap_or_default()
            )
        })
        .collect()
    }

    #[test]
    fn finds_no_problem_on_a_healthy_computer() {
        assert_eq!(not_good(&computer(&[])), Vec::<String>::new());
    }

    #[test]
    fn reports_each_problem_with_advice() {
        let none = ("sys/class/bluetooth/hci0/type", "(none)");
        let wombat = (
            "boot/config.txt",
            "#dtoverlay=disable-bt\ndtoverlay=pi3-disable-bt\n",
        );
        for (files, about, advice) in [
            (
                vec![("proc/sys/kernel/osrelease", "6.1.192-1")],
                "kernel",
                "another kernel",
            ),
            (
                vec![
                    ("proc/sys/kernel/osrelease", "6.1.0-53-amd64"),
                    (
                        "proc/version",
                        "Linux version 6.1.0-53-amd64 (debian-kernel@lists.debian.org) (gcc-12 (Debian 12.2.0-14) 12.2.0, \
                         GNU ld (GNU Binutils for Debian) 2.40) #1 SMP PREEMPT_DYNAMIC Debian 6.1.192-1 (2026-11-02)\n",
                    ),
                ],
                "kernel: Linux 6.1.0-53-amd64 (Debian 6.1.192-1)",
                "another kernel",
            ),
            (
                vec![("proc/sys/kernel/osrelease", "5.10.0-46-amd64")],
                "kernel",
                "another kernel",
            ),
            (
                vec![("proc/sys/kernel/osrelease", "4.19.0-9")],
                "kernel",
                "update",
            ),
            (vec![none], "adapter", "sim-"),
            (vec![none, wombat], "adapter", "miniuart-bt"),
            (
                vec![("sys/class/rfkill/rfkill0/soft", "1")],
                "rfkill",
                "rfkill unblock",
            ),
            (
                vec![("sys/class/rfkill/rfkill0/hard", "1")],
                "rfkill",
                "turn on the switch",
            ),
            (vec![("proc/321/comm", "bash")], "bluetoothd", "systemctl"),
            (
                vec![("etc/group", "bluetooth:x:113:pi\n")],
                "rights",
                "usermod",
            ),
            (vec![("etc/group", "root:x:0:\n")], "rights", "usermod"),
            (
                vec![("etc/bluetooth/main.conf", "")],
                "timing",
                "bluetooth.conf",
            ),
            (
                vec![
                    ("etc/bluetooth/main.conf", ""),
                    ("usr/lib/systemd/system/rect-bluetooth@.service", ""),
                ],
                "timing",
                "restart rect-bluetooth@hci0",
            ),
        ] {
            let bad = not_good(&computer(&files));
            assert_eq!(bad.len(), 1, "{files:?}: {bad:?}");
            assert!(
                bad[0].starts_with(about) && bad[0].contains(advice),
                "{bad:?}"
            );
        }
    }

    #[test]
    fn debian_package_version_is_that_of_the_kernel() {
        for (version, package) in [
            (
                "Linux version 6.1.0-42-amd64 (debian-kernel@lists.debian.org) #1 SMP PREEMPT_DYNAMIC Debian 6.1.159-1 (2025-12-30)",
                Some("6.1.159-1"),
            ),
            (
                "Linux version 6.12.34+rpt-rpi-v8 (serge@raspberrypi.com) #1 SMP PREEMPT Debian 1:6.12.34-1+rpt1 (2025-06-26)",
                Some("6.12.34-1+rpt1"),
            ),
            (
                "Linux version 6.6.1 (pi@wombat) (gcc (Debian 12.2.0-14) 12.2.0) #1 SMP Tue Nov 24",
                None,
            ),
            ("", None),
        ] {
            assert_eq!(debian_package(version), package, "{version}");
        }
    }

    #[test]
    fn accepts_timing_set_by_the_service() {
        let by_service = [
            ("etc/bluetooth/main.conf", ""),
            ("run/rect-bluetooth/hci0", ""),
        ];
        assert_eq!(not_good(&computer(&by_service)), Vec::<String>::new());
    }

    #[test]
    fn accepts_root_without_the_group() {
        let root = ("proc/self/status", "Uid:\t0\t0\t0\t0\nGroups:\t0 \n");
        assert_eq!(not_good(&computer(&[root])), Vec::<String>::new());
    }

    #[test]
    fn the_bluetooth_of_this_computer_matters_only_if_the_router_uses_it() {
        let root = tempfile::tempdir().expect("a folder");
        let adapters =
            |used: &[&str]| -> Vec<String> { used.iter().map(|&one| one.to_owned()).collect() };
        let verdict = |used: Option<&[&str]>| {
            let used = used.map(adapters);
            let found = findings(root.path(), used.as_deref());
            let found = found.iter().find(|finding| finding.about == "adapter");
            found.map(|finding| finding.verdict)
        };
        assert_eq!(verdict(None), Some(Verdict::Wrong));
        assert_eq!(verdict(Some(&["hci0"])), Some(Verdict::Wrong));
        assert_eq!(verdict(Some(&["hci0", "sim-1"])), Some(Verdict::Wrong));
        assert_eq!(verdict(Some(&["sim-1"])), Some(Verdict::Good));
        assert_eq!(verdict(Some(&[])), Some(Verdict::Good));
    }
}
