//! Opens links on TCP with a peer that sends any bytes, as its dialler and as its listener. Without the secret, nobody is accepted.
use std::{io::Cursor, sync::LazyLock};

use tokio::{
    io::{join, sink, AsyncRead, AsyncWrite},
    runtime::{Builder, Runtime},
};
use zenoh_link_any::meeting::{accept, dial};
use link_lanes::{hello::{Hello, NodeId, PathOf, MAGIC, VERSION}, secret::Secret};

/// HELLO, ACCEPT, REFUSE, KEY, KEY ANSWER, and an unknown kind.
const KINDS: std::ops::RangeInclusive<u8> = 1..=6;

static SECRET: LazyLock<Secret> =
    LazyLock::new(|| Secret::new(b"what only the team knows").expect("long enough"));
static RUNTIME: LazyLock<Runtime> =
    LazyLock::new(|| Builder::new_current_thread().build().expect("started"));

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    check(input.to_vec());
    // The same bytes as messages with a correct head, of which the first byte is the length.
    for kind in KINDS {
        let mut sent = Vec::new();
        let mut rest = input;
        while let [length, tail @ ..] = rest {
            let (body, tail) = tail.split_at(usize::from(*length).min(tail.len()));
            let message = [&MAGIC[..], &[kind], body].concat();
            sent.extend_from_slice(&(message.len() as u16).to_le_bytes());
            sent.extend_from_slice(&message);
            rest = tail;
        }
        check(sent);
    }
}

fn check(sent: Vec<u8>) {
    let own = || Hello {
        version: VERSION,
        node: NodeId(1),
        mtu: 8192,
        window: u16::MAX,
        name: "own".to_owned(),
        intervals: None,
        path: Some(PathOf {
            link: 7,
            joins: false,
        }),
        accepts_compressed: false,
    };
    let accepted = async {
        accept(&mut peer(sent.clone()), Some(&*SECRET), |_| Ok(own()))
            .await
            .is_ok()
    };
    assert!(!RUNTIME.block_on(accepted));
    let dialled = async { dial(&mut peer(sent.clone()), &SECRET, own()).await.is_ok() };
    assert!(!RUNTIME.block_on(dialled));
}

/// Returns a connection on which the peer has sent these bytes, and then closes it.
fn peer(sent: Vec<u8>) -> impl AsyncRead + AsyncWrite + Unpin {
    join(Cursor::new(sent), sink())
}
