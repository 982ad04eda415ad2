//! Owns `rect-router init`: a robot's folder of configuration, safe from the first start.
use std::{
    fs::{self, OpenOptions},
    io::{self, Write},
    os::unix::fs::{OpenOptionsExt, PermissionsExt},
    path::Path,
};

use rect::core::name::Name;

use super::{Failure, InitArgs};

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
    fs::create_dir_all(&args.folder)
        .map_err(|error| format!("{} can't be made: {error}", args.folder.display()))?;
    let files = [
        ("users", users),
        ("robot.json5", robot(args)),
        ("connections.json", NO_CONNECTIONS.to_owned()),
    ];
    // None is touched if one is there already.
    for (name, _) in &files {
        let path = args.folder.join(name);
        if path.exists() {
            return Err(format!("{} is there already; nothing was changed", path.display()).into());
        }
    }
    for (name, text) in files {
        let path = args.folder.join(name);
        write(&path, &text).map_err(|error| format!("{}: {error}", path.display()))?;
        println!("wrote {}", path.display());
    }
    let [fleet, config] = LOGINS;
    println!(
        "start it with: rect-router -c {} --login-as {}",
        args.folder.join("robot.json5").display(),
        if args.base_station { config } else { fleet }
    );
    if args.users.is_none() {
        let users = args.folder.join("users");
        println!(
            "the team's other robots need the same login: copy {} to them and give it as --users",
            users.display()
        );
    }
    Ok(())
}

/// The shipped configuration with this robot's name, fleet, adapter and folder.
fn robot(args: &InitArgs) -> String {
    let folder = |file: &str| args.folder.join(file).display().to_string();
    let settings = format!(
        "  // RECT's own: this robot's name in keys, and its named connections.\n  plugins: {{\n    rect: {{ fleet: \"{}\", \
         robot: \"{}\", connections: \"{}\" }},\n  }},\n}}\n",
        args.fleet,
        args.robot,
        folder("connections.json")
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

fn write(path: &Path, text: &str) -> io::Result<()> {
    let mut options = OpenOptions::new();
    let mut file = options
        .write(true)
        .create_new(true)
        .mode(PRIVATE)
        .open(path)?;
    file.write_all(text.as_bytes())?;
    // Whatever the umask is.
    file.set_permissions(fs::Permissions::from_mode(PRIVATE))?;
    file.sync_all()
}
