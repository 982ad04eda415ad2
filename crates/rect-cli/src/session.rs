//! Connects a command to a router: its arguments, and the name under which it connects.
use std::{path::PathBuf, time::Duration};

use clap::{
    builder::{PossibleValuesParser, TypedValueParser},
    Args,
};
use rect::{Error, Name, Options, Robot, Urgency};
use rect_core::session::{
    login::{default_file, FILE_VARIABLE},
    router::CLOSED,
};
use serde_json::Value;
use zenoh::query::ConsolidationMode;

use crate::{endpoint, Failure};

/// The name under which a command connects while the name of the router's robot is not known. Nothing is published
/// under it.
pub const PLACEHOLDER: &str = "rect-tool";

/// How often a command looks whether the router closes the session, and the pause between two looks.
const LOOKS: usize = 10;
const PAUSE: Duration = Duration::from_millis(50);

/// The router to connect to, and the name under which to connect.
#[derive(Args, Clone, Debug)]
pub struct JoinArguments {
    /// Connect as a program of this robot [default: the robot of the router]
    #[arg(long = "as", value_name = "ROBOT")]
    robot_name: Option<String>,
    /// The name of the fleet
    #[arg(long, default_value = "rect")]
    fleet: String,
    /// The router; the environment variable RECT_ENDPOINT changes the default
    #[arg(long, value_name = "ENDPOINT", default_value_t = Options::default_router(), value_parser = endpoint)]
    router: String,
    /// The login file, if the router requires a login [default: $RECT_LOGIN, else /etc/rect/users]
    #[arg(long, value_name = "FILE")]
    users: Option<PathBuf>,
}

/// Which robots a list is about, and its form.
#[derive(Args)]
pub struct ListArguments {
    /// The robot [default: all]
    #[arg(value_parser = name)]
    pub robot: Option<Name>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub join: JoinArguments,
}

/// The urgency and compression of a message.
#[derive(Args, Clone, Debug)]
pub struct DeliveryArguments {
    /// Urgent messages overtake all others on every link
    #[arg(long, default_value = "normal", value_parser = urgency())]
    pub urgency: Urgency,
    /// Compress the value with this codec: zstd:3, png, jpeg:60, webp:60, quantised:0.01, ...
    #[arg(long, value_name = "CODEC")]
    pub codec: Option<String>,
    /// Compress the value with this dictionary (see `rect dictionary train`)
    #[arg(long, value_name = "FILE", conflicts_with = "codec")]
    pub dictionary: Option<PathBuf>,
}

fn urgency() -> impl TypedValueParser<Value = Urgency> {
    PossibleValuesParser::new(["bulk", "normal", "urgent"]).map(|name| match name.as_str() {
        "bulk" => Urgency::Bulk,
        "urgent" => Urgency::Urgent,
        _ => Urgency::Normal,
    })
}

impl JoinArguments {
    /// Connects as the robot of `--as`, or as the robot of the router.
    ///
    /// # Errors
    /// Returns `Unnamed` if `--as` is not given and the router has no robot.
    pub async fn join(&self) -> Result<Robot, Failure> {
        let robot = match &self.robot_name {
            Some(robot) => robot.clone(),
            None => self.robot_of_router().await?,
        };
        Ok(self.options(&robot)?.connect().await?)
    }

    /// Connects for receiving and requesting only, which is also possible if the router has no robot.
    pub async fn join_unnamed(&self) -> Result<Robot, Failure> {
        match self.join().await {
            Ok(robot) => Ok(robot),
            Err(error) if error.is::<Unnamed>() => {
                Ok(self.placeholder_options()?.connect().await?)
            }
            Err(error) => Err(error),
        }
    }

    /// Returns the login file with which the command connects, if the router requires a login.
    pub fn login_file(&self) -> PathBuf {
        let default = || default_file(std::env::var(FILE_VARIABLE).ok()).into();
        self.users.clone().unwrap_or_else(default)
    }

