//! Serves the page over HTTP, with or without TLS.
use std::{
    fs,
    net::{IpAddr, SocketAddr},
    path::Path,
    pin::pin,
    sync::Arc,
    time::{Duration, Instant},
};

use axum::{
    extract::{Extension, Form, Path as UrlPath, Request, State, WebSocketUpgrade},
    http::{header, HeaderMap, Method, StatusCode},
    middleware::{from_fn_with_state, Next},
    response::{Html, IntoResponse, Redirect, Response},
    routing::{get, post},
    Router,
};
use hyper::server::conn::http1;
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use rust_embed::Embed;
use rustls::{
    pki_types::{pem::PemObject, CertificateDer, PrivateKeyDer},
    ServerConfig,
};
use serde::Deserialize;
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::{TcpListener, TcpStream},
    time::{sleep, timeout},
};
use tokio_rustls::TlsAcceptor;

use crate::{
    guard::Guard,
    login::{Access, Logins, Refused, COOKIE, LASTS},
    permits::Permits,
    protocol::MAX_COMMAND,
    socket, App, LoginFor,
};

/// The largest number of connections, apart from WebSockets.
const MAX_CONNECTIONS: usize = 64;
/// How long a client may take for a handshake, and for the header of a request.
const HEADER_WITHIN: Duration = Duration::from_secs(10);
/// How long a connection accepts requests, unless it becomes a WebSocket.
const ACCEPTS_FOR: Duration = Duration::from_secs(20);
/// How long the last request of a connection may take afterwards, with its body and the answer.
const FINISHED_WITHIN: Duration = Duration::from_secs(10);
/// The largest form, in bytes.
const MAX_FORM: usize = 4096;
/// The place of a message in the login page.
const MESSAGE: &str = "<!-- message -->";

/// The files of the page.
#[derive(Embed)]
#[folder = "page"]
struct Files;

/// The address of a client.
#[derive(Clone, Copy)]
struct Client(IpAddr);

/// The protection of the page.
pub struct Protection {
    /// Rejects requests of other sites.
    pub guard: Guard,
    /// The logins; `None` if there is none.
    pub logins: Option<Logins>,
    /// The use of the page that requires a login, if there are logins.
    pub login_for: LoginFor,
    /// The encryption, if there is one.
    pub tls: Option<TlsAcceptor>,
}

struct Served {
    app: Arc<App>,
    protection: Protection,
}

type Shared = State<Arc<Served>>;

/// Serves the page until the process ends.
pub async fn serve(listener: TcpListener, app: Arc<App>, protection: Protection) {
    let tls = protection.tls.clone();
    let served = Arc::new(Served { app, protection });
    let router = Router::new()
        .route("/", get(page))
        .route("/assets/{file}", get(asset))
        .route("/socket", get(open_socket))
        .route("/login", get(login_form).post(log_in))
        .route("/logout", post(log_out))
        .layer(axum::extract::DefaultBodyLimit::max(MAX_FORM))
        .layer(from_fn_with_state(served.clone(), protect))
        .with_state(served.clone());
    let permits = Permits::new(MAX_CONNECTIONS);
    loop {
        let (stream, client) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                // Such as too many open files.
                tracing::warn!("cannot accept a browser: {error}");
                sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        let logins = served.protection.logins.as_ref();
        let is_known = logins.is_some_and(|logins| logins.is_known(client.ip(), Instant::now()));
        let Some(mut permit) = permits.grant(client.ip(), is_known) else {
            continue;
        };
        let router = router.clone().layer(Extension(Client(client.ip())));
        let tls = tls.clone();
        tokio::spawn(async move {
            tokio::select! {
                () = talk(stream, client, tls, router) => {}
                () = permit.evicted() => tracing::debug!("{client} has made room for another connection"),
            }
        });
    }
}

async fn talk(stream: TcpStream, client: SocketAddr, tls: Option<TlsAcceptor>, router: Router) {
    match tls {
        None => answer_requests(stream, router).await,
        Some(tls) => match timeout(HEADER_WITHIN, tls.accept(stream)).await {
            Ok(Ok(stream)) => answer_requests(stream, router).await,
            Ok(Err(error)) => tracing::debug!("no TLS with {client}: {error}"),
            Err(_) => tracing::debug!("no TLS with {client} in time"),
        },
    }
}

