//! Sends and receives SDUs on a connected L2CAP socket.
//!
//! The methods of bluer are not used for this. After such a socket was hung up and its error was read once, the kernel
//! reports both "ready" and "would block", and bluer's methods would retry forever without yielding.
use std::{
    io::{self, Read},
    net::Shutdown,
    os::fd::{AsRawFd, BorrowedFd},
    time::Duration,
};

use socket2::Socket;
use tokio::io::{unix::AsyncFd, Interest};

/// Requested size of the receive buffer, in bytes. The system grants at most `net.core.rmem_max`.
const RECEIVE_BUFFER_BYTES: usize = 1 << 20;
/// Initial size of the send buffer, in bytes: the minimum that Linux allows. The buffer grows until one SDU fits and no
/// further, because data in it cannot be overtaken by more urgent data. The space that an SDU needs depends on the size
/// of the peer's K-frames.
const MIN_SEND_BUFFER_BYTES: usize = 4608;

/// How long a sender waits for an event before it tries again. At 100 kB/s, a radio sends half a send buffer in 40 ms.
const RETRY: Duration = Duration::from_millis(40);

/// A connected L2CAP socket.
pub(super) struct SduSocket(AsyncFd<Socket>);

impl SduSocket {
    /// Takes over the connection of `socket`, which may be dropped afterwards.
    pub(super) fn new(socket: &impl AsRawFd) -> io::Result<Self> {
        // SAFETY: `socket` keeps its descriptor open through the call.
        let borrowed = unsafe { BorrowedFd::borrow_raw(socket.as_raw_fd()) };
        let own = Socket::from(borrowed.try_clone_to_owned()?);
        own.set_nonblocking(true)?;
        // Linux doubles the requested size.
        own.set_send_buffer_size(MIN_SEND_BUFFER_BYTES / 2)?;
        // SAFETY: `own` owns its descriptor and keeps the same one for as long as it lives.
        Ok(Self(unsafe { AsyncFd::register(own) }?))
    }

    /// Sends one SDU and returns how many of its bytes were sent.
    ///
    /// # Errors
    /// Fails with "would block" if there is no room.
    pub(super) fn try_send(&self, sdu: &[u8]) -> io::Result<usize> {
        let mut was_empty = false;
        let send = |socket: &Socket| loop {
            // Without SIGPIPE: the process that loads the plugin does not necessarily ignore that signal.
            let sent = check_hung_up(socket, socket.send_with_flags(sdu, libc::MSG_NOSIGNAL));
            match &sent {
                Err(error)
                    if error.kind() == io::ErrorKind::WouldBlock && unsent_bytes(socket) == 0 =>
                {
                    // Retry once before growing the buffer: its last bytes may have been sent just now.
                    if was_empty {
                        socket.set_send_buffer_size(socket.send_buffer_size()?)?;
                    }
                    was_empty = !was_empty;
                }
                _ => return sent,
            }
        };
        self.0.try_io(Interest::WRITABLE, send)
    }

    /// Waits until the socket has more room than now, or the connection was hung up, but at most [`RETRY`].
    ///
    /// An event of the system is not enough. An attempt to send an SDU of several K-frames, of which only the first ones
    /// have room, returns their space, and that is an event too: a sender that tries again for each event never rests.
    /// Nor does each change cause an event: the room may have grown before this wait began.
    pub(super) async fn writable(&self) {
        let socket = self.0.get_ref();
        let unsent_before = unsent_bytes(socket);
        let has_more_room = async {
            // Fails only when the runtime shuts down.
            while let Ok(mut event) = self.0.ready(Interest::WRITABLE).await {
                let unsent = unsent_bytes(socket);
                if unsent == 0 || unsent < unsent_before || is_hung_up(socket) {
                    return;
                }
                event.clear_ready();
            }
        };
        let _ = tokio::time::timeout(RETRY, has_more_room).await;
    }

    /// Requests a large receive buffer and returns its actual size, in bytes.
    pub(super) fn widen_receive_buffer(&self) -> io::Result<usize> {
        let socket = self.0.get_ref();
        if socket.recv_buffer_size()? < RECEIVE_BUFFER_BYTES {
            socket.set_recv_buffer_size(RECEIVE_BUFFER_BYTES / 2)?;
        }
        socket.recv_buffer_size()
    }

    /// Receives one SDU and returns its size in bytes; 0 if the peer closed the channel.
    pub(super) async fn recv(&self, buffer: &mut [u8]) -> io::Result<usize> {
        let recv = |mut socket: &Socket| check_hung_up(socket, socket.read(buffer));
        self.0.async_io(Interest::READABLE, recv).await
    }

    /// Closes both directions.
    pub(super) fn shutdown(&self) {
        // The socket may already be down; nothing is left to do then.
        let _ = self.0.get_ref().shutdown(Shutdown::Both);
    }
}

