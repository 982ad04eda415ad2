//! Tests what a sniffer learns from the radio: `cargo test -p rect-router --test behaviour sniffer`
use std::{
    fs,
    sync::{Arc, Mutex},
};

use crate::support::{
    answers, arrives, ble, client, file, init, program, simulated, start, Air, Wombat,
};
use zenoh::{Session, Wait};

/// Parts of what the two robots exchange, which nobody else may read.
const PRIVATE: [&[u8]; 4] = [
    b"arm/secret-plan",
    b"what-we-will-do",
    b"status",
    b"wombat-2",
];

/// Records everything that is sent over the air from now on.
fn sniff(air: &Air) -> Arc<Mutex<Vec<u8>>> {
    let recorded = Arc::new(Mutex::new(Vec::new()));
    let record = Arc::clone(&recorded);
    air.air().sniff(move |_, sdu| {
        record.lock().expect("no panic").extend_from_slice(sdu);
    });
    recorded
}

/// Publishes from one robot to the other until a message has arrived, and asks the other robot's router.
fn exchange(from: &Session, to: &Session) {
    let linked = "rect/wombat-2/@rect/connections?name=first";
    answers(from, linked, |answer| answer[0]["state"] == "connected");
    let key = "rect/wombat-1/arm/secret-plan";
    let subscriber = to.declare_subscriber(key).wait().expect("a subscription");
    assert!(arrives(from, to, key));
    for _ in 0..10 {
        from.put(key, "what-we-will-do").wait().expect("published");
    }
    let expected = "what-we-will-do";
    loop {
        let sample = subscriber.recv().expect("a message");
        if sample
            .payload()
            .try_to_string()
            .is_ok_and(|text| text == expected)
        {
            break;
        }
    }
}

/// Returns which parts of a record a sniffer can read.
fn readable(record: &Mutex<Vec<u8>>) -> Vec<&'static [u8]> {
    let record = record.lock().expect("no panic");
    assert!(record.len() > 1000, "{} bytes were recorded", record.len());
    let is_in = |part: &&[u8]| record.windows(part.len()).any(|bytes| bytes == *part);
    PRIVATE.into_iter().filter(|part| is_in(part)).collect()
}

#[test]
fn nothing_of_a_link_with_a_secret_is_readable() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let record = sniff(&air);
    let one = init(root.path(), "wombat-1", &[]);
    let two = init(
        root.path(),
        "wombat-2",
        &["--users", &format!("{one}/users")],
    );
    let dial = file(&[ble("first", "wombat-1")]).to_string();
    fs::write(format!("{two}/connections.json"), dial).expect("written");
    let (_one, local) = start(&air, &one, "wombat-1", "fleet");
    let (_two, remote) = start(&air, &two, "wombat-2", "fleet");
    let (here, there) = (program(&one, &local), program(&two, &remote));
    exchange(&here, &there);
    let connections = answers(&there, "rect/wombat-2/@rect/connections?name=first", |_| {
        true
    });
    assert_eq!(connections[0]["encrypted"], true, "{connections:#}");
    assert_eq!(readable(&record), Vec::<&[u8]>::new());
}

/// The parts that are not only in declarations, which a link compresses.
const PLAIN: [&[u8]; 2] = [b"what-we-will-do", b"wombat-2"];

/// Without a secret, the same search finds everything that is not compressed, so that it would also find it above.
#[test]
fn everything_of_a_link_without_a_secret_is_readable() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let record = sniff(&air);
    let (mut one, local) = simulated(&air, 1, &[]);
    one.up();
    let two = Wombat::start(&air, &folder, 2, &file(&[ble("first", "wombat-1")]));
    let (here, there) = (client(&local), client(&two.endpoint));
    exchange(&here, &there);
    let connections = answers(&there, "rect/wombat-2/@rect/connections?name=first", |_| {
        true
    });
    assert_eq!(connections[0]["encrypted"], false, "{connections:#}");
    let found = readable(&record);
    for part in PLAIN {
        assert!(found.contains(&part), "{found:?}");
    }
}