/// Answers the requests of a connection, until it becomes a WebSocket or its time has passed.
async fn answer_requests(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    router: Router,
) {
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER_WITHIN)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router))
        .with_upgrades();
    let mut served = pin!(served);
    let mut done = timeout(ACCEPTS_FOR, served.as_mut()).await;
    if done.is_err() {
        served.as_mut().graceful_shutdown();
        done = timeout(FINISHED_WITHIN, served).await;
    }
    match done {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::debug!("a browser's connection has ended: {error}"),
        Err(_) => tracing::debug!("a browser's connection has ended: it took too long"),
    }
}

/// Reads a certificate and its key.
///
/// # Errors
/// Fails if one of them cannot be read, or they do not fit.
pub fn tls(certificate: &Path, key: &Path) -> Result<TlsAcceptor, String> {
    let named = |file: &Path, problem: String| format!("{}: {problem}", file.display());
    let text = fs::read(certificate).map_err(|error| named(certificate, error.to_string()))?;
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&text).collect();
    let chain = chain.map_err(|error| named(certificate, error.to_string()))?;
    let key_text = fs::read(key).map_err(|error| named(key, error.to_string()))?;
    let private = PrivateKeyDer::from_pem_slice(&key_text);
    let private = private.map_err(|error| named(key, error.to_string()))?;
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .and_then(|config| {
            config
                .with_no_client_auth()
                .with_single_cert(chain, private)
        });
    let config = config.map_err(|error| named(certificate, error.to_string()))?;
    Ok(TlsAcceptor::from(Arc::new(config)))
}

/// Rejects requests of other sites, and adds the headers that restrict the page.
async fn protect(State(served): Shared, request: Request, next: Next) -> Response {
    let guard = &served.protection.guard;
    let headers = request.headers();
    let changes = request.method() != Method::GET || request.uri().path() == "/socket";
    let mut response = if !guard.accepts_host(headers) {
        let text = "This name is not one of the dashboard: open it by its address, or start it with --name <host>";
        (StatusCode::MISDIRECTED_REQUEST, text).into_response()
    } else if changes && !guard.accepts_origin(headers) {
        (
            StatusCode::FORBIDDEN,
            "Only the dashboard's own page may do this",
        )
            .into_response()
    } else {
        next.run(request).await
    };
    response.headers_mut().extend(guard.headers());
    response
}

impl Served {
    /// Returns who has logged in at a browser, if somebody has. `None`: there are no logins.
    fn login(&self, headers: &HeaderMap) -> Option<Option<String>> {
        let logins = self.protection.logins.as_ref()?;
        let user = |token| logins.user(token, Instant::now());
        Some(token(headers).and_then(user))
    }

    fn access(&self, headers: &HeaderMap) -> Access {
        match (self.login(headers), self.protection.login_for) {
            (Some(None), LoginFor::Everything) => Access::None,
            (Some(None), LoginFor::Changes) => Access::Look,
            (None | Some(Some(_)), _) if self.app.read_only => Access::Look,
            (None | Some(Some(_)), _) => Access::Change,
        }
    }
}

/// Returns the token of the browser's session.
fn token(headers: &HeaderMap) -> Option<&str> {
    let cookies = headers.get_all(header::COOKIE).into_iter();
    let mut cookies = cookies
        .filter_map(|cookie| cookie.to_str().ok())
        .flat_map(|text| text.split(';'));
    cookies.find_map(|cookie| cookie.trim().strip_prefix(COOKIE)?.strip_prefix('='))
}

async fn page(State(served): Shared, headers: HeaderMap) -> Response {
    match served.access(&headers) {
        Access::None => login_page(StatusCode::OK, ""),
        Access::Look | Access::Change => file("index.html", &headers),
    }
}

async fn login_form() -> Response {
    login_page(StatusCode::OK, "")
}

fn login_page(status: StatusCode, message: &str) -> Response {
    let page = Files::get("login.html")
        .map(|file| file.data)
        .unwrap_or_default();
    let page = String::from_utf8_lossy(&page).replace(MESSAGE, message);
    (status, [(header::CACHE_CONTROL, "no-store")], Html(page)).into_response()
}

