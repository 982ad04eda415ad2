//! What `benches/stream.py` runs: a camera at one router, who watches at the other, and urgent messages from the camera's
//! program all the while. Both are in this process, so that one clock tells the ages.
//!
//!     stream_load '{"near": "tcp/...", "far": "tcp/...", "panorama": "file", "panorama_size": [1280, 960],
//!                   "size": [640, 480], "codec": null, "photographs": "jpeg", "seconds": 30, "frames": "folder"}'
//!
//! `panorama` is raw RGB; the camera pans over it, 15 times a second. `codec`: that of a fixed stream; null: adaptive.
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
    core::{
        codec,
        picture::{Format, Picture},
        stream::picture::Photographs,
    },
    Options, Robot, Stream, StreamOptions, ToPayload,
};
use serde::{Deserialize, Serialize};

const FRAMES_PER_S: u32 = 15;
const URGENT_EVERY: Duration = Duration::from_millis(50);
const STRAGGLERS: Duration = Duration::from_secs(2);

#[derive(Deserialize)]
struct Task {
    near: String,
    far: String,
    panorama: PathBuf,
    panorama_size: [u32; 2],
    size: [u32; 2],
    codec: Option<String>,
    photographs: String,
    seconds: u64,
    frames: PathBuf,
}

#[derive(Serialize)]
struct Seen {
    number: u32,
    /// Which of the camera's.
    index: u32,
    at_s: f64,
    age_ms: f64,
    told_ms: Option<f64>,
    skipped: u32,
    bytes: usize,
    encoding: String,
}

#[derive(Serialize)]
struct Outcome {
    sent: usize,
    seen: Vec<Seen>,
    urgent_sent: u32,
    urgent_ms: Vec<f64>,
    status: rect::core::stream::status::Status,
    encode_ms: f64,
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let given = std::env::args().nth(1).ok_or("the task is missing")?;
    let task: Task = serde_json::from_str(&given)?;
    let outcome = run(task).await?;
    println!("{}", serde_json::to_string(&outcome)?);
    Ok(())
}

async fn run(task: Task) -> Result<Outcome, Box<dyn Error>> {
    let (near, far) = (
        joined("wombat-1", &task.near).await?,
        joined("wombat-2", &task.far).await?,
    );
    let begun = Instant::now();
    let urgent_ms: Arc<Mutex<Vec<f64>>> = Arc::default();
    let heard = urgent_ms.clone();
    let _urgent = far
        .on_message("wombat-1/stop", move |message| {
            if let Ok(due_s) = message.payload.value::<f64>() {
                let age_s = begun.elapsed().as_secs_f64() - due_s;
                heard.lock().expect("not poisoned").push(age_s * 1000.0);
            }
        })
        .await?;
    let watch = far.watch("wombat-1", "camera").await?;
    let options = match &task.codec {
        Some(_) => StreamOptions::fixed(f64::from(FRAMES_PER_S)),
        None => StreamOptions {
            photographs: match task.photographs.as_str() {
                "webp" => Photographs::Webp,
                _ => Photographs::Jpeg,
            },
            ..StreamOptions::default()
        },
    };
    let stream = Arc::new(near.stream("camera", options).await?);
    // Discovery is not what is measured.
    while stream.send(vec![0u8; 1])? == 0 {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
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
    let whole = Duration::from_secs(seconds);
    while started.elapsed() < whole {
        let left = whole.saturating_sub(started.elapsed());
        if let Ok(Some(frame)) = tokio::time::timeout(left, watch.recv()).await {
            received.push((Instant::now(), frame));
        }
    }
    let status = stream.status();
    ended.store(true, Ordering::Relaxed);
    let (sent, encode_ms) = camera.join().map_err(|_| "the camera panicked")??;
    let urgent_sent = urgent.await?;
    tokio::time::sleep(STRAGGLERS).await;

    let mut seen = Vec::new();
    for (at, frame) in received {
        // The first was the one byte of discovery.
        let Some(&(index, sent_at)) = (frame.number as usize)
            .checked_sub(1)
            .and_then(|n| sent.get(n))
        else {
            continue;
        };
        fs::write(frames.join(index.to_string()), &frame.payload.bytes)?;
        seen.push(Seen {
            number: frame.number,
            index,
            at_s: at.duration_since(started).as_secs_f64(),
            age_ms: at.duration_since(sent_at).as_secs_f64() * 1000.0,
            told_ms: frame.age.map(|age| age.as_secs_f64() * 1000.0),
            skipped: frame.skipped,
            bytes: frame.payload.bytes.len(),
            encoding: frame.payload.encoding.to_string(),
        });
    }
    let urgent_ms = urgent_ms.lock().expect("not poisoned").clone();
    Ok(Outcome {
        sent: sent.len(),
        seen,
        urgent_sent,
        urgent_ms,
        status,
        encode_ms,
    })
}

async fn joined(name: &str, router: &str) -> Result<Robot, rect::Error> {
    Options::new(name)?
        .login_file("/none")
        .router(router)
        .connect()
        .await
}

async fn send_urgent(robot: Robot, begun: Instant, ended: Arc<AtomicBool>) -> u32 {
    let mut ticks = tokio::time::interval(URGENT_EVERY);
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

/// Each frame that went, by its index, and when it was taken; and the mean time of encoding, in milliseconds.
fn camera(task: &Task, stream: &Stream, ended: &AtomicBool) -> Result<(Sent, f64), Box<dyn Error>> {
    let panorama = fs::read(&task.panorama)?;
    let codec = task.codec.as_deref().map(codec::parse).transpose()?;
    let (started, mut sent, mut spent) = (Instant::now(), Vec::new(), Duration::ZERO);
    for index in 0.. {
        let due = started + Duration::from_secs(1) * index / FRAMES_PER_S;
        thread::sleep(due.saturating_duration_since(Instant::now()));
        if ended.load(Ordering::Relaxed) {
            break;
        }
        let picture = view(&panorama, task, index)?;
        let taken = Instant::now();
        let went = match &codec {
            Some(codec) => stream.send_with(1, |_| Ok(codec.encode(&picture.to_payload()?)?))?,
            None => stream.send_picture(&picture)?,
        };
        if went > 0 {
            spent += taken.elapsed();
            sent.push((index, taken));
        }
    }
    let mean_ms = spent.as_secs_f64() * 1000.0 / sent.len().max(1) as f64;
    Ok((sent, mean_ms))
}

/// The camera goes to and fro over the panorama, three pixels a frame sidewards, and two up or down.
fn view(panorama: &[u8], task: &Task, index: u32) -> Result<Picture, Box<dyn Error>> {
    let [wide, high] = task.panorama_size;
    let [width, height] = task.size;
    let to_and_fro = |step: u32, room: u32| match room {
        0 => 0,
        room => room.abs_diff(index * step % (room * 2)),
    };
    let (left, top) = (to_and_fro(3, wide - width), to_and_fro(2, high - height));
    let mut pixels = Vec::with_capacity((width * height * 3) as usize);
    for row in top..top + height {
        let from = ((row * wide + left) * 3) as usize;
        let part = panorama.get(from..from + (width * 3) as usize);
        pixels.extend_from_slice(part.ok_or("the panorama is smaller than it says")?);
    }
    Ok(Picture::new(width, height, Format::Rgb8, pixels)?)
}
