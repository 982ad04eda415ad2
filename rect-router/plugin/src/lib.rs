//! RECT as a plugin of a stock zenohd: `libzenoh_plugin_rect.so`, configured under `plugins/rect`.
//!
//! A stock zenohd has no `ble` link, and its connections cannot be changed while it runs. The plugin therefore opens a second
//! router in the same process, with the Bluetooth listeners and the named connections, and connects it to the host's
//! listener (`embedded_router.rs`). Everything else is code of `rect-router`.

mod embedded_router;

use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc, OnceLock,
    },
    thread,
};

use rect_core::text::humanize;
use rect_router::{config::Settings, links, threads};
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

use self::embedded_router::EmbeddedRouter;

/// The plugin, as zenohd loads it.
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
        // This library contains its own copy of Zenoh, with its own threads and links, and without a log.
        threads::set();
        links::register();
        zenoh::try_init_log_from_env();
        let given = host.get_config().get_plugin_config(name)?;
        let settings = Settings::parse(given)?;
        let running = Running::default();
        let (state, host) = (Arc::clone(&running.0), host.clone());
        // The host listens only after all plugins have started, so the router is opened on another thread.
        thread::Builder::new()
            .name("rect".to_owned())
            .spawn(move || {
                match EmbeddedRouter::open(settings, &host, &state.is_stopped) {
                    Ok(Some(router)) => {
                        tracing::info!("rect: the plugin's router is up, with id {}", router.id());
                        // If the plugin was stopped in the meantime, this thread drops the last reference.
                        let _ = state.router.set(router);
                    }
                    Ok(None) => {}
                    Err(error) => {
                        let why = humanize::with_causes(error.as_ref());
                        tracing::error!("rect: cannot start: {why}");
                        let _ = state.trouble.set(why);
                    }
                }
            })?;
        Ok(Box::new(running))
    }
}

/// The state shared with the thread that opens the router.
#[derive(Default)]
struct State {
    /// The plugin's router, once it is open.
    router: OnceLock<EmbeddedRouter>,
    /// The reason why the router could not be opened.
    trouble: OnceLock<String>,
    is_stopped: AtomicBool,
}

/// The running plugin. Dropping it stops the plugin's router.
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
            "id": self.0.router.get().map(|router| router.id().to_string()),
            "trouble": self.0.trouble.get(),
        });
        Ok(vec![Response::new(key.to_string(), status)])
    }
}
