//! Implements `rect recording fetch`, which copies a part of the recording that a robot makes.
use std::{
    io,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use rect::{Error, Name, Recorded};
use rect_core::text::humanize;
use rect_recording::{
    file::{About, OpenFile},
    Entry, RecorderError,
};
use tokio::time::sleep;

use crate::{
    duration::DurationArgument,
    session::{name, JoinArguments},
    Done, Failure,
};

/// The pause before a question is repeated.
const PAUSE: Duration = Duration::from_secs(1);
/// How long to repeat a question that no program answers, because the recorder has just begun.
const BEGUN_WITHIN: Duration = Duration::from_secs(2);
/// How often the progress is drawn.
const DRAWN_EVERY: Duration = Duration::from_millis(200);

/// Copy a part of the recording that a robot makes, such as the last ten seconds, to a file here
///
/// `rect record` runs there, or a program that records. If the link is lost, the copy continues when it is back.
#[derive(Args)]
pub struct FetchArguments {
    /// The robot that records
    #[arg(value_parser = name)]
    robot: Name,
    /// How much of the past
    #[arg(long, value_name = "DURATION", default_value = "1m")]
    last: DurationArgument,
    /// Without the newest part of this length, such as 20s [default: until now]
    #[arg(
        long,
        value_name = "DURATION",
        default_value = "0s",
        hide_default_value = true
    )]
    until: DurationArgument,
    /// Only these messages, <robot>/<topic> with wildcards [default: all, with events and links]
    #[arg(
        long = "topic",
        value_name = "PATTERN",
        default_value = "**",
        hide_default_value = true
    )]
    topics: String,
    /// The file to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// How long to wait for a link that is lost
    #[arg(long, value_name = "DURATION", default_value = "1m")]
    timeout: DurationArgument,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect recording fetch`.
pub async fn run(arguments: FetchArguments) -> Done {
    let (last, until) = (arguments.last.0, arguments.until.0);
    if until >= last {
        return Err("nothing is left: --until has to be shorter than --last".into());
    }
    let robot = arguments.join.join_unnamed().await?;
    let time = format!(
        "[now(-{}s)..now(-{}s)]",
        last.as_secs_f64(),
        until.as_secs_f64()
    );
    let mut recorded = robot.recorded(&arguments.robot, &arguments.topics, &time)?;
    let bar = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed} {msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(DRAWN_EVERY);
    let mut copy = Copy::default();
    let copied = copy.all(&mut recorded, &arguments, &bar).await;
    bar.finish_and_clear();
    let Copy { file, count, .. } = copy;
    let Some(file) = file else {
        copied?;
        return Err("nothing was recorded in this time".into());
    };
    let output = &arguments.output;
    file.finish()
        .map_err(|error| RecorderError::of_file(output, error))?;
    copied.map_err(|error| {
        format!(
            "{error}. {count} messages, the older part, are in {}",
            output.display()
        )
    })?;
    super::written(count, output)
}

/// The messages that were copied.
#[derive(Default)]
struct Copy {
    /// The file, which is created once there is something in it.
    file: Option<OpenFile>,
    count: u64,
    bytes: u64,
}

impl Copy {
    async fn all(
        &mut self,
        recorded: &mut Recorded,
        arguments: &FetchArguments,
        bar: &ProgressBar,
    ) -> Result<(), Failure> {
        while let Some(entries) = next(recorded, arguments.timeout.0, bar).await? {
            for entry in &entries {
                let added = self.add(entry, recorded.about(), &arguments.output);
                added.map_err(|error| RecorderError::of_file(&arguments.output, error))?;
            }
            let size = humanize::bytes(self.bytes);
            bar.set_message(format!("{} messages, {size}", self.count));
        }
        Ok(())
    }

    fn add(&mut self, entry: &Entry, about: &About, path: &Path) -> io::Result<()> {
        let file = match &mut self.file {
            Some(file) => file,
            None => self.file.insert(OpenFile::create(path.to_owned(), about)?),
        };
        self.count += u64::from(!entry.is_report());
        self.bytes += entry.payload.bytes.len() as u64;
        file.add(entry)
    }
}

/// Reads the next messages. Repeats the question while the robot cannot be reached, at most for `timeout`, and the first
/// question at most for [`BEGUN_WITHIN`].
async fn next(
    recorded: &mut Recorded,
    timeout: Duration,
    bar: &ProgressBar,
) -> Result<Option<Vec<Entry>>, Failure> {
    // At first, the robot may not record at all, or may just have begun.
    let ends = Instant::now()
        + match recorded.about().is_empty() {
            true => timeout.min(BEGUN_WITHIN),
            false => timeout,
        };
    loop {
        let error = match recorded.next().await {
            Ok(entries) => return Ok(entries),
            Err(error) => error,
        };
        let is_lost = matches!(error, Error::TimedOut { .. } | Error::NoService { .. });
        if !is_lost || Instant::now() >= ends {
            return Err(error.into());
        }
        bar.set_message(format!("asking again: {error}"));
        sleep(PAUSE).await;
    }
}
