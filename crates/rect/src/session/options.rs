//! Defines [`Options`]: the robot, fleet, router, direct links and login with which a program connects.
use std::{
    fs,
    path::PathBuf,
    time::{Duration, Instant},
};

use rect_core::{
    catalogue::{program_name, PROGRAM_VARIABLE},
    name::{key::KeySpace, Name},
    session::{
        endpoint,
        login::{self, Login},
        router::{JoinAttempts, JoinError, CLOSED},
        settings::SessionLinks,
    },
};
use serde_json::Value;
use zenoh::{Config, Session};

use super::{
    connect::{self, NotOpened},
    robot::Robot,
};
use crate::error::{valid, Error};

const DEFAULT_FLEET: &str = "rect";

/// The name under which a program is known.
#[derive(Clone, Debug)]
enum ProgramName {
    OfExecutable,
    Chosen(Option<Name>),
}

/// The settings of a session, for programs that need other settings than the defaults of [`connect`](crate::connect).
///
/// ```no_run
/// # async fn open() -> Result<(), rect::Error> {
/// let robot = rect::Options::new("wombat-1")?.fleet("lions")?.router("tcp/192.168.0.7:7447").connect().await?;
/// # Ok(()) }
/// ```
#[derive(Clone, Debug)]
pub struct Options {
    place: KeySpace,
    program: ProgramName,
    router: String,
    endpoints: Vec<String>,
    listen: Vec<String>,
    login: Option<Login>,
    login_file: PathBuf,
    allows_name_mismatch: bool,
    timeout: Duration,
    zenoh: Vec<(String, Value)>,
}

/// Connects to the router of this computer as a program of `robot`, in the fleet `rect`.
///
/// [`Options`] selects another router, another fleet, or direct links.
///
/// ```no_run
/// # async fn hello() -> Result<(), rect::Error> {
/// let robot = rect::connect("wombat-1").await?;
/// robot.publish("greeting", "hello").await?;
/// # Ok(()) }
/// ```
///
/// # Errors
/// [`Error::Name`] if `robot` is not a valid name, [`Error::NoRouter`] if no router replies within 5 s, and the other errors
/// of [`Options::connect`].
///
/// # Cancel safety
/// If the future is dropped, the session is closed as soon as it has been opened.
pub async fn connect(robot: &str) -> Result<Robot, Error> {
    Options::new(robot)?.connect().await
}

impl Options {
    /// Creates the default options: a program of `robot` in the fleet `rect`, connected to the router of this computer.
    ///
    /// # Errors
    /// [`Error::Name`] if `robot` is not a valid name.
    pub fn new(robot: impl TryInto<Name, Error: Into<Error>>) -> Result<Self, Error> {
        let fleet = Name::new(DEFAULT_FLEET)?;
        let robot = valid(robot)?;
        Ok(Self {
            place: KeySpace { fleet, robot },
            program: ProgramName::OfExecutable,
            router: Self::default_router(),
            endpoints: Vec::new(),
            listen: Vec::new(),
            login: None,
            login_file: Self::default_login_file(),
            allows_name_mismatch: false,
            timeout: Duration::from_secs(5),
            zenoh: Vec::new(),
        })
    }

    /// Sets the name of the fleet; default: `rect`. Only robots of the same fleet exchange messages.
    ///
    /// # Errors
    /// [`Error::Name`] if `fleet` is not a valid name.
    pub fn fleet(mut self, fleet: impl TryInto<Name, Error: Into<Error>>) -> Result<Self, Error> {
        self.place.fleet = valid(fleet)?;
        Ok(self)
    }

    /// Sets the name under which this program is known in the fleet; default: the value of the environment variable `RECT_PROGRAM`, or else
    /// that of the executable, unless it is a test of Cargo's. Other robots see it in `rect program list`, and learn when the program ends.
    ///
    /// # Errors
    /// [`Error::Name`] if `program` is not a valid name.
    pub fn program(
        mut self,
        program: impl TryInto<Name, Error: Into<Error>>,
    ) -> Result<Self, Error> {
        self.program = ProgramName::Chosen(Some(valid(program)?));
        Ok(self)
    }

    /// Leaves this program without a name: for tools that are not part of what a robot does. It is known only while it serves
    /// something.
    #[must_use]
    pub fn without_program_name(mut self) -> Self {
        self.program = ProgramName::Chosen(None);
        self
    }

