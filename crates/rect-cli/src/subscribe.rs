//! Implements `rect sub`.
use std::{process::ExitCode, time::SystemTime};

use clap::Args;
use rect::{Message, Pattern, Payload, SubscribeOptions};
use rect_core::{clock::unix::ms_since_1970, text::display::line};
use rect_terminal::clock::time_of_day;
use rect_terminal::{self as terminal, paint, Style};
use serde_json::json;

use crate::{display, retained, session::JoinArguments, Done};

/// Print the messages that match a pattern, until Ctrl-C
#[derive(Args)]
pub struct SubArguments {
    /// The pattern, <robot>/<topic> with wildcards: 'wombat-2/arm/*', '*/**'
    pattern: Pattern,
    /// Exit after this number of messages
    #[arg(long)]
    count: Option<u64>,
    /// Receive at most this number of messages of each topic per second, such as 2 or 0.5; the robot that publishes leaves out the others
    #[arg(long, value_name = "RATE")]
    max_hz: Option<f64>,
    /// Receive only messages whose value differs from the last one
    #[arg(long)]
    on_change: bool,
    /// Print a line of JSON for each message
    #[arg(long)]
    json: bool,
    /// Do not print the time at which each message arrived
    #[arg(long)]
    no_time: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect sub`.
pub async fn run(arguments: SubArguments) -> Done {
    let robot = arguments.join.join_unnamed().await?;
    let options = SubscribeOptions {
        max_hz: arguments.max_hz,
        on_change: arguments.on_change,
        ..SubscribeOptions::default()
    };
    let pattern = arguments.pattern.clone();
    let messages = robot.subscribe_with::<Payload>(pattern, options).await?;
    let pattern = arguments.pattern.to_string();
    rect_terminal::errln!(
        "rect: subscribed to {}; press Ctrl-C to exit",
        line(&pattern)
    );
    let mut left = arguments.count.unwrap_or(u64::MAX);
    while left > 0 {
        let Some(message) = messages.next().await else {
            break;
        };
        left -= 1;
        if arguments.json {
            terminal::json_line(&as_json(&message))?;
        } else if arguments.no_time {
            rect_terminal::outln!("{}", as_text(&message));
        } else {
            let time = time_of_day(SystemTime::now());
            rect_terminal::outln!("{} {}", paint(Style::Faint, &time), as_text(&message));
        }
    }
    let dropped = messages.dropped();
    if dropped > 0 {
        rect_terminal::errln!(
            "rect: {dropped} messages arrived faster than they could be printed, and were dropped"
        );
    }
    Ok(ExitCode::SUCCESS)
}

fn as_text(message: &Message) -> String {
    let Message { sender, topic, .. } = message;
    let topic = line(topic.as_str());
    let mut text = paint(Style::Name, &format!("{sender}/{topic}"));
    if message.recipient.is_some() {
        text += " (to this robot)";
    }
    if message.replayed {
        text += " (replayed)";
    }
    if let Some(retained) = &message.retained {
        text += &format!(" ({})", retained::words(retained));
    }
    if let Some(method) = &message.method {
        text += &format!(" (over {})", line(method));
    }
    if message.missed > 0 {
        let missed = format!(" ({} missed before this one)", message.missed);
        text += &paint(Style::Poor, &missed);
    }
    if message.is_forgotten() {
        return text;
    }
    if let Some(problem) = message.problem() {
        let problem = format!(" (not decoded: {})", line(&problem.to_string()));
        text += &paint(Style::Wrong, &problem);
    }
    format!("{text}: {}", display::text(&message.payload))
}

/// Returns a message as JSON. The value and the problem of a topic that was forgotten are `null`.
pub fn as_json(message: &Message) -> serde_json::Value {
    let is_forgotten = message.is_forgotten();
    let value = (!is_forgotten).then(|| display::json(&message.payload));
    let problem = message.problem().filter(|_| !is_forgotten);
    json!({
        "sender": message.sender,
        "recipient": message.recipient,
        "topic": message.topic.as_str(),
        "encoding": message.payload.encoding.as_str(),
        "value": value,
        "bytes": message.payload.bytes.len(),
        "urgency": message.urgency,
        "sent_ms": message.sent_at.map(ms_since_1970),
        "sequence": message.sequence,
        "missed": message.missed,
        "skipped": message.skipped,
        "late": message.late,
        "replayed": message.replayed,
        "method": message.method,
        "retained": message.retained.as_ref().map(retained::json),
        "problem": problem.map(ToString::to_string),
    })
}
