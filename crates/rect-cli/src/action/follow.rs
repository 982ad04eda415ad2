//! Follows a goal to its end, and shows how far it is.
use std::{process::ExitCode, time::Duration};

use indicatif::{ProgressBar, ProgressStyle};
use rect::{ActionRun, Error, Payload, Phase};
use rect_core::text::{
    display::line,
    humanize::{bytes, duration},
};
use rect_terminal as terminal;
use serde_json::{json, Value as Json};
use tokio::{
    signal::unix::{signal, Signal, SignalKind},
    time::{interval, sleep},
};

use crate::{display, report, Done};

/// How often the times are drawn.
const DRAWN_EVERY: Duration = Duration::from_millis(500);
/// The pause before a cancel is sent again that did not reach the robot.
const PAUSE: Duration = Duration::from_secs(1);
/// The number of steps of the bar.
const STEPS: u64 = 1000;
/// The maximum length of feedback in the line of the bar, in characters.
const MAX_FEEDBACK: usize = 200;
/// The status that shells use for an interrupted program.
pub const INTERRUPTED: u8 = 130;

/// The signals that ask this program to end.
pub struct Interrupts {
    interrupt: Signal,
    terminate: Signal,
}

/// Shows a goal: as a bar on a terminal, or as lines of JSON.
struct Shown {
    bar: ProgressBar,
    has_progress: bool,
    as_json: bool,
    printed: Json,
}

impl Interrupts {
    pub fn new() -> std::io::Result<Self> {
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
        })
    }

    pub async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}

/// Follows a goal to its end, and prints that. The exit status is 0 if it is done.
///
/// With `interrupts`, the first one cancels the goal, and the next one ends this program at once. `is_cancelled`: the first one has been.
pub async fn to_end(
    run: &ActionRun,
    as_json: bool,
    mut interrupts: Option<&mut Interrupts>,
    mut is_cancelled: bool,
) -> Done {
    let mut shown = Shown::new(as_json);
    let bar = shown.bar.clone();
    let mut cancelling = std::pin::pin!(cancel(run, &bar));
    let mut has_order = false;
    let mut changes = run.changes();
    let mut tick = interval(DRAWN_EVERY);
    if is_cancelled {
        tell_of_cancel(&bar);
    }
    if run.phase() != Phase::Waiting {
        // It was found, with its state.
        shown.on_change(run)?;
    }
    loop {
        tokio::select! {
            change = changes.next() => match change {
                Some(()) => shown.on_change(run)?,
                None => break,
            },
            _ = tick.tick() => shown.draw(run),
            () = &mut cancelling, if is_cancelled && !has_order => has_order = true,
            () = interrupted(&mut interrupts) => {
                if is_cancelled {
                    bar.finish_and_clear();
                    return Ok(ExitCode::from(INTERRUPTED));
                }
                is_cancelled = true;
                tell_of_cancel(&bar);
            }
        }
    }
    let received = result(run, &mut shown, interrupts).await;
    bar.finish_and_clear();
    match received {
        Some(result) => end(run, as_json, result),
        None => Ok(ExitCode::from(INTERRUPTED)),
    }
}

async fn interrupted(interrupts: &mut Option<&mut Interrupts>) {
    match interrupts {
        Some(interrupts) => interrupts.next().await,
        None => std::future::pending().await,
    }
}

/// Returns the result of a goal that has ended; `None` if this program is interrupted while it receives a large one.
async fn result(
    run: &ActionRun,
    shown: &mut Shown,
    mut interrupts: Option<&mut Interrupts>,
) -> Option<Result<Payload, Error>> {
    let mut ending = std::pin::pin!(run.end());
    let mut tick = interval(DRAWN_EVERY);
    loop {
        tokio::select! {
            biased;
            result = &mut ending => return Some(result),
            _ = tick.tick() => shown.draw_result(run),
            () = interrupted(&mut interrupts) => return None,
        }
    }
}

