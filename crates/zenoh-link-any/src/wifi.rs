//! A simulated Wi-Fi for tests, demos and benches: a relay through which the TCP paths of simulated robots run, with a rate, a
//! latency and faults. It is found by its Unix socket, whose path is that of the simulated air and `.wifi`.
use std::{
    ffi::OsString,
    io,
    net::SocketAddr,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use parking_lot::Mutex;
use tokio::{
    io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader},
    net::{TcpStream, UnixListener, UnixStream},
    sync::{mpsc, watch},
    time::Instant,
};

/// Number of bytes that are read at once.
const CHUNK_BYTES: usize = 4096;
/// Number of chunks that wait in the network, in each direction of a connection.
const QUEUE_CHUNKS: usize = 16;
/// How much later a chunk arrives whose packet was lost: TCP's shortest retransmission timeout on Linux.
const RETRANSMISSION: Duration = Duration::from_millis(200);
/// Number of chunks to which [`WifiOptions::losses`] refers.
const LOSSES_PER: u32 = 1000;

/// The properties of the network.
#[derive(Clone, Copy, Debug)]
pub struct WifiOptions {
    /// Bytes per second, of all connections together.
    pub bytes_per_s: f64,
    /// Time that each byte needs in addition.
    pub latency: Duration,
    /// How many of 1000 chunks of 4 kB are delayed by a lost packet.
    pub losses: u32,
}

impl Default for WifiOptions {
    fn default() -> Self {
        Self {
            bytes_per_s: 3_000_000.0,
            latency: Duration::from_millis(2),
            losses: 0,
        }
    }
}

/// Whether the network works.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WifiState {
    /// It works.
    On,
    /// Nothing arrives, but connections stay open, as if the channel were jammed.
    Silent,
    /// There is no network: connections have ended, and new ones fail.
    Off,
}

impl WifiState {
    /// Returns the name of the state.
    pub fn name(self) -> &'static str {
        match self {
            Self::On => "on",
            Self::Silent => "silent",
            Self::Off => "off",
        }
    }

    /// Returns the state with that name.
    pub fn parse(name: &str) -> Option<Self> {
        [Self::On, Self::Silent, Self::Off]
            .into_iter()
            .find(|state| state.name() == name)
    }
}

/// Returns the path of the socket of this user's simulated Wi-Fi.
pub fn socket_path() -> PathBuf {
    socket_beside(&zenoh_link_ble_air::socket_path())
}

/// Returns the path of the socket of the Wi-Fi beside a simulated air.
pub fn socket_beside(air: &Path) -> PathBuf {
    let mut path = OsString::from(air);
    path.push(".wifi");
    path.into()
}

/// Changes the state of a running simulated Wi-Fi.
///
/// # Errors
/// Fails if there is none at that path.
pub async fn control(socket: &Path, state: WifiState) -> io::Result<()> {
    let mut stream = BufReader::new(UnixStream::connect(socket).await?);
    let command = format!("set {}\n", state.name());
    stream.write_all(command.as_bytes()).await?;
    let mut answer = String::new();
    stream.read_line(&mut answer).await?;
    match answer.trim() {
        "ok" => Ok(()),
        other => Err(io::Error::other(other.to_owned())),
    }
}

/// Connects to an address through the simulated Wi-Fi.
pub(crate) async fn connect(address: SocketAddr) -> io::Result<UnixStream> {
    let mut stream = UnixStream::connect(socket_path()).await?;
    let request = format!("connect {address}\n");
    stream.write_all(request.as_bytes()).await?;
    Ok(stream)
}

/// A simulated Wi-Fi. Dropping it removes its socket.
pub struct Wifi {
    listener: UnixListener,
    path: PathBuf,
    shared: Arc<Shared>,
}

struct Shared {
    options: WifiOptions,
    state: watch::Sender<WifiState>,
    /// Until when the channel is in use.
    busy_until: Mutex<Instant>,
    chunks: Mutex<u32>,
}

impl Wifi {
    /// Opens the socket, and replaces one that a killed program has left.
    ///
    /// # Errors
    /// Fails if the socket cannot be created.
    pub fn bind(path: &Path, options: WifiOptions) -> io::Result<Self> {
        match std::fs::remove_file(path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let listener = UnixListener::bind(path)?;
        // Whatever the umask of the program is.
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600))?;
        Ok(Self {
            listener,
            path: path.to_owned(),
            shared: Arc::new(Shared {
                options,
                state: watch::Sender::new(WifiState::On),
                busy_until: Mutex::new(Instant::now()),
                chunks: Mutex::new(0),
            }),
        })
    }

    /// Relays connections until the future is dropped.
    pub async fn serve(&self) {
        loop {
            match self.listener.accept().await {
                Ok((stream, _)) => {
                    let shared = Arc::clone(&self.shared);
                    // A client that ends a connection in the middle of a request concerns nobody else.
                    tokio::spawn(async move { drop(shared.handle(stream).await) });
                }
                Err(_) => tokio::time::sleep(RETRANSMISSION).await,
            }
        }
    }
}

