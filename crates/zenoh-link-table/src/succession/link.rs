//! Wraps a link: holds back Zenoh's handshake until the predecessor is released, and ends the link before Zenoh gives it up.
use std::{
    future::Future,
    sync::{
        atomic::{AtomicBool, AtomicUsize, Ordering},
        Arc, OnceLock, Weak,
    },
    time::Duration,
};

use async_trait::async_trait;
use parking_lot::{Condvar, Mutex};
use tokio::time::{sleep, sleep_until, timeout, Instant};
use tokio_util::{sync::CancellationToken, task::AbortOnDropHandle};
use zenoh_link_commons::{LinkAuthId, LinkUnicast, LinkUnicastTrait, NewLink};
use zenoh_protocol::{
    core::{Locator, Priority},
    transport::BatchSize,
};
use zenoh_result::{zerror, Error, ZResult};

use super::{
    handshake::{decode, Message},
    ledger::LastReceived,
    wait_for_predecessor, Hold, LinkEnd, ZenohNode, ZenohPair,
};

/// The longest lease that a peer may announce. A longer one counts as this one.
const MAX_LEASE: Duration = Duration::from_secs(24 * 3600);
/// How long before the end of Zenoh's lease a silent link fails, as a share of the lease.
const EARLIER: u32 = 20;
/// How long after the tasks that write the tasks that read learn of the end. Zenoh's messages that wait for a link are released
/// when its writers fail, and block Zenoh's close if its reader fails before.
const SETTLE: Duration = Duration::from_millis(100);
/// Number of bytes of the length before a batch on a streamed link.
const LENGTH_BYTES: usize = size_of::<BatchSize>();

/// A link that waits for its predecessor.
pub(super) struct SucceedingLink {
    link: Arc<dyn LinkUnicastTrait>,
    is_complete: AtomicBool,
    handshake: Mutex<Handshake>,
    received: Arc<LastReceived>,
    reads: Arc<Reads>,
    writers: Arc<Writers>,
    established: OnceLock<Established>,
    ended: CancellationToken,
}

/// The state of Zenoh's handshake, as far as it is known.
#[derive(Default)]
struct Handshake {
    own: Option<ZenohNode>,
    peer: Option<ZenohNode>,
    /// How long the peer may be silent.
    lease: Option<Duration>,
    /// Whether the bytes that are read next are a batch, after its length.
    is_after_length: bool,
}

/// A link whose handshake is complete.
struct Established {
    hold: Arc<Hold>,
    _watching: AbortOnDropHandle<()>,
}

impl SucceedingLink {
    /// Wraps a new link.
    pub(super) fn wrap(link: LinkUnicast) -> LinkUnicast {
        LinkUnicast(match link.0 {
            NewLink::Single(link) => NewLink::Single(Self::wrapped(link)),
            // The handshake runs on the reliable link, and both links end together.
            NewLink::MixedReliability {
                reliable,
                best_effort,
            } => NewLink::MixedReliability {
                reliable: Self::wrapped(reliable),
                best_effort,
            },
        })
    }

    fn wrapped(link: Arc<dyn LinkUnicastTrait>) -> Arc<dyn LinkUnicastTrait> {
        Arc::new(Self {
            link,
            is_complete: AtomicBool::new(false),
            handshake: Mutex::default(),
            received: Arc::new(LastReceived::new(Instant::now().into_std())),
            reads: Arc::new(Reads {
                waiting: AtomicUsize::new(0),
                since: LastReceived::new(Instant::now().into_std()),
            }),
            writers: Arc::default(),
            established: OnceLock::new(),
            ended: CancellationToken::new(),
        })
    }

    fn is_complete(&self) -> bool {
        self.is_complete.load(Ordering::Acquire)
    }

