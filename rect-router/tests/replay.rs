//! A login that somebody has recorded opens nothing: `cargo test -p rect-router --test replay`. (Over Bluetooth: the link
//! contract, `an_opening_that_is_played_back_is_refused`.)

mod support;

use std::{
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    sync::mpsc,
    thread,
    time::Instant,
};

use support::{admin, client_with, login_file, Router, DEADLINE};
use zenoh::{Session, Wait};

const LOGIN: (&str, &str) = (
    "transport/auth/usrpwd",
    "{ user: 'fleet', password: 'secret' }",
);

/// Passes one connection on to `to` and back; gives what the client said, up to its end.
fn recorder(to: &str) -> (String, mpsc::Receiver<Vec<u8>>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let endpoint = format!("tcp/{}", listener.local_addr().expect("an address"));
    let (to, (told, recording)) = (to.to_owned(), mpsc::channel());
    thread::spawn(move || {
        let (mut client, _) = listener.accept().expect("a client");
        let mut router = TcpStream::connect(to).expect("the router");
        let (mut back, mut to_client) = (
            router.try_clone().expect("a handle"),
            client.try_clone().expect("a handle"),
        );
        thread::spawn(move || std::io::copy(&mut back, &mut to_client));
        let (mut said, mut buffer) = (Vec::new(), [0; 4096]);
        while let Ok(size @ 1..) = client.read(&mut buffer) {
            said.extend_from_slice(&buffer[..size]);
            if router.write_all(&buffer[..size]).is_err() {
                break;
            }
        }
        let _ = told.send(said);
    });
    (endpoint, recording)
}

/// The sessions that the router tells of.
fn sessions(watcher: &Session) -> String {
    admin(watcher, "@/abc/router").expect("an answer")
}

#[test]
fn a_recorded_login_that_is_played_back_is_no_session() {
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
        "so that its absence tells"
    );
    client.close().wait().expect("closed");
    drop(client);
    let said = recording.recv_timeout(DEADLINE).expect("ends");
    assert!(said.len() > 100, "{} bytes", said.len());
    // The router takes a moment to let it go.
    let deadline = Instant::now() + DEADLINE;
    while sessions(&watcher).contains(&id) {
        assert!(Instant::now() < deadline, "it stays");
    }

    let mut again = TcpStream::connect(address).expect("connects");
    again.set_read_timeout(Some(DEADLINE)).expect("set");
    again.write_all(&said).expect("sends");
    let mut answer = Vec::new();
    // The router ends it, with or without a word.
    let ended = again.read_to_end(&mut answer);
    let timed_out = ended.is_err_and(|error| error.kind() == std::io::ErrorKind::WouldBlock);
    assert!(!timed_out, "it is kept open");
    assert!(!sessions(&watcher).contains(&id), "it is a session");
    // And those who know the password are let in as before.
    let honest = client_with(&endpoint, &[LOGIN]).expect("let in");
    sessions(&honest);
}
