//! Implements `rect replay`.
use std::{
    collections::{BTreeSet, HashMap},
    path::PathBuf,
    process::ExitCode,
    time::{Duration, Instant},
};

use clap::Args;
use rect::{
    core::{display::line, humanize},
    recording::{address, replay::Due, Reader, Replay, Summary},
    Name, Options, Publisher, Robot, Urgency,
};
use tokio::time::sleep_until;
use zenoh::Session;

use crate::{endpoint, recording::PartArguments, session::name, Done, Failure};

/// Where the recorded robots are reached, unless the user says otherwise.
const LISTEN: &str = "tcp/127.0.0.1:7450";
/// How many robots a recording may have.
const MAX_ROBOTS: usize = 100;
/// How many topics are looked at for `--wait`.
const MAX_WATCHED: usize = 200;
/// Interval at which that is done.
const WATCHED_EVERY: Duration = Duration::from_millis(50);

/// Publish the messages of a recording again, at their times
///
/// By default the command starts a router of its own, at which the recorded robots appear as if they were running. The
/// robots of a fleet are not affected: `rect sub --router tcp/127.0.0.1:7450 '*/**'` shows what is replayed.
#[derive(Args)]
pub struct ReplayArguments {
    /// The file, or the folder of an interrupted recording
    recording: PathBuf,
    #[command(flatten)]
    part: PartArguments,
    /// How fast to replay: 2 takes half the time
    #[arg(long, default_value_t = 1.0, value_parser = rate)]
    rate: f64,
    /// Begin again at the end, until Ctrl-C
    #[arg(long = "loop")]
    repeat: bool,
    /// Begin when the first program subscribes to one of the topics
    #[arg(long)]
    wait: bool,
    /// Print what would be published, and do nothing
    #[arg(long)]
    dry_run: bool,
    /// Where programs reach the recorded robots
    #[arg(long, value_name = "ENDPOINT", default_value = LISTEN, value_parser = endpoint)]
    listen: String,
    /// Publish at this router instead, under the name of --as: no router lets a program publish for other robots
    #[arg(long, value_name = "ENDPOINT", value_parser = endpoint, requires = "robot")]
    router: Option<String>,
    /// Publish everything as a program of this robot
    #[arg(long = "as", value_name = "ROBOT", value_parser = name)]
    robot: Option<Name>,
    /// The name of the fleet
    #[arg(long, default_value = "rect")]
    fleet: String,
    /// The login file, if the router requires a login
    #[arg(long, value_name = "FILE", requires = "router")]
    users: Option<PathBuf>,
}

fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|rate| (0.1..=10.0).contains(rate));
    rate.ok_or_else(|| "write a number from 0.1 to 10".to_owned())
}

/// Runs `rect replay`.
pub async fn run(arguments: ReplayArguments) -> Done {
    let (summary, error) = Summary::read(Reader::open(&arguments.recording)?);
    if let Some(error) = error {
        rect::errln!("rect: {error}. The messages before that are replayed");
    }
    if arguments.dry_run {
        return dry_run(&arguments);
    }
    let mut robots = Robots::start(&arguments, &summary).await?;
    if arguments.wait {
        robots.wait_for_subscriber(&arguments, &summary).await?;
    }
    loop {
        let mut due = replayed(&arguments)?;
        let started = Instant::now();
        let mut count = 0u64;
        for message in due.by_ref() {
            // The file is damaged here, which was reported.
            let Ok(message) = message else { break };
            sleep_until((started + message.at).into()).await;
            robots.publish(message).await?;
            count += 1;
        }
        let took = humanize::duration(started.elapsed());
        rect::errln!("rect: replayed {count} messages in {took}");
        if due.skipped() > 0 {
            rect::errln!(
                "rect: skipped {} messages whose topics do not begin with the name of a robot; --as names one",
                due.skipped()
            );
        }
        if !arguments.repeat || count == 0 {
            break;
        }
    }
    robots.close().await?;
    Ok(ExitCode::SUCCESS)
}

fn replayed(arguments: &ReplayArguments) -> Result<Replay<Reader>, Failure> {
    let reader = Reader::open(&arguments.recording)?;
    let selection = arguments.part.selection();
    Ok(Replay::new(
        reader,
        selection,
        arguments.rate,
        arguments.robot.clone(),
    ))
}

