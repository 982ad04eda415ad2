//! Owns `rect sub`.
use std::{process::ExitCode, time::SystemTime};

use clap::Args;
use rect::{
    core::display::line,
    terminal::{self, paint, Style},
    Message, Name, Pattern, Robot,
};
use serde_json::json;

use crate::{
    clock::time_of_day,
    session::JoinArguments,
    shown::{self, shown},
    Done,
};

/// Show the messages of robots, until Ctrl-C.
#[derive(Args)]
pub struct SubArguments {
    /// Of whom and about what, <robot>/<topic> with wildcards: 'wombat-2/arm/*', '*/**'
    pattern: Pattern,
    /// End after so many messages
    #[arg(long)]
    count: Option<u64>,
    /// A line of JSON for each
    #[arg(long)]
    json: bool,
    /// Without the time at which each message arrived
    #[arg(long)]
    no_time: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// `rect sub`.
pub async fn run(arguments: SubArguments) -> Done {
    let robot = arguments.join.join_to_hear().await?;
    let messages = robot.subscribe(&arguments.pattern).await?;
    let pattern = arguments.pattern.to_string();
    rect::errln!("rect: listening to {}; Ctrl-C ends this", line(&pattern));
    if let Some(hint) = missing(&robot, arguments.pattern.robot()).await? {
        rect::errln!("rect: {hint}");
    }
    let mut left = arguments.count.unwrap_or(u64::MAX);
    while left > 0 {
        let Some(message) = messages.recv().await else {
            break;
        };
        left -= 1;
        if arguments.json {
            terminal::json_line(&as_json(&message))?;
        } else if arguments.no_time {
            rect::outln!("{}", as_text(&message));
        } else {
            let time = time_of_day(SystemTime::now());
            rect::outln!("{} {}", paint(Style::Faint, &time), as_text(&message));
        }
    }
    let dropped = messages.dropped();
    if dropped > 0 {
        rect::errln!("rect: {dropped} messages came faster than they could be shown");
    }
    Ok(ExitCode::SUCCESS)
}

/// A hint, if the robot that the user named is not there.
async fn missing(robot: &Robot, named: Option<&Name>) -> Result<Option<String>, rect::Error> {
    let Some(named) = named.filter(|named| *named != robot.name()) else {
        return Ok(None);
    };
    let peers = robot.peers().await?;
    if peers.contains(named) {
        return Ok(None);
    }
    let mut there: Vec<&str> = peers.iter().map(Name::as_str).collect();
    there.push(robot.name().as_str());
    there.sort_unstable();
    Ok(Some(format!(
        "there is no robot {named} now; there are: {}. Its messages are shown once it is there",
        there.join(", ")
    )))
}

fn as_text(message: &Message) -> String {
    let Message { from, topic, .. } = message;
    let topic = line(topic.as_str());
    let mut text = paint(Style::Name, &format!("{from}/{topic}"));
    if message.to.is_some() {
        text += " (to this robot)";
    }
    if let Some(method) = &message.over {
        text += &format!(" (over {})", line(method));
    }
    if message.missed > 0 {
        let missed = format!(" ({} before it did not arrive)", message.missed);
        text += &paint(Style::Poor, &missed);
    }
    if let Some(flaw) = &message.flaw {
        let flaw = format!(" (as it came: {})", line(&flaw.to_string()));
        text += &paint(Style::Wrong, &flaw);
    }
    format!("{text}: {}", shown(&message.payload))
}

fn as_json(message: &Message) -> serde_json::Value {
    json!({
        "from": message.from,
        "to": message.to,
        "topic": message.topic.as_str(),
        "encoding": message.payload.encoding.as_str(),
        "value": shown::json(&message.payload),
        "bytes": message.payload.bytes.len(),
        "urgency": message.urgency,
        "sent_ms": message.sent_ms,
        "sequence": message.sequence,
        "missed": message.missed,
        "late": message.late,
        "over": message.over,
        "flaw": message.flaw.as_ref().map(ToString::to_string),
    })
}
