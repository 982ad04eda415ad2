//! Implements `rect log`, which shows what the programs of robots have logged.
mod print;
mod seen;

use std::{collections::BTreeSet, io::IsTerminal, process::ExitCode};

use clap::Args;
use indicatif::ProgressBar;
use rect::{KeptLine, Level, LogItem, LogOptions, Name};

use self::{
    print::{Printer, Selection},
    seen::Seen,
};
use crate::{
    duration::DurationArgument,
    session::{name, JoinArguments},
    Done,
};

const EXAMPLE: &str = "\
Examples:
  rect log wombat-2                                   # the last 100 lines of its programs, also of those that have ended
  rect log wombat-2 --program arm --level warn --follow
  rect log '*' --last 20                              # all robots
  rect log wombat-2 --json | jq .text

A router keeps the last 1,000 lines of each program, and 2 MB in all. Lines cross a link only while somebody reads them. If a
robot does not answer, the lines are shown that this computer has seen before.

Exit status: 0 if all robots have answered, 1 if not.";

/// Show what the programs of a robot have logged, also after their end
#[derive(Args)]
#[command(after_help = EXAMPLE)]
pub struct LogArguments {
    /// The robot; '*' for all [default: the robot of the router]
    robot: Option<String>,
    /// Only lines of this program
    #[arg(long, value_name = "PROGRAM", value_parser = name)]
    program: Option<Name>,
    #[command(flatten)]
    shown: ShownArguments,
}

/// Show what a program of a robot has logged, also after its end
#[derive(Args)]
pub struct ProgramLogArguments {
    /// The program
    #[arg(value_parser = name)]
    program: Name,
    /// The robot; '*' for all [default: the robot of the router]
    robot: Option<String>,
    #[command(flatten)]
    shown: ShownArguments,
}

/// Which lines are shown, and how.
#[derive(Args)]
struct ShownArguments {
    /// Only lines of this level and more important ones: debug, info, warn, error
    #[arg(long, value_name = "LEVEL", default_value = "debug")]
    level: Level,
    /// Only lines that contain this text, in upper or lower case
    #[arg(long, value_name = "TEXT")]
    text: Option<String>,
    /// The number of lines of each robot
    #[arg(long, value_name = "COUNT", default_value_t = 100)]
    last: usize,
    /// Continue with new lines, until Ctrl-C
    #[arg(long, short)]
    follow: bool,
    /// How long a robot may take to answer
    #[arg(long, value_name = "TIME", default_value = "10s")]
    timeout: DurationArgument,
    /// Print JSON, one line each
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect program log`.
pub async fn run_program(arguments: ProgramLogArguments) -> Done {
    let (robot, program) = (arguments.robot, Some(arguments.program));
    let shown = arguments.shown;
    run(LogArguments {
        robot,
        program,
        shown,
    })
    .await
}

/// Runs `rect log`.
pub async fn run(arguments: LogArguments) -> Done {
    let LogArguments {
        robot,
        program,
        shown: arguments,
    } = arguments;
    let own = arguments.join.join_unnamed().await?;
    let asked = robot.unwrap_or_else(|| own.name().to_string());
    let one = (asked != "*").then(|| Name::new(&asked)).transpose()?;
    let selection = Selection {
        program: program.clone(),
        level: arguments.level,
        text: arguments.text.as_ref().map(|text| text.to_lowercase()),
        last: arguments.last,
    };
    let mut reading = Reading {
        seen: Seen::of(own.fleet()),
        answered: BTreeSet::new(),
        history: Vec::new(),
        is_history_printed: false,
        printer: Printer::new(arguments.json, one.is_none(), selection),
        progress: progress(&asked),
    };
    let logs = own.logs(&asked, options(&arguments, program)).await?;
    let mut is_complete = true;
    loop {
        let item = tokio::select! {
            item = logs.next() => item,
            interrupted = tokio::signal::ctrl_c() => interrupted.map(|()| None)?,
        };
        match item {
            Some(LogItem::Complete) => {
                let peers = own.peers().await?;
                let mut silent = match &one {
                    Some(robot) => vec![robot.clone()],
                    None => peers.clone(),
                };
                silent.retain(|robot| !reading.answered.contains(robot));
                reading.print_history(&silent, &peers);
                is_complete = silent.is_empty();
            }
            Some(item) => reading.on_item(item),
            None => break,
        }
    }
    reading.seen.save();
    own.close().await?;
    Ok(ExitCode::from(u8::from(!is_complete)))
}

fn options(arguments: &ShownArguments, program: Option<Name>) -> LogOptions {
    let DurationArgument(timeout) = arguments.timeout;
    let options = LogOptions::new()
        .level(arguments.level)
        .last(arguments.last)
        .timeout(timeout);
    let options = match program {
        Some(program) => options.program(program),
        None => options,
    };
    if arguments.follow {
        options.follow()
    } else {
        options
    }
}

/// Shows on a terminal how many lines have arrived, since a radio link may take seconds.
fn progress(asked: &str) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let progress = ProgressBar::new_spinner();
    progress.enable_steady_tick(std::time::Duration::from_millis(200));
    progress.set_message(format!("reading the log of {asked}"));
    progress
}

/// The lines and answers that have arrived.
struct Reading {
    seen: Seen,
    answered: BTreeSet<Name>,
    /// The lines before, until all have arrived.
    history: Vec<(Name, KeptLine)>,
    is_history_printed: bool,
    printer: Printer,
    progress: ProgressBar,
}

impl Reading {
    fn on_item(&mut self, item: LogItem) {
        match item {
            LogItem::Lines {
                robot,
                lines,
                is_new,
            } => {
                self.seen.add(&robot, &lines);
                if !is_new {
                    self.answered.insert(robot.clone());
                    let count = self.history.len() + lines.len();
                    self.progress.set_message(format!("{count} lines"));
                }
                for kept in lines {
                    if self.is_history_printed {
                        self.printer.print(&robot, &kept);
                    } else {
                        self.history.push((robot.clone(), kept));
                    }
                }
            }
            LogItem::Complete => {}
            LogItem::Missed(robot) => rect_terminal::errln!(
                "rect log: lines of {robot} are missing: its programs log faster than the link carries"
            ),
        }
    }

    /// Prints the lines before in order, and what this computer has seen of the robots that have not answered.
    fn print_history(&mut self, silent: &[Name], reachable: &[Name]) {
        self.progress.finish_and_clear();
        self.is_history_printed = true;
        let mut history = std::mem::take(&mut self.history);
        // Of one robot by number, since its clock may jump; robots among each other by time.
        history.sort_by_key(|(_, kept)| kept.number);
        history.sort_by_key(|(robot, _)| robot.clone());
        if self.answered.len() > 1 {
            history.sort_by_key(|(_, kept)| kept.line.at);
        }
        for (robot, kept) in &history {
            self.printer.print(robot, kept);
        }
        for robot in silent {
            self.seen.print(robot, reachable, &self.printer);
        }
    }
}
