//! Tests files of other programs: in any order, and with what only those programs understand.
use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{BufWriter, Write},
    path::{Path, PathBuf},
    slice::from_ref,
    time::Duration,
};

use mcap::{
    read::ChunkFlattener,
    records::{MessageHeader, Metadata, Record},
    Attachment, WriteOptions,
};
use rect_recording::{by_time, merge::merge, Extras, Reader, Selection, Summary};

use crate::{entry, read, written};

fn map(name: &str, value: &str) -> BTreeMap<String, String> {
    BTreeMap::from([(name.to_owned(), value.to_owned())])
}

/// Writes a file with messages at these seconds, in this order, in chunks of seven.
fn ros_file(path: &Path, options: WriteOptions, seconds: &[u64]) {
    let file = BufWriter::new(File::create(path).expect("created"));
    let mut writer = options.profile("ros2").create(file).expect("begun");
    writer
        .write_metadata(&Metadata {
            name: "weather".to_owned(),
            metadata: map("sky", "grey"),
        })
        .expect("written");
    writer
        .attach(&Attachment {
            log_time: 1,
            create_time: 2,
            name: "map.pgm".to_owned(),
            media_type: "image/x-portable-graymap".to_owned(),
            data: vec![7; 100_000].into(),
        })
        .expect("written");
    let schema = writer.add_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data");
    let schema = schema.expect("written");
    for (n, second) in seconds.iter().enumerate() {
        let topic = format!("/topic{}", n % 3);
        let channel = writer.add_channel(schema, &topic, "cdr", &map("offered_qos_profiles", ""));
        let header = MessageHeader {
            channel_id: channel.expect("written"),
            sequence: n as u32,
            log_time: second * 1_000_000_000,
            publish_time: n as u64,
        };
        let data = [0, 1, 0, 0, n as u8];
        let added = writer.write_to_known_channel(&header, &data);
        added.expect("written");
        if n % 7 == 6 {
            writer.flush().expect("written");
        }
    }
    writer.finish().expect("finished");
}

/// Returns everything that a file contains, in a form without its own numbers.
fn contents(path: &Path) -> Vec<String> {
    let bytes = fs::read(path).expect("readable");
    let (mut schemas, mut channels) = (BTreeMap::new(), BTreeMap::new());
    let mut found = Vec::new();
    for record in ChunkFlattener::new(&bytes).expect("a file") {
        match record.expect("whole") {
            Record::Header(header) => found.push(header.profile),
            Record::Schema { header, data } => {
                let schema = format!("{} {} {data:?}", header.name, header.encoding);
                schemas.insert(header.id, schema);
            }
            Record::Channel(channel) => {
                let schema = schemas.get(&channel.schema_id);
                let (topic, encoding) = (channel.topic, channel.message_encoding);
                let channel_text = format!("{topic} {encoding} {:?} {schema:?}", channel.metadata);
                channels.insert(channel.id, channel_text);
            }
            Record::Message { header, data } => {
                let (channel, times) = (&channels[&header.channel_id], header.log_time);
                let numbers = (header.sequence, times, header.publish_time);
                found.push(format!("{numbers:?} {channel} {data:?}"));
            }
            Record::Metadata(metadata) => found.push(format!("{metadata:?}")),
            Record::Attachment { header, data, .. } => found.push(format!("{header:?} {data:?}")),
            _ => {}
        }
    }
    found.sort();
    found.dedup();
    found
}

/// Times whose first is the latest, and of which each chunk has early and late ones.
fn mixed() -> Vec<u64> {
    let times = (0..40).map(|n| 100 + (39 + n * 17) % 40);
    times.collect()
}

