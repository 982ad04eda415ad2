//! Owns how a program joins: by which router, or directly, as whom.
use std::{
    fs,
    path::PathBuf,
    time::{Duration, Instant},
};

use serde_json::{json, Value};
use zenoh::{Config, Session};

use super::{opening, robot::Robot};
use crate::{
    core::{
        endpoint,
        key::Place,
        login::{self, Login},
        name::Name,
        router::{JoinError, Joining},
        wording,
    },
    error::Error,
};

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
    allows_name_mismatch: bool,
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
            login_file: Self::default_login_file(),
            allows_name_mismatch: false,
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
        endpoint::default_router(std::env::var(endpoint::ROUTER_VARIABLE).ok())
    }

    /// Returns the login file of programs that name none: the environment's `RECT_LOGIN`, else `/etc/rect/users`.
    pub fn default_login_file() -> PathBuf {
        login::default_file(std::env::var(login::FILE_VARIABLE).ok()).into()
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

    /// As that user; by default the first line of the login file, `user:password`, if it can be read.
    #[must_use]
    pub fn login(mut self, user: impl Into<String>, password: impl Into<String>) -> Self {
        self.login = Some((user.into(), password.into()));
        self
    }

    /// As the user of the first line of that file, `user:password`; default: [`default_login_file`](Self::default_login_file).
    #[must_use]
    pub fn login_file(mut self, file: impl Into<PathBuf>) -> Self {
        self.login_file = file.into();
        self
    }

    /// Joins although the router serves another robot: for a program that uses another name on purpose. A router with
    /// access control as `rect-router init` writes it drops what such a program publishes.
    #[must_use]
    pub fn allow_name_mismatch(mut self) -> Self {
        self.allows_name_mismatch = true;
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
    /// [`Error::NoRouter`]: none is there; [`Error::LoginRefused`]; [`Error::WrongRobot`]: the router serves another robot;
    /// [`Error::Option`]: Zenoh does not take one of the options.
    pub async fn connect(self) -> Result<Robot, Error> {
        if self.is_direct() {
            let opened = zenoh::open(self.config(None)?).await;
            let session = opened.map_err(|error| self.refused(&error))?;
            return Robot::start(session, self.place, None).await;
        }
        let (session, config) = self.join().await?;
        if !self.allows_name_mismatch {
            let tokens = opening::tokens_of_router(&session).await;
            if let Err(wrong) = self.place.check_router(&self.router, tokens) {
                if let Err(error) = session.close().await {
                    tracing::debug!("the session does not close: {error}");
                }
                return Err(wrong.into());
            }
        }
        Robot::start(session, self.place, Some(config)).await
    }

    /// Opens a session with the router, and returns it with its configuration.
    async fn join(&self) -> Result<(Session, Config), Error> {
        let mut joining = Joining::new(&self.router, self.login_or_file(), self.patience);
        let began = Instant::now();
        loop {
            let config = self.config(joining.credentials())?;
            let limit = joining.limit(began.elapsed());
            let reason = match opening::open(config.clone(), limit).await {
                Ok(session) => return Ok((session, config)),
                Err(reason) => reason,
            };
            let pause = joining.on_failure(began.elapsed(), reason.as_deref());
            tokio::time::sleep(pause.map_err(|error| self.not_joined(error))?).await;
        }
    }

    fn not_joined(&self, error: JoinError) -> Error {
        match error {
            JoinError::NoRouter { reason } => {
                let endpoint = self.router.clone();
                Error::NoRouter { endpoint, reason }
            }
            JoinError::Login(refused) => refused.into(),
        }
    }

    fn is_direct(&self) -> bool {
        !self.endpoints.is_empty() || !self.listen.is_empty()
    }

    fn refused(&self, error: &zenoh::Error) -> Error {
        let all = self.listen.iter().chain(&self.endpoints);
        Error::Option {
            what: "listen or endpoint",
            value: all.cloned().collect::<Vec<_>>().join(" "),
            reason: wording::with_causes(error.as_ref()),
        }
    }

    /// `credentials`: for the router; direct links use those of the options.
    fn config(&self, credentials: Option<(&str, &str)>) -> Result<Config, Error> {
        let mut config = Config::default();
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
                // One attempt: `join` decides about more. The pauses are those of reconnecting.
                ("connect/timeout_ms", json!(0)),
                ("connect/retry", retry(100)),
            ]);
        }
        let login = self.login_or_file();
        let credentials = match self.is_direct() {
            true => login.credentials(),
            false => credentials,
        };
        if let Some((user, password)) = credentials {
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

    fn login_or_file(&self) -> Login {
        match &self.login {
            Some((user, password)) => Login::given(user, password),
            None => {
                let text = fs::read_to_string(&self.login_file);
                let text = text.as_deref().map_err(ToString::to_string);
                Login::of_file(self.login_file.display().to_string(), text)
            }
        }
    }
}

fn retry(first_ms: u32) -> Value {
    json!({ "period_init_ms": first_ms, "period_max_ms": 1000, "period_increase_factor": 2 })
}
