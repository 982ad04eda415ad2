//! Owns an adapter on an air that another process serves: the connection to it, and coming back when the air does.
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

use super::{
    adapter::{address_of, check_name},
    air::AirStatus,
    attachment::{Attachment, Carrier},
    message::Command,
    radio::SimRadio,
    socket::socket_path,
    wire::{self, Control, FromAir, ToAir, PROTOCOL},
};
use crate::radio::{AdapterState, Radio, RadioError};

const SERVICE: &str = "the simulated air";

/// How often an air that is not there is looked for.
const RETRY: Duration = Duration::from_millis(200);

/// How long an air may take to answer the first message.
const PATIENCE: Duration = Duration::from_secs(5);

/// The adapters this process has on airs of other processes: one attachment for all radios of one name.
static ATTACHMENTS: LazyLock<Mutex<Attachments>> = LazyLock::new(Mutex::default);

/// By the air's socket and the adapter's name.
type Attachments = HashMap<(PathBuf, String), Weak<Attachment>>;

/// The adapter of that name on the air that `rect air` serves. Must be called within a tokio runtime. It attaches in
/// the background: what is first asked of it waits for that, and says so if no air is running.
pub fn radio(name: &str) -> Result<Arc<dyn Radio>, RadioError> {
    let radio = radio_at(&socket_path(), name)?;
    Ok(radio)
}

/// The same on the air at that socket.
pub fn radio_at(path: &Path, name: &str) -> Result<Arc<SimRadio>, RadioError> {
    check_name(name).map_err(|error| RadioError::NoAdapter {
        adapter: name.to_owned(),
        advice: error.to_string(),
    })?;
    let runtime = Handle::try_current().map_err(|error| RadioError::System {
        action: "using the simulated air outside of a tokio runtime",
        source: Box::new(error),
    })?;
    let mut attachments = ATTACHMENTS.lock();
    attachments.retain(|_, attachment| attachment.strong_count() > 0);
    let key = (path.to_owned(), name.to_owned());
    if let Some(attachment) = attachments.get(&key).and_then(Weak::upgrade) {
        return Ok(Arc::new(SimRadio { attachment }));
    }
    let gone = CancellationToken::new();
    let line = Arc::new(Mutex::new(Line::Down(Absence::NoServer(
        io::ErrorKind::NotConnected.into(),
    ))));
    let carrier = Remote {
        path: path.to_owned(),
        line: Arc::clone(&line),
        _gone: gone.clone().drop_guard(),
    };
    let attachment = Attachment::new(name, address_of(name), Box::new(carrier)).not_yet();
    let attachment = Arc::new(attachment);
    let weak = Arc::downgrade(&attachment);
    attachments.insert(key, Weak::clone(&weak));
    let (path, name) = (path.to_owned(), name.to_owned());
    runtime.spawn(async move {
        tokio::select! {
            () = gone.cancelled() => {}
            () = keep_attached(&path, &name, &line, &weak) => {}
        }
    });
    Ok(Arc::new(SimRadio { attachment }))
}

/// Why a running air did not do what it was told.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// Nobody is there.
    #[error(transparent)]
    NoServer(#[from] RadioError),
    /// It says no.
    #[error("{0}")]
    Refused(String),
}

/// Tells the air at that socket to do something. `Control::Status` brings an account of it.
pub async fn control(path: &Path, control: Control) -> Result<Option<AirStatus>, ControlError> {
    let protocol = PROTOCOL;
    let (_, _, answer) = ask(path, &ToAir::Control { protocol, control })
        .await
        .map_err(|error| no_server(path, &error))?;
    match answer {
        FromAir::Done => Ok(None),
        FromAir::Status(status) => Ok(Some(status)),
        FromAir::Refused(why) => Err(ControlError::Refused(why)),
        FromAir::Attached | FromAir::Event(_) => Err(ControlError::Refused(
            "it answered something else".to_owned(),
        )),
    }
}

/// The way to the air, as the radio's side holds it. Dropping it ends the task that keeps it.
struct Remote {
    path: PathBuf,
    line: Arc<Mutex<Line>>,
    _gone: DropGuard,
}

enum Line {
    Up(mpsc::UnboundedSender<Command>),
    Down(Absence),
}

/// Why there is no line.
enum Absence {
    NoServer(io::Error),
    Refused(String),
}

impl Carrier for Remote {
    fn command(&self, command: Command) {
        if let Line::Up(commands) = &*self.line.lock() {
            let _ = commands.send(command);
        }
    }

