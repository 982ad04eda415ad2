//! Decides with which settings of Zenoh a program opens its sessions.
use serde_json::{json, Value};

use crate::message::urgency::Urgency;

/// Settings with which Zenoh reports why it cannot connect. A Zenoh client reports only that it could not.
pub const DIAGNOSIS: [(&str, &str); 5] = [
    ("mode", "\"peer\""),
    ("connect/exit_on_failure", "true"),
    ("listen/endpoints", "[]"),
    ("scouting/gossip/enabled", "false"),
    ("open/return_conditions/connect_scouted", "false"),
];

/// The links of a program: to its router, or direct ones.
#[derive(Clone, Debug)]
pub struct SessionLinks<'a> {
    /// Endpoint of the router, which is used without direct links.
    pub router: &'a str,
    /// Endpoints to which the program opens direct links.
    pub endpoints: &'a [String],
    /// Endpoints at which the program accepts direct links.
    pub listen: &'a [String],
}

/// A setting of Zenoh.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// Path of the setting, such as `mode`.
    pub key: String,
    /// The value.
    pub value: Value,
    /// The option of the program that determines the value, for the error if Zenoh rejects it.
    pub option: &'static str,
    /// The value of that option.
    pub given: String,
}

/// An option has a value that is not possible.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the option {option} cannot be {given:?}: {reason}")]
pub struct SettingError {
    /// Name of the option.
    pub option: &'static str,
    /// The value.
    pub given: String,
    /// Why it is not possible, and what to do instead.
    pub reason: String,
}

impl SessionLinks<'_> {
    /// Returns whether the program has direct links, and therefore no router.
    pub fn is_direct(&self) -> bool {
        !self.endpoints.is_empty() || !self.listen.is_empty()
    }

    /// Returns all settings: RECT's, the `login` (user and password), and those that the program adds (`zenoh`), which
    /// override the others.
    pub fn settings(&self, login: Option<(&str, &str)>, zenoh: &[(String, Value)]) -> Vec<Setting> {
        let mut settings = vec![
            // Links are configured explicitly: multicast scouting would connect all robots in a network with each other.
            ("scouting/multicast/enabled", json!(false)),
            // Messages wait for room on a slow link instead of closing it (docs/reference/configuration.md).
            (
                "transport/link/tx/queue/congestion_control/block/wait_before_close",
                json!(60_000_000),
            ),
        ];
        if self.is_direct() {
            settings.extend([
                ("mode", json!("peer")),
                ("connect/endpoints", json!(self.endpoints)),
                ("connect/timeout_ms", json!(-1)),
                ("connect/exit_on_failure", json!(false)),
                ("connect/retry", retry(200)),
                ("listen/endpoints", json!(self.listen)),
                ("listen/exit_on_failure", json!(true)),
                ("scouting/gossip/enabled", json!(false)),
            ]);
        } else {
            settings.extend([
                ("mode", json!("client")),
                ("connect/endpoints", json!([self.router])),
                // One attempt; `JoinAttempts` decides about further ones. The backoff applies to reconnecting.
                ("connect/timeout_ms", json!(0)),
                ("connect/retry", retry(100)),
            ]);
        }
        if let Some((user, password)) = login {
            let login = json!({ "user": user, "password": password });
            settings.push(("transport/auth/usrpwd", login));
        }
        let own = settings
            .into_iter()
            .map(|(key, value)| self.own(key, value));
        let added = zenoh.iter().map(|(key, value)| Setting {
            key: key.clone(),
            value: value.clone(),
            option: "zenoh",
            given: format!("{key}: {value}"),
        });
        own.chain(added).collect()
    }

    /// Returns a setting of RECT with the option that determines it.
    fn own(&self, key: &str, value: Value) -> Setting {
        let (option, given) = match key {
            "connect/endpoints" if !self.is_direct() => ("router", self.router.to_owned()),
            "connect/endpoints" => ("endpoint", self.endpoints.join(" ")),
            "listen/endpoints" => ("listen", self.listen.join(" ")),
            // The password must not appear in an error.
            "transport/auth/usrpwd" => ("login", "…".to_owned()),
            _ => ("zenoh", format!("{key}: {value}")),
        };
        Setting {
            key: key.to_owned(),
            value,
            option,
            given,
        }
    }

    /// Returns the locators of the direct links, for the error if Zenoh cannot open them.
    pub fn locators(&self) -> String {
        let all = self.listen.iter().chain(self.endpoints);
        all.cloned().collect::<Vec<_>>().join(" ")
    }

    /// Checks the endpoints of a program whose Zenoh has no Bluetooth link, such as a Python program.
    ///
    /// # Errors
    /// Returns a [`SettingError`] that says how to use Bluetooth through a router.
    pub fn check_without_bluetooth(&self) -> Result<(), SettingError> {
        let is_direct = self.is_direct();
        let router = (!is_direct).then_some(("router", self.router));
        let of = |option| move |endpoint: &String| (option, endpoint.clone());
        let all = self.endpoints.iter().map(of("endpoints"));
        let all = all.chain(self.listen.iter().map(of("listen")));
        let all = all.chain(router.map(|(option, endpoint)| (option, endpoint.to_owned())));
        let mut bluetooth = all.filter(|(_, endpoint)| {
            ["any/", "ble/"]
                .iter()
                .any(|prefix| endpoint.starts_with(prefix))
        });
        match bluetooth.next() {
            None => Ok(()),
            Some((option, given)) => Err(SettingError {
                option,
                reason: without_bluetooth(option, &given),
                given,
            }),
        }
    }
}

