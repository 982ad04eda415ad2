//! Limits the sessions and handshakes that a router accepts: a share is reserved for robots over Bluetooth, and neither one
//! login nor one address can use the whole remainder.
//!
//! `zenoh_link_table::admission` enforces the limits of links before Zenoh receives them. `logins` enforces the limit of a user,
//! which Zenoh knows only once the session is open. `docs/reference/configuration.md` documents the numbers.

mod logins;

use std::time::Duration;

use zenoh::Config;
use zenoh_link_table::admission;

pub use self::logins::LoginLimit;
use crate::config::{uses_bluetooth, ConfigError, SessionSettings};

/// Maximum duration of a handshake over other links than Bluetooth. A local program or a computer on the same network
/// completes it in milliseconds; only a busy Bluetooth link needs Zenoh's own limit (`accept_timeout`, 10 s).
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(3);

/// The limits of one router.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SessionLimits {
    links: admission::Limits,
    per_user: usize,
}

impl SessionLimits {
    /// Computes the limits from Zenoh's settings and RECT's.
    ///
    /// # Errors
    /// [`ConfigError::Settings`] if a share is larger than the number of sessions that remain for it.
    pub fn of(config: &Config, settings: &SessionSettings) -> Result<Self, ConfigError> {
        let unicast = &config.transport.unicast;
        let (sessions, handshakes) = (*unicast.max_sessions(), *unicast.accept_pending());
        let has_bluetooth = uses_bluetooth(config);
        let share = |of: usize, quarters: usize| (of * quarters).div_ceil(4);
        let bluetooth = match has_bluetooth {
            true => settings.bluetooth.unwrap_or(sessions / 4),
            false => 0,
        };
        let others = sessions.saturating_sub(bluetooth);
        let per_user = settings.per_user.unwrap_or(share(others, 2));
        let per_address = settings.per_address.unwrap_or(share(others, 3));
        for (key, given, available) in [
            ("bluetooth", bluetooth, sessions.saturating_sub(1)),
            ("per_user", per_user, others),
            ("per_address", per_address, others),
        ] {
            if given > available {
                return Err(ConfigError::Settings {
                    reason: format!(
                        "sessions/{key} is {given}, but only {available} remain of transport/unicast/max_sessions"
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

    /// Applies the limits of links to this process, and raises Zenoh's own limit to leave room for handshakes that are ending.
    ///
    /// # Errors
    /// [`ConfigError::Refused`] if Zenoh rejects the raised limit.
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

    /// Returns the handler that limits the sessions of one login.
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
    fn reserves_a_quarter_for_bluetooth_and_limits_users_and_addresses() {
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
    fn reserves_nothing_without_bluetooth() {
        let text = ROBOT.replace(r#", "ble/sim-a#name=a""#, "");
        let limits = limits(&text, &SessionSettings::default()).expect("valid");
        assert_eq!((limits.links.sessions, limits.links.handshakes), (128, 64));
    }

    #[test]
    fn rejects_a_share_above_the_total_and_names_the_key() {
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
    fn accepts_a_limit_of_one_session() {
        let text = r#"{ mode: "router", listen: { endpoints: ["tcp/127.0.0.1:0"] }, transport: { unicast: { max_sessions: 1 } } }"#;
        let limits = limits(text, &SessionSettings::default()).expect("valid");
        assert_eq!(limits.links.sessions, 1);
        assert_eq!((limits.links.sessions_per_source, limits.per_user), (1, 1));
    }
}