/// Prints the end of a goal.
fn end(run: &ActionRun, as_json: bool, result: Result<Payload, Error>) -> Done {
    if !run.phase().is_end() {
        return Err(format!(
            "the router has ended the connection, and the goal goes on: follow it with `rect action watch {} {} {}`",
            run.robot(),
            run.action(),
            run.id()
        )
        .into());
    }
    if as_json {
        let mut document = document(run);
        let is_done = result.is_ok();
        match result {
            Ok(result) => document["result"] = display::json(&result),
            // It is done, and its result is not known.
            Err(Error::Goal { reason, .. }) => document["reason"] = reason.into(),
            Err(error) => return Err(error.into()),
        }
        terminal::json_line(&document)?;
        return Ok(ExitCode::from(u8::from(!is_done)));
    }
    let result = result?;
    match display::json(&result) {
        Json::Null => terminal::outln!("done"),
        _ => terminal::outln!("done: {}", display::text(&result)),
    }
    Ok(ExitCode::SUCCESS)
}

fn tell_of_cancel(bar: &ProgressBar) {
    bar.suspend(|| {
        terminal::errln!(
            "rect: the goal is cancelled; press Ctrl-C again to leave it before it has ended"
        );
    });
}

/// Cancels a goal. Tries again while the robot cannot be reached.
async fn cancel(run: &ActionRun, bar: &ProgressBar) {
    let mut is_known = false;
    loop {
        match run.cancel().await {
            Ok(()) => return,
            // It does not know the goal, or has no such action: the goal has ended, as its state shows.
            Err(Error::Service { .. } | Error::NoAction { .. } | Error::Closed) => return,
            Err(error) if !is_known => {
                bar.suspend(|| report(&error));
                is_known = true;
            }
            Err(_) => {}
        }
        sleep(PAUSE).await;
    }
}

impl Shown {
    fn new(as_json: bool) -> Self {
        let bar = match as_json {
            true => ProgressBar::hidden(),
            false => ProgressBar::new_spinner(),
        };
        bar.set_style(style("{spinner} {wide_msg}"));
        Self {
            bar,
            has_progress: false,
            as_json,
            printed: Json::Null,
        }
    }

    fn on_change(&mut self, run: &ActionRun) -> serde_json::Result<()> {
        self.draw(run);
        let is_end = run.phase().is_end();
        if self.as_json && !is_end {
            let document = document(run);
            if document != self.printed {
                terminal::json_line(&document)?;
                self.printed = document;
            }
        }
        Ok(())
    }

    fn draw(&mut self, run: &ActionRun) {
        if let Some(progress) = run.progress() {
            if !std::mem::replace(&mut self.has_progress, true) {
                self.bar.set_length(STEPS);
                self.bar
                    .set_style(style("{bar:30} {percent:>3} % {wide_msg}"));
            }
            // A progress is from 0 to 1.
            self.bar
                .set_position((progress * STEPS as f64).round() as u64);
        }
        self.bar.set_message(words(run));
        self.bar.tick();
    }

    /// Draws how much of a large result has arrived.
    fn draw_result(&self, run: &ActionRun) {
        if let Some(progress) = run.result_progress() {
            let [received, all] = [progress.received_bytes, progress.size_bytes].map(bytes);
            self.bar
                .set_message(format!("receiving the result: {received} of {all}"));
            self.bar.tick();
        }
    }
}

fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// Returns how far a goal is: `running for 3 s, {"depth":2}`.
fn words(run: &ActionRun) -> String {
    let mut words = format!("{} for {}", run.phase(), duration(run.phase_for()));
    if let Some(time) = run.unreachable_for() {
        words += &format!(
            ", {} cannot be reached since {}",
            run.robot(),
            duration(time)
        );
    }
    if let Some(feedback) = run.feedback().filter(has_value) {
        let text = display::text(&feedback);
        let cut: String = line(&text).chars().take(MAX_FEEDBACK).collect();
        words += &format!(", {cut}");
    }
    words
}

fn has_value(payload: &rect::Payload) -> bool {
    !display::json(payload).is_null()
}

/// Returns what is known about a goal as JSON.
fn document(run: &ActionRun) -> Json {
    json!({
        "robot": run.robot(),
        "action": run.action(),
        "id": run.id(),
        "phase": run.phase(),
        "reason": run.reason(),
        "progress": run.progress(),
        "feedback": run.feedback().as_ref().map(display::json),
        "is_reachable": run.unreachable_for().is_none(),
    })
}
