//! Sets the timing parameters of BLE connections: the connection interval and the supervision timeout. The kernel keeps
//! them per adapter. bluetoothd sets them from its `main.conf`, and root can set them in debugfs. No socket option
//! exists for them.
use std::{
    fs, io,
    path::Path,
    sync::atomic::{AtomicBool, Ordering},
};
use zenoh_link_ble_radio::interval::{ConnectionInterval, SPREAD};

// Paths relative to the root of the file system.
/// Folder with one file for each adapter that `rect-bluetooth@.service` has configured.
const SET_BY_SERVICE: &str = "run/rect-bluetooth";
const DEBUGFS: &str = "sys/kernel/debug/bluetooth";
const MAIN_CONF: &str = "etc/bluetooth/main.conf";

struct Parameter {
    /// File in debugfs (Linux, net/bluetooth/hci_debugfs.c).
    file: &'static str,
    /// Key in `main.conf`.
    key: &'static str,
    /// Default of Linux (net/bluetooth/hci_core.c), in units of 1.25 ms for an interval and of 10 ms for the timeout.
    /// Any other value was set deliberately.
    default: u16,
    /// Value for robots, in the same unit.
    target: u16,
}

/// The same values as in `config/bluetooth.conf`. The minimum interval comes first: it must not exceed the maximum.
const PARAMETERS: [Parameter; 3] = [
    Parameter {
        file: "conn_min_interval",
        key: "MinConnectionInterval",
        default: 24,
        target: 6,
    },
    Parameter {
        file: "conn_max_interval",
        key: "MaxConnectionInterval",
        default: 40,
        target: 20,
    },
    Parameter {
        file: "supervision_timeout",
        key: "ConnectionSupervisionTimeout",
        default: 42,
        target: 200,
    },
];

/// Whether the message about the timing was logged, or is not needed.
#[derive(Default)]
pub(super) struct Timing(AtomicBool);

impl Timing {
    /// Sets each parameter that still has the default of Linux to the value for robots, which applies to new
    /// connections. If that fails and the parameters are not configured externally, logs once what the user can do.
    pub(super) fn apply(&self, adapter: &str) {
        let root = Path::new("/");
        let Err(error) = write_targets(&root.join(DEBUGFS).join(adapter)) else {
            return;
        };
        if !self.0.swap(true, Ordering::Relaxed) && !is_configured_externally(root, adapter) {
            tracing::info!(
                "ble: {adapter}: the connection interval and supervision timeout keep their defaults ({error}). Install \
                 RECT's config/bluetooth.conf as /{MAIN_CONF} for faster and more stable links"
            );
        }
    }
}

fn write_targets(folder: &Path) -> io::Result<()> {
    for parameter in &PARAMETERS {
        let file = folder.join(parameter.file);
        if fs::read_to_string(&file)?.trim() == parameter.default.to_string() {
            fs::write(&file, parameter.target.to_string())?;
        }
    }
    Ok(())
}

/// Returns whether RECT's service or bluetoothd sets the connection interval and the supervision timeout on the
/// adapter. `root` is the root of the file system.
pub fn is_configured_externally(root: &Path, adapter: &str) -> bool {
    root.join(SET_BY_SERVICE).join(adapter).exists()
        || is_configured(&fs::read_to_string(root.join(MAIN_CONF)).unwrap_or_default())
}

/// Returns the connection interval that links should have: [`SPREAD`] units below the maximum of `main.conf`, or of RECT's
/// settings. The kernel of the peripheral requests another interval if the one of the link is outside its own range, so that
/// all intervals that the router chooses must be inside.
pub(super) fn preferred_interval() -> ConnectionInterval {
    preferred_below(&fs::read_to_string(Path::new("/").join(MAIN_CONF)).unwrap_or_default())
}

fn preferred_below(main_conf: &str) -> ConnectionInterval {
    let [_, max, _] = &PARAMETERS;
    let configured = main_conf
        .lines()
        .filter_map(|line| line.split_once('='))
        .find(|(key, _)| key.trim() == max.key)
        .and_then(|(_, value)| value.trim().parse().ok());
    let preferred = configured.unwrap_or(max.target).saturating_sub(SPREAD);
    ConnectionInterval::from_units(preferred).unwrap_or(ConnectionInterval::MIN)
}

/// Returns whether bluetoothd sets the parameters if it runs with this `main.conf`.
fn is_configured(main_conf: &str) -> bool {
    let keys = || main_conf.lines().filter_map(|line| line.split_once('='));
    PARAMETERS
        .iter()
        .all(|parameter| keys().any(|(key, _)| key.trim() == parameter.key))
}

#[cfg(test)]
mod tests {
    use super::*;

    const RECT_MAIN_CONF: &str = include_str!("../../../config/bluetooth.conf");

    #[test]
    fn keeps_values_that_were_set_deliberately() {
        let folder = tempfile::tempdir().expect("a folder");
        let write = |file: &str, text: &str| fs::write(folder.path().join(file), text);
        let read = |file: &str| fs::read_to_string(folder.path().join(file)).expect("a file");
        write("conn_min_interval", "24\n").expect("written");
        write("conn_max_interval", "80\n").expect("written");
        assert!(write_targets(folder.path()).is_err(), "one file is missing");
        write("supervision_timeout", "42\n").expect("written");
        write_targets(folder.path()).expect("all files exist");
        assert_eq!(read("conn_min_interval"), "6");
        assert_eq!(read("conn_max_interval"), "80\n");
        assert_eq!(read("supervision_timeout"), "200");
    }

    #[test]
    fn service_configures_one_adapter_and_bluetoothd_all() {
        let root = tempfile::tempdir().expect("a folder");
        let write = |path: &str, text: &str| {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().expect("a folder")).expect("made");
            fs::write(path, text).expect("written");
        };
        assert!(!is_configured_externally(root.path(), "hci0"));
        write("run/rect-bluetooth/hci0", "");
        assert!(
            is_configured_externally(root.path(), "hci0")
                && !is_configured_externally(root.path(), "hci1")
        );
        write(MAIN_CONF, RECT_MAIN_CONF);
        assert!(is_configured_externally(root.path(), "hci1"));
    }

    #[test]
    fn chosen_intervals_are_in_the_range_of_the_kernel() {
        let units = |main_conf| preferred_below(main_conf).units();
        assert_eq!(units(RECT_MAIN_CONF), 12);
        assert_eq!(units("#MaxConnectionInterval = 40\n"), 12);
        assert_eq!(units("MaxConnectionInterval=32\n"), 24);
        assert_eq!(units("MaxConnectionInterval = 9\n"), 6);
        assert_eq!(units("MaxConnectionInterval = soon\n"), 12);
    }

    #[test]
    fn matches_the_shipped_bluetooth_conf() {
        assert!(is_configured(RECT_MAIN_CONF));
        for parameter in &PARAMETERS {
            let line = format!("{} = {}", parameter.key, parameter.target);
            assert!(RECT_MAIN_CONF.lines().any(|l| l == line), "{line}");
        }
        assert!(!is_configured("#MinConnectionInterval=6\n"));
        assert!(!is_configured(""));
    }
}
