//! Attaches an adapter to an air that another process serves, and attaches it again after that air was restarted.
use std::{
    collections::HashMap,
    io,
    path::{Path, PathBuf},
    sync::{Arc, LazyLock, Weak},
    time::Duration,
};

use parking_lot::Mutex;
use tokio::{
    net::{
        unix::{OwnedReadHalf, OwnedWriteHalf},
        UnixStream,
    },
    runtime::Handle,
    sync::mpsc,
    time::{sleep, timeout},
};
use tokio_util::sync::{CancellationToken, DropGuard};
use zenoh_link_ble_radio::{interval::ConnectionInterval, AdapterState, Radio, RadioError};

use super::{
    adapter::{address_of, check_name},
    air::AirStatus,
    attachment::{AirConnection, Attachment},
    message::Command,
    radio::SimRadio,
    socket::socket_path,
    wire::{self, Control, FromAir, ToAir, PROTOCOL},
};

const SERVICE: &str = "the simulated air";

/// Time between attempts to reach an air that is not running.
const RETRY_INTERVAL: Duration = Duration::from_millis(200);

/// Maximum time that an air may take to respond to the first message.
const REPLY_TIMEOUT: Duration = Duration::from_secs(5);

/// Adapters that this process has attached to airs of other processes. All radios of one name share one attachment.
static ATTACHMENTS: LazyLock<Mutex<Attachments>> = LazyLock::new(Mutex::default);

/// Attachments by the path of the air's socket and the name of the adapter.
type Attachments = HashMap<(PathBuf, String), Weak<Attachment>>;

/// Returns the adapter of that name on the air that `rect air` serves. Must be called within a tokio runtime.
///
/// The adapter attaches in the background. The first operation waits for that, and fails if no air is running.
///
/// # Errors
/// Fails if the name is invalid or if there is no tokio runtime.
pub fn radio(name: &str) -> Result<Arc<dyn Radio>, RadioError> {
    let radio = radio_at(&socket_path(), name)?;
    Ok(radio)
}

/// Returns the adapter of that name on the air at the socket `path`, as [`radio`] does for the default socket.
pub fn radio_at(path: &Path, name: &str) -> Result<Arc<SimRadio>, RadioError> {
    check_name(name).map_err(|error| RadioError::NoAdapter {
        adapter: name.to_owned(),
        advice: error.to_string(),
    })?;
    let runtime = Handle::try_current().map_err(|error| RadioError::System {
        action: "use the simulated air outside a tokio runtime",
        source: Box::new(error),
    })?;
    let mut attachments = ATTACHMENTS.lock();
    attachments.retain(|_, attachment| attachment.strong_count() > 0);
    let key = (path.to_owned(), name.to_owned());
    if let Some(attachment) = attachments.get(&key).and_then(Weak::upgrade) {
        return Ok(Arc::new(SimRadio { attachment }));
    }
    let cancelled = CancellationToken::new();
    let connection = Arc::new(Mutex::new(ServerConnection::Down(DownReason::NoServer(
        io::ErrorKind::NotConnected.into(),
    ))));
    let air = RemoteAir {
        path: path.to_owned(),
        connection: Arc::clone(&connection),
        _cancel_on_drop: cancelled.clone().drop_guard(),
    };
    let attachment = Attachment::new(name, address_of(name), Box::new(air)).attaching();
    let attachment = Arc::new(attachment);
    let weak = Arc::downgrade(&attachment);
    attachments.insert(key, Weak::clone(&weak));
    let (path, name) = (path.to_owned(), name.to_owned());
    runtime.spawn(async move {
        tokio::select! {
            () = cancelled.cancelled() => {}
            () = keep_attached(&path, &name, &connection, &weak) => {}
        }
    });
    Ok(Arc::new(SimRadio { attachment }))
}

/// Reasons why a control command failed.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// No air is running at the socket.
    #[error(transparent)]
    NoServer(#[from] RadioError),
    /// The air refused the command.
    #[error("{0}")]
    Refused(String),
}

/// Sends a control command to the air at the socket `path`. `Control::Status` returns the status of the air.
///
/// # Errors
/// Fails if no air is running at the socket or if it refuses the command.
pub async fn control(path: &Path, control: Control) -> Result<Option<AirStatus>, ControlError> {
    let protocol = PROTOCOL;
    let (_, _, answer) = request(path, &ToAir::Control { protocol, control })
        .await
        .map_err(|error| no_server(path, &error))?;
    match answer {
        FromAir::Done => Ok(None),
        FromAir::Status(status) => Ok(Some(status)),
        FromAir::Refused(why) => Err(ControlError::Refused(why)),
        FromAir::Attached { .. } | FromAir::Event(_) => Err(ControlError::Refused(
            "the simulated air sent an unexpected reply".to_owned(),
        )),
    }
}

/// Connection to the air, as used by the radio. Dropping it ends the task that maintains the connection.
struct RemoteAir {
    path: PathBuf,
    connection: Arc<Mutex<ServerConnection>>,
    _cancel_on_drop: DropGuard,
}

enum ServerConnection {
    Up(mpsc::UnboundedSender<Command>),
    Down(DownReason),
}

/// Reasons why there is no connection.
enum DownReason {
    NoServer(io::Error),
    Refused(String),
}

