//! The tasks of the paths: each moves frames between the link and its medium until the path has ended.
use std::{io, sync::Arc, time::Duration};

use snow::StatelessTransportState;
use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, BufReader, Join},
    net::TcpStream,
    time::Instant,
};
use zenoh_link_ble::{path::BlePath, protocol::lanes::Lane};

use crate::{
    frame::Frame,
    multipath::LAST_COPIED_LANE,
    path::Medium,
    proof::SEAL_BYTES,
    shared::{Next, PathGuard, Shared},
};

/// The largest frame on a TCP connection, in bytes.
const MAX_TCP_FRAME: usize = 16_384;
/// Number of bytes of frames that are written at once.
const WRITE_BYTES: usize = 65_536;
/// Number of bytes that may wait in the kernel of this side, so that what has not left can take another path.
const NOT_SENT_BYTES: libc::c_int = 32_768;
/// How long a connection may be silent although data was sent, before the kernel ends it.
const TCP_TIMEOUT: Duration = Duration::from_secs(10);

/// Carries frames over a Bluetooth path until it has ended.
pub(crate) async fn run_ble(shared: Arc<Shared>, path: BlePath, is_proven: bool) {
    let guard = shared.add_path(Medium::Bluetooth, path.max_frame(), is_proven);
    let reason = tokio::select! {
        reason = send_ble(&guard, &path) => reason,
        reason = receive_ble(&guard, &path) => reason,
        () = shared.ended() => "the link has ended".to_owned(),
    };
    drop(guard);
    tracing::info!(
        "any: the Bluetooth path to {} has ended: {reason}",
        shared.peer
    );
    path.close().await;
}

async fn send_ble(guard: &PathGuard, path: &BlePath) -> String {
    let mut frame = Vec::new();
    let mut offer = guard.shared.own_offer();
    offer.mark_changed();
    let urgent = Lane::new(LAST_COPIED_LANE).unwrap_or(Lane::first());
    loop {
        if offer.has_changed().unwrap_or(false) {
            frame.clear();
            Frame::Offer(&offer.borrow_and_update()).encode(&mut frame);
            if let Err(error) = path.send(Lane::last(), &frame).await {
                return error.to_string();
            }
        }
        // While a frame waits for the radio, only more urgent ones are added, which overtake it.
        let is_busy = path.is_busy();
        let least_urgent = if is_busy { urgent } else { Lane::last() };
        let next = guard.shared.next_frame(guard.id, least_urgent, &mut frame);
        match next {
            Next::Frame(lane) => {
                if let Err(error) = path.send(lane, &frame).await {
                    return error.to_string();
                }
            }
            Next::Wait(until) => {
                let offered = async { drop(offer.changed().await) };
                tokio::select! {
                    () = guard.task.waker.notified() => {}
                    () = sleep_until(until) => {}
                    () = path.sent(), if is_busy => {}
                    () = offered => offer.mark_changed(),
                }
            }
        }
    }
}

async fn receive_ble(guard: &PathGuard, path: &BlePath) -> String {
    loop {
        let frame = match path.receive().await {
            Ok(frame) => frame,
            Err(error) => return error.to_string(),
        };
        if let Err(error) = guard.shared.on_frame(guard.id, &frame) {
            return error.to_string();
        }
    }
}

async fn sleep_until(until: Option<Instant>) {
    match until {
        Some(until) => tokio::time::sleep_until(until).await,
        None => std::future::pending().await,
    }
}

/// Sets the options of a connection before it becomes a path.
pub(crate) fn prepare(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let socket = socket2::SockRef::from(stream);
    #[cfg(target_os = "linux")]
    {
        socket.set_tcp_user_timeout(Some(TCP_TIMEOUT))?;
        set_not_sent(&socket)?;
    }
    socket.set_keepalive(true)
}

