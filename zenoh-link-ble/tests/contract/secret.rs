//! Who has the team's secret is linked; who has not, or plays back what somebody said who has, is not.
use std::sync::Arc;

use tempfile::TempDir;
use zenoh_link_ble::{
    advertisement::Advertisement,
    hello::{Challenge, Hello, NodeId, Opening, Refusal},
    radio::Channel,
    secret::{Said, Secret, Side, NONCE_BYTES, PROOF_BYTES},
};

use super::{advertisement, World};
use crate::shared::{
    listener::OPTIONS,
    peer::{says, within, Peer},
    raw::{hello, raw_channel},
};

pub const OURS: &str = "fleet:what only we know";
pub const THEIRS: &str = "fleet:what only they know";
const NOT_SHARED: &str = "did not prove that it has the same secret";

/// A file with a secret, and the option that names it.
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
        ..hello(6, name)
    }
}

async fn hears(channel: &Arc<dyn Channel>) -> Opening {
    let mut buffer = [0; 2000];
    let size = within("the answer", channel.recv(&mut buffer)).await;
    Opening::decode(&buffer[..size.expect("receives")]).expect("an opening")
}

async fn sends(channel: &Arc<dyn Channel>, opening: &Opening) {
    let sent = within("sending", channel.send(&opening.encode())).await;
    sent.expect("sends");
}

/// The dialler's part, with our secret: the bytes it sends, and the listener's last word.
async fn proves(channel: &Arc<dyn Channel>, hello: &Opening) -> (Opening, Opening) {
    sends(channel, hello).await;
    let Opening::Challenge(challenge) = hears(channel).await else {
        panic!("a listener with a secret asks for it");
    };
    let said = Said {
        hello: &hello.encode(),
        listener: challenge.node,
        nonce: &challenge.nonce,
    };
    assert!(ours().is_proved(Side::Listener, said, &challenge.proof));
    let proof = Opening::Proof(ours().proof(Side::Dialler, said));
    sends(channel, &proof).await;
    (proof, hears(channel).await)
}

pub async fn two_with_the_same_secret_are_linked(world: World) {
    let file = File::with(OURS);
    let b = Peer::on(&world.b);
    let b = b
        .listens_as(&format!("name=wombat-2;{}", file.option()))
        .await;
    let a = Peer::on(&world.a);
    let locator = format!("ble/wombat-2#{}", file.option());
    let near = a.dials(&locator).await.expect("dials");
    let far = b.incoming().await;
    says(&near, &far, b"there").await;
    says(&far, &near, b"and back").await;
}

pub async fn a_node_that_listens_with_a_secret_dials_with_it(world: World) {
    let file = File::with(OURS);
    let listen = |name: &str| format!("name={name};{}", file.option());
    let b = Peer::on(&world.b).listens_as(&listen("wombat-2")).await;
    let a = Peer::on(&world.a).listens_as(&listen("wombat-1")).await;
    // Both at once, as two robots of a team do.
    let (one, other) = tokio::join!(a.dials("ble/wombat-2"), b.dials("ble/wombat-1"));
    let (near, far) = match (one, other) {
        (Ok(near), Err(_)) => (near, b.incoming().await),
        (Err(_), Ok(far)) => (a.incoming().await, far),
        (Ok(_), Ok(_)) => panic!("two links"),
        (Err(one), Err(other)) => panic!("no link: {one}; {other}"),
    };
    says(&near, &far, b"there").await;
    says(&far, &near, b"and back").await;
}

pub async fn without_the_secret_there_is_no_link_in_either_direction(world: World) {
    let (ours, theirs) = (File::with(OURS), File::with(THEIRS));
    let listener = format!("name=wombat-2;{}", ours.option());
    let b = Peer::on(&world.b).listens_as(&listener).await;
    let a = Peer::on(&world.a);
    for (locator, reason) in [
        ("ble/wombat-2".to_owned(), "do not have the same secret"),
        (format!("ble/wombat-2#{}", theirs.option()), NOT_SHARED),
        ("ble/wombat-2#plain=true".to_owned(), ""),
    ] {
        match a.dials(&locator).await {
            Err(error) => assert!(error.to_string().contains(reason), "{error}"),
            // A plain link begins with Zenoh's own first message.
            Ok(plain) => {
                plain.write_all(&[0x01, 9, 9], None).await.expect("writes");
                let end = within("being dropped", plain.read(&mut [0; 100], None)).await;
                assert!(end.is_err(), "{locator}");
            }
        }
        assert!(b.no_more_incoming(), "{locator}");
    }
    let locator = format!("ble/wombat-2#{}", ours.option());
    a.dials(&locator).await.expect("the right one is let in");
}

pub async fn a_stranger_that_takes_the_name_of_a_robot_gets_no_link(world: World) {
    let file = File::with(OURS);
    let a = Peer::on(&world.a);
    let accept = Opening::Accept(hello(6, "wombat-2"));
    let guess = Opening::Challenge(Challenge {
        node: NodeId(6),
        nonce: [1; NONCE_BYTES],
        proof: [1; PROOF_BYTES],
    });
    for (answer, reason) in [
        (accept, NOT_SHARED),
        (guess, NOT_SHARED),
        (Opening::Proof([1; PROOF_BYTES]), "was not asked for"),
    ] {
        let listener = world.b.listen(None, OPTIONS).await.expect("listens");
        let advertised = advertisement(listener.psm(), "wombat-2");
        let _advertising = world.b.advertise(&advertised, "wombat-2").await;
        let answering = async {
            let channel = listener.accept().await.expect("accepts");
            assert!(matches!(hears(&channel).await, Opening::Hello(_)));
            sends(&channel, &answer).await;
            let mut heard = Vec::new();
            let mut buffer = [0; 2000];
            while let Ok(size) = within("the end", channel.recv(&mut buffer)).await {
                heard.push(Opening::decode(&buffer[..size]).expect("an opening"));
            }
            heard
        };
        let locator = format!("ble/wombat-2#{}", file.option());
        let (dialled, heard) = tokio::join!(a.dials(&locator), answering);
        let error = dialled.expect_err("that is no link").to_string();
        assert!(error.contains(reason), "{error}");
        // Nothing that a stranger could use.
        let refused = [Opening::Refuse(Refusal::Secret)];
        assert!(heard.is_empty() || heard == refused, "{heard:?}");
    }
}

