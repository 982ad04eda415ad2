//! Implements `rect stream`, which receives a stream, or sends pictures as a stream.
use std::{fs, path::PathBuf, process::ExitCode, time::Duration};

use clap::{Args, Subcommand};
use rect::{
    core::{codec::Limits, picture::Picture},
    terminal, Encoding, Frame, Name, Payload, StreamOptions, Topic,
};
use serde_json::{json, Value};
use tokio::time::{interval, MissedTickBehavior};

use crate::{
    display,
    session::{name, JoinArguments},
    Done, Failure,
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
        /// The robot
        #[arg(value_parser = name)]
        robot: Name,
        /// The topic of the stream, such as camera
        topic: Topic,
        /// Write the newest frame to this file
        #[arg(long, value_name = "FILE")]
        output: Option<PathBuf>,
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
        #[command(flatten)]
        join: JoinArguments,
    },
}

/// Runs `rect stream`.
pub async fn run(arguments: StreamArguments) -> Done {
    match arguments.command {
        StreamCommand::Watch {
            robot: sender,
            topic,
            output,
            count,
            json,
            join,
        } => {
            let robot = join.join().await?;
            let watch = robot.watch(&sender, &topic).await?;
            let mut left = count.unwrap_or(u64::MAX);
            while left > 0 {
                let Some(frame) = watch.next().await else {
                    break;
                };
                left -= 1;
                if let Some(file) = &output {
                    replace(file, &frame.payload)?;
                }
                if json {
                    terminal::json_line(&as_json(&frame))?;
                } else {
                    rect::outln!("{}", as_text(&frame));
                }
            }
            Ok(ExitCode::SUCCESS)
        }
        StreamCommand::Send {
            topic,
            pictures,
            rate,
            join,
        } => {
            let every = Duration::try_from_secs_f64(1.0 / rate)
                .ok()
                .filter(|every| !every.is_zero())
                .ok_or("--rate must be a number of pictures per second, such as 10")?;
            let pictures: Vec<Picture> = pictures.iter().map(picture).collect::<Result<_, _>>()?;
            let robot = join.join().await?;
            let stream = robot.stream(&topic, StreamOptions::default()).await?;
            rect::errln!(
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
    let (number, skipped) = (frame.number, frame.skipped);
    format!(
        "{number}, {age}, {skipped} skipped: {}",
        display::text(&frame.payload)
    )
}

fn as_json(frame: &Frame) -> Value {
    json!({
        "number": frame.number,
        "age_ms": frame.age.map(|age| age.as_millis() as u64),
        "skipped": frame.skipped,
        "encoding": frame.payload.encoding.as_str(),
        "bytes": frame.payload.bytes.len(),
    })
}

/// Replaces a file in one step, so that a viewer never reads half a picture.
fn replace(file: &PathBuf, payload: &Payload) -> Result<(), Failure> {
    let new_file = file.with_extension("new");
    let named = |error: std::io::Error| format!("{}: {error}", file.display());
    fs::write(&new_file, &payload.bytes).map_err(named)?;
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
