//! Implements `rect dashboard`: serves a page that shows the robots, their links and their data in a browser.
use std::{
    net::SocketAddr,
    path::PathBuf,
    process::{Command, ExitCode, Stdio},
};

use clap::Args;
use rect_core::session::login::{default_file, FILE_VARIABLE};
use rect_dashboard::{Dashboard, LoginFor, Settings};
use rect_terminal::errln;

use crate::{session::JoinArguments, Done};

/// Show the robots, their links and their data in a browser, until Ctrl-C
///
/// Open the address that is printed. Messages are transmitted only for what a browser shows. Beyond this computer, the page
/// requires a login of the team. On this computer, changes require one if there is a login file.
#[derive(Args)]
pub struct DashboardArguments {
    /// The address and port for browsers, such as 0.0.0.0:8080 for all networks
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// Open the page in this computer's browser
    #[arg(long)]
    open: bool,
    /// The service that the Stop button called in earlier versions
    #[arg(long, hide = true, value_name = "SERVICE")]
    stop: Option<String>,
    /// Show a Record button, which records this robot's messages to files in this folder
    #[arg(long, value_name = "FOLDER")]
    record: Option<PathBuf>,
    /// Let the page neither publish nor change anything
    #[arg(long)]
    read_only: bool,
    /// Require a login of this file, also to look at the page on this computer [default beyond this computer: $RECT_LOGIN, else /etc/rect/users]
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

impl DashboardArguments {
    fn settings(&self) -> Settings {
        let (logins, login_for) = match &self.logins {
            Some(file) => (Some(file.clone()), LoginFor::Everything),
            None if !self.listen.ip().is_loopback() => {
                let file = default_file(std::env::var(FILE_VARIABLE).ok());
                (Some(file.into()), LoginFor::Everything)
            }
            None if self.read_only => (None, LoginFor::Changes),
            None => (Some(self.join.login_file()), LoginFor::Changes),
        };
        Settings {
            listen: self.listen,
            record: self.record.clone(),
            read_only: self.read_only,
            logins,
            login_for,
            certificate: self.certificate.clone().zip(self.key.clone()),
            names: self.names.clone(),
            embed_in: self.embed_in.clone(),
        }
    }
}

/// Runs `rect dashboard`.
pub async fn run(arguments: DashboardArguments) -> Done {
    if let Some(service) = &arguments.stop {
        // A team that relies on the service must learn that nothing calls it any more.
        return Err(format!(
            "leave out --stop: the page always has a Stop button now. It does not call the service {service}; it stops the robots \
             whose programs take part in the stop of the fleet (docs/how-to/dashboard.md)"
        )
        .into());
    }
    let dashboard = Dashboard::bind(arguments.settings()).await?;
    let robot = match arguments.read_only {
        true => arguments.join.join_unnamed().await?,
        false => arguments.join.join().await?,
    };
    let serving = dashboard.serve(robot)?;
    let url = serving.url();
    errln!("rect: open {url} in a browser; press Ctrl-C to stop");
    if serving.is_exposed() {
        errln!(
            "rect: the connection to browsers is not encrypted: others in the network can read what they show, and the password. \
             Use --certificate and --key"
        );
    }
    if arguments.open {
        open(url);
    }
    serving.until_closed().await?;
    errln!("rect: the router has ended the connection");
    Ok(ExitCode::FAILURE)
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
        errln!("rect: cannot start a browser with {opener}: {error}; open the page yourself");
    }
}
