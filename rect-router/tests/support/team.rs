//! Starts robots on a simulated air with configurations written by `rect-router init`.
use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use serde_json::json;
use zenoh::Session;

use super::{client_with, Air, Router};

/// Runs `rect-router` until it exits.
pub fn rect_router(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rect-router"));
    command.args(args).output().expect("it starts")
}

/// Returns the output of a command, stdout followed by stderr.
pub fn text_of(output: &Output) -> String {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    text(&output.stdout) + &text(&output.stderr)
}

/// Runs `init` for a robot with additional arguments, and returns its folder.
pub fn init(root: &Path, robot: &str, more: &[&str]) -> String {
    let folder = root.join(robot).display().to_string();
    let adapter = format!("sim-{robot}");
    let mut args = vec!["init", robot, "--adapter", &adapter, "--folder", &folder];
    args.extend(more);
    let output = rect_router(&args);
    assert!(output.status.success(), "{}", text_of(&output));
    folder
}

/// Starts the router of a robot on a free port. It logs in as `login` when it dials.
pub fn start(air: &Air, folder: &str, robot: &str, login: &str) -> (Router, String) {
    start_with(air, folder, robot, &["--login-as", login])
}

/// Starts the router of a robot on a free port, with additional arguments.
pub fn start_with(air: &Air, folder: &str, robot: &str, more: &[&str]) -> (Router, String) {
    let config = format!("{folder}/robot.json5");
    let radio = format!("ble/sim-{robot}#name={robot};secret={folder}/users");
    let listen = ["-c", &config, "-l", "tcp/127.0.0.1:0", "-l", &radio];
    let mut router = Router::start_on(air, &[&listen, more].concat());
    let endpoint = router.listener();
    router.up();
    (router, endpoint)
}

/// Opens a session of a program on that robot, logged in with the first line of its login file.
pub fn program(folder: &str, endpoint: &str) -> Session {
    let users = fs::read_to_string(format!("{folder}/users")).expect("a login file");
    let login = users.lines().next().expect("a line");
    let (user, password) = login.split_once(':').expect("a login");
    let login = json!({ "user": user, "password": password }).to_string();
    client_with(endpoint, &[("transport/auth/usrpwd", &login)]).expect("let in")
}