pub async fn an_opening_that_is_played_back_is_refused(world: World) {
    let file = File::with(OURS);
    let listener = format!("name=wombat-2;{}", file.option());
    let b = Peer::on(&world.b).listens_as(&listener).await;
    let opening = Opening::Hello(hello_with_nonce("wombat-3"));
    let channel = raw_channel(&world.a, &world.b).await;
    let (proof, answer) = proves(&channel, &opening).await;
    assert!(matches!(answer, Opening::Accept(_)), "{answer:?}");
    let link = b.incoming().await;
    // The same bytes again, by somebody who has listened.
    let again = raw_channel(&world.a, &world.b).await;
    sends(&again, &opening).await;
    assert!(matches!(hears(&again).await, Opening::Challenge(_)));
    sends(&again, &proof).await;
    assert_eq!(hears(&again).await, Opening::Refuse(Refusal::Secret));
    drop(again);
    assert!(b.no_more_incoming(), "no link");
    // Nor did the hello of a stranger end the link of whose name it took.
    link.write_all(b"still there", None).await.expect("writes");
    let mut buffer = [0; 100];
    let size = within("the batch", channel.recv(&mut buffer)).await;
    assert!(size.expect("receives") > b"still there".len());
}

/// A later version may append fields, and nobody may change those on the way.
pub async fn a_proof_covers_the_whole_hello(world: World) {
    let file = File::with(OURS);
    let listener = format!("name=wombat-2;{}", file.option());
    let b = Peer::on(&world.b).listens_as(&listener).await;
    let known = Opening::Hello(hello_with_nonce("wombat-3")).encode();
    let sent = [&known[..], b"a field of a later version"].concat();
    for (covered, is_accepted) in [(&known, false), (&sent, true)] {
        let channel = raw_channel(&world.a, &world.b).await;
        channel.send(&sent).await.expect("sends");
        let Opening::Challenge(challenge) = hears(&channel).await else {
            panic!("a listener with a secret asks for it");
        };
        let said = Said {
            hello: covered,
            listener: challenge.node,
            nonce: &challenge.nonce,
        };
        let is_proved = ours().is_proved(Side::Listener, said, &challenge.proof);
        assert_eq!(is_proved, is_accepted, "the listener's own proof");
        let proof = ours().proof(Side::Dialler, said);
        sends(&channel, &Opening::Proof(proof)).await;
        match hears(&channel).await {
            Opening::Accept(_) => assert!(is_accepted),
            Opening::Refuse(Refusal::Secret) => assert!(!is_accepted),
            other => panic!("{other:?}"),
        }
    }
    drop(b.incoming().await);
}

pub async fn with_a_secret_nothing_may_come_before_the_proof(world: World) {
    let file = File::with(OURS);
    let listener = format!("name=wombat-2;{}", file.option());
    let b = Peer::on(&world.b).listens_as(&listener).await;
    let half_a_proof = Opening::Proof([1; PROOF_BYTES]).encode()[..10].to_vec();
    let again = Opening::Hello(hello_with_nonce("wombat-3")).encode();
    for instead in [b"\x00\x00\x00an early batch".to_vec(), half_a_proof, again] {
        let channel = raw_channel(&world.a, &world.b).await;
        sends(&channel, &Opening::Hello(hello_with_nonce("wombat-3"))).await;
        assert!(matches!(hears(&channel).await, Opening::Challenge(_)));
        channel.send(&instead).await.expect("sends");
        let answer = hears(&channel).await;
        assert_eq!(answer, Opening::Refuse(Refusal::Malformed));
    }
    assert!(b.no_more_incoming());
}

/// It could not prove anything, and anybody can send an advertisement.
pub async fn a_plain_listener_is_not_dialled_with_a_secret(world: World) {
    let file = File::with(OURS);
    let listener = world.b.listen(None, OPTIONS).await.expect("listens");
    let advertised = Advertisement {
        plain: true,
        ..advertisement(listener.psm(), "wombat-2")
    };
    let _advertising = world.b.advertise(&advertised, "wombat-2").await;
    let a = Peer::on(&world.a);
    let locator = format!("ble/wombat-2#{}", file.option());
    let error = a
        .dials(&locator)
        .await
        .expect_err("it is plain")
        .to_string();
    assert!(error.contains(NOT_SHARED), "{error}");
    // Without a secret it is.
    let (dialled, _) = tokio::join!(a.dials("ble/wombat-2"), listener.accept());
    dialled.expect("dials");
}

pub async fn sec_high_needs_a_secret(world: World) {
    let b = Peer::on(&world.b);
    let refused = b.try_listen("name=wombat-2;sec=high").await;
    let error = refused.expect_err("there is no passkey").to_string();
    assert!(error.contains("sec=high needs a secret"), "{error}");
    let b = b.listens_as("name=wombat-2").await;
    let refused = Peer::on(&world.a).dials("ble/wombat-2#sec=high").await;
    let error = refused.expect_err("there is no passkey").to_string();
    assert!(error.contains("sec=high needs a secret"), "{error}");
    assert!(b.no_more_incoming());
}
