//! Tests the simulated air between processes, over real sockets and in real time:
//! `cargo test -p zenoh-link-ble-air --test air_server`.
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
use zenoh_link_ble_air::{
    control, radio_at, AirOptions, AirServer, Condition, Control, ServeError, SimRadio, SocketError,
};
use zenoh_link_ble_radio::{
    advertisement::Advertisement, AdapterState, AdvertisingGuard, Channel, ChannelListener,
    ChannelOptions, Radio, RadioError, Security,
};

const OPTIONS: ChannelOptions = ChannelOptions {
    recv_mtu: 4096,
    security: Security::Low,
    passkey: None,
};

/// Timeout that only applies if a test hangs.
const LIMIT: Duration = Duration::from_secs(20);

/// A temporary folder, removed when it is dropped.
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
    let peer = to.address().await.expect("has an address");
    let dialled = from.connect(peer, listening.0.psm(), OPTIONS);
    let both = async { tokio::join!(dialled, listening.0.accept()) };
    let (dialled, accepted) = timeout(LIMIT, both).await.expect("in time");
    (
        dialled.expect("connects"),
        accepted.expect("accepts"),
        listening,
    )
}

async fn assert_delivers(from: &dyn Channel, to: &dyn Channel, sdu: &[u8]) {
    from.send(sdu).await.expect("sends");
    let mut buffer = vec![0; 5000];
    let received = timeout(LIMIT, to.recv(&mut buffer)).await.expect("in time");
    assert_eq!(&buffer[..received.expect("receives")], sdu);
}

#[tokio::test]
async fn two_clients_discover_each_other_and_exchange_sdus() {
    let folder = Folder::new("talk");
    let _server = serve(&folder.socket());
    let a = radio_at(&folder.socket(), "sim-a").expect("a good name");
    let b = radio_at(&folder.socket(), "sim-b").expect("a good name");
    let (x, y, listening) = link(&a, &b).await;
    assert_delivers(&*x, &*y, &[1; 4096]).await;
    assert_delivers(&*y, &*x, b"answer").await;
    let mut scan = a.scan().await.expect("scans");
    let received = timeout(LIMIT, scan.next())
        .await
        .expect("in time")
        .expect("receives a report");
    assert_eq!(received.device, b.address().await.expect("has an address"));
    let status = control(&folder.socket(), Control::Status)
        .await
        .expect("answers");
    let status = status.expect("a status");
    assert_eq!((status.adapters.len(), status.links.len()), (2, 1));
    // The end of a program is detected immediately.
    drop((y, b, listening));
    let ended = timeout(LIMIT, x.recv(&mut [0; 8])).await.expect("in time");
    assert!(
        matches!(ended, Err(RadioError::ChannelDown { .. })),
        "{ended:?}"
    );
}

#[tokio::test]
async fn missing_server_error_names_the_socket_and_the_command() {
    let folder = Folder::new("nobody");
    let radio = radio_at(&folder.socket(), "sim-a").expect("a good name");
    assert_eq!(radio.state().await, AdapterState::Missing);
    let error = radio.scan().await.err().expect("no air is running");
    assert!(matches!(error, RadioError::NoService { .. }), "{error:?}");
    let text = error.to_string();
    assert!(
        text.contains("air.sock") && text.contains("rect air"),
        "{text}"
    );
}

#[tokio::test]
async fn adapters_reattach_after_a_server_restart() {
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
            timeout(LIMIT, changed).await.expect("reattaches");
        }
    }
    // Remaining objects of the old attachments do not affect the new ones.
    let new = listen(&b).await;
    drop((x, y, old));
    drop(new);
    let (x, y, _listening) = link(&a, &b).await;
    assert_delivers(&*x, &*y, b"again").await;
}

#[tokio::test]
async fn rejects_a_second_program_with_the_same_adapter_name() {
    let folder = Folder::new("twice");
    let _server = serve(&folder.socket());
    let first = radio_at(&folder.socket(), "sim-a").expect("a good name");
    assert_eq!(first.state().await, AdapterState::On);
    // With another path, this process counts as another program.
    let alias = folder.0.join("alias.sock");
    symlink(folder.socket(), &alias).expect("links");
    let second = radio_at(&alias, "sim-a").expect("a good name");
    let error = second.address().await.expect_err("is taken");
    assert!(error.to_string().contains("another program"), "{error}");
    drop(first);
    while second.state().await != AdapterState::On {
        timeout(LIMIT, second.changed()).await.expect("attaches");
    }
}

#[tokio::test]
async fn disconnects_a_client_that_sends_garbage_without_affecting_others() {
    let folder = Folder::new("garbage");
    let _server = serve(&folder.socket());
    let a = radio_at(&folder.socket(), "sim-a").expect("a good name");
    let b = radio_at(&folder.socket(), "sim-b").expect("a good name");
    let (x, y, _listening) = link(&a, &b).await;
    let messages: [&[u8]; 4] = [
        b"GET / HTTP/1.1\r\n\r\n",
        &[4, 0, 0, 0, 0xff, 0xff, 0xff, 0xff],
        // A command as the first message.
        &[3, 0, 0, 0, 2, 2, 1],
        // An invalid adapter name.
        &[6, 0, 0, 0, 0, 1, 3, b'h', b'c', b'i'],
    ];
    for message in messages {
        let mut client = UnixStream::connect(folder.socket())
            .await
            .expect("connects");
        client.write_all(message).await.expect("writes");
        let mut answer = Vec::new();
        let ended = timeout(LIMIT, client.read_to_end(&mut answer)).await;
        // A reset also counts as the end: the server did not read everything.
        let _ = ended.expect("is disconnected");
        assert_delivers(&*x, &*y, b"undisturbed").await;
    }
}

#[tokio::test]
async fn socket_is_private_and_replaces_a_stale_file_and_is_removed_on_exit() {
    let folder = Folder::new("socket");
    let path = folder.socket();
    drop(std::os::unix::net::UnixListener::bind(&path).expect("binds"));
    assert!(path.exists(), "a dead server leaves its file");
    let server = serve(&path);
    let mode = std::fs::metadata(&path)
        .expect("exists")
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
