//! Implements `rect replay`.
mod presence;

use std::{
    collections::{BTreeSet, HashMap},
    path::PathBuf,
    process::ExitCode,
    time::{Duration, Instant},
};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use rect::{KeptState, Name, Options, Publisher, Robot};
use rect_core::{
    name::key::KeySpace,
    state::keeper::Disk,
    text::{
        display::{line, paragraph},
        humanize,
    },
};
use rect_recording::{
    address,
    pace::{self, Pace, RATES},
    remap::{remapped, Remap},
    replay::Due,
    Reader, Replay, Summary,
};
use tokio::{
    signal::unix::{signal, SignalKind},
    time::{interval, sleep_until, Interval},
};
use zenoh::Session;

use self::presence::Presence;
use crate::{
    endpoint,
    keyboard::Keyboard,
    recording::PartArguments,
    session::{name, PLACEHOLDER},
    Done, Failure,
};

/// Where the recorded robots are reached, unless the user says otherwise.
const LISTEN: &str = "tcp/127.0.0.1:7450";
/// How many robots a recording may have.
const MAX_ROBOTS: usize = 100;
/// Interval at which the position is shown.
const SHOWN_EVERY: Duration = Duration::from_millis(200);
/// The factor by which a key changes the rate.
const RATE_STEP: f64 = 2.0;
/// Tokio's timers expire up to this much too late. The rest is slept on the thread, for which the kernel's timers are precise.
const TIMER_STEP: Duration = Duration::from_millis(2);
/// How many topics are looked at for `--wait`.
const MAX_WATCHED: usize = 200;
/// Interval at which that is done.
const WATCHED_EVERY: Duration = Duration::from_millis(50);

/// Publish the messages of a recording again, at their times
///
/// By default the command starts a router of its own, at which the recorded robots appear as if they were running: `rect peers` and
/// `rect topic list` with the option `--router tcp/127.0.0.1:7450` show them, and `rect sub` what is replayed. The robots of a fleet are
/// not affected.
///
/// Keys: space pauses and continues, `n` publishes the next message, `+` and `-` change the rate, `q` ends the replay.
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
    /// Replace a robot, or the beginning of a topic: wombat-1=wombat-9, wombat-1/arm=wombat-1/gripper
    #[arg(long, value_name = "FROM=TO")]
    remap: Vec<Remap>,
    /// Begin paused; a key continues
    #[arg(long)]
    paused: bool,
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
    let rate = text.parse().ok().filter(|rate| RATES.contains(rate));
    rate.ok_or_else(|| "write a number from 0.1 to 10".to_owned())
}

/// Runs `rect replay`.
pub async fn run(arguments: ReplayArguments) -> Done {
    let (summary, error) = Summary::read(Reader::open(&arguments.recording)?);
    if let Some(error) = error {
        if summary.messages == 0 {
            return Err(error.into());
        }
        rect_terminal::errln!("rect: {error}. The messages before that are replayed");
    }
    if arguments.dry_run {
        return dry_run(&arguments);
    }
    let mut player = Player::new(&arguments, &summary)?;
    let mut interrupted = signal(SignalKind::interrupt())?;
    let robots = Robots::start(&arguments, &summary).await?;
    let played = async {
        if arguments.wait {
            robots.wait_for_subscriber(&arguments, &summary).await?;
        }
        while player.play(&arguments, &robots).await? && arguments.repeat {}
        Ok::<_, Failure>(())
    };
    tokio::select! {
        done = played => done?,
        _ = interrupted.recv() => {}
    }
    // The terminal is as before, also if the robots cannot be closed.
    drop(player);
    robots.close().await?;
    Ok(ExitCode::SUCCESS)
}

/// Waits until messages are due, and follows the keys meanwhile.
struct Player {
    pace: Pace,
    keyboard: Option<Keyboard>,
    bar: ProgressBar,
    shown: Interval,
    is_ended: bool,
    /// Whether that was reported.
    has_left_out: bool,
}

