//! Owns `rect transfer`: files of any size, to another robot and from it.
use std::{
    fmt,
    path::PathBuf,
    process::ExitCode,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use clap::{Args, Subcommand};
use indicatif::{HumanBytes, ProgressBar, ProgressState, ProgressStyle};
use rect::{
    core::{display::line, transfer::Progress, wording::duration},
    Name, Pattern, ReceiveTransfers, Topic,
};

use crate::{
    report,
    session::{name, JoinArguments},
    span::Span,
    Done,
};

/// A transfer without progress for so long is shown as standing still.
const STALLED_AFTER: Duration = Duration::from_secs(3);
/// How often the bar is drawn while nothing arrives.
const TICK: Duration = Duration::from_millis(500);

/// Files of any size, over a link that may come and go.
#[derive(Args)]
pub struct TransferArguments {
    #[command(subcommand)]
    command: TransferCommand,
}

#[derive(Subcommand)]
enum TransferCommand {
    /// Send a file; goes on after a cut or a restart, and ends when the other robot has it, whole
    Send {
        /// To whom
        #[arg(value_parser = name)]
        robot: Name,
        /// Which file
        file: PathBuf,
        /// About what
        #[arg(long, default_value = "files")]
        topic: Topic,
        /// Give up when nothing has gone for so long [default: never]
        #[arg(long)]
        patience: Option<Span>,
        #[command(flatten)]
        join: JoinArguments,
    },
    /// Take the files that are sent to this robot, until Ctrl-C
    Receive {
        /// Whose, and about what
        #[arg(default_value = "*/files")]
        pattern: Pattern,
        /// Where to; each sender has a folder of its own in it
        #[arg(long, default_value = ".")]
        folder: PathBuf,
        /// The largest that is taken, in bytes
        #[arg(long, default_value_t = 1 << 30)]
        max_bytes: u64,
        #[command(flatten)]
        join: JoinArguments,
    },
}

/// `rect transfer`.
pub async fn run(arguments: TransferArguments) -> Done {
    match arguments.command {
        TransferCommand::Send {
            robot: to,
            file,
            topic,
            patience,
            join,
        } => {
            let robot = join.join().await?;
            let bar = bar();
            let shown = bar.clone();
            let mut transfer = robot
                .transfer(&to, &topic, file.as_path())?
                .on_progress(move |progress| show(&shown, progress));
            if let Some(Span(patience)) = patience {
                transfer = transfer.patience(patience);
            }
            transfer.await?;
            bar.finish();
            rect::outln!("{to} has {}", file.display());
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
            let options = ReceiveTransfers::in_folder(&folder, max_bytes)
                .on_progress(move |_, progress| show(&shown, progress));
            let transfers = robot.receive_transfers(&pattern, options).await?;
            let (me, place) = (robot.name(), folder.display());
            rect::errln!("rect: {me} takes files into {place}; Ctrl-C ends this");
            // No end after so many: a sender asks whether all is there, and this is to answer.
            while let Some(received) = transfers.next().await {
                match received {
                    Ok(received) => {
                        let (from, name, size) =
                            (&received.from, &received.name, received.size_bytes);
                        bar.suspend(|| rect::outln!("{} of {from}, {size} bytes", line(name)));
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
            // Writing to the bar's line cannot fail.
            let _ = text.write_str(&said(stalled, state.per_sec(), state.eta()));
        },
    );
    let bar = ProgressBar::new(0).with_style(style);
    bar.enable_steady_tick(TICK);
    bar
}

/// How long a transfer has been standing still.
#[derive(Default)]
struct Pace(Option<(u64, Instant)>);

impl Pace {
    /// Takes the position at `now`; returns for how long it has not changed, if that is long.
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

/// The rate and the time left, or that nothing moves.
fn said(stalled: Option<Duration>, bytes_per_s: f64, left: Duration) -> String {
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
    bar.set_position(progress.held_bytes);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stalled_transfer_promises_no_end() {
        let mut pace = Pace::default();
        let start = Instant::now();
        let at = |ms| start + Duration::from_millis(ms);
        assert_eq!(pace.on_position(at(0), 10), None);
        assert_eq!(pace.on_position(at(2900), 10), None);
        let stalled = pace.on_position(at(4000), 10);
        assert_eq!(stalled, Some(Duration::from_secs(4)));
        let shown = said(stalled, 1000.0, Duration::from_secs(13));
        assert_eq!(shown, "no progress for 4 s");
        assert_eq!(pace.on_position(at(5000), 11), None, "it goes on");
        assert!(said(None, 1000.0, Duration::from_secs(13)).ends_with("13 s left"));
    }
}
