//! Owns `rect-router init`: a robot's folder of configuration, safe from the first start.
use std::{
    env,
    fs::{self, OpenOptions},
    io::{self, Write},
    os::unix::fs::{OpenOptionsExt, PermissionsExt},
    path::{Path, PathBuf},
};

use rect::core::{login, name::Name};

use super::{
    service::{self, Owner},
    Failure, InitArgs,
};
use crate::config::MAX_SOCKET_PATH;

/// The shipped configurations, and the name that each is written for.
const ROBOT: (&str, &str) = (include_str!("../../../config/robot.json5"), "wombat-1");
const BASE_STATION: (&str, &str) = (
    include_str!("../../../config/base-station.json5"),
    "base-station",
);
/// The fleet that both are written for.
const ITS_FLEET: &str = "\"rect/";
/// The socket file that both are written for: systemd makes its folder for the installed service, and nobody else does.
const SERVICE_SOCKET: &str = "unixsock-stream//run/rect/router.sock";
/// The TCP listener that both are written for.
const ITS_LISTENER: &str = "tcp/127.0.0.1:7447";
/// Characters that a path in an endpoint cannot have: they end it there.
const NOT_IN_A_PATH: [char; 4] = ['#', '?', ';', '|'];
/// As whom a robot logs in where it dials, and as whom a base station does, which may change settings there.
const LOGINS: [&str; 2] = ["fleet", "config"];
const NO_CONNECTIONS: &str =
    "// Connections with names: config/README.md.\n{\n  \"connections\": [\n  ],\n}\n";
/// Of the password: more than anybody can try out.
const SECRET_BYTES: usize = 18;
/// For the router and the members of its group.
const PRIVATE: u32 = 0o640;
const PRIVATE_FOLDER: u32 = 0o750;

pub fn run(args: &InitArgs) -> Result<(), Failure> {
    for (what, name) in [("robot", &args.robot), ("--fleet", &args.fleet)] {
        Name::new(name).map_err(|error| format!("{what}: {error}"))?;
    }
    let users = match &args.users {
        Some(path) => fs::read_to_string(path)
            .map_err(|error| format!("{} can't be read: {error}", path.display()))?,
        None => {
            let login = |user| Ok(format!("{user}:{}\n", secret()?));
            LOGINS
                .into_iter()
                .map(login)
                .collect::<Result<_, Failure>>()?
        }
    };
    let folder = folder(&args.folder)?;
    let installed = service::is_installed_for(&folder);
    if args.start && !installed {
        return Err(service::NOT_INSTALLED.into());
    }
    let state = if installed {
        Path::new(service::STATE)
    } else {
        &folder
    };
    let login_as = login_as(args, &users);
    let (root, router) = (Owner::root(), Owner::router());
    let files = [
        (folder.join("users"), users, &root),
        // The config service writes it, and what is beside it.
        (
            state.join("connections.json"),
            NO_CONNECTIONS.to_owned(),
            &router,
        ),
        (
            folder.join("robot.json5"),
            robot(args, &folder, state, login_as),
            &root,
        ),
    ];
    // None is touched if one is there already.
    for (path, ..) in &files {
        if path.exists() {
            return Err(format!("{} is there already; nothing was changed", path.display()).into());
        }
    }
    make_folder(&folder).map_err(|error| not_made(&folder, &error))?;
    for (path, text, owner) in files {
        write(&path, &text, owner).map_err(|error| not_made(&path, &error))?;
        rect::outln!("wrote {}", path.display());
    }
    if args.start {
        service::start()?;
        rect::outln!("the router runs, and will at each boot: systemctl status rect-router");
    } else if installed {
        rect::outln!("start it with: systemctl enable --now rect-router");
    } else {
        let config = quoted(&folder.join("robot.json5").display().to_string());
        rect::outln!("start it with: {} -c {config}", program());
    }
    if args.users.is_none() {
        let users = folder.join("users");
        rect::outln!(
            "the team's other robots need the same login: copy {} to them and give it as --users",
            users.display()
        );
    }
    Ok(())
}

/// Returns the folder as an absolute path: the router may be started elsewhere.
fn folder(given: &Path) -> Result<PathBuf, Failure> {
    let folder = std::path::absolute(given)
        .map_err(|error| format!("--folder {}: {error}", given.display()))?;
    let is_wrong = |c: char| c.is_control() || NOT_IN_A_PATH.contains(&c);
    match folder.to_str() {
        Some(text) if !text.contains(is_wrong) => Ok(folder),
        _ => Err(format!(
            "--folder {}: its name must be text without control characters and without any of {}, which a configuration \
             cannot hold; choose another folder",
            given.display(),
            NOT_IN_A_PATH.map(String::from).join(" ")
        )
        .into()),
    }
}

fn not_made(path: &Path, error: &io::Error) -> String {
    let advice = match error.kind() {
        io::ErrorKind::PermissionDenied => {
            "; run it as root (sudo), or choose a folder of your own, such as --folder ~/rect"
        }
        _ => "",
    };
    format!("{} can't be made: {error}{advice}", path.display())
}

/// Returns what starts this program again: its name if that was found by the shell's `PATH`, its path otherwise.
fn program() -> String {
    let name = env!("CARGO_PKG_NAME");
    let Ok(own) = env::current_exe() else {
        return name.to_owned();
    };
    let path = env::var_os("PATH").unwrap_or_default();
    let found = env::split_paths(&path)
        .map(|folder| folder.join(name))
        .find(|program| program.is_file());
    let is_own = found
        .and_then(|found| fs::canonicalize(found).ok())
        .is_some_and(|found| fs::canonicalize(&own).is_ok_and(|own| own == found));
    match is_own {
        true => name.to_owned(),
        false => quoted(&own.display().to_string()),
    }
}

