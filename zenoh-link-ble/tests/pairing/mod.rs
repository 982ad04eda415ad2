//! Tests pairing with a passkey that both sides know. Runs only on a real Bluetooth stack: the simulated air does not
//! pair.
use std::{collections::BTreeMap, fs, path::Path, time::Duration};

use tokio::time::sleep;
use zenoh_link_ble_radio::{ChannelOptions, Security};

use crate::{
    contract::{
        advertisement,
        secret::{File, OURS, THEIRS},
        Paced, World,
    },
    run,
    shared::{
        listener::OPTIONS,
        peer::{assert_delivers, within, Peer},
    },
};

/// Folder in which bluetoothd keeps the keys of paired devices.
const BONDS: &str = "/var/lib/bluetooth";
/// Rate of the radios in bytes per second. Both adapters share one bluetoothd, whose agent handles one request at a
/// time; on a slow radio, the two adapters request the passkey one after the other.
const PACE: u32 = 1500;

/// Removes the keys that the two radios have for each other, and limits their rate until the returned value is dropped.
fn unpaired(world: &World) -> Paced<'_> {
    for radio in [&world.a, &world.b] {
        run("adapter", &["forget", radio.name()]);
    }
    assert!(keys().is_empty(), "{:?}", keys().keys());
    Paced::new(world, PACE)
}

/// Returns the keys of all paired devices, by the file that contains them.
fn keys() -> BTreeMap<String, Vec<String>> {
    let read = |folder: &Path| fs::read_dir(folder).into_iter().flatten().flatten();
    let mut keys = BTreeMap::new();
    for adapter in read(Path::new(BONDS)) {
        for device in read(&adapter.path()) {
            let file = device.path().join("info");
            let text = fs::read_to_string(&file).unwrap_or_default();
            let keys_of_it = text.lines().filter(|line| line.starts_with("Key="));
            let keys_of_it: Vec<_> = keys_of_it.map(str::to_owned).collect();
            if !keys_of_it.is_empty() {
                keys.insert(file.display().to_string(), keys_of_it);
            }
        }
    }
    keys
}

/// Returns whether a channel opens if the two sides enter these passkeys.
async fn channel_with(world: &World, passkeys: [u32; 2]) -> bool {
    let options = |passkey| ChannelOptions {
        security: Security::High,
        passkey: Some(passkey),
        ..OPTIONS
    };
    let listener = world.b.listen(None, options(passkeys[1])).await;
    let listener = listener.expect("listens");
    let advertised = advertisement(listener.psm(), "b");
    let _advertising = world.b.advertise(&advertised, "b").await;
    let to = world.b.address().await.expect("has an address");
    let connected = world.a.connect(to, listener.psm(), options(passkeys[0]));
    let connected = within("an answer", connected).await.is_ok();
    world.a.disconnect(to).await;
    connected
}

pub async fn refuses_a_wrong_passkey_and_pairs_with_the_right_one(world: World) {
    let _unpaired = unpaired(&world);
    assert!(!channel_with(&world, [123_456, 123_457]).await);
    assert!(
        keys().is_empty(),
        "the radios are paired with a wrong passkey"
    );
    assert!(channel_with(&world, [123_456, 123_456]).await);
    // BlueZ writes its files after the kernel has paired.
    let stored = async {
        while keys().len() < 2 {
            sleep(Duration::from_millis(10)).await;
        }
    };
    within("both store the key of the other", stored).await;
}

pub async fn pairs_once_with_a_shared_secret_and_reconnects(world: World) {
    let _unpaired = unpaired(&world);
    let file = File::with(OURS);
    let listener = format!("name=wombat-2;sec=high;{}", file.option());
    let b = Peer::on(&world.b).listen_as(&listener).await;
    let a = Peer::on(&world.a);
    let locator = format!("ble/wombat-2#sec=high;{}", file.option());
    let mut paired = None;
    for round in 0..3 {
        let near = a.dial(&locator).await.expect("dials");
        let far = b.incoming().await;
        assert_delivers(&near, &far, b"in private").await;
        near.close().await.expect("closes");
        drop((near, far));
        // The connection is dropped, so that the next one is encrypted with the existing keys.
        (world.lose_links)();
        let now = keys();
        assert_eq!(
            now.len(),
            2,
            "round {round}: both store the key of the other"
        );
        let before = paired.get_or_insert_with(|| now.clone());
        assert_eq!(*before, now, "round {round}: they were paired again");
    }
}

pub async fn does_not_pair_with_a_different_secret(world: World) {
    let _unpaired = unpaired(&world);
    let (ours, theirs) = (File::with(OURS), File::with(THEIRS));
    let listener = format!("name=wombat-2;sec=high;{}", ours.option());
    let b = Peer::on(&world.b).listen_as(&listener).await;
    let a = Peer::on(&world.a);
    let locator = format!("ble/wombat-2#sec=high;{}", theirs.option());
    let refused = a.dial(&locator).await.err().map(|error| error.to_string());
    println!("refused: {refused:?}");
    let names_the_cause = |why: &String| why.contains("could not be paired");
    assert!(refused.as_ref().is_some_and(names_the_cause), "{refused:?}");
    assert!(b.no_more_incoming() && keys().is_empty());
}
