//! Tests of the store.
use super::*;
use crate::{
    message::encoding::Encoding,
    name::{topic::Topic, Name},
    transfer::offer::FileName,
};

fn offer(name: &str, bytes: &[u8]) -> (Offer, TransferId) {
    let offer = Offer {
        sender: Name::new("wombat-1").expect("valid name"),
        topic: Topic::new("map").expect("valid topic"),
        name: FileName::new(name).expect("valid file name"),
        encoding: Encoding::BYTES,
        size_bytes: bytes.len() as u64,
        checksum: Checksum::of(bytes),
        call: 1,
    };
    let id = offer.id(&Name::new("wombat-2").expect("valid name"));
    (offer, id)
}

fn held(range: std::ops::Range<u64>) -> Ranges {
    let mut held = Ranges::default();
    held.insert(range);
    held
}

#[test]
fn saved_data_is_present_after_a_restart() {
    let folder = tempfile::tempdir().expect("a folder");
    let (offer, id) = offer("x.bin", b"abcdef");
    let (mut store, present) = Store::in_folder(folder.path(), id, &offer).expect("a store");
    assert_eq!(present, Ranges::default());
    store.write(0, b"abc").expect("written");
    store.save(&held(0..3)).expect("written");
    store.write(3, b"d").expect("written");
    drop(store);
    let again = Offer {
        call: 2,
        ..offer.clone()
    };
    let (mut store, present) = Store::in_folder(folder.path(), id, &again).expect("a store");
    assert_eq!(present, held(0..3));
    store.write(3, b"def").expect("written");
    assert_eq!(store.checksum().expect("read"), offer.checksum);
    let Content::File(path) = store.finish().expect("renamed") else {
        panic!("no file");
    };
    assert_eq!(path, folder.path().join("wombat-1/x.bin"));
    assert_eq!(fs::read(&path).expect("exists"), b"abcdef");
    assert_eq!(
        fs::read_dir(folder.path().join("wombat-1"))
            .expect("exists")
            .count(),
        1,
        "nothing else"
    );
}

