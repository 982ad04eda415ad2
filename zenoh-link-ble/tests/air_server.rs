//! The simulated air between processes, over real sockets and in real time:
//! `cargo test -p zenoh-link-ble --test air_server`.
use std::{
    os::unix::fs::{symlink, PermissionsExt},
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::UnixStream,
    task::JoinHandle,
    time::timeout,
};
use zenoh_link_ble::{
    advertisement::Advertisement,
    radio::{
        sim::{
            control, radio_at, AirOptions, AirServer, Condition, Control, ServeError, SimRadio,
            SocketError,
        },
        AdapterState, AdvertisingGuard, Channel, ChannelListener, ChannelOptions, Radio,
        RadioError, Security,
    },
};

const OPTIONS: ChannelOptions = ChannelOptions {
    recv_mtu: 4096,
    security: Security::Low,
    passkey: None,
};

/// Only bounds a test that hangs.
const LIMIT: Duration = Duration::from_secs(20);

/// A folder of its own, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("rect-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&path).expect("a temporary folder");
        Self(path)
    }

    fn socket(&self) -> PathBuf {
        self.0.join("air.sock")
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn serve(path: &Path) -> JoinHandle<()> {
    let options = AirOptions {
        condition: Condition::Desk,
        interval: Duration::from_micros(7500),
        ..AirOptions::default()
    };
    tokio::spawn(AirServer::bind(path, options).expect("binds").serve())
}

async fn stop(server: JoinHandle<()>) {
    server.abort();
    let _ = server.await;
}

type Listening = (Box<dyn ChannelListener>, Box<dyn AdvertisingGuard>);

async fn listen(radio: &SimRadio) -> Listening {
    let listener = radio.listen(None, OPTIONS).await.expect("listens");
    let advertisement = Advertisement {
        psm: listener.psm(),
        plain: false,
        name_hash: 0,
        fleet_hash: 0,
        incarnation: 0,
    };
    let advertised = radio.advertise(&advertisement, "host").await;
    (listener, advertised.expect("advertises"))
}

async fn link(from: &SimRadio, to: &SimRadio) -> (Arc<dyn Channel>, Arc<dyn Channel>, Listening) {
    let listening = listen(to).await;
    let peer = to.address().await.expect("is there");
    let dialled = from.connect(peer, listening.0.psm(), OPTIONS);
    let both = async { tokio::join!(dialled, listening.0.accept()) };
    let (dialled, accepted) = timeout(LIMIT, both).await.expect("in time");
    (
        dialled.expect("connects"),
        accepted.expect("is called"),
        listening,
    )
}

async fn say(from: &dyn Channel, to: &dyn Channel, sdu: &[u8]) {
    from.send(sdu).await.expect("sends");
    let mut buffer = vec![0; 5000];
    let received = timeout(LIMIT, to.recv(&mut buffer)).await.expect("in time");
    assert_eq!(&buffer[..received.expect("receives")], sdu);
}

#[tokio::test]
async fn two_clients_find_each_other_and_talk() {
    let folder = Folder::new("talk");
    let _server = serve(&folder.socket());
    let a = radio_at(&folder.socket(), "sim-a").expect("a good name");
    let b = radio_at(&folder.socket(), "sim-b").expect("a good name");
    let (x, y, listening) = link(&a, &b).await;
    say(&*x, &*y, &[1; 4096]).await;
    say(&*y, &*x, b"answer").await;
    let mut scan = a.scan().await.expect("scans");
    let heard = timeout(LIMIT, scan.next())
        .await
        .expect("in time")
        .expect("hears");
    assert_eq!(heard.device, b.address().await.expect("is there"));
    let status = control(&folder.socket(), Control::Status)
        .await
        .expect("answers");
    let status = status.expect("an account");
    assert_eq!((status.adapters.len(), status.links.len()), (2, 1));
    // A program that ends is known at once.
    drop((y, b, listening));
    let ended = timeout(LIMIT, x.recv(&mut [0; 8])).await.expect("in time");
    assert!(
        matches!(ended, Err(RadioError::ChannelDown { .. })),
        "{ended:?}"
    );
}

#[tokio::test]
async fn without_a_server_the_error_says_where_and_how() {
    let folder = Folder::new("nobody");
    let radio = radio_at(&folder.socket(), "sim-a").expect("a good name");
    assert_eq!(radio.state().await, AdapterState::Missing);
    let error = radio.scan().await.err().expect("nobody is there");
    assert!(matches!(error, RadioError::NoService { .. }), "{error:?}");
    let text = error.to_string();
    assert!(
        text.contains("air.sock") && text.contains("rect air"),
        "{text}"
    );
}

#[tokio::test]
async fn adapters_come_back_when_the_server_does() {
    let folder = Folder::new("again");
    let server = serve(&folder.socket());
    let a = radio_at(&folder.socket(), "sim-a").expect("a good name");
    let b = radio_at(&folder.socket(), "sim-b").expect("a good name");
    let (x, y, old) = link(&a, &b).await;
    stop(server).await;
    assert!(timeout(LIMIT, x.recv(&mut [0; 8]))
        .await
        .expect("in time")
        .is_err());
    assert!(timeout(LIMIT, y.recv(&mut [0; 8]))
        .await
        .expect("in time")
        .is_err());
    assert!(old.0.accept().await.is_err());
    let _server = serve(&folder.socket());
    for radio in [&a, &b] {
        loop {
            let changed = radio.changed();
            if radio.state().await == AdapterState::On {
                break;
            }
            timeout(LIMIT, changed).await.expect("comes back");
        }
    }
    // What is left of the old ones does not touch the new ones.
    let new = listen(&b).await;
    drop((x, y, old));
    drop(new);
    let (x, y, _listening) = link(&a, &b).await;
    say(&*x, &*y, b"again").await;
}

#[tokio::test]
async fn a_name_belongs_to_one_program_at_a_time() {
    let folder = Folder::new("twice");
    let _server = serve(&folder.socket());
    let first = radio_at(&folder.socket(), "sim-a").expect("a good name");
    assert_eq!(first.state().await, AdapterState::On);
    // By another path this process counts as another program.
    let alias = folder.0.join("alias.sock");
    symlink(folder.socket(), &alias).expect("links");
    let second = radio_at(&alias, "sim-a").expect("a good name");
    let error = second.address().await.expect_err("is taken");
    assert!(error.to_string().contains("another program"), "{error}");
    drop(first);
    while second.state().await != AdapterState::On {
        timeout(LIMIT, second.changed()).await.expect("gets it");
    }
}

#[tokio::test]
async fn a_client_that_talks_garbage_is_let_go_and_others_do_not_notice() {
    let folder = Folder::new("garbage");
    let _server = serve(&folder.socket());
    let a = radio_at(&folder.socket(), "sim-a").expect("a good name");
    let b = radio_at(&folder.socket(), "sim-b").expect("a good name");
    let (x, y, _listening) = link(&a, &b).await;
    let messages: [&[u8]; 4] = [
        b"GET / HTTP/1.1\r\n\r\n",
        &[4, 0, 0, 0, 0xff, 0xff, 0xff, 0xff],
        // A command before the introduction.
        &[3, 0, 0, 0, 2, 2, 1],
        // A name that is none.
        &[6, 0, 0, 0, 0, 1, 3, b'h', b'c', b'i'],
    ];
    for message in messages {
        let mut client = UnixStream::connect(folder.socket())
            .await
            .expect("connects");
        client.write_all(message).await.expect("writes");
        let mut answer = Vec::new();
        let ended = timeout(LIMIT, client.read_to_end(&mut answer)).await;
        // A reset is an end too: the server did not read all of it.
        let _ = ended.expect("is let go");
        say(&*x, &*y, b"undisturbed").await;
    }
}

#[tokio::test]
async fn the_socket_is_private_replaces_a_stale_one_and_goes_with_its_server() {
    let folder = Folder::new("socket");
    let path = folder.socket();
    drop(std::os::unix::net::UnixListener::bind(&path).expect("binds"));
    assert!(path.exists(), "a dead server leaves its file");
    let server = serve(&path);
    let mode = std::fs::metadata(&path)
        .expect("is there")
        .permissions()
        .mode();
    assert_eq!(mode & 0o777, 0o600);
    let second = AirServer::bind(&path, AirOptions::default()).err();
    assert!(
        matches!(second, Some(ServeError::Socket(SocketError::InUse(_)))),
        "{second:?}"
    );
    stop(server).await;
    assert!(!path.exists());
    std::fs::write(&path, b"somebody's notes").expect("writes");
    let third = AirServer::bind(&path, AirOptions::default()).err();
    assert!(
        matches!(third, Some(ServeError::Socket(SocketError::NotASocket(_)))),
        "{third:?}"
    );
}
