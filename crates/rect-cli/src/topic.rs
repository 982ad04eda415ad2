//! Implements `rect topic`, which shows the topics that robots publish or have retained, and their rates. Each robot's router
//! measures the rates, so that no messages are transmitted for the measurement.
use std::{process::ExitCode, time::Duration};

use clap::{Args, Subcommand};
use rect::{Name, Payload, Robot, RobotTopic, Topic};
use rect_core::{
    action,
    registry::{
        topics::{TopicReport, Topics, MAX_TOPICS, WINDOW},
        usage::{on_air, percent, LinkUsage},
    },
    text::{
        display::line,
        humanize::{bytes, duration},
    },
};
use rect_dashboard::topics::{answers, query, Answers, QUERY_TIMEOUT};
use rect_terminal::{self as terminal, paint, Cell, Style, Table};
use serde_json::json;

use crate::{
    display,
    duration::DurationArgument,
    retained,
    session::{name, JoinArguments},
    subscribe, Done, Failure,
};

/// How long messages are counted before `hz` prints the first line.
const COUNTED: Duration = Duration::from_secs(2);
/// Interval at which `hz` prints.
const EVERY: Duration = Duration::from_secs(1);
/// The shortest time for which `list` and `info` count messages.
const MIN_COUNTED: Duration = Duration::from_millis(100);
/// How long the routers count after a question: until the next one reaches them, even if one robot does not answer this one before
/// its timeout, and the radio is slow.
const KEEP: Duration = WINDOW.saturating_add(QUERY_TIMEOUT.saturating_mul(2));

/// Show the topics that robots publish, as measured by their routers, and the values that they retain
#[derive(Args)]
pub struct TopicArguments {
    #[command(subcommand)]
    command: TopicCommand,
}

#[derive(Subcommand)]
enum TopicCommand {
    /// List the topics of a robot, or of all robots of the fleet
    ///
    /// The topics of goals, `actions/...`, are left out: `rect action list` shows the goals.
    List {
        /// The robot [default: all]
        #[arg(value_parser = name)]
        robot: Option<Name>,
        /// List the topics of goals, too
        #[arg(long)]
        all: bool,
        #[command(flatten)]
        measured: MeasuredArguments,
        #[command(flatten)]
        join: JoinArguments,
    },
    /// Print the rate of a topic once per second, until Ctrl-C
    Hz {
        /// The topic, <robot>/<topic>: wombat-2/arm/angle
        topic: RobotTopic,
        /// Exit after this number of lines
        #[arg(long)]
        count: Option<u64>,
        /// Print lines of JSON
        #[arg(long)]
        json: bool,
        #[command(flatten)]
        join: JoinArguments,
    },
    /// Show all information about a topic
    Info {
        /// The topic, <robot>/<topic>: wombat-2/arm/angle
        topic: RobotTopic,
        #[command(flatten)]
        measured: MeasuredArguments,
        #[command(flatten)]
        join: JoinArguments,
    },
    /// Print the last value of a retained topic, and how old it is
    ///
    /// The exit status is 1 if no value is kept.
    Get {
        /// The topic, <robot>/<topic>: wombat-2/mode
        topic: RobotTopic,
        /// Print JSON
        #[arg(long)]
        json: bool,
        #[command(flatten)]
        join: JoinArguments,
    },
    /// Forget the value of a retained topic of this robot
    ///
    /// Programs that subscribe to the topic receive that it was forgotten.
    Forget {
        /// The topic, such as mode
        topic: Topic,
        #[command(flatten)]
        join: JoinArguments,
    },
}