/// Returns the text as a shell takes it for one word.
fn quoted(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "/._-+=:,@%".contains(c);
    match !text.is_empty() && text.chars().all(is_plain) {
        true => text.to_owned(),
        false => format!("'{}'", text.replace('\'', r"'\''")),
    }
}

/// As itself, where the team has given each robot a login of its own; else as the team's file lets it.
fn login_as<'a>(args: &'a InitArgs, users: &str) -> Option<&'a str> {
    let [fleet, config] = LOGINS;
    let of_all = if args.base_station { config } else { fleet };
    [args.robot.as_str(), of_all]
        .into_iter()
        .find(|user| login::logins(users).any(|(name, _)| name == *user))
}

/// The shipped configuration with this robot's name, fleet, adapter, port and folders.
fn robot(args: &InitArgs, folder: &Path, state: &Path, login_as: Option<&str>) -> String {
    let login_as = login_as.map_or_else(String::new, |user| format!(", login_as: {}", json(user)));
    let settings = format!(
        "  // RECT's own: this robot's name in keys, its named connections, and as whom it logs in where it dials.\n  plugins: {{\n    \
         rect: {{ fleet: \"{}\", robot: \"{}\", connections: {}{login_as} }},\n  }},\n}}\n",
        args.fleet,
        args.robot,
        json(&state.join("connections.json").display().to_string()),
    );
    let (template, its_name) = if args.base_station {
        BASE_STATION
    } else {
        ROBOT
    };
    let text = template
        .replace(its_name, &args.robot)
        .replace(ITS_FLEET, &format!("\"{}/", args.fleet))
        .replace(ITS_LISTENER, &format!("tcp/127.0.0.1:{}", args.port))
        .replace("ble/hci0", &format!("ble/{}", args.adapter))
        .replace(
            "/etc/rect/robot.json5",
            &folder.join("robot.json5").display().to_string(),
        )
        .replace(
            "/etc/rect/users",
            &escaped(&folder.join("users").display().to_string()),
        );
    let text = if service::is_installed_for(folder) {
        text
    } else {
        with_socket_in(folder, &text)
    };
    let body = text.trim_end().strip_suffix('}').unwrap_or(&text);
    format!("{body}\n{settings}")
}

/// Puts the socket file into the folder, or leaves that listener out if its path would be longer than the system takes.
fn with_socket_in(folder: &Path, text: &str) -> String {
    let socket = folder.join("router.sock").display().to_string();
    if socket.len() <= MAX_SOCKET_PATH {
        let listener = format!("unixsock-stream/{}", escaped(&socket));
        return text.replace(SERVICE_SOCKET, &listener);
    }
    let mut lines: Vec<_> = text.lines().collect();
    if let Some(at) = lines.iter().position(|line| line.contains(SERVICE_SOCKET)) {
        lines.remove(at);
        if at > 0 {
            lines[at - 1] = "      // (No socket file: the path of one in this folder would be longer than the system takes.)";
        }
    }
    lines.join("\n")
}

/// The text as a string of JSON.
fn json(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// The text as it stands within the quotes of a string of JSON.
fn escaped(text: &str) -> String {
    let text = json(text);
    text[1..text.len() - 1].to_owned()
}

fn secret() -> Result<String, Failure> {
    use base64::Engine;
    let mut bytes = [0; SECRET_BYTES];
    getrandom::fill(&mut bytes).map_err(|error| format!("no random numbers: {error}"))?;
    Ok(base64::engine::general_purpose::STANDARD_NO_PAD.encode(bytes))
}

fn make_folder(folder: &Path) -> io::Result<()> {
    if folder.is_dir() {
        return Ok(());
    }
    fs::create_dir_all(folder)?;
    Owner::root().give(folder)?;
    fs::set_permissions(folder, fs::Permissions::from_mode(PRIVATE_FOLDER))
}

fn write(path: &Path, text: &str, owner: &Owner) -> io::Result<()> {
    let mut options = OpenOptions::new();
    let mut file = options
        .write(true)
        .create_new(true)
        .mode(PRIVATE)
        .open(path)?;
    file.write_all(text.as_bytes())?;
    owner.give(path)?;
    // Whatever the umask is.
    file.set_permissions(fs::Permissions::from_mode(PRIVATE))?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shell_takes_a_quoted_path_for_one_word() {
        assert_eq!(quoted("/etc/rect/robot.json5"), "/etc/rect/robot.json5");
        assert_eq!(quoted("/home/a b"), "'/home/a b'");
        assert_eq!(quoted("it's"), r"'it'\''s'");
    }

    #[test]
    fn a_socket_file_whose_path_is_too_long_is_left_out() {
        for template in [ROBOT.0, BASE_STATION.0] {
            let text = with_socket_in(Path::new("/home/me"), template);
            assert!(text.contains("\"unixsock-stream//home/me/router.sock\""));
            let folder = format!("/{}", "long".repeat(40));
            let text = with_socket_in(Path::new(&folder), template);
            assert!(!text.contains("unixsock-stream/"), "{text}");
            zenoh::Config::from_json5(&text).expect("valid");
        }
    }
}
