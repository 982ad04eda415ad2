//! Tests of the store.
use super::*;
use crate::core::{encoding::Encoding, name::Name, topic::Topic, transfer::offer::FileName};

fn offer(name: &str, bytes: &[u8]) -> (Offer, TransferId) {
    let offer = Offer {
        from: Name::new("wombat-1").expect("a name"),
        topic: Topic::new("map").expect("a topic"),
        name: FileName::new(name).expect("a file's name"),
        encoding: Encoding::BYTES,
        size_bytes: bytes.len() as u64,
        checksum: Checksum::of(bytes),
        call: 1,
    };
    let id = offer.id(&Name::new("wombat-2").expect("a name"));
    (offer, id)
}

fn held(range: std::ops::Range<u64>) -> Ranges {
    let mut held = Ranges::default();
    held.insert(range);
    held
}

#[test]
fn what_was_saved_is_there_after_a_restart() {
    let folder = tempfile::tempdir().expect("a folder");
    let (offer, id) = offer("x.bin", b"abcdef");
    let (mut store, there) = Store::in_folder(folder.path(), id, &offer).expect("a store");
    assert_eq!(there, Ranges::default());
    store.write(0, b"abc").expect("room");
    store.save(&held(0..3)).expect("room");
    store.write(3, b"d").expect("room");
    drop(store);
    let again = Offer {
        call: 2,
        ..offer.clone()
    };
    let (mut store, there) = Store::in_folder(folder.path(), id, &again).expect("a store");
    assert_eq!(there, held(0..3));
    store.write(3, b"def").expect("room");
    assert_eq!(store.checksum().expect("read"), offer.checksum);
    let Content::File(path) = store.finish().expect("renamed") else {
        panic!("no file");
    };
    assert_eq!(path, folder.path().join("wombat-1/x.bin"));
    assert_eq!(fs::read(&path).expect("there"), b"abcdef");
    assert_eq!(
        fs::read_dir(folder.path().join("wombat-1"))
            .expect("there")
            .count(),
        1,
        "nothing else"
    );
}

#[test]
fn a_record_that_is_damaged_or_of_another_part_is_not_believed() {
    let folder = tempfile::tempdir().expect("a folder");
    let (offer, id) = offer("", b"abcdef");
    let record = folder.path().join(format!("wombat-1/.{id}.record"));
    let part = folder.path().join(format!("wombat-1/.{id}.part"));
    let begun = || {
        let (mut store, _) = Store::in_folder(folder.path(), id, &offer).expect("a store");
        store.write(0, b"abcd").expect("room");
        store.save(&held(0..4)).expect("room");
    };
    let found = || {
        Store::in_folder(folder.path(), id, &offer)
            .expect("a store")
            .1
            .bytes()
    };
    begun();
    assert_eq!(found(), 4);
    fs::write(&record, b"nonsense").expect("written");
    assert_eq!(found(), 0);
    begun();
    fs::write(&record, vec![0; MAX_RECORD_BYTES + 1]).expect("written");
    assert_eq!(found(), 0);
    begun();
    fs::write(&part, b"abc").expect("written");
    assert_eq!(found(), 0, "shorter than the record says");
    begun();
    fs::remove_file(&part).expect("removed");
    assert_eq!(found(), 0);
}

#[test]
fn memory_takes_what_was_said_and_no_more() {
    let mut store = Store::in_memory(6).expect("memory");
    store.write(3, b"def").expect("room");
    store.write(0, b"abc").expect("room");
    assert!(store.write(1 << 40, b"x").is_err());
    assert_eq!(
        store.finish().expect("there"),
        Content::Bytes(Bytes::from_static(b"abcdef"))
    );
    assert!(Store::in_memory(u64::MAX).is_err());
}

#[test]
fn a_disk_that_is_full_is_an_error_with_a_reason() {
    let (offer, _) = offer("x", b"abcdef");
    let Ok(file) = OpenOptions::new().read(true).write(true).open("/dev/full") else {
        return;
    };
    let (part, record, whole) = ("/none/p".into(), "/none/r".into(), "/none/w".into());
    let mut store = Store::File(PartFile {
        file,
        part,
        record,
        whole,
        offer,
    });
    let error = store.write(0, b"abc").expect_err("full").to_string();
    assert!(error.contains("No space left"), "{error}");
    assert!(store.save(&held(0..3)).is_err());
}

#[test]
fn old_parts_go_and_nothing_else() {
    let folder = tempfile::tempdir().expect("a folder");
    let robot = folder.path().join("wombat-1");
    fs::create_dir(&robot).expect("made");
    for name in [".1.part", ".1.record", "x.part", ".keep"] {
        fs::write(robot.join(name), b"x").expect("written");
    }
    Store::clean(folder.path(), SystemTime::now());
    assert_eq!(fs::read_dir(&robot).expect("there").count(), 4);
    Store::clean(folder.path(), SystemTime::now() + KEPT * 2);
    assert_eq!(fs::read_dir(&robot).expect("there").count(), 2);
    Store::clean(Path::new("/none"), SystemTime::now());
}
