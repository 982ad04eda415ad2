//! Owns `rect transfer`: files of any size, to another robot and from it.
use std::{path::PathBuf, process::ExitCode};

use clap::{Args, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use rect::{core::transfer::Progress, Name, Pattern, ReceiveTransfers, Topic};

use crate::{
    session::{name, JoinArguments},
    span::Span,
    Done,
};

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
            println!("{to} has {}", file.display());
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
            eprintln!("rect: {me} takes files into {place}; Ctrl-C ends this");
            // No end after so many: a sender asks whether all is there, and this is to answer.
            while let Some(received) = transfers.next().await {
                match received {
                    Ok(received) => {
                        let (from, name, size) =
                            (&received.from, &received.name, received.size_bytes);
                        bar.suspend(|| println!("{name} of {from}, {size} bytes"));
                    }
                    Err(error) => bar.suspend(|| eprintln!("rect: {error}")),
                }
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn bar() -> ProgressBar {
    let style = "{bar:40} {bytes} of {total_bytes}, {bytes_per_sec}, {eta} left";
    let style = ProgressStyle::with_template(style);
    ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

fn show(bar: &ProgressBar, progress: Progress) {
    bar.set_length(progress.size_bytes);
    bar.set_position(progress.held_bytes);
}
