//! Measures what a recording of 20 topics with 50 messages per second and a camera costs, beside the reference writer of MCAP.
//!
//!     record_cost rect|mcap FILE
//!
//! Prints one line of JSON. `packaging/footprint/run` runs it on an emulated Raspberry Pi 3B, where processor time counts
//! instructions.
mod processor_time;

use std::{
    collections::BTreeMap,
    error::Error,
    fs::{self, File},
    io::BufWriter,
    path::Path,
    thread::sleep,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use mcap::records::MessageHeader;
use processor_time::processor_time;
use rect_core::{
    message::{encoding::Encoding, payload::Payload, Message},
    name::{topic::Topic, Name},
};
use rect_recording::{Recorder, Settings, Split};

type Outcome<T> = Result<T, Box<dyn Error>>;

const SECONDS: u32 = 20;
const TOPICS: u32 = 20;
const RATE_HZ: u32 = 50;
/// A picture follows each fifth round of messages.
const ROUNDS_FOR_A_PICTURE: u32 = 5;
/// About the size of a JPEG of 320x240.
const PICTURE_BYTES: usize = 10_000;

fn main() -> Outcome<()> {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let arguments: Vec<_> = arguments.iter().map(String::as_str).collect();
    let (writer, written) = match arguments[..] {
        ["rect", file] => ("rect", record(Path::new(file))?),
        ["mcap", file] => ("mcap", write(Path::new(file))?),
        _ => return Err("usage: record_cost rect|mcap FILE".into()),
    };
    let Written {
        time,
        memory_kb,
        bytes,
    } = written;
    let us = time.as_micros();
    println!("{{\"recorder\": \"{writer}\", \"cpu_us\": {us}, \"own_kb\": {memory_kb}, \"bytes\": {bytes}, \"s\": {SECONDS}}}");
    Ok(())
}

struct Written {
    /// The processor time, without that of making the messages.
    time: Duration,
    /// The private memory of the process at the end of the recording, before the file is completed.
    memory_kb: u64,
    /// The size of the complete file.
    bytes: u64,
}

/// Records with RECT.
fn record(file: &Path) -> Outcome<Written> {
    let recorder = Recorder::start(Settings {
        path: file.to_owned(),
        about: BTreeMap::default(),
        keep: None,
        split: Split::default(),
    })?;
    let before = processor_time()?;
    let others = paced(|message, _| {
        recorder.on_message(message);
        Ok(())
    })?;
    let memory_kb = private_kb()?;
    let (files, progress) = recorder.finish()?;
    let time = processor_time()? - before - others;
    let expected = SECONDS * RATE_HZ * TOPICS + SECONDS * RATE_HZ / ROUNDS_FOR_A_PICTURE;
    assert_eq!((progress.written, progress.dropped), (expected.into(), 0));
    Ok(Written {
        time,
        memory_kb,
        bytes: size(&files[0])?,
    })
}

/// Writes the same with the crate `mcap` and its defaults, except that it compresses on the same thread.
fn write(file: &Path) -> Outcome<Written> {
    let options = mcap::WriteOptions::new().compression_threads(0);
    let mut writer = options.create(BufWriter::new(File::create(file)?))?;
    let mut channels = BTreeMap::new();
    let before = processor_time()?;
    let others = paced(|message, sequence| {
        let topic = message.topic.to_string();
        let encoding = message.payload.encoding.as_str();
        let channel_id = match channels.get(&topic) {
            Some(id) => *id,
            None => {
                let id = writer.add_channel(0, &topic, encoding, &BTreeMap::new())?;
                *channels.entry(topic).or_insert(id)
            }
        };
        let now = SystemTime::now().duration_since(UNIX_EPOCH)?;
        let now = u64::try_from(now.as_nanos())?;
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: now,
            publish_time: now,
        };
        Ok(writer.write_to_known_channel(&header, &message.payload.bytes)?)
    })?;
    let memory_kb = private_kb()?;
    writer.finish()?;
    let time = processor_time()? - before - others;
    Ok(Written {
        time,
        memory_kb,
        bytes: size(file)?,
    })
}

/// Passes the messages on as fast as they would arrive. Returns the processor time of making them.
fn paced(mut record: impl FnMut(Message, u32) -> Outcome<()>) -> Outcome<Duration> {
    let sender = Name::new("wombat-1")?;
    let topics = (0..TOPICS).map(|n| Topic::new(&format!("sensor-{n}/value")));
    let topics = topics.collect::<Result<Vec<_>, _>>()?;
    let camera = Topic::new("camera")?;
    let mut random = 1u32;
    let mut others = Duration::ZERO;
    let start = Instant::now();
    for round in 0..SECONDS * RATE_HZ {
        let due = start + Duration::from_secs(1) * round / RATE_HZ;
        sleep(due.saturating_duration_since(Instant::now()));
        let mut pass = |topic: &Topic, payload: Payload| {
            record(message(&sender, topic, payload, round), round)
        };
        for (n, topic) in topics.iter().enumerate() {
            let begun = processor_time()?;
            let value = f64::from(round) * 0.25 + n as f64;
            let json = format!(
                "{{\"at\": {{\"x\": {value}, \"y\": {}, \"heading\": 1.25}}}}",
                -value
            );
            others += processor_time()? - begun;
            pass(topic, Payload::new(json, Encoding::JSON))?;
        }
        if round % ROUNDS_FOR_A_PICTURE == 0 {
            let begun = processor_time()?;
            let mut picture = vec![0xff, 0xd8];
            picture.resize_with(PICTURE_BYTES, || {
                random ^= random << 13;
                random ^= random >> 17;
                random ^= random << 5;
                random as u8
            });
            others += processor_time()? - begun;
            pass(&camera, Payload::new(picture, Encoding::JPEG))?;
        }
    }
    Ok(others)
}

fn message(sender: &Name, topic: &Topic, payload: Payload, sequence: u32) -> Message {
    Message {
        sequence: Some(sequence),
        publisher: Some(1),
        ..Message::new(sender.clone(), topic.clone(), payload)
    }
}

/// Returns the private memory of this process: heap, stacks and changed data.
fn private_kb() -> Outcome<u64> {
    let text = fs::read_to_string("/proc/self/smaps_rollup")?;
    let line = text
        .lines()
        .find_map(|line| line.strip_prefix("Anonymous:"));
    let kb = line.and_then(|line| line.split_whitespace().next());
    Ok(kb.ok_or("no line Anonymous")?.parse()?)
}

fn size(file: &Path) -> Outcome<u64> {
    Ok(fs::metadata(file)?.len())
}
