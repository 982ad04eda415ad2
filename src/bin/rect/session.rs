//! Owns how a command joins: the arguments for it, and whose program it is.
use std::path::PathBuf;

use clap::Args;
use rect::{Name, Options, Robot, Urgency};
use serde_json::Value;

use crate::{endpoint, Failure};

/// As whom to ask a router which robot it is of; nothing is said under this name.
const NOBODY: &str = "rect-tool";

/// Where to join, and as whom.
#[derive(Args, Clone, Debug)]
pub struct JoinArguments {
    /// Speak as this robot [default: the one whose router it is]
    #[arg(long = "as", value_name = "ROBOT")]
    speaker: Option<String>,
    /// The team's name
    #[arg(long, default_value = "rect")]
    fleet: String,
    /// The router; $RECT_ENDPOINT changes the default
    #[arg(long, value_name = "ENDPOINT", default_value_t = Options::default_router(), value_parser = endpoint)]
    router: String,
    /// The login file, if the router asks for a login [default: $RECT_LOGIN, else /etc/rect/users]
    #[arg(long, value_name = "FILE")]
    users: Option<PathBuf>,
}

/// How to say something.
#[derive(Args, Clone, Debug)]
pub struct SpeakArguments {
    /// bulk, normal or urgent: urgent messages overtake all others, on every link
    #[arg(long, default_value = "normal", value_parser = urgency)]
    pub urgency: Urgency,
    /// Make it smaller: zstd:3, png, jpeg:60, webp:60, quantised:0.01, ...
    #[arg(long, value_name = "CODEC")]
    pub codec: Option<String>,
    /// Make it smaller with that dictionary (`rect dictionary train`)
    #[arg(long, value_name = "FILE", conflicts_with = "codec")]
    pub dictionary: Option<PathBuf>,
}

fn urgency(text: &str) -> Result<Urgency, String> {
    match text {
        "bulk" => Ok(Urgency::Bulk),
        "normal" => Ok(Urgency::Normal),
        "urgent" => Ok(Urgency::Urgent),
        _ => Err("bulk, normal or urgent".to_owned()),
    }
}

impl JoinArguments {
    /// Joins.
    pub async fn join(&self) -> Result<Robot, Failure> {
        let robot = match &self.speaker {
            Some(robot) => robot.clone(),
            None => self.robot_of_router().await?,
        };
        Ok(self.options(&robot)?.connect().await?)
    }

    /// Joins to ask and hear only: the router needs no robot's name for that.
    pub async fn join_to_hear(&self) -> Result<Robot, Failure> {
        match self.join().await {
            Ok(robot) => Ok(robot),
            Err(error) if error.is::<Unnamed>() => Ok(self.nobody()?.connect().await?),
            Err(error) => Err(error),
        }
    }

    fn options(&self, robot: &str) -> Result<Options, rect::Error> {
        let options = Options::new(robot)?.fleet(self.fleet.as_str())?;
        let options = options.router(&self.router);
        Ok(match &self.users {
            Some(file) => options.login_file(file),
            None => options,
        })
    }

    /// To ask the router, whichever robot it serves.
    fn nobody(&self) -> Result<Options, rect::Error> {
        Ok(self.options(NOBODY)?.allow_name_mismatch())
    }

    async fn robot_of_router(&self) -> Result<String, Failure> {
        let asking = self.nobody()?.connect().await?;
        let zenoh = asking.zenoh();
        let router = zenoh.info().routers_zid().await.next();
        let router = router.map(|id| id.to_string()).unwrap_or_default();
        let robots = zenoh.get(format!("{}/*/@rect/status", self.fleet)).await?;
        let mut found = None;
        while let Ok(reply) = robots.recv_async().await {
            let Ok(sample) = reply.into_result() else {
                continue;
            };
            let status: Value = serde_json::from_slice(&sample.payload().to_bytes())?;
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
        asking.close().await?;
        found.ok_or_else(|| {
            Unnamed {
                router: self.router.clone(),
                fleet: self.fleet.clone(),
            }
            .into()
        })
    }
}

/// The router is no robot's.
#[derive(Debug, thiserror::Error)]
#[error(
    "the router at {router} is that of no robot of the fleet {fleet}: say as whom to speak, with `--as <robot>`, \
     or give it a name (plugins/rect/robot in its configuration)"
)]
struct Unnamed {
    router: String,
    fleet: String,
}

impl SpeakArguments {
    /// The same robot, speaking so.
    pub fn of(&self, robot: &Robot) -> Result<Robot, Failure> {
        let robot = robot.with(self.urgency);
        if let Some(file) = &self.dictionary {
            let dictionary = rect::core::dictionary::Dictionary::read(file)?;
            return Ok(robot.packed_with(dictionary.into())?);
        }
        Ok(match &self.codec {
            Some(codec) => robot.encoded(rect::core::codec::parse(codec)?),
            None => robot,
        })
    }
}

/// A robot's name on the command line.
pub fn name(text: &str) -> Result<Name, rect::core::name::NameError> {
    Name::new(text)
}
