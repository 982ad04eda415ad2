//! Owns how many sessions and handshakes a router accepts, and from whom: room for robots over Bluetooth is kept free, and
//! neither one login nor one address can take all the rest.
//!
//! `zenoh_link::admission` applies what concerns links before Zenoh has them, `logins` what concerns a user, whom Zenoh
//! knows only once its session is open. `config/README.md` documents the numbers.

mod logins;

use std::time::Duration;

use serde::Deserialize;
use zenoh::Config;
use zenoh_link::admission;

pub use self::logins::LoginLimit;
use crate::config::{uses_bluetooth, ConfigError};

/// A local program or a computer on the same network completes its handshake in milliseconds. Zenoh's own limit
/// (`accept_timeout`, 10 s) is what a busy Bluetooth link needs.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(3);

/// `plugins: { rect: { sessions: { ... } } }`; what is left out is a share of `transport/unicast/max_sessions`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SessionSettings {
    /// Sessions that only links over Bluetooth may take; default a quarter of all.
    pub bluetooth: Option<usize>,
    /// Sessions of one login, over other links than Bluetooth; default half of those that are left.
    pub per_user: Option<usize>,
    /// Sessions from one IP address, and from this computer's programs together, over other links than Bluetooth; default
    /// three quarters of those that are left.
    pub per_address: Option<usize>,
}

/// The numbers for one router.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SessionLimits {
    links: admission::Limits,
    per_user: usize,
}

impl SessionLimits {
    /// Derives the numbers from Zenoh's own settings and RECT's.
    pub fn of(config: &Config, settings: &SessionSettings) -> Result<Self, ConfigError> {
        let unicast = &config.transport.unicast;
        let (most, handshakes) = (*unicast.max_sessions(), *unicast.accept_pending());
        let has_bluetooth = uses_bluetooth(config);
        let share = |of: usize, quarters: usize| (of * quarters).div_ceil(4);
        let bluetooth = match has_bluetooth {
            true => settings.bluetooth.unwrap_or(most / 4),
            false => 0,
        };
        let others = most.saturating_sub(bluetooth);
        let per_user = settings.per_user.unwrap_or(share(others, 2));
        let per_address = settings.per_address.unwrap_or(share(others, 3));
        for (key, given, most) in [
            ("bluetooth", bluetooth, most.saturating_sub(1)),
            ("per_user", per_user, others),
            ("per_address", per_address, others),
        ] {
            if given > most {
                return Err(ConfigError::Settings {
                    reason: format!(
                        "sessions/{key} is {given}, but only {most} are left of transport/unicast/max_sessions"
                    ),
                });
            }
        }
        let accept_timeout = Duration::from_millis(*unicast.accept_timeout());
        Ok(Self {
            links: admission::Limits {
                handshakes: handshakes - if has_bluetooth { handshakes / 4 } else { 0 },
                sessions: others,
                sessions_per_source: per_address,
                handshake_timeout: HANDSHAKE_TIMEOUT.min(accept_timeout),
            },
            per_user,
        })
    }

    /// Applies the limits of links, and leaves room in Zenoh's own for handshakes that are ending.
    pub fn apply(&self, config: &mut Config) -> Result<(), ConfigError> {
        let given = *config.transport.unicast.accept_pending();
        let of_zenoh = given.saturating_add(self.links.handshakes);
        let set = config.transport.unicast.set_accept_pending(of_zenoh);
        set.map_err(|_| ConfigError::Refused {
            key: "transport/unicast/accept_pending",
            value: of_zenoh.to_string(),
        })?;
        admission::set_limits(self.links);
        Ok(())
    }

    /// Returns what limits the sessions of one login.
    pub fn logins(&self) -> LoginLimit {
        LoginLimit::new(self.per_user)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits(text: &str, settings: &SessionSettings) -> Result<SessionLimits, ConfigError> {
        SessionLimits::of(&Config::from_json5(text).expect("valid"), settings)
    }

    const ROBOT: &str = r#"{ mode: "router", listen: { endpoints: ["tcp/127.0.0.1:0", "ble/sim-a#name=a"] },
        transport: { unicast: { max_sessions: 128, accept_pending: 64 } } }"#;

    #[test]
    fn a_quarter_is_kept_for_bluetooth_and_nobody_takes_all_the_rest() {
        let limits = limits(ROBOT, &SessionSettings::default()).expect("valid");
        let links = admission::Limits {
            handshakes: 48,
            sessions: 96,
            sessions_per_source: 72,
            handshake_timeout: Duration::from_secs(3),
        };
        let expected = SessionLimits {
            links,
            per_user: 48,
        };
        assert_eq!(limits, expected);
    }

    #[test]
    fn without_bluetooth_nothing_is_kept() {
        let text = ROBOT.replace(r#", "ble/sim-a#name=a""#, "");
        let limits = limits(&text, &SessionSettings::default()).expect("valid");
        assert_eq!((limits.links.sessions, limits.links.handshakes), (128, 64));
    }

    #[test]
    fn more_than_there_are_is_an_error_that_names_the_key() {
        for (key, settings) in [
            (
                "sessions/bluetooth",
                SessionSettings {
                    bluetooth: Some(128),
                    ..SessionSettings::default()
                },
            ),
            (
                "sessions/per_user",
                SessionSettings {
                    per_user: Some(97),
                    ..SessionSettings::default()
                },
            ),
            (
                "sessions/per_address",
                SessionSettings {
                    per_address: Some(97),
                    ..SessionSettings::default()
                },
            ),
        ] {
            let error = limits(ROBOT, &settings).expect_err(key).to_string();
            assert!(error.contains(key), "{error}");
        }
    }

    #[test]
    fn a_single_session_is_possible() {
        let text = r#"{ mode: "router", listen: { endpoints: ["tcp/127.0.0.1:0"] }, transport: { unicast: { max_sessions: 1 } } }"#;
        let limits = limits(text, &SessionSettings::default()).expect("valid");
        assert_eq!(limits.links.sessions, 1);
        assert_eq!((limits.links.sessions_per_source, limits.per_user), (1, 1));
    }
}
