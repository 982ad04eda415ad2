//! Owns the simulated air of `rect sim`, served to the routers and to `rect air`.
use std::path::{Path, PathBuf};

use tokio::runtime::{Builder, Runtime};
use zenoh_link::ble::radio::sim::{self, AirOptions, AirServer, Condition};

use super::Failure;

/// An air that is served until it is dropped.
pub struct Air {
    /// Ends what runs in it when it is dropped, and with that the socket's file.
    _runtime: Runtime,
    socket: PathBuf,
}

impl Air {
    /// Serves an air at the usual place, or in `folder` if another air is there.
    pub fn start(condition: Condition, folder: &Path) -> Result<Self, Failure> {
        let runtime = Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()?;
        let (usual, own) = (sim::socket_path(), folder.join("air.sock"));
        let options = || AirOptions {
            condition,
            ..AirOptions::default()
        };
        let server = {
            let _in_runtime = runtime.enter();
            AirServer::bind(&usual, options()).or_else(|_| AirServer::bind(&own, options()))?
        };
        let socket = server.path().to_owned();
        runtime.spawn(server.serve());
        Ok(Self {
            _runtime: runtime,
            socket,
        })
    }

    /// Where it is served.
    pub fn socket(&self) -> &Path {
        &self.socket
    }

    /// The same, if programs do not find it by themselves.
    pub fn other_socket(&self) -> Option<&Path> {
        (self.socket != sim::socket_path()).then_some(&self.socket)
    }
}
