//! Tests of `init` and the start command that it prints, for several kinds of installation:
//! `cargo test -p rect-router --test behaviour first_start`
//!
//! The installation by the package, with systemd, is tested by `packaging/test/guest`; the installation by the wheel is
//! tested by `rect-py/tests/test_first_start.py`.

use std::{
    fs,
    os::unix::{
        fs::{chown, symlink, PermissionsExt},
        process::CommandExt,
    },
    path::{Path, PathBuf},
    process::{Command, Output},
    thread,
    time::{Duration, Instant},
};

use crate::support::{free_socket, program, text_of, DEADLINE};
use nix::unistd::geteuid;
use zenoh_link_ble_air::SOCKET_VARIABLE;

/// ID of a user other than root: the system's `nobody`.
const NOBODY: u32 = 65534;

struct Installation {
    /// Working folder of the program.
    folder: PathBuf,
    /// Path of the program.
    program: PathBuf,
    /// Folder to put first in `PATH`.
    path: Option<PathBuf>,
    /// User and group to run as, if not those of this process.
    user: Option<u32>,
}

impl Installation {
    fn at(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
            program: env!("CARGO_BIN_EXE_rect-router").into(),
            path: None,
            user: None,
        }
    }

    fn command(&self, program: &Path) -> Command {
        let mut command = Command::new(program);
        command.current_dir(&self.folder).env_remove("RUST_LOG");
        // No air runs there, so that no robot of another test is in range.
        command.env(SOCKET_VARIABLE, self.folder.join("air.sock"));
        if let Some(path) = &self.path {
            let others = std::env::var("PATH").unwrap_or_default();
            command.env("PATH", format!("{}:{others}", path.display()));
        }
        if let Some(user) = self.user {
            command.uid(user).gid(user);
        }
        command
    }

    fn run(&self, args: &[&str]) -> Output {
        let output = self.command(&self.program).args(args).output();
        output.expect("it starts")
    }

    /// Runs `init` with these arguments, then `check`, then the command that `init` prints, from another folder. Checks that a
    /// program can log in over TCP and, if there is one, over the socket file. Returns the command.
    fn starts(&self, robot: &Path, more: &[&str]) -> String {
        let port = free_socket().rsplit_once(':').expect("a port").1.to_owned();
        let given = robot.to_str().expect("text");
        // A simulated adapter, so that no Bluetooth is needed.
        let init = [
            "init",
            "wombat-1",
            "--adapter",
            "sim-first",
            "--port",
            &port,
        ];
        let made = self.run(&[&init[..], &["--folder", given], more].concat());
        let output = text_of(&made);
        assert!(made.status.success(), "{output}");
        let command = output
            .lines()
            .find_map(|line| line.strip_prefix("start it with: "))
            .expect("a command");

        let robot = self.folder.join(robot);
        let config = robot.join("robot.json5");
        let checked = self.run(&["check", config.to_str().expect("text")]);
        assert!(checked.status.success(), "{}", text_of(&checked));

        let log = robot.join("log");
        let mut shell = self.command(Path::new("sh"));
        let line = format!("exec {command} >\"$LOG\" 2>&1");
        let shell = shell.args(["-c", &line]).env("LOG", &log);
        let router = shell.current_dir("/").spawn();
        let mut router = RunningCommand(router.expect("a shell"));
        let text = || fs::read_to_string(&log).unwrap_or_default();
        let deadline = Instant::now() + DEADLINE;
        while !text().contains("rect-router is up") {
            let ended = router.0.try_wait().expect("our child");
            assert!(
                ended.is_none() && Instant::now() < deadline,
                "{command}: {}",
                text()
            );
            thread::sleep(Duration::from_millis(10));
        }
        let robot = robot.to_str().expect("text");
        drop(program(robot, &format!("tcp/127.0.0.1:{port}")));
        let socket = format!("{robot}/router.sock");
        if Path::new(&socket).exists() {
            drop(program(robot, &format!("unixsock-stream/{socket}")));
        }
        command.to_owned()
    }
}

/// A process that is killed at the end of the test.
struct RunningCommand(std::process::Child);

