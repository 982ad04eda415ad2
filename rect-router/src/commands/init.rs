//! Implements `rect-router init`: writes the configuration, login file and connections file of a robot.
use std::{
    env,
    fs::{self, OpenOptions},
    io::{self, Write},
    os::unix::fs::{OpenOptionsExt, PermissionsExt},
    path::{Path, PathBuf},
};

use rect_core::{name::Name, session::login};
use zenoh_link_ble::secret_file;

use super::{
    cloud,
    service::{self, Owner},
    Failure,
};
use crate::{args::InitArgs, config::MAX_SOCKET_PATH};

/// The shipped configurations, each with the robot's name that it contains.
const ROBOT: (&str, &str) = (include_str!("../../../config/robot.json5"), "wombat-1");
const BASE_STATION: (&str, &str) = (
    include_str!("../../../config/base-station.json5"),
    "base-station",
);
/// The fleet that both configurations contain.
const TEMPLATE_FLEET: &str = "\"rect/";
/// The socket file that both configurations contain. Its folder is created by systemd, for the installed service only.
const SERVICE_SOCKET: &str = "unixsock-stream//run/rect/router.sock";
/// The TCP listener that both configurations contain.
const TEMPLATE_LISTENER: &str = "tcp/127.0.0.1:7447";
/// Characters that would end a path in an endpoint.
const FORBIDDEN_IN_PATH: [char; 4] = ['#', '?', ';', '|'];
/// The users of a new login file. Robots log in as the first one when they dial, base stations as the second one, which may
/// change the connections of robots.
const LOGINS: [&str; 2] = ["fleet", "config"];
/// Number of random bytes in a password, too many for a brute-force search.
const SECRET_BYTES: usize = 18;
/// Permissions of files and folders: for the owner and the router's group.
const PRIVATE_MODE: u32 = 0o640;
const PRIVATE_FOLDER_MODE: u32 = 0o750;

