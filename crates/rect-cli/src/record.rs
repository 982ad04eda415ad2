//! Implements `rect record`.
use std::{
    path::PathBuf,
    process::ExitCode,
    str::FromStr,
    time::{Duration, SystemTime},
};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use rect::{Name, Pattern, RecordOptions, RobotRecorder};
use rect_core::text::{display::line, humanize};
use rect_recording::{file::COMPLETE, Progress, Split};
use rect_terminal::clock;
use tokio::{
    signal::unix::{signal, SignalKind},
    time::{interval, sleep},
};

use crate::{duration::DurationArgument, runtime, session::JoinArguments, Done};

/// The units of sizes, in bytes.
const UNITS: [(&str, u64); 3] = [("kB", 1000), ("MB", 1_000_000), ("GB", 1_000_000_000)];
/// Interval at which the number of messages is shown.
const SHOWN_EVERY: Duration = Duration::from_millis(500);

/// Record messages to an MCAP file, until Ctrl-C
///
/// While it runs, the recording is a folder of short files, of which a power cut damages only the last one. `rect
/// recording merge` makes a file of such a folder. Foxglove, Lichtblick and other viewers of MCAP open the file.
#[derive(Args)]
pub struct RecordArguments {
    /// The messages to record, <robot>/<topic> with wildcards [default: everything that this robot publishes, and that is sent by it or to it]
    patterns: Vec<Pattern>,
    /// The file [default: <robot>-<date>-<time>.mcap]
    #[arg(short, long, value_name = "FILE", value_parser = recording_path)]
    output: Option<PathBuf>,
    /// Stop after this time, such as 10m
    #[arg(long = "for", value_name = "DURATION")]
    duration: Option<DurationArgument>,
    /// Keep only about this much of the past, such as 5m
    #[arg(long, value_name = "DURATION", conflicts_with = "split")]
    keep: Option<DurationArgument>,
    /// Continue in another file after this time or size, such as 10m or 500MB; may be given twice
    #[arg(long, value_name = "DURATION|SIZE")]
    split: Vec<SplitArgument>,
    /// Leave out the lines that the programs of the recorded robots log
    #[arg(long)]
    without_logs: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// Parses the name of a recording. The folder of its parts has the same name with another ending.
fn recording_path(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let is_complete = path.extension().is_some_and(|ending| ending == COMPLETE);
    is_complete
        .then_some(path)
        .ok_or_else(|| format!("a recording ends in .{COMPLETE}: write {text}.{COMPLETE}"))
}

/// Runs `rect record`.
pub fn run(arguments: RecordArguments) -> Done {
    rect::use_one_thread();
    let runtime = runtime()?;
    let done = runtime.block_on(record(arguments));
    runtime.shutdown_background();
    done
}

async fn record(arguments: RecordArguments) -> Done {
    // Before the first message is recorded, so that no signal ends the process without completing the file.
    let mut interrupted = signal(SignalKind::interrupt())?;
    let mut terminated = signal(SignalKind::terminate())?;
    // Without a robot there is nothing that is recorded by default.
    let robot = match arguments.patterns.is_empty() {
        true => arguments.join.join().await?,
        false => arguments.join.join_unnamed().await?,
    };
    warn_of_others(robot.name(), &arguments.patterns);
    let path = arguments.output.unwrap_or_else(|| {
        let now = clock::file_name(SystemTime::now());
        format!("{}-{now}.mcap", robot.name()).into()
    });
    let options = RecordOptions {
        patterns: arguments.patterns,
        keep: arguments.keep.map(|keep| keep.0),
        split: split(&arguments.split),
        without_logs: arguments.without_logs,
    };
    let mut recording = robot.record(&path, options).await?;
    rect_terminal::errln!(
        "rect: recording {} in {}; press Ctrl-C to stop",
        line(recording.patterns()),
        path.display()
    );
    tokio::select! {
        _ = interrupted.recv() => {}
        _ = terminated.recv() => {}
        _ = ended(arguments.duration) => {}
        () = show(&mut recording) => rect_terminal::errln!("rect: the router has ended the connection"),
    }
    let (files, progress) = recording.finish().await?;
    let text = text(&progress);
    match files.as_slice() {
        [] => {
            rect_terminal::errln!("rect: there is no recording: {text}");
            return Ok(ExitCode::FAILURE);
        }
        [file] => rect_terminal::outln!("{}: {text}", file.display()),
        [first, .., last] => {
            rect_terminal::outln!("{} to {}: {text}", first.display(), last.display())
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Warns of the cost of messages of other robots than `own`.
fn warn_of_others(own: &Name, patterns: &[Pattern]) {
    if patterns.iter().any(|pattern| pattern.robot() != Some(own)) {
        rect_terminal::errln!(
            "rect: messages and log lines of other robots travel over their links to this robot only because they are recorded here. \
             Record on each robot if the links are slow"
        );
    }
}

async fn ended(after: Option<DurationArgument>) {
    match after {
        Some(after) => sleep(after.0).await,
        None => std::future::pending().await,
    }
}

/// Shows how the recording goes, until the session has ended.
async fn show(recording: &mut RobotRecorder) {
    let bar = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{elapsed} {msg}") {
        bar.set_style(style);
    }
    let mut tick = interval(SHOWN_EVERY);
    let mut known_problem = None;
    loop {
        tokio::select! {
            _ = tick.tick() => {}
            () = recording.ended() => return,
        }
        let progress = recording.progress();
        bar.set_message(text(&progress));
        if progress.problem == known_problem {
            continue;
        }
        bar.suspend(|| match &progress.problem {
            Some(problem) => rect_terminal::errln!(
                "rect: the recording cannot be written: {problem}. Recording goes on, and continues to be written when there is \
                 room; what does not fit in memory until then is dropped, urgent messages last"
            ),
            None => rect_terminal::errln!("rect: the recording is written again"),
        });
        known_problem = progress.problem;
    }
}

fn text(progress: &Progress) -> String {
    let size = humanize::bytes(progress.bytes);
    let mut text = format!("{} messages, {size}", progress.written);
    if progress.dropped > 0 {
        text += &format!(", {} dropped", progress.dropped);
    }
    text
}

/// The time or the size after which a recording continues in another file.
#[derive(Clone, Copy, Debug)]
enum SplitArgument {
    After(Duration),
    Bytes(u64),
}

impl FromStr for SplitArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let size = UNITS.iter().find_map(|(unit, bytes)| {
            let number = text.strip_suffix(unit)?.trim_end().parse::<u32>().ok()?;
            Some(u64::from(number) * bytes)
        });
        if let Some(bytes) = size {
            return match bytes {
                0 => Err("a file has at least 1 kB".to_owned()),
                bytes => Ok(Self::Bytes(bytes)),
            };
        }
        let after = text.parse::<DurationArgument>().ok();
        after
            .filter(|after| !after.0.is_zero())
            .map(|after| Self::After(after.0))
            .ok_or_else(|| "write a time such as 10m, or a size such as 500MB".to_owned())
    }
}

fn split(arguments: &[SplitArgument]) -> Split {
    let mut split = Split::default();
    for argument in arguments {
        match *argument {
            SplitArgument::After(after) => split.after = Some(after),
            SplitArgument::Bytes(bytes) => split.bytes = Some(bytes),
        }
    }
    split
}
