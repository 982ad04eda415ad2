//! Connects to a router: the attempts, the login, and the check of which robot the router serves.
use std::{
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use pyo3::prelude::*;
use rect_core::session::{
    endpoint,
    login::{self, Login},
    router::{self, JoinError},
};

use crate::{
    errors::{raised, OrRaise, Raised},
    key_space::KeySpace,
};

/// The attempts to connect to one router.
#[pyclass(frozen, module = "rect._rect")]
pub struct JoinAttempts {
    endpoint: String,
    core: Mutex<router::JoinAttempts>,
}

#[pymethods]
impl JoinAttempts {
    /// Creates the state of the attempts. `login` is the user and password that the program passes. If it is `None`,
    /// the login is read from the first line of `text`, the content of the login file `file`. If `text` is `None`, the
    /// file cannot be read, for the reason `unreadable`.
    #[new]
    #[pyo3(signature = (endpoint, timeout_s, login, file, text, unreadable))]
    fn new(
        endpoint: String,
        timeout_s: f64,
        login: Option<(String, String)>,
        file: String,
        text: Option<&str>,
        unreadable: String,
    ) -> PyResult<Self> {
        let login = match login {
            Some((user, password)) => Login::given(user, password),
            None => Login::of_file(file, text.ok_or(unreadable)),
        };
        let timeout = Duration::try_from_secs_f64(timeout_s).unwrap_or(Duration::MAX);
        let core = Mutex::new(router::JoinAttempts::new(endpoint.clone(), login, timeout));
        Ok(Self { endpoint, core })
    }

    /// Returns the user and password for the next attempt. `None` if it is made without a login.
    fn credentials(&self) -> Option<(String, String)> {
        let core = self.core();
        let (user, password) = core.credentials()?;
        Some((user.to_owned(), password.to_owned()))
    }

    /// Returns the time limit of the next attempt, in seconds. `elapsed_s` is the time since the first attempt began.
    fn limit(&self, elapsed_s: f64) -> f64 {
        self.core().limit(duration(elapsed_s)).as_secs_f64()
    }

    /// Handles a failed attempt and returns the pause before the next one, in seconds. `reason` is the text of Zenoh's
    /// error, or `None` if the attempt exceeded its time limit. Raises `NoRouter` and `LoginRefused`.
    fn on_failure(&self, py: Python<'_>, elapsed_s: f64, reason: Option<&str>) -> PyResult<f64> {
        let pause = self.core().on_failure(duration(elapsed_s), reason);
        pause
            .map(|pause| pause.as_secs_f64())
            .map_err(|error| match error {
                JoinError::NoRouter { reason } => {
                    raised(py, "NoRouter", (self.endpoint.clone(), reason))
                }
                JoinError::Login(refused) => {
                    let text = refused.to_string();
                    raised(py, "LoginRefused", (text, self.endpoint.clone()))
                }
            })
    }
}

impl JoinAttempts {
    fn core(&self) -> MutexGuard<'_, router::JoinAttempts> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Raised for router::WrongRobot {
    fn raised(self) -> PyErr {
        let serves = self.serves.robot.to_string();
        Python::attach(|py| raised(py, "WrongRobot", (self.to_string(), serves)))
    }
}

/// Returns the login file of programs that name none. `given` is the value of the environment variable `RECT_LOGIN`.
#[pyfunction]
#[pyo3(signature = (given))]
pub fn default_login_file(given: Option<String>) -> String {
    login::default_file(given)
}

/// Returns what to do if no router answers at an endpoint. `router` is the command that runs a router on this computer.
#[pyfunction]
pub fn router_advice(endpoint: &str, reason: &str, router: &str) -> String {
    endpoint::advice(endpoint, reason, router)
}

/// Returns the key expression of the liveliness tokens that name the robot of the router with this Zenoh id.
#[pyfunction]
pub fn robot_of_router(id: &str) -> String {
    router::robot_of_router(id)
}

/// Raises `WrongRobot` if there are tokens, and none of them names the robot of the key space, and `NoRouter` if the router has closed
/// the session.
#[pyfunction]
pub fn check_router(
    py: Python<'_>,
    key_space: &KeySpace,
    endpoint: &str,
    tokens: Vec<String>,
    is_closed: bool,
) -> PyResult<()> {
    if tokens.is_empty() && is_closed {
        return Err(raised(py, "NoRouter", (endpoint, router::CLOSED)));
    }
    key_space.0.check_router(endpoint, tokens).or_raise()
}

fn duration(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or_default()
}