#[cfg(target_os = "linux")]
fn set_not_sent(socket: &socket2::SockRef<'_>) -> io::Result<()> {
    use std::os::fd::AsRawFd;
    let value = NOT_SENT_BYTES;
    // SAFETY: the descriptor is open while `socket` is borrowed, and the pointer and the size are those of an integer that
    // lives during the call.
    let result = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            libc::IPPROTO_TCP,
            libc::TCP_NOTSENT_LOWAT,
            std::ptr::from_ref(&value).cast(),
            size_of::<libc::c_int>() as libc::socklen_t,
        )
    };
    match result {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

pub(crate) type ReadHalf = Box<dyn AsyncRead + Send + Unpin>;
pub(crate) type WriteHalf = Box<dyn AsyncWrite + Send + Unpin>;

/// A TCP connection that belongs to a link, with its keys and the number of the next frame in each direction.
pub(crate) struct Connection {
    read: ReadHalf,
    write: WriteHalf,
    keys: StatelessTransportState,
    sent: u64,
    received: u64,
}

impl Connection {
    /// Creates a connection that this side has dialled. Its confirmation was the first frame.
    pub(crate) fn dialled(
        stream: Join<ReadHalf, WriteHalf>,
        keys: StatelessTransportState,
    ) -> Self {
        let (read, write) = stream.into_inner();
        Self {
            read,
            write,
            keys,
            sent: 1,
            received: 0,
        }
    }

    /// Creates a connection that this side has accepted.
    pub(crate) fn accepted(
        stream: Join<ReadHalf, WriteHalf>,
        keys: StatelessTransportState,
    ) -> Self {
        Self {
            sent: 0,
            received: 1,
            ..Self::dialled(stream, keys)
        }
    }
}

/// Carries frames over a TCP connection until it has ended.
pub(crate) async fn run_tcp(shared: Arc<Shared>, connection: Connection, is_proven: bool) {
    let Connection {
        read,
        write,
        keys,
        sent,
        received,
    } = connection;
    let guard = shared.add_path(Medium::Network, MAX_TCP_FRAME, is_proven);
    let reason = tokio::select! {
        error = send_tcp(&guard, write, &keys, sent) => error.to_string(),
        error = receive_tcp(&guard, read, &keys, received) => error.to_string(),
        () = guard.task.end.cancelled() => "another one is used".to_owned(),
        () = shared.ended() => "the link has ended".to_owned(),
    };
    tracing::info!(
        "any: the network path to {} has ended: {reason}",
        shared.peer
    );
}

async fn send_tcp(
    guard: &PathGuard,
    mut stream: impl AsyncWrite + Unpin,
    keys: &StatelessTransportState,
    mut number: u64,
) -> io::Error {
    let (mut frame, mut sealed) = (Vec::new(), Vec::with_capacity(WRITE_BYTES));
    let mut offer = guard.shared.own_offer();
    offer.mark_changed();
    loop {
        let next = if offer.has_changed().unwrap_or(false) {
            frame.clear();
            Frame::Offer(&offer.borrow_and_update()).encode(&mut frame);
            Next::Frame(Lane::last())
        } else {
            (guard.shared).next_frame(guard.id, Lane::last(), &mut frame)
        };
        if let Next::Frame(_) = next {
            if let Err(error) = seal(keys, number, &frame, &mut sealed) {
                return error;
            }
            number += 1;
            if sealed.len() < WRITE_BYTES - MAX_TCP_FRAME {
                continue;
            }
        }
        if !sealed.is_empty() {
            if let Err(error) = stream.write_all(&sealed).await {
                return error;
            }
            sealed.clear();
            continue;
        }
        if let Next::Wait(until) = next {
            let offered = async { drop(offer.changed().await) };
            tokio::select! {
                () = guard.task.waker.notified() => {}
                () = sleep_until(until) => {}
                () = offered => offer.mark_changed(),
            }
        }
    }
}

/// Appends a frame with its length, encrypted under that number.
pub(crate) fn seal(
    keys: &StatelessTransportState,
    number: u64,
    frame: &[u8],
    to: &mut Vec<u8>,
) -> io::Result<()> {
    let size = frame.len() + SEAL_BYTES;
    let length = u16::try_from(size).map_err(io::Error::other)?;
    to.extend_from_slice(&length.to_le_bytes());
    let at = to.len();
    to.resize(at + size, 0);
    let written = keys.write_message(number, frame, &mut to[at..]);
    written.map(drop).map_err(io::Error::other)
}

async fn receive_tcp(
    guard: &PathGuard,
    stream: impl AsyncRead + Unpin,
    keys: &StatelessTransportState,
    mut number: u64,
) -> io::Error {
    let mut stream = BufReader::with_capacity(WRITE_BYTES, stream);
    let (mut sealed, mut frame) = (Vec::new(), vec![0; MAX_TCP_FRAME]);
    loop {
        match open_next(&mut stream, keys, number, &mut sealed, &mut frame).await {
            Ok(size) => {
                number += 1;
                if let Err(error) = guard.shared.on_frame(guard.id, &frame[..size]) {
                    return io::Error::other(error);
                }
            }
            Err(error) => return error,
        }
    }
}

/// Receives the next frame into `frame`, and returns its size.
pub(crate) async fn open_next(
    stream: &mut (impl AsyncReadExt + Unpin),
    keys: &StatelessTransportState,
    number: u64,
    sealed: &mut Vec<u8>,
    frame: &mut [u8],
) -> io::Result<usize> {
    let size = usize::from(stream.read_u16_le().await?);
    if !(SEAL_BYTES..=MAX_TCP_FRAME + SEAL_BYTES).contains(&size) {
        return Err(io::Error::other("it sent a frame with a wrong length"));
    }
    sealed.resize(size, 0);
    stream.read_exact(sealed).await?;
    keys.read_message(number, sealed, frame)
        .map_err(|_| io::Error::other("it sent a frame that is not authentic"))
}