    /// Handles a batch of the handshake before Zenoh sends it. Waits while the peer must not receive it.
    async fn before_sending(&self, buffer: &[u8]) -> ZResult<()> {
        let head = if self.is_streamed() { LENGTH_BYTES } else { 0 };
        match buffer.get(head..).and_then(decode) {
            Some(Message::InitSyn(node)) => self.handshake.lock().own = Some(node),
            Some(Message::InitAck(node)) => {
                self.handshake.lock().own = Some(node);
                self.wait().await?;
            }
            // Zenoh has added the link to a session.
            Some(Message::OpenAck(_)) => self.establish(),
            Some(Message::OpenSyn(_)) | None => {}
        }
        Ok(())
    }

    /// Handles a batch of the handshake before Zenoh receives it. Waits while Zenoh must not receive it.
    async fn before_receiving(&self, batch: &[u8]) -> ZResult<()> {
        match decode(batch) {
            Some(Message::InitSyn(node)) => self.handshake.lock().peer = Some(node),
            Some(Message::InitAck(node)) => {
                self.handshake.lock().peer = Some(node);
                self.wait().await?;
            }
            Some(Message::OpenSyn(lease)) => self.handshake.lock().lease = Some(lease),
            Some(Message::OpenAck(lease)) => {
                self.handshake.lock().lease = Some(lease);
                self.establish();
            }
            None => {}
        }
        Ok(())
    }

    fn pair(&self) -> Option<ZenohPair> {
        let handshake = self.handshake.lock();
        let (own, peer) = (handshake.own?, handshake.peer?);
        Some(ZenohPair { own, peer })
    }

    async fn wait(&self) -> ZResult<()> {
        match self.pair() {
            Some(pair) => Ok(wait_for_predecessor(pair).await?),
            None => Ok(()),
        }
    }

    fn establish(&self) {
        self.received.set(Instant::now().into_std());
        let lease = self.handshake.lock().lease;
        let lease = lease.map(|lease| lease.min(MAX_LEASE));
        if let (Some(pair), Some(lease)) = (self.pair(), lease) {
            let hold = Arc::new(Hold::new(
                pair,
                Arc::clone(&self.received),
                lease,
                LinkEnd {
                    src: self.link.get_src().clone(),
                    dst: self.link.get_dst().clone(),
                    writers: Arc::clone(&self.writers),
                    ended: self.ended.clone(),
                },
            ));
            let watching = watch(
                Arc::downgrade(&hold),
                Arc::clone(&self.received),
                Arc::clone(&self.reads),
                self.ended.clone(),
                lease - lease / EARLIER,
                self.link.get_dst().to_string(),
            );
            let _ = self.established.set(Established {
                hold,
                _watching: AbortOnDropHandle::new(tokio::spawn(watching)),
            });
        }
        self.is_complete.store(true, Ordering::Release);
    }

    /// Ends the link for all tasks of Zenoh. Returns whether it had not ended before.
    fn end(&self) -> bool {
        let is_first = !self.ended.is_cancelled();
        self.ended.cancel();
        if let Some(established) = self.established.get().filter(|_| is_first) {
            established.hold.on_ended();
        }
        is_first
    }

    /// Sends, unless the link has ended.
    async fn sending<T>(&self, sending: impl Future<Output = ZResult<T>>) -> ZResult<T> {
        let _writing = Writing::begin(&self.writers);
        if self.ended.is_cancelled() {
            return Err(self.has_ended());
        }
        let sent = tokio::select! {
            biased;
            sent = sending => sent,
            () = self.ended.cancelled() => Err(self.has_ended()),
        };
        if sent.is_err() {
            self.end();
        }
        sent
    }

    /// Receives, unless the link has ended.
    async fn receiving<T>(&self, receiving: impl Future<Output = ZResult<T>>) -> ZResult<T> {
        let reading = Reading::begin(&self.reads);
        let received = tokio::select! {
            biased;
            received = receiving => received,
            () = self.ended.cancelled() => Err(self.has_ended()),
        };
        drop(reading);
        match &received {
            Ok(_) => self.received.set(Instant::now().into_std()),
            Err(_) => {
                self.end();
                if self.is_complete() {
                    sleep(SETTLE).await;
                }
            }
        }
        received
    }

