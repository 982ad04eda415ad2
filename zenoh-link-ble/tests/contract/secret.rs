//! Contract of the shared secret: peers with the secret are linked; peers without it, and replayed handshakes, are
//! rejected.
use std::sync::Arc;

use tempfile::TempDir;
use zenoh_link_ble::{
    advertisement::Advertisement,
    protocol::hello::{Challenge, HandshakeMessage, Hello, NodeId, Refusal},
    protocol::secret::{ProofTranscript, Secret, Side, NONCE_BYTES, PROOF_BYTES},
    radio::Channel,
};

use super::{advertisement, World};
use crate::shared::{
    listener::OPTIONS,
    peer::{assert_delivers, within, Peer},
    raw::{hello, raw_channel},
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

fn hello_with_nonce(name: &str) -> Hello {
    Hello {
        nonce: Some([5; NONCE_BYTES]),
        intervals: None,
        ..hello(6, name)
    }
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

/// Runs the dialler's side of the handshake with our secret. Returns the proof that was sent, and the listener's last
/// message.
async fn authenticate(
    channel: &Arc<dyn Channel>,
    hello: &HandshakeMessage,
) -> (HandshakeMessage, HandshakeMessage) {
    send_message(channel, hello).await;
    let HandshakeMessage::Challenge(challenge) = receive_message(channel).await else {
        panic!("a listener with a secret sends a challenge");
    };
    let transcript = ProofTranscript {
        hello: &hello.encode(),
        listener: challenge.node,
        nonce: &challenge.nonce,
    };
    assert!(ours().verify(Side::Listener, transcript, &challenge.proof));
    let proof = HandshakeMessage::Proof(ours().proof(Side::Dialler, transcript));
    send_message(channel, &proof).await;
    (proof, receive_message(channel).await)
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
    let guess = HandshakeMessage::Challenge(Challenge {
        node: NodeId(6),
        nonce: [1; NONCE_BYTES],
        proof: [1; PROOF_BYTES],
    });
    for (answer, reason) in [
        (accept, NOT_SHARED),
        (guess, NOT_SHARED),
        (
            HandshakeMessage::Proof([1; PROOF_BYTES]),
            "was not requested",
        ),
    ] {
        let listener = world.b.listen(None, OPTIONS).await.expect("listens");
        let advertised = advertisement(listener.psm(), "wombat-2");
        let _advertising = world.b.advertise(&advertised, "wombat-2").await;
        let answering = async {
            let channel = listener.accept().await.expect("accepts");
            assert!(matches!(
                receive_message(&channel).await,
                HandshakeMessage::Hello(_)
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
    let opening = HandshakeMessage::Hello(hello_with_nonce("wombat-3"));
    let channel = raw_channel(&world.a, &world.b).await;
    let (proof, answer) = authenticate(&channel, &opening).await;
    assert!(matches!(answer, HandshakeMessage::Accept(_)), "{answer:?}");
    let link = b.incoming().await;
    // A replay of the same bytes by an eavesdropper.
    let again = raw_channel(&world.a, &world.b).await;
    send_message(&again, &opening).await;
    assert!(matches!(
        receive_message(&again).await,
        HandshakeMessage::Challenge(_)
    ));
    send_message(&again, &proof).await;
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

/// A later version may append fields, which must be protected against changes too.
pub async fn proof_covers_the_whole_hello(world: World) {
    let file = File::with(OURS);
    let listener = format!("name=wombat-2;{}", file.option());
    let b = Peer::on(&world.b).listen_as(&listener).await;
    let known = HandshakeMessage::Hello(hello_with_nonce("wombat-3")).encode();
    let sent = [&known[..], b"a field of a later version"].concat();
    for (covered, is_accepted) in [(&known, false), (&sent, true)] {
        let channel = raw_channel(&world.a, &world.b).await;
        channel.send(&sent).await.expect("sends");
        let HandshakeMessage::Challenge(challenge) = receive_message(&channel).await else {
            panic!("a listener with a secret sends a challenge");
        };
        let transcript = ProofTranscript {
            hello: covered,
            listener: challenge.node,
            nonce: &challenge.nonce,
        };
        let is_proved = ours().verify(Side::Listener, transcript, &challenge.proof);
        assert_eq!(is_proved, is_accepted, "the listener's own proof");
        let proof = ours().proof(Side::Dialler, transcript);
        send_message(&channel, &HandshakeMessage::Proof(proof)).await;
        match receive_message(&channel).await {
            HandshakeMessage::Accept(_) => assert!(is_accepted),
            HandshakeMessage::Refuse(Refusal::Secret) => assert!(!is_accepted),
            other => panic!("{other:?}"),
        }
    }
    drop(b.incoming().await);
}

pub async fn refuses_messages_before_the_proof(world: World) {
    let file = File::with(OURS);
    let listener = format!("name=wombat-2;{}", file.option());
    let b = Peer::on(&world.b).listen_as(&listener).await;
    let half_a_proof = HandshakeMessage::Proof([1; PROOF_BYTES]).encode()[..10].to_vec();
    let again = HandshakeMessage::Hello(hello_with_nonce("wombat-3")).encode();
    for instead in [b"\x00\x00\x00an early batch".to_vec(), half_a_proof, again] {
        let channel = raw_channel(&world.a, &world.b).await;
        send_message(
            &channel,
            &HandshakeMessage::Hello(hello_with_nonce("wombat-3")),
        )
        .await;
        assert!(matches!(
            receive_message(&channel).await,
            HandshakeMessage::Challenge(_)
        ));
        channel.send(&instead).await.expect("sends");
        let answer = receive_message(&channel).await;
        assert_eq!(answer, HandshakeMessage::Refuse(Refusal::Malformed));
    }
    assert!(b.no_more_incoming());
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
