//! Owns asking for a connection's timing: how often its two ends meet, and how long a silent one is kept. The kernel holds
//! both per adapter; bluetoothd sets them from its `main.conf`, and root may in debugfs. No socket option does.
use std::{
    fs, io,
    path::Path,
    sync::atomic::{AtomicBool, Ordering},
};

// Below the root of the file system.
/// Has a file for each adapter that `rect-bluetooth@.service` has seen to.
const SET_BY_SERVICE: &str = "run/rect-bluetooth";
const DEBUGFS: &str = "sys/kernel/debug/bluetooth";
const MAIN_CONF: &str = "etc/bluetooth/main.conf";

struct Figure {
    /// In debugfs (Linux, net/bluetooth/hci_debugfs.c).
    file: &'static str,
    /// In `main.conf`.
    key: &'static str,
    /// What Linux begins with (net/bluetooth/hci_core.c): any other value was chosen by somebody.
    default: u16,
    wanted: u16,
}

/// As in `config/bluetooth.conf`. The shortest interval comes first: it may not be over the longest.
const FIGURES: [Figure; 3] = [
    Figure {
        file: "conn_min_interval",
        key: "MinConnectionInterval",
        default: 24,
        wanted: 6,
    },
    Figure {
        file: "conn_max_interval",
        key: "MaxConnectionInterval",
        default: 40,
        wanted: 12,
    },
    Figure {
        file: "supervision_timeout",
        key: "ConnectionSupervisionTimeout",
        default: 42,
        wanted: 200,
    },
];

/// Whether the user was told, or needs not be.
#[derive(Default)]
pub(super) struct Timing(AtomicBool);

impl Timing {
    /// Asks for what suits robots, for connections made from now on, where the adapter still has Linux's own figures.
    /// Says once what to do where this process may not ask.
    pub(super) fn ask(&self, adapter: &str) {
        let root = Path::new("/");
        let Err(error) = set(&root.join(DEBUGFS).join(adapter)) else {
            return;
        };
        if !self.0.swap(true, Ordering::Relaxed) && !is_seen_to(root, adapter) {
            tracing::info!(
                "ble: {adapter}: connection interval and supervision timeout are left as they are ({error}). With \
                 RECT's config/bluetooth.conf as /{MAIN_CONF} links answer faster and hold better"
            );
        }
    }
}

fn set(folder: &Path) -> io::Result<()> {
    for figure in &FIGURES {
        let file = folder.join(figure.file);
        if fs::read_to_string(&file)?.trim() == figure.default.to_string() {
            fs::write(&file, figure.wanted.to_string())?;
        }
    }
    Ok(())
}

/// Whether somebody else sets a connection's interval and supervision timeout on that adapter: RECT's service, or bluetoothd.
/// `root`: where the file system begins.
pub fn is_seen_to(root: &Path, adapter: &str) -> bool {
    root.join(SET_BY_SERVICE).join(adapter).exists()
        || is_configured(&fs::read_to_string(root.join(MAIN_CONF)).unwrap_or_default())
}

/// Whether bluetoothd, with that `main.conf`, sets them.
fn is_configured(main_conf: &str) -> bool {
    let keys = || main_conf.lines().filter_map(|line| line.split_once('='));
    FIGURES
        .iter()
        .all(|figure| keys().any(|(key, _)| key.trim() == figure.key))
}

#[cfg(test)]
mod tests {
    use super::*;

    const OURS: &str = include_str!("../../../../config/bluetooth.conf");

    #[test]
    fn what_somebody_chose_is_left_alone() {
        let folder = tempfile::tempdir().expect("a folder");
        let write = |file: &str, text: &str| fs::write(folder.path().join(file), text);
        let read = |file: &str| fs::read_to_string(folder.path().join(file)).expect("a file");
        write("conn_min_interval", "24\n").expect("written");
        write("conn_max_interval", "80\n").expect("written");
        assert!(set(folder.path()).is_err(), "one file is missing");
        write("supervision_timeout", "42\n").expect("written");
        set(folder.path()).expect("all there");
        assert_eq!(read("conn_min_interval"), "6");
        assert_eq!(read("conn_max_interval"), "80\n");
        assert_eq!(read("supervision_timeout"), "200");
    }

    #[test]
    fn the_service_sees_to_its_adapter_and_bluetoothd_to_all() {
        let root = tempfile::tempdir().expect("a folder");
        let write = |path: &str, text: &str| {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().expect("a folder")).expect("made");
            fs::write(path, text).expect("written");
        };
        assert!(!is_seen_to(root.path(), "hci0"));
        write("run/rect-bluetooth/hci0", "");
        assert!(is_seen_to(root.path(), "hci0") && !is_seen_to(root.path(), "hci1"));
        write(MAIN_CONF, OURS);
        assert!(is_seen_to(root.path(), "hci1"));
    }

    #[test]
    fn our_configuration_says_the_same() {
        assert!(is_configured(OURS));
        for figure in &FIGURES {
            let line = format!("{} = {}", figure.key, figure.wanted);
            assert!(OURS.lines().any(|l| l == line), "{line}");
        }
        assert!(!is_configured("#MinConnectionInterval=6\n"));
        assert!(!is_configured(""));
    }
}
