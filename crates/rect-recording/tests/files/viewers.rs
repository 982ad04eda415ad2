//! Tests that Foxglove and Lichtblick show the messages of a recording, by the rules of their parser of schemas, and that reading
//! returns the payloads as they were.
use std::{fs, io::Cursor, path::Path, time::Duration};

use bytes::Bytes;
use rect_core::{
    codec::array::Array,
    log::{level::Level, line::Line, page::Kept},
    message::{
        encoding::Encoding,
        payload::{typed, Payload, ToPayload},
        urgency::Urgency,
    },
    name::Name,
};
use rect_recording::{
    file::{About, Encoder},
    log,
    report::EventReport,
    Entry, Reader, Recorder, Selection, Settings, Split, Summary,
};
use serde_json::{json, Value};

fn entry(topic: &str, payload: Payload, sequence: u32) -> Entry {
    let logged = Duration::from_secs(1000 + u64::from(sequence));
    Entry {
        topic: topic.to_owned(),
        recipient: None,
        payload,
        urgency: Urgency::Normal,
        sequence,
        publisher: None,
        logged,
        sent: logged,
        retained: None,
        foreign: None,
    }
}

fn json_payload(text: &str) -> Payload {
    Payload::new(text.to_owned(), Encoding::JSON)
}

/// Returns what the viewers refuse in a schema: a root that is not an object, and fields and items without one known type.
fn refused(schema: &Value, name: &str) -> Option<String> {
    let fields = schema["properties"].as_object();
    let Some(fields) = fields.filter(|_| schema["type"] == "object") else {
        return Some(format!("{name} is not an object: {schema}"));
    };
    fields.iter().find_map(|(field, schema)| {
        let name = format!("{name}.{field}");
        let schema = match schema["type"] == "array" {
            true => &schema["items"],
            false => schema,
        };
        match schema["type"].as_str() {
            Some("boolean" | "integer" | "number" | "string") => None,
            Some("object") => refused(schema, &name),
            other => Some(format!("{name} has the type {other:?}")),
        }
    })
}

/// A message in the form in which viewers show it, and its schema.
type Shown = (Value, Value);

/// Records messages. Verifies that viewers accept what shows them, and that the same messages are read back. Returns what is shown.
fn recorded(entries: &[Entry]) -> Vec<Shown> {
    let mut encoder = Encoder::new(Cursor::new(Vec::new()), &About::new()).expect("begun");
    for entry in entries {
        encoder.add(entry).expect("written");
    }
    let file = encoder.finish().expect("finished").into_inner();
    let reader = Reader::of("x.mcap".into(), Cursor::new(file.clone()));
    let read = reader.expect("opened").collect::<Result<Vec<_>, _>>();
    assert_eq!(read.expect("whole"), entries);
    let messages = mcap::MessageStream::new(&file).expect("a file");
    let shown = messages.filter_map(|message| {
        let message = message.expect("whole");
        let channel = &message.channel;
        if channel.message_encoding != "json" {
            assert!(channel.schema.is_none(), "{channel:?}");
            return None;
        }
        let schema = channel.schema.as_ref().expect("a schema");
        assert_eq!(schema.encoding, "jsonschema");
        let definition = serde_json::from_slice(&schema.data).expect("JSON");
        assert_eq!(refused(&definition, &schema.name), None, "{definition}");
        let value: Value = serde_json::from_slice(&message.data).expect("JSON");
        assert!(value.is_object(), "{value}");
        Some((value, definition))
    });
    shown.collect()
}

/// Records a message, which is shown. Returns the object.
fn shown(payload: Payload) -> Value {
    let text = format!("{payload:?}");
    let [(shown, _)] = &recorded(&[entry("a/x", payload, 0)])[..] else {
        panic!("{text} is not shown");
    };
    shown.clone()
}