impl Drop for RunningCommand {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_router_built_from_source_starts_with_any_folder() {
    let root = tempfile::tempdir().expect("a folder");
    let source = Installation::at(root.path());
    let own = env!("CARGO_BIN_EXE_rect-router");
    let command = source.starts(Path::new("relative"), &[]);
    let config = root.path().join("relative/robot.json5");
    assert_eq!(command, format!("{own} -c {}", config.display()));
    assert!(root.path().join("relative/router.sock").exists());
    source.starts(
        Path::new("a folder's name, \"quoted\" \\"),
        &["--base-station"],
    );
    let deep = "deep/".repeat(30);
    source.starts(Path::new(&deep), &[]);
    assert!(
        !root.path().join(deep).join("router.sock").exists(),
        "too long"
    );
}

#[test]
fn a_router_in_path_is_started_by_its_name() {
    let root = tempfile::tempdir().expect("a folder");
    let bin = root.path().join("bin");
    fs::create_dir(&bin).expect("a folder");
    let program = bin.join("rect-router");
    symlink(env!("CARGO_BIN_EXE_rect-router"), &program).expect("a link");
    let installed = Installation {
        program,
        path: Some(bin),
        ..Installation::at(root.path())
    };
    let command = installed.starts(Path::new("robot"), &[]);
    assert!(command.starts_with("rect-router -c /"), "{command}");
}

#[test]
fn an_unpacked_router_starts_with_a_folder_of_its_user() {
    let root = tempfile::tempdir().expect("a folder");
    let unpacked = root.path().join("rect-0.1.0");
    fs::create_dir(&unpacked).expect("a folder");
    let program = unpacked.join("rect-router");
    fs::copy(env!("CARGO_BIN_EXE_rect-router"), &program).expect("copied");
    let user = geteuid().is_root().then_some(NOBODY);
    for folder in [root.path(), &unpacked] {
        fs::set_permissions(folder, fs::Permissions::from_mode(0o755)).expect("set");
        chown(folder, user, user).expect("given");
    }
    let archive = Installation {
        program,
        user,
        ..Installation::at(&unpacked)
    };
    archive.starts(Path::new("../robot"), &[]);

    // If the user may not write to the folder, the error gives advice.
    if user.is_some() {
        let refused = archive.run(&["init", "wombat-1", "--folder", "/nobodys/rect"]);
        assert!(!refused.status.success());
        assert!(
            text_of(&refused).contains("--folder ~/rect"),
            "{}",
            text_of(&refused)
        );
    }
}

#[test]
fn init_rejects_folders_that_a_configuration_cannot_contain() {
    let root = tempfile::tempdir().expect("a folder");
    let source = Installation::at(root.path());
    for wrong in ["a#b", "a?b", "a;b", "a\nb"] {
        let refused = source.run(&["init", "wombat-1", "--folder", wrong]);
        let output = text_of(&refused);
        assert!(
            !refused.status.success() && output.contains("choose another"),
            "{output}"
        );
        assert!(!root.path().join(wrong).exists(), "{wrong}");
    }
}

#[test]
fn check_reports_a_missing_socket_folder_and_an_exposed_login_file() {
    let root = tempfile::tempdir().expect("a folder");
    let source = Installation::at(root.path());
    let made = source.run(&["init", "wombat-1", "--folder", "robot"]);
    assert!(made.status.success(), "{}", text_of(&made));
    let (config, users) = (
        root.path().join("robot/robot.json5"),
        root.path().join("robot/users"),
    );
    fs::set_permissions(&users, fs::Permissions::from_mode(0o644)).expect("set");
    let checked = source.run(&["check", "robot/robot.json5"]);
    let output = text_of(&checked);
    assert!(
        checked.status.success() && output.contains("chmod o-rw"),
        "{output}"
    );

    let text = fs::read_to_string(&config).expect("exists");
    let missing = text.replace("/router.sock", "/missing/router.sock");
    assert_ne!(missing, text);
    fs::write(&config, missing).expect("written");
    let checked = source.run(&["check", "robot/robot.json5"]);
    let output = text_of(&checked);
    assert_eq!(checked.status.code(), Some(1), "{output}");
    assert!(output.contains("/missing does not exist"), "{output}");
}
