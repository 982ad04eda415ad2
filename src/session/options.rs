//! Owns how a program joins: by which router, or directly, as whom.
use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use serde_json::{json, Value};
use zenoh::Config;

use super::robot::Robot;
use crate::{
    core::{key::Place, login, name::Name, wording},
    error::Error,
};

/// Where a robot's router serves its programs unless told otherwise.
const DEFAULT_ROUTER: &str = "tcp/127.0.0.1:7447";
/// Where another router is named for all programs that do not name one.
const ROUTER_VARIABLE: &str = "RECT_ENDPOINT";
/// Where `rect-router init` puts the logins.
const DEFAULT_LOGIN_FILE: &str = "/etc/rect/users";
const DEFAULT_FLEET: &str = "rect";

/// How to join, where `connect("wombat-1")` does not do.
///
/// ```no_run
/// # async fn joined() -> Result<(), rect::Error> {
/// let robot = rect::Options::new("wombat-1")?.fleet("lions")?.router("tcp/192.168.0.7:7447").connect().await?;
/// # Ok(()) }
/// ```
#[derive(Clone, Debug)]
pub struct Options {
    place: Place,
    router: String,
    endpoints: Vec<String>,
    listen: Vec<String>,
    login: Option<(String, String)>,
    login_file: PathBuf,
    patience: Duration,
    zenoh: Vec<(String, Value)>,
}

impl Options {
    /// As a program of that robot, of the fleet `rect`, at the router of this computer.
    ///
    /// # Errors
    /// [`Error::Name`].
    pub fn new<N: TryInto<Name>>(robot: N) -> Result<Self, Error>
    where
        Error: From<N::Error>,
    {
        let fleet = Name::new(DEFAULT_FLEET)?;
        let robot = robot.try_into()?;
        Ok(Self {
            place: Place { fleet, robot },
            router: Self::default_router(),
            endpoints: Vec::new(),
            listen: Vec::new(),
            login: None,
            login_file: DEFAULT_LOGIN_FILE.into(),
            patience: Duration::from_secs(5),
            zenoh: Vec::new(),
        })
    }

    /// Of another fleet: the team's name.
    ///
    /// # Errors
    /// [`Error::Name`].
    pub fn fleet<N: TryInto<Name>>(mut self, fleet: N) -> Result<Self, Error>
    where
        Error: From<N::Error>,
    {
        self.place.fleet = fleet.try_into()?;
        Ok(self)
    }

    /// The router of programs that name none: what the environment's `RECT_ENDPOINT` says, else `tcp/127.0.0.1:7447`.
    pub fn default_router() -> String {
        let given = std::env::var(ROUTER_VARIABLE).ok();
        given
            .filter(|given| !given.is_empty())
            .unwrap_or_else(|| DEFAULT_ROUTER.to_owned())
    }

    /// At another router, as `tcp/192.168.0.7:7447`; default: [`default_router`](Self::default_router).
    #[must_use]
    pub fn router(mut self, endpoint: impl Into<String>) -> Self {
        self.router = endpoint.into();
        self
    }

    /// Without a router: connects to that one directly, as `ble/wombat-2` or `udp/192.168.0.8:7447`. Can be given
    /// several times. It is dialled until it is there; joining does not wait for it.
    #[must_use]
    pub fn endpoint(mut self, endpoint: impl Into<String>) -> Self {
        self.endpoints.push(endpoint.into());
        self
    }

    /// Without a router: others may connect to this program there, as `tcp/0.0.0.0:7447` or `ble/hci0#name=wombat-1`.
    #[must_use]
    pub fn listen(mut self, endpoint: impl Into<String>) -> Self {
        self.listen.push(endpoint.into());
        self
    }

    /// As that user; by default the first line of `/etc/rect/users`, `user:password`, if it can be read.
    #[must_use]
    pub fn login(mut self, user: impl Into<String>, password: impl Into<String>) -> Self {
        self.login = Some((user.into(), password.into()));
        self
    }

    /// As the user of the first line of that file, `user:password`.
    #[must_use]
    pub fn login_file(mut self, file: impl Into<PathBuf>) -> Self {
        self.login_file = file.into();
        self
    }

