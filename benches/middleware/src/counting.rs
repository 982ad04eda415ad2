//! Provides a proxy that counts the bytes of TCP streams, without the headers of TCP and IP.
use std::{
    io,
    net::SocketAddr,
    sync::{
        atomic::{AtomicU64, Ordering::Relaxed},
        Arc,
    },
};

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{
        tcp::{OwnedReadHalf, OwnedWriteHalf},
        TcpListener, TcpStream,
    },
};

pub struct CountingProxy {
    /// The address that the proxy listens on.
    pub address: SocketAddr,
    passed: Arc<AtomicU64>,
}

impl CountingProxy {
    pub async fn before(target: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0").await?;
        let address = listener.local_addr()?;
        let passed = Arc::<AtomicU64>::default();
        tokio::spawn(accept(listener, target, passed.clone()));
        Ok(Self { address, passed })
    }

    /// Returns the bytes of all TCP connections, in both directions.
    pub fn bytes(&self) -> u64 {
        self.passed.load(Relaxed)
    }
}

async fn accept(
    listener: TcpListener,
    target: SocketAddr,
    passed: Arc<AtomicU64>,
) -> io::Result<()> {
    loop {
        let (near, _) = listener.accept().await?;
        // The client connects again, as it would without the proxy.
        let Ok(far) = TcpStream::connect(target).await else {
            continue;
        };
        near.set_nodelay(true)?;
        far.set_nodelay(true)?;
        let ((from_near, to_near), (from_far, to_far)) = (near.into_split(), far.into_split());
        tokio::spawn(pass(from_near, to_far, passed.clone()));
        tokio::spawn(pass(from_far, to_near, passed.clone()));
    }
}

async fn pass(
    mut from: OwnedReadHalf,
    mut to: OwnedWriteHalf,
    passed: Arc<AtomicU64>,
) -> io::Result<()> {
    let mut buffer = vec![0; 65_536];
    loop {
        match from.read(&mut buffer).await? {
            0 => return to.shutdown().await,
            count => {
                passed.fetch_add(count as u64, Relaxed);
                to.write_all(&buffer[..count]).await?;
            }
        }
    }
}
