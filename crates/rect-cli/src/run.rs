//! Implements `rect run`, which runs a program and keeps what it writes, and why it ended.
mod end;
mod journal;
mod kept_output;
mod output;
mod restart;

use std::{
    io::IsTerminal,
    os::unix::process::ExitStatusExt,
    path::Path,
    process::{ExitCode, Stdio},
    sync::Arc,
    time::{Duration, Instant},
};

use clap::Args;
use rect::{Level, Name};
use rect_core::{
    catalogue::{program_name, PROGRAM_VARIABLE},
    session::{endpoint::ROUTER_VARIABLE, login::FILE_VARIABLE},
    text::humanize,
};
use rustix::process::{kill_process, Pid, Signal};
use serde_json::json;
use tokio::{
    process::{Child, Command},
    signal::unix::{signal, SignalKind},
};

use self::{
    end::End,
    journal::Journal,
    kept_output::{pass_on, KeptOutput, Stream},
    restart::{Pauses, Restart, SOUND_AFTER},
};
use crate::{
    duration::DurationArgument,
    session::{name, JoinArguments},
    Done, Failure,
};

/// How long the output of a program is read after its end. Programs that it has left behind may hold it open.
const OUTPUT_AFTER_END: Duration = Duration::from_millis(500);
const EXAMPLE: &str = "\
Examples:
  rect run -- python3 arm.py                        # the output stays on the terminal, and `rect log` shows it on the laptop
  rect run --restart on-failure -- ./drive          # starts it again 1 s after a crash, then 2 s, 4 s, at most 60 s
  rect run --name arm --private -- ./arm            # other robots cannot read its lines
  rect log wombat-1 --program arm                   # afterwards, from anywhere in the fleet

The program gets its name, the router and the login in RECT_PROGRAM, RECT_ENDPOINT and RECT_LOGIN, so that
`rect.connect` needs none of them. Ctrl-C and SIGTERM end the program; what is still running after --grace is killed.

Exit status: that of the program, or 128 and the number of the signal that ended it.";

/// Run a program, keep what it writes, and say why it ended
///
/// The router of this robot keeps the last 1,000 lines, also after the end of the program. Lines on the standard error have the level
/// warn. A program that fails raises an alert, which ends when it runs again.
#[derive(Args)]
#[command(after_help = EXAMPLE)]
pub struct RunArguments {
    /// The name of the program [default: that of the script or executable]
    #[arg(long, value_parser = name)]
    name: Option<Name>,
    /// When to start it again
    #[arg(long, value_enum, default_value_t = Restart::Never)]
    restart: Restart,
    /// Keep its lines on this robot: other robots cannot read them
    #[arg(long)]
    private: bool,
    /// How long it may take to end after SIGTERM
    #[arg(long, value_name = "TIME", default_value = "5s")]
    grace: DurationArgument,
    #[command(flatten)]
    join: JoinArguments,
    /// The program and its arguments
    #[arg(trailing_var_arg = true, required = true, value_name = "COMMAND")]
    command: Vec<String>,
}

/// Runs `rect run`.
pub async fn run(arguments: RunArguments) -> Done {
    let DurationArgument(grace) = arguments.grace;
    let program = match arguments.name {
        Some(name) => name,
        None => default_name(&arguments.command).ok_or(
            "the command has no name that other robots could know it by: give it one with --name, such as --name arm",
        )?,
    };
    let journal = Arc::new(Journal::open(
        arguments.join.clone(),
        program.clone(),
        arguments.private,
    ));
    let mut pauses = Pauses::default();
    let mut restarts = 0_u64;
    let mut stop = Stop::new()?;
    let status = loop {
        let mut command = Command::new(&arguments.command[0]);
        command
            .args(&arguments.command[1..])
            .env(PROGRAM_VARIABLE, program.as_str())
            .env(ROUTER_VARIABLE, arguments.join.router())
            .env(FILE_VARIABLE, arguments.join.login_file())
            // Otherwise Python keeps its output back, since it is not a terminal.
            .env("PYTHONUNBUFFERED", "1")
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let end = match command.spawn() {
            Ok(child) => {
                journal.report(
                    Level::Info,
                    start_text(restarts),
                    &[("pid", json!(child.id()))],
                );
                until_end(child, &journal, &mut stop, grace).await?
            }
            Err(error) => {
                let text = format!("cannot be started: {error}");
                journal.report(Level::Error, text.clone(), &[]);
                journal.alert(Some(format!("{program} {text}"))).await;
                close(journal).await;
                return Err(format!("{}: {error}", arguments.command[0]).into());
            }
        };
        let text = end.text();
        let level = if end.has_failed() {
            Level::Error
        } else {
            Level::Info
        };
        journal.report(level, text.clone(), &end.fields(restarts));
        if end.has_left_programs {
            let text = "it has left programs behind, whose output is no longer kept";
            journal.report(Level::Warn, text.to_owned(), &[]);
        }
        if end.has_failed() {
            rect_terminal::errln!("rect run: {program} {text}");
            journal.alert(Some(end.alert(&program, restarts))).await;
        } else {
            journal.alert(None).await;
        }
        if end.is_asked || !arguments.restart.applies(end.has_failed()) {
            break end.status;
        }
        let pause = pauses.after(end.ran);
        let text = format!("starts again in {}", humanize::duration(pause));
        rect_terminal::errln!("rect run: {program} {text}");
        journal.report(Level::Info, text, &[]);
        tokio::select! {
            () = tokio::time::sleep(pause) => {}
            _ = stop.next() => break end.status,
        }
        restarts += 1;
    };
    close(journal).await;
    let code = status.code().or(status.signal().map(|signal| 128 + signal));
    let code = code.and_then(|code| u8::try_from(code).ok());
    Ok(ExitCode::from(code.unwrap_or(u8::MAX)))
}

