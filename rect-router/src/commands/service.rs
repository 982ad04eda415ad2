//! Owns what the commands know of the installed service: whose its files are, and starting it.
use std::{
    io,
    os::unix::fs::chown,
    path::Path,
    process::{Command, Stdio},
};

use nix::unistd::{geteuid, Gid, Group, Uid, User};

use super::Failure;

/// Where the router may write, as packaging/systemd/rect-router.service says.
pub const STATE: &str = "/var/lib/rect";
/// The folder of its socket file, which systemd makes when the service starts.
pub const RUNTIME: &str = "/run/rect";
/// Where the service reads its configuration.
const CONFIGURATION: &str = "/etc/rect";
const UNIT: &str = "rect-router.service";
/// The user and the group that the package makes.
const ROUTER: &str = "rect";

/// What to say to who asks for a service that is not there.
pub const NOT_INSTALLED: &str =
    "--start: there is no service that reads that folder; install the package `rect` \
     (docs/install.md), or start the router yourself: rect-router -c <folder>/robot.json5";

/// Whether the service's configuration is in that folder.
pub fn is_installed_for(folder: &Path) -> bool {
    let units = [
        "/etc/systemd/system",
        "/usr/lib/systemd/system",
        "/lib/systemd/system",
    ];
    folder == Path::new(CONFIGURATION)
        && Path::new(STATE).is_dir()
        && units
            .iter()
            .any(|units| Path::new(units).join(UNIT).exists())
}

/// Starts it, now and at each boot; returns when it is up.
pub fn start() -> Result<(), Failure> {
    let started = Command::new("systemctl")
        .args(["enable", "--now", UNIT])
        .stdin(Stdio::null())
        .status()
        .map_err(|error| format!("systemctl can't be run: {error}"))?;
    if started.success() {
        return Ok(());
    }
    Err("the configuration is written, but the router does not start; why: journalctl -u rect-router -n 20, \
         and what to do: rect doctor. It is started again every 2 s"
        .into())
}

/// To whom a file is given: nobody, unless root writes it and there is the router's group.
pub struct Owner(Option<(Option<Uid>, Gid)>);

impl Owner {
    /// The router may read it.
    pub fn root() -> Self {
        Self(group().map(|group| (None, group)))
    }

    /// The router may write it.
    pub fn router() -> Self {
        let user = User::from_name(ROUTER).ok().flatten();
        Self(group().map(|group| (user.map(|user| user.uid), group)))
    }

    /// Gives it to them.
    pub fn give(&self, path: &Path) -> io::Result<()> {
        let Some((user, group)) = self.0 else {
            return Ok(());
        };
        chown(path, user.map(Uid::as_raw), Some(group.as_raw()))
    }
}

fn group() -> Option<Gid> {
    if !geteuid().is_root() {
        return None;
    }
    let group = Group::from_name(ROUTER).ok().flatten();
    group.map(|group| group.gid)
}