/// Writes the files, and starts the service if requested.
///
/// # Errors
/// Fails if a name is invalid, if one of the files exists already, if a file cannot be written, or if the service cannot be
/// started. No existing file is changed.
pub fn run(args: &InitArgs) -> Result<(), Failure> {
    let names = [("robot", &args.robot), ("--fleet", &args.fleet)];
    let fleets = args.fleets.iter().map(|fleet| ("--fleets", fleet));
    for (argument, name) in names.into_iter().chain(fleets) {
        Name::new(name).map_err(|error| format!("{argument}: {error}"))?;
    }
    cloud::check(&args.fleets)?;
    let users = match &args.users {
        Some(path) => {
            let text = fs::read_to_string(path).map_err(|error| {
                format!("cannot read the login file {}: {error}", path.display())
            })?;
            // With a shorter secret, the router would not start.
            if args.fleets.is_empty() {
                secret_file::of_text(path, text.as_bytes())?;
            }
            text
        }
        None => {
            let login = |user| Ok(format!("{user}:{}\n", secret()?));
            let users = match args.fleets.as_slice() {
                [] => LOGINS.to_vec(),
                fleets => fleets.iter().map(String::as_str).collect(),
            };
            users
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
        Path::new(service::STATE_FOLDER)
    } else {
        &folder
    };
    let text = if args.fleets.is_empty() {
        let login_as = login_as(args, &users)?;
        configuration(args, &folder, state, login_as)
    } else {
        for_this_computer(&cloud::configuration(&args.fleets), args, &folder)
    };
    let (root, router) = (Owner::root(), Owner::router());
    let mut files = vec![(folder.join("users"), users, &root)];
    if args.fleets.is_empty() {
        // The config service writes this file and temporary files beside it.
        let text = connections(args.cloud.as_deref())?;
        files.push((state.join("connections.json"), text, &router));
    }
    files.push((folder.join("robot.json5"), text, &root));
    // If one of the files exists, none is written.
    for (path, ..) in &files {
        if path.exists() {
            return Err(format!(
                "{} already exists; nothing was changed. Remove it, or choose another folder with --folder",
                path.display()
            )
            .into());
        }
    }
    make_folder(&folder).map_err(|error| cannot_create(&folder, &error))?;
    for (path, text, owner) in files {
        write(&path, &text, owner).map_err(|error| cannot_create(&path, &error))?;
        rect_terminal::outln!("wrote {}", path.display());
    }
    if args.start {
        service::start()?;
        rect_terminal::outln!(
            "the router is running, and starts at each boot: systemctl status rect-router"
        );
    } else if installed {
        rect_terminal::outln!("start it with: systemctl enable --now rect-router");
    } else {
        let config = quoted(&folder.join("robot.json5").display().to_string());
        rect_terminal::outln!("start it with: {} -c {config}", program());
    }
    let users = folder.join("users");
    if !args.fleets.is_empty() {
        rect_terminal::outln!(
            "give each fleet its line of {}, and let it connect to this router: docs/how-to/cloud.md",
            users.display()
        );
    } else if args.users.is_none() {
        rect_terminal::outln!(
            "the other robots of the team need the same login: copy {} to them and give it with --users",
            users.display()
        );
    }
    if args.base_station {
        rect_terminal::outln!(
            "to link robots over Wi-Fi, too, add a listener with TLS: docs/how-to/security.md"
        );
    }
    Ok(())
}

/// Returns the folder as an absolute path, because the router may be started in another folder.
fn folder(given: &Path) -> Result<PathBuf, Failure> {
    let folder = std::path::absolute(given)
        .map_err(|error| format!("--folder {}: {error}", given.display()))?;
    let is_wrong = |c: char| c.is_control() || FORBIDDEN_IN_PATH.contains(&c);
    match folder.to_str() {
        Some(text) if !text.contains(is_wrong) => Ok(folder),
        _ => Err(format!(
            "--folder {}: its name must be text without control characters and without any of {}, which a configuration \
             cannot hold; choose another folder",
            given.display(),
            FORBIDDEN_IN_PATH.map(String::from).join(" ")
        )
        .into()),
    }
}

fn cannot_create(path: &Path, error: &io::Error) -> String {
    let advice = match error.kind() {
        io::ErrorKind::PermissionDenied => {
            "; run this command as root (sudo), or choose a folder of your own, such as --folder ~/rect"
        }
        _ => "",
    };
    format!("cannot create {}: {error}{advice}", path.display())
}

/// Returns the command that runs this program: its name if the shell finds it in `PATH`, otherwise its path.
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

/// Quotes a text for a shell, if necessary.
fn quoted(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "/._-+=:,@%".contains(c);
    match !text.is_empty() && text.chars().all(is_plain) {
        true => text.to_owned(),
        false => format!("'{}'", text.replace('\'', r"'\''")),
    }
}

/// Returns the user to log in as: the fleet's name if the router connects to one that many fleets share. Otherwise the robot's
/// name if the login file has that user, or else the common user of robots or base stations if the file has it.
fn login_as<'a>(args: &'a InitArgs, users: &str) -> Result<Option<&'a str>, Failure> {
    let has = |user: &str| login::logins(users).any(|(name, _)| name == user);
    if args.cloud.is_some() {
        return match has(&args.fleet) {
            true => Ok(Some(&args.fleet)),
            false => Err(format!(
                "--cloud: the login file has no line `{0}:<password>`, with which the fleet {0} logs in there; add the line that \
                 the owner of that router has given you, and give the file with --users",
                args.fleet
            )
            .into()),
        };
    }
    let [fleet, config] = LOGINS;
    let of_all = if args.base_station { config } else { fleet };
    Ok([args.robot.as_str(), of_all]
        .into_iter()
        .find(|user| has(user)))
}

/// Returns the text of a new connections file, with the connection to a router that many fleets share, if there is one.
fn connections(cloud: Option<&str>) -> Result<String, Failure> {
    let first = match cloud {
        Some(endpoint) => format!("    {},\n", cloud::connection(endpoint)?),
        None => String::new(),
    };
    Ok(format!(
        "// Named connections: see docs/reference/configuration.md.\n{{\n  \"connections\": [\n{first}  ],\n}}\n"
    ))
}