    fn absence(&self, adapter: &str) -> RadioError {
        match &*self.line.lock() {
            Line::Down(Absence::NoServer(error)) => no_server(&self.path, error),
            Line::Down(Absence::Refused(why)) => RadioError::NoAdapter {
                adapter: adapter.to_owned(),
                advice: why.clone(),
            },
            Line::Up(_) => RadioError::NoAdapter {
                adapter: adapter.to_owned(),
                advice: format!("it was removed; `rect air power {adapter} on` brings it back"),
            },
        }
    }
}

async fn keep_attached(path: &Path, name: &str, line: &Mutex<Line>, attachment: &Weak<Attachment>) {
    loop {
        let absence = match attach(path, name).await {
            Ok((from, to)) => {
                let (sender, commands) = mpsc::unbounded_channel();
                *line.lock() = Line::Up(sender);
                let Some(here) = attachment.upgrade() else {
                    return;
                };
                here.on_state(AdapterState::On);
                here.ready();
                drop(here);
                tokio::select! {
                    absence = take_events(from, attachment) => absence,
                    absence = pass_commands(commands, to) => absence,
                }
            }
            Err(absence) => absence,
        };
        *line.lock() = Line::Down(absence);
        let Some(here) = attachment.upgrade() else {
            return;
        };
        here.on_state(AdapterState::Missing);
        here.ready();
        drop(here);
        sleep(RETRY).await;
    }
}

async fn attach(path: &Path, name: &str) -> Result<(OwnedReadHalf, OwnedWriteHalf), Absence> {
    let attach = ToAir::Attach {
        protocol: PROTOCOL,
        adapter: name.to_owned(),
    };
    match ask(path, &attach).await.map_err(Absence::NoServer)? {
        (from, to, FromAir::Attached) => Ok((from, to)),
        (_, _, FromAir::Refused(why)) => Err(Absence::Refused(why)),
        (_, _, FromAir::Event(_) | FromAir::Done | FromAir::Status(_)) => {
            Err(Absence::NoServer(io::ErrorKind::InvalidData.into()))
        }
    }
}

async fn ask(path: &Path, message: &ToAir) -> io::Result<(OwnedReadHalf, OwnedWriteHalf, FromAir)> {
    let asked = async {
        let (mut from, mut to) = UnixStream::connect(path).await?.into_split();
        wire::write(&mut to, message)
            .await
            .map_err(io::Error::other)?;
        let answer = wire::read(&mut from).await.map_err(io::Error::other)?;
        let answer = answer.ok_or(io::ErrorKind::UnexpectedEof)?;
        Ok((from, to, answer))
    };
    match timeout(PATIENCE, asked).await {
        Ok(answered) => answered,
        Err(_) => Err(io::ErrorKind::TimedOut.into()),
    }
}

async fn take_events(mut from: OwnedReadHalf, attachment: &Weak<Attachment>) -> Absence {
    loop {
        match wire::read(&mut from).await {
            Ok(Some(FromAir::Event(event))) => match attachment.upgrade() {
                Some(attachment) => attachment.on_event(event),
                None => return Absence::NoServer(io::ErrorKind::NotConnected.into()),
            },
            Ok(Some(FromAir::Refused(why))) => return Absence::Refused(why),
            Ok(Some(_)) => return Absence::NoServer(io::ErrorKind::InvalidData.into()),
            Ok(None) => return Absence::NoServer(io::ErrorKind::ConnectionReset.into()),
            Err(error) => return Absence::NoServer(io::Error::other(error)),
        }
    }
}

async fn pass_commands(
    mut commands: mpsc::UnboundedReceiver<Command>,
    mut to: OwnedWriteHalf,
) -> Absence {
    while let Some(command) = commands.recv().await {
        if let Err(error) = wire::write(&mut to, &ToAir::Command(command)).await {
            return Absence::NoServer(io::Error::other(error));
        }
    }
    Absence::NoServer(io::ErrorKind::NotConnected.into())
}

fn no_server(path: &Path, error: &io::Error) -> RadioError {
    let path = path.display();
    let advice = match error.kind() {
        io::ErrorKind::PermissionDenied => {
            format!("{path} is another user's: run as that user, or set RECT_AIR")
        }
        io::ErrorKind::InvalidData | io::ErrorKind::Other => {
            format!(
                "what listens at {path} is no air of this version ({error}): restart `rect air`"
            )
        }
        _ => format!("nobody listens at {path}: start it with `rect air --condition room`"),
    };
    RadioError::NoService {
        service: SERVICE,
        advice,
    }
}
