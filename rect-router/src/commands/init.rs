//! Owns `rect-router init`: a robot's folder of configuration, safe from the first start.
use std::{
    fs::{self, OpenOptions},
    io::{self, Write},
    os::unix::fs::{OpenOptionsExt, PermissionsExt},
    path::Path,
};

use rect::core::{login, name::Name};

use super::{
    service::{self, Owner},
    Failure, InitArgs,
};

/// The shipped configurations, and the name that each is written for.
const ROBOT: (&str, &str) = (include_str!("../../../config/robot.json5"), "wombat-1");
const BASE_STATION: (&str, &str) = (
    include_str!("../../../config/base-station.json5"),
    "base-station",
);
/// The fleet that both are written for.
const ITS_FLEET: &str = "\"rect/";
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
    let installed = service::is_installed_for(&args.folder);
    if args.start && !installed {
        return Err(service::NOT_INSTALLED.into());
    }
    let state = if installed {
        Path::new(service::STATE)
    } else {
        &args.folder
    };
    let login_as = login_as(args, &users);
    let (root, router) = (Owner::root(), Owner::router());
    let files = [
        (args.folder.join("users"), users, &root),
        // The config service writes it, and what is beside it.
        (
            state.join("connections.json"),
            NO_CONNECTIONS.to_owned(),
            &router,
        ),
        (
            args.folder.join("robot.json5"),
            robot(args, state, login_as),
            &root,
        ),
    ];
    // None is touched if one is there already.
    for (path, ..) in &files {
        if path.exists() {
            return Err(format!("{} is there already; nothing was changed", path.display()).into());
        }
    }
    make_folder(&args.folder)
        .map_err(|error| format!("{} can't be made: {error}", args.folder.display()))?;
    for (path, text, owner) in files {
        write(&path, &text, owner).map_err(|error| format!("{}: {error}", path.display()))?;
        rect::outln!("wrote {}", path.display());
    }
    if args.start {
        service::start()?;
        rect::outln!("the router runs, and will at each boot: systemctl status rect-router");
    } else if installed {
        rect::outln!("start it with: systemctl enable --now rect-router");
    } else {
        let config = args.folder.join("robot.json5");
        rect::outln!("start it with: rect-router -c {}", config.display());
    }
    if args.users.is_none() {
        let users = args.folder.join("users");
        rect::outln!(
            "the team's other robots need the same login: copy {} to them and give it as --users",
            users.display()
        );
    }
    Ok(())
}

/// As itself, where the team has given each robot a login of its own; else as the team's file lets it.
fn login_as<'a>(args: &'a InitArgs, users: &str) -> Option<&'a str> {
    let [fleet, config] = LOGINS;
    let of_all = if args.base_station { config } else { fleet };
    [args.robot.as_str(), of_all]
        .into_iter()
        .find(|user| login::logins(users).any(|(name, _)| name == *user))
}

/// The shipped configuration with this robot's name, fleet, adapter and folders.
fn robot(args: &InitArgs, state: &Path, login_as: Option<&str>) -> String {
    let folder = |file: &str| args.folder.join(file).display().to_string();
    let login_as = login_as.map_or_else(String::new, |user| format!(", login_as: \"{user}\""));
    let settings = format!(
        "  // RECT's own: this robot's name in keys, its named connections, and as whom it logs in where it dials.\n  plugins: {{\n    \
         rect: {{ fleet: \"{}\", robot: \"{}\", connections: \"{}\"{login_as} }},\n  }},\n}}\n",
        args.fleet,
        args.robot,
        state.join("connections.json").display(),
    );
    let (template, its_name) = if args.base_station {
        BASE_STATION
    } else {
        ROBOT
    };
    let text = template
        .replace(its_name, &args.robot)
        .replace(ITS_FLEET, &format!("\"{}/", args.fleet))
        .replace("ble/hci0", &format!("ble/{}", args.adapter))
        .replace("/etc/rect/users", &folder("users"));
    let body = text.trim_end().strip_suffix('}').unwrap_or(&text);
    format!("{body}\n{settings}")
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