    fn has_ended(&self) -> Error {
        zerror!("{}: the link has ended", self.link.get_dst()).into()
    }
}

/// Zenoh's tasks that write, one for each priority.
#[derive(Default)]
pub(super) struct Writers {
    /// Number of tasks that wait for room.
    waiting: Mutex<usize>,
    changed: Condvar,
}

impl Writers {
    /// Blocks until no task waits for room, at most until `deadline`.
    pub(super) fn wait_until_none(&self, deadline: std::time::Instant) {
        let mut waiting = self.waiting.lock();
        while *waiting > 0 && !self.changed.wait_until(&mut waiting, deadline).timed_out() {}
    }
}

/// A task that waits for room.
struct Writing<'a>(&'a Writers);

impl<'a> Writing<'a> {
    fn begin(writers: &'a Writers) -> Self {
        *writers.waiting.lock() += 1;
        Self(writers)
    }
}

impl Drop for Writing<'_> {
    fn drop(&mut self) {
        let mut waiting = self.0.waiting.lock();
        *waiting -= 1;
        if *waiting == 0 {
            self.0.changed.notify_all();
        }
    }
}

/// Zenoh's tasks that read. While none does, because a message waits for another link, the peer is not silent.
struct Reads {
    /// Number of tasks that wait for something to arrive.
    waiting: AtomicUsize,
    /// Since when at least one does.
    since: LastReceived,
}

/// A task that waits for something to arrive.
struct Reading<'a>(&'a Reads);

impl<'a> Reading<'a> {
    fn begin(reads: &'a Reads) -> Self {
        if reads.waiting.fetch_add(1, Ordering::AcqRel) == 0 {
            reads.since.set(Instant::now().into_std());
        }
        Self(reads)
    }
}

