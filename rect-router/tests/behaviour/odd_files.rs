//! Tests of unusual files: pipes, symbolic links, wrong permissions, and leftovers of a killed router:
//! `cargo test -p rect-router --test behaviour odd_files`

use std::{
    fs,
    os::unix::fs::{symlink, PermissionsExt},
    path::Path,
};

use crate::support::{
    answers, change, client, file, init, login_file, rect_router, tcp, text_of, Air, Router, Wombat,
};
use nix::{sys::stat::Mode, unistd::mkfifo};
use serde_json::json;

fn pipe_at(path: &Path) {
    mkfifo(path, Mode::S_IRWXU).expect("a pipe");
}

#[test]
fn a_pipe_as_login_file_prevents_the_start() {
    let folder = tempfile::tempdir().expect("a folder");
    let login = login_file(folder.path(), "fleet:secret\n");
    fs::remove_file(folder.path().join("users")).expect("removed");
    pipe_at(&folder.path().join("users"));
    let mut args = vec!["-l", "tcp/127.0.0.1:0", "--no-multicast-scouting"];
    args.extend(login.iter().map(String::as_str));
    let mut router = Router::start(&args);
    assert_eq!(router.exit().code(), Some(1));
    let log = router.full_log();
    assert!(log.contains("it is not a regular file"), "{log}");
}

#[test]
fn a_pipe_as_connections_file_is_reported_until_it_is_replaced() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let mut one = Wombat::start(&air, &folder, 1, &file(&[]));
    let pipe = folder.path().join("pipe");
    pipe_at(&pipe);
    fs::rename(&pipe, &one.file).expect("renamed");
    one.router.wait_for("it is not a regular file");
    one.write(&file(&[tcp("base", 1)]));
    one.router.wait_for("added base");
}

#[test]
fn warns_of_a_login_file_that_every_user_can_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let login = login_file(folder.path(), "fleet:secret\n");
    let users = folder.path().join("users");
    fs::set_permissions(&users, fs::Permissions::from_mode(0o644)).expect("set");
    let mut args = vec!["-l", "tcp/127.0.0.1:0", "--no-multicast-scouting"];
    args.extend(login.iter().map(String::as_str));
    let mut router = Router::start(&args);
    router.wait_for("every user of this computer can read the login file");
    router.up();
}

#[test]
fn a_change_replaces_the_target_of_a_symbolic_link() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let real = folder.path().join("real");
    fs::create_dir(&real).expect("a folder");
    let (target, link) = (
        real.join("list.json"),
        folder.path().join("connections.json"),
    );
    fs::write(&target, file(&[]).to_string()).expect("written");
    symlink(&target, &link).expect("a link");
    let settings = json!({ "connections": &link, "max_connections": 4 });
    let mut one = Wombat::start_with(&air, 1, settings, link.clone());

    let session = client(&one.endpoint);
    let settings = "rect/wombat-1/@rect/@config/connections";
    let text = file(&[tcp("base", 1)]).to_string();
    let changed = change(&session, settings, &text).expect("an answer");
    changed.expect("accepted");
    assert!(fs::symlink_metadata(&link).expect("exists").is_symlink());
    assert_eq!(fs::read_to_string(&target).expect("exists"), text);

    // A change of the link's target takes effect, too.
    let new = real.join("new");
    fs::write(&new, file(&[tcp("other", 1)]).to_string()).expect("written");
    fs::rename(&new, &target).expect("renamed");
    one.router.wait_for("added other; removed base");
    answers(
        &session,
        "rect/wombat-1/@rect/connections?name=other",
        |all| all[0]["name"] == "other",
    );
}

#[test]
fn removes_leftovers_of_a_killed_router_at_the_next_start() {
    let root = tempfile::tempdir().expect("a folder");
    let (air, folder) = (Air::new(), init(root.path(), "wombat-1", &[]));
    let left = Path::new(&folder).join(".new-connections.json-abcdef");
    fs::write(&left, "half a te").expect("written");
    // Checking a configuration changes nothing.
    let checked = rect_router(&["check", &format!("{folder}/robot.json5")]);
    assert!(
        checked.status.success() && left.exists(),
        "{}",
        text_of(&checked)
    );
    let (_router, _) = crate::support::start(&air, &folder, "wombat-1", "fleet");
    assert!(!left.exists());
}