async fn close(journal: Arc<Journal>) {
    if let Some(journal) = Arc::into_inner(journal) {
        journal.close().await;
    }
}

fn start_text(restarts: u64) -> String {
    match restarts {
        0 => "started".to_owned(),
        1 => "started again".to_owned(),
        count => format!("started again, for the {count}th time"),
    }
}

/// Returns the name of the script, if the command is an interpreter, or that of the executable.
fn default_name(command: &[String]) -> Option<Name> {
    program_name(command.first()?)
        .filter(|name| !is_interpreter(name))
        .or_else(|| {
            let script = command[1..]
                .iter()
                .find(|argument| !argument.starts_with('-'))?;
            let stem = Path::new(script).file_stem()?.to_str()?;
            program_name(stem)
        })
}

fn is_interpreter(name: &Name) -> bool {
    matches!(
        name.as_str(),
        "node" | "bash" | "sh" | "env" | "uv" | "java" | "ruby"
    )
}

/// The signals that ask `rect run` to end.
struct Stop {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
}

impl Stop {
    fn new() -> Result<Self, Failure> {
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
        })
    }

    async fn next(&mut self) -> Signal {
        tokio::select! {
            _ = self.interrupt.recv() => Signal::INT,
            _ = self.terminate.recv() => Signal::TERM,
        }
    }
}

/// Waits for the end of a program, passes its output on and keeps it.
async fn until_end(
    mut child: Child,
    journal: &Arc<Journal>,
    stop: &mut Stop,
    grace: Duration,
) -> Result<End, Failure> {
    let began = Instant::now();
    let kept = Arc::new(KeptOutput::new(journal));
    let mut reading = Vec::new();
    if let Some(output) = child.stdout.take() {
        reading.push(pass_on(output, std::io::stdout(), &kept, Stream::Output));
    }
    if let Some(output) = child.stderr.take() {
        reading.push(pass_on(output, std::io::stderr(), &kept, Stream::Errors));
    }
    let sound = tokio::time::sleep(SOUND_AFTER);
    tokio::pin!(sound);
    let mut is_sound = false;
    let mut kill_at = None;
    let mut is_asked = false;
    let status = loop {
        let kill = async {
            match kill_at {
                Some(at) => tokio::time::sleep_until(at).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            status = child.wait() => break status?,
            asked = stop.next() => {
                is_asked = true;
                // A terminal sends Ctrl-C to the program itself.
                let is_sent = asked == Signal::INT && std::io::stdin().is_terminal();
                if let (Some(pid), false) = (pid(&child), is_sent) {
                    // It may have ended by now.
                    let _ = kill_process(pid, asked);
                }
                kill_at.get_or_insert(tokio::time::Instant::now() + grace);
            }
            () = kill => {
                let text = format!("does not end within {} and is killed", humanize::duration(grace));
                journal.report(Level::Warn, text, &[]);
                let _ = child.start_kill();
                kill_at = None;
            }
            () = &mut sound, if !is_sound => {
                is_sound = true;
                journal.alert(None).await;
            }
        }
    };
    let ran = began.elapsed();
    let until = tokio::time::Instant::now() + OUTPUT_AFTER_END;
    let mut has_left_programs = false;
    for mut task in reading {
        if tokio::time::timeout_at(until, &mut task).await.is_err() {
            has_left_programs = true;
            task.abort();
        }
    }
    let last_error = kept.last_error();
    Ok(End {
        status,
        ran,
        is_asked,
        has_left_programs,
        last_error,
    })
}

fn pid(child: &Child) -> Option<Pid> {
    Pid::from_raw(i32::try_from(child.id()?).ok()?)
}