#[test]
fn messages_are_read_in_the_order_of_their_times() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("mixed.mcap");
    let no_summary = || WriteOptions::new().emit_summary_records(false);
    for options in [
        WriteOptions::new(),
        no_summary(),
        WriteOptions::new().use_chunks(false),
        no_summary().use_chunks(false),
    ] {
        ros_file(&path, options, &mixed());
        let (entries, error) = read(&path);
        assert!(error.is_none(), "{error:?}");
        let times: Vec<_> = entries.iter().map(|entry| entry.logged.as_secs()).collect();
        assert_eq!(times, (100..140).collect::<Vec<_>>());
        let selection = Selection {
            begin: Duration::from_secs(10),
            end: Some(Duration::from_secs(20)),
            ..Selection::default()
        };
        let selected = selection.of(Reader::open(&path).expect("opened"));
        let times = selected.map(|entry| entry.expect("whole").logged.as_secs());
        assert_eq!(times.collect::<Vec<_>>(), (110..=120).collect::<Vec<_>>());
    }
}

/// Compresses the chunks of a file, which are not compressed yet, with LZ4.
fn with_lz4(file: &[u8]) -> Vec<u8> {
    const CHUNK: u8 = 6;
    // The times, the size and the checksum of the records.
    const FIXED: usize = 28;
    let (mut found, mut rest) = file.split_at(8);
    let mut written = found.to_vec();
    while rest.len() > 8 {
        let length = u64::from_le_bytes(*rest[1..].first_chunk().expect("a length"));
        (found, rest) = rest.split_at(9 + usize::try_from(length).expect("short"));
        if found[0] != CHUNK {
            written.extend_from_slice(found);
            continue;
        }
        let content = &found[9..];
        let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
        // Behind the empty name of the compression and the size.
        encoder
            .write_all(&content[FIXED + 12..])
            .expect("compressed");
        let records = encoder.finish().expect("compressed");
        let size = (records.len() as u64).to_le_bytes();
        let chunk = [
            &content[..FIXED],
            &3_u32.to_le_bytes(),
            b"lz4",
            &size,
            &records,
        ]
        .concat();
        written.push(CHUNK);
        written.extend_from_slice(&(chunk.len() as u64).to_le_bytes());
        written.extend_from_slice(&chunk);
    }
    [&written, rest].concat()
}

#[test]
fn lz4_is_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("lz4.mcap");
    let options = WriteOptions::new()
        .compression(None)
        .emit_summary_records(false);
    ros_file(&path, options.emit_message_indexes(false), &mixed());
    let compressed = with_lz4(&fs::read(&path).expect("readable"));
    fs::write(&path, compressed).expect("written");
    let (entries, error) = read(&path);
    assert!(error.is_none(), "{error:?}");
    assert_eq!(entries.len(), 40);
}

/// One chunk with all messages, and an attachment, of more than 64 MB each.
#[test]
fn large_chunks_and_attachments_are_read() {
    const MB: usize = 1 << 20;
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("large.mcap");
    let file = BufWriter::new(File::create(&path).expect("created"));
    let options = WriteOptions::new().compression(None).chunk_size(None);
    let mut writer = options.create(file).expect("begun");
    let attachment = Attachment {
        log_time: 1,
        create_time: 2,
        name: "map".to_owned(),
        media_type: "application/octet-stream".to_owned(),
        data: vec![7; 65 * MB].into(),
    };
    writer.attach(&attachment).expect("written");
    let channel = writer
        .add_channel(0, "/cloud", "cdr", &BTreeMap::new())
        .expect("written");
    for sequence in 0..17 {
        let header = MessageHeader {
            channel_id: channel,
            sequence,
            log_time: u64::from(sequence),
            publish_time: 0,
        };
        let data = vec![0; 4 * MB];
        writer
            .write_to_known_channel(&header, &data)
            .expect("written");
    }
    writer.finish().expect("finished");
    let (entries, error) = read(&path);
    assert!(error.is_none(), "{error:?}");
    assert_eq!(entries.len(), 17);
    let extras = Extras::of(&[path]).expect("read");
    let (header, size, _) = extras.attachments[0].open().expect("whole");
    assert_eq!((header.name.as_str(), size), ("map", 65 << 20));
}

