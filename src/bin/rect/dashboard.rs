//! Implements `rect dashboard`: serves a page that shows the robots, their links and their data in a browser.
mod browsers;
mod commands;
mod feed;
mod fleet;
mod guard;
mod login;
mod outbox;
mod protocol;
mod recording;
mod server;
mod socket;

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    process::{Command, ExitCode, Stdio},
    sync::Arc,
    time::Duration,
};

use clap::Args;
use rect::{core::session::login::default_file, Robot, Topic};
use tokio::{net::TcpListener, time::interval};

use self::{
    browsers::Browsers, feed::Feeds, guard::Guard, login::Logins, recording::Recording,
    server::Protection,
};
use crate::{session::JoinArguments, Done, Failure};

/// How often the state of a recording is shown.
const SHOWN_EVERY: Duration = Duration::from_secs(1);

/// Show the robots, their links and their data in a browser, until Ctrl-C
///
/// Open the address that is printed. Messages are transmitted only for what a browser shows. Beyond this computer, the page
/// requires a login of the team.
#[derive(Args)]
pub struct DashboardArguments {
    /// The address and port for browsers, such as 0.0.0.0:8080 for all networks
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// Open the page in this computer's browser
    #[arg(long)]
    open: bool,
    /// Show a Stop button, which sends an urgent request to this service of all robots
    #[arg(long, value_name = "SERVICE")]
    stop: Option<Topic>,
    /// Show a Record button, which records this robot's messages to files in this folder
    #[arg(long, value_name = "FOLDER")]
    record: Option<PathBuf>,
    /// Let the page neither publish nor change anything
    #[arg(long)]
    read_only: bool,
    /// Require a login of this file also on this computer [default beyond this computer: $RECT_LOGIN, else /etc/rect/users]
    #[arg(long, value_name = "FILE")]
    logins: Option<PathBuf>,
    /// Encrypt with this certificate, a file in PEM
    #[arg(long, value_name = "FILE", requires = "key")]
    certificate: Option<PathBuf>,
    /// The private key of the certificate, a file in PEM
    #[arg(long, value_name = "FILE", requires = "certificate")]
    key: Option<PathBuf>,
    /// Accept browsers that use this host name, besides those of this computer; can be repeated
    #[arg(long = "name", value_name = "HOST")]
    names: Vec<String>,
    /// Let pages of this site contain parts of the dashboard, such as https://example.org; can be repeated
    #[arg(long = "embed-in", value_name = "ORIGIN")]
    embed_in: Vec<String>,
    #[command(flatten)]
    join: JoinArguments,
}

/// The state that all browsers share.
pub struct App {
    robot: Robot,
    browsers: Arc<Browsers>,
    feeds: Feeds,
    recording: Option<Recording>,
    stop: Option<Topic>,
    read_only: bool,
}

/// Runs `rect dashboard`.
pub async fn run(arguments: DashboardArguments) -> Done {
    let protection = protection(&arguments)?;
    let address = arguments.listen;
    let listener = TcpListener::bind(address).await.map_err(|error| {
        format!("cannot listen on {address}: {error}; choose another address or port with --listen")
    })?;
    let at = listener.local_addr()?;
    let robot = match arguments.read_only {
        true => arguments.join.join_unnamed().await?,
        false => arguments.join.join().await?,
    };
    let folder = arguments.record.as_deref().map(writable).transpose()?;
    let app = Arc::new(App {
        browsers: Arc::default(),
        feeds: Feeds::new(robot.clone()),
        recording: folder.map(|folder| Recording::new(robot.clone(), folder)),
        stop: arguments.stop,
        read_only: arguments.read_only,
        robot,
    });
    let url = url(at, protection.tls.is_some());
    rect::errln!("rect: open {url} in a browser; press Ctrl-C to stop");
    if !at.ip().is_loopback() && protection.tls.is_none() {
        rect::errln!(
            "rect: the connection to browsers is not encrypted: others in the network can read what they show, and the password. \
             Use --certificate and --key"
        );
    }
    if arguments.open {
        open(&url);
    }
    let served = app.clone();
    tokio::spawn(async move { server::serve(listener, served, protection).await });
    let shown = app.clone();
    tokio::spawn(async move { show_recording(&shown).await });
    fleet::observe(app.robot.clone(), app.browsers.clone()).await?;
    rect::errln!("rect: the router has ended the connection");
    Ok(ExitCode::FAILURE)
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

fn protection(arguments: &DashboardArguments) -> Result<Protection, Failure> {
    let tls = match (&arguments.certificate, &arguments.key) {
        (Some(certificate), Some(key)) => Some(server::tls(certificate, key)?),
        _ => None,
    };
    let file = match &arguments.logins {
        Some(file) => Some(file.clone()),
        None if arguments.listen.ip().is_loopback() => None,
        None => {
            Some(default_file(std::env::var(rect::core::session::login::FILE_VARIABLE).ok()).into())
        }
    };
    let logins = file.as_deref().map(Logins::read).transpose();
    let logins = logins.map_err(|error| {
        format!("beyond this computer, the dashboard requires a login: {error}. Name the team's login file with --logins")
    })?;
    Ok(Protection {
        guard: Guard::new(&arguments.names, &arguments.embed_in, tls.is_some())?,
        logins,
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

fn open(url: &str) {
    let opener = if cfg!(target_os = "macos") {
        "open"
    } else {
        "xdg-open"
    };
    let started = Command::new(opener)
        .arg(url)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    if let Err(error) = started {
        rect::errln!("rect: cannot start a browser with {opener}: {error}; open the page yourself");
    }
}
