//! Pairing by a passkey that both sides know. Only on a real stack: the simulated air pairs with nobody.
use std::{collections::BTreeMap, fs, path::Path, process::Command};

use zenoh_link_ble::radio::{ChannelOptions, Security};

use crate::{
    contract::{
        advertisement,
        secret::{File, OURS, THEIRS},
        World,
    },
    shared::{
        listener::OPTIONS,
        peer::{says, within, Peer},
    },
};

/// Where bluetoothd keeps whom it has paired with.
const BONDS: &str = "/var/lib/bluetooth";
/// Both adapters have one bluetoothd here, whose agent is asked by one of them at a time; on a slow radio they ask one after
/// the other.
const PACE: &str = "1500";

fn run(program: &str, arguments: &[&str]) {
    let done = Command::new(program).args(arguments).status();
    assert!(
        done.is_ok_and(|status| status.success()),
        "{program} {arguments:?}"
    );
}

/// Two radios that have never met, and are slow until it is dropped.
struct Strangers<'a>(&'a World);

impl<'a> Strangers<'a> {
    fn of(world: &'a World) -> Self {
        for radio in [&world.a, &world.b] {
            run("adapter", &["forget", radio.name()]);
            run("room", &["pace", radio.name(), PACE]);
        }
        assert!(keys().is_empty(), "{:?}", keys().keys());
        Self(world)
    }
}

impl Drop for Strangers<'_> {
    fn drop(&mut self) {
        for radio in [&self.0.a, &self.0.b] {
            run("room", &["pace", radio.name(), "0"]);
        }
    }
}

/// The keys of all that are paired, by the file they are in.
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

/// Whether there is a channel for which the two type in these.
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

pub async fn a_wrong_passkey_is_refused_and_the_right_one_pairs(world: World) {
    let _strangers = Strangers::of(&world);
    assert!(!channel_with(&world, [123_456, 123_457]).await);
    assert!(keys().is_empty(), "they are paired all the same");
    assert!(channel_with(&world, [123_456, 123_456]).await);
    assert_eq!(keys().len(), 2, "both remember the other");
}

pub async fn with_the_same_secret_two_are_paired_once_and_linked_again_after_that(world: World) {
    let _strangers = Strangers::of(&world);
    let file = File::with(OURS);
    let listener = format!("name=wombat-2;sec=high;{}", file.option());
    let b = Peer::on(&world.b).listens_as(&listener).await;
    let a = Peer::on(&world.a);
    let locator = format!("ble/wombat-2#sec=high;{}", file.option());
    let mut paired = None;
    for round in 0..3 {
        let near = a.dials(&locator).await.expect("dials");
        let far = b.incoming().await;
        says(&near, &far, b"in private").await;
        near.close().await.expect("closes");
        drop((near, far));
        // Lost altogether, so that the next one is encrypted anew, with the keys that are there.
        (world.lose_links)();
        let now = keys();
        assert_eq!(now.len(), 2, "round {round}: both remember the other");
        let before = paired.get_or_insert_with(|| now.clone());
        assert_eq!(*before, now, "round {round}: they were paired anew");
    }
}

pub async fn with_another_secret_two_are_not_paired(world: World) {
    let _strangers = Strangers::of(&world);
    let (ours, theirs) = (File::with(OURS), File::with(THEIRS));
    let listener = format!("name=wombat-2;sec=high;{}", ours.option());
    let b = Peer::on(&world.b).listens_as(&listener).await;
    let a = Peer::on(&world.a);
    let locator = format!("ble/wombat-2#sec=high;{}", theirs.option());
    let refused = a.dials(&locator).await.err().map(|error| error.to_string());
    println!("refused: {refused:?}");
    let says_so = |why: &String| why.contains("could not be paired");
    assert!(refused.as_ref().is_some_and(says_so), "{refused:?}");
    assert!(b.no_more_incoming() && keys().is_empty());
}
