//! Serves RECT's dashboard, a page that shows the robots, their links and their data in a browser. `rect dashboard` runs it.
//!
//! [`Dashboard::bind`] checks the settings and listens, [`Dashboard::serve`] shows what a robot sees to all browsers.
mod actions;
mod alerts;
mod browsers;
mod commands;
mod feed;
mod fleet;
mod guard;
pub mod hosts;
mod login;
mod logs;
mod outbox;
pub mod permits;
pub mod plot;
pub mod programs;
mod protocol;
mod recording;
mod server;
mod socket;
mod stop;
pub mod topics;

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use rect::Robot;
use tokio::{net::TcpListener, time::interval};

use self::{
    actions::Actions, alerts::Alerts, browsers::Browsers, feed::Feeds, guard::Guard, login::Logins,
    logs::Logs, recording::Recording, server::Protection, stop::StopButton,
};

/// How often the state of a recording is shown.
const SHOWN_EVERY: Duration = Duration::from_secs(1);

/// The error of the dashboard, whose text is for people.
pub type Failure = Box<dyn std::error::Error + Send + Sync>;

/// The settings of a dashboard.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The address and port for browsers.
    pub listen: SocketAddr,
    /// The folder to which the Record button records. `None`: there is no such button.
    pub record: Option<PathBuf>,
    /// Whether the page can neither publish nor change anything.
    pub read_only: bool,
    /// The file of the logins that browsers need. `None`: they need none.
    pub logins: Option<PathBuf>,
    /// The use of the page for which browsers need a login.
    pub login_for: LoginFor,
    /// The certificate and its private key, two files in PEM. `None`: the connections are not encrypted.
    pub certificate: Option<(PathBuf, PathBuf)>,
    /// The host names that browsers may use, besides those of this computer.
    pub names: Vec<String>,
    /// The sites whose pages may contain parts of the dashboard.
    pub embed_in: Vec<String>,
}

/// The use of the page for which browsers need a login.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LoginFor {
    /// For everything. The login file has to exist.
    Everything,
    /// For changes. Without a login file, the robot's router requires no login either, and browsers need none.
    Changes,
}

/// A dashboard that listens, and accepts no browser yet.
pub struct Dashboard {
    listener: TcpListener,
    protection: Protection,
    settings: Settings,
}

/// A dashboard that serves browsers.
pub struct Serving {
    app: Arc<App>,
    url: String,
    is_exposed: bool,
}

/// The state that all browsers share.
struct App {
    robot: Robot,
    browsers: Arc<Browsers>,
    feeds: Feeds,
    logs: Logs,
    alerts: Arc<Alerts>,
    actions: Arc<Actions>,
    recording: Option<Recording>,
    stop: Arc<StopButton>,
    read_only: bool,
}

impl Dashboard {
    /// Reads the files of the settings, and listens for browsers.
    ///
    /// # Errors
    /// Fails if a file cannot be read, a value is invalid, or another program uses the address.
    pub async fn bind(settings: Settings) -> Result<Self, Failure> {
        let protection = protection(&settings)?;
        let address = settings.listen;
        let listener = TcpListener::bind(address).await.map_err(|error| {
            format!(
                "cannot listen on {address}: {error}; choose another address or port with --listen"
            )
        })?;
        Ok(Self {
            listener,
            protection,
            settings,
        })
    }

    /// Serves browsers what `robot` sees. Requires tokio's runtime.
    ///
    /// # Errors
    /// Fails if the folder of the recordings cannot be created.
    pub fn serve(self, robot: Robot) -> Result<Serving, Failure> {
        let at = self.listener.local_addr()?;
        let folder = self.settings.record.as_deref().map(writable).transpose()?;
        let is_tls = self.protection.tls.is_some();
        let browsers = Arc::<Browsers>::default();
        let app = Arc::new(App {
            stop: StopButton::new(robot.clone(), browsers.clone()),
            alerts: Alerts::new(robot.clone(), browsers.clone()),
            actions: Actions::new(robot.clone(), browsers.clone()),
            browsers,
            feeds: Feeds::new(robot.clone()),
            logs: Logs::new(robot.clone()),
            recording: folder.map(|folder| Recording::new(robot.clone(), folder)),
            read_only: self.settings.read_only,
            robot,
        });
        let served = app.clone();
        tokio::spawn(async move { server::serve(self.listener, served, self.protection).await });
        let stop = app.stop.clone();
        tokio::spawn(async move { stop.run().await });
        let alerts = app.alerts.clone();
        tokio::spawn(async move { alerts.run().await });
        let actions = app.actions.clone();
        tokio::spawn(async move { actions.run().await });
        let shown = app.clone();
        tokio::spawn(async move { show_recording(&shown).await });
        Ok(Serving {
            app,
            url: url(at, is_tls),
            is_exposed: !at.ip().is_loopback() && !is_tls,
        })
    }
}

impl Serving {
    /// Returns the address of the page on this computer.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Returns whether other computers can open the page over a connection that is not encrypted.
    pub fn is_exposed(&self) -> bool {
        self.is_exposed
    }

    /// Keeps browsers informed about the fleet until the robot's session is closed.
    ///
    /// # Errors
    /// Fails if the session is closed already.
    pub async fn until_closed(self) -> Result<(), rect::Error> {
        fleet::observe(self.app).await
    }
}

async fn show_recording(app: &App) {
    let Some(recording) = &app.recording else {
        return;
    };
    let mut tick = interval(SHOWN_EVERY);
    loop {
        tick.tick().await;
        recording.show(&app.browsers).await;
    }
}

fn protection(settings: &Settings) -> Result<Protection, Failure> {
    let tls = match &settings.certificate {
        Some((certificate, key)) => Some(server::tls(certificate, key)?),
        None => None,
    };
    let logins = match (&settings.logins, settings.login_for) {
        (None, _) => None,
        (Some(file), LoginFor::Changes) => Logins::read(file).ok(),
        (Some(file), LoginFor::Everything) => Some(Logins::read(file).map_err(|error| {
            format!("beyond this computer, the dashboard requires a login: {error}. Name the team's login file with --logins")
        })?),
    };
    Ok(Protection {
        guard: Guard::new(&settings.names, &settings.embed_in, tls.is_some())?,
        logins,
        login_for: settings.login_for,
        tls,
    })
}

fn writable(folder: &Path) -> Result<PathBuf, Failure> {
    std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    Ok(folder.to_owned())
}

/// Returns the address of the page on this computer.
fn url(at: SocketAddr, is_tls: bool) -> String {
    let scheme = if is_tls { "https" } else { "http" };
    match at.ip().is_unspecified() {
        true => format!("{scheme}://localhost:{}", at.port()),
        false => format!("{scheme}://{at}"),
    }
}
