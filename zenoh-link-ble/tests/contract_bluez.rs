//! Runs the link contract on the Bluetooth stack of the kernel: `RECT_BLUEZ_ADAPTERS=hci0,hci1 cargo test -p
//! zenoh-link-ble --test contract_bluez -- --test-threads=1`. `tests/vm/test` runs it in the VM. It is skipped, with a
//! message, elsewhere.
mod contract;
mod pairing;
mod shared {
    pub mod listener;
    pub mod peer;
    pub mod raw;
}

use std::process::Command;

use contract::{channel, flooding, handshake, handshake_flood, link, misbehaving, secret, World};
use zenoh_link_ble::radio::bluez;

fn world() -> Option<World> {
    let Ok(adapters) = std::env::var("RECT_BLUEZ_ADAPTERS") else {
        println!("skipped: RECT_BLUEZ_ADAPTERS does not name two adapters in range of each other (the VM does)");
        return None;
    };
    let (a, b) = adapters
        .split_once(',')
        .expect("two adapters, as hci0,hci1");
    // Waits for the end of the previous test's advertisements and scans. bluetoothd ends them when it notices that
    // their client has disconnected.
    for adapter in [a, b] {
        run("adapter", ["idle", adapter]);
    }
    Some(World {
        a: bluez::radio(Some(a)).expect("opens"),
        b: bluez::radio(Some(b)).expect("opens"),
        lose_links: lose_links_of(a.to_owned()),
    })
}

/// Uses the emulated radio of the VM (`tests/vm/guest/room`).
fn lose_links_of(adapter: String) -> Box<dyn Fn() + Send + Sync> {
    Box::new(move || run("room", ["drop", &adapter]))
}

/// Runs a program of the VM (`tests/vm/guest`).
fn run<const N: usize>(program: &str, arguments: [&str; N]) {
    let output = Command::new(program).args(arguments).output();
    let output = output.unwrap_or_else(|error| panic!("cannot run {program}: {error}"));
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success(),
        "{program} {arguments:?}: {message}"
    );
}

macro_rules! on_bluez {
    ($($scenario:ident: $group:ident,)+) => {
        $(
            #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
            async fn $scenario() {
                if let Some(world) = world() {
                    $group::$scenario(world).await;
                }
            }
        )+
    };
}

for_each_scenario!(on_bluez);

on_bluez! {
    refuses_a_wrong_passkey_and_pairs_with_the_right_one: pairing,
    pairs_once_with_a_shared_secret_and_reconnects: pairing,
    does_not_pair_with_a_different_secret: pairing,
}
