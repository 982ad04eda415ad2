//! Implements `rect stream`, which receives a stream, or sends pictures as a stream.
use std::{
    fs,
    path::PathBuf,
    process::ExitCode,
    time::{Duration, Instant},
};

use clap::{Args, Subcommand};
use rect::{
    Encoding, EncodingKind, Frame, Payload, QueueOptions, RobotTopic, StreamOptions, Topic,
    Watcher, WhenFull,
};
use rect_core::codec::{jpeg::Jpeg, picture::Picture, Codec, Limits};
use rect_recording::video_file::VideoFile;
use rect_terminal as terminal;
use serde_json::{json, Value};
use tokio::time::{interval, MissedTickBehavior};

use crate::{display, session::JoinArguments, Done, Failure};

/// The quality of the pictures of a video that are written to a file.
const QUALITY: u8 = 85;
/// A saved video needs every frame: those of some seconds may wait for the disk.
const EVERY_FRAME: QueueOptions = QueueOptions {
    capacity: 600,
    when_full: WhenFull::DropOldest,
};

/// Receive and send streams of frames, of which only the newest matters
#[derive(Args)]
pub struct StreamArguments {
    #[command(subcommand)]
    command: StreamCommand,
}

#[derive(Subcommand)]
enum StreamCommand {
    /// Print the frames of a robot's stream, until Ctrl-C
    Watch {
        /// The robot and the topic of the stream, such as wombat-2/camera
        #[arg(value_name = "ROBOT/TOPIC")]
        stream: RobotTopic,
        /// Write the newest frame to this file; one of a video as JPEG
        #[arg(long, value_name = "FILE")]
        output: Option<PathBuf>,
        /// Save the video to this file, which ends in .mkv
        #[arg(long, value_name = "FILE", conflicts_with = "output")]
        save: Option<PathBuf>,
        /// Exit after this number of frames
        #[arg(long)]
        count: Option<u64>,
        /// Print a line of JSON for each frame
        #[arg(long)]
        json: bool,
        #[command(flatten)]
        join: JoinArguments,
    },
    /// Send pictures as a stream in an endless loop, until Ctrl-C; size and quality adapt to the throughput of the link
    Send {
        /// The topic of the stream, such as camera
        topic: Topic,
        /// The pictures: .png, .jpg or .webp files
        #[arg(required = true)]
        pictures: Vec<PathBuf>,
        /// Pictures per second
        #[arg(long, default_value_t = 10.0)]
        rate: f64,
        /// Send them as video, in which each frame contains only what differs from the one before
        #[arg(long)]
        video: bool,
        #[command(flatten)]
        join: JoinArguments,
    },
}

/// Runs `rect stream`.
pub async fn run(arguments: StreamArguments) -> Done {
    match arguments.command {
        StreamCommand::Watch {
            stream,
            output,
            save,
            count,
            json,
            join,
        } => {
            let mut video = save.map(VideoFile::new).transpose()?;
            let robot = join.join().await?;
            let watch = match &video {
                Some(_) => {
                    let watch = robot.watch_with(&stream, EVERY_FRAME).await?;
                    watch.undecoded()
                }
                None => robot.watch(&stream).await?,
            };
            let began = Instant::now();
            let mut left = count.unwrap_or(u64::MAX);
            while left > 0 {
                let Some(frame) = next_or_stop(&watch).await? else {
                    break;
                };
                left -= 1;
                if let Some(file) = &output {
                    replace(file, &frame.payload)?;
                }
                if let Some(video) = &mut video {
                    save_frame(video, &frame, began)?;
                }
                if json {
                    terminal::json_line(&as_json(&frame))?;
                } else {
                    rect_terminal::outln!("{}", as_text(&frame));
                }
            }
            if let Some(video) = &video {
                let (frames, files) = video.written();
                rect_terminal::errln!("rect: saved {frames} frames in {files} files");
            }
            Ok(ExitCode::SUCCESS)
        }
        StreamCommand::Send {
            topic,
            pictures,
            rate,
            video,
            join,
        } => {
            let every = Duration::try_from_secs_f64(1.0 / rate)
                .ok()
                .filter(|every| !every.is_zero())
                .ok_or("--rate must be a number of pictures per second, such as 10")?;
            let pictures: Vec<Picture> = pictures.iter().map(picture).collect::<Result<_, _>>()?;
            let options = match video {
                true => StreamOptions::video(),
                false => StreamOptions::default(),
            };
            let robot = join.join().await?;
            let stream = robot.stream(&topic, options).await?;
            rect_terminal::errln!(
                "rect: sending; receive it with `rect stream watch {} {topic}`; press Ctrl-C to exit",
                robot.name()
            );
            let mut ticks = interval(every);
            ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
            for picture in pictures.iter().cycle() {
                ticks.tick().await;
                tokio::task::block_in_place(|| stream.send_picture(picture))?;
            }
            Ok(ExitCode::SUCCESS)
        }
    }
}

