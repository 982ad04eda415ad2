//! Owns `rect sub`.
use std::process::ExitCode;

use clap::Args;
use rect::{Message, Pattern};
use serde_json::json;

use crate::{
    session::JoinArguments,
    shown::{self, shown},
    Done,
};

/// Show what robots say, until Ctrl-C.
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
    #[command(flatten)]
    join: JoinArguments,
}

/// `rect sub`.
pub async fn run(arguments: SubArguments) -> Done {
    let robot = arguments.join.join_to_hear().await?;
    let messages = robot.subscribe(&arguments.pattern).await?;
    let mut left = arguments.count.unwrap_or(u64::MAX);
    while left > 0 {
        let Some(message) = messages.recv().await else {
            break;
        };
        left -= 1;
        if arguments.json {
            println!("{}", as_json(&message));
        } else {
            println!("{}", as_text(&message));
        }
    }
    let dropped = messages.dropped();
    if dropped > 0 {
        eprintln!("rect: {dropped} messages came faster than they could be shown");
    }
    Ok(ExitCode::SUCCESS)
}

fn as_text(message: &Message) -> String {
    let Message { from, topic, .. } = message;
    let mut line = format!("{from}/{topic}");
    if message.to.is_some() {
        line += " (to this robot)";
    }
    if let Some(method) = &message.over {
        line += &format!(" (over {method})");
    }
    if message.missed > 0 {
        line += &format!(" ({} before it did not arrive)", message.missed);
    }
    if let Some(flaw) = &message.flaw {
        line += &format!(" (as it came: {flaw})");
    }
    format!("{line}: {}", shown(&message.payload))
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
