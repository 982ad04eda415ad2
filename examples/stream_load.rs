//! Generates the load of `benches/stream.py`: a camera at one router, a program that watches its stream at the other router,
//! and urgent messages from the camera's program at the same time. All run in one process, so that a single clock measures
//! the ages. The result is printed as JSON.
//!
//!     stream_load '{"near": "tcp/...", "far": "tcp/...", "panorama": "file", "panorama_size": [1280, 960],
//!                   "size": [640, 480], "codec": null, "lossy_format": "jpeg", "video": false, "moves": false, "frames_per_s": 15,
//!                   "seconds": 30, "frames": "folder"}'
//!
//! `panorama` is a file of raw RGB pixels, over which the camera pans. Each value has noise of up to 3 of 255, as that of a
//! sensor. `codec` is the codec of a fixed stream; null selects an adaptive stream, or a video. Every eighth
//! frame is written to `frames`, as `<index>.clean` before the noise and as `<index>` after it has arrived.
use std::{
    error::Error,
    fs,
    path::PathBuf,
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc, Mutex,
    },
    thread,
    time::{Duration, Instant},
};

use rect::{
    codec, Format, LossyFormat, Options, Picture, Robot, StreamOptions, StreamSender, ToPayload,
};
use serde::{Deserialize, Serialize};

/// The noise of the camera, in each direction.
const NOISE: i16 = 3;
/// Every frame whose number is a multiple of this is examined.
const EXAMINED: u32 = 8;
const URGENT_INTERVAL: Duration = Duration::from_millis(50);
/// How long messages in flight may take to arrive after the last one was sent.
const DRAIN_TIME: Duration = Duration::from_secs(2);

#[derive(Deserialize)]
struct Task {
    /// Endpoint of the router of the camera's program.
    near: String,
    /// Endpoint of the router of the program that watches.
    far: String,
    panorama: PathBuf,
    panorama_size: [u32; 2],
    size: [u32; 2],
    codec: Option<String>,
    lossy_format: String,
    video: bool,
    /// Whether things move before the camera, and the light changes.
    moves: bool,
    /// The rate of the camera, and the largest of the stream.
    frames_per_s: u32,
    /// Duration of the measurement.
    seconds: u64,
    /// Folder into which the payloads of the received frames are written.
    frames: PathBuf,
}

#[derive(Serialize)]
struct ReceivedFrame {
    number: u32,
    /// The camera's index of the frame.
    index: u32,
    /// Time of arrival since the start of the measurement.
    at_s: f64,
    /// Time since the camera took the picture.
    age_ms: f64,
    /// Age according to the library.
    reported_age_ms: Option<f64>,
    skipped: u32,
    bytes: usize,
    encoding: String,
}

#[derive(Serialize)]
struct Outcome {
    sent: usize,
    received_frames: Vec<ReceivedFrame>,
    urgent_sent: u32,
    /// Delay of each urgent message that arrived.
    urgent_ms: Vec<f64>,
    /// State of the stream at the end of the measurement.
    status: rect::StreamStatus,
    /// Mean time for encoding a frame.
    encode_ms: f64,
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let argument = std::env::args()
        .nth(1)
        .ok_or("the argument with the task is missing")?;
    let task: Task = serde_json::from_str(&argument)?;
    let outcome = run(task).await?;
    println!("{}", serde_json::to_string(&outcome)?);
    Ok(())
}