impl Drop for Wifi {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

impl Shared {
    async fn handle(self: Arc<Self>, stream: UnixStream) -> io::Result<()> {
        let mut stream = BufReader::new(stream);
        let mut request = String::new();
        // Requests are short.
        (&mut stream).take(100).read_line(&mut request).await?;
        let request = request.trim();
        if let Some(name) = request.strip_prefix("set ") {
            let answer = match WifiState::parse(name) {
                Some(state) => {
                    self.state.send_replace(state);
                    "ok\n"
                }
                None => "a state is on, silent or off\n",
            };
            return stream.write_all(answer.as_bytes()).await;
        }
        let address = request.strip_prefix("connect ").map(str::parse);
        let Some(Ok(address)) = address else {
            return Err(io::ErrorKind::InvalidInput.into());
        };
        self.relay(stream, address).await
    }

    async fn relay(
        self: Arc<Self>,
        near: BufReader<UnixStream>,
        address: SocketAddr,
    ) -> io::Result<()> {
        let mut state = self.state.subscribe();
        state
            .wait_for(|state| *state != WifiState::Silent)
            .await
            .map_err(io::Error::other)?;
        if *state.borrow() == WifiState::Off {
            return Err(io::ErrorKind::NetworkUnreachable.into());
        }
        let far = TcpStream::connect(address).await?;
        far.set_nodelay(true)?;
        let (near_read, near_write) = tokio::io::split(near);
        let (far_read, far_write) = far.into_split();
        let off = async move { drop(state.wait_for(|state| *state == WifiState::Off).await) };
        // Both directions end together, and with them the connection.
        tokio::select! {
            ended = self.carry(near_read, far_write) => ended,
            ended = self.carry(far_read, near_write) => ended,
            () = off => Ok(()),
        }
    }

    /// Moves the bytes of one direction.
    async fn carry(
        &self,
        mut from: impl AsyncReadExt + Unpin,
        mut to: impl AsyncWriteExt + Unpin,
    ) -> io::Result<()> {
        let (queue, mut arrivals) = mpsc::channel::<(Instant, Vec<u8>)>(QUEUE_CHUNKS);
        let send = async move {
            loop {
                let mut chunk = vec![0; CHUNK_BYTES];
                let size = from.read(&mut chunk).await?;
                if size == 0 {
                    return Ok(());
                }
                chunk.truncate(size);
                let left = self.airtime(size);
                // The sender's kernel waits while the channel is in use.
                tokio::time::sleep_until(left).await;
                let arrives = left + self.options.latency + self.delay();
                if queue.send((arrives, chunk)).await.is_err() {
                    return Ok(());
                }
            }
        };
        let receive = async {
            let mut state = self.state.subscribe();
            while let Some((arrives, chunk)) = arrivals.recv().await {
                tokio::time::sleep_until(arrives).await;
                if state
                    .wait_for(|state| *state == WifiState::On)
                    .await
                    .is_err()
                {
                    return Ok(());
                }
                to.write_all(&chunk).await?;
            }
            Ok(())
        };
        // The bytes that were sent before the end of a connection still arrive.
        tokio::try_join!(send, receive).map(drop)
    }

    /// Reserves the channel for that many bytes, and returns when they have left.
    fn airtime(&self, bytes: usize) -> Instant {
        let mut busy_until = self.busy_until.lock();
        let time = Duration::from_secs_f64(bytes as f64 / self.options.bytes_per_s);
        *busy_until = (*busy_until).max(Instant::now()) + time;
        *busy_until
    }

    /// Returns the delay of the next chunk by lost packets.
    fn delay(&self) -> Duration {
        let mut chunks = self.chunks.lock();
        *chunks = chunks.wrapping_add(1);
        // Spread evenly, so that each run is alike.
        let is_lost = |n: u32| n.wrapping_mul(2_654_435_761) % LOSSES_PER < self.options.losses;
        match is_lost(*chunks) {
            true => RETRANSMISSION,
            false => Duration::ZERO,
        }
    }
}