impl AirConnection for RemoteAir {
    fn command(&self, command: Command) {
        if let ServerConnection::Up(commands) = &*self.connection.lock() {
            let _ = commands.send(command);
        }
    }

    fn missing_error(&self, adapter: &str) -> RadioError {
        match &*self.connection.lock() {
            ServerConnection::Down(DownReason::NoServer(error)) => no_server(&self.path, error),
            ServerConnection::Down(DownReason::Refused(why)) => RadioError::NoAdapter {
                adapter: adapter.to_owned(),
                advice: why.clone(),
            },
            ServerConnection::Up(_) => RadioError::NoAdapter {
                adapter: adapter.to_owned(),
                advice: format!(
                    "it was removed; run `rect air power {adapter} on` to add it again"
                ),
            },
        }
    }
}

async fn keep_attached(
    path: &Path,
    name: &str,
    connection: &Mutex<ServerConnection>,
    attachment: &Weak<Attachment>,
) {
    loop {
        let reason = match attach(path, name).await {
            Ok(((interval, can_change), from, to)) => {
                let (sender, commands) = mpsc::unbounded_channel();
                *connection.lock() = ServerConnection::Up(sender);
                let Some(strong) = attachment.upgrade() else {
                    return;
                };
                strong.set_intervals(interval, can_change);
                strong.on_adapter_state(AdapterState::On);
                strong.set_ready();
                drop(strong);
                tokio::select! {
                    reason = receive_events(from, attachment) => reason,
                    reason = forward_commands(commands, to) => reason,
                }
            }
            Err(reason) => reason,
        };
        *connection.lock() = ServerConnection::Down(reason);
        let Some(strong) = attachment.upgrade() else {
            return;
        };
        strong.on_adapter_state(AdapterState::Missing);
        strong.set_ready();
        drop(strong);
        sleep(RETRY_INTERVAL).await;
    }
}

async fn attach(
    path: &Path,
    name: &str,
) -> Result<((ConnectionInterval, bool), OwnedReadHalf, OwnedWriteHalf), DownReason> {
    let attach = ToAir::Attach {
        protocol: PROTOCOL,
        adapter: name.to_owned(),
    };
    match request(path, &attach).await.map_err(DownReason::NoServer)? {
        (
            from,
            to,
            FromAir::Attached {
                interval_units,
                changes_open_connections,
            },
        ) => match ConnectionInterval::from_units(interval_units) {
            Some(interval) => Ok(((interval, changes_open_connections), from, to)),
            None => Err(DownReason::NoServer(io::ErrorKind::InvalidData.into())),
        },
        (_, _, FromAir::Refused(why)) => Err(DownReason::Refused(why)),
        (_, _, FromAir::Event(_) | FromAir::Done | FromAir::Status(_)) => {
            Err(DownReason::NoServer(io::ErrorKind::InvalidData.into()))
        }
    }
}

async fn request(
    path: &Path,
    message: &ToAir,
) -> io::Result<(OwnedReadHalf, OwnedWriteHalf, FromAir)> {
    let exchange = async {
        let (mut from, mut to) = UnixStream::connect(path).await?.into_split();
        wire::write(&mut to, message)
            .await
            .map_err(io::Error::other)?;
        let answer = wire::read(&mut from).await.map_err(io::Error::other)?;
        let answer = answer.ok_or(io::ErrorKind::UnexpectedEof)?;
        Ok((from, to, answer))
    };
    match timeout(REPLY_TIMEOUT, exchange).await {
        Ok(result) => result,
        Err(_) => Err(io::ErrorKind::TimedOut.into()),
    }
}

async fn receive_events(mut from: OwnedReadHalf, attachment: &Weak<Attachment>) -> DownReason {
    loop {
        match wire::read(&mut from).await {
            Ok(Some(FromAir::Event(event))) => match attachment.upgrade() {
                Some(attachment) => attachment.on_event(event),
                None => return DownReason::NoServer(io::ErrorKind::NotConnected.into()),
            },
            Ok(Some(FromAir::Refused(why))) => return DownReason::Refused(why),
            Ok(Some(_)) => return DownReason::NoServer(io::ErrorKind::InvalidData.into()),
            Ok(None) => return DownReason::NoServer(io::ErrorKind::ConnectionReset.into()),
            Err(error) => return DownReason::NoServer(io::Error::other(error)),
        }
    }
}

async fn forward_commands(
    mut commands: mpsc::UnboundedReceiver<Command>,
    mut to: OwnedWriteHalf,
) -> DownReason {
    while let Some(command) = commands.recv().await {
        if let Err(error) = wire::write(&mut to, &ToAir::Command(command)).await {
            return DownReason::NoServer(io::Error::other(error));
        }
    }
    DownReason::NoServer(io::ErrorKind::NotConnected.into())
}

fn no_server(path: &Path, error: &io::Error) -> RadioError {
    let path = path.display();
    let advice = match error.kind() {
        io::ErrorKind::PermissionDenied => {
            format!("{path} belongs to another user: run as that user, or set RECT_AIR")
        }
        io::ErrorKind::InvalidData | io::ErrorKind::Other => {
            format!(
                "the program at {path} is not a simulated air of this version ({error}): restart `rect air`"
            )
        }
        _ => {
            format!("no program listens at {path}: start the air with `rect air --condition room`")
        }
    };
    RadioError::NoService {
        service: SERVICE,
        advice,
    }
}
