//! Runs the link contract on the Bluetooth stack of the kernel: `RECT_BLUEZ_ADAPTERS=hci0,hci1 cargo test -p
//! zenoh-link-ble --test contract_bluez -- --test-threads=1`. `tests/vm/test` runs it in the VM. It is skipped, with a
//! message, elsewhere.
mod contract;
mod pairing;
mod shared {
    pub mod listener;
    pub mod peer;
    pub mod raw;
    pub mod sealed;
}

use std::{process::Command, time::Duration};

use contract::{
    channel, closing, compression, flooding, handshake, handshake_flood, link, misbehaving, secret,
    World,
};
use shared::peer::within;

/// Returns the names of the two adapters.
fn adapters() -> Option<(String, String)> {
    let Ok(adapters) = std::env::var("RECT_BLUEZ_ADAPTERS") else {
        println!("skipped: RECT_BLUEZ_ADAPTERS does not name two adapters in range of each other (the VM does)");
        return None;
    };
    let (a, b) = adapters
        .split_once(',')
        .expect("two adapters, as hci0,hci1");
    Some((a.to_owned(), b.to_owned()))
}

fn world(a: &str, b: &str) -> World {
    let (one, both) = (a.to_owned(), [a.to_owned(), b.to_owned()]);
    let adapters = both.clone();
    World {
        a: zenoh_link_ble_bluez::radio(Some(a)).expect("opens"),
        b: zenoh_link_ble_bluez::radio(Some(b)).expect("opens"),
        is_simulated: false,
        is_connected: Box::new(move || Box::pin(is_connected(adapters.clone()))),
        lose_links: Box::new(move || run("room", &["drop", &one])),
        set_pace: Box::new(move |bytes_per_s| {
            for adapter in &both {
                run("room", &["pace", adapter, &bytes_per_s.to_string()]);
            }
        }),
    }
}

/// Returns whether bluetoothd reports a connection between two adapters.
async fn is_connected([one, other]: [String; 2]) -> bool {
    let session = bluer::Session::new().await.expect("reaches bluetoothd");
    let adapter = |name: &str| session.adapter(name).expect("a valid name");
    let peer = adapter(&other).address().await.expect("is known");
    let device = adapter(&one).device(peer).expect("a valid address");
    // bluetoothd does not know a device that it has not found.
    device.is_connected().await.unwrap_or(false)
}

/// Runs a program of the VM (`tests/vm/guest`).
fn run(program: &str, arguments: &[&str]) {
    let done = Command::new(program).args(arguments).status();
    assert!(
        done.is_ok_and(|status| status.success()),
        "{program} {arguments:?}"
    );
}

/// Waits until the advertisements and scans of the test have ended. The crate bluer ends them in tasks. If the runtime
/// ended before these tasks, the advertisements would last as long as the process, and disturb the next tests.
async fn end_of_advertisements_and_scans(adapters: [&str; 2]) {
    let session = bluer::Session::new().await.expect("reaches bluetoothd");
    for name in adapters {
        let adapter = session.adapter(name).expect("a valid name");
        within("the end of all advertisements and scans", async {
            while adapter.is_discovering().await.expect("is known")
                || adapter
                    .active_advertising_instances()
                    .await
                    .expect("is known")
                    > 0
            {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        })
        .await;
    }
}

macro_rules! on_bluez {
    ($($scenario:ident: $group:ident,)+) => {
        $(
            #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
            async fn $scenario() {
                if let Some((a, b)) = adapters() {
                    $group::$scenario(world(&a, &b)).await;
                    end_of_advertisements_and_scans([&a, &b]).await;
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