/// Each channel counts for itself, although several have the same topic.
#[test]
fn sequence_numbers_count_per_channel() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("two.mcap");
    let file = BufWriter::new(File::create(&path).expect("created"));
    let mut writer = WriteOptions::new().create(file).expect("begun");
    let channels =
        ["one", "two"].map(|node| writer.add_channel(0, "/tf", "cdr", &map("node", node)));
    let channels = channels.map(|channel| channel.expect("written"));
    for n in 0..10 {
        for (channel_id, first) in channels.into_iter().zip([0, 1000]) {
            let header = MessageHeader {
                channel_id,
                sequence: first + n,
                log_time: u64::from(n),
                publish_time: 0,
            };
            writer
                .write_to_known_channel(&header, b"x")
                .expect("written");
        }
    }
    writer.finish().expect("finished");
    let (summary, error) = Summary::read(Reader::open(&path).expect("opened"));
    assert!(error.is_none(), "{error:?}");
    assert_eq!(summary.topics["/tf"].messages, 20);
    assert_eq!(summary.topics["/tf"].missed, 0);
}

#[test]
fn copy_keeps_what_other_programs_have_recorded() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("ros.mcap");
    let copy = folder.path().join("copy.mcap");
    for options in [WriteOptions::new(), WriteOptions::new().use_chunks(false)] {
        ros_file(&path, options, &mixed());
        let extras = Extras::of(from_ref(&path)).expect("read");
        let reader = Reader::open(&path).expect("opened");
        assert_eq!(merge(reader, &copy, &extras).expect("written"), 40);
        assert_eq!(contents(&copy), contents(&path));
        fs::remove_file(&copy).expect("removed");
    }
}

#[test]
fn recordings_of_several_programs_are_merged() {
    let folder = tempfile::tempdir().expect("a folder");
    let ros = folder.path().join("ros.mcap");
    ros_file(&ros, WriteOptions::new(), &mixed());
    written(folder.path(), 20);
    let paths: Vec<PathBuf> = vec![folder.path().join("whole.mcap"), ros.clone()];
    let readers = paths.iter().map(|path| Reader::open(path).expect("opened"));
    let entries = by_time(readers.collect());
    let merged = folder.path().join("merged.mcap");
    let extras = Extras::of(&paths).expect("read");
    assert_eq!(merge(entries, &merged, &extras).expect("written"), 60);
    let all = contents(&merged);
    let is_message = |text: &&String| text.contains("/topic");
    for kept in contents(&ros).iter().filter(|text| *text != "ros2") {
        assert!(all.contains(kept), "{kept}");
    }
    assert_eq!(all.iter().filter(is_message).count(), 40);
    let (entries, error) = read(&merged);
    assert!(error.is_none(), "{error:?}");
    assert!(entries.is_sorted_by_key(|entry| entry.logged));
    let own = entries.into_iter().filter(|entry| entry.foreign.is_none());
    assert!(own.eq((0..20).map(entry)));
}

#[test]
fn damaged_attachment_is_not_copied() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("ros.mcap");
    ros_file(&path, WriteOptions::new(), &[1, 2]);
    let mut bytes = fs::read(&path).expect("readable");
    let name = b"map.pgm";
    let at = bytes.windows(name.len()).position(|bytes| bytes == name);
    bytes[at.expect("the attachment") + 1000] ^= 1;
    fs::write(&path, bytes).expect("written");
    let extras = Extras::of(from_ref(&path)).expect("read");
    let copy = folder.path().join("copy.mcap");
    let error = merge(Reader::open(&path).expect("opened"), &copy, &extras);
    let error = error.expect_err("damaged").to_string();
    assert!(error.contains("Attachment CRC failed"), "{error}");
    assert!(!copy.exists());
    let (extras, missing) = Extras::of_damaged(&path).expect("read");
    assert_eq!((extras.attachments.len(), missing.len()), (0, 1));
    assert!(missing[0].reason.contains("attachment"), "{missing:?}");
}
