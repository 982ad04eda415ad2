//! Sets the connection interval for single peers through the kernel's management interface: `Load Connection Parameters`
//! (BlueZ, doc/mgmt-protocol.rst), which requires CAP_NET_ADMIN.
//!
//! The kernel uses the parameters for the next connection to the peer of which this adapter is the central. Since Linux
//! 6.11, a command with one peer that the kernel knows already also updates the existing connection. A command with
//! several peers, and before 6.11 every command, replaces the parameters of all others. Therefore [`PeerIntervals::set`]
//! loads all peers, then the changed one, then all peers again; a single peer once. (Kernel commit "MGMT: Make
//! MGMT_OP_LOAD_CONN_PARAM update existing connection"; `tests/vm/scenarios/test_five_robots.py` shows both behaviours.)
use std::{
    io,
    sync::{
        atomic::{AtomicBool, Ordering},
        LazyLock,
    },
};

use parking_lot::Mutex;
use zenoh_link_ble_radio::{address::DeviceAddress, interval::ConnectionInterval};

use super::management;

const OP_LOAD_CONNECTION_PARAMETERS: u16 = 0x0035;

/// Supervision timeout in units of 10 ms, as in `config/bluetooth.conf`.
const SUPERVISION_TIMEOUT: u16 = 200;
/// Largest number of peers whose intervals are kept: the kernel's other parameters stay few.
const MAX_PEERS: usize = 32;

/// The first kernel that changes the interval of an open connection.
const CHANGES_OPEN_CONNECTIONS: (u32, u32) = (6, 11);

/// Returns whether the kernel changes the interval of an open connection, and not only of the next one.
pub(super) fn changes_open_connections() -> bool {
    static CHANGES: LazyLock<bool> = LazyLock::new(|| {
        let release = std::fs::read_to_string("/proc/sys/kernel/osrelease");
        version_of(&release.unwrap_or_default()) >= Some(CHANGES_OPEN_CONNECTIONS)
    });
    *CHANGES
}

/// Returns the first two numbers of a kernel's release, such as `6.1.0-25-arm64`.
fn version_of(release: &str) -> Option<(u32, u32)> {
    let mut numbers = release.split(|c: char| !c.is_ascii_digit());
    let mut next = || numbers.next()?.parse().ok();
    Some((next()?, next()?))
}

/// The intervals that were set for peers of one adapter.
#[derive(Default)]
pub(super) struct PeerIntervals {
    chosen: Mutex<Vec<(DeviceAddress, ConnectionInterval)>>,
    has_explained: AtomicBool,
}

impl PeerIntervals {
    /// Sets the interval for a peer. Returns whether the kernel permits it. If it does not, logs once what the user can do.
    pub(super) async fn set(
        &self,
        adapter: &str,
        peer: DeviceAddress,
        interval: ConnectionInterval,
    ) -> bool {
        let all = {
            let mut chosen = self.chosen.lock();
            chosen.retain(|(device, _)| *device != peer);
            if chosen.len() >= MAX_PEERS {
                chosen.remove(0);
            }
            chosen.push((peer, interval));
            chosen.clone()
        };
        let name = adapter.to_owned();
        let loaded = tokio::task::spawn_blocking(move || load(&name, &all)).await;
        let error = match loaded {
            Ok(Ok(())) => return true,
            Ok(Err(error)) => error,
            Err(error) => io::Error::other(error),
        };
        if !self.has_explained.swap(true, Ordering::Relaxed) {
            tracing::info!(
                "ble: {adapter}: all links get the same connection interval ({error}). A robot with links in both \
                 directions may lose one now and then; it is dialled again. To let the router choose intervals, give it \
                 CAP_NET_ADMIN: see the page \"Many robots in one hall\" of RECT's documentation"
            );
        }
        false
    }
}

/// Loads the intervals of all peers. The last one is the one that has changed.
fn load(adapter: &str, all: &[(DeviceAddress, ConnectionInterval)]) -> io::Result<()> {
    let changed = all.last().map(std::slice::from_ref).unwrap_or_default();
    let commands = match all {
        [_] => vec![all],
        _ => vec![all, changed, all],
    };
    let commands: Vec<_> = commands.into_iter().map(parameters).collect();
    management::send(adapter, OP_LOAD_CONNECTION_PARAMETERS, &commands)
}

/// Encodes the parameters of the command for these peers.
fn parameters(peers: &[(DeviceAddress, ConnectionInterval)]) -> Vec<u8> {
    let mut parameters = u16::try_from(peers.len())
        .unwrap_or(0)
        .to_le_bytes()
        .to_vec();
    for (peer, interval) in peers {
        parameters.extend(management::encode(*peer));
        // Minimum and maximum interval, latency, supervision timeout.
        for value in [interval.units(), interval.units(), 0, SUPERVISION_TIMEOUT] {
            parameters.extend(value.to_le_bytes());
        }
    }
    parameters
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenoh_link_ble_radio::address::{Address, AddressType};

    #[test]
    fn kernels_are_compared_by_version() {
        for (release, changes) in [
            ("5.10.0-46-amd64", false),
            ("6.1.192-1", false),
            ("6.10.1", false),
            ("6.11.0-rc1", true),
            ("6.12.107+deb13-arm64\n", true),
            ("7.0.0", true),
            ("", false),
        ] {
            let version = version_of(release);
            assert_eq!(
                version >= Some(CHANGES_OPEN_CONNECTIONS),
                changes,
                "{release}"
            );
        }
    }

    #[test]
    fn encodes_the_parameters_of_the_command() {
        let peer = DeviceAddress {
            address: Address([0xdc, 0xa6, 0x32, 1, 2, 3]),
            kind: AddressType::Public,
        };
        let interval = ConnectionInterval::from_units(12).expect("valid");
        let expected = [
            1, 0, // number of peers
            3, 2, 1, 0x32, 0xa6, 0xdc, 1, // address and its type
            12, 0, 12, 0, 0, 0, 200, 0,
        ];
        assert_eq!(parameters(&[(peer, interval)]), expected);
    }
}