#[test]
fn values_of_every_form_are_shown() {
    for (text, expected) in [
        ("12.5", json!({"value": 12.5})),
        ("true", json!({"value": true})),
        ("null", json!({"value": null})),
        ("\"open\"", json!({"value": "open"})),
        (" [1, 2]\n", json!({"value": [1, 2]})),
        ("[]", json!({"value": []})),
        ("[[1, 2], [3]]", json!({"value": [[1, 2], [3]]})),
        ("{}", json!({})),
        ("{\"value\": 1}", json!({"value": 1})),
        ("{\"a\": null}", json!({"a": null})),
        ("{\"detections\": []}", json!({"detections": []})),
        ("{\"table\": [[1], []]}", json!({"table": [[1], []]})),
        (
            "[{\"x\": {}}, null, 1]",
            json!({"value": [{"x": {}}, null, 1]}),
        ),
        ("{\"range\": NaN}", json!({"range": "NaN"})),
        ("-Infinity", json!({"value": "-Infinity"})),
    ] {
        assert_eq!(shown(json_payload(text)), expected, "{text}");
    }
    let deep = format!("{}1{}", "{\"a\":[".repeat(40), "]}".repeat(40));
    assert!(shown(json_payload(&deep)).is_object());
    let text = Payload::new("hä", Encoding::TEXT);
    assert_eq!(shown(text), json!({"value": "hä"}));
    // A map with the key 1 and two bytes.
    let cbor = Payload::new(&b"\xa1\x01\x42ab"[..], Encoding::CBOR);
    assert_eq!(shown(cbor), json!({"1": {"bytes": 2}}));
    let array = Array::of(&[2], &[0.1f32, 2.0]).expect("an array");
    let array = array.to_payload().expect("a payload");
    assert_eq!(shown(array), json!({"value": [0.1, 2.0]}));
}

#[test]
fn values_in_the_documentation_are_shown() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut pages = vec![root.join("README.md")];
    for folder in [
        "docs",
        "docs/tutorial",
        "docs/how-to",
        "docs/concepts",
        "docs/reference",
    ] {
        let Ok(files) = fs::read_dir(root.join(folder)) else {
            continue;
        };
        pages.extend(files.map(|file| file.expect("a file").path()));
    }
    pages.retain(|page| page.extension().is_some_and(|ending| ending == "md"));
    let mut count = 0;
    for page in pages {
        let text = fs::read_to_string(page).expect("text");
        let commands = ["rect pub ", "rect send ", "rect request "];
        let lines = text.lines().filter_map(|line| {
            let command = commands.iter().find_map(|command| line.split_once(command));
            Some(command?.1.split('#').next().unwrap_or_default())
        });
        for line in lines {
            // In quotes, or a word.
            let value = match line.split('\'').collect::<Vec<_>>()[..] {
                [_, value, ..] => value,
                _ => line.split_whitespace().last().unwrap_or_default(),
            };
            shown(typed(value.to_owned()));
            count += 1;
        }
        let blocks = text.split("```json\n").skip(1);
        for block in blocks.filter_map(|block| block.split("```").next()) {
            shown(typed(block.to_owned()));
            count += 1;
        }
    }
    assert!(count > 5, "{count} values");
}

#[test]
fn topic_whose_values_change_their_form_is_shown() {
    let texts = [
        "{\"detections\": []}",
        "{\"detections\": [{\"x\": 1}]}",
        "{\"detections\": [], \"n\": 0}",
        "12.5",
        "\"off\"",
        "[1, 2]",
        "{\"value\": {\"x\": 1}}",
        "{\"detections\": 3}",
    ];
    let texts: Vec<_> = (0..).zip(texts).collect();
    let entries = texts
        .iter()
        .map(|(n, text)| entry("a/x", json_payload(text), *n));
    let shown = recorded(&entries.collect::<Vec<_>>());
    assert_eq!(shown.len(), texts.len());
    let fields = |n: usize| {
        let (_, schema) = &shown[n];
        let fields = schema["properties"].as_object().expect("an object");
        fields.keys().cloned().collect::<Vec<_>>()
    };
    assert_eq!(fields(0), Vec::<String>::new());
    assert_eq!(fields(1), ["detections"]);
    assert_eq!(fields(2), ["detections", "n"]);
    assert_eq!(fields(3), ["detections", "n", "value"]);
    // A field that is a number, a list and an object, or a list and a number, is not described.
    assert_eq!(fields(5), ["detections", "n"]);
    assert_eq!(fields(7), ["n"]);
}

#[test]
fn bytes_of_other_programs_are_left_as_they_are() {
    for (bytes, encoding) in [
        (&b"\xff\x00"[..], Encoding::BYTES),
        (b"\0\x01\0\0", Encoding::new("application/cdr")),
        (b"{not JSON", Encoding::JSON),
        (b"\xa1", Encoding::CBOR),
        (b"\xff", Encoding::TEXT),
        (b"12", Encoding::new("application/octet-stream;array;f32;9")),
    ] {
        let payload = Payload::new(Bytes::from_static(bytes), encoding);
        assert!(recorded(&[entry("a/x", payload, 0)]).is_empty());
    }
}

