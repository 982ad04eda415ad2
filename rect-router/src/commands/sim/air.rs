//! Serves the simulated air of `rect sim` to the routers and to `rect air`.
use std::path::{Path, PathBuf};

use tokio::runtime::{Builder, Runtime};
use zenoh_link_ble_air::{AirOptions, AirServer, Condition};

use super::Failure;

/// A simulated air that is served until it is dropped.
pub struct Air {
    /// Runs the server. Dropping it stops the server, which removes the socket file.
    _runtime: Runtime,
    socket: PathBuf,
}

impl Air {
    /// Serves an air at the default socket, or at a socket in `folder` if another air uses the default one.
    ///
    /// # Errors
    /// Fails if neither socket can be opened.
    pub fn start(condition: Condition, folder: &Path) -> Result<Self, Failure> {
        let runtime = Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()?;
        let (default, own) = (zenoh_link_ble_air::socket_path(), folder.join("air.sock"));
        let options = || AirOptions {
            condition,
            ..AirOptions::default()
        };
        let server = {
            let _in_runtime = runtime.enter();
            AirServer::bind(&default, options()).or_else(|_| AirServer::bind(&own, options()))?
        };
        let socket = server.path().to_owned();
        runtime.spawn(server.serve());
        Ok(Self {
            _runtime: runtime,
            socket,
        })
    }

    /// Returns the path of its socket.
    pub fn socket(&self) -> &Path {
        &self.socket
    }

    /// Returns the path of its socket if that is not the default, so that programs need `RECT_AIR` to find it.
    pub fn non_default_socket(&self) -> Option<&Path> {
        (self.socket != zenoh_link_ble_air::socket_path()).then_some(&self.socket)
    }
}
