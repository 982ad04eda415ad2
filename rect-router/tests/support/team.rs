//! A team's robots as `rect-router init` makes them, on a simulated air.
use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use serde_json::json;
use zenoh::Session;

use super::{client_with, Air, Router};

/// Runs it to its end.
pub fn rect_router(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rect-router"));
    command.args(args).output().expect("it starts")
}

/// All that it said.
pub fn said(output: &Output) -> String {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    text(&output.stdout) + &text(&output.stderr)
}

/// A robot's folder as `init` makes it, with further arguments.
pub fn init(root: &Path, robot: &str, more: &[&str]) -> String {
    let folder = root.join(robot).display().to_string();
    let adapter = format!("sim-{robot}");
    let mut args = vec!["init", robot, "--adapter", &adapter, "--folder", &folder];
    args.extend(more);
    let output = rect_router(&args);
    assert!(output.status.success(), "{}", said(&output));
    folder
}

/// Its router, on ports of its own, which logs in as `login` where it dials.
pub fn start(air: &Air, folder: &str, robot: &str, login: &str) -> (Router, String) {
    start_with(air, folder, robot, &["--login-as", login])
}

/// Its router with further arguments, on ports of its own.
pub fn start_with(air: &Air, folder: &str, robot: &str, more: &[&str]) -> (Router, String) {
    let config = format!("{folder}/robot.json5");
    let radio = format!("ble/sim-{robot}#name={robot};secret={folder}/users");
    let listen = ["-c", &config, "-l", "tcp/127.0.0.1:0", "-l", &radio];
    let mut router = Router::start_on(air, &[&listen, more].concat());
    let endpoint = router.listener();
    router.up();
    (router, endpoint)
}

/// A program of that robot's own.
pub fn program(folder: &str, endpoint: &str) -> Session {
    let users = fs::read_to_string(format!("{folder}/users")).expect("a login file");
    let login = users.lines().next().expect("a line");
    let (user, password) = login.split_once(':').expect("a login");
    let login = json!({ "user": user, "password": password }).to_string();
    client_with(endpoint, &[("transport/auth/usrpwd", &login)]).expect("let in")
}
