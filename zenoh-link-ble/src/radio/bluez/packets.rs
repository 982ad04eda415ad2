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

pub(super) struct Packets(AsyncFd<Socket>);

impl Packets {
    /// Goes on with the connection of `socket`, which may be dropped then.
    pub(super) fn of(socket: &impl AsRawFd) -> io::Result<Self> {
        // SAFETY: `socket` keeps its descriptor open through the call.
        let borrowed = unsafe { BorrowedFd::borrow_raw(socket.as_raw_fd()) };
        let own = Socket::from(borrowed.try_clone_to_owned()?);
        own.set_nonblocking(true)?;
        // SAFETY: `own` owns its descriptor and keeps the same one for as long as it lives.
        Ok(Self(unsafe { AsyncFd::register(own) }?))
    }

    /// Sends one SDU; waits for room. Tells how many bytes of it went.
    pub(super) async fn send(&self, sdu: &[u8]) -> io::Result<usize> {
        // No signal: the host of a plugin may not ignore SIGPIPE.
        let send =
            |socket: &Socket| unless_down(socket, socket.send_with_flags(sdu, libc::MSG_NOSIGNAL));
        self.0.async_io(Interest::WRITABLE, send).await
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
    async fn sdus_go_both_ways_whole() {
        let (near, far) = Socket::pair(socket2::Domain::UNIX, socket2::Type::SEQPACKET, None)
            .expect("the system has them");
        let (near, far) = (
            Packets::of(&near).expect("made"),
            Packets::of(&far).expect("made"),
        );
        assert_eq!(near.send(b"to the far end").await.expect("sends"), 14);
        assert_eq!(far.send(b"back").await.expect("sends"), 4);
        let mut buffer = [0; 100];
        assert_eq!(far.recv(&mut buffer).await.expect("receives"), 14);
        assert_eq!(near.recv(&mut buffer).await.expect("receives"), 4);
        near.shutdown();
        assert_eq!(far.recv(&mut buffer).await.expect("receives"), 0);
    }
}