impl Player {
    fn new(arguments: &ReplayArguments, summary: &Summary) -> Result<Self, Failure> {
        let keyboard = Keyboard::open();
        if arguments.paused && keyboard.is_none() {
            return Err(
                "--paused waits for a key, and the standard input is not a terminal".into(),
            );
        }
        let part = arguments.part.selection();
        let all = Duration::from_secs_f64(summary.duration_s);
        let length = part.end.map_or(all, |end| end.min(all));
        let length = length.saturating_sub(part.begin);
        let bar = ProgressBar::new(u64::try_from(length.as_millis()).unwrap_or(u64::MAX));
        if let Ok(style) = ProgressStyle::with_template("{wide_bar} {msg}") {
            bar.set_style(style);
        }
        let mut pace = Pace::new(arguments.rate, Instant::now());
        if arguments.paused {
            pace.pause_or_continue(Instant::now());
        }
        Ok(Self {
            pace,
            keyboard,
            bar,
            shown: interval(SHOWN_EVERY),
            is_ended: false,
            has_left_out: false,
        })
    }

    /// Replays the recording once. Returns whether it may be replayed again.
    async fn play(
        &mut self,
        arguments: &ReplayArguments,
        robots: &Robots,
    ) -> Result<bool, Failure> {
        let mut due = replayed(arguments)?;
        let (started, mut count) = (Instant::now(), 0u64);
        self.pace.restart(started);
        self.bar.reset();
        for message in due.by_ref() {
            // The file is damaged here, which was reported.
            let Ok(message) = message else { break };
            if !self.wait(message.at).await {
                break;
            }
            robots.publish(message).await?;
            count += 1;
        }
        self.bar.finish_and_clear();
        let took = humanize::duration(started.elapsed());
        rect_terminal::errln!("rect: replayed {count} messages in {took}");
        let skipped: u64 = due.skipped().values().sum();
        if skipped > 0 {
            rect_terminal::errln!(
                "rect: skipped {skipped} messages whose topics do not begin with the name of a robot; --as names one"
            );
        }
        if due.left_out() > 0 && !std::mem::replace(&mut self.has_left_out, true) {
            rect_terminal::errln!(
                "rect: the values of parameters, goals, alerts and stops were left out ({}): at the router of a robot they belong to its programs",
                due.left_out()
            );
        }
        Ok(count > 0 && !self.is_ended)
    }