    /// How long to wait for the router; default 5 s, so that a program may be started together with it.
    #[must_use]
    pub fn patience(mut self, patience: Duration) -> Self {
        self.patience = patience;
        self
    }

    /// Any setting of Zenoh's configuration, by its path: `("transport/unicast/max_links", 2)`. Goes before ours.
    #[must_use]
    pub fn zenoh(mut self, key: impl Into<String>, value: impl Into<Value>) -> Self {
        self.zenoh.push((key.into(), value.into()));
        self
    }

    /// Joins.
    ///
    /// # Errors
    /// [`Error::NoRouter`]: none is there; [`Error::Option`]: Zenoh does not take one of the options.
    pub async fn connect(self) -> Result<Robot, Error> {
        let config = self.config()?;
        let direct = self.is_direct();
        let opened = zenoh::open(config.clone()).await;
        let session = opened.map_err(|error| self.refused(direct, &error))?;
        let router = (!direct).then_some(config);
        Robot::start(session, self.place, router).await
    }

    fn is_direct(&self) -> bool {
        !self.endpoints.is_empty() || !self.listen.is_empty()
    }

    fn refused(&self, direct: bool, error: &zenoh::Error) -> Error {
        let reason = wording::with_causes(error.as_ref());
        if direct {
            let all = self.listen.iter().chain(&self.endpoints);
            let value = all.cloned().collect::<Vec<_>>().join(" ");
            let what = "listen or endpoint";
            return Error::Option {
                what,
                value,
                reason,
            };
        }
        let endpoint = self.router.clone();
        Error::NoRouter { endpoint, reason }
    }

    fn config(&self) -> Result<Config, Error> {
        let mut config = Config::default();
        let patience_ms = u64::try_from(self.patience.as_millis()).unwrap_or(u64::MAX);
        let mut settings = vec![
            // Identical robots in one network are told apart by their links, not by who hears whose multicast.
            ("scouting/multicast/enabled", json!(false)),
            // What does not fit into a slow link waits, and does not cost the link (config/README.md).
            (
                "transport/link/tx/queue/congestion_control/block/wait_before_close",
                json!(60_000_000),
            ),
        ];
        if self.is_direct() {
            settings.extend([
                ("mode", json!("peer")),
                ("connect/endpoints", json!(self.endpoints)),
                ("connect/timeout_ms", json!(-1)),
                ("connect/exit_on_failure", json!(false)),
                ("connect/retry", retry(200)),
                ("listen/endpoints", json!(self.listen)),
                ("listen/exit_on_failure", json!(true)),
                ("scouting/gossip/enabled", json!(false)),
            ]);
        } else {
            settings.extend([
                ("mode", json!("client")),
                ("connect/endpoints", json!([self.router])),
                ("connect/timeout_ms", json!(patience_ms)),
                ("connect/retry", retry(100)),
            ]);
        }
        if let Some((user, password)) = self.user() {
            let login = json!({ "user": user, "password": password });
            settings.push(("transport/auth/usrpwd", login));
        }
        let given = self
            .zenoh
            .iter()
            .map(|(key, value)| (key.as_str(), value.clone()));
        for (key, value) in settings.into_iter().chain(given) {
            let text = value.to_string();
            config
                .insert_json5(key, &text)
                .map_err(|error| Error::Option {
                    what: "of Zenoh",
                    value: format!("{key}: {text}"),
                    reason: wording::with_causes(error.as_ref()),
                })?;
        }
        Ok(config)
    }

    fn user(&self) -> Option<(String, String)> {
        self.login.clone().or_else(|| first_login(&self.login_file))
    }
}

fn retry(first_ms: u32) -> Value {
    json!({ "period_init_ms": first_ms, "period_max_ms": 1000, "period_increase_factor": 2 })
}

fn first_login(file: &Path) -> Option<(String, String)> {
    let text = fs::read_to_string(file).ok()?;
    let (user, password) = login::logins(&text).next()?;
    Some((user.to_owned(), password.to_owned()))
}
