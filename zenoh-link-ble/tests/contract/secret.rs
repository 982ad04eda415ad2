//! Contract of the shared secret: peers with the secret are linked; peers without it, and replayed handshakes, are
//! rejected. A link with a secret is encrypted, and an SDU that the peer has not sealed ends it.
use std::sync::Arc;

use link_lanes::{
    goodbye::Goodbye,
    hello::{HandshakeMessage, Hello, Key, Refusal, MIN_MTU, VERSION},
    key_agreement::{respond, Initiator, KEY_MESSAGE_BYTES},
    lanes::{credits::MIN_WINDOW, sdu::Content, Lane},
    sealed_message,
    secret::Secret,
};
use tempfile::TempDir;
use zenoh_link_ble_radio::{advertisement::Advertisement, Channel};

use super::{advertisement, misbehaving::assert_link_ends, World};
use crate::shared::{
    listener::OPTIONS,
    peer::{assert_delivers, within, Peer},
    raw::{hello, raw_channel},
    sealed::{agree, dial_with_secret, receive_sealed},
};

pub const OURS: &str = "fleet:what only we know";
pub const THEIRS: &str = "fleet:what only they know";
const NOT_SHARED: &str = "did not prove that it has the same secret";

/// A file with a secret. Provides the locator option that names it.
pub struct File {
    folder: TempDir,
}

impl File {
    pub fn with(secret: &str) -> Self {
        let folder = tempfile::tempdir().expect("makes a folder");
        std::fs::write(folder.path().join("users"), secret).expect("writes");
        Self { folder }
    }

    pub fn option(&self) -> String {
        format!("secret={}", self.folder.path().join("users").display())
    }
}

fn ours() -> Secret {
    Secret::new(OURS.as_bytes()).expect("long enough")
}

async fn receive_message(channel: &Arc<dyn Channel>) -> HandshakeMessage {
    let mut buffer = [0; 2000];
    let size = within("the answer", channel.recv(&mut buffer)).await;
    HandshakeMessage::decode(&buffer[..size.expect("receives")]).expect("a handshake message")
}

async fn send_message(channel: &Arc<dyn Channel>, message: &HandshakeMessage) {
    let sent = within("sending", channel.send(&message.encode())).await;
    sent.expect("sends");
}

pub async fn links_two_nodes_with_the_same_secret(world: World) {
    let file = File::with(OURS);
    let b = Peer::on(&world.b);
    let b = b
        .listen_as(&format!("name=wombat-2;{}", file.option()))
        .await;
    let a = Peer::on(&world.a);
    let locator = format!("ble/wombat-2#{}", file.option());
    let near = a.dial(&locator).await.expect("dials");
    let far = b.incoming().await;
    assert_delivers(&near, &far, b"there").await;
    assert_delivers(&far, &near, b"and back").await;
}

pub async fn dials_with_the_secret_of_its_listener(world: World) {
    let file = File::with(OURS);
    let listen = |name: &str| format!("name={name};{}", file.option());
    let b = Peer::on(&world.b).listen_as(&listen("wombat-2")).await;
    let a = Peer::on(&world.a).listen_as(&listen("wombat-1")).await;
    // Both dial at the same time, as two robots of a team do.
    let (one, other) = tokio::join!(a.dial("ble/wombat-2"), b.dial("ble/wombat-1"));
    let (near, far) = match (one, other) {
        (Ok(near), Err(_)) => (near, b.incoming().await),
        (Err(_), Ok(far)) => (a.incoming().await, far),
        (Ok(_), Ok(_)) => panic!("two links"),
        (Err(one), Err(other)) => panic!("no link: {one}; {other}"),
    };
    assert_delivers(&near, &far, b"there").await;
    assert_delivers(&far, &near, b"and back").await;
}

