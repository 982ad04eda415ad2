//! Tests that a recorded login cannot be replayed: `cargo test -p rect-router --test behaviour replay`. (The same is tested for
//! Bluetooth links by the link contract in `zenoh-link-ble/tests`.)

use std::{
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    sync::mpsc,
    thread,
    time::Instant,
};

use crate::support::{admin, client_with, login_file, Router, DEADLINE};
use zenoh::{Session, Wait};

const LOGIN: (&str, &str) = (
    "transport/auth/usrpwd",
    "{ user: 'fleet', password: 'secret' }",
);

/// Forwards one connection to `to` and back. Returns the endpoint to connect to, and a channel for the bytes that the
/// client has sent, once it disconnects.
fn recorder(to: &str) -> (String, mpsc::Receiver<Vec<u8>>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let endpoint = format!("tcp/{}", listener.local_addr().expect("an address"));
    let (to, (recorded, recording)) = (to.to_owned(), mpsc::channel());
    thread::spawn(move || {
        let (mut client, _) = listener.accept().expect("a client");
        let mut router = TcpStream::connect(to).expect("the router");
        let (mut back, mut to_client) = (
            router.try_clone().expect("a handle"),
            client.try_clone().expect("a handle"),
        );
        thread::spawn(move || std::io::copy(&mut back, &mut to_client));
        let (mut sent, mut buffer) = (Vec::new(), [0; 4096]);
        while let Ok(size @ 1..) = client.read(&mut buffer) {
            sent.extend_from_slice(&buffer[..size]);
            if router.write_all(&buffer[..size]).is_err() {
                break;
            }
        }
        let _ = recorded.send(sent);
    });
    (endpoint, recording)
}

/// Returns the sessions that the router reports.
fn sessions(watcher: &Session) -> String {
    admin(watcher, "@/abc/router").expect("an answer")
}

#[test]
fn rejects_a_replayed_login() {
    let folder = tempfile::tempdir().expect("a folder");
    let [flag, logins] = login_file(folder.path(), "fleet:secret\n");
    let mut router = Router::start(&[
        "-l",
        "tcp/127.0.0.1:0",
        "-i",
        "abc",
        "--no-multicast-scouting",
        &flag,
        &logins,
    ]);
    let endpoint = router.listener();
    let address = endpoint.strip_prefix("tcp/").expect("over TCP");
    let watcher = client_with(&endpoint, &[LOGIN]).expect("let in");

    let (recorded_at, recording) = recorder(address);
    let client = client_with(&recorded_at, &[LOGIN]).expect("let in");
    let id = client.zid().to_string();
    assert!(
        sessions(&watcher).contains(&id),
        "an open session is reported"
    );
    client.close().wait().expect("closed");
    drop(client);
    let sent = recording.recv_timeout(DEADLINE).expect("ends");
    assert!(sent.len() > 100, "{} bytes", sent.len());
    // The router takes a moment to remove the session.
    let deadline = Instant::now() + DEADLINE;
    while sessions(&watcher).contains(&id) {
        assert!(Instant::now() < deadline, "the session stays");
    }

    let mut again = TcpStream::connect(address).expect("connects");
    again.set_read_timeout(Some(DEADLINE)).expect("set");
    again.write_all(&sent).expect("sends");
    let mut answer = Vec::new();
    // The router closes the connection, with or without a message.
    let ended = again.read_to_end(&mut answer);
    let timed_out = ended.is_err_and(|error| error.kind() == std::io::ErrorKind::WouldBlock);
    assert!(!timed_out, "the connection is kept open");
    assert!(
        !sessions(&watcher).contains(&id),
        "the replay opened a session"
    );
    // Clients with the password are still accepted.
    let honest = client_with(&endpoint, &[LOGIN]).expect("let in");
    sessions(&honest);
}