/// Returns the shipped configuration with this robot's name, fleet, adapter, port and folders.
fn configuration(args: &InitArgs, folder: &Path, state: &Path, login_as: Option<&str>) -> String {
    let login_as = login_as.map_or_else(String::new, |user| format!(", login_as: {}", json(user)));
    let region = args.cloud.as_ref().map_or_else(String::new, |_| {
        format!(
            "  // The region of the router that many fleets share.\n  region_name: \"{}\",\n\n",
            args.fleet
        )
    });
    let settings = format!(
        "{region}  // RECT's own settings: the fleet and this robot's name, its named connections, and the user as which it logs in.\n  plugins: {{\n    \
         rect: {{ fleet: \"{}\", robot: \"{}\", connections: {}{login_as} }},\n  }},\n}}\n",
        args.fleet,
        args.robot,
        json(&state.join("connections.json").display().to_string()),
    );
    let (template, template_name) = if args.base_station {
        BASE_STATION
    } else {
        ROBOT
    };
    let text = template
        .replace(template_name, &args.robot)
        .replace(TEMPLATE_FLEET, &format!("\"{}/", args.fleet));
    let text = for_this_computer(&text, args, folder);
    let body = text.trim_end().strip_suffix('}').unwrap_or(&text);
    format!("{body}\n{settings}")
}

/// Replaces the adapter, port and folders of a shipped configuration.
fn for_this_computer(template: &str, args: &InitArgs, folder: &Path) -> String {
    let text = template
        .replace(TEMPLATE_LISTENER, &format!("tcp/127.0.0.1:{}", args.port))
        .replace("any/hci0", &format!("any/{}", args.adapter))
        .replace(
            "/etc/rect/robot.json5",
            &folder.join("robot.json5").display().to_string(),
        )
        .replace(
            "/etc/rect/users",
            &escaped(&folder.join("users").display().to_string()),
        );
    if service::is_installed_for(folder) {
        text
    } else {
        with_socket_in(folder, &text)
    }
}

/// Moves the socket file to the folder, or removes that listener if its path would exceed the system's limit.
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
            lines[at - 1] = "      // (No socket file: its path in this folder would exceed the system's limit.)";
        }
    }
    lines.join("\n")
}

/// Returns the text as a JSON string.
fn json(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// Returns the text as a JSON string without its quotes.
fn escaped(text: &str) -> String {
    let text = json(text);
    text[1..text.len() - 1].to_owned()
}

fn secret() -> Result<String, Failure> {
    use base64::Engine;
    let mut bytes = [0; SECRET_BYTES];
    getrandom::fill(&mut bytes)
        .map_err(|error| format!("cannot get random numbers from the system: {error}"))?;
    Ok(base64::engine::general_purpose::STANDARD_NO_PAD.encode(bytes))
}

fn make_folder(folder: &Path) -> io::Result<()> {
    if folder.is_dir() {
        return Ok(());
    }
    fs::create_dir_all(folder)?;
    Owner::root().set_on(folder)?;
    fs::set_permissions(folder, fs::Permissions::from_mode(PRIVATE_FOLDER_MODE))
}

fn write(path: &Path, text: &str, owner: &Owner) -> io::Result<()> {
    let mut options = OpenOptions::new();
    let mut file = options
        .write(true)
        .create_new(true)
        .mode(PRIVATE_MODE)
        .open(path)?;
    file.write_all(text.as_bytes())?;
    owner.set_on(path)?;
    // The mode above is reduced by the umask.
    file.set_permissions(fs::Permissions::from_mode(PRIVATE_MODE))?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quotes_paths_for_a_shell() {
        assert_eq!(quoted("/etc/rect/robot.json5"), "/etc/rect/robot.json5");
        assert_eq!(quoted("/home/a b"), "'/home/a b'");
        assert_eq!(quoted("it's"), r"'it'\''s'");
    }

    #[test]
    fn omits_a_socket_file_whose_path_is_too_long() {
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