    /// Returns the default router: the value of the environment variable `RECT_ENDPOINT`, or `tcp/127.0.0.1:7447` if it is
    /// not set.
    pub fn default_router() -> String {
        endpoint::default_router(std::env::var(endpoint::ROUTER_VARIABLE).ok())
    }

    /// Returns the default login file: the value of the environment variable `RECT_LOGIN`, or `/etc/rect/users` if it is not
    /// set.
    pub fn default_login_file() -> PathBuf {
        login::default_file(std::env::var(login::FILE_VARIABLE).ok()).into()
    }

    /// Sets the endpoint of the router, such as `tcp/192.168.0.7:7447`; default: [`default_router`](Self::default_router).
    #[must_use]
    pub fn router(mut self, endpoint: impl Into<String>) -> Self {
        self.router = endpoint.into();
        self
    }

    /// Adds an endpoint to which this program opens a direct link, such as `ble/wombat-2` or `udp/192.168.0.8:7447`.
    ///
    /// A program with direct links does not use a router. The endpoint is dialled until the link is up, and again after
    /// the link is lost. [`connect`](Self::connect) does not wait for the link.
    #[must_use]
    pub fn endpoint(mut self, endpoint: impl Into<String>) -> Self {
        self.endpoints.push(endpoint.into());
        self
    }

    /// Adds an endpoint at which this program accepts direct links, such as `tcp/0.0.0.0:7447` or `ble/hci0#name=wombat-1`.
    ///
    /// A program with direct links does not use a router.
    #[must_use]
    pub fn listen(mut self, endpoint: impl Into<String>) -> Self {
        self.listen.push(endpoint.into());
        self
    }

    /// Sets the user name and password; default: the first login of the [login file](Self::login_file), if the file can
    /// be read.
    #[must_use]
    pub fn login(mut self, user: impl Into<String>, password: impl Into<String>) -> Self {
        self.login = Some(Login::given(user, password));
        self
    }

    /// Sets the login file, whose first line of the form `user:password` is the login; default:
    /// [`default_login_file`](Self::default_login_file).
    #[must_use]
    pub fn login_file(mut self, file: impl Into<PathBuf>) -> Self {
        self.login_file = file.into();
        self
    }

    /// Permits connecting to the router of another robot, for programs that use another name on purpose.
    ///
    /// With the access control that `rect-router init` configures, a router drops the messages that such a program
    /// publishes.
    #[must_use]
    pub fn allow_name_mismatch(mut self) -> Self {
        self.allows_name_mismatch = true;
        self
    }

    /// Sets how long [`connect`](Self::connect) waits for the router; default: 5 s, so that a program and its router can be
    /// started at the same time. Direct links ignore it.
    #[must_use]
    pub fn timeout(mut self, timeout: Duration) -> Self {
        self.timeout = timeout;
        self
    }

    /// Sets a value of Zenoh's configuration by its path, such as `("transport/unicast/max_links", 2)`. It overrides the
    /// values that RECT sets.
    #[must_use]
    pub fn zenoh(mut self, key: impl Into<String>, value: impl Into<Value>) -> Self {
        self.zenoh.push((key.into(), value.into()));
        self
    }

    /// Opens the session: connects to the router, or opens the direct links.
    ///
    /// # Errors
    /// [`Error::NoRouter`] if no router replies within the [timeout](Self::timeout), [`Error::LoginRefused`] if the
    /// router rejects the login, [`Error::WrongRobot`] if it serves another robot, [`Error::Option`] if Zenoh rejects
    /// one of the options, [`Error::Runtime`] without tokio's runtime with several threads, [`Error::Thread`] if no thread
    /// can be started, and [`Error::Zenoh`] if the session ends while it is being set up.
    ///
    /// # Cancel safety
    /// If the future is dropped, the session is closed as soon as it has been opened.
    pub async fn connect(self) -> Result<Robot, Error> {
        connect::check_runtime()?;
        if self.links().is_direct() {
            let config = self.config(self.login_or_file().credentials())?;
            let opened = zenoh::open(config).await;
            let session = opened.map_err(|source| Error::Option {
                option: "listen or endpoint",
                value: self.links().locators(),
                source,
            })?;
            let program = self.program_name();
            return Robot::complete(session, self.place, program, None).await;
        }
        let (session, config) = self.join().await?;
        if !self.allows_name_mismatch {
            let tokens = connect::tokens_of_router(&session).await;
            if tokens.is_empty() && connect::is_closed(&session).await {
                return Err(Error::NoRouter {
                    endpoint: self.router.clone(),
                    reason: CLOSED.to_owned(),
                    source: None,
                });
            }
            if let Err(wrong) = self.place.check_router(&self.router, tokens) {
                if let Err(error) = session.close().await {
                    tracing::debug!("cannot close the session: {error}");
                }
                return Err(wrong.into());
            }
        }
        let program = self.program_name();
        Robot::complete(session, self.place, program, Some(config)).await
    }