fn as_text(frame: &Frame) -> String {
    let age = frame.age.map_or("age unknown".to_owned(), |age| {
        format!("{} ms old", age.as_millis())
    });
    let number = frame.number;
    let missing = match (frame.skipped, frame.lost) {
        (skipped, 0) => format!("{skipped} skipped"),
        (skipped, lost) => format!("{skipped} skipped ({lost} lost)"),
    };
    let is_decoded = frame.sent_bytes != frame.payload.bytes.len();
    let decoded = is_decoded.then(|| frame.payload.picture(&Limits::default()));
    let shown = match decoded {
        Some(Ok(picture)) => display::picture(&picture, "video", frame.sent_bytes),
        _ => display::text(&frame.payload),
    };
    format!("{number}, {age}, {missing}: {shown}")
}

fn as_json(frame: &Frame) -> Value {
    json!({
        "number": frame.number,
        "age_ms": frame.age.map(|age| age.as_millis() as u64),
        "skipped": frame.skipped,
        "lost": frame.lost,
        "encoding": frame.payload.encoding.as_str(),
        "bytes": frame.sent_bytes,
    })
}

/// Waits for the next frame. Returns `None` after Ctrl-C, or if the session is closed.
async fn next_or_stop(watch: &Watcher) -> Result<Option<Frame>, Failure> {
    tokio::select! {
        frame = watch.next() => Ok(frame),
        stopped = tokio::signal::ctrl_c() => Ok(stopped.map(|()| None)?),
    }
}

/// Adds a frame to a video, at the time when it was taken.
fn save_frame(video: &mut VideoFile, frame: &Frame, began: Instant) -> Result<(), Failure> {
    if frame.payload.encoding.kind() != EncodingKind::H264 {
        let kind = &frame.payload.encoding;
        return Err(format!(
            "the stream is not a video, but {kind}: create it with the mode `video`, or use --output"
        )
        .into());
    }
    if frame.skipped > 0 {
        video.on_gap();
    }
    let taken = began
        .elapsed()
        .saturating_sub(frame.age.unwrap_or_default());
    Ok(video.add(&frame.payload.bytes, taken)?)
}

/// Replaces a file in one step, so that a viewer never reads half a picture.
fn replace(file: &PathBuf, payload: &Payload) -> Result<(), Failure> {
    let new_file = file.with_extension("new");
    let named = |error: std::io::Error| format!("{}: {error}", file.display());
    // Only a raw payload is decoded here: a picture in another form is written as it is.
    let is_raw = payload.encoding.kind() == EncodingKind::Raw;
    let bytes = match is_raw && payload.picture(&Limits::default()).is_ok() {
        true => Jpeg::new(QUALITY).encode(payload)?.bytes,
        false => payload.bytes.clone(),
    };
    fs::write(&new_file, &bytes).map_err(named)?;
    Ok(fs::rename(&new_file, file).map_err(named)?)
}

/// Reads a picture from a file, whose extension determines the format.
fn picture(file: &PathBuf) -> Result<Picture, Failure> {
    let bytes = fs::read(file).map_err(|error| format!("{}: {error}", file.display()))?;
    let encoding = match file.extension().and_then(|end| end.to_str()) {
        Some("png") => Encoding::PNG,
        Some("jpg" | "jpeg") => Encoding::JPEG,
        Some("webp") => Encoding::WEBP,
        _ => {
            let problem = "not a picture; .png, .jpg and .webp files are supported";
            return Err(format!("{}: {problem}", file.display()).into());
        }
    };
    let decoded = Payload::new(bytes, encoding).picture(&Limits::default());
    Ok(decoded.map_err(|error| format!("{}: {error}", file.display()))?)
}
