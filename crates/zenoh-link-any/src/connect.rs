//! Opens and accepts the TCP connections that become paths.
use std::{future::Future, io, net::SocketAddr, sync::Arc, time::Duration};

use tokio::{
    io::{join, AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    time::timeout,
};

use crate::{
    connection::{open_next, seal, Connection, Stream},
    proof::{tag_of, Tag, MAGIC, MESSAGE_BYTES, OPENING_BYTES},
    shared::Shared,
    wifi,
};

/// How long a connect, and then the proof, may take.
const TIMEOUT: Duration = Duration::from_secs(3);

/// Connects to an address of the peer, and proves that the connection belongs to the link.
pub(crate) async fn connect(
    shared: &Shared,
    address: SocketAddr,
    is_simulated: bool,
) -> io::Result<Connection> {
    let stream = dial(address, is_simulated).await?;
    prove(shared, stream).await
}

/// Connects to an address. A simulated robot connects through the simulated Wi-Fi.
pub(crate) async fn dial(address: SocketAddr, is_simulated: bool) -> io::Result<Stream> {
    if is_simulated {
        let (read, write) = within(wifi::connect(address)).await?.into_split();
        return Ok(Stream {
            halves: join(Box::new(read), Box::new(write)),
            local: None,
        });
    }
    let stream = within(TcpStream::connect(address)).await?;
    Stream::of_tcp(stream)
}

/// Proves as the dialler of a connection that it belongs to the link.
pub(crate) async fn prove(shared: &Shared, mut stream: Stream) -> io::Result<Connection> {
    let proof = shared.proof.as_ref().ok_or_else(no_secret)?;
    let halves = &mut stream.halves;
    let (opening, message) = proof.open().map_err(io::Error::other)?;
    let answered = async {
        halves.write_all(&message).await?;
        let mut answer = [0; MESSAGE_BYTES];
        halves.read_exact(&mut answer).await?;
        let keys = opening.finish(&answer).map_err(io::Error::other)?;
        // Only one who has the keys can confirm; the first message may be a repetition.
        let mut confirmation = Vec::new();
        seal(&keys, 0, &[], &mut confirmation)?;
        halves.write_all(&confirmation).await?;
        Ok::<_, io::Error>(keys)
    };
    let keys = within(answered).await?;
    Ok(Connection::dialled(stream, keys))
}

/// Verifies that an accepted connection belongs to a link, which `find` returns for its tag. `magic` are its first bytes.
pub(crate) async fn accept(
    mut stream: Stream,
    magic: [u8; MAGIC.len()],
    find: impl FnOnce(Tag) -> Option<Arc<Shared>>,
) -> io::Result<(Arc<Shared>, Connection)> {
    let halves = &mut stream.halves;
    let proven = async {
        let mut opening = [0; OPENING_BYTES];
        let (first, rest) = opening.split_at_mut(magic.len());
        first.copy_from_slice(&magic);
        halves.read_exact(rest).await?;
        let shared = tag_of(&opening).and_then(find).ok_or_else(unknown)?;
        let proof = shared.proof.as_ref().ok_or_else(no_secret)?;
        let (answer, keys) = proof.answer(&opening).map_err(io::Error::other)?;
        halves.write_all(&answer).await?;
        let (mut sealed, mut confirmation) = (Vec::new(), [0; 64]);
        match open_next(halves, &keys, 0, &mut sealed, &mut confirmation).await? {
            0 => Ok::<_, io::Error>((shared, keys)),
            _ => Err(io::Error::other("it did not confirm its keys")),
        }
    };
    let (shared, keys) = within(proven).await?;
    Ok((shared, Connection::accepted(stream, keys)))
}

/// Verifies that an accepted connection belongs to this link, which was opened on it.
pub(crate) async fn accept_as(shared: &Arc<Shared>, mut stream: Stream) -> io::Result<Connection> {
    let mut magic = [0; MAGIC.len()];
    within(stream.halves.read_exact(&mut magic)).await?;
    let is_this = |tag: Tag| shared.proof.as_ref().is_some_and(|proof| proof.tag == tag);
    let find = |tag: Tag| is_this(tag).then(|| Arc::clone(shared));
    let (_, connection) = accept(stream, magic, find).await?;
    Ok(connection)
}

/// Receives the first bytes of an accepted connection, which tell what it is for.
pub(crate) async fn receive_magic(stream: TcpStream) -> io::Result<(Stream, [u8; MAGIC.len()])> {
    let mut stream = Stream::of_tcp(stream)?;
    let mut magic = [0; MAGIC.len()];
    within(stream.halves.read_exact(&mut magic)).await?;
    Ok((stream, magic))
}

/// Waits for a step of a handshake for at most [`TIMEOUT`].
pub(crate) async fn within<T, E: From<io::Error>>(
    step: impl Future<Output = Result<T, E>>,
) -> Result<T, E> {
    timeout(TIMEOUT, step)
        .await
        .unwrap_or_else(|_| Err(io::Error::from(io::ErrorKind::TimedOut).into()))
}

fn unknown() -> io::Error {
    io::Error::other("it belongs to no link of this side")
}

fn no_secret() -> io::Error {
    io::Error::other("the link has no secret, and therefore no further paths")
}