    fn program_name(&self) -> Option<Name> {
        match &self.program {
            ProgramName::Chosen(name) => name.clone(),
            ProgramName::OfExecutable => {
                let given = std::env::var(PROGRAM_VARIABLE).unwrap_or_default();
                if let Ok(name) = Name::new(&given) {
                    return Some(name);
                }
                let file = std::env::current_exe().ok()?;
                program_name(file.to_str()?)
            }
        }
    }

    /// Opens a session with the router, and returns it with its configuration.
    async fn join(&self) -> Result<(Session, Config), Error> {
        let mut joining = JoinAttempts::new(&self.router, self.login_or_file(), self.timeout);
        let began = Instant::now();
        loop {
            let config = self.config(joining.credentials())?;
            let limit = joining.limit(began.elapsed());
            let source = match connect::open(config.clone(), limit).await? {
                Ok(session) => return Ok((session, config)),
                Err(NotOpened::Zenoh(error)) => Some(error),
                Err(NotOpened::TimedOut) => None,
            };
            let reason = source.as_ref().map(ToString::to_string);
            match joining.on_failure(began.elapsed(), reason.as_deref()) {
                Ok(pause) => tokio::time::sleep(pause).await,
                Err(error) => return Err(self.connect_error(error, source)),
            }
        }
    }

    fn connect_error(&self, error: JoinError, source: Option<zenoh::Error>) -> Error {
        match error {
            JoinError::NoRouter { reason } => Error::NoRouter {
                endpoint: self.router.clone(),
                reason,
                source,
            },
            JoinError::Login(refused) => refused.into(),
        }
    }

    fn links(&self) -> SessionLinks<'_> {
        SessionLinks {
            router: &self.router,
            endpoints: &self.endpoints,
            listen: &self.listen,
        }
    }

    /// Returns Zenoh's configuration, with the login `credentials`.
    fn config(&self, credentials: Option<(&str, &str)>) -> Result<Config, Error> {
        let mut config = Config::default();
        for setting in self.links().settings(credentials, &self.zenoh) {
            let inserted = config.insert_json5(&setting.key, &setting.value.to_string());
            inserted.map_err(|source| Error::Option {
                option: setting.option,
                value: setting.given,
                source,
            })?;
        }
        Ok(config)
    }

    fn login_or_file(&self) -> Login {
        match &self.login {
            Some(login) => login.clone(),
            None => {
                let text = fs::read_to_string(&self.login_file);
                let text = text.as_deref().map_err(ToString::to_string);
                Login::of_file(self.login_file.display().to_string(), text)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options() -> Options {
        Options::new("wombat-1")
            .expect("a name")
            .login_file("/none")
    }

    /// Returns the option and the value that are named in the error about these options.
    fn rejected(options: &Options) -> (&'static str, String) {
        match options.config(None) {
            Err(Error::Option { option, value, .. }) => (option, value),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn debug_output_omits_the_password() {
        let text = format!("{:?}", options().login("fleet", "secret"));
        assert!(text.contains("fleet") && !text.contains("secret"), "{text}");
    }

    #[test]
    fn error_names_the_option_of_an_invalid_locator() {
        let wrong = || "192.168.0.7:7447".to_owned();
        for (options, option) in [
            (options().router(wrong()), "router"),
            (options().endpoint(wrong()), "endpoint"),
            (options().listen(wrong()), "listen"),
        ] {
            assert_eq!(rejected(&options), (option, wrong()));
        }
        let given = options().zenoh("connect/endpoints", wrong());
        let expected = format!("connect/endpoints: {:?}", wrong());
        assert_eq!(rejected(&given), ("zenoh", expected));
    }
}
