//! RECT as a plugin of a stock zenohd: `libzenoh_plugin_rect.so`, configured under `plugins/rect`.
//!
//! A stock zenohd has no `ble` link, and its own connections can't be changed while it runs. So the plugin opens a router
//! of its own in the same process, with the Bluetooth listeners and the named connections, and connects it to the host's
//! listener (`second.rs`); everything else is `rect-router`'s code.

mod second;

use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc, OnceLock,
    },
    thread,
};

use rect::core::wording;
use rect_router::{config::Settings, threads};
use zenoh::{
    internal::{
        plugins::{Response, RunningPlugin, RunningPluginTrait, ZenohPlugin},
        runtime::DynamicRuntime,
    },
    key_expr::KeyExpr,
    Result as ZResult,
};
use zenoh_plugin_trait::{
    declare_plugin, plugin_long_version, plugin_version, Plugin, PluginControl,
};

use self::second::Second;

/// What zenohd loads.
pub struct RectPlugin;

declare_plugin!(RectPlugin);

impl ZenohPlugin for RectPlugin {}

impl Plugin for RectPlugin {
    type StartArgs = DynamicRuntime;
    type Instance = RunningPlugin;

    const DEFAULT_NAME: &'static str = "rect";
    const PLUGIN_VERSION: &'static str = plugin_version!();
    const PLUGIN_LONG_VERSION: &'static str = plugin_long_version!();

    fn start(name: &str, host: &DynamicRuntime) -> ZResult<RunningPlugin> {
        // This library has a copy of Zenoh of its own, with threads of its own and no log yet.
        threads::set();
        zenoh::try_init_log_from_env();
        let given = host.get_config().get_plugin_config(name)?;
        let settings = Settings::parse(given)?;
        let running = Running::default();
        let (state, host) = (Arc::clone(&running.0), host.clone());
        // The host listens only when all plugins have started.
        thread::Builder::new()
            .name("rect".to_owned())
            .spawn(move || {
                match Second::open(settings, &host, &state.is_stopped) {
                    Ok(Some(second)) => {
                        tracing::info!("rect: its router is up, with id {}", second.id());
                        // Stopped meanwhile: dropped here, or by whoever dropped the rest.
                        let _ = state.second.set(second);
                    }
                    Ok(None) => {}
                    Err(error) => {
                        let why = wording::with_causes(error.as_ref());
                        tracing::error!("rect: can't start: {why}");
                        let _ = state.trouble.set(why);
                    }
                }
            })?;
        Ok(Box::new(running))
    }
}

#[derive(Default)]
struct State {
    second: OnceLock<Second>,
    trouble: OnceLock<String>,
    is_stopped: AtomicBool,
}

/// Dropping it ends the plugin's router.
#[derive(Default)]
struct Running(Arc<State>);

impl Drop for Running {
    fn drop(&mut self) {
        self.0.is_stopped.store(true, Ordering::Relaxed);
    }
}

impl PluginControl for Running {}

impl RunningPluginTrait for Running {
    fn adminspace_getter<'a>(
        &'a self,
        asked: &'a KeyExpr<'a>,
        status_key: &str,
    ) -> ZResult<Vec<Response>> {
        let key = KeyExpr::try_from(format!("{status_key}/router"))?;
        if !asked.intersects(&key) {
            return Ok(Vec::new());
        }
        let status = serde_json::json!({
            "id": self.0.second.get().map(|second| second.id().to_string()),
            "trouble": self.0.trouble.get(),
        });
        Ok(vec![Response::new(key.to_string(), status)])
    }
}
