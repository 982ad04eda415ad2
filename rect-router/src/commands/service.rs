//! Starts the installed systemd service, and sets the owner of its files.
use std::{
    io,
    os::unix::fs::chown,
    path::Path,
    process::{Command, Stdio},
};

use nix::unistd::{geteuid, Gid, Group, Uid, User};

use super::Failure;

/// The folder that the service may write to, as in packaging/systemd/rect-router.service.
pub const STATE_FOLDER: &str = "/var/lib/rect";
/// The folder of the socket file, which systemd creates when the service starts.
pub const RUNTIME_FOLDER: &str = "/run/rect";
/// The folder from which the service reads its configuration.
const CONFIGURATION_FOLDER: &str = "/etc/rect";
const UNIT: &str = "rect-router.service";
/// The user and the group that the package creates.
const ROUTER_USER: &str = "rect";

/// The error message for a service that is not installed.
pub const NOT_INSTALLED: &str =
    "--start: no installed service uses this folder; install the package `rect` \
     (docs/how-to/laptop.md), or start the router yourself: rect-router -c <folder>/robot.json5";

/// Returns whether a service is installed that reads its configuration from `folder`.
pub fn is_installed_for(folder: &Path) -> bool {
    let units = [
        "/etc/systemd/system",
        "/usr/lib/systemd/system",
        "/lib/systemd/system",
    ];
    folder == Path::new(CONFIGURATION_FOLDER)
        && Path::new(STATE_FOLDER).is_dir()
        && units
            .iter()
            .any(|units| Path::new(units).join(UNIT).exists())
}

/// Starts the service now and at each boot, and waits until it is up.
///
/// # Errors
/// Fails if systemd cannot start the service.
pub fn start() -> Result<(), Failure> {
    let started = Command::new("systemctl")
        .args(["enable", "--now", UNIT])
        .stdin(Stdio::null())
        .status()
        .map_err(|error| format!("cannot run systemctl: {error}"))?;
    if started.success() {
        return Ok(());
    }
    Err("the configuration is written, but the router does not start; `journalctl -u rect-router -n 20` shows the reason, \
         and `rect doctor` gives advice. systemd retries every 2 s"
        .into())
}

/// The owner and the group to set on a file. `None`, which changes nothing, unless root runs this program and the router's
/// group exists.
pub struct Owner(Option<(Option<Uid>, Gid)>);

impl Owner {
    /// Returns root as the owner, so that the router can only read the file.
    pub fn root() -> Self {
        Self(group().map(|group| (None, group)))
    }

    /// Returns the router's user as the owner, so that the router can write the file.
    pub fn router() -> Self {
        let user = User::from_name(ROUTER_USER).ok().flatten();
        Self(group().map(|group| (user.map(|user| user.uid), group)))
    }

    /// Sets owner and group of the file at `path`.
    ///
    /// # Errors
    /// The error of the system.
    pub fn set_on(&self, path: &Path) -> io::Result<()> {
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
    let group = Group::from_name(ROUTER_USER).ok().flatten();
    group.map(|group| group.gid)
}
