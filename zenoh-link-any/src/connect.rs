//! Opens and accepts the TCP connections that become paths.
use std::{future::Future, io, net::SocketAddr, sync::Arc, time::Duration};

use snow::StatelessTransportState;
use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt},
    net::TcpStream,
    time::timeout,
};

use crate::{
    proof::{tag_of, Tag, MESSAGE_BYTES, OPENING_BYTES},
    run::{open_next, prepare, seal, Connection},
    shared::Shared,
    wifi,
};

/// How long a connect, and then the proof, may take.
const TIMEOUT: Duration = Duration::from_secs(3);

/// Connects to an address of the peer, and proves that the connection belongs to the link. A simulated robot connects through
/// the simulated Wi-Fi.
pub(crate) async fn connect(
    shared: &Shared,
    address: SocketAddr,
    is_simulated: bool,
) -> io::Result<Connection> {
    if is_simulated {
        let mut stream = within(wifi::connect(address)).await?;
        let keys = prove(shared, &mut stream).await?;
        return Ok(Connection::dialled(stream.into_split(), keys));
    }
    let mut stream = within(TcpStream::connect(address)).await?;
    prepare(&stream)?;
    let keys = prove(shared, &mut stream).await?;
    Ok(Connection::dialled(stream.into_split(), keys))
}

/// Performs the handshake of a connection as its dialler.
async fn prove(
    shared: &Shared,
    stream: &mut (impl AsyncRead + AsyncWrite + Unpin),
) -> io::Result<StatelessTransportState> {
    let proof = shared.proof.as_ref().ok_or_else(no_secret)?;
    let (opening, message) = proof.open().map_err(io::Error::other)?;
    let answered = async {
        stream.write_all(&message).await?;
        let mut answer = [0; MESSAGE_BYTES];
        stream.read_exact(&mut answer).await?;
        let keys = opening.finish(&answer).map_err(io::Error::other)?;
        // Only one who has the keys can confirm; the first message may be a repetition.
        let mut confirmation = Vec::new();
        seal(&keys, 0, &[], &mut confirmation)?;
        stream.write_all(&confirmation).await?;
        Ok(keys)
    };
    within(answered).await
}

/// Verifies that an accepted connection belongs to a link, which `find` returns for its tag.
pub(crate) async fn accept(
    mut stream: TcpStream,
    find: impl FnOnce(Tag) -> Option<Arc<Shared>>,
) -> io::Result<(Arc<Shared>, Connection)> {
    prepare(&stream)?;
    let proven = async {
        let mut opening = [0; OPENING_BYTES];
        stream.read_exact(&mut opening).await?;
        let shared = tag_of(&opening).and_then(find).ok_or_else(unknown)?;
        let proof = shared.proof.as_ref().ok_or_else(no_secret)?;
        let (answer, keys) = proof.answer(&opening).map_err(io::Error::other)?;
        stream.write_all(&answer).await?;
        let (mut sealed, mut confirmation) = (Vec::new(), [0; 64]);
        match open_next(&mut stream, &keys, 0, &mut sealed, &mut confirmation).await? {
            0 => Ok((shared, keys)),
            _ => Err(io::Error::other("it did not confirm its keys")),
        }
    };
    let (shared, keys) = within(proven).await?;
    Ok((shared, Connection::accepted(stream.into_split(), keys)))
}

async fn within<T>(step: impl Future<Output = io::Result<T>>) -> io::Result<T> {
    timeout(TIMEOUT, step)
        .await
        .unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()))
}

fn unknown() -> io::Error {
    io::Error::other("it belongs to no link of this side")
}

fn no_secret() -> io::Error {
    io::Error::other("the link has no secret, and therefore no further paths")
}