    /// Returns the endpoint of the router.
    pub fn router(&self) -> &str {
        &self.router
    }

    fn options(&self, robot: &str) -> Result<Options, rect::Error> {
        let options = Options::new(robot)?.fleet(self.fleet.as_str())?;
        let options = options.router(&self.router);
        Ok(match &self.users {
            Some(file) => options.login_file(file),
            None => options,
        })
    }

    /// Returns the options for connecting to a router whose robot is not known.
    fn placeholder_options(&self) -> Result<Options, rect::Error> {
        Ok(self.options(PLACEHOLDER)?.allow_name_mismatch())
    }

    /// Queries the router for the name of its robot.
    async fn robot_of_router(&self) -> Result<String, Failure> {
        let placeholder = self.placeholder_options()?.connect().await?;
        let zenoh = placeholder.zenoh();
        let router = zenoh.info().routers_zid().await.next();
        let router = router.map(|id| id.to_string()).unwrap_or_default();
        // Without consolidation, which would wait for the answers of all robots, also over links that are busy.
        let statuses = zenoh
            .get(format!("{}/*/@rect/status", self.fleet))
            .consolidation(ConsolidationMode::None)
            .await?;
        let mut found = None;
        while let Ok(reply) = statuses.recv_async().await {
            let Ok(sample) = reply.into_result() else {
                continue;
            };
            // An answer of another robot that cannot be read does not matter.
            let status = serde_json::from_slice(&sample.payload().to_bytes());
            let status: Value = status.unwrap_or_default();
            if status["id"] == router.as_str() {
                found = sample
                    .key_expr()
                    .as_str()
                    .split('/')
                    .nth(1)
                    .map(str::to_owned);
                break;
            }
        }
        let is_closed = found.is_none() && is_closed(zenoh).await;
        placeholder.close().await?;
        if is_closed {
            return Err(Error::NoRouter {
                endpoint: self.router.clone(),
                reason: CLOSED.to_owned(),
                source: None,
            }
            .into());
        }
        found.ok_or_else(|| {
            Unnamed {
                router: self.router.clone(),
                fleet: self.fleet.clone(),
            }
            .into()
        })
    }
}

/// Returns whether the router closes the session. Zenoh opens it again and again, so that it may be open at the moment.
async fn is_closed(session: &zenoh::Session) -> bool {
    for _ in 0..LOOKS {
        let info = session.info();
        let is_open = info.routers_zid().await.next().is_some();
        if !is_open && info.peers_zid().await.next().is_none() {
            return true;
        }
        tokio::time::sleep(PAUSE).await;
    }
    false
}

/// The router belongs to no robot of the fleet.
#[derive(Debug, thiserror::Error)]
#[error(
    "the router at {router} does not belong to a robot of the fleet {fleet}: name the robot to connect as with \
     `--as <robot>`, or give the router a name (plugins/rect/robot in its configuration)"
)]
struct Unnamed {
    router: String,
    fleet: String,
}

impl DeliveryArguments {
    /// Returns a handle of `robot` with this urgency and codec.
    pub fn apply(&self, robot: &Robot) -> Result<Robot, Failure> {
        let robot = robot.with_urgency(self.urgency);
        if let Some(file) = &self.dictionary {
            let dictionary = rect_core::codec::dictionary::Dictionary::read(file)?;
            return Ok(robot.with_dictionary(dictionary.into())?);
        }
        Ok(match &self.codec {
            Some(codec) => robot.with_codec(rect_core::codec::parse(codec)?),
            None => robot,
        })
    }
}

/// Parses the name of a robot on the command line.
pub fn name(text: &str) -> Result<Name, rect_core::name::NameError> {
    Name::new(text)
}

/// Fails if a robot cannot be reached.
pub async fn require_reachable(own: &Robot, robot: &Name) -> Result<(), Error> {
    let available = own.peers().await?;
    if robot == own.name() || available.contains(robot) {
        return Ok(());
    }
    Err(Error::NotReachable {
        robot: robot.clone(),
        available,
    })
}