async fn asset(UrlPath(name): UrlPath<String>, headers: HeaderMap) -> Response {
    file(&name, &headers)
}

/// Returns a file of the page, unless the browser has it already.
fn file(name: &str, headers: &HeaderMap) -> Response {
    let Some(file) = Files::get(name) else {
        return StatusCode::NOT_FOUND.into_response();
    };
    let hash = file.metadata.sha256_hash();
    let hash: String = hash
        .iter()
        .take(8)
        .map(|byte| format!("{byte:02x}"))
        .collect();
    let tag = format!("\"{hash}\"");
    let known = headers.get(header::IF_NONE_MATCH);
    if known.is_some_and(|known| known.as_bytes() == tag.as_bytes()) {
        return StatusCode::NOT_MODIFIED.into_response();
    }
    let kind = match name.rsplit_once('.') {
        Some((_, "html")) => "text/html; charset=utf-8",
        Some((_, "css")) => "text/css; charset=utf-8",
        Some((_, "js")) => "text/javascript; charset=utf-8",
        Some((_, "svg")) => "image/svg+xml",
        _ => "text/plain; charset=utf-8",
    };
    let headers = [
        (header::CONTENT_TYPE, kind.to_owned()),
        (header::ETAG, tag),
        // Asks each time, which takes a few bytes, so that a new version is seen at once.
        (header::CACHE_CONTROL, "no-cache".to_owned()),
    ];
    (headers, file.data.into_owned()).into_response()
}

#[derive(Deserialize)]
struct LoginForm {
    user: String,
    password: String,
}

async fn log_in(
    State(served): Shared,
    Extension(Client(from)): Extension<Client>,
    Form(form): Form<LoginForm>,
) -> Response {
    let Some(logins) = &served.protection.logins else {
        return Redirect::to("/").into_response();
    };
    match logins.log_in(from, &form.user, &form.password, Instant::now()) {
        Ok(token) => with_cookie(&served, &token, LASTS),
        Err(Refused::Wrong) => login_page(
            StatusCode::UNAUTHORIZED,
            "The user or the password is wrong. They are in the team's login file, a line user:password.",
        ),
        Err(Refused::TooMany) => login_page(
            StatusCode::TOO_MANY_REQUESTS,
            "There were too many wrong logins. Wait a minute, and try again.",
        ),
    }
}

async fn log_out(State(served): Shared, headers: HeaderMap) -> Response {
    if let (Some(logins), Some(token)) = (&served.protection.logins, token(&headers)) {
        logins.log_out(token);
    }
    with_cookie(&served, "", Duration::ZERO)
}

fn with_cookie(served: &Served, token: &str, lasts: Duration) -> Response {
    let secure = if served.protection.tls.is_some() {
        "; Secure"
    } else {
        ""
    };
    let lasts = lasts.as_secs();
    let cookie =
        format!("{COOKIE}={token}; Path=/; Max-Age={lasts}; HttpOnly; SameSite=Strict{secure}");
    ([(header::SET_COOKIE, cookie)], Redirect::to("/")).into_response()
}

async fn open_socket(
    State(served): Shared,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if served.access(&headers) == Access::None {
        return StatusCode::UNAUTHORIZED.into_response();
    }
    upgrade
        .max_message_size(MAX_COMMAND)
        .max_frame_size(MAX_COMMAND)
        .on_upgrade(async move |stream| {
            let login = served.login(&headers);
            let access = || served.access(&headers);
            socket::run(stream, &served.app, login, &access).await;
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vendored_files_are_unchanged() {
        let list = Files::get("VENDORED.txt").expect("the list").data;
        let list = String::from_utf8_lossy(&list);
        for name in ["uPlot.iife.min.js", "uPlot.min.css"] {
            let file = Files::get(name).expect(name);
            let hash = file.metadata.sha256_hash();
            let hash: String = hash.iter().map(|byte| format!("{byte:02x}")).collect();
            let listed = list.lines().find(|line| line.contains(name));
            assert!(
                listed.is_some_and(|line| line.ends_with(&hash)),
                "{name}: {hash}"
            );
        }
    }
}
