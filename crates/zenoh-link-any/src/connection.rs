//! A TCP connection that is a path, or is about to become one, and its frames.
use std::{io, net::IpAddr, time::Duration};

use snow::StatelessTransportState;
use tokio::{
    io::{join, AsyncRead, AsyncReadExt, AsyncWrite, Join},
    net::TcpStream,
};

use crate::proof::SEAL_BYTES;

/// The largest frame on a TCP connection, in bytes.
pub(crate) const MAX_TCP_FRAME: usize = 16_384;
/// Number of bytes that may wait in the kernel of this side, so that what has not left can take another path.
const NOT_SENT_BYTES: libc::c_int = 32_768;
/// How long a connection may be silent although data was sent, before the kernel ends it.
const TCP_TIMEOUT: Duration = Duration::from_secs(10);

pub(crate) type ReadHalf = Box<dyn AsyncRead + Send + Unpin>;
pub(crate) type WriteHalf = Box<dyn AsyncWrite + Send + Unpin>;

/// A connection.
pub(crate) struct Stream {
    /// Its directions, which two tasks can use without a lock.
    pub(crate) halves: Join<ReadHalf, WriteHalf>,
    /// The address of this side; `None` in a simulation.
    pub(crate) local: Option<IpAddr>,
}

impl Stream {
    /// Takes over a connection of the network, and sets its options.
    pub(crate) fn of_tcp(stream: TcpStream) -> io::Result<Self> {
        prepare(&stream)?;
        let local = stream.local_addr()?.ip().to_canonical();
        let (read, write) = stream.into_split();
        Ok(Stream {
            halves: join(Box::new(read), Box::new(write)),
            local: Some(local),
        })
    }
}

/// Sets the options of a connection before it becomes a path.
fn prepare(stream: &TcpStream) -> io::Result<()> {
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

/// A TCP connection that belongs to a link, with its keys and the number of the next frame in each direction.
pub(crate) struct Connection {
    pub(crate) read: ReadHalf,
    pub(crate) write: WriteHalf,
    pub(crate) keys: StatelessTransportState,
    pub(crate) sent: u64,
    pub(crate) received: u64,
    /// The address of this side; `None` in a simulation.
    pub(crate) local: Option<IpAddr>,
}

impl Connection {
    /// Creates a connection that this side has dialled. Its confirmation was the first frame.
    pub(crate) fn dialled(stream: Stream, keys: StatelessTransportState) -> Self {
        let Stream { halves, local } = stream;
        let (read, write) = halves.into_inner();
        Self {
            read,
            write,
            keys,
            sent: 1,
            received: 0,
            local,
        }
    }

    /// Creates a connection that this side has accepted.
    pub(crate) fn accepted(stream: Stream, keys: StatelessTransportState) -> Self {
        Self {
            sent: 0,
            received: 1,
            ..Self::dialled(stream, keys)
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
