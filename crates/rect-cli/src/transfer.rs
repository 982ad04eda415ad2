//! Implements `rect transfer`, which sends and receives files of any size.
use std::{
    fmt,
    path::PathBuf,
    process::ExitCode,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use clap::{Args, Subcommand};
use indicatif::{HumanBytes, ProgressBar, ProgressState, ProgressStyle};
use rect::{Name, Pattern, ReceiveOptions, Topic};
use rect_core::{
    text::{display::line, humanize::duration},
    transfer::Progress,
};

use crate::{
    duration::DurationArgument,
    report,
    session::{name, JoinArguments},
    Done,
};

/// Time without progress after which a transfer is shown as stalled.
const STALLED_AFTER: Duration = Duration::from_secs(3);
/// Interval at which the progress bar is drawn while there is no progress.
const TICK: Duration = Duration::from_millis(500);

/// Send and receive files of any size; transfers resume after a link is lost
#[derive(Args)]
pub struct TransferArguments {
    #[command(subcommand)]
    command: TransferCommand,
}

#[derive(Subcommand)]
enum TransferCommand {
    /// Send a file, and exit when the other robot has verified the whole content
    Send {
        /// The robot
        #[arg(value_parser = name)]
        robot: Name,
        /// The file
        file: PathBuf,
        /// The topic
        #[arg(long, default_value = "files")]
        topic: Topic,
        /// Give up after this time without any message from the receiver, or if its program takes no transfers [default: never]
        #[arg(long)]
        timeout: Option<DurationArgument>,
        #[command(flatten)]
        join: JoinArguments,
    },
    /// Receive the files that are sent to this robot, until Ctrl-C
    Receive {
        /// The senders and topics to accept, <robot>/<topic> with wildcards
        #[arg(default_value = "*/files")]
        pattern: Pattern,
        /// The folder for the files, in which each sender gets a separate folder
        #[arg(long, default_value = ".")]
        folder: PathBuf,
        /// The largest accepted file, in bytes
        #[arg(long, default_value_t = 1 << 30)]
        max_bytes: u64,
        #[command(flatten)]
        join: JoinArguments,
    },
}

/// Runs `rect transfer`.
pub async fn run(arguments: TransferArguments) -> Done {
    match arguments.command {
        TransferCommand::Send {
            robot: recipient,
            file,
            topic,
            timeout,
            join,
        } => {
            let robot = join.join().await?;
            let bar = bar();
            let shown = bar.clone();
            let mut transfer = robot
                .transfer(&recipient, &topic, file.as_path())?
                .on_progress(move |progress| show(&shown, progress));
            if let Some(DurationArgument(timeout)) = timeout {
                transfer = transfer.timeout(timeout);
            }
            transfer.await?;
            bar.finish();
            rect_terminal::outln!("{recipient} has received {}", file.display());
            robot.close().await?;
        }
        TransferCommand::Receive {
            pattern,
            folder,
            max_bytes,
            join,
        } => {
            let robot = join.join().await?;
            let bar = bar();
            let shown = bar.clone();
            let options = ReceiveOptions::in_folder(&folder, max_bytes)
                .on_progress(move |_, progress| show(&shown, progress));
            let transfers = robot.receive_transfers(&pattern, options).await?;
            let (me, folder) = (robot.name(), folder.display());
            rect_terminal::errln!("rect: {me} receives files into {folder}; press Ctrl-C to exit");
            // There is no `--count`: if the link is down when the last file is complete, its sender still needs the
            // outcome.
            while let Some(received) = transfers.next().await {
                match received {
                    Ok(received) => {
                        let (sender, name, size) =
                            (&received.sender, &received.name, received.size_bytes);
                        bar.suspend(|| {
                            rect_terminal::outln!("{} of {sender}, {size} bytes", line(name))
                        });
                    }
                    Err(error) => bar.suspend(|| report(&error)),
                }
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn bar() -> ProgressBar {
    let style = "{bar:30} {bytes} of {total_bytes}, {pace}";
    let style =
        ProgressStyle::with_template(style).unwrap_or_else(|_| ProgressStyle::default_bar());
    let pace = Arc::new(Mutex::new(Pace::default()));
    let style = style.with_key(
        "pace",
        move |state: &ProgressState, text: &mut dyn fmt::Write| {
            let mut pace = pace.lock().unwrap_or_else(PoisonError::into_inner);
            let stalled = pace.on_position(Instant::now(), state.pos());
            // Writing to the text of the bar cannot fail.
            let _ = text.write_str(&pace_text(stalled, state.per_sec(), state.eta()));
        },
    );
    let bar = ProgressBar::new(0).with_style(style);
    bar.enable_steady_tick(TICK);
    bar
}

/// Measures how long a transfer has been stalled.
#[derive(Default)]
struct Pace(Option<(u64, Instant)>);

impl Pace {
    /// Updates the position at `now`; returns the time without progress if it is at least [`STALLED_AFTER`].
    fn on_position(&mut self, now: Instant, position: u64) -> Option<Duration> {
        let since = match self.0 {
            Some((last, since)) if last == position => since,
            _ => now,
        };
        self.0 = Some((position, since));
        let stalled = now.saturating_duration_since(since);
        (stalled >= STALLED_AFTER).then_some(stalled)
    }
}

/// Returns the rate and the remaining time, or the time without progress.
fn pace_text(stalled: Option<Duration>, bytes_per_s: f64, left: Duration) -> String {
    match stalled {
        Some(stalled) => format!("no progress for {}", duration(stalled)),
        None => format!(
            "{}/s, {} left",
            HumanBytes(bytes_per_s as u64),
            duration(left)
        ),
    }
}

fn show(bar: &ProgressBar, progress: Progress) {
    bar.set_length(progress.size_bytes);
    bar.set_position(progress.received_bytes);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shows_no_remaining_time_while_stalled() {
        let mut pace = Pace::default();
        let start = Instant::now();
        let at = |ms| start + Duration::from_millis(ms);
        assert_eq!(pace.on_position(at(0), 10), None);
        assert_eq!(pace.on_position(at(2900), 10), None);
        let stalled = pace.on_position(at(4000), 10);
        assert_eq!(stalled, Some(Duration::from_secs(4)));
        let shown = pace_text(stalled, 1000.0, Duration::from_secs(13));
        assert_eq!(shown, "no progress for 4 s");
        assert_eq!(pace.on_position(at(5000), 11), None, "progress again");
        assert!(pace_text(None, 1000.0, Duration::from_secs(13)).ends_with("13 s left"));
    }
}
