//! Accepts viewers: limits their number and their time, checks where they come from, and passes them on to the server.
//!
//! The server of the protocol's library accepts everything, without a limit, and ends for good if the system has no more file
//! descriptors. Therefore it listens on an address of the loopback interface that pages cannot guess, and is started again if it has
//! ended.
use std::{
    io,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    sync::Arc,
    time::Duration,
};

use rand::Rng;
use rect_dashboard::{
    hosts::{name_of, Hosts},
    permits::Permits,
};
use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt},
    net::{TcpListener, TcpSocket, TcpStream},
    sync::{mpsc, watch},
    time::{sleep, timeout},
};

use super::frames::{Frames, TooLarge};

/// The largest number of viewers.
const MAX_VIEWERS: usize = 16;
/// The largest number of connections that have not sent their request yet.
const MAX_HANDSHAKES: usize = 32;
/// How long a viewer may take for its request.
const REQUEST_WITHIN: Duration = Duration::from_secs(10);
/// The largest request, in bytes, and the largest number of its headers.
const MAX_REQUEST: usize = 8192;
const MAX_HEADERS: usize = 64;
/// How long a viewer may take nothing before the connection is ended.
const STALLED_AFTER: Duration = Duration::from_secs(30);
/// The bytes that the system keeps between the server and this gate. More would only make the messages of a slow viewer older.
const BUFFER: u32 = 64 * 1024;
/// The viewer at this address is a page of this site, which the user opens to see live data.
const FOXGLOVE: &str = "https://app.foxglove.dev";
/// The origin of viewers that are installed on a computer.
const INSTALLED: &str = "file://";

/// Which viewers are accepted.
pub struct Rules {
    hosts: Hosts,
    sites: Vec<String>,
}

/// The listener for viewers.
pub struct Gate {
    listener: TcpListener,
    rules: Arc<Rules>,
}

/// The server behind the gate.
#[derive(Clone)]
pub struct Inside {
    /// Its address.
    pub address: watch::Receiver<SocketAddr>,
    /// Is given the address at which a server does not accept viewers any more.
    pub ended: mpsc::Sender<SocketAddr>,
}

impl Rules {
    /// Accepts viewers that use a name of this computer or one of `names`, and pages of `sites` besides the usual ones.
    pub fn new(names: &[String], sites: Vec<String>) -> Self {
        Self {
            hosts: Hosts::new(names),
            sites,
        }
    }

    /// Checks a request. Returns its length, or `None` if it is not complete.
    ///
    /// # Errors
    /// Fails with the status and the reason of the refusal.
    fn check(&self, request: &[u8]) -> Result<Option<usize>, (&'static str, &'static str)> {
        let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
        let mut parsed = httparse::Request::new(&mut headers);
        let status = parsed.parse(request);
        let status = status.map_err(|_| ("400 Bad Request", "This is not a request of HTTP"))?;
        let httparse::Status::Complete(end) = status else {
            return match request.len() < MAX_REQUEST {
                true => Ok(None),
                false => Err((
                    "431 Request Header Fields Too Large",
                    "The request is too large",
                )),
            };
        };
        let values = |name: &str| -> Vec<_> {
            let headers = parsed.headers.iter();
            let named = headers.filter(|header| header.name.eq_ignore_ascii_case(name));
            named
                .map(|header| std::str::from_utf8(header.value).unwrap_or_default())
                .collect()
        };
        let host = match values("host")[..] {
            [host] if self.hosts.accepts(host) => host,
            _ => {
                return Err((
                    "421 Misdirected Request",
                    "This name is not one of the server: use its address, or start it with --name <host>",
                ))
            }
        };
        match values("origin")[..] {
            // Not a page.
            [] => Ok(Some(end)),
            [origin] if self.accepts_origin(origin, host) => Ok(Some(end)),
            _ => Err((
                "403 Forbidden",
                "Pages of this site may not connect: start the server with --site <origin>",
            )),
        }
    }

    /// Returns whether pages of `origin` may connect: those of the viewers above, and those that this computer or the user's own serves.
    fn accepts_origin(&self, origin: &str, host: &str) -> bool {
        if [FOXGLOVE, INSTALLED].contains(&origin) || self.sites.iter().any(|site| site == origin) {
            return true;
        }
        let scheme = ["http://", "https://"];
        let place = scheme
            .iter()
            .find_map(|scheme| origin.strip_prefix(*scheme));
        place.map(name_of).is_some_and(|name| {
            let is_loopback = name.parse().is_ok_and(|ip: IpAddr| ip.is_loopback());
            name == "localhost" || is_loopback || name.eq_ignore_ascii_case(name_of(host))
        })
    }
}