fn without_bluetooth(option: &str, endpoint: &str) -> String {
    let flag = if option == "listen" { "-l" } else { "-e" };
    format!(
        "this program has no Bluetooth link of its own; the router has. Run `rect-router {flag} '{endpoint}' -l \
         tcp/127.0.0.1:7447` on this computer (with the Python package: `python -m rect router ...`) and connect \
         without `{option}`"
    )
}

fn retry(first_ms: u32) -> Value {
    json!({ "period_init_ms": first_ms, "period_max_ms": 1000, "period_increase_factor": 2 })
}

/// Which session carries the messages of an urgency. See [`Urgency::uses_separate_session`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SessionChoice {
    /// The session for normal messages.
    Normal,
    /// The separate session, which is open.
    Separate,
    /// The separate session, which is to be opened now.
    Open,
}

/// The state of a program's sessions when one is chosen.
#[derive(Clone, Copy, Debug)]
pub struct SessionsState {
    /// Whether the program has a router.
    pub has_router: bool,
    /// Whether the separate session of the urgency is open.
    pub is_open: bool,
    /// Whether the normal session is linked with the router now. Without a link, opening a session would block the caller.
    pub is_linked: bool,
}

impl SessionsState {
    /// Returns the session for messages of an urgency.
    pub fn choose(self, urgency: Urgency) -> SessionChoice {
        match self {
            _ if !urgency.uses_separate_session() => SessionChoice::Normal,
            Self {
                has_router: false, ..
            } => SessionChoice::Normal,
            Self { is_open: true, .. } => SessionChoice::Separate,
            Self {
                is_linked: true, ..
            } => SessionChoice::Open,
            _ => SessionChoice::Normal,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn links<'a>(
        router: &'a str,
        endpoints: &'a [String],
        listen: &'a [String],
    ) -> SessionLinks<'a> {
        SessionLinks {
            router,
            endpoints,
            listen,
        }
    }

    #[test]
    fn settings_name_the_option_that_determines_them() {
        let (endpoint, listen) = (["tcp/a:1".to_owned()], ["tcp/b:2".to_owned()]);
        let option = |settings: &[Setting], key: &str| {
            let setting = settings.iter().find(|setting| setting.key == key);
            setting.map(|setting| (setting.option, setting.given.clone()))
        };
        let joined = links("tcp/r:3", &[], &[]).settings(None, &[]);
        let expected = Some(("router", "tcp/r:3".to_owned()));
        assert_eq!(option(&joined, "connect/endpoints"), expected);
        let direct = links("tcp/r:3", &endpoint, &listen).settings(Some(("fleet", "secret")), &[]);
        let expected = Some(("endpoint", "tcp/a:1".to_owned()));
        assert_eq!(option(&direct, "connect/endpoints"), expected);
        let expected = Some(("listen", "tcp/b:2".to_owned()));
        assert_eq!(option(&direct, "listen/endpoints"), expected);
        let login = option(&direct, "transport/auth/usrpwd").expect("a login");
        assert!(!login.1.contains("secret"), "{login:?}");
    }

    #[test]
    fn added_settings_come_last() {
        let added = [("mode".to_owned(), json!("peer"))];
        let settings = links("tcp/r:3", &[], &[]).settings(None, &added);
        let last = settings.last().expect("a setting");
        assert_eq!(
            (last.option, last.given.as_str()),
            ("zenoh", "mode: \"peer\"")
        );
    }

    #[test]
    fn a_bluetooth_endpoint_without_a_link_is_answered_with_advice() {
        let (tcp, ble) = (["tcp/a:1".to_owned()], ["ble/wombat-2".to_owned()]);
        assert_eq!(
            links("tcp/r:3", &tcp, &[]).check_without_bluetooth(),
            Ok(())
        );
        for (links, option, flag) in [
            (links("tcp/r:3", &ble, &[]), "endpoints", "-e"),
            (links("tcp/r:3", &tcp, &ble), "listen", "-l"),
            (links("ble/wombat-2", &[], &[]), "router", "-e"),
        ] {
            let error = links.check_without_bluetooth().expect_err("no Bluetooth");
            assert_eq!(
                (error.option, error.given.as_str()),
                (option, "ble/wombat-2")
            );
            let command = format!("rect-router {flag} 'ble/wombat-2'");
            assert!(error.reason.contains(&command), "{error}");
        }
    }

    #[test]
    fn separate_sessions_are_opened_while_the_router_is_linked() {
        let state = |has_router, is_open, is_linked| SessionsState {
            has_router,
            is_open,
            is_linked,
        };
        for (urgency, state, choice) in [
            (
                Urgency::Normal,
                state(true, true, true),
                SessionChoice::Normal,
            ),
            (
                Urgency::Urgent,
                state(false, false, true),
                SessionChoice::Normal,
            ),
            (
                Urgency::Urgent,
                state(true, true, false),
                SessionChoice::Separate,
            ),
            (Urgency::Bulk, state(true, false, true), SessionChoice::Open),
            (
                Urgency::Bulk,
                state(true, false, false),
                SessionChoice::Normal,
            ),
        ] {
            assert_eq!(state.choose(urgency), choice, "{urgency:?} {state:?}");
        }
    }
}
