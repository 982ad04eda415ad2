//! Implements `rect survey`: measures two robots with real radios, step by step, and writes what it found to a JSON file and a
//! page with plots.
mod computer;
mod discovery;
mod document;
mod expected;
mod guide;
mod label;
mod page;
mod place;
mod reconnection;
mod switch;

use std::{
    fs,
    path::{Path, PathBuf},
    process::ExitCode,
    time::{Duration, Instant, SystemTime},
};

use clap::Args;
use rect::{Connection, Json, LinkPathState, Name, Payload, Robot};
use rect_core::registry::connection::ConnectionState;
use rect_terminal::clock;
use serde_json::Value;
use tokio::time::sleep;

use self::{
    computer::Computer,
    document::{Link, Place, Soak, Survey},
    guide::{Guide, Step},
    label::Label,
};
use crate::{
    duration::DurationArgument,
    measure::{partner::Partner, round_trip},
    session::{name, JoinArguments},
    Done, Failure,
};

/// The service that describes the other robot's computer.
const COMPUTER: &str = "rect-survey/computer";
/// How long the other robot is awaited.
const PEER_TIMEOUT: Duration = Duration::from_secs(30);
/// How long the registry may take to show the link.
const LINKED_WITHIN: Duration = Duration::from_secs(5);
const POLL: Duration = Duration::from_millis(100);
/// Methods of paths.
const BLE: &str = "ble";
const TCP: &str = "tcp";

const EXAMPLE: &str = "\
Example: two robots that are linked
  rect survey --serve              # on wombat-2
  rect survey wombat-2             # on wombat-1: says where to put the robots, and measures

Without robots: `make survey-sim` runs it on the simulated air.";

/// Measure two robots with real radios, step by step, and write a JSON file and a page with plots
///
/// The survey takes about ten minutes. It says what to do: put the robots at several distances, switch the radio off and on, and
/// the Wi-Fi. Each step can be skipped. The files contain no addresses and no secrets, so they can be attached to a bug report.
#[derive(Args)]
#[command(after_help = EXAMPLE)]
pub struct SurveyArguments {
    /// The other robot
    #[arg(value_parser = name, required_unless_present = "serve")]
    robot: Option<Name>,
    /// Serve the surveys of other robots, until Ctrl-C
    #[arg(long, conflicts_with = "robot")]
    serve: bool,
    /// Where the robots are put: distances, with `+body` if a person stands in between
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "1m,5m,10m,20m,30m,5m+body"
    )]
    places: Vec<Label>,
    /// Measure only where the robots are now, and ask nothing
    #[arg(long, conflicts_with_all = ["places", "by"])]
    here: bool,
    /// Run this program for each step instead of asking, with the step as its arguments: `place 5m`, `radio off`, `wifi on`, ...
    #[arg(long, value_name = "PROGRAM")]
    by: Option<PathBuf>,
    /// How long each figure is measured
    #[arg(long, default_value = "3s")]
    duration: DurationArgument,
    /// Watch the link for this time at the end, such as 1h
    #[arg(long, value_name = "DURATION")]
    soak: Option<DurationArgument>,
    /// The adapter that measures how soon the other robot is discovered
    #[arg(long, default_value = "hci0")]
    adapter: String,
    /// The JSON file; the page is written beside it [default: survey-<robot>-<date>-<time>.json]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect survey`.