#[test]
fn damaged_records_and_those_of_other_parts_are_ignored() {
    let folder = tempfile::tempdir().expect("a folder");
    let (offer, id) = offer("", b"abcdef");
    let record = folder.path().join(format!("wombat-1/.{id}.record"));
    let part = folder.path().join(format!("wombat-1/.{id}.part"));
    let begun = || {
        let (mut store, _) = Store::in_folder(folder.path(), id, &offer).expect("a store");
        store.write(0, b"abcd").expect("written");
        store.save(&held(0..4)).expect("written");
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
    assert_eq!(found(), 0, "shorter than the record states");
    begun();
    fs::remove_file(&part).expect("removed");
    assert_eq!(found(), 0);
}

#[test]
fn memory_is_limited_to_the_announced_size() {
    let mut store = Store::in_memory(6).expect("memory");
    store.write(3, b"def").expect("written");
    store.write(0, b"abc").expect("written");
    assert!(store.write(1 << 40, b"x").is_err());
    assert_eq!(
        store.finish().expect("exists"),
        Content::Bytes(Bytes::from_static(b"abcdef"))
    );
    assert!(Store::in_memory(u64::MAX).is_err());
}

#[test]
fn a_full_disk_is_an_error_with_a_reason() {
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

/// Creates a transfer of that size that was interrupted halfway, `ago` ago.
fn interrupted(folder: &Path, size: u8, ago: Duration) -> PathBuf {
    let bytes = vec![size; size.into()];
    let (offer, id) = offer("x", &bytes);
    let (mut store, _) = Store::in_folder(folder, id, &offer).expect("a store");
    let half = u64::from(size) / 2;
    store.write(0, &bytes[..half as usize]).expect("written");
    let kept = store.interrupt(&held(0..half), &Fault::Stopped);
    kept.expect("kept");
    let part = folder.join(format!("wombat-1/.{id}.part"));
    let file = File::options().write(true).open(&part).expect("exists");
    file.set_modified(SystemTime::now() - ago).expect("set");
    part
}

#[test]
fn clean_keeps_only_files_with_which_a_transfer_can_continue() {
    let folder = tempfile::tempdir().expect("a folder");
    let robot = folder.path().join("wombat-1");
    let part = interrupted(folder.path(), 100, Duration::ZERO);
    let foreign = ["x.part", ".keep", ".1.part", "0123456789abcdef.part"];
    for name in foreign {
        fs::write(robot.join(name), b"x").expect("written");
    }
    let stem = |n: u32, kind: &str| format!(".{n:016x}.{kind}");
    // The process was killed before the first record, while it wrote a record, and between removing the part and the
    // record.
    for name in [stem(1, "part"), stem(2, "new"), stem(3, "record")] {
        fs::write(robot.join(name), b"x").expect("written");
    }
    fs::create_dir(folder.path().join("wombat-9")).expect("made");
    let now = SystemTime::now();
    Store::clean(folder.path(), now);
    assert_eq!(
        files(&robot).len(),
        foreign.len() + 5,
        "another program may be active"
    );
    Store::clean(folder.path(), now + USELESS_LIFETIME * 2);
    assert_eq!(files(&robot).len(), foreign.len() + 2);
    assert!(part.exists(), "this one can continue");
    assert_eq!(files(folder.path()), ["wombat-1"]);
    Store::clean(folder.path(), now + PART_LIFETIME * 2);
    assert_eq!(files(&robot).len(), foreign.len());
    Store::clean(Path::new("/none"), now);
}

#[test]
fn transfers_that_cannot_finish_leave_no_files() {
    let faults = [
        Fault::NotStored("disk full".into()),
        Fault::Checksum,
        Fault::Protocol(String::new()),
        Fault::Changed(String::new()),
    ];
    for fault in faults {
        let folder = tempfile::tempdir().expect("a folder");
        let (offer, id) = offer("x", b"abcdef");
        let (mut store, _) = Store::in_folder(folder.path(), id, &offer).expect("a store");
        store.write(0, b"abc").expect("written");
        store.save(&held(0..3)).expect("written");
        store.interrupt(&held(0..3), &fault).expect("removed");
        assert!(files(folder.path()).is_empty(), "{fault:?}");
    }
}

#[test]
fn transfers_without_data_leave_no_files() {
    let folder = tempfile::tempdir().expect("a folder");
    let (offer, id) = offer("x", b"abcdef");
    let (store, _) = Store::in_folder(folder.path(), id, &offer).expect("a store");
    let ended = store.interrupt(&Ranges::default(), &Fault::TimedOut(600));
    ended.expect("removed");
    assert!(files(folder.path()).is_empty());
}

#[test]
fn a_receiver_that_ends_does_not_remove_the_part_of_another() {
    let folder = tempfile::tempdir().expect("a folder");
    let (offer, id) = offer("x", b"abcdef");
    let begin = || {
        Store::in_folder(folder.path(), id, &offer)
            .expect("a store")
            .0
    };
    let (ending, mut continuing) = (begin(), begin());
    let ended = ending.interrupt(&Ranges::default(), &Fault::Stopped);
    ended.expect("removed");
    continuing.write(0, b"abcdef").expect("written");
    continuing.finish().expect("it has a name");
}

#[test]
fn the_parts_of_a_sender_are_limited() {
    let folder = tempfile::tempdir().expect("a folder");
    let hours = |n: u8| Duration::from_secs(3600) * n.into();
    let parts: Vec<_> = (1..=40)
        .map(|n| interrupted(folder.path(), 100 + n, hours(100 - n)))
        .collect();
    let remaining = parts.iter().filter(|part| part.exists()).count();
    assert_eq!(remaining, MAX_INTERRUPTED);
    assert!(
        parts[39].exists() && !parts[0].exists(),
        "the oldest are removed"
    );
    assert_eq!(
        files(&folder.path().join("wombat-1")).len(),
        MAX_INTERRUPTED * 2
    );
}

#[test]
fn a_record_that_cannot_be_written_leaves_no_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let (offer, id) = offer("x", b"abcdef");
    let (mut store, _) = Store::in_folder(folder.path(), id, &offer).expect("a store");
    store.write(0, b"abc").expect("written");
    // A file cannot be renamed to an existing folder.
    let record = folder.path().join(format!("wombat-1/.{id}.record"));
    fs::create_dir(&record).expect("made");
    assert!(store.save(&held(0..3)).is_err());
    let new = record.with_extension(NEW);
    assert!(!new.exists());
}