impl Gate {
    /// Listens for viewers.
    ///
    /// # Errors
    /// Fails if another program uses the address.
    pub async fn bind(address: SocketAddr, rules: Rules) -> io::Result<Self> {
        Ok(Self {
            listener: TcpListener::bind(address).await?,
            rules: Arc::new(rules),
        })
    }

    /// Returns the address for viewers.
    ///
    /// # Errors
    /// Fails if the system does not report it.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Accepts viewers until the future is dropped.
    pub async fn serve(self, inside: Inside) {
        let (handshakes, viewers) = (Permits::new(MAX_HANDSHAKES), Permits::new(MAX_VIEWERS));
        loop {
            let (stream, from) = match self.listener.accept().await {
                Ok(accepted) => accepted,
                Err(error) => {
                    // Such as too many open files.
                    tracing::warn!("cannot accept a viewer: {error}");
                    sleep(Duration::from_millis(100)).await;
                    continue;
                }
            };
            let Some(mut handshake) = handshakes.grant(from.ip(), false) else {
                continue;
            };
            let (rules, inside, viewers) = (self.rules.clone(), inside.clone(), viewers.clone());
            tokio::spawn(async move {
                let mut stream = stream;
                let accepted = tokio::select! {
                    accepted = timeout(REQUEST_WITHIN, accept(&mut stream, &rules)) => accepted,
                    () = handshake.evicted() => return,
                };
                drop(handshake);
                let request = match accepted {
                    Ok(Ok(Some(request))) => request,
                    Ok(Ok(None)) => return,
                    Ok(Err(error)) => return tracing::debug!("the viewer {from}: {error}"),
                    Err(_) => return tracing::debug!("the viewer {from} has sent no request"),
                };
                let Some(mut viewer) = viewers.grant(from.ip(), false) else {
                    return;
                };
                tokio::select! {
                    passed = pass(stream, &request, &inside) => if let Err(error) = passed {
                        tracing::debug!("the connection of the viewer {from} has ended: {error}");
                    },
                    () = viewer.evicted() => tracing::debug!("the viewer {from} has made room for another"),
                }
            });
        }
    }
}

/// The request of a viewer.
struct Request {
    bytes: Vec<u8>,
    /// Its length. Further bytes belong to the WebSocket.
    end: usize,
}

/// Reads the request of a viewer. A request that the rules refuse is answered with the reason; `None` then.
async fn accept(stream: &mut TcpStream, rules: &Rules) -> io::Result<Option<Request>> {
    let mut bytes = Vec::new();
    loop {
        let mut part = (&mut *stream).take((MAX_REQUEST - bytes.len()) as u64);
        if part.read_buf(&mut bytes).await? == 0 {
            return Ok(None);
        }
        match rules.check(&bytes) {
            Ok(Some(end)) => return Ok(Some(Request { bytes, end })),
            Ok(None) => {}
            Err((status, reason)) => {
                let answer = format!(
                    "HTTP/1.1 {status}\r\nContent-Type: text/plain\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{reason}",
                    reason.len()
                );
                stream.write_all(answer.as_bytes()).await?;
                return Ok(None);
            }
        }
    }
}

/// Passes the request of a viewer and all that follows on to the server, and its answers back.
async fn pass(mut stream: TcpStream, request: &Request, inside: &Inside) -> io::Result<()> {
    let mut frames = Frames::default();
    frames
        .on_bytes(&request.bytes[request.end..])
        .map_err(io::Error::other)?;
    let mut server = connect(inside).await?;
    stream.set_nodelay(true)?;
    server.set_nodelay(true)?;
    server.write_all(&request.bytes).await?;
    let (from_viewer, to_viewer) = stream.split();
    let (from_server, to_server) = server.split();
    let unlimited = |_: &[u8]| Ok(());
    tokio::select! {
        ended = copy(from_viewer, to_server, |bytes| frames.on_bytes(bytes)) => ended,
        ended = copy(from_server, to_viewer, unlimited) => ended,
    }
}

