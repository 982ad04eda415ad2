//! Tests transfers between two robots, linked over TCP in one process, with link losses, restarts, refusals and invalid
//! replies:
//! `cargo test -p rect-robot --test timing transfer`
use std::{
    fs,
    future::IntoFuture,
    path::Path,
    sync::{
        atomic::{AtomicU64, Ordering},
        Arc, Mutex,
    },
    time::{Duration, Instant},
};

use rect::{Error, ReceiveOptions, Robot, Topic};
use rect_core::{
    message::encoding::Encoding,
    storage::Content,
    transfer::{offer::FileName, Answer, Checksum, Fault, Offer, Refusal, Request},
};

use crate::pair::{dialling, free_endpoint, listening, pair, TIMEOUT};
use crate::wire::Wire;
use tokio::{
    sync::{Mutex as Turn, MutexGuard},
    time::timeout,
};
use zenoh::Wait;

const MB: usize = 1_000_000;

/// Waits until no other test runs, since the tests measure time and memory.
async fn turn() -> MutexGuard<'static, ()> {
    static TURN: Turn<()> = Turn::const_new(());
    TURN.lock().await
}

/// Returns incompressible bytes.
fn noise(length: usize) -> Vec<u8> {
    let mut state = 0x9E37_79B9_7F4A_7C15u64;
    let mut bytes = Vec::with_capacity(length + 8);
    while bytes.len() < length {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        bytes.extend_from_slice(&state.to_le_bytes());
    }
    bytes.truncate(length);
    bytes
}

/// The number of received bytes that was last reported to the sender.
#[derive(Clone, Default)]
struct ReportedBytes(Arc<AtomicU64>);

