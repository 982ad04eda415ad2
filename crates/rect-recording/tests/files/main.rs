//! Tests the files of recordings: files that break off at any byte or are damaged, files of other programs, what viewers show, and a
//! disk that fails: `cargo test -p rect-recording`
mod damage;
mod foreign;
mod viewers;

use std::{
    collections::BTreeMap,
    fs,
    io::Cursor,
    path::Path,
    process::{self, Command},
    time::{Duration, Instant},
};

use rect_core::{
    message::{encoding::Encoding, payload::Payload, urgency::Urgency, Message},
    name::{topic::Topic, Name},
};
use rect_recording::{
    file::OpenFile,
    segments::{self, Segments},
    Entry, ReadError, Reader, Recorder, RetainedKind, Settings, Split,
};

/// Timeout of one step of a test, long enough for a busy computer.
const TIMEOUT: Duration = Duration::from_secs(30);

fn entry(sequence: u32) -> Entry {
    let topics = ["a/pose", "b/camera/front", "a/log"];
    let encodings = [Encoding::JSON, Encoding::JPEG, Encoding::TEXT];
    let kind = sequence as usize % topics.len();
    let urgency = [Urgency::Normal, Urgency::Bulk, Urgency::Urgent][kind];
    let logged = Duration::from_millis(1_795_000_000_000 + u64::from(sequence) * 20);
    Entry {
        topic: topics[kind].to_owned(),
        recipient: (kind == 2).then(|| "c".to_owned()),
        payload: Payload::new(format!("{{\"n\": {sequence}}}"), encodings[kind].clone()),
        urgency,
        sequence,
        publisher: (kind == 0).then_some(7),
        logged,
        sent: logged - Duration::from_millis(3),
        retained: None,
        foreign: None,
    }
}

fn about() -> BTreeMap<String, String> {
    BTreeMap::from([("robot".to_owned(), "a".to_owned())])
}

fn read(path: &Path) -> (Vec<Entry>, Option<ReadError>) {
    let (mut entries, mut error) = (Vec::new(), None);
    match Reader::open(path) {
        Ok(reader) => reader.for_each(|read| match read {
            Ok(entry) => entries.push(entry),
            Err(failed) => error = Some(failed),
        }),
        Err(failed) => error = Some(failed),
    }
    (entries, error)
}

/// Writes a file whose chunks have ten messages each; returns its content.
fn written(folder: &Path, count: u32) -> Vec<u8> {
    let path = folder.join("whole.mcap");
    let mut file = OpenFile::create(path.clone(), &about()).expect("created");
    for sequence in 0..count {
        file.add(&entry(sequence)).expect("written");
        if sequence % 10 == 9 {
            file.flush().expect("written");
        }
    }
    file.finish().expect("on the disk");
    fs::read(path).expect("readable")
}

#[test]
fn file_contains_what_was_written() {
    let folder = tempfile::tempdir().expect("a folder");
    written(folder.path(), 100);
    let (entries, error) = read(&folder.path().join("whole.mcap"));
    assert!(error.is_none(), "{error:?}");
    assert_eq!(entries, (0..100).map(entry).collect::<Vec<_>>());
}

#[test]
fn unfinished_file_is_read_up_to_its_last_chunk_wherever_it_breaks_off() {
    let folder = tempfile::tempdir().expect("a folder");
    let bytes = written(folder.path(), 40);
    let part = folder.path().join("000001.mcap.part");
    let other = folder.path().join("cut.mcap");
    let mut most = 0;
    for length in 0..bytes.len() {
        fs::write(&part, &bytes[..length]).expect("written");
        let (entries, error) = read(&part);
        assert!(error.is_none(), "{length}: {error:?}");
        assert!(
            entries.len() >= most,
            "{length}: {} after {most}",
            entries.len()
        );
        most = entries.len();
        let expected: Vec<_> = (0..most as u32).map(entry).collect();
        assert_eq!(entries, expected, "cut to {length} bytes");
        fs::write(&other, &bytes[..length]).expect("written");
        let (_, error) = read(&other);
        assert!(
            matches!(error, Some(ReadError::Damaged { .. })),
            "a complete file that is cut to {length} bytes: {error:?}"
        );
    }
    assert_eq!(most, 40);
}

