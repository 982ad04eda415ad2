//! Transfers between two programs, linked over TCP in one process: cut, restarted, refused, lied to.
//! `cargo test -p rect --test transfer`
mod pair;
mod wire;

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

use pair::{dialling, free_endpoint, listening, pair, PATIENCE};
use rect::{
    core::{
        encoding::Encoding,
        transfer::{offer::FileName, Answer, Checksum, Fault, Offer, Refusal, Request},
    },
    storage::Content,
    Error, ReceiveTransfers, Robot, Topic,
};
use tokio::{
    sync::{Mutex as Turn, MutexGuard},
    time::timeout,
};
use wire::Wire;
use zenoh::Wait;

const MB: usize = 1_000_000;

/// One at a time: they measure time and memory.
async fn turn() -> MutexGuard<'static, ()> {
    static TURN: Turn<()> = Turn::const_new(());
    TURN.lock().await
}

/// Bytes that repeat nowhere.
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

/// What the sender knows to be held.
#[derive(Clone, Default)]
struct Held(Arc<AtomicU64>);

impl Held {
    async fn reaches(&self, bytes: u64) {
        let there = async {
            while self.0.load(Ordering::SeqCst) < bytes {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        timeout(PATIENCE, there).await.expect("in time");
    }

    fn watch(&self) -> impl FnMut(rect::core::transfer::Progress) + Send + 'static {
        let held = self.0.clone();
        move |progress| held.store(progress.held_bytes, Ordering::SeqCst)
    }
}

/// Two robots' programs, and what is between them.
struct Wired {
    a: Robot,
    b: Robot,
    wire: Wire,
    /// Where `b` listens.
    there: String,
}

async fn wired(bytes_per_s: f64) -> Wired {
    let there = free_endpoint();
    let b = listening("b", &there).await;
    let wire = Wire::to(&there, bytes_per_s);
    let a = dialling("a", &wire.endpoint).await;
    Wired { a, b, wire, there }
}

fn in_folder(folder: &tempfile::TempDir) -> ReceiveTransfers {
    ReceiveTransfers::in_folder(folder.path(), 1 << 30)
}

fn file_of(received: &rect::Received) -> Vec<u8> {
    match &received.content {
        Content::File(path) => fs::read(path).expect("kept"),
        Content::Bytes(bytes) => bytes.to_vec(),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn five_megabytes_arrive_though_the_link_is_cut_three_times() {
    let _turn = turn().await;
    let (bytes, folder) = (noise(5 * MB), tempfile::tempdir().expect("a folder"));
    let Wired { a, b, wire, .. } = wired(2e6).await;
    let received = b
        .receive_transfers("a/maps/*", in_folder(&folder))
        .await
        .expect("declared");
    let held = Held::default();
    let sent = a
        .transfer("b", "maps/x", bytes.clone())
        .expect("named")
        .named("x.bin")
        .on_progress(held.watch());
    let sent = tokio::spawn(sent.into_future());
    for part in 1..4u64 {
        held.reaches(part * 5 * MB as u64 / 4).await;
        wire.cut(Duration::from_millis(300)).await;
    }
    timeout(PATIENCE, sent)
        .await
        .expect("in time")
        .expect("no panic")
        .expect("sent");
    let got = received.next().await.expect("open").expect("whole");
    assert!(file_of(&got) == bytes, "the same bytes");
    assert_eq!(got.content, Content::File(folder.path().join("a/x.bin")));
    let twice = wire.carried() as i64 - bytes.len() as i64;
    println!("{twice} bytes more than there are went over the wire");
    // 1 % for headers, and at most what is on its way three times.
    assert!(twice < 1_500_000, "{twice}");
}

#[tokio::test(flavor = "multi_thread")]
async fn it_goes_on_after_either_side_was_restarted() {
    let _turn = turn().await;
    let (bytes, folder) = (noise(4 * MB), tempfile::tempdir().expect("a folder"));
    let Wired { a, b, wire, there } = wired(2e6).await;
    let received = b
        .receive_transfers("*/**", in_folder(&folder))
        .await
        .expect("declared");
    let held = Held::default();
    let send = |robot: &Robot| {
        let sent = robot
            .transfer("b", "x", bytes.clone())
            .expect("named")
            .on_progress(held.watch());
        tokio::spawn(sent.into_future())
    };
    let sent = send(&a);
    held.reaches(MB as u64).await;
    // The sender.
    sent.abort();
    a.close().await.expect("closed");
    let a = dialling("a", &wire.endpoint).await;
    let sent = send(&a);
    held.reaches(2 * MB as u64).await;
    // The receiver.
    drop(received);
    // In the midst of a transfer Zenoh's close may take longer than it waits for itself; a restart does not ask.
    if let Err(error) = b.close().await {
        println!("{error}");
    }
    drop(b);
    let b = listening("b", &there).await;
    let received = b
        .receive_transfers("*/**", in_folder(&folder))
        .await
        .expect("declared");
    timeout(PATIENCE, sent)
        .await
        .expect("in time")
        .expect("no panic")
        .expect("sent");
    let got = received.next().await.expect("open").expect("whole");
    assert!(file_of(&got) == bytes, "the same bytes");
    let twice = wire.carried() as i64 - bytes.len() as i64;
    println!("{twice} bytes more than there are went over the wire");
    assert!(twice < 1_000_000, "{twice}");
}

fn memory_kb(what: &str) -> u64 {
    let status = fs::read_to_string("/proc/self/status").expect("linux");
    let line = status
        .lines()
        .find(|line| line.starts_with(what))
        .expect("there");
    line.split_whitespace()
        .nth(1)
        .and_then(|kb| kb.parse().ok())
        .expect("a number")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_large_file_is_fast_and_takes_no_memory() {
    let _turn = turn().await;
    let size = 300 * MB;
    let (folder, here) = (
        tempfile::tempdir().expect("a folder"),
        tempfile::tempdir().expect("a folder"),
    );
    let path = here.path().join("large.bin");
    fs::write(&path, noise(size)).expect("written");
    let (a, b) = pair("a", "b").await;
    let received = b
        .receive_transfers("a/**", in_folder(&folder))
        .await
        .expect("declared");
    // The most that it was begins anew.
    fs::write("/proc/self/clear_refs", "5").expect("linux");
    let (before, start) = (memory_kb("VmRSS:"), Instant::now());
    a.transfer("b", "large", &path)
        .expect("named")
        .await
        .expect("sent");
    let took = start.elapsed();
    let more = memory_kb("VmHWM:").saturating_sub(before);
    let rate = size as f64 / took.as_secs_f64() / 1e6;
    println!("{size} bytes in {took:?}, {rate:.0} MB/s with both checksums, at most {more} kB of memory more");
    let got = received.next().await.expect("open").expect("whole");
    assert_eq!(got.size_bytes, size as u64);
    assert!(more < 60_000, "{more} kB");
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_and_little_arrive_in_memory_and_as_what_they_are() {
    let _turn = turn().await;
    let (a, b) = pair("a", "b").await;
    let received = b
        .receive_transfers("*/**", ReceiveTransfers::in_memory(100))
        .await
        .expect("declared");
    a.transfer("b", "nothing", vec![])
        .expect("named")
        .await
        .expect("sent");
    let got = received.next().await.expect("open").expect("whole");
    assert_eq!(got.content, Content::Bytes(Default::default()));
    let sent = a
        .transfer(
            "b",
            "little",
            rect::ToPayload::to_payload("hä?").expect("text"),
        )
        .expect("named");
    sent.await.expect("sent");
    let got = received.next().await.expect("open").expect("whole");
    assert_eq!(
        (got.encoding.clone(), got.from.as_str(), got.topic.as_str()),
        (Encoding::TEXT, "a", "little")
    );
    assert_eq!(file_of(&got), "hä?".as_bytes());
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_sent_twice_by_the_programs_wish_comes_twice_and_two_at_once_both_come() {
    let _turn = turn().await;
    let (a, b) = pair("a", "b").await;
    let received = b
        .receive_transfers("*/**", ReceiveTransfers::in_memory(1 << 20))
        .await
        .expect("declared");
    let bytes = noise(1 << 20);
    let send = |topic| {
        tokio::spawn(
            a.transfer("b", topic, bytes.clone())
                .expect("named")
                .into_future(),
        )
    };
    let both = [send("one"), send("two")];
    for sent in both {
        timeout(PATIENCE, sent)
            .await
            .expect("in time")
            .expect("no panic")
            .expect("sent");
    }
    send("one").await.expect("no panic").expect("sent");
    for _ in 0..3 {
        let got = timeout(PATIENCE, received.next())
            .await
            .expect("in time")
            .expect("open")
            .expect("whole");
        assert!(file_of(&got) == bytes);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn without_consent_nothing_is_taken() {
    let _turn = turn().await;
    let (a, b) = pair("a", "b").await;
    let brief = Duration::from_secs(2);
    let nobody = a
        .transfer("b", "maps/x", vec![1])
        .expect("named")
        .patience(brief)
        .await;
    assert!(matches!(nobody, Err(Error::TimedOut { .. })), "{nobody:?}");
    let _received = b
        .receive_transfers("a/maps/*", ReceiveTransfers::in_memory(10))
        .await
        .expect("declared");
    let other = a.transfer("b", "logs/x", vec![1]).expect("named").await;
    let not_wanted = |refusal: &Refusal| *refusal == Refusal::NotWanted;
    assert!(
        matches!(&other, Err(Error::TransferRefused { refusal, .. }) if not_wanted(refusal)),
        "{other:?}"
    );
    let large = a.transfer("b", "maps/x", vec![1; 11]).expect("named").await;
    let text = large.expect_err("refused").to_string();
    assert!(text.contains("larger than the 10 bytes"), "{text}");
    let name = a
        .transfer("b", "maps/x", vec![1])
        .expect("named")
        .named("../x")
        .await;
    assert!(matches!(name, Err(Error::Offer(_))), "{name:?}");
    let none = a
        .transfer("b", "maps/x", Path::new("/none"))
        .expect("named")
        .await;
    assert!(matches!(none, Err(Error::File { .. })), "{none:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_that_changes_meanwhile_is_an_error_that_says_so() {
    let _turn = turn().await;
    let here = tempfile::tempdir().expect("a folder");
    let path = here.path().join("log");
    fs::write(&path, noise(3 * MB)).expect("written");
    let Wired {
        a, b, wire: _wire, ..
    } = wired(1e6).await;
    let received = b
        .receive_transfers("*/**", ReceiveTransfers::in_memory(1 << 30))
        .await
        .expect("declared");
    let held = Held::default();
    let sent = a
        .transfer("b", "log", &path)
        .expect("named")
        .on_progress(held.watch());
    let sent = tokio::spawn(sent.into_future());
    held.reaches(MB as u64 / 2).await;
    fs::write(&path, noise(2 * MB)).expect("written");
    let error = timeout(PATIENCE, sent)
        .await
        .expect("in time")
        .expect("no panic")
        .expect_err("changed")
        .to_string();
    assert!(error.contains("changed"), "{error}");
    let got = timeout(PATIENCE, received.next())
        .await
        .expect("in time")
        .expect("open");
    let error = got.expect_err("changed").to_string();
    assert!(error.contains("changed"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_can_not_be_kept_is_an_error_on_both_sides() {
    let _turn = turn().await;
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("a"), "a file where a folder is to be").expect("written");
    let (a, b) = pair("a", "b").await;
    let received = b
        .receive_transfers("*/**", in_folder(&folder))
        .await
        .expect("declared");
    let sent = a.transfer("b", "x", vec![1]).expect("named").await;
    let not_kept = |fault: &Fault| matches!(fault, Fault::NotKept(_));
    assert!(
        matches!(&sent, Err(Error::TransferFailed { fault, .. }) if not_kept(fault)),
        "{sent:?}"
    );
    assert!(received.next().await.expect("open").is_err());
}

/// A sender that answers requests with whatever it likes.
async fn lied_to(
    size_bytes: u64,
    lie: impl Fn(u32) -> Result<Vec<u8>, Vec<u8>> + Send + Sync + 'static,
) -> Fault {
    let (a, b) = pair("a", "b").await;
    let received = b
        .receive_transfers("*/**", ReceiveTransfers::in_memory(1 << 20))
        .await
        .expect("declared");
    let offer = Offer {
        from: "a".parse().expect("a name"),
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
                    let _ = match lie(length) {
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
    let got = timeout(PATIENCE, received.next())
        .await
        .expect("in time")
        .expect("open");
    match got {
        Err(Error::TransferFailed { fault, .. }) => fault,
        other => panic!("{other:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sender_that_lies_gets_nowhere() {
    let _turn = turn().await;
    let short = lied_to(5000, |length| Ok(vec![0; length as usize - 1])).await;
    assert!(matches!(short, Fault::Protocol(_)), "{short:?}");
    let long = lied_to(5000, |length| Ok(vec![0; length as usize + 100_000])).await;
    assert!(matches!(long, Fault::Protocol(_)), "{long:?}");
    let wrong = lied_to(5000, |length| Ok(vec![0; length as usize])).await;
    assert_eq!(wrong, Fault::Checksum);
    let fault = lied_to(5000, |_| Err(Fault::Unreadable("a disk".into()).encode())).await;
    assert_eq!(fault, Fault::Unreadable("a disk".into()));
}

#[tokio::test(flavor = "multi_thread")]
async fn progress_is_told_on_both_sides_and_closing_ends_the_waiting() {
    let _turn = turn().await;
    let (a, b) = pair("a", "b").await;
    let seen = Arc::new(Mutex::new(Vec::new()));
    let told = seen.clone();
    let options = ReceiveTransfers::in_memory(1 << 30).on_progress(move |about, progress| {
        told.lock()
            .expect("whole")
            .push((about.name.clone(), progress))
    });
    let received = b
        .receive_transfers("*/**", options)
        .await
        .expect("declared");
    let held = Held::default();
    let sent = a
        .transfer("b", "x", noise(MB))
        .expect("named")
        .named("x")
        .on_progress(held.watch());
    sent.await.expect("sent");
    assert_eq!(held.0.load(Ordering::SeqCst), MB as u64);
    let seen = seen.lock().expect("whole").clone();
    assert!(seen
        .iter()
        .all(|(name, progress)| name == "x" && progress.size_bytes == MB as u64));
    assert_eq!(seen.last().expect("some").1.fraction(), 1.0);
    assert!(received.next().await.expect("open").is_ok());
    b.close().await.expect("closed");
    assert!(timeout(PATIENCE, received.next())
        .await
        .expect("in time")
        .is_none());
}

/// An offer of these bytes in that robot's name.
fn offer_of(from: &str, bytes: &[u8]) -> Offer {
    Offer {
        from: from.parse().expect("a name"),
        topic: Topic::new("maps/x").expect("a topic"),
        name: FileName::new("map.bin").expect("a file's name"),
        encoding: Encoding::BYTES,
        size_bytes: bytes.len() as u64,
        checksum: Checksum::of(bytes),
        call: 1,
    }
}

/// What `b` answers to an offer that `by` sends, once `b` can be reached.
async fn offered(by: &Robot, offer: &Offer) -> Answer {
    let answered = async {
        loop {
            let asked = by.zenoh().get("rect/b/@rect/inbox");
            let replies = asked.payload(offer.encode()).await.expect("asked");
            if let Ok(Ok(reply)) = replies.recv_async().await.map(|reply| reply.into_result()) {
                return Answer::decode(&reply.payload().to_bytes()).expect("an answer");
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    timeout(PATIENCE, answered).await.expect("in time")
}

#[tokio::test(flavor = "multi_thread")]
async fn an_offer_in_another_robots_name_touches_nothing() {
    let _turn = turn().await;
    let folder = tempfile::tempdir().expect("a folder");
    let there = free_endpoint();
    let b = listening("b", &there).await;
    let honest = dialling("honest", &there).await;
    let forger = dialling("forger", &there).await;
    let received = b
        .receive_transfers("*/**", in_folder(&folder))
        .await
        .expect("declared");
    honest
        .transfer("b", "maps/x", noise(1000))
        .expect("named")
        .named("map.bin")
        .await
        .expect("sent");
    assert!(received.next().await.expect("open").is_ok());
    let file = folder.path().join("honest/map.bin");
    for (from, bytes) in [
        ("honest", &b""[..]),
        ("honest", b"forged"),
        ("nobody", b""),
        ("nobody", b"forged"),
    ] {
        offered(&forger, &offer_of(from, bytes)).await;
    }
    // Whatever those began has ended when a transfer that began later has.
    for _ in 0..3 {
        honest
            .transfer("b", "maps/y", noise(10))
            .expect("named")
            .await
            .expect("sent");
        let got = received.next().await.expect("open").expect("whole");
        assert_eq!((got.topic.as_str(), got.name.as_str()), ("maps/y", ""));
    }
    assert_eq!(fs::read(&file).expect("there"), noise(1000));
    let senders: Vec<_> = fs::read_dir(folder.path()).expect("there").collect();
    assert_eq!(senders.len(), 1, "{senders:?}");
    for file in fs::read_dir(folder.path().join("honest")).expect("there") {
        let name = file.expect("read").file_name();
        assert!(!name.to_string_lossy().ends_with(".part"), "{name:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn senders_that_never_answer_take_no_place_from_one_that_does() {
    let _turn = turn().await;
    let folder = tempfile::tempdir().expect("a folder");
    let there = free_endpoint();
    let b = listening("b", &there).await;
    let honest = dialling("honest", &there).await;
    let forger = dialling("forger", &there).await;
    let received = b
        .receive_transfers("*/**", in_folder(&folder))
        .await
        .expect("declared");
    // It is asked, and keeps each question until its time is over.
    let kept = Mutex::new(Vec::new());
    let silent = forger
        .zenoh()
        .declare_queryable("rect/forger/@rect/transfer/*");
    let silent = silent.callback(move |query| kept.lock().expect("whole").push(query));
    let _silent = silent.wait().expect("declared");
    for n in 0..20u8 {
        offered(&forger, &offer_of("forger", &[n; 100])).await;
        offered(&forger, &offer_of("nobody", &[n; 100])).await;
    }
    let start = Instant::now();
    let sent = honest.transfer("b", "maps/x", noise(1000)).expect("named");
    timeout(PATIENCE, sent.into_future())
        .await
        .expect("in time")
        .expect("sent");
    let took = start.elapsed();
    println!("an honest transfer among 40 offers that nobody confirms took {took:?}");
    assert!(took < Duration::from_secs(5), "{took:?}");
    let got = received.next().await.expect("open").expect("whole");
    assert_eq!(got.from.as_str(), "honest");
    let senders = fs::read_dir(folder.path()).expect("there").count();
    assert_eq!(senders, 1, "the others have left nothing");
}

/// How a transfer ends at a sender whose receiver is gone as soon as its program knows the end.
async fn told_before_the_receiver_is_gone(folder: &Path) -> Result<(), Error> {
    let Wired { a, b, wire, .. } = wired(5e3).await;
    let options = ReceiveTransfers::in_folder(folder, 1 << 20);
    let received = b
        .receive_transfers("*/**", options)
        .await
        .expect("declared");
    let sent = a.transfer("b", "x", noise(100)).expect("named");
    let sent = sent.patience(Duration::from_secs(8)).into_future();
    let sent = tokio::spawn(sent);
    let _ended = timeout(PATIENCE, received.next()).await.expect("in time");
    tokio::select! {
        () = wire.cut(PATIENCE) => panic!("it waits for a receiver that is gone"),
        sent = sent => sent.expect("no panic"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sender_knows_the_end_before_the_receivers_program_does() {
    let _turn = turn().await;
    let folder = tempfile::tempdir().expect("a folder");
    let done = told_before_the_receiver_is_gone(folder.path()).await;
    assert!(done.is_ok(), "{done:?}");
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("a"), "a file where a folder is to be").expect("written");
    let failed = told_before_the_receiver_is_gone(folder.path()).await;
    assert!(
        matches!(
            &failed,
            Err(Error::TransferFailed {
                fault: Fault::NotKept(_),
                ..
            })
        ),
        "{failed:?}"
    );
}
