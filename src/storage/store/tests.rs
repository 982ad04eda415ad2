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
    let part: PathBuf = part;
    let in_use = InUse::new(&part);
    let mut store = Store::File(Box::new(PartFile {
        file,
        part,
        record,
        whole,
        offer,
        in_use,
    }));
    let error = store.write(0, b"abc").expect_err("full").to_string();
    assert!(error.contains("No space left"), "{error}");
    assert!(store.save(&held(0..3)).is_err());
}

fn files(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> = entries(folder)
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// A transfer of that size, interrupted after half of it, so long ago.
fn interrupted(folder: &Path, size: u8, ago: Duration) -> PathBuf {
    let bytes = vec![size; size.into()];
    let (offer, id) = offer("x", &bytes);
    let (mut store, _) = Store::in_folder(folder, id, &offer).expect("a store");
    let half = u64::from(size) / 2;
    store.write(0, &bytes[..half as usize]).expect("room");
    let kept = store.interrupt(&held(0..half), &Fault::Stopped);
    kept.expect("kept");
    let part = folder.join(format!("wombat-1/.{id}.part"));
    let file = File::options().write(true).open(&part).expect("there");
    file.set_modified(SystemTime::now() - ago).expect("set");
    part
}

#[test]
fn of_what_a_killed_process_leaves_only_what_can_go_on_stays() {
    let folder = tempfile::tempdir().expect("a folder");
    let robot = folder.path().join("wombat-1");
    let part = interrupted(folder.path(), 100, Duration::ZERO);
    let foreign = ["x.part", ".keep", ".1.part", "0123456789abcdef.part"];
    for name in foreign {
        fs::write(robot.join(name), b"x").expect("written");
    }
    let stem = |n: u32, kind: &str| format!(".{n:016x}.{kind}");
    // Killed before the first record, while a record was written, and between the removal of part and record.
    for name in [stem(1, "part"), stem(2, "new"), stem(3, "record")] {
        fs::write(robot.join(name), b"x").expect("written");
    }
    fs::create_dir(folder.path().join("wombat-9")).expect("made");
    let now = SystemTime::now();
    Store::clean(folder.path(), now);
    assert_eq!(
        files(&robot).len(),
        foreign.len() + 5,
        "another program may be at work"
    );
    Store::clean(folder.path(), now + LEFT * 2);
    assert_eq!(files(&robot).len(), foreign.len() + 2);
    assert!(part.exists(), "this one can go on");
    assert_eq!(files(folder.path()), ["wombat-1"]);
    Store::clean(folder.path(), now + KEPT * 2);
    assert_eq!(files(&robot).len(), foreign.len());
    Store::clean(Path::new("/none"), now);
}

#[test]
fn what_can_not_be_finished_leaves_nothing_behind() {
    let faults = [
        Fault::NotKept("disk full".into()),
        Fault::Checksum,
        Fault::Protocol(String::new()),
        Fault::Changed(String::new()),
    ];
    for fault in faults {
        let folder = tempfile::tempdir().expect("a folder");
        let (offer, id) = offer("x", b"abcdef");
        let (mut store, _) = Store::in_folder(folder.path(), id, &offer).expect("a store");
        store.write(0, b"abc").expect("room");
        store.save(&held(0..3)).expect("room");
        store.interrupt(&held(0..3), &fault).expect("removed");
        assert!(files(folder.path()).is_empty(), "{fault:?}");
    }
}

#[test]
fn nothing_is_kept_of_a_transfer_of_which_nothing_came() {
    let folder = tempfile::tempdir().expect("a folder");
    let (offer, id) = offer("x", b"abcdef");
    let (store, _) = Store::in_folder(folder.path(), id, &offer).expect("a store");
    let ended = store.interrupt(&Ranges::default(), &Fault::Silence(600));
    ended.expect("removed");
    assert!(files(folder.path()).is_empty());
}

#[test]
fn a_taker_that_goes_on_does_not_lose_the_part_to_the_one_that_ends() {
    let folder = tempfile::tempdir().expect("a folder");
    let (offer, id) = offer("x", b"abcdef");
    let begin = || {
        Store::in_folder(folder.path(), id, &offer)
            .expect("a store")
            .0
    };
    let (ending, mut going_on) = (begin(), begin());
    let ended = ending.interrupt(&Ranges::default(), &Fault::Stopped);
    ended.expect("removed");
    going_on.write(0, b"abcdef").expect("room");
    going_on.finish().expect("it has a name");
}

#[test]
fn a_sender_can_not_leave_behind_more_than_so_many_parts() {
    let folder = tempfile::tempdir().expect("a folder");
    let hours = |n: u8| Duration::from_secs(3600) * n.into();
    let parts: Vec<_> = (1..=40)
        .map(|n| interrupted(folder.path(), 100 + n, hours(100 - n)))
        .collect();
    let there = parts.iter().filter(|part| part.exists()).count();
    assert_eq!(there, MAX_KEPT);
    assert!(parts[39].exists() && !parts[0].exists(), "the oldest go");
    assert_eq!(files(&folder.path().join("wombat-1")).len(), MAX_KEPT * 2);
}

#[test]
fn a_record_that_can_not_be_written_leaves_no_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let (offer, id) = offer("x", b"abcdef");
    let (mut store, _) = Store::in_folder(folder.path(), id, &offer).expect("a store");
    store.write(0, b"abc").expect("room");
    // Nothing can be renamed to a folder.
    let record = folder.path().join(format!("wombat-1/.{id}.record"));
    fs::create_dir(&record).expect("made");
    assert!(store.save(&held(0..3)).is_err());
    let new = record.with_extension(NEW);
    assert!(!new.exists());
}
