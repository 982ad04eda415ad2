//! Exposes the settings of Zenoh with which a program opens its sessions.
use pyo3::prelude::*;
use rect_core::session::{
    endpoint,
    settings::{SessionLinks, SettingError},
};
use serde_json::Value;

use crate::errors::{raised, OrRaise, Raised};

/// A setting: its path, its value in JSON, and the option with its value that determine it.
type SettingFields = (String, String, &'static str, String);

/// Returns all settings of Zenoh, in order. `added` are the settings that the program adds, as a JSON object. Raises
/// `OptionError` for a `ble/` locator: eclipse-zenoh has no Bluetooth link.
#[pyfunction]
pub fn session_settings(
    py: Python<'_>,
    router: &str,
    endpoints: Vec<String>,
    listen: Vec<String>,
    login: Option<(String, String)>,
    added: &str,
) -> PyResult<Vec<SettingFields>> {
    let links = SessionLinks {
        router,
        endpoints: &endpoints,
        listen: &listen,
    };
    links.check_without_bluetooth().or_raise()?;
    let added: serde_json::Map<String, Value> = serde_json::from_str(added)
        .map_err(|error| raised(py, "OptionError", ("zenoh", added, error.to_string())))?;
    let added: Vec<_> = added.into_iter().collect();
    let login = login
        .as_ref()
        .map(|(user, password)| (&**user, &**password));
    let settings = links.settings(login, &added).into_iter();
    let fields = settings.map(|one| (one.key, one.value.to_string(), one.option, one.given));
    Ok(fields.collect())
}

/// Returns the router's locator for programs that name none. `given` is the value of the environment variable
/// `RECT_ENDPOINT`.
#[pyfunction]
pub fn default_router(given: Option<String>) -> String {
    endpoint::default_router(given)
}

impl Raised for SettingError {
    fn raised(self) -> PyErr {
        Python::attach(|py| raised(py, "OptionError", (self.option, self.given, self.reason)))
    }
}
