//! `init` and then the command that it prints, wherever rect-router comes from: `cargo test -p rect-router --test first_start`
//!
//! The package's own route, with systemd, is `packaging/test/guest`; the wheel's is `rect-py/tests/test_first_start.py`.

mod support;

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

use nix::unistd::geteuid;
use support::{free_socket, program, said, DEADLINE};

/// Somebody who is not root, as the system's `nobody`.
const NOBODY: u32 = 65534;

struct Installation {
    /// Where it is run.
    folder: PathBuf,
    /// How it is called there.
    program: PathBuf,
    /// Instead of this process's own.
    path: Option<PathBuf>,
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

    /// Runs `init` with these arguments, `check`, and what `init` says, from another folder; then a program logs in over
    /// TCP and, where there is one, over the socket file. Returns the command.
    fn starts(&self, robot: &Path, more: &[&str]) -> String {
        let port = free_socket().rsplit_once(':').expect("a port").1.to_owned();
        let given = robot.to_str().expect("text");
        // No radio of this computer's.
        let init = [
            "init",
            "wombat-1",
            "--adapter",
            "sim-first",
            "--port",
            &port,
        ];
        let made = self.run(&[&init[..], &["--folder", given], more].concat());
        let told = said(&made);
        assert!(made.status.success(), "{told}");
        let command = told
            .lines()
            .find_map(|line| line.strip_prefix("start it with: "))
            .expect("a command");

        let robot = self.folder.join(robot);
        let config = robot.join("robot.json5");
        let checked = self.run(&["check", config.to_str().expect("text")]);
        assert!(checked.status.success(), "{}", said(&checked));

        let log = robot.join("log");
        let mut shell = self.command(Path::new("sh"));
        let line = format!("exec {command} >\"$LOG\" 2>&1");
        let shell = shell.args(["-c", &line]).env("LOG", &log);
        let router = shell.current_dir("/").spawn();
        let mut router = Ended(router.expect("a shell"));
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

/// Killed at the end of the test.
struct Ended(std::process::Child);

impl Drop for Ended {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn built_from_source_it_starts_in_any_folder() {
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
fn found_by_the_shell_it_is_called_by_its_name() {
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
fn unpacked_by_any_user_it_starts_in_a_folder_of_that_user() {
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

    // Where the user may not write, that is what it says.
    if user.is_some() {
        let refused = archive.run(&["init", "wombat-1", "--folder", "/nobodys/rect"]);
        assert!(!refused.status.success());
        assert!(
            said(&refused).contains("--folder ~/rect"),
            "{}",
            said(&refused)
        );
    }
}

#[test]
fn a_folder_that_a_configuration_cannot_hold_is_refused_before_anything_is_written() {
    let root = tempfile::tempdir().expect("a folder");
    let source = Installation::at(root.path());
    for wrong in ["a#b", "a?b", "a;b", "a\nb"] {
        let refused = source.run(&["init", "wombat-1", "--folder", wrong]);
        let told = said(&refused);
        assert!(
            !refused.status.success() && told.contains("choose another"),
            "{told}"
        );
        assert!(!root.path().join(wrong).exists(), "{wrong}");
    }
}

#[test]
fn check_names_a_socket_folder_that_is_missing_and_a_login_file_that_all_can_read() {
    let root = tempfile::tempdir().expect("a folder");
    let source = Installation::at(root.path());
    let made = source.run(&["init", "wombat-1", "--folder", "robot"]);
    assert!(made.status.success(), "{}", said(&made));
    let (config, users) = (
        root.path().join("robot/robot.json5"),
        root.path().join("robot/users"),
    );
    fs::set_permissions(&users, fs::Permissions::from_mode(0o644)).expect("set");
    let checked = source.run(&["check", "robot/robot.json5"]);
    let told = said(&checked);
    assert!(
        checked.status.success() && told.contains("chmod o-rw"),
        "{told}"
    );

    let text = fs::read_to_string(&config).expect("there");
    let missing = text.replace("/router.sock", "/missing/router.sock");
    assert_ne!(missing, text);
    fs::write(&config, missing).expect("written");
    let checked = source.run(&["check", "robot/robot.json5"]);
    let told = said(&checked);
    assert_eq!(checked.status.code(), Some(1), "{told}");
    assert!(told.contains("/missing does not exist"), "{told}");
}
