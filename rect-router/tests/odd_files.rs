//! Files that are not what they should be, and what a killed router leaves: `cargo test -p rect-router --test odd_files`

mod support;

use std::{
    fs,
    os::unix::fs::{symlink, PermissionsExt},
    path::Path,
};

use nix::{sys::stat::Mode, unistd::mkfifo};
use serde_json::json;
use support::{
    answers, change, client, file, init, login_file, rect_router, said, tcp, Air, Router, Wombat,
};

fn pipe_at(path: &Path) {
    mkfifo(path, Mode::S_IRWXU).expect("a pipe");
}

#[test]
fn a_pipe_in_place_of_the_login_file_ends_the_start() {
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
fn a_pipe_in_place_of_the_connections_is_an_error_until_there_is_a_file() {
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
fn a_login_file_that_every_user_can_read_is_in_the_log() {
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
fn a_symbolic_link_to_the_connections_stays_one() {
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
    changed.expect("taken");
    assert!(fs::symlink_metadata(&link).expect("there").is_symlink());
    assert_eq!(fs::read_to_string(&target).expect("there"), text);

    // And a change where it leads to takes effect.
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
fn what_a_killed_router_left_is_removed_at_the_next_start() {
    let root = tempfile::tempdir().expect("a folder");
    let (air, folder) = (Air::new(), init(root.path(), "wombat-1", &[]));
    let left = Path::new(&folder).join(".new-connections.json-abcdef");
    fs::write(&left, "half a te").expect("written");
    // To check a configuration changes nothing.
    let checked = rect_router(&["check", &format!("{folder}/robot.json5")]);
    assert!(
        checked.status.success() && left.exists(),
        "{}",
        said(&checked)
    );
    let (_router, _) = support::start(&air, &folder, "wombat-1", "fleet");
    assert!(!left.exists());
}
