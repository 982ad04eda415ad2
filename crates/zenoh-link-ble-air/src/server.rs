//! Serves one air to several processes: [`AirServer`] accepts their connections, each of which controls one adapter. A
//! client that violates the protocol is disconnected and its adapter detached; other clients are not affected.
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
    local::{AirHandle, Attached, SimAir},
    message::{Event, Violation},
    options::{AirOptions, AirOptionsError},
    socket::{SocketError, SocketFile},
    wire::{self, Control, FromAir, ToAir, WireError, PROTOCOL},
};

/// Maximum time for a client to send its first message, and to read a message.
const CLIENT_TIMEOUT: Duration = Duration::from_secs(10);

/// Pause before the next accept when the system has no more file descriptors.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Reasons why an air cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The options are outside the range of Bluetooth.
    #[error(transparent)]
    Options(#[from] AirOptionsError),
    /// The socket cannot be created.
    #[error(transparent)]
    Socket(#[from] SocketError),
    /// The server cannot accept connections.
    #[error("cannot accept connections")]
    Listen(#[from] io::Error),
}

/// A simulated air for all processes of this user.
pub struct AirServer {
    air: SimAir,
    listener: UnixListener,
    file: SocketFile,
}

/// Reasons why a client was disconnected.
#[derive(Debug, thiserror::Error)]
enum ClientError {
    #[error(transparent)]
    Wire(#[from] WireError),
    #[error("the client uses version {0} of the protocol instead of {PROTOCOL}")]
    Protocol(u16),
    #[error(transparent)]
    Attach(#[from] AttachError),
    #[error(transparent)]
    Violation(#[from] Violation),
    #[error("the client did not send a first message")]
    NoFirstMessage,
    #[error("a message that is not allowed at this point")]
    OutOfPlace,
    #[error("the client does not read its messages")]
    NotReading,
}

impl AirServer {
    /// Creates an air at the socket `path`. Must be called within a tokio runtime.
    ///
    /// # Errors
    /// Fails if the options are invalid or if the socket cannot be created.
    pub fn bind(path: &Path, options: AirOptions) -> Result<Self, ServeError> {
        options.check()?;
        let (file, listener) = SocketFile::bind(path)?;
        Ok(Self {
            air: SimAir::new(options),
            listener: UnixListener::from_std(listener)?,
            file,
        })
    }

    /// Returns the path of the socket.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Returns the air.
    pub fn air(&self) -> &SimAir {
        &self.air
    }

    /// Serves clients until the future is dropped, which disconnects all clients and removes the socket.
    pub async fn serve(self) {
        let mut clients = JoinSet::new();
        loop {
            tokio::select! {
                accepted = self.listener.accept() => match accepted {
                    Ok((stream, _)) => {
                        clients.spawn(serve_client(self.air.clone(), stream));
                    }
                    Err(error) => {
                        tracing::warn!("cannot accept a client of the simulated air: {error}");
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
    match serve_first_message(&air, &mut from, &mut to).await {
        Ok(()) => {}
        Err(ClientError::Wire(WireError::Io(error))) => {
            tracing::debug!("a client of the simulated air disconnected: {error}");
        }
        Err(error) => {
            tracing::warn!("disconnected a client of the simulated air: {error}");
            // The client may have exited or hang; then it does not receive the reason.
            let refused = FromAir::Refused(error.to_string());
            let _ = timeout(CLIENT_TIMEOUT, wire::write(&mut to, &refused)).await;
        }
    }
}

async fn serve_first_message(
    air: &SimAir,
    from: &mut OwnedReadHalf,
    to: &mut OwnedWriteHalf,
) -> Result<(), ClientError> {
    let first = timeout(CLIENT_TIMEOUT, wire::read(from))
        .await
        .map_err(|_| ClientError::NoFirstMessage)??;
    match first {
        None => Ok(()),
        Some(ToAir::Attach { protocol, .. } | ToAir::Control { protocol, .. })
            if protocol != PROTOCOL =>
        {
            Err(ClientError::Protocol(protocol))
        }
        Some(ToAir::Attach { adapter, .. }) => {
            let attached = air.attach(&adapter)?;
            let answer = FromAir::Attached {
                interval_units: air.default_interval().units(),
                changes_open_connections: air.changes_open_connections(),
            };
            send_message(to, &answer).await?;
            serve_adapter(attached, from, to).await
        }
        Some(ToAir::Control { control, .. }) => {
            let answer = apply_control(air, control);
            send_message(to, &answer).await
        }
        Some(ToAir::Command(_)) => Err(ClientError::OutOfPlace),
    }
}

async fn serve_adapter(
    attached: Attached,
    from: &mut OwnedReadHalf,
    to: &mut OwnedWriteHalf,
) -> Result<(), ClientError> {
    let Attached { events, handle } = attached;
    // The first one to end ends both. Dropping `handle` detaches the adapter.
    tokio::select! {
        ended = receive_commands(from, &handle) => ended,
        ended = forward_events(events, to) => ended,
    }
}

async fn receive_commands(from: &mut OwnedReadHalf, handle: &AirHandle) -> Result<(), ClientError> {
    while let Some(message) = wire::read(from).await? {
        match message {
            ToAir::Command(command) => handle.try_command(command)?,
            ToAir::Attach { .. } | ToAir::Control { .. } => return Err(ClientError::OutOfPlace),
        }
    }
    Ok(())
}

async fn forward_events(
    mut events: mpsc::UnboundedReceiver<Event>,
    to: &mut OwnedWriteHalf,
) -> Result<(), ClientError> {
    while let Some(event) = events.recv().await {
        send_message(to, &FromAir::Event(event)).await?;
    }
    Ok(())
}

/// Sends a message to a client. A client that does not read in time is disconnected, so that the data queued for it is
/// bounded.
async fn send_message(to: &mut OwnedWriteHalf, message: &FromAir) -> Result<(), ClientError> {
    timeout(CLIENT_TIMEOUT, wire::write(to, message))
        .await
        .map_err(|_| ClientError::NotReading)??;
    Ok(())
}

fn apply_control(air: &SimAir, control: Control) -> FromAir {
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
