//! Implements `rect wifi`: serves a simulated Wi-Fi, or controls a running one.
use std::{io, path::Path, time::Duration};

use tokio::{
    runtime::{Builder, Runtime},
    signal::unix::{signal, SignalKind},
};
use zenoh_link_any::wifi::{self, Wifi, WifiOptions, WifiState};

use super::Failure;
use crate::args::WifiArgs;

/// Runs the command.
///
/// # Errors
/// Fails if the socket cannot be opened, or if there is no simulated Wi-Fi to control.
pub fn run(args: &WifiArgs) -> Result<(), Failure> {
    let air = args
        .socket
        .clone()
        .unwrap_or_else(zenoh_link_ble_air::socket_path);
    let socket = wifi::socket_beside(&air);
    let runtime = Builder::new_current_thread().enable_all().build()?;
    match WifiState::parse(&args.action) {
        Some(state) => runtime
            .block_on(wifi::control(&socket, state))
            .map_err(|error| not_reached(&socket, &error).into()),
        None => runtime.block_on(serve(&socket, options(args))),
    }
}

fn options(args: &WifiArgs) -> WifiOptions {
    WifiOptions {
        bytes_per_s: f64::from(args.rate) * 1000.0,
        latency: Duration::from_millis(args.latency),
        losses: args.losses,
    }
}

async fn serve(socket: &Path, options: WifiOptions) -> Result<(), Failure> {
    // Signals are handled before the socket exists, so that no signal can leave it behind.
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let mut hang_up = signal(SignalKind::hangup())?;
    let wifi = Wifi::bind(socket, options)?;
    // The Wi-Fi is served even if the standard output is closed.
    let _ = rect_terminal::try_write(format_args!(
        "simulated Wi-Fi at {}: listen on any/sim-1#name=...;secret=..., or see `rect wifi --help`",
        socket.display()
    ));
    tokio::select! {
        () = wifi.serve() => {}
        _ = interrupt.recv() => {}
        _ = terminate.recv() => {}
        _ = hang_up.recv() => {}
    }
    Ok(())
}

fn not_reached(socket: &Path, error: &io::Error) -> String {
    format!(
        "no simulated Wi-Fi answers at {}: {error}; start one with `rect sim --wifi` or `rect wifi serve`",
        socket.display()
    )
}

/// A simulated Wi-Fi that is served until it is dropped.
pub struct Serving {
    /// Runs the Wi-Fi. Dropping it ends the Wi-Fi, which removes its socket.
    _runtime: Runtime,
}

impl Serving {
    /// Serves a Wi-Fi with the default options beside the simulated air at `air`.
    ///
    /// # Errors
    /// Fails if its socket cannot be opened.
    pub fn start(air: &Path) -> Result<Self, Failure> {
        let runtime = Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()?;
        let wifi = {
            let _in_runtime = runtime.enter();
            Wifi::bind(&wifi::socket_beside(air), WifiOptions::default())?
        };
        runtime.spawn(async move { wifi.serve().await });
        Ok(Self { _runtime: runtime })
    }
}