pub async fn refuses_links_without_the_secret_in_both_directions(world: World) {
    let (ours, theirs) = (File::with(OURS), File::with(THEIRS));
    let listener = format!("name=wombat-2;{}", ours.option());
    let b = Peer::on(&world.b).listen_as(&listener).await;
    let a = Peer::on(&world.a);
    for (locator, reason) in [
        ("ble/wombat-2".to_owned(), "do not have the same secret"),
        (format!("ble/wombat-2#{}", theirs.option()), NOT_SHARED),
        ("ble/wombat-2#plain=true".to_owned(), ""),
    ] {
        match a.dial(&locator).await {
            Err(error) => assert!(error.to_string().contains(reason), "{error}"),
            // A plain link starts with Zenoh's own first message.
            Ok(plain) => {
                plain.write_all(&[0x01, 9, 9], None).await.expect("writes");
                let end = within("being dropped", plain.read(&mut [0; 100], None)).await;
                assert!(end.is_err(), "{locator}");
            }
        }
        assert!(b.no_more_incoming(), "{locator}");
    }
    let locator = format!("ble/wombat-2#{}", ours.option());
    a.dial(&locator)
        .await
        .expect("the right secret is accepted");
}

pub async fn rejects_an_impostor_with_the_name_of_a_robot(world: World) {
    let file = File::with(OURS);
    let a = Peer::on(&world.a);
    let accept = HandshakeMessage::Accept(hello(6, "wombat-2"));
    let guess = HandshakeMessage::KeyAnswer(Key {
        version: VERSION,
        message: [1; KEY_MESSAGE_BYTES],
    });
    for (answer, reason) in [
        (accept, NOT_SHARED),
        (guess, NOT_SHARED),
        (
            HandshakeMessage::Hello(hello(6, "wombat-2")),
            "answered a hello with a hello",
        ),
    ] {
        let listener = world.b.listen(None, OPTIONS).await.expect("listens");
        let advertised = advertisement(listener.psm(), "wombat-2");
        let _advertising = world.b.advertise(&advertised, "wombat-2").await;
        let answering = async {
            let channel = listener.accept().await.expect("accepts");
            assert!(matches!(
                receive_message(&channel).await,
                HandshakeMessage::Key(_)
            ));
            send_message(&channel, &answer).await;
            let mut received = Vec::new();
            let mut buffer = [0; 2000];
            while let Ok(size) = within("the end", channel.recv(&mut buffer)).await {
                received
                    .push(HandshakeMessage::decode(&buffer[..size]).expect("a handshake message"));
            }
            received
        };
        let locator = format!("ble/wombat-2#{}", file.option());
        let (dialled, received) = tokio::join!(a.dial(&locator), answering);
        let error = dialled.expect_err("the dial fails").to_string();
        assert!(error.contains(reason), "{error}");
        // The dialler must not send anything that an impostor could use.
        let refused = [HandshakeMessage::Refuse(Refusal::Secret)];
        assert!(received.is_empty() || received == refused, "{received:?}");
    }
}

pub async fn refuses_a_replayed_handshake(world: World) {
    let file = File::with(OURS);
    let listener = format!("name=wombat-2;{}", file.option());
    let b = Peer::on(&world.b).listen_as(&listener).await;
    let channel = raw_channel(&world.a, &world.b).await;
    let started = Initiator::start(&ours(), &Key::header(VERSION));
    let (initiator, message) = started.expect("starts");
    let version = VERSION;
    let key = HandshakeMessage::Key(Key { version, message });
    send_message(&channel, &key).await;
    let HandshakeMessage::KeyAnswer(answer) = receive_message(&channel).await else {
        panic!("a listener with a secret answers with its key");
    };
    let agreed = initiator.finish(&answer.message).expect("our secret");
    let mut keys = agreed.keys;
    let sealed = sealed_message::seal(&mut keys, &HandshakeMessage::Hello(hello(6, "wombat-3")));
    channel.send(&sealed).await.expect("sends");
    let accepted = receive_sealed(&channel, &mut keys).await;
    assert!(matches!(accepted, HandshakeMessage::Accept(_)));
    let link = b.incoming().await;
    // A replay of the same bytes by an eavesdropper.
    let again = raw_channel(&world.a, &world.b).await;
    send_message(&again, &key).await;
    assert!(matches!(
        receive_message(&again).await,
        HandshakeMessage::KeyAnswer(_)
    ));
    again.send(&sealed).await.expect("sends");
    assert_eq!(
        receive_message(&again).await,
        HandshakeMessage::Refuse(Refusal::Secret)
    );
    drop(again);
    assert!(b.no_more_incoming(), "no link");
    // The replayed hello must not end the link of the robot whose name it used.
    link.write_all(b"still there", None).await.expect("writes");
    let mut buffer = [0; 100];
    let size = within("the batch", channel.recv(&mut buffer)).await;
    assert!(size.expect("receives") > b"still there".len());
}