#[test]
fn reports_of_robots_are_shown() {
    let robot = Name::new("wombat-1").expect("a name");
    let event = EventReport {
        kind: "peer_up",
        robot: Some("wombat-2"),
        ..EventReport::default()
    };
    let event = serde_json::to_vec(&event).expect("JSON");
    let link = br#"{"method":"ble","robot":null,"paths":[],"sent":{"bytes":1,"lost":null}}"#;
    let at = Duration::from_secs(1);
    let shown = recorded(&[
        Entry::of_report(&robot, "events", event, at),
        Entry::of_report(&robot, "link/wombat-2", link.to_vec(), at),
    ]);
    let [(_, event), (_, link)] = &shown[..] else {
        panic!("{shown:?}");
    };
    assert_eq!(event["properties"]["robot"], json!({"type": "string"}));
    assert_eq!(
        link["properties"]["sent"]["properties"],
        json!({"bytes": {"type": "number"}})
    );
}

#[test]
fn lines_of_logs_are_shown_in_log_panels() {
    let folder = tempfile::tempdir().expect("folder");
    let robot = Name::new("wombat-1").expect("a name");
    let recorder = Recorder::start(Settings {
        path: folder.path().join("match.mcap"),
        about: About::new(),
        keep: None,
        split: Split::default(),
    });
    let recorder = recorder.expect("started");
    for level in Level::ALL {
        let line = Line {
            fields: [("angle".to_owned(), json!(12.5))].into(),
            source: "arm.py:7".to_owned(),
            ..Line::new(1_795_000_000_123, level, "one\n  two")
        };
        recorder.on_line(
            &robot,
            &Kept {
                number: 1,
                program: "arm".to_owned(),
                line,
            },
        );
    }
    recorder.on_missed_lines(&robot);
    let (files, progress) = recorder.finish().expect("finished");
    assert_eq!(progress.written, 0, "lines do not count as messages");
    let reader = Reader::open(&files[0]).expect("opened");
    let (summary, error) = Summary::read(reader);
    assert!(error.is_none(), "{error:?}");
    assert_eq!((summary.log_lines, summary.reports), (5, 0));
    assert!(summary.topics.is_empty(), "{summary:?}");

    let file = fs::read(&files[0]).expect("read");
    let messages = mcap::MessageStream::new(&file).expect("a file");
    let shown = messages.map(|message| {
        let message = message.expect("whole");
        let schema = message.channel.schema.clone().expect("a schema");
        assert_eq!(message.channel.topic, "wombat-1/@rect/log");
        assert_eq!(schema.name, "foxglove.Log");
        serde_json::from_slice::<Value>(&message.data).expect("JSON")
    });
    let shown: Vec<_> = shown.collect();
    let levels: Vec<_> = shown.iter().map(|line| &line["level"]).collect();
    assert_eq!(levels, [1, 2, 3, 4, 3]);
    assert_eq!(shown[0]["message"], "one\n  two");
    // Viewers accept the schema, and it stays in a file that is cut or merged.
    let reader = Reader::open(&files[0]).expect("opened");
    let entries: Vec<_> = reader.map(|entry| entry.expect("whole")).collect();
    let definition = serde_json::from_slice::<Value>(&log::schema().text).expect("JSON");
    assert!(recorded(&entries).iter().all(|(_, of)| *of == definition));
    assert!(rect_recording::Replay::new(
        entries.into_iter().map(Ok::<_, ()>),
        Selection::default(),
        Vec::new(),
        None
    )
    .next()
    .is_none());
}

#[test]
fn payloads_that_another_program_has_removed_come_back_as_values() {
    let entries = [
        entry("a/x", json_payload("12.5"), 0),
        entry("a/x", Payload::new("hello", Encoding::TEXT), 1),
        entry("a/x", Payload::new(&b"\x18\x2a"[..], Encoding::CBOR), 2),
    ];
    let mut encoder = Encoder::new(Cursor::new(Vec::new()), &About::new()).expect("begun");
    for entry in &entries {
        encoder.add(entry).expect("written");
    }
    let file = encoder.finish().expect("finished").into_inner();
    // As a filter does it: the messages and their channels are copied, and other records are not.
    let mut copy = mcap::Writer::new(Cursor::new(Vec::new())).expect("begun");
    for message in mcap::MessageStream::new(&file).expect("a file") {
        copy.write(&message.expect("whole")).expect("written");
    }
    copy.finish().expect("finished");
    let copy = copy.into_inner().into_inner();
    let reader = Reader::of("x.mcap".into(), Cursor::new(copy)).expect("opened");
    let payloads = reader.map(|entry| entry.expect("whole").payload);
    let expected = [
        json_payload("12.5"),
        Payload::new("hello", Encoding::TEXT),
        json_payload("42"),
    ];
    assert_eq!(payloads.collect::<Vec<_>>(), expected);
}