impl Drop for Reading<'_> {
    fn drop(&mut self) {
        self.0.waiting.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Ends a link on which nothing was received for `limit`, although Zenoh reads.
async fn watch(
    hold: Weak<Hold>,
    received: Arc<LastReceived>,
    reads: Arc<Reads>,
    ended: CancellationToken,
    limit: Duration,
    peer: String,
) {
    let silent = async {
        loop {
            let since = received.get().max(reads.since.get());
            let at = Instant::from_std(since) + limit;
            if Instant::now() < at {
                sleep_until(at).await;
            } else if reads.waiting.load(Ordering::Acquire) > 0 {
                return;
            } else {
                sleep(limit / EARLIER).await;
            }
        }
    };
    if ended.run_until_cancelled(silent).await.is_some() {
        tracing::debug!("{peer}: nothing was received for {limit:?}: the link ends");
        if let Some(hold) = hold.upgrade() {
            hold.on_ended();
        }
    }
}

#[async_trait]
impl LinkUnicastTrait for SucceedingLink {
    fn get_mtu(&self) -> BatchSize {
        self.link.get_mtu()
    }

    fn get_src(&self) -> &Locator {
        self.link.get_src()
    }

    fn get_dst(&self) -> &Locator {
        self.link.get_dst()
    }

    fn is_reliable(&self) -> bool {
        self.link.is_reliable()
    }

    fn is_streamed(&self) -> bool {
        self.link.is_streamed()
    }

    fn get_interface_names(&self) -> Vec<String> {
        self.link.get_interface_names()
    }

    fn get_auth_id(&self) -> &LinkAuthId {
        self.link.get_auth_id()
    }

    fn supports_priorities(&self) -> bool {
        self.link.supports_priorities()
    }

    async fn write(&self, buffer: &[u8], priority: Option<Priority>) -> ZResult<usize> {
        self.sending(self.link.write(buffer, priority)).await
    }

    async fn write_all(&self, buffer: &[u8], priority: Option<Priority>) -> ZResult<()> {
        if !self.is_complete() {
            self.before_sending(buffer).await?;
        }
        self.sending(self.link.write_all(buffer, priority)).await
    }

    async fn read(&self, buffer: &mut [u8], priority: Option<Priority>) -> ZResult<usize> {
        let size = self.receiving(self.link.read(buffer, priority)).await?;
        if !self.is_complete() {
            self.before_receiving(buffer.get(..size).unwrap_or_default())
                .await?;
        }
        Ok(size)
    }

    async fn read_exact(&self, buffer: &mut [u8], priority: Option<Priority>) -> ZResult<()> {
        self.receiving(self.link.read_exact(buffer, priority))
            .await?;
        if !self.is_complete() {
            let is_batch = {
                let mut handshake = self.handshake.lock();
                let is_after_length = handshake.is_after_length || !self.is_streamed();
                handshake.is_after_length = !is_after_length;
                is_after_length
            };
            if is_batch {
                self.before_receiving(buffer).await?;
            }
        }
        Ok(())
    }

    async fn close(&self) -> ZResult<()> {
        if self.end() {
            return self.link.close().await;
        }
        // The peer reads nothing more, so there is nothing to wait for.
        timeout(SETTLE, self.link.close()).await.unwrap_or(Ok(()))
    }

    #[cfg(all(feature = "uring", target_os = "linux"))]
    fn get_fd(&self) -> ZResult<std::os::fd::RawFd> {
        // Zenoh then reads without this link, which never counts as silent.
        let never = Duration::from_secs(10 * 365 * 24 * 3600);
        self.received.set(Instant::now().into_std() + never);
        self.link.get_fd()
    }
}

#[cfg(test)]
mod tests {
    use std::{collections::VecDeque, task::Poll};

    use zenoh_protocol::{
        core::{WhatAmI, ZenohIdProto},
        transport::id,
    };

    use super::*;
    use crate::succession::Session;

    const LEASE: Duration = Duration::from_secs(10);

    /// A link that never has room, and receives what the test gives it.
    struct StuckLink {
        locator: Locator,
        batches: Mutex<VecDeque<Vec<u8>>>,
        has_room: bool,
    }

    #[async_trait]
    impl LinkUnicastTrait for StuckLink {
        fn get_mtu(&self) -> BatchSize {
            1000
        }
        fn get_src(&self) -> &Locator {
            &self.locator
        }
        fn get_dst(&self) -> &Locator {
            &self.locator
        }
        fn is_reliable(&self) -> bool {
            true
        }
        fn is_streamed(&self) -> bool {
            false
        }
        fn get_interface_names(&self) -> Vec<String> {
            Vec::new()
        }
        fn get_auth_id(&self) -> &LinkAuthId {
            &LinkAuthId::Tcp
        }
        async fn write(&self, buffer: &[u8], priority: Option<Priority>) -> ZResult<usize> {
            self.write_all(buffer, priority).await?;
            Ok(buffer.len())
        }
        async fn write_all(&self, _buffer: &[u8], priority: Option<Priority>) -> ZResult<()> {
            // There is no priority during the handshake.
            match self.has_room || priority.is_none() {
                true => Ok(()),
                false => std::future::pending().await,
            }
        }
        async fn read(&self, buffer: &mut [u8], _: Option<Priority>) -> ZResult<usize> {
            let batch = self.batches.lock().pop_front();
            let Some(batch) = batch else {
                return std::future::pending().await;
            };
            buffer[..batch.len()].copy_from_slice(&batch);
            Ok(batch.len())
        }
        async fn read_exact(&self, _: &mut [u8], _: Option<Priority>) -> ZResult<()> {
            std::future::pending().await
        }
        async fn close(&self) -> ZResult<()> {
            Ok(())
        }
        #[cfg(all(feature = "uring", target_os = "linux"))]
        fn get_fd(&self) -> ZResult<std::os::fd::RawFd> {
            zenoh_result::bail!("no descriptor")
        }
    }

    /// The flag of an answer, in the header of a message.
    const ANSWER: u8 = 1 << 5;
    /// [`LEASE`] in milliseconds, and a sequence number.
    const LEASE_AND_NUMBER: [u8; 3] = [0x90, 0x4e, 1];
    const NO_COOKIE: [u8; 1] = [0];

    fn init_syn(node: ZenohNode) -> Vec<u8> {
        let size = node.zid.size();
        let head = [id::INIT, 9, (size as u8 - 1) << 4];
        [&head[..], &node.zid.to_le_bytes()[..size]].concat()
    }

    fn init_ack(node: ZenohNode) -> Vec<u8> {
        let mut bytes = [init_syn(node), NO_COOKIE.to_vec()].concat();
        bytes[0] |= ANSWER;
        bytes
    }

    fn open_syn() -> Vec<u8> {
        [&[id::OPEN][..], &LEASE_AND_NUMBER, &NO_COOKIE].concat()
    }

    fn open_ack() -> Vec<u8> {
        [&[id::OPEN | ANSWER][..], &LEASE_AND_NUMBER].concat()
    }

    #[test]
    fn messages_of_the_handshake_are_read() {
        let [node, _] = nodes();
        assert_eq!(decode(&init_syn(node)), Some(Message::InitSyn(node)));
        assert_eq!(decode(&init_ack(node)), Some(Message::InitAck(node)));
        assert_eq!(decode(&open_syn()), Some(Message::OpenSyn(LEASE)));
        assert_eq!(decode(&open_ack()), Some(Message::OpenAck(LEASE)));
        for other in [&[][..], &[id::KEEP_ALIVE], &[id::INIT, 9], &[0xff; 20]] {
            assert_eq!(decode(other), None, "{other:?}");
        }
    }

    fn nodes() -> [ZenohNode; 2] {
        [(); 2].map(|()| ZenohNode {
            zid: ZenohIdProto::rand(),
            whatami: WhatAmI::Router,
        })
    }

    fn link_that_receives(batches: Vec<Vec<u8>>, has_room: bool) -> Arc<dyn LinkUnicastTrait> {
        SucceedingLink::wrapped(Arc::new(StuckLink {
            locator: "tcp/127.0.0.1:1".parse().expect("a locator"),
            batches: Mutex::new(batches.into()),
            has_room,
        }))
    }

    /// Performs Zenoh's handshake as the accepting side.
    async fn accept([own, peer]: [ZenohNode; 2]) -> ZResult<Arc<dyn LinkUnicastTrait>> {
        let link = link_that_receives(vec![init_syn(peer), open_syn()], false);
        let mut buffer = [0; 1000];
        link.read(&mut buffer, None).await?;
        link.write_all(&init_ack(own), None).await?;
        link.read(&mut buffer, None).await?;
        link.write_all(&open_ack(), None).await?;
        Ok(link)
    }

    /// Performs Zenoh's handshake as the dialling side.
    async fn dial([own, peer]: [ZenohNode; 2]) -> ZResult<Arc<dyn LinkUnicastTrait>> {
        let link = link_that_receives(vec![init_ack(peer), open_ack()], false);
        let mut buffer = [0; 1000];
        link.write_all(&init_syn(own), None).await?;
        link.read(&mut buffer, None).await?;
        link.write_all(&open_syn(), None).await?;
        link.read(&mut buffer, None).await?;
        Ok(link)
    }

    #[tokio::test(start_paused = true)]
    async fn both_sides_wait_until_the_predecessor_is_released() {
        for is_dialled in [false, true] {
            let nodes = nodes();
            let first = accept(nodes).await.expect("a link");
            let [own, peer] = nodes;
            let session = Session::opened(ZenohPair { own, peer });
            first.close().await.expect("closes");
            drop(first);
            let start = Instant::now();
            tokio::spawn(async move {
                sleep(Duration::from_secs(1)).await;
                drop(session);
            });
            let second = match is_dialled {
                true => dial(nodes).await,
                false => accept(nodes).await,
            };
            second.expect("a link");
            let waited = start.elapsed();
            let expected = Duration::from_millis(1300)..Duration::from_millis(1500);
            assert!(expected.contains(&waited), "{waited:?}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn link_fails_if_its_predecessor_hangs() {
        let nodes = nodes();
        let first = accept(nodes).await.expect("a link");
        first.close().await.expect("closes");
        let start = Instant::now();
        let error = accept(nodes).await.err().expect("its predecessor hangs");
        assert!(error.to_string().contains("has not ended"), "{error}");
        assert!(start.elapsed() < Duration::from_secs(3));
        drop(first);
        accept(nodes).await.expect("a link");
    }

    #[tokio::test(start_paused = true)]
    async fn silent_link_fails_before_the_lease_and_its_writers_before_its_readers() {
        let start = Instant::now();
        let link = accept(nodes()).await.expect("a link");
        let mut buffer = [0; 1000];
        let writing = async {
            let written = link.write_all(&[1; 10], Some(Priority::Data)).await;
            assert!(written.is_err());
            start.elapsed()
        };
        let reading = async {
            let read = link.read(&mut buffer, Some(Priority::Data)).await;
            assert!(read.is_err());
            start.elapsed()
        };
        let other = async {
            let written = link.write_all(&[1; 10], Some(Priority::Background)).await;
            assert!(written.is_err());
            start.elapsed()
        };
        let (wrote, read, other) = tokio::join!(writing, reading, other);
        let end = Duration::from_millis(9500);
        assert!(wrote >= end && other >= end, "{wrote:?} {other:?}");
        assert!(wrote + SETTLE / 2 < read && other + SETTLE / 2 < read);
        assert!(read < LEASE, "{read:?}");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn zenoh_removes_a_link_only_after_all_its_writers_have_failed() {
        let link = accept(nodes()).await.expect("a link");
        let priorities = [Priority::Control, Priority::Data, Priority::Background];
        let begun = Arc::new(tokio::sync::Barrier::new(priorities.len() + 1));
        let writing = priorities.map(|priority| {
            let (link, begun) = (Arc::clone(&link), Arc::clone(&begun));
            tokio::spawn(async move {
                let mut writing = link.write_all(&[1; 10], Some(priority));
                std::future::poll_fn(|context| {
                    assert!(writing.as_mut().poll(context).is_pending());
                    Poll::Ready(())
                })
                .await;
                begun.wait().await;
                assert!(writing.await.is_err());
            })
        });
        begun.wait().await;
        let (src, dst) = (link.get_src().clone(), link.get_dst().clone());
        let removed = || crate::succession::wait_for_writers(&src, &dst);
        let began = Instant::now();
        tokio::task::block_in_place(removed);
        assert!(
            began.elapsed() >= crate::succession::WRITERS_FAIL,
            "they wait for room"
        );
        link.close().await.expect("closes");
        tokio::task::block_in_place(removed);
        // They have failed, and may not have ended yet.
        for writing in writing {
            writing.await.expect("no panic");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn link_that_zenoh_does_not_read_is_not_silent() {
        let link = accept(nodes()).await.expect("a link");
        sleep(LEASE * 3).await;
        let mut buffer = [0; 1000];
        let reading = link.read(&mut buffer, Some(Priority::Data));
        assert!(timeout(LEASE / 2, reading).await.is_err(), "still open");
    }

    #[tokio::test(start_paused = true)]
    async fn new_link_ends_a_silent_one() {
        let nodes = nodes();
        let first = accept(nodes).await.expect("a link");
        sleep(Duration::from_secs(4)).await;
        let released = async {
            let mut buffer = [0; 1000];
            let ended = first.read(&mut buffer, Some(Priority::Control)).await;
            assert!(ended.is_err());
            drop(first);
        };
        let (second, ()) = tokio::join!(accept(nodes), released);
        second.expect("a link");
    }
}