pub async fn refuses_anything_but_a_sealed_hello(world: World) {
    let file = File::with(OURS);
    let listener = format!("name=wombat-2;{}", file.option());
    let b = Peer::on(&world.b).listen_as(&listener).await;
    let hello = HandshakeMessage::Hello(hello(6, "wombat-3"));
    let early = Content::Batch(Lane::first(), b"an early batch").encode();
    for what in [
        "an early batch",
        "a hello that is not sealed",
        "half a hello",
        "a changed hello",
    ] {
        let channel = raw_channel(&world.a, &world.b).await;
        let mut keys = agree(&channel, &ours()).await;
        let mut sealed = sealed_message::seal(&mut keys, &hello);
        match what {
            "an early batch" => sealed = early.clone(),
            "a hello that is not sealed" => sealed = hello.encode(),
            "half a hello" => sealed.truncate(20),
            _ => sealed[10] ^= 1,
        }
        channel.send(&sealed).await.expect("sends");
        let refusal = receive_message(&channel).await;
        assert_eq!(refusal, HandshakeMessage::Refuse(Refusal::Secret), "{what}");
    }
    assert!(b.no_more_incoming());
}

/// A peer that has sealed its hello has the secret, so the reason is another one, and is sealed.
pub async fn refuses_an_invalid_sealed_hello_with_the_reason(world: World) {
    let file = File::with(OURS);
    let listener = format!("name=wombat-2;{}", file.option());
    let b = Peer::on(&world.b).listen_as(&listener).await;
    let with = |change: fn(&mut Hello)| {
        let mut hello = hello(6, "wombat-3");
        change(&mut hello);
        HandshakeMessage::Hello(hello)
    };
    for (what, message, refusal) in [
        (
            "an older version",
            with(|hello| hello.version = VERSION - 1),
            Refusal::Version,
        ),
        (
            "its mtu",
            with(|hello| hello.mtu = MIN_MTU - 1),
            Refusal::Malformed,
        ),
        (
            "its window",
            with(|hello| hello.window = MIN_WINDOW - 1),
            Refusal::Malformed,
        ),
        (
            "another message",
            HandshakeMessage::Accept(hello(6, "wombat-3")),
            Refusal::Malformed,
        ),
    ] {
        let channel = raw_channel(&world.a, &world.b).await;
        let mut keys = agree(&channel, &ours()).await;
        let sealed = sealed_message::seal(&mut keys, &message);
        channel.send(&sealed).await.expect("sends");
        let refused = receive_sealed(&channel, &mut keys).await;
        assert_eq!(refused, HandshakeMessage::Refuse(refusal), "{what}");
    }
    assert!(b.no_more_incoming());
}

pub async fn accepts_no_other_version_of_a_key_answer(world: World) {
    let file = File::with(OURS);
    let listener = world.b.listen(None, OPTIONS).await.expect("listens");
    let advertised = advertisement(listener.psm(), "wombat-2");
    let _advertising = world.b.advertise(&advertised, "wombat-2").await;
    let answering = async {
        let channel = listener.accept().await.expect("accepts");
        let HandshakeMessage::Key(key) = receive_message(&channel).await else {
            panic!("a dialler with a secret begins with its key");
        };
        let answered = respond(&ours(), &Key::header(VERSION), &key.message);
        let (message, _) = answered.expect("answers");
        let version = VERSION + 1;
        send_message(
            &channel,
            &HandshakeMessage::KeyAnswer(Key { version, message }),
        )
        .await;
        let more = within("the end", channel.recv(&mut [0; 200])).await;
        assert!(more.is_err(), "the dialler sends nothing more");
    };
    let a = Peer::on(&world.a);
    let locator = format!("ble/wombat-2#{}", file.option());
    let (dialled, ()) = tokio::join!(a.dial(&locator), answering);
    let error = dialled.expect_err("the dial fails").to_string();
    let reason = format!("it chose version {}", VERSION + 1);
    assert!(error.contains(&reason), "{error}");
}

