//! Maps errors of BlueZ and the kernel to [`RadioError`], with advice for the user.
use bluer::{ErrorKind, Session};
use zenoh_link_ble_radio::{
    address::{DeviceAddress, Psm},
    RadioError,
};

/// Maps a D-Bus error of `action` to a [`RadioError`].
pub(super) fn dbus_error(action: &'static str) -> impl Fn(bluer::Error) -> RadioError {
    move |error| {
        let text = error.to_string();
        let is = |names: &[&str]| names.iter().any(|name| text.contains(name));
        if is(&[
            "ServiceUnknown",
            "NoReply",
            "NameHasNoOwner",
            "not provided by any .service",
        ]) {
            return no_bluetoothd();
        }
        if is(&["Failed to connect to socket", "D-Bus"]) && is(&["No such file", "refused"]) {
            return RadioError::NoService {
                service: "the system D-Bus",
                advice: "start it with `sudo systemctl start dbus`".to_owned(),
            };
        }
        let denied = matches!(
            error.kind,
            ErrorKind::NotPermitted | ErrorKind::NotAuthorized
        );
        if denied || is(&["AccessDenied", "Access denied"]) {
            return RadioError::NotPermitted {
                action,
                advice: "add the user to the group bluetooth (`sudo usermod -aG bluetooth $USER`) and log in again".to_owned(),
            };
        }
        RadioError::System {
            action,
            source: Box::new(error),
        }
    }
}

fn no_bluetoothd() -> RadioError {
    RadioError::NoService {
        service: "bluetoothd",
        advice: "install it with `sudo apt install bluez` and start it with `sudo systemctl start bluetooth`".to_owned(),
    }
}

/// Returns the error for a missing adapter. It lists the available adapters.
pub(super) async fn no_adapter(name: &str, session: &Session) -> RadioError {
    let mut adapters = match session.adapter_names().await {
        Ok(adapters) => adapters,
        Err(_) => return no_bluetoothd(),
    };
    adapters.sort();
    let advice = if !adapters.is_empty() {
        format!("available adapters: {}", adapters.join(", "))
    } else if is_raspberry_pi() {
        "no Bluetooth adapter was found. On a KIPR Wombat, the line `dtoverlay=pi3-disable-bt` in /boot/config.txt disables the built-in adapter: plug in a USB Bluetooth dongle, or replace that line with `dtoverlay=pi3-miniuart-bt` and reboot".to_owned()
    } else {
        "no Bluetooth adapter was found: plug one in, or check `rfkill list` and `dmesg | grep -i bluetooth`. Without Bluetooth, use an adapter named sim-... on the simulated air (`rect air`)".to_owned()
    };
    RadioError::NoAdapter {
        adapter: name.to_owned(),
        advice,
    }
}

fn is_raspberry_pi() -> bool {
    std::fs::read("/proc/device-tree/model").is_ok_and(|model| model.starts_with(b"Raspberry Pi"))
}

/// Maps an error of a listening or unconnected socket to a [`RadioError`].
pub(super) fn socket_error(
    action: &'static str,
    adapter: &str,
    psm: Option<Psm>,
) -> impl Fn(std::io::Error) -> RadioError {
    let adapter = adapter.to_owned();
    move |error| {
        match (error.raw_os_error(), psm) {
        (Some(libc::EAFNOSUPPORT | libc::EPROTONOSUPPORT), _) => RadioError::NoAdapter {
            adapter: adapter.clone(),
            advice: "this kernel does not support Bluetooth; load the module with `sudo modprobe bluetooth`".to_owned(),
        },
        (Some(libc::EADDRINUSE), Some(psm)) => RadioError::PsmTaken(psm),
        (Some(libc::EACCES | libc::EPERM), _) => RadioError::NotPermitted {
            action,
            advice:
                "run as a user who may use Bluetooth sockets; a container must be allowed to use them"
                    .to_owned(),
        },
        (Some(libc::ENODEV | libc::EADDRNOTAVAIL | libc::EHOSTUNREACH), _) => {
            RadioError::AdapterOff {
                adapter: adapter.clone(),
            }
        }
        _ => RadioError::System {
            action,
            source: Box::new(error),
        },
    }
    }
}

/// Maps the error of a failed connect to a [`RadioError`].
pub(super) fn connect_error(peer: DeviceAddress, psm: Psm, error: std::io::Error) -> RadioError {
    match error.raw_os_error() {
        Some(libc::ECONNREFUSED) => RadioError::Refused { peer, psm },
        Some(libc::EACCES | libc::EPERM) => RadioError::NotPermitted {
            action: "open a channel with that sec=",
            advice: format!(
                "the two devices could not be paired at this security level; use the same sec= and secret= on both. \
                 `bluetoothctl remove {}` on either side removes an old pairing",
                peer.address
            ),
        },
        _ => RadioError::ChannelDown {
            peer,
            source: Some(error),
        },
    }
}