#[test]
fn damaged_file_is_reported() {
    let folder = tempfile::tempdir().expect("a folder");
    let bytes = written(folder.path(), 40);
    let path = folder.path().join("damaged.mcap");
    let mut undetected = 0;
    for position in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[position] ^= 0x10;
        fs::write(&path, damaged).expect("written");
        let (entries, error) = read(&path);
        // Outside of the chunks, whose checksums are verified, a bit may change what nothing depends on.
        undetected += usize::from(error.is_none());
        for read in entries {
            let original = entry(read.sequence);
            assert_eq!(read.payload.bytes, original.payload.bytes, "{position}");
        }
    }
    assert!(undetected < bytes.len(), "{undetected} of {}", bytes.len());
}

#[test]
fn other_files_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = |error: Option<ReadError>| error.expect("refused").to_string();
    assert!(text(read(folder.path()).1).contains("contains no recording"));
    let path = folder.path().join("x.mcap");
    assert!(text(read(&path).1).starts_with("cannot read"));
    for content in [&b""[..], b"no recording", &[0x89; 100_000]] {
        fs::write(&path, content).expect("written");
        assert!(text(read(&path).1).contains("damaged after 0 messages"));
    }
}

/// Found by fuzzing: a parser that believes the length of a string reserves 4 GB for it.
#[test]
fn file_that_promises_a_long_string_is_damaged() {
    let magic = b"\x89MCAP0\r\n";
    let channel = [
        &[4, 12, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0][..],
        &[0xff; 4],
        &[0; 4],
    ];
    let metadata = [&[12, 8, 0, 0, 0, 0, 0, 0, 0][..], &[0; 4], &[0xff; 4]];
    for record in [channel, metadata] {
        let file = [&magic[..], &record.concat()].concat();
        let reader = Reader::of("x.mcap".into(), Cursor::new(file));
        let mut reader = reader.expect("opened");
        assert!(matches!(
            reader.next(),
            Some(Err(ReadError::Damaged { .. }))
        ));
        assert!(reader.next().is_none());
    }
}

fn message(number: u32, urgency: Urgency) -> Message {
    let (sender, topic) = (Name::new("a"), Topic::new("x"));
    let payload = Payload::new(number.to_string(), Encoding::TEXT);
    Message {
        urgency,
        sequence: Some(number),
        publisher: Some(7),
        ..Message::new(sender.expect("a name"), topic.expect("a topic"), payload)
    }
}