/// Neither side falls back to a link without encryption, whatever it is offered.
pub async fn refuses_a_hello_without_keys(world: World) {
    let file = File::with(OURS);
    let listener = format!("name=wombat-2;{}", file.option());
    let b = Peer::on(&world.b).listen_as(&listener).await;
    let channel = raw_channel(&world.a, &world.b).await;
    send_message(&channel, &HandshakeMessage::Hello(hello(6, "wombat-3"))).await;
    let refused = HandshakeMessage::Refuse(Refusal::Secret);
    assert_eq!(receive_message(&channel).await, refused);
    // An older version is none, either.
    let channel = raw_channel(&world.a, &world.b).await;
    let key = Key {
        version: VERSION,
        message: [1; KEY_MESSAGE_BYTES],
    };
    let mut older = HandshakeMessage::Key(key).encode();
    older[5] = VERSION - 1;
    channel.send(&older).await.expect("sends");
    let refused = HandshakeMessage::Refuse(Refusal::Version);
    assert_eq!(receive_message(&channel).await, refused);
    assert!(b.no_more_incoming());
}

pub async fn forged_sdu_ends_an_encrypted_link(world: World) {
    let file = File::with(OURS);
    let listener = format!("name=wombat-2;{}", file.option());
    let b = Peer::on(&world.b).listen_as(&listener).await;
    let batch = |text: &[u8]| Content::Batch(Lane::first(), text).encode();
    for attack in ["injected", "not sealed", "changed", "repeated"] {
        let mut raw = dial_with_secret(&world.a, &world.b, "raw", &ours()).await;
        let far = b.incoming().await;
        raw.send_sdu(batch(b"honest")).await;
        let mut buffer = [0; 100];
        let size = within("the batch", far.read(&mut buffer, None)).await;
        assert_eq!(&buffer[..size.expect("reads")], b"honest");
        let mut sdu = raw.seal(batch(b"sealed"));
        match attack {
            "injected" => sdu = vec![0; 20],
            "not sealed" => sdu = batch(b"not sealed"),
            "changed" => sdu[3] ^= 1,
            _ => raw.send_raw(&sdu).await,
        }
        raw.send_raw(&sdu).await;
        let reason = "could not be authenticated";
        if attack == "repeated" {
            let size = within("the batch", far.read(&mut buffer, None)).await;
            assert_eq!(&buffer[..size.expect("reads")], b"sealed");
        }
        assert_link_ends(&mut raw, &far, reason, Goodbye::LostOrDamaged).await;
    }
}

/// A plain listener cannot prove anything, and anyone can send an advertisement.
pub async fn does_not_dial_a_plain_listener_with_a_secret(world: World) {
    let file = File::with(OURS);
    let listener = world.b.listen(None, OPTIONS).await.expect("listens");
    let advertised = Advertisement {
        plain: true,
        ..advertisement(listener.psm(), "wombat-2")
    };
    let _advertising = world.b.advertise(&advertised, "wombat-2").await;
    let a = Peer::on(&world.a);
    let locator = format!("ble/wombat-2#{}", file.option());
    let error = a.dial(&locator).await.expect_err("it is plain").to_string();
    assert!(error.contains(NOT_SHARED), "{error}");
    // Without a secret, the plain listener is dialled.
    let (dialled, _) = tokio::join!(a.dial("ble/wombat-2"), listener.accept());
    dialled.expect("dials");
}

pub async fn sec_high_requires_a_secret(world: World) {
    let b = Peer::on(&world.b);
    let refused = b.try_listen("name=wombat-2;sec=high").await;
    let error = refused.expect_err("there is no passkey").to_string();
    assert!(error.contains("sec=high needs a secret"), "{error}");
    let b = b.listen_as("name=wombat-2").await;
    let refused = Peer::on(&world.a).dial("ble/wombat-2#sec=high").await;
    let error = refused.expect_err("there is no passkey").to_string();
    assert!(error.contains("sec=high needs a secret"), "{error}");
    assert!(b.no_more_incoming());
}