#[derive(Args)]
struct MeasuredArguments {
    /// How long to count messages, at most 5s. A topic without a message in this time is only listed if it is retained
    #[arg(long, default_value = "2s", value_parser = counted)]
    duration: DurationArgument,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Parses how long messages are counted.
fn counted(text: &str) -> Result<DurationArgument, String> {
    let counted: DurationArgument = text.parse().map_err(|error| format!("{error}"))?;
    if (MIN_COUNTED..=WINDOW).contains(&counted.0) {
        return Ok(counted);
    }
    let (from, to) = (duration(MIN_COUNTED), duration(WINDOW));
    Err(format!("routers count the messages of {from} to {to}"))
}

/// Runs `rect topic`.
pub async fn run(arguments: TopicArguments) -> Done {
    match arguments.command {
        TopicCommand::List {
            robot: publisher,
            all,
            measured,
            join,
        } => {
            let robot = join.join_unnamed().await?;
            let Answers {
                mut topics,
                problems,
            } = measure(&robot, publisher.as_ref(), None, measured.duration).await?;
            let left_out: usize = match all {
                true => 0,
                false => topics.iter_mut().map(|(_, of)| leave_goals_out(of)).sum(),
            };
            if measured.json {
                let all = topics
                    .iter()
                    .map(|(robot, topics)| (robot.clone(), as_json(topics)));
                terminal::json(&all.collect::<serde_json::Map<_, _>>())?;
            } else {
                list(&topics);
            }
            if left_out > 0 {
                rect_terminal::errln!(
                    "rect: the topics of goals are left out: `rect action list` shows the goals, and --all lists their topics"
                );
            }
            for problem in problems {
                rect_terminal::errln!("rect: {problem}");
            }
        }
        TopicCommand::Hz {
            topic,
            count,
            json,
            join,
        } => {
            let robot = join.join_unnamed().await?;
            hz(&robot, &topic, count, json).await?;
        }
        TopicCommand::Info {
            topic,
            measured,
            join,
        } => {
            let robot = join.join_unnamed().await?;
            let answers = measure(
                &robot,
                Some(&topic.robot),
                Some(topic.topic.as_str()),
                measured.duration,
            )
            .await?;
            let topics = answers
                .topics
                .first()
                .map(|(_, topics)| topics.clone())
                .unwrap_or_default();
            let Some(report) = topics.topics.first() else {
                return Err(not_published(&topic));
            };
            if measured.json {
                let mut json = report_as_json(report);
                json["links"] = links_as_json(&topics.links);
                terminal::json(&json)?;
            } else {
                info(&topic, &topics, report);
            }
        }
        TopicCommand::Get { topic, json, join } => {
            let robot = join.join_unnamed().await?;
            get(&robot, &topic, json).await?;
        }
        TopicCommand::Forget { topic, join } => {
            let robot = join.join().await?;
            robot.forget(&topic).await?;
            rect_terminal::outln!(
                "{} retains no value of {} now",
                robot.name(),
                line(topic.as_str())
            );
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Prints the last value of a retained topic.
async fn get(robot: &Robot, topic: &RobotTopic, json: bool) -> Result<(), Failure> {
    let latest = robot.latest::<Payload>(topic.robot.clone(), &topic.topic);
    let Some(message) = latest.await? else {
        return Err(not_retained(topic));
    };
    if json {
        terminal::json(&subscribe::as_json(&message))?;
        return Ok(());
    }
    let mut text = paint(
        Style::Name,
        &format!("{}/{}", topic.robot, line(topic.topic.as_str())),
    );
    if let Some(retained) = &message.retained {
        let (age, ended) = (retained::age(retained), retained::ended(retained));
        text += &format!(" ({age}{ended})");
    }
    if let Some(problem) = message.problem() {
        let problem = format!(" (not decoded: {})", line(&problem.to_string()));
        text += &paint(Style::Wrong, &problem);
    }
    rect_terminal::outln!("{text}: {}", display::text(&message.payload));
    Ok(())
}

fn not_retained(topic: &RobotTopic) -> Failure {
    let RobotTopic { robot, topic } = topic;
    let topic = line(topic.as_str());
    format!("{robot} keeps no value of {topic}, or is not reachable. `rect peers` lists the reachable robots, and `rect topic list {robot}` the topics that it retains")
        .into()
}

fn not_published(topic: &RobotTopic) -> Failure {
    let RobotTopic { robot, topic } = topic;
    let topic = line(topic.as_str());
    format!("{robot} published no message on {topic} while its messages were counted; count for longer with --duration 5s, or list its topics with `rect topic list {robot}`")
        .into()
}

/// Counts messages for `duration`, and returns the topics of one robot or of all robots.
async fn measure(
    robot: &Robot,
    publisher: Option<&Name>,
    topic: Option<&str>,
    duration: DurationArgument,
) -> Result<Answers, Failure> {
    // The first query starts the count.
    answers(robot, publisher, topic, KEEP).await?;
    tokio::time::sleep(duration.0).await;
    answers(robot, publisher, topic, KEEP).await
}

/// Removes the topics of goals, which the router keeps for ten minutes after their ends. Returns how many there were.
fn leave_goals_out(topics: &mut Topics) -> usize {
    let before = topics.topics.len();
    let of_goals = |topic: &str| topic.split('/').next() == Some(action::TOPIC);
    topics.topics.retain(|report| !of_goals(&report.topic));
    before - topics.topics.len()
}

fn list(answers: &[(String, Topics)]) {
    let mut columns = vec!["TOPIC", "RATE", "?BYTES/S"];
    let has_links = links(answers).next().is_some();
    if has_links {
        columns.push("ON AIR/S");
    }
    columns.extend(["?LAST", "?ENCODING"]);
    let reports = || answers.iter().flat_map(|(_, topics)| &topics.topics);
    let has_losses = reports().any(|report| report.lost > 0);
    let has_retained = reports().any(|report| report.is_retained);
    if has_losses {
        columns.push("?LOST");
    }
    if has_retained {
        columns.push("?RETAINED");
    }
    let mut table = Table::new(&columns);
    let mut more = 0;
    for (robot, topics) in answers {
        more += topics.more;
        for report in &topics.topics {
            let mut cells = vec![
                Cell::styled(Style::Name, format!("{robot}/{}", report.topic)),
                format!("{:.1} Hz", report.hz).into(),
                bytes(report.bytes_per_s).into(),
            ];
            if has_links {
                let topic = format!("{robot}/{}", report.topic);
                cells.push(match on_air(links(answers), &topic) {
                    0 => "".into(),
                    sent => bytes(sent).into(),
                });
            }
            cells.push(bytes(report.last_bytes).into());
            cells.push(report.encoding.as_str().into());
            if has_losses {
                cells.push(report.lost.to_string().into());
            }
            if has_retained {
                cells.push(if report.is_retained { "yes" } else { "" }.into());
            }
            table.row(cells);
        }
    }
    table.print();
    for (robot, topics) in answers {
        for link in topics.links.iter().filter(|link| link.is_slow()) {
            let robot = line(robot);
            rect_terminal::outln!("{robot} sends over {}", link.in_words(&robot));
        }
    }
    if more > 0 {
        rect_terminal::errln!(
            "rect: {more} more topics are not listed: the router of a robot counts at most {MAX_TOPICS}"
        );
    }
}

/// Returns what the links of all robots have sent.
fn links(answers: &[(String, Topics)]) -> impl Iterator<Item = &LinkUsage> {
    answers.iter().flat_map(|(_, topics)| &topics.links)
}

async fn hz(
    robot: &Robot,
    topic: &RobotTopic,
    count: Option<u64>,
    json: bool,
) -> Result<(), Failure> {
    // The first query starts the count.
    query(robot, Some(&topic.robot), Some(topic.topic.as_str()), KEEP).await?;
    let mut ticks = tokio::time::interval(EVERY);
    ticks.tick().await;
    tokio::time::sleep(COUNTED.saturating_sub(EVERY)).await;
    for _ in 0..count.unwrap_or(u64::MAX) {
        ticks.tick().await;
        let answers = query(robot, Some(&topic.robot), Some(topic.topic.as_str()), KEEP).await?;
        let topics = answers.into_iter().next().map(|(_, topics)| topics);
        let topics = topics.unwrap_or_default();
        let report = topics.topics.first().cloned().unwrap_or_default();
        if json {
            terminal::json_line(&report_as_json(&report))?;
        } else {
            rect_terminal::outln!("{}", rate(&report, topics.window_s));
        }
    }
    Ok(())
}

fn rate(report: &TopicReport, window_s: f64) -> String {
    if report.hz == 0.0 {
        return format!("no message within {window_s} s");
    }
    let intervals = report
        .interval_ms
        .map_or_else(String::new, |(shortest, longest)| {
            format!(", {shortest} to {longest} ms apart")
        });
    format!(
        "{:.1} Hz, {}/s{intervals} (within {window_s} s)",
        report.hz,
        bytes(report.bytes_per_s)
    )
}

fn info(topic: &RobotTopic, topics: &Topics, report: &TopicReport) {
    let RobotTopic { robot, topic } = topic;
    rect_terminal::outln!("topic:    {robot}/{}", line(topic.as_str()));
    rect_terminal::outln!("rate:     {}", rate(report, topics.window_s));
    let name = format!("{robot}/{}", report.topic);
    for link in &topics.links {
        if let Some(sent) = link.topic(&name) {
            let share = (sent.share).map_or_else(String::new, |share| {
                format!(", {} of what it carries", percent(share))
            });
            let sent = bytes(sent.bytes_per_s);
            rect_terminal::outln!("on air:   {sent}/s over {}{share}", link.name());
        }
    }
    rect_terminal::outln!("encoding: {}", line(&report.encoding));
    rect_terminal::outln!("last:     {}", bytes(report.last_bytes));
    rect_terminal::outln!("lost:     {}", report.lost);
    rect_terminal::outln!(
        "retained: {}",
        if report.is_retained { "yes" } else { "no" }
    );
}

fn as_json(topics: &Topics) -> serde_json::Value {
    json!({
        "window_s": topics.window_s,
        "topics": topics.topics.iter().map(report_as_json).collect::<Vec<_>>(),
        "more": topics.more,
        "links": links_as_json(&topics.links),
    })
}

/// Returns what links have sent as JSON with field names.
fn links_as_json(links: &[LinkUsage]) -> serde_json::Value {
    let links = links.iter().map(|link| {
        let sent = link.sent.iter().map(|sent| {
            json!({"topic": sent.topic, "bytes_per_s": sent.bytes_per_s, "share": sent.share})
        });
        json!({"link": link.link, "path": link.path, "sent": sent.collect::<Vec<_>>()})
    });
    links.collect()
}

/// Returns a report as JSON with field names, which the router's compact reply omits.
fn report_as_json(report: &TopicReport) -> serde_json::Value {
    json!({
        "topic": report.topic,
        "encoding": report.encoding,
        "hz": report.hz,
        "bytes_per_s": report.bytes_per_s,
        "last_bytes": report.last_bytes,
        "lost": report.lost,
        "interval_ms": report.interval_ms,
        "retained": report.is_retained,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_of_goals_are_left_out() {
        let names = [
            "actions/dig/7f",
            "actions/dig/7f/feedback",
            "actionsdig",
            "mode",
        ];
        let report = |topic: &str| TopicReport {
            topic: topic.to_owned(),
            ..TopicReport::default()
        };
        let mut topics = Topics {
            topics: names.map(report).into(),
            ..Topics::default()
        };
        assert_eq!(leave_goals_out(&mut topics), 2);
        let left: Vec<_> = topics.topics.iter().map(|one| one.topic.as_str()).collect();
        assert_eq!(left, ["actionsdig", "mode"]);
    }
}