fn wait_until(what: &str, is_so: impl Fn() -> bool) {
    let deadline = Instant::now() + TIMEOUT;
    while !is_so() {
        assert!(Instant::now() < deadline, "{what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn nothing_is_lost_while_the_disk_fails_for_a_while() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("match.mcap");
    let recorder = Recorder::start(Settings {
        path: path.clone(),
        about: about(),
        keep: None,
        split: Split::default(),
    })
    .expect("started");
    // Nothing can be created in a folder that does not exist.
    let parts = segments::folder_of(&path);
    fs::remove_dir(&parts).expect("removed");
    for number in 0..500 {
        recorder.on_message(message(number, Urgency::Normal));
    }
    wait_until("the problem is reported", || {
        recorder.progress().problem.is_some()
    });
    assert_eq!(recorder.progress().written, 0);
    fs::create_dir(&parts).expect("created");
    wait_until("it is written again", || recorder.progress().written == 500);
    assert_eq!(recorder.progress().problem, None);
    let (files, progress) = recorder.finish().expect("one file");
    assert_eq!((progress.written, progress.dropped), (500, 0));
    assert_eq!(files, [path]);
    let (entries, error) = read(&files[0]);
    assert!(error.is_none(), "{error:?}");
    let numbers: Vec<_> = entries.iter().map(|entry| entry.sequence).collect();
    assert_eq!(numbers, (0..500).collect::<Vec<_>>());
    assert!(!parts.exists(), "the parts are removed");
}

/// Runs a test in a process of its own, for which a file that is too large is an error. Returns whether this is that process.
fn runs_alone(test: &str) -> bool {
    const ALONE: &str = "RECT_TEST_ALONE";
    if std::env::var_os(ALONE).is_some() {
        return true;
    }
    let program = std::env::current_exe().expect("this program");
    let run = r#"trap '' XFSZ; exec "$0" --exact "$1" --nocapture"#;
    let mut command = Command::new("sh");
    command.args(["-c", run]).arg(program).arg(test);
    let status = command.env(ALONE, "1").status().expect("started");
    assert!(status.success(), "{test}");
    false
}

/// Limits the size of the files that this process writes.
fn limit_files(bytes: &str) {
    let mut command = Command::new("prlimit");
    command.arg(format!("--pid={}", process::id()));
    command.arg(format!("--fsize={bytes}:unlimited"));
    let status = command.status().expect("util-linux has `prlimit`");
    assert!(status.success());
}

#[test]
fn file_that_cannot_be_begun_does_not_end_the_recording() {
    if !runs_alone("file_that_cannot_be_begun_does_not_end_the_recording") {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let recorder = Recorder::start(Settings {
        path: folder.path().join("match.mcap"),
        about: about(),
        keep: None,
        split: Split::default(),
    })
    .expect("started");
    // A file can be created, but not its header.
    limit_files("0");
    for number in 0..100 {
        recorder.on_message(message(number, Urgency::Normal));
    }
    wait_until("the problem is reported", || {
        recorder.progress().problem.is_some()
    });
    limit_files("unlimited");
    wait_until("it is written again", || recorder.progress().written == 100);
    let (files, progress) = recorder.finish().expect("one file");
    assert_eq!((progress.written, progress.dropped), (100, 0));
    assert_eq!(read(&files[0]).0.len(), 100);
}

#[test]
fn part_continues_if_the_next_one_cannot_be_begun() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = segments::folder_of(&folder.path().join("match.mcap"));
    let mut written = Segments::create(path.clone(), about(), None).expect("created");
    let renamed = folder.path().join("match-1.segments");
    // Its folder cannot be made.
    let next = path.with_extension("next");
    fs::write(&next, "").expect("written");
    assert!(written.continue_elsewhere(&renamed).is_err());
    written.write(entry(0)).expect("written");
    written.finish(entry(0).logged).expect("on the disk");
    fs::remove_file(&next).expect("removed");
    written.continue_elsewhere(&renamed).expect("continued");
    written.write(entry(1)).expect("written");
    written.finish(entry(1).logged).expect("on the disk");
    assert_eq!(read(&renamed).0, [entry(0)]);
    assert_eq!(read(&path).0, [entry(1)]);
    assert!(!next.exists());
}

fn retained(sequence: u32, topic: &str, kind: RetainedKind) -> Entry {
    Entry {
        topic: topic.to_owned(),
        recipient: None,
        retained: Some(kind),
        ..entry(sequence)
    }
}

#[test]
fn each_file_begins_with_the_values_that_were_retained_before() {
    use RetainedKind::{Forgotten, Repeated, Value};
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("match.segments");
    let mut written = Segments::create(path.clone(), about(), None).expect("created");
    let files = [
        vec![
            retained(0, "a/mode", Value),
            retained(3, "a/map", Value),
            entry(4),
        ],
        vec![retained(6, "a/mode", Value), entry(7)],
        vec![retained(9, "a/map", Forgotten)],
        vec![entry(10)],
    ];
    for file in &files {
        for entry in file {
            written.write(entry.clone()).expect("written");
        }
        let last = file.last().expect("an entry");
        written.finish(last.logged).expect("on the disk");
    }
    // The folder as a whole has each value once.
    assert_eq!(read(&path).0, files.concat());

    let repeated = |of: &Entry, first: &Entry| Entry {
        retained: Some(Repeated),
        logged: first.logged,
        ..of.clone()
    };
    let begins_with = |number: usize, values: &[&Entry]| {
        let (entries, _) = read(&path.join(format!("{number:06}.mcap")));
        let own = &files[number - 1];
        let values = values.iter().map(|value| repeated(value, &own[0]));
        let expected: Vec<_> = values.chain(own.iter().cloned()).collect();
        assert_eq!(entries, expected, "{number}");
    };
    let (map, mode) = (&files[0][1], &files[1][0]);
    begins_with(1, &[]);
    begins_with(2, &[map, &files[0][0]]);
    begins_with(3, &[map, mode]);
    begins_with(4, &[mode]);

    // Without the first file, the second one has what was retained.
    fs::remove_file(path.join("000001.mcap")).expect("removed");
    let topics: Vec<_> = (read(&path).0.into_iter())
        .map(|entry| (entry.topic, entry.retained))
        .take(3)
        .collect();
    let expected = [("a/map", Repeated), ("a/mode", Repeated), ("a/mode", Value)];
    assert_eq!(
        topics,
        expected.map(|(topic, kind)| (topic.to_owned(), Some(kind)))
    );
}

#[test]
fn values_of_a_file_that_failed_are_repeated_as_they_were_before_it() {
    use RetainedKind::{Repeated, Value};
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("match.segments");
    let mut written = Segments::create(path.clone(), about(), None).expect("created");
    let (old, new) = (retained(0, "a/mode", Value), retained(3, "a/mode", Value));
    written.write(old.clone()).expect("written");
    written.finish(old.logged).expect("on the disk");
    written.write(new.clone()).expect("written");
    let returned = written.abandon();
    assert_eq!(
        returned,
        std::slice::from_ref(&new),
        "without the repeated value"
    );
    for entry in returned {
        written.write(entry).expect("written");
    }
    written.finish(new.logged).expect("on the disk");
    let (entries, _) = read(&path.join("000003.mcap"));
    let kinds: Vec<_> = entries.iter().map(|entry| entry.retained).collect();
    assert_eq!(kinds, [Some(Repeated), Some(Value)]);
    assert_eq!(entries[0].sequence, old.sequence);
    assert_eq!(read(&path).0, [old, new]);
}

#[test]
fn what_a_failure_has_left_does_not_end_the_recording() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("match.segments");
    let mut written = Segments::create(path.clone(), about(), None).expect("created");
    fs::write(path.join("000001.mcap.part"), "").expect("written");
    assert!(written.write(entry(0)).is_err());
    for entry in written.abandon() {
        written.write(entry).expect("written");
    }
    written.finish(entry(0).logged).expect("on the disk");
    assert_eq!(read(&path).0, [entry(0)]);
}

#[test]
fn long_recording_is_split_into_files() {
    let folder = tempfile::tempdir().expect("a folder");
    // A name that is taken is skipped.
    fs::write(folder.path().join("match-2.mcap"), "mine").expect("written");
    let recorder = Recorder::start(Settings {
        path: folder.path().join("match.mcap"),
        about: about(),
        keep: None,
        split: Split {
            bytes: Some(1000),
            ..Split::default()
        },
    })
    .expect("started");
    // Two of them fill a segment, after which a part is complete.
    let large = |number| Message {
        payload: Payload::new(vec![7; segments::SEGMENT_BYTES / 2], Encoding::BYTES),
        ..message(number, Urgency::Urgent)
    };
    for number in 0..6 {
        recorder.on_message(large(number));
        wait_until("it is written", || {
            recorder.progress().written == u64::from(number) + 1
        });
    }
    recorder.on_message(message(6, Urgency::Normal));
    let (files, progress) = recorder.finish().expect("files");
    assert_eq!((progress.written, progress.dropped), (7, 0));
    let names = [
        "match-1.mcap",
        "match-3.mcap",
        "match-4.mcap",
        "match-5.mcap",
    ];
    let expected: Vec<_> = names.iter().map(|name| folder.path().join(name)).collect();
    assert_eq!(files, expected);
    let numbers = files.iter().flat_map(|file| read(file).0);
    let numbers: Vec<_> = numbers.map(|entry| entry.sequence).collect();
    assert_eq!(numbers, [0, 1, 2, 3, 4, 5, 6]);
    let left = fs::read_dir(folder.path()).expect("readable").count();
    assert_eq!(left, 5, "no folder remains");
}

#[test]
fn two_recorders_of_one_file_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let settings = Settings {
        path: folder.path().join("match.mcap"),
        about: about(),
        keep: None,
        split: Split::default(),
    };
    let _first = Recorder::start(settings.clone()).expect("started");
    let second = Recorder::start(settings)
        .err()
        .expect("refused")
        .to_string();
    assert!(second.contains("another recorder writes it"), "{second}");
}
