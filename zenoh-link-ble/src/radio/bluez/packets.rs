//! Owns sending and receiving SDUs on a connected L2CAP socket.
//!
//! bluer's own calls are not used for this: once such a socket is hung up and its error has been told, the kernel goes on
//! to say both "ready" and "would block", and they would ask again for ever without giving their thread away.
use std::{
    io::{self, Read},
    net::Shutdown,
    os::fd::{AsRawFd, BorrowedFd},
};

use socket2::Socket;
use tokio::io::{unix::AsyncFd, Interest};

/// The receive buffer asked for, in bytes. The system gives as much as `net.core.rmem_max` allows.
const RECEIVE_BUFFER_BYTES: usize = 1 << 20;
/// The send buffer to begin with, in bytes: the least that Linux gives. It grows until an SDU fits and no further, as what
/// is in it cannot be overtaken by what is more urgent. How much an SDU takes depends on the peer's K-frames.
const LEAST_SEND_BUFFER_BYTES: usize = 4608;

/// A connected L2CAP socket.
pub(super) struct Packets(AsyncFd<Socket>);

impl Packets {
    /// Goes on with the connection of `socket`, which may be dropped then.
    pub(super) fn of(socket: &impl AsRawFd) -> io::Result<Self> {
        // SAFETY: `socket` keeps its descriptor open through the call.
        let borrowed = unsafe { BorrowedFd::borrow_raw(socket.as_raw_fd()) };
        let own = Socket::from(borrowed.try_clone_to_owned()?);
        own.set_nonblocking(true)?;
        // Linux doubles what it is asked for.
        own.set_send_buffer_size(LEAST_SEND_BUFFER_BYTES / 2)?;
        // SAFETY: `own` owns its descriptor and keeps the same one for as long as it lives.
        Ok(Self(unsafe { AsyncFd::register(own) }?))
    }

    /// Sends one SDU; "would block" where there is no room. Tells how many bytes of it went.
    pub(super) fn try_send(&self, sdu: &[u8]) -> io::Result<usize> {
        let mut was_empty = false;
        let send = |socket: &Socket| loop {
            // No signal: the host of a plugin may not ignore SIGPIPE.
            let sent = unless_down(socket, socket.send_with_flags(sdu, libc::MSG_NOSIGNAL));
            match &sent {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock && is_empty(socket) => {
                    // Tried again before the buffer grows: the last of what was in it may have gone just now.
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

    /// Resolves when there may be room since there was none.
    pub(super) async fn has_room(&self) {
        // It fails only when the runtime ends.
        let _ = self.0.ready(Interest::WRITABLE).await;
    }

    /// Asks for a large receive buffer, and tells what there is, in bytes.
    pub(super) fn widen_receive_buffer(&self) -> io::Result<usize> {
        let socket = self.0.get_ref();
        if socket.recv_buffer_size()? < RECEIVE_BUFFER_BYTES {
            socket.set_recv_buffer_size(RECEIVE_BUFFER_BYTES / 2)?;
        }
        socket.recv_buffer_size()
    }

    /// Receives one SDU and tells its size; 0 when the peer has closed.
    pub(super) async fn recv(&self, buffer: &mut [u8]) -> io::Result<usize> {
        let recv = |mut socket: &Socket| unless_down(socket, socket.read(buffer));
        self.0.async_io(Interest::READABLE, recv).await
    }

    /// Closes both directions.
    pub(super) fn shutdown(&self) {
        // It may be down already; there is nothing left to do then.
        let _ = self.0.get_ref().shutdown(Shutdown::Both);
    }
}

/// What was done, or the reason why "would block" will never change.
fn unless_down(socket: &Socket, done: io::Result<usize>) -> io::Result<usize> {
    match done {
        Err(error) if error.kind() == io::ErrorKind::WouldBlock && is_hung_up(socket) => {
            Err(socket
                .take_error()?
                .unwrap_or_else(|| io::ErrorKind::NotConnected.into()))
        }
        done => done,
    }
}

/// Whether nothing waits in the send buffer. (TIOCOUTQ of a Bluetooth socket tells how much is free.)
fn is_empty(socket: &Socket) -> bool {
    /// Where `SO_MEMINFO` has the bytes in the send buffer (include/uapi/linux/sock_diag.h).
    const SK_MEMINFO_WMEM_ALLOC: usize = 2;
    let mut told = [0_u32; SK_MEMINFO_WMEM_ALLOC + 1];
    let mut size = size_of_val(&told) as libc::socklen_t;
    // SAFETY: the system writes at most `size` bytes into `told`.
    let result = unsafe {
        libc::getsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_MEMINFO,
            told.as_mut_ptr().cast(),
            &raw mut size,
        )
    };
    result == 0 && told[SK_MEMINFO_WMEM_ALLOC] == 0
}

/// Whether the connection is over.
pub(super) fn is_hung_up(socket: &Socket) -> bool {
    events(socket) & (libc::POLLHUP | libc::POLLERR) != 0
}

/// Whether the connection is made, and has room.
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

    /// As an L2CAP socket behaves whose error was told before: hung up, nothing to read, no error.
    #[tokio::test]
    async fn a_socket_that_is_hung_up_is_down_and_not_waited_for() {
        let (near, far) = Socket::pair(socket2::Domain::UNIX, socket2::Type::SEQPACKET, None)
            .expect("the system has them");
        near.set_nonblocking(true).expect("can be");
        let would_block = || Err(io::ErrorKind::WouldBlock.into());
        let waits = unless_down(&near, would_block());
        assert_eq!(
            waits.expect_err("waits").kind(),
            io::ErrorKind::WouldBlock,
            "alive"
        );
        drop(far);
        let down = unless_down(&near, would_block());
        assert_eq!(
            down.expect_err("is down").kind(),
            io::ErrorKind::NotConnected
        );
    }

    #[tokio::test]
    async fn what_was_sent_waits_in_the_buffer_until_it_is_taken() {
        let (near, far) = Socket::pair(socket2::Domain::UNIX, socket2::Type::SEQPACKET, None)
            .expect("the system has them");
        assert!(is_empty(&near));
        near.send(b"an sdu").expect("sends");
        assert!(!is_empty(&near));
        assert_eq!((&far).read(&mut [0; 100]).expect("receives"), 6);
        assert!(is_empty(&near));
    }

    /// The system tells neither from the other.
    #[tokio::test]
    async fn an_empty_sdu_reads_as_the_end() {
        let (near, far) = Socket::pair(socket2::Domain::UNIX, socket2::Type::SEQPACKET, None)
            .expect("the system has them");
        let near = Packets::of(&near).expect("made");
        far.send(&[]).expect("sends");
        assert_eq!(near.recv(&mut [0; 100]).await.expect("receives"), 0);
    }

    #[tokio::test]
    async fn sdus_go_both_ways_whole() {
        let (near, far) = Socket::pair(socket2::Domain::UNIX, socket2::Type::SEQPACKET, None)
            .expect("the system has them");
        let (near, far) = (
            Packets::of(&near).expect("made"),
            Packets::of(&far).expect("made"),
        );
        near.has_room().await;
        assert_eq!(near.try_send(b"to the far end").expect("sends"), 14);
        far.has_room().await;
        assert_eq!(far.try_send(b"back").expect("sends"), 4);
        let mut buffer = [0; 100];
        assert_eq!(far.recv(&mut buffer).await.expect("receives"), 14);
        assert_eq!(near.recv(&mut buffer).await.expect("receives"), 4);
        near.shutdown();
        assert_eq!(far.recv(&mut buffer).await.expect("receives"), 0);
    }
}