pub async fn run(arguments: SurveyArguments) -> Done {
    let robot = arguments.join.join().await?;
    let partner = Partner::serve(&robot).await?;
    let Some(other) = arguments.robot.clone() else {
        return serve(&robot, partner).await;
    };
    let path = arguments.output.clone().unwrap_or_else(|| {
        let at = clock::file_name(SystemTime::now());
        PathBuf::from(format!("survey-{}-{at}.json", robot.name()))
    });
    robot.wait_for_peer(&other, PEER_TIMEOUT).await?;
    let guide = match (&arguments.by, arguments.here) {
        (Some(program), _) => Guide::Program(program.clone()),
        (None, true) => Guide::Nobody,
        (None, false) => Guide::Person,
    };
    let survey = Surveyor {
        robot: &robot,
        other: &other,
        partner: &partner,
        guide: &guide,
        adapter: &arguments.adapter,
        duration: arguments.duration.0,
    };
    let mut survey = survey.run(&arguments).await?;
    survey.deviations = expected::deviations(&survey);
    write(&survey, &path)?;
    summarize(&survey, &path);
    Ok(ExitCode::SUCCESS)
}

async fn serve(robot: &Robot, partner: Partner) -> Done {
    let _computer = robot
        .serve(COMPUTER, |_| async {
            let described = tokio::task::spawn_blocking(|| Computer::describe(Path::new("/")));
            described.await.map(Json).map_err(|error| error.to_string())
        })
        .await?;
    rect_terminal::errln!(
        "rect: ready; begin on the other robot with `rect survey {}`; press Ctrl-C to exit",
        robot.name()
    );
    partner.run().await?;
    Ok(ExitCode::SUCCESS)
}

/// Measures one robot after the other step.
struct Surveyor<'a> {
    robot: &'a Robot,
    other: &'a Name,
    partner: &'a Partner,
    guide: &'a Guide,
    /// The adapter that scans.
    adapter: &'a str,
    duration: Duration,
}

impl Surveyor<'_> {
    async fn run(&self, arguments: &SurveyArguments) -> Result<Survey, Failure> {
        let own = tokio::task::spawn_blocking(|| Computer::describe(Path::new("/"))).await?;
        let reply = self
            .robot
            .request::<Payload>(self.other, COMPUTER, "")
            .await;
        let theirs = reply.map_err(|error| {
            format!("{error}. Run `rect survey --serve` on {} first", self.other)
        })?;
        let link = self.link().await?;
        say(&format!(
            "{} and {} are linked by {}.",
            self.robot.name(),
            self.other,
            link.method
        ));
        let mut survey = Survey::new(
            [
                (self.robot.name().clone(), own),
                (self.other.clone(), theirs.payload.value()?),
            ],
            Link::of(&link, self.batch_bytes().await),
        );
        let has_wifi = is_live(&link, TCP);
        if has_wifi {
            say("Measuring over Wi-Fi.");
            let label = Label::named("over Wi-Fi");
            survey.places.push(self.place(&label).await);
            survey
                .switches
                .extend(switch::measure(self, Step::WifiOff).await?);
        }
        if !has_wifi || survey.switches.iter().any(|switch| switch.path == BLE) {
            self.places(arguments, &mut survey).await?;
        }
        if has_wifi {
            survey
                .switches
                .extend(switch::measure(self, Step::WifiOn).await?);
        }
        if let Some(DurationArgument(duration)) = arguments.soak {
            survey.soak = Some(self.soak(duration).await?);
        }
        Ok(survey)
    }

    /// Measures over Bluetooth at each place, and how soon the robots reach each other again.
    async fn places(
        &self,
        arguments: &SurveyArguments,
        survey: &mut Survey,
    ) -> Result<(), Failure> {
        if arguments.here {
            survey.places.push(self.place(&Label::named("here")).await);
            return Ok(());
        }
        for label in &arguments.places {
            let step = Step::Place(label.clone());
            if self.guide.ask(&step).await?.is_some() {
                survey.places.push(self.place(label).await);
            }
        }
        survey.reconnections = reconnection::measure(self).await?;
        Ok(())
    }

    async fn place(&self, label: &Label) -> Place {
        let measured = place::measure(self, label).await;
        let measured = measured.map(|place| Place {
            resembles: expected::resembles(&place),
            ..place
        });
        measured.unwrap_or_else(|error| {
            // Out of range, for example: the other places are measured nevertheless.
            rect_terminal::errln!("rect: {label}: {error}");
            Place::failed(label, &error.to_string())
        })
    }

    /// Watches the link for a long time.
    async fn soak(&self, duration: Duration) -> Result<Soak, Failure> {
        say(&format!(
            "Watching the link for {}.",
            rect_core::text::humanize::duration(duration)
        ));
        let measured = round_trip::measure(self.robot, self.other, duration, |_| {}).await?;
        Ok(Soak {
            seconds: duration.as_secs_f64(),
            round_trip: measured.into(),
        })
    }

    /// Returns the largest batch of the Bluetooth link, in bytes, from the admin space of the routers.
    async fn batch_bytes(&self) -> Option<u64> {
        let replies = self.robot.zenoh().get("@/*/router/ble").await.ok()?;
        while let Ok(reply) = replies.recv_async().await {
            let Ok(sample) = reply.into_result() else {
                continue;
            };
            let nodes: Value = serde_json::from_slice(&sample.payload().to_bytes()).ok()?;
            let nodes = nodes.as_array().into_iter().flatten();
            let mut links = nodes.flat_map(|node| node["links"].as_array().into_iter().flatten());
            if let Some(link) = links.find(|link| link["peer"] == self.other.as_str()) {
                return link["mtu"].as_u64();
            }
        }
        None
    }

    /// Waits for the connection of the two robots. The registry shows it a moment after the robots reach each other.
    async fn link(&self) -> Result<Connection, Failure> {
        let deadline = Instant::now() + LINKED_WITHIN;
        loop {
            if let Some(link) = self.linked().await? {
                return Ok(link);
            }
            if Instant::now() > deadline {
                return Err(format!(
                    "{} is not linked with this robot, only reachable through others: see `rect connections`",
                    self.other
                )
                .into());
            }
            sleep(POLL).await;
        }
    }

    /// Returns the connection of the two robots, if there is one.
    async fn linked(&self) -> Result<Option<Connection>, Failure> {
        let other = Some(self.other.as_str());
        let all = self.robot.connections().await?.into_iter();
        let is_link =
            |one: &Connection| one.state == ConnectionState::Connected && one.robot() == other;
        let mut links: Vec<_> = all.filter(is_link).collect();
        // Both robots may have dialled.
        links.sort_by_key(|link| link.method != "any");
        Ok(links.into_iter().next())
    }
}