fn dry_run(arguments: &ReplayArguments) -> Done {
    for message in replayed(arguments)? {
        let Ok(Due {
            at,
            robot,
            topic,
            entry,
        }) = message
        else {
            break;
        };
        let size = humanize::bytes(entry.payload.bytes.len() as u64);
        let (at, topic) = (at.as_secs_f64(), line(topic.as_str()));
        rect::outln!("{at:10.3} s  {robot}/{topic}  {size}");
    }
    Ok(ExitCode::SUCCESS)
}

/// The robots that publish, and the router at which they do.
struct Robots {
    robots: HashMap<(Name, Urgency), Robot>,
    router: Option<Session>,
}

impl Robots {
    async fn start(arguments: &ReplayArguments, summary: &Summary) -> Result<Self, Failure> {
        let router = match &arguments.router {
            Some(_) => None,
            None => Some(router(&arguments.listen).await?),
        };
        let at = arguments.router.as_ref().unwrap_or(&arguments.listen);
        let names = match &arguments.robot {
            Some(robot) => BTreeSet::from([robot.as_str().to_owned()]),
            None => robots_of(summary),
        };
        if names.len() > MAX_ROBOTS {
            return Err(format!(
                "the recording has more than {MAX_ROBOTS} robots; select some with --topic"
            )
            .into());
        }
        let mut robots = HashMap::new();
        for name in &names {
            let options = Options::new(name.as_str())?.fleet(arguments.fleet.as_str())?;
            let options = options.router(at);
            let options = match &arguments.users {
                Some(file) => options.login_file(file),
                None => options,
            };
            let robot = options.connect().await?;
            for urgency in [Urgency::Bulk, Urgency::Normal, Urgency::Urgent] {
                robots.insert((robot.name().clone(), urgency), robot.with_urgency(urgency));
            }
        }
        let names: Vec<_> = names.into_iter().collect();
        rect::errln!(
            "rect: replaying {} at {at}; press Ctrl-C to stop",
            names.join(", ")
        );
        if router.is_some() {
            rect::errln!("rect: `rect sub --router {at} '*/**'` shows the messages");
        }
        Ok(Self { robots, router })
    }

    /// Waits until a program subscribes to a topic.
    async fn wait_for_subscriber(
        &self,
        arguments: &ReplayArguments,
        summary: &Summary,
    ) -> Result<(), Failure> {
        let mut publishers: Vec<Publisher> = Vec::new();
        for topic in summary.topics.keys().take(MAX_WATCHED) {
            let Some((robot, topic)) = address(topic) else {
                continue;
            };
            let robot = arguments.robot.clone().unwrap_or(robot);
            if let Some(robot) = self.robots.get(&(robot, Urgency::Normal)) {
                publishers.push(robot.publisher(topic).await?);
            }
        }
        while !publishers.iter().any(Publisher::has_subscribers) {
            tokio::time::sleep(WATCHED_EVERY).await;
        }
        Ok(())
    }

    async fn publish(&mut self, due: Due) -> Result<(), Failure> {
        let Due {
            robot,
            topic,
            entry,
            ..
        } = due;
        let Some(robot) = self.robots.get(&(robot, entry.urgency)) else {
            return Ok(());
        };
        match &entry.recipient {
            Some(recipient) => robot.send(recipient.as_str(), topic, entry.payload).await?,
            None => robot.publish(topic, entry.payload).await?,
        }
        Ok(())
    }

    async fn close(self) -> Result<(), Failure> {
        for robot in self.robots.values() {
            robot.close().await?;
        }
        if let Some(router) = self.router {
            router.close().await?;
        }
        Ok(())
    }
}

/// Returns the names of the robots of a recording.
fn robots_of(summary: &Summary) -> BTreeSet<String> {
    let addresses = summary.topics.keys().filter_map(|topic| address(topic));
    addresses
        .map(|(robot, _)| robot.as_str().to_owned())
        .collect()
}

/// Starts a router that only programs of this replay use.
async fn router(listen: &str) -> Result<Session, Failure> {
    let mut config = zenoh::Config::default();
    let listen_on = serde_json::json!([listen]).to_string();
    for (key, value) in [
        ("mode", "\"router\""),
        ("listen/endpoints", &listen_on),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
    ] {
        config.insert_json5(key, value)?;
    }
    let opened = zenoh::open(config).await;
    opened.map_err(|error| {
        let reason = humanize::short_reason(&error.to_string());
        format!("cannot listen at {listen}: {reason}. --listen selects another endpoint").into()
    })
}