async fn run(task: Task) -> Result<Outcome, Box<dyn Error>> {
    let (near, far) = (
        connect("wombat-1", &task.near).await?,
        connect("wombat-2", &task.far).await?,
    );
    let begun = Instant::now();
    let urgent_ms: Arc<Mutex<Vec<f64>>> = Arc::default();
    let ages_ms = urgent_ms.clone();
    let _urgent = far
        .on_message::<f64>("wombat-1/stop", move |message| {
            if let Ok(due_s) = message.value {
                let age_s = begun.elapsed().as_secs_f64() - due_s;
                ages_ms.lock().expect("not poisoned").push(age_s * 1000.0);
            }
        })
        .await?;
    let watch = far.watch("wombat-1/camera").await?;
    let options = match &task.codec {
        Some(_) => StreamOptions::fixed(f64::from(task.frames_per_s)),
        None if task.video => StreamOptions {
            max_frames_per_s: f64::from(task.frames_per_s),
            ..StreamOptions::video()
        },
        None => StreamOptions {
            max_frames_per_s: f64::from(task.frames_per_s),
            lossy_format: match task.lossy_format.as_str() {
                "webp" => LossyFormat::Webp,
                _ => LossyFormat::Jpeg,
            },
            ..StreamOptions::default()
        },
    };
    let stream = Arc::new(near.stream("camera", options).await?);
    // Waits until the sender has discovered the receiver, which is not measured.
    while stream.send(vec![0u8; 1])? == 0 {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    // Opens the urgency session before the measurement. The receiver ignores this message, because it is not a number.
    near.urgent().publish("stop", "").await?;
    tokio::time::sleep(Duration::from_secs(1)).await;

    let ended = Arc::new(AtomicBool::new(false));
    let urgent = tokio::spawn(send_urgent(near.urgent(), begun, ended.clone()));
    let started = Instant::now();
    let (camera_stream, camera_ended) = (stream.clone(), ended.clone());
    let (seconds, frames) = (task.seconds, task.frames.clone());
    let camera = thread::spawn(move || {
        camera(&task, &camera_stream, &camera_ended).map_err(|error| error.to_string())
    });
    let mut received = Vec::new();
    let duration = Duration::from_secs(seconds);
    while started.elapsed() < duration {
        let remaining = duration.saturating_sub(started.elapsed());
        if let Ok(Some(frame)) = tokio::time::timeout(remaining, watch.next()).await {
            let at = Instant::now();
            let mut frame = frame;
            if frame.number % EXAMINED != 0 {
                // Of the others, only the numbers are kept.
                frame.payload.bytes = bytes::Bytes::new();
            }
            received.push((at, frame));
        }
    }
    let status = stream.status();
    ended.store(true, Ordering::Relaxed);
    let (sent, encode_ms) = camera.join().map_err(|_| "the camera panicked")??;
    let urgent_sent = urgent.await?;
    tokio::time::sleep(DRAIN_TIME).await;

    let mut received_frames = Vec::new();
    for (at, frame) in received {
        // The first frame was the byte sent for discovery.
        let Some(&(index, sent_at)) = (frame.number as usize)
            .checked_sub(1)
            .and_then(|n| sent.get(n))
        else {
            continue;
        };
        if !frame.payload.bytes.is_empty() {
            fs::write(frames.join(index.to_string()), &frame.payload.bytes)?;
        }
        received_frames.push(ReceivedFrame {
            number: frame.number,
            index,
            at_s: at.duration_since(started).as_secs_f64(),
            age_ms: at.duration_since(sent_at).as_secs_f64() * 1000.0,
            reported_age_ms: frame.age.map(|age| age.as_secs_f64() * 1000.0),
            skipped: frame.skipped,
            bytes: frame.sent_bytes,
            encoding: frame.payload.encoding.to_string(),
        });
    }
    let urgent_ms = urgent_ms.lock().expect("not poisoned").clone();
    Ok(Outcome {
        sent: sent.len(),
        received_frames,
        urgent_sent,
        urgent_ms,
        status,
        encode_ms,
    })
}

async fn connect(name: &str, router: &str) -> Result<Robot, rect::Error> {
    Options::new(name)?
        .login_file("/none")
        .router(router)
        .connect()
        .await
}

async fn send_urgent(robot: Robot, begun: Instant, ended: Arc<AtomicBool>) -> u32 {
    let mut ticks = tokio::time::interval(URGENT_INTERVAL);
    let mut sent = 0;
    while !ended.load(Ordering::Relaxed) {
        let due = ticks.tick().await.into_std();
        let due_s = due.duration_since(begun).as_secs_f64();
        if robot.publish("stop", rect::Json(due_s)).await.is_ok() {
            sent += 1;
        }
    }
    sent
}

type Sent = Vec<(u32, Instant)>;

/// Sends frames until `ended` is set. Returns the index and time of each frame that was sent, and the mean time for encoding a
/// frame, in milliseconds.
fn camera(
    task: &Task,
    stream: &StreamSender,
    ended: &AtomicBool,
) -> Result<(Sent, f64), Box<dyn Error>> {
    let panorama = fs::read(&task.panorama)?;
    let codec = task.codec.as_deref().map(codec::parse).transpose()?;
    let (started, mut sent, mut encoding_time) = (Instant::now(), Vec::new(), Duration::ZERO);
    for index in 0.. {
        let due = started + Duration::from_secs(1) * index / task.frames_per_s;
        thread::sleep(due.saturating_duration_since(Instant::now()));
        if ended.load(Ordering::Relaxed) {
            break;
        }
        let clean = view(&panorama, task, index)?;
        let [width, height] = task.size;
        let picture = Picture::new(width, height, Format::Rgb8, noisy(&clean, index))?;
        let taken = Instant::now();
        let groups = match &codec {
            Some(codec) => stream.send_with(1, |_| Ok(codec.encode(&picture.to_payload()?)?))?,
            None => stream.send_picture(&picture)?,
        };
        if groups > 0 {
            encoding_time += taken.elapsed();
            sent.push((index, taken));
            if sent.len() as u32 % EXAMINED == 0 {
                fs::write(task.frames.join(format!("{index}.clean")), &clean)?;
            }
        }
    }
    let mean_ms = encoding_time.as_secs_f64() * 1000.0 / sent.len().max(1) as f64;
    Ok((sent, mean_ms))
}

/// Returns what the camera sees: a part of the panorama, which moves back and forth by 3 pixels per frame horizontally and 2
/// vertically. In a moving scene, two things nearer to the camera move faster and in other directions, and the light changes.
fn view(panorama: &[u8], task: &Task, index: u32) -> Result<Vec<u8>, Box<dyn Error>> {
    let [wide, high] = task.panorama_size;
    let [width, height] = task.size;
    let (left, top) = (
        back_and_forth(index * 3, wide - width),
        back_and_forth(index * 2, high - height),
    );
    let mut pixels = Vec::with_capacity((width * height * 3) as usize);
    for row in top..top + height {
        let start = ((row * wide + left) * 3) as usize;
        let part = panorama.get(start..start + (width * 3) as usize);
        pixels.extend_from_slice(part.ok_or("the panorama is smaller than panorama_size")?);
    }
    if task.moves {
        for (step, side) in [([7, 1], height / 3), ([2, 9], height / 4)] {
            let at = [
                back_and_forth(index * step[0], width - side),
                back_and_forth(index * step[1], height - side),
            ];
            paste(&mut pixels, width, panorama, wide, at, side);
        }
        let seconds = f64::from(index) / f64::from(task.frames_per_s);
        let light = 0.85 + 0.15 * (seconds * 0.42).sin();
        for value in &mut pixels {
            *value = (f64::from(*value) * light) as u8;
        }
    }
    Ok(pixels)
}

fn back_and_forth(distance: u32, range: u32) -> u32 {
    match range {
        0 => 0,
        range => range.abs_diff(distance % (range * 2)),
    }
}

/// Covers a disc of the picture with the beginning of the panorama.
fn paste(pixels: &mut [u8], width: u32, panorama: &[u8], wide: u32, at: [u32; 2], side: u32) {
    let radius = f64::from(side) / 2.0;
    for (x, y) in (0..side * side).map(|n| (n % side, n / side)) {
        if (f64::from(x) - radius).hypot(f64::from(y) - radius) < radius {
            let to = (((at[1] + y) * width + at[0] + x) * 3) as usize;
            let start = ((y * wide + x) * 3) as usize;
            pixels[to..to + 3].copy_from_slice(&panorama[start..start + 3]);
        }
    }
}

/// Adds the noise of a sensor.
fn noisy(pixels: &[u8], index: u32) -> Vec<u8> {
    let mut random = index.wrapping_mul(2_654_435_761) | 1;
    let noise = |value: &u8| {
        random ^= random << 13;
        random ^= random >> 17;
        random ^= random << 5;
        let noise = (random % (2 * NOISE as u32 + 1)) as i16 - NOISE;
        (i16::from(*value) + noise).clamp(0, 255) as u8
    };
    pixels.iter().map(noise).collect()
}