impl ReportedBytes {
    /// Waits until at least `bytes` are reported.
    async fn reaches(&self, bytes: u64) {
        let reached = async {
            while self.0.load(Ordering::SeqCst) < bytes {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        timeout(TIMEOUT, reached).await.expect("in time");
    }

    /// Returns a callback for `on_progress`.
    fn watch(&self) -> impl FnMut(rect_core::transfer::Progress) + Send + 'static {
        let reported = self.0.clone();
        move |progress| reported.store(progress.received_bytes, Ordering::SeqCst)
    }
}

/// Two robots and the wire between them.
struct Wired {
    a: Robot,
    b: Robot,
    wire: Wire,
    /// The endpoint at which `b` listens.
    endpoint: String,
}

async fn wired(bytes_per_s: f64) -> Wired {
    let endpoint = free_endpoint();
    let b = listening("b", &endpoint).await;
    let wire = Wire::to(&endpoint, bytes_per_s);
    let a = dialling("a", &wire.endpoint).await;
    Wired {
        a,
        b,
        wire,
        endpoint,
    }
}

fn in_folder(folder: &tempfile::TempDir) -> ReceiveOptions {
    ReceiveOptions::in_folder(folder.path(), 1 << 30)
}

fn file_of(received: &rect::Received) -> Vec<u8> {
    match &received.content {
        Content::File(path) => fs::read(path).expect("stored"),
        Content::Bytes(bytes) => bytes.to_vec(),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn transfer_completes_after_three_link_losses() {
    let _turn = turn().await;
    let (bytes, folder) = (noise(5 * MB), tempfile::tempdir().expect("a folder"));
    let Wired { a, b, wire, .. } = wired(2e6).await;
    let received = b
        .receive_transfers("a/maps/*", in_folder(&folder))
        .await
        .expect("declared");
    let reported = ReportedBytes::default();
    let sent = a
        .transfer("b", "maps/x", bytes.clone())
        .expect("valid arguments")
        .name("x.bin")
        .on_progress(reported.watch());
    let sent = tokio::spawn(sent.into_future());
    for part in 1..4u64 {
        reported.reaches(part * 5 * MB as u64 / 4).await;
        wire.cut(Duration::from_millis(300)).await;
    }
    timeout(TIMEOUT, sent)
        .await
        .expect("in time")
        .expect("no panic")
        .expect("sent");
    let got = received.next().await.expect("open").expect("complete");
    assert!(file_of(&got) == bytes, "the same bytes");
    assert_eq!(got.content, Content::File(folder.path().join("a/x.bin")));
    let overhead = wire.carried() as i64 - bytes.len() as i64;
    println!("{overhead} bytes of overhead on the wire");
    // 1 % for headers, and at most the bytes in flight at each of three losses.
    assert!(overhead < 1_500_000, "{overhead}");
}

#[tokio::test(flavor = "multi_thread")]
async fn transfer_resumes_after_restart_of_sender_or_receiver() {
    let _turn = turn().await;
    let (bytes, folder) = (noise(4 * MB), tempfile::tempdir().expect("a folder"));
    let Wired {
        a,
        b,
        wire,
        endpoint,
    } = wired(2e6).await;
    let received = b
        .receive_transfers("*/**", in_folder(&folder))
        .await
        .expect("declared");
    let reported = ReportedBytes::default();
    let send = |robot: &Robot| {
        let sent = robot
            .transfer("b", "x", bytes.clone())
            .expect("valid arguments")
            .on_progress(reported.watch());
        tokio::spawn(sent.into_future())
    };
    let sent = send(&a);
    reported.reaches(MB as u64).await;
    // Restarts the sender.
    sent.abort();
    a.close().await.expect("closed");
    let a = dialling("a", &wire.endpoint).await;
    let sent = send(&a);
    reported.reaches(2 * MB as u64).await;
    // Restarts the receiver.
    drop(received);
    b.close().await.expect("closed");
    drop(b);
    let b = listening("b", &endpoint).await;
    let received = b
        .receive_transfers("*/**", in_folder(&folder))
        .await
        .expect("declared");
    timeout(TIMEOUT, sent)
        .await
        .expect("in time")
        .expect("no panic")
        .expect("sent");
    let got = received.next().await.expect("open").expect("complete");
    assert!(file_of(&got) == bytes, "the same bytes");
    let overhead = wire.carried() as i64 - bytes.len() as i64;
    println!("{overhead} bytes of overhead on the wire");
    assert!(overhead < 1_000_000, "{overhead}");
}

/// Returns a value of `/proc/self/status`, in kB.
fn memory_kb(field: &str) -> u64 {
    let status = fs::read_to_string("/proc/self/status").expect("linux");
    let line = status
        .lines()
        .find(|line| line.starts_with(field))
        .expect("present");
    line.split_whitespace()
        .nth(1)
        .and_then(|kb| kb.parse().ok())
        .expect("a number")
}

#[tokio::test(flavor = "multi_thread")]
async fn large_file_transfer_is_fast_and_uses_little_memory() {
    let _turn = turn().await;
    let size = 300 * MB;
    let (folder, source_folder) = (
        tempfile::tempdir().expect("a folder"),
        tempfile::tempdir().expect("a folder"),
    );
    let path = source_folder.path().join("large.bin");
    fs::write(&path, noise(size)).expect("written");
    let (a, b) = pair("a", "b").await;
    let received = b
        .receive_transfers("a/**", in_folder(&folder))
        .await
        .expect("declared");
    // Resets the peak memory usage.
    fs::write("/proc/self/clear_refs", "5").expect("linux");
    let (before, start) = (memory_kb("VmRSS:"), Instant::now());
    a.transfer("b", "large", &path)
        .expect("valid arguments")
        .await
        .expect("sent");
    let took = start.elapsed();
    let additional_kb = memory_kb("VmHWM:").saturating_sub(before);
    let rate = size as f64 / took.as_secs_f64() / 1e6;
    println!("{size} bytes in {took:?}, {rate:.0} MB/s with both checksums, at most {additional_kb} kB of additional memory");
    let got = received.next().await.expect("open").expect("complete");
    assert_eq!(got.size_bytes, size as u64);
    assert!(additional_kb < 60_000, "{additional_kb} kB");
}

#[tokio::test(flavor = "multi_thread")]
async fn empty_and_small_transfers_are_received_in_memory_with_their_encoding() {
    let _turn = turn().await;
    let (a, b) = pair("a", "b").await;
    let received = b
        .receive_transfers("*/**", ReceiveOptions::in_memory(100))
        .await
        .expect("declared");
    a.transfer("b", "nothing", vec![])
        .expect("valid arguments")
        .await
        .expect("sent");
    let got = received.next().await.expect("open").expect("complete");
    assert_eq!(got.content, Content::Bytes(Default::default()));
    let sent = a
        .transfer(
            "b",
            "little",
            rect::ToPayload::to_payload("hä?").expect("text"),
        )
        .expect("valid arguments");
    sent.await.expect("sent");
    let got = received.next().await.expect("open").expect("complete");
    assert_eq!(
        (
            got.encoding.clone(),
            got.sender.as_str(),
            got.topic.as_str()
        ),
        (Encoding::TEXT, "a", "little")
    );
    assert_eq!(file_of(&got), "hä?".as_bytes());
}

#[tokio::test(flavor = "multi_thread")]
async fn repeated_and_concurrent_transfers_are_all_received() {
    let _turn = turn().await;
    let (a, b) = pair("a", "b").await;
    let received = b
        .receive_transfers("*/**", ReceiveOptions::in_memory(1 << 20))
        .await
        .expect("declared");
    let bytes = noise(1 << 20);
    let send = |topic| {
        tokio::spawn(
            a.transfer("b", topic, bytes.clone())
                .expect("valid arguments")
                .into_future(),
        )
    };
    let both = [send("one"), send("two")];
    for sent in both {
        timeout(TIMEOUT, sent)
            .await
            .expect("in time")
            .expect("no panic")
            .expect("sent");
    }
    send("one").await.expect("no panic").expect("sent");
    for _ in 0..3 {
        let got = timeout(TIMEOUT, received.next())
            .await
            .expect("in time")
            .expect("open")
            .expect("complete");
        assert!(file_of(&got) == bytes);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn transfers_time_out_if_the_program_takes_none() {
    let _turn = turn().await;
    let (a, b) = pair("a", "b").await;
    let options = ReceiveOptions::in_memory(1000).max_concurrent(1);
    let received = b
        .receive_transfers("*/**", options)
        .await
        .expect("declared");
    let send = |content: &'static str| {
        let transfer = a.transfer("b", "notes", content.as_bytes().to_vec());
        let transfer = transfer.expect("valid arguments");
        let transfer = transfer.timeout(Duration::from_millis(500));
        timeout(TIMEOUT, transfer.into_future())
    };
    send("first")
        .await
        .expect("in time")
        .expect("it waits for the program");
    // The second one has arrived, and the third one finds no place.
    for content in ["second", "third"] {
        let error = send(content).await.expect("in time").expect_err(content);
        assert!(matches!(error, Error::TimedOut { .. }), "{error}");
        let reason = "the program of b has taken none of those that have arrived";
        assert!(error.to_string().contains(reason), "{error}");
    }
    for content in ["first", "second"] {
        let next = timeout(TIMEOUT, received.next()).await.expect("in time");
        let next = next.expect("open").expect("received");
        assert_eq!(file_of(&next), content.as_bytes());
    }
    send("third")
        .await
        .expect("in time")
        .expect("there is a place");
}

#[tokio::test(flavor = "multi_thread")]
async fn transfers_that_are_not_accepted_are_refused() {
    let _turn = turn().await;
    let (a, b) = pair("a", "b").await;
    let unanswered = a
        .transfer("b", "maps/x", vec![1])
        .expect("valid arguments")
        .timeout(Duration::from_secs(2))
        .await;
    assert!(
        matches!(unanswered, Err(Error::TimedOut { .. })),
        "{unanswered:?}"
    );
    let _received = b
        .receive_transfers("a/maps/*", ReceiveOptions::in_memory(10))
        .await
        .expect("declared");
    let other = a
        .transfer("b", "logs/x", vec![1])
        .expect("valid arguments")
        .await;
    let not_accepted = |refusal: &Refusal| *refusal == Refusal::NotAccepted;
    assert!(
        matches!(&other, Err(Error::TransferRefused { refusal, .. }) if not_accepted(refusal)),
        "{other:?}"
    );
    let large = a
        .transfer("b", "maps/x", vec![1; 11])
        .expect("valid arguments")
        .await;
    let text = large.expect_err("refused").to_string();
    assert!(text.contains("larger than the 10 bytes"), "{text}");
    let name = a
        .transfer("b", "maps/x", vec![1])
        .expect("valid arguments")
        .name("../x")
        .await;
    assert!(matches!(name, Err(Error::Offer(_))), "{name:?}");
    let none = a
        .transfer("b", "maps/x", Path::new("/none"))
        .expect("valid arguments")
        .await;
    assert!(matches!(none, Err(Error::File { .. })), "{none:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn file_changed_during_transfer_fails_at_both_ends() {
    let _turn = turn().await;
    let source_folder = tempfile::tempdir().expect("a folder");
    let path = source_folder.path().join("log");
    fs::write(&path, noise(3 * MB)).expect("written");
    let Wired {
        a, b, wire: _wire, ..
    } = wired(1e6).await;
    let received = b
        .receive_transfers("*/**", ReceiveOptions::in_memory(1 << 30))
        .await
        .expect("declared");
    let reported = ReportedBytes::default();
    let sent = a
        .transfer("b", "log", &path)
        .expect("valid arguments")
        .on_progress(reported.watch());
    let sent = tokio::spawn(sent.into_future());
    reported.reaches(MB as u64 / 2).await;
    fs::write(&path, noise(2 * MB)).expect("written");
    let error = timeout(TIMEOUT, sent)
        .await
        .expect("in time")
        .expect("no panic")
        .expect_err("changed")
        .to_string();
    assert!(error.contains("changed"), "{error}");
    let got = timeout(TIMEOUT, received.next())
        .await
        .expect("in time")
        .expect("open");
    let error = got.expect_err("changed").to_string();
    assert!(error.contains("changed"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn storage_error_of_the_receiver_fails_at_both_ends() {
    let _turn = turn().await;
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("a"), "a file where a folder is to be").expect("written");
    let (a, b) = pair("a", "b").await;
    let received = b
        .receive_transfers("*/**", in_folder(&folder))
        .await
        .expect("declared");
    let sent = a
        .transfer("b", "x", vec![1])
        .expect("valid arguments")
        .await;
    let not_stored = |fault: &Fault| matches!(fault, Fault::NotStored(_));
    assert!(
        matches!(&sent, Err(Error::TransferFailed { fault, .. }) if not_stored(fault)),
        "{sent:?}"
    );
    assert!(received.next().await.expect("open").is_err());
}

/// Offers a transfer of `size_bytes` bytes, replies to the receiver's requests for `length` bytes with `reply(length)`,
/// and returns the fault at the receiver.
async fn fault_after_replies(
    size_bytes: u64,
    reply: impl Fn(u32) -> Result<Vec<u8>, Vec<u8>> + Send + Sync + 'static,
) -> Fault {
    let (a, b) = pair("a", "b").await;
    let received = b
        .receive_transfers("*/**", ReceiveOptions::in_memory(1 << 20))
        .await
        .expect("declared");
    let offer = Offer {
        sender: "a".parse().expect("a name"),
        topic: Topic::new("x").expect("a topic"),
        name: FileName::default(),
        encoding: Encoding::BYTES,
        size_bytes,
        checksum: Checksum::of(b"something else"),
        call: 1,
    };
    let key = format!("rect/a/@rect/transfer/{}", offer.id(b.name()));
    let (reply_key, confirmation) = (key.clone(), offer.encode());
    let queryable = a
        .zenoh()
        .declare_queryable(key)
        .complete(true)
        .callback(move |query| {
            let request = query
                .payload()
                .and_then(|bytes| Request::decode(&bytes.to_bytes()));
            if let Some(Request::Confirm) = request {
                let _ = query.reply(&reply_key, &confirmation[..]).wait();
            }
            if let Some(Request::Range { length, .. }) = request {
                for _ in 0..3 {
                    let _ = match reply(length) {
                        Ok(bytes) => query.reply(&reply_key, bytes).wait(),
                        Err(bytes) => query.reply_err(bytes).wait(),
                    };
                }
            }
        });
    let _queryable = queryable.wait().expect("declared");
    let ask = async |payload: Vec<u8>| {
        let replies = a
            .zenoh()
            .get("rect/b/@rect/inbox")
            .payload(payload)
            .await
            .expect("asked");
        let reply = replies.recv_async().await.ok()?.into_result().ok()?;
        Answer::decode(&reply.payload().to_bytes())
    };
    while ask(b"nonsense".to_vec()).await.is_none() {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert!(matches!(ask(vec![]).await, Some(Answer::Refused(_))));
    assert!(matches!(
        ask(vec![1; 100_000]).await,
        Some(Answer::Refused(_))
    ));
    ask(offer.encode()).await;
    let got = timeout(TIMEOUT, received.next())
        .await
        .expect("in time")
        .expect("open");
    match got {
        Err(Error::TransferFailed { fault, .. }) => fault,
        other => panic!("{other:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_replies_of_a_sender_fail_the_transfer() {
    let _turn = turn().await;
    let short = fault_after_replies(5000, |length| Ok(vec![0; length as usize - 1])).await;
    assert!(matches!(short, Fault::Protocol(_)), "{short:?}");
    let long = fault_after_replies(5000, |length| Ok(vec![0; length as usize + 100_000])).await;
    assert!(matches!(long, Fault::Protocol(_)), "{long:?}");
    let wrong = fault_after_replies(5000, |length| Ok(vec![0; length as usize])).await;
    assert_eq!(wrong, Fault::Checksum);
    let fault =
        fault_after_replies(5000, |_| Err(Fault::Unreadable("a disk".into()).encode())).await;
    assert_eq!(fault, Fault::Unreadable("a disk".into()));
}

#[tokio::test(flavor = "multi_thread")]
async fn progress_is_reported_at_both_ends_and_close_ends_next() {
    let _turn = turn().await;
    let (a, b) = pair("a", "b").await;
    let seen = Arc::new(Mutex::new(Vec::new()));
    let reports = seen.clone();
    let options = ReceiveOptions::in_memory(1 << 30).on_progress(move |about, progress| {
        reports
            .lock()
            .expect("not poisoned")
            .push((about.name.clone(), progress))
    });
    let received = b
        .receive_transfers("*/**", options)
        .await
        .expect("declared");
    let reported = ReportedBytes::default();
    let sent = a
        .transfer("b", "x", noise(MB))
        .expect("valid arguments")
        .name("x")
        .on_progress(reported.watch());
    sent.await.expect("sent");
    assert_eq!(reported.0.load(Ordering::SeqCst), MB as u64);
    let seen = seen.lock().expect("not poisoned").clone();
    assert!(seen
        .iter()
        .all(|(name, progress)| name == "x" && progress.size_bytes == MB as u64));
    assert_eq!(seen.last().expect("some").1.fraction(), 1.0);
    assert!(received.next().await.expect("open").is_ok());
    b.close().await.expect("closed");
    assert!(timeout(TIMEOUT, received.next())
        .await
        .expect("in time")
        .is_none());
}

/// Returns an offer of `bytes` in the name of the robot `sender`.
fn offer_of(sender: &str, bytes: &[u8]) -> Offer {
    Offer {
        sender: sender.parse().expect("a name"),
        topic: Topic::new("maps/x").expect("a topic"),
        name: FileName::new("map.bin").expect("a file's name"),
        encoding: Encoding::BYTES,
        size_bytes: bytes.len() as u64,
        checksum: Checksum::of(bytes),
        call: 1,
    }
}

/// Repeats an offer from `robot` until `b` answers, and returns the answer.
async fn offered(robot: &Robot, offer: &Offer) -> Answer {
    let answered = async {
        loop {
            let asked = robot.zenoh().get("rect/b/@rect/inbox");
            let replies = asked.payload(offer.encode()).await.expect("asked");
            if let Ok(Ok(reply)) = replies.recv_async().await.map(|reply| reply.into_result()) {
                return Answer::decode(&reply.payload().to_bytes()).expect("an answer");
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    timeout(TIMEOUT, answered).await.expect("in time")
}

#[tokio::test(flavor = "multi_thread")]
async fn forged_offer_does_not_change_stored_files() {
    let _turn = turn().await;
    let folder = tempfile::tempdir().expect("a folder");
    let endpoint = free_endpoint();
    let b = listening("b", &endpoint).await;
    let honest = dialling("honest", &endpoint).await;
    let forger = dialling("forger", &endpoint).await;
    let received = b
        .receive_transfers("*/**", in_folder(&folder))
        .await
        .expect("declared");
    honest
        .transfer("b", "maps/x", noise(1000))
        .expect("valid arguments")
        .name("map.bin")
        .await
        .expect("sent");
    assert!(received.next().await.expect("open").is_ok());
    let file = folder.path().join("honest/map.bin");
    for (sender, bytes) in [
        ("honest", &b""[..]),
        ("honest", b"forged"),
        ("nobody", b""),
        ("nobody", b"forged"),
    ] {
        offered(&forger, &offer_of(sender, bytes)).await;
    }
    // Actions that the forged offers caused have ended when a later transfer has ended.
    for _ in 0..3 {
        honest
            .transfer("b", "maps/y", noise(10))
            .expect("valid arguments")
            .await
            .expect("sent");
        let got = received.next().await.expect("open").expect("complete");
        assert_eq!((got.topic.as_str(), got.name.as_str()), ("maps/y", ""));
    }
    assert_eq!(fs::read(&file).expect("present"), noise(1000));
    let senders: Vec<_> = fs::read_dir(folder.path()).expect("present").collect();
    assert_eq!(senders.len(), 1, "{senders:?}");
    for file in fs::read_dir(folder.path().join("honest")).expect("present") {
        let name = file.expect("read").file_name();
        assert!(!name.to_string_lossy().ends_with(".part"), "{name:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn unconfirmed_offers_do_not_block_an_honest_sender() {
    let _turn = turn().await;
    let folder = tempfile::tempdir().expect("a folder");
    let endpoint = free_endpoint();
    let b = listening("b", &endpoint).await;
    let honest = dialling("honest", &endpoint).await;
    let forger = dialling("forger", &endpoint).await;
    let received = b
        .receive_transfers("*/**", in_folder(&folder))
        .await
        .expect("declared");
    // The forger keeps each query without replying until its timeout expires.
    let kept = Mutex::new(Vec::new());
    let silent = forger
        .zenoh()
        .declare_queryable("rect/forger/@rect/transfer/*");
    let silent = silent.callback(move |query| kept.lock().expect("not poisoned").push(query));
    let _silent = silent.wait().expect("declared");
    for n in 0..20u8 {
        offered(&forger, &offer_of("forger", &[n; 100])).await;
        offered(&forger, &offer_of("nobody", &[n; 100])).await;
    }
    let start = Instant::now();
    let sent = honest
        .transfer("b", "maps/x", noise(1000))
        .expect("valid arguments");
    timeout(TIMEOUT, sent.into_future())
        .await
        .expect("in time")
        .expect("sent");
    let took = start.elapsed();
    println!("an honest transfer among 40 unconfirmed offers took {took:?}");
    assert!(took < Duration::from_secs(5), "{took:?}");
    let got = received.next().await.expect("open").expect("complete");
    assert_eq!(got.sender.as_str(), "honest");
    let senders = fs::read_dir(folder.path()).expect("present").count();
    assert_eq!(senders, 1, "the other offers leave no files");
}

/// Returns the outcome at the sender if the receiver disappears as soon as its program has received the transfer.
async fn outcome_before_the_receiver_exits(folder: &Path) -> Result<(), Error> {
    let Wired { a, b, wire, .. } = wired(5e3).await;
    let options = ReceiveOptions::in_folder(folder, 1 << 20);
    let received = b
        .receive_transfers("*/**", options)
        .await
        .expect("declared");
    let sent = a.transfer("b", "x", noise(100)).expect("valid arguments");
    let sent = sent.timeout(Duration::from_secs(8)).into_future();
    let sent = tokio::spawn(sent);
    let _ended = timeout(TIMEOUT, received.next()).await.expect("in time");
    tokio::select! {
        () = wire.cut(TIMEOUT) => panic!("the sender waits for a receiver that has exited"),
        sent = sent => sent.expect("no panic"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn sender_gets_the_outcome_before_the_receiving_program() {
    let _turn = turn().await;
    let folder = tempfile::tempdir().expect("a folder");
    let done = outcome_before_the_receiver_exits(folder.path()).await;
    assert!(done.is_ok(), "{done:?}");
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("a"), "a file where a folder is to be").expect("written");
    let failed = outcome_before_the_receiver_exits(folder.path()).await;
    assert!(
        matches!(
            &failed,
            Err(Error::TransferFailed {
                fault: Fault::NotStored(_),
                ..
            })
        ),
        "{failed:?}"
    );
}