    /// Waits until the message at a position is due. Returns whether the replay goes on.
    async fn wait(&mut self, at: Duration) -> bool {
        while !self.is_ended {
            let due = self.pace.due(at, Instant::now());
            let is_due = async {
                match due {
                    pace::Due::At(time) => {
                        if let Some(early) = time.checked_sub(TIMER_STEP) {
                            sleep_until(early.into()).await;
                        }
                        std::thread::sleep(time.saturating_duration_since(Instant::now()));
                    }
                    pace::Due::Paused => std::future::pending().await,
                }
            };
            let key = async {
                match &mut self.keyboard {
                    Some(keyboard) => keyboard.next().await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                () = is_due => {
                    self.pace.on_published(at);
                    return true;
                }
                key = key => self.on_key(key),
                _ = self.shown.tick() => self.show(),
            }
        }
        false
    }

    fn on_key(&mut self, key: u8) {
        let now = Instant::now();
        match key {
            b' ' => self.pace.pause_or_continue(now),
            b'n' => self.pace.step(now),
            b'+' => self.pace.change_rate(RATE_STEP, now),
            b'-' => self.pace.change_rate(1.0 / RATE_STEP, now),
            b'q' => self.is_ended = true,
            _ => {}
        }
        self.show();
    }

    fn show(&self) {
        let position = self.pace.position(Instant::now());
        let state = match self.pace.is_paused() {
            true => "paused: space continues, n is the next message".to_owned(),
            false => format!("rate {}", self.pace.rate()),
        };
        (self.bar).set_position(u64::try_from(position.as_millis()).unwrap_or(u64::MAX));
        self.bar
            .set_message(format!("{:.1} s, {state}", position.as_secs_f64()));
    }
}

fn replayed(arguments: &ReplayArguments) -> Result<Replay<Reader>, Failure> {
    let reader = Reader::open(&arguments.recording)?;
    let selection = arguments.part.selection();
    let replay = Replay::new(
        reader,
        selection,
        arguments.remap.clone(),
        arguments.robot.clone(),
    );
    Ok(match arguments.router {
        Some(_) => replay.as_live_robot(),
        None => replay,
    })
}

fn dry_run(arguments: &ReplayArguments) -> Done {
    let mut replay = replayed(arguments)?;
    for message in replay.by_ref() {
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
        rect_terminal::outln!("{at:10.3} s  {robot}/{topic}  {size}");
    }
    for (topic, count) in replay.skipped() {
        let topic = line(topic);
        rect_terminal::outln!(
            "   skipped  {topic}, {count} messages: it does not begin with the name of a robot; --as names one"
        );
    }
    Ok(ExitCode::SUCCESS)
}

/// The robots that publish, and the router at which they do.
struct Robots {
    robots: HashMap<Name, Robot>,
    router: Option<Session>,
    /// The retained values of the robots, which the own router keeps.
    kept: Vec<KeptState>,
    /// The robots, as programs at the own router see them.
    shown: HashMap<Name, Presence>,
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
            None => robots_of(summary, &arguments.remap),
        };
        if names.len() > MAX_ROBOTS {
            return Err(format!(
                "the recording has more than {MAX_ROBOTS} robots; select some with --topic"
            )
            .into());
        }
        let (mut robots, mut kept) = (HashMap::new(), Vec::new());
        for name in &names {
            let options = Options::new(name.as_str())?.fleet(arguments.fleet.as_str())?;
            let options = options.router(at);
            let options = match &arguments.users {
                Some(file) => options.login_file(file),
                None => options,
            };
            let robot = options.connect().await?;
            robots.insert(robot.name().clone(), robot);
        }
        let mut shown = HashMap::new();
        if let Some(router) = &router {
            for (name, robot) in &robots {
                shown.insert(name.clone(), Presence::start(robot)?);
            }
            // Also for commands such as `rect sub`, which belong to none of the robots.
            for name in names.iter().map(String::as_str).chain([PLACEHOLDER]) {
                kept.push(keep(router, &arguments.fleet, name)?);
            }
        }
        let names: Vec<_> = names.into_iter().collect();
        rect_terminal::errln!(
            "rect: replaying {} at {at}; press Ctrl-C to stop",
            names.join(", ")
        );
        if router.is_some() {
            rect_terminal::errln!("rect: `rect sub --router {at} '*/**'` shows the messages");
        }
        Ok(Self {
            robots,
            router,
            kept,
            shown,
        })
    }

    /// Waits until a program subscribes to a topic.
    async fn wait_for_subscriber(
        &self,
        arguments: &ReplayArguments,
        summary: &Summary,
    ) -> Result<(), Failure> {
        let mut publishers: Vec<Publisher> = Vec::new();
        for topic in summary.topics.keys().take(MAX_WATCHED) {
            let Some((robot, topic)) = address(&remapped(&arguments.remap, topic)) else {
                continue;
            };
            let robot = arguments.robot.clone().unwrap_or(robot);
            if let Some(robot) = self.robots.get(&robot) {
                publishers.push(robot.publisher(topic).await?);
            }
        }
        while !publishers.iter().any(Publisher::has_subscribers) {
            tokio::time::sleep(WATCHED_EVERY).await;
        }
        Ok(())
    }

    async fn publish(&self, due: Due) -> Result<(), Failure> {
        let Some(robot) = self.robots.get(&due.robot) else {
            return Ok(());
        };
        if let Some(shown) = self.shown.get(&due.robot) {
            shown.on_message(due.topic.as_str(), &due.entry.payload);
        }
        match robot.replay(due.topic, due.entry).await {
            // The other messages do not depend on it.
            Err(error @ rect::Error::NotRetained { .. }) => {
                rect_terminal::errln!("rect: {}", paragraph(&error.to_string()));
                Ok(())
            }
            replayed => Ok(replayed?),
        }
    }

    async fn close(self) -> Result<(), Failure> {
        drop(self.shown);
        for robot in self.robots.values() {
            robot.close().await?;
        }
        drop(self.kept);
        if let Some(router) = self.router {
            router.close().await?;
        }
        Ok(())
    }
}

/// Begins to keep the retained values of a robot at a router.
fn keep(router: &Session, fleet: &str, robot: &str) -> Result<KeptState, Failure> {
    let place = KeySpace {
        fleet: Name::new(fleet)?,
        robot: Name::new(robot)?,
    };
    let disk = Disk::None("the router of a replay keeps no values on disk".to_owned());
    let save = Box::new(|_: &[u8]| Ok(()));
    Ok(KeptState::start(
        router,
        place,
        disk,
        save,
        Box::new(|_| false),
    )?)
}

/// Returns the names of the robots of a recording.
fn robots_of(summary: &Summary, remaps: &[Remap]) -> BTreeSet<String> {
    let topics = summary.topics.keys();
    let addresses = topics.filter_map(|topic| address(&remapped(remaps, topic)));
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