/// Returns whether a path of the link is used.
fn is_live(link: &Connection, method: &str) -> bool {
    let paths = link.paths.iter().flatten();
    paths
        .filter(|path| path.method == method)
        .any(|path| path.state == LinkPathState::Live)
}

fn say(text: &str) {
    rect_terminal::errln!("{text}");
}

fn write(survey: &Survey, path: &Path) -> Result<(), Failure> {
    let fail = |path: &Path| {
        let path = path.display().to_string();
        move |error: std::io::Error| format!("cannot write {path}: {error}")
    };
    let json = serde_json::to_string_pretty(survey)? + "\n";
    fs::write(path, &json).map_err(fail(path))?;
    let page = path.with_extension("html");
    fs::write(&page, page::html(survey)?).map_err(fail(&page))?;
    Ok(())
}

fn summarize(survey: &Survey, path: &Path) {
    let mut table = rect_terminal::Table::new(&[
        "PLACE",
        "SIGNAL",
        "ROUND TRIP",
        "UNDER LOAD",
        "SENT",
        "RECEIVED",
        "LOST",
    ]);
    for place in &survey.places {
        table.row(place.cells());
    }
    table.print();
    match survey.deviations.as_slice() {
        [] => rect_terminal::outln!("Everything is as on the simulated air, or better."),
        deviations => {
            rect_terminal::outln!("Not as expected:");
            for deviation in deviations {
                rect_terminal::outln!("  - {deviation}");
            }
        }
    }
    rect_terminal::outln!(
        "Written: {} and {}",
        path.display(),
        path.with_extension("html").display()
    );
}
