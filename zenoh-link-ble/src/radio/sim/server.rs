//! Owns the air that many processes share: [`AirServer`] takes their connections and lets each speak for its adapter.
//! A client that says something wrong loses its connection, and its adapter leaves the air; the others go on.
use std::{io, path::Path, time::Duration};

use tokio::{
    net::{
        unix::{OwnedReadHalf, OwnedWriteHalf},
        UnixListener, UnixStream,
    },
    sync::mpsc,
    task::JoinSet,
    time::{sleep, timeout},
};

use super::{
    air::AttachError,
    local::{Attached, Place, SimAir},
    message::{Event, Violation},
    options::{AirOptions, AirOptionsError},
    socket::{SocketError, SocketFile},
    wire::{self, Control, FromAir, ToAir, WireError, PROTOCOL},
};

/// How long a client may take to say what it is, and to take what it is told.
const PATIENCE: Duration = Duration::from_secs(10);

/// How long to wait when the system has no more file descriptors.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Why an air cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The options are none a link could have.
    #[error(transparent)]
    Options(#[from] AirOptionsError),
    /// There is no socket for it.
    #[error(transparent)]
    Socket(#[from] SocketError),
    /// Nobody can be taken in.
    #[error("cannot take connections")]
    Listen(#[from] io::Error),
}

/// A simulated air for all processes of this user.
pub struct AirServer {
    air: SimAir,
    listener: UnixListener,
    file: SocketFile,
}

/// Why a client was let go.
#[derive(Debug, thiserror::Error)]
enum ClientError {
    #[error(transparent)]
    Wire(#[from] WireError),
    #[error("it speaks version {0} of the protocol, not {PROTOCOL}")]
    Protocol(u16),
    #[error(transparent)]
    Attach(#[from] AttachError),
    #[error(transparent)]
    Violation(#[from] Violation),
    #[error("it did not say what it is")]
    NoIntroduction,
    #[error("a message out of place")]
    OutOfPlace,
    #[error("it does not read")]
    NotReading,
}

impl AirServer {
    /// An air at that socket. Must be called within a tokio runtime.
    pub fn bind(path: &Path, options: AirOptions) -> Result<Self, ServeError> {
        options.check()?;
        let (file, listener) = SocketFile::bind(path)?;
        Ok(Self {
            air: SimAir::new(options),
            listener: UnixListener::from_std(listener)?,
            file,
        })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// The air itself.
    pub fn air(&self) -> &SimAir {
        &self.air
    }

    /// Serves until it is dropped, which ends every client's connection and removes the socket.
    pub async fn serve(self) {
        let mut clients = JoinSet::new();
        loop {
            tokio::select! {
                accepted = self.listener.accept() => match accepted {
                    Ok((stream, _)) => {
                        clients.spawn(serve_client(self.air.clone(), stream));
                    }
                    Err(error) => {
                        tracing::warn!("cannot take a client of the simulated air: {error}");
                        sleep(ACCEPT_PAUSE).await;
                    }
                },
                Some(_) = clients.join_next() => {}
            }
        }
    }
}

async fn serve_client(air: SimAir, stream: UnixStream) {
    let (mut from, mut to) = stream.into_split();
    match introduce(&air, &mut from, &mut to).await {
        Ok(()) => {}
        Err(ClientError::Wire(WireError::Io(error))) => {
            tracing::debug!("a client of the simulated air is gone: {error}");
        }
        Err(error) => {
            tracing::warn!("a client of the simulated air was let go: {error}");
            // It may be gone or wedged: then it does not learn why.
            let refused = FromAir::Refused(error.to_string());
            let _ = timeout(PATIENCE, wire::write(&mut to, &refused)).await;
        }
    }
}

async fn introduce(
    air: &SimAir,
    from: &mut OwnedReadHalf,
    to: &mut OwnedWriteHalf,
) -> Result<(), ClientError> {
    let first = timeout(PATIENCE, wire::read(from))
        .await
        .map_err(|_| ClientError::NoIntroduction)??;
    match first {
        None => Ok(()),
        Some(ToAir::Attach { protocol, .. } | ToAir::Control { protocol, .. })
            if protocol != PROTOCOL =>
        {
            Err(ClientError::Protocol(protocol))
        }
        Some(ToAir::Attach { adapter, .. }) => serve_adapter(air.attach(&adapter)?, from, to).await,
        Some(ToAir::Control { control, .. }) => {
            let answer = obey(air, control);
            tell(to, &answer).await
        }
        Some(ToAir::Command(_)) => Err(ClientError::OutOfPlace),
    }
}

async fn serve_adapter(
    attached: Attached,
    from: &mut OwnedReadHalf,
    to: &mut OwnedWriteHalf,
) -> Result<(), ClientError> {
    let Attached { events, place } = attached;
    tell(to, &FromAir::Attached).await?;
    // Whichever ends first ends both; `place` goes out of scope and takes the adapter off the air.
    tokio::select! {
        ended = take_commands(from, &place) => ended,
        ended = pass_events(events, to) => ended,
    }
}

async fn take_commands(from: &mut OwnedReadHalf, place: &Place) -> Result<(), ClientError> {
    while let Some(message) = wire::read(from).await? {
        match message {
            ToAir::Command(command) => place.try_command(command)?,
            ToAir::Attach { .. } | ToAir::Control { .. } => return Err(ClientError::OutOfPlace),
        }
    }
    Ok(())
}

async fn pass_events(
    mut events: mpsc::UnboundedReceiver<Event>,
    to: &mut OwnedWriteHalf,
) -> Result<(), ClientError> {
    while let Some(event) = events.recv().await {
        tell(to, &FromAir::Event(event)).await?;
    }
    Ok(())
}

/// A client that takes nothing for long is let go, so that what waits for it stays bounded.
async fn tell(to: &mut OwnedWriteHalf, message: &FromAir) -> Result<(), ClientError> {
    timeout(PATIENCE, wire::write(to, message))
        .await
        .map_err(|_| ClientError::NotReading)??;
    Ok(())
}

fn obey(air: &SimAir, control: Control) -> FromAir {
    match control {
        Control::Cut => air.cut(),
        Control::Restore => air.restore(),
        Control::Condition(condition) => air.set_condition(condition),
        Control::Power { adapter, on } => {
            if let Err(error) = air.power(&adapter, on) {
                return FromAir::Refused(error.to_string());
            }
        }
        Control::Status => return FromAir::Status(air.status()),
    }
    FromAir::Done
}