/// Returns the result, or the reason of the hang-up if "would block" would never change.
fn check_hung_up(socket: &Socket, result: io::Result<usize>) -> io::Result<usize> {
    match result {
        Err(error) if error.kind() == io::ErrorKind::WouldBlock && is_hung_up(socket) => {
            Err(socket
                .take_error()?
                .unwrap_or_else(|| io::ErrorKind::NotConnected.into()))
        }
        result => result,
    }
}

/// Returns the size of the send buffer's content, in bytes as the system counts them; 0 if the system does not tell. (For
/// a Bluetooth socket, TIOCOUTQ returns the free space.)
fn unsent_bytes(socket: &Socket) -> u32 {
    /// Index of the number of bytes in the send buffer within `SO_MEMINFO` (include/uapi/linux/sock_diag.h).
    const SK_MEMINFO_WMEM_ALLOC: usize = 2;
    let mut meminfo = [0_u32; SK_MEMINFO_WMEM_ALLOC + 1];
    let mut size = size_of_val(&meminfo) as libc::socklen_t;
    // SAFETY: the system writes at most `size` bytes into `meminfo`.
    unsafe {
        libc::getsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_MEMINFO,
            meminfo.as_mut_ptr().cast(),
            &raw mut size,
        );
    }
    meminfo[SK_MEMINFO_WMEM_ALLOC]
}

/// Returns whether the connection was hung up.
pub(super) fn is_hung_up(socket: &Socket) -> bool {
    events(socket) & (libc::POLLHUP | libc::POLLERR) != 0
}

/// Returns whether the connection is established and has room.
pub(super) fn is_writable(socket: &Socket) -> bool {
    events(socket) & libc::POLLOUT != 0
}

fn events(socket: &Socket) -> libc::c_short {
    let mut poll = libc::pollfd {
        fd: socket.as_raw_fd(),
        events: libc::POLLOUT,
        revents: 0,
    };
    // SAFETY: one valid pollfd, and no waiting.
    match unsafe { libc::poll(&mut poll, 1, 0) } {
        1 => poll.revents,
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Simulates an L2CAP socket whose error was already read: hung up, nothing to read, no error.
    #[tokio::test]
    async fn reports_a_hung_up_socket_as_down() {
        let (near, far) = Socket::pair(socket2::Domain::UNIX, socket2::Type::SEQPACKET, None)
            .expect("creates a socket pair");
        near.set_nonblocking(true).expect("sets non-blocking mode");
        let would_block = || Err(io::ErrorKind::WouldBlock.into());
        let waits = check_hung_up(&near, would_block());
        assert_eq!(
            waits.expect_err("would block").kind(),
            io::ErrorKind::WouldBlock,
            "alive"
        );
        drop(far);
        let down = check_hung_up(&near, would_block());
        assert_eq!(
            down.expect_err("is down").kind(),
            io::ErrorKind::NotConnected
        );
    }

    #[tokio::test]
    async fn detects_unsent_data_in_the_send_buffer() {
        let (near, far) = Socket::pair(socket2::Domain::UNIX, socket2::Type::SEQPACKET, None)
            .expect("creates a socket pair");
        assert_eq!(unsent_bytes(&near), 0);
        near.send(b"an sdu").expect("sends");
        assert!(unsent_bytes(&near) > 0);
        assert_eq!((&far).read(&mut [0; 100]).expect("receives"), 6);
        assert_eq!(unsent_bytes(&near), 0);
    }

    /// The system does not distinguish the two.
    #[tokio::test]
    async fn reads_an_empty_sdu_as_the_end() {
        let (near, far) = Socket::pair(socket2::Domain::UNIX, socket2::Type::SEQPACKET, None)
            .expect("creates a socket pair");
        let near = SduSocket::new(&near).expect("wraps the socket");
        far.send(&[]).expect("sends");
        assert_eq!(near.recv(&mut [0; 100]).await.expect("receives"), 0);
    }

    #[tokio::test]
    async fn transfers_complete_sdus_in_both_directions() {
        let (near, far) = Socket::pair(socket2::Domain::UNIX, socket2::Type::SEQPACKET, None)
            .expect("creates a socket pair");
        let (near, far) = (
            SduSocket::new(&near).expect("wraps the socket"),
            SduSocket::new(&far).expect("wraps the socket"),
        );
        near.writable().await;
        assert_eq!(near.try_send(b"to the far end").expect("sends"), 14);
        far.writable().await;
        assert_eq!(far.try_send(b"back").expect("sends"), 4);
        let mut buffer = [0; 100];
        assert_eq!(far.recv(&mut buffer).await.expect("receives"), 14);
        assert_eq!(near.recv(&mut buffer).await.expect("receives"), 4);
        near.shutdown();
        assert_eq!(far.recv(&mut buffer).await.expect("receives"), 0);
    }
}