async fn connect(inside: &Inside) -> io::Result<TcpStream> {
    let address = *inside.address.borrow();
    let socket = TcpSocket::new_v4()?;
    socket.set_recv_buffer_size(BUFFER)?;
    let connected = socket.connect(address).await;
    if let Err(error) = &connected {
        if error.kind() == io::ErrorKind::ConnectionRefused {
            // If one waits already, it has the same effect.
            let _ = inside.ended.try_send(address);
        }
    }
    connected
}

/// Copies all bytes, each part after `check` has accepted it.
async fn copy(
    mut from: impl AsyncRead + Unpin,
    mut to: impl AsyncWrite + Unpin,
    mut check: impl FnMut(&[u8]) -> Result<(), TooLarge>,
) -> io::Result<()> {
    let mut buffer = vec![0; 16 * 1024];
    loop {
        let size = from.read(&mut buffer).await?;
        if size == 0 {
            return to.shutdown().await;
        }
        check(&buffer[..size]).map_err(io::Error::other)?;
        timeout(STALLED_AFTER, to.write_all(&buffer[..size])).await??;
    }
}

/// Returns an address of the loopback interface for the server.
pub fn hidden_address() -> Ipv4Addr {
    // Only Linux gives the whole network 127.0.0.0/8 to the loopback interface.
    match cfg!(target_os = "linux") {
        true => {
            let [a, b, c] = rand::thread_rng().gen::<[u8; 3]>();
            Ipv4Addr::new(127, a.max(1), b, c.clamp(1, 254))
        }
        false => Ipv4Addr::LOCALHOST,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(request: &str) -> &'static str {
        let rules = Rules::new(
            &["robots.example.org".into()],
            vec!["https://viewer.example.org".into()],
        );
        match rules.check(request.as_bytes()) {
            Ok(Some(_)) => "accepted",
            Ok(None) => "incomplete",
            Err((status, _)) => &status[..3],
        }
    }

    fn status_of(host: &str, origin: &str) -> &'static str {
        status(&format!(
            "GET / HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\n\r\n"
        ))
    }

    #[test]
    fn viewers_are_accepted_under_own_names_without_an_origin() {
        for host in [
            "localhost:8765",
            "192.168.7.2:8765",
            "[::1]:8765",
            "robots.example.org",
        ] {
            assert_eq!(
                status(&format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n")),
                "accepted"
            );
        }
        assert_eq!(
            status("GET / HTTP/1.1\r\nHost: evil.example:8765\r\n\r\n"),
            "421"
        );
        assert_eq!(status("GET / HTTP/1.1\r\n\r\n"), "421");
        assert_eq!(
            status("GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n"),
            "421"
        );
    }

    #[test]
    fn only_pages_of_known_sites_are_accepted() {
        for (host, origin) in [
            ("localhost:8765", "https://app.foxglove.dev"),
            ("localhost:8765", "file://"),
            ("127.0.0.1:8765", "http://localhost:8080"),
            ("192.168.7.2:8765", "http://127.0.0.1:8080"),
            ("192.168.7.2:8765", "http://192.168.7.2"),
            ("robots.example.org:8765", "https://Robots.example.org"),
            ("localhost:8765", "https://viewer.example.org"),
        ] {
            assert_eq!(status_of(host, origin), "accepted", "{origin}");
        }
        for origin in [
            "http://evil.example",
            "https://app.foxglove.dev.evil.example",
            "http://localhost.evil.example",
            "http://192.168.7.3",
            "https://viewer.example.org:444",
            "null",
            "",
        ] {
            assert_eq!(status_of("localhost:8765", origin), "403", "{origin}");
        }
        assert_eq!(
            status_of("evil.example:8765", "http://evil.example:8765"),
            "421"
        );
        let two = "file://\r\nOrigin: http://evil.example";
        assert_eq!(status_of("localhost:8765", two), "403");
    }

    #[test]
    fn requests_are_limited() {
        assert_eq!(status("GET / HTTP/1.1\r\nHost: loc"), "incomplete");
        assert_eq!(status("no request\r\n\r\n"), "400");
        assert_eq!(status(&format!("GET /{} ", "x".repeat(MAX_REQUEST))), "431");
        let headers = "X: 1\r\n".repeat(MAX_HEADERS + 1);
        assert_eq!(status(&format!("GET / HTTP/1.1\r\n{headers}\r\n")), "400");
    }

    #[test]
    fn the_server_has_an_address_of_its_own_on_the_loopback_interface() {
        assert!(hidden_address().is_loopback());
        if cfg!(target_os = "linux") {
            assert_ne!(hidden_address(), Ipv4Addr::LOCALHOST);
        }
    }
}
