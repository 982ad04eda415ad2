//! Implements `rect record`.
use std::{
    collections::BTreeMap,
    path::PathBuf,
    process::ExitCode,
    sync::Arc,
    time::{Duration, SystemTime},
};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use rect::{
    core::{display::line, humanize},
    recording::{file::COMPLETE, Progress, Recorder, Settings},
    Pattern, QueueOptions, Robot, Subscriber,
};
use tokio::{
    signal::unix::{signal, SignalKind},
    task::JoinSet,
    time::{interval, sleep},
};

use crate::{clock, duration::DurationArgument, runtime, session::JoinArguments, Done, Failure};

/// How many messages wait for the recorder at most, for each pattern.
const QUEUE: usize = 4096;
/// Interval at which the number of messages is shown.
const SHOWN_EVERY: Duration = Duration::from_millis(500);

/// Record messages to an MCAP file, until Ctrl-C
///
/// While it runs, the recording is a folder of short files, of which a power cut damages only the last one. `rect
/// recording merge` makes a file of such a folder. Foxglove, Lichtblick and other viewers of MCAP open the file.
#[derive(Args)]
pub struct RecordArguments {
    /// The messages to record, <robot>/<topic> with wildcards [default: everything that this robot publishes]
    patterns: Vec<Pattern>,
    /// The file [default: <robot>-<date>-<time>.mcap]
    #[arg(short, long, value_name = "FILE", value_parser = recording_path)]
    output: Option<PathBuf>,
    /// Stop after this time, such as 10m
    #[arg(long = "for", value_name = "DURATION")]
    duration: Option<DurationArgument>,
    /// Keep only about this much of the past, such as 5m
    #[arg(long, value_name = "DURATION")]
    keep: Option<DurationArgument>,
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
    let patterns = patterns(&robot, arguments.patterns)?;
    let path = arguments.output.unwrap_or_else(|| {
        let now = clock::file_name(SystemTime::now());
        format!("{}-{now}.mcap", robot.name()).into()
    });
    let recorder = Recorder::start(Settings {
        path: path.clone(),
        about: about(&robot, &patterns),
        keep: arguments.keep.map(|keep| keep.0),
    })?;
    let recorder = Arc::new(recorder);
    let mut subscribers = Vec::new();
    let mut tasks = JoinSet::new();
    for pattern in &patterns {
        let subscriber = Arc::new(robot.subscribe_with(pattern, queue()).await?);
        subscribers.push(subscriber.clone());
        tasks.spawn(forward(subscriber, recorder.clone()));
    }
    let names: Vec<_> = patterns.iter().map(Pattern::to_string).collect();
    rect::errln!(
        "rect: recording {} to {}; press Ctrl-C to stop",
        line(&names.join(", ")),
        path.display()
    );
    tokio::select! {
        _ = interrupted.recv() => {}
        _ = terminated.recv() => {}
        _ = ended(arguments.duration) => {}
        // The connection to the router has ended.
        _ = tasks.join_next() => rect::errln!("rect: the router has ended the connection"),
        () = show(&recorder) => {}
    }
    tasks.shutdown().await;
    let unread: u64 = subscribers
        .iter()
        .map(|subscriber| subscriber.dropped())
        .sum();
    drop(subscribers);
    let recorder = Arc::into_inner(recorder).ok_or("the recorder is still in use")?;
    let finished = tokio::task::spawn_blocking(|| recorder.finish()).await?;
    let (path, progress) = finished?;
    if progress.written == 0 {
        rect::errln!("rect: there is no recording: {}", text(&progress, unread));
        return Ok(ExitCode::FAILURE);
    }
    rect::outln!("{}: {}", path.display(), text(&progress, unread));
    Ok(ExitCode::SUCCESS)
}

fn queue() -> QueueOptions {
    QueueOptions {
        capacity: QUEUE,
        ..QueueOptions::default()
    }
}

/// Returns what to record: the patterns, or everything that the robot publishes.
fn patterns(robot: &Robot, given: Vec<Pattern>) -> Result<Vec<Pattern>, Failure> {
    let own = robot.name();
    if given.is_empty() {
        return Ok(vec![Pattern::of(Some(own.clone()), "**")?]);
    }
    if given.iter().any(|pattern| pattern.robot() != Some(own)) {
        rect::errln!(
            "rect: messages of other robots travel over their links to this robot only because they are recorded here. \
             Record on each robot if the links are slow"
        );
    }
    Ok(given)
}

fn about(robot: &Robot, patterns: &[Pattern]) -> BTreeMap<String, String> {
    let patterns: Vec<_> = patterns.iter().map(Pattern::to_string).collect();
    [
        ("robot", robot.name().to_string()),
        ("fleet", robot.fleet().to_string()),
        ("patterns", patterns.join(" ")),
        ("rect", env!("CARGO_PKG_VERSION").to_owned()),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into()
}

async fn forward(subscriber: Arc<Subscriber>, recorder: Arc<Recorder>) {
    while let Some(message) = subscriber.next().await {
        recorder.on_message(message);
    }
}

async fn ended(after: Option<DurationArgument>) {
    match after {
        Some(after) => sleep(after.0).await,
        None => std::future::pending().await,
    }
}

/// Shows how the recording goes, until the future is dropped.
async fn show(recorder: &Recorder) {
    let bar = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{elapsed} {msg}") {
        bar.set_style(style);
    }
    let mut tick = interval(SHOWN_EVERY);
    let mut known_problem = None;
    loop {
        tick.tick().await;
        let progress = recorder.progress();
        bar.set_message(text(&progress, 0));
        if progress.problem == known_problem {
            continue;
        }
        bar.suspend(|| match &progress.problem {
            Some(problem) => rect::errln!(
                "rect: the recording cannot be written: {problem}. Recording goes on, and continues to be written when there is \
                 room; what does not fit in memory until then is dropped, urgent messages last"
            ),
            None => rect::errln!("rect: the recording is written again"),
        });
        known_problem = progress.problem;
    }
}

fn text(progress: &Progress, unread: u64) -> String {
    let size = humanize::bytes(progress.bytes);
    let mut text = format!("{} messages, {size}", progress.written);
    let dropped = progress.dropped + unread;
    if dropped > 0 {
        text += &format!(", {dropped} dropped");
    }
    text
}
