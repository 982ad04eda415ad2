//! Decides how a program joins a router: when to retry, why joining failed, and whether the router serves the robot
//! that the program joins as. It is given the time and Zenoh's error messages; the sessions do the I/O.
use std::time::Duration;

use super::login::{Login, LoginRefused};
use crate::{
    name::{
        key::{KeySpace, OWN},
        Name,
    },
    text::humanize,
};

/// How long to wait for the router's answer about the robot that it serves. A router answers within a millisecond,
/// unless its access control forbids the question.
pub const ROBOT_TIMEOUT: Duration = Duration::from_secs(1);

/// Why there is no session although one was opened: Zenoh's routers can close a session only after they have opened it.
pub const CLOSED: &str = "it has closed the session at once: the login probably has all sessions that one login may have \
    (plugins/rect/sessions/per_user in its configuration)";

/// The minimum duration of an attempt, even at the end of the timeout, so that a timeout of 0 suffices to join a router
/// that is running.
const SHORTEST_ATTEMPT: Duration = Duration::from_millis(100);
/// The pause after the first failed attempt. It doubles after each further one.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// The attempts to join one router.
#[derive(Debug)]
pub struct JoinAttempts {
    endpoint: String,
    login: Login,
    timeout: Duration,
    pause: Duration,
    uses_login: bool,
}

/// Why a program cannot join a router.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum JoinError {
    /// No router answers within the timeout.
    NoRouter {
        /// The reason why the last attempt failed.
        reason: String,
    },
    /// The router requires a login, and the program's is missing or wrong.
    Login(LoginRefused),
}

/// The meaning of Zenoh's reason for a failed attempt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Refusal {
    Login,
    /// The router does not require a login, and Zenoh's client insists on sending one.
    NoLoginRequired,
    Full,
    Other,
}

impl JoinAttempts {
    /// Creates the state for joining the router at `endpoint` within `timeout`.
    pub fn new(endpoint: impl Into<String>, login: Login, timeout: Duration) -> Self {
        Self {
            endpoint: endpoint.into(),
            uses_login: login.credentials().is_some(),
            login,
            timeout,
            pause: FIRST_PAUSE,
        }
    }

    /// Returns the user and password for the next attempt.
    pub fn credentials(&self) -> Option<(&str, &str)> {
        self.login.credentials().filter(|_| self.uses_login)
    }

    /// Returns how long the next attempt may take. `elapsed` is the time since the first attempt began.
    pub fn limit(&self, elapsed: Duration) -> Duration {
        self.remaining(elapsed).max(SHORTEST_ATTEMPT)
    }

    /// Handles a failed attempt, and returns the pause before the next one. `reason` is what Zenoh reports, or `None`
    /// if the attempt exceeded [`limit`](Self::limit). `elapsed` is the time since the first attempt began.
    ///
    /// # Errors
    /// Returns a [`JoinError`] if further attempts are pointless or the timeout has passed.
    pub fn on_failure(
        &mut self,
        elapsed: Duration,
        reason: Option<&str>,
    ) -> Result<Duration, JoinError> {
        let refusal = reason.map_or(Refusal::Other, Refusal::of);
        match refusal {
            Refusal::Login => {
                return Err(JoinError::Login(self.login.refused_by(&self.endpoint)));
            }
            Refusal::NoLoginRequired if self.uses_login => {
                self.uses_login = false;
                return Ok(Duration::ZERO);
            }
            _ => {}
        }
        let remaining = self.remaining(elapsed);
        if remaining.is_zero() {
            let reason = self.describe(refusal, reason);
            return Err(JoinError::NoRouter { reason });
        }
        let pause = self.pause.min(remaining);
        self.pause = (self.pause * 2).min(LONGEST_PAUSE);
        Ok(pause)
    }

    fn remaining(&self, elapsed: Duration) -> Duration {
        self.timeout.saturating_sub(elapsed)
    }

    fn describe(&self, refusal: Refusal, reason: Option<&str>) -> String {
        match (refusal, reason) {
            (Refusal::Full, _) => "it has as many sessions as it accepts \
                (transport/unicast/max_sessions in its configuration)"
                .to_owned(),
            (_, Some(reason)) => {
                system_error(reason).unwrap_or_else(|| humanize::on_one_line(reason))
            }
            (_, None) => format!("no answer within {}", humanize::duration(self.timeout)),
        }
    }
}

impl Refusal {
    /// Interprets the reason that Zenoh 1.10 gives when a session does not open. Its routers close the link of a client
    /// without a login in response to the first message (InitSyn), and that of a client with a wrong login in response
    /// to the second (OpenSyn).
    fn of(reason: &str) -> Self {
        let closed = |why: &str, message: &str| {
            reason.contains(&format!(
                "Received a close message (reason {why}) in response to an {message}"
            ))
        };
        let generic = |message| closed("0", message) || closed("GENERIC", message);
        if generic("InitSyn") || generic("OpenSyn") {
            Self::Login
        } else if closed("INVALID", "OpenSyn") {
            Self::Full
        } else if reason.contains("UsrPwd extension") || reason.contains("Auth extension") {
            Self::NoLoginRequired
        } else {
            Self::Other
        }
    }
}

/// Returns the operating system's error, if Zenoh quotes one: "Connection refused".
fn system_error(reason: &str) -> Option<String> {
    let (before, _) = reason.split_once(" (os error ")?;
    let text = before.rsplit([':', '[', ',']).next()?.trim();
    (!text.is_empty()).then(|| text.to_owned())
}

/// Returns the key expression of the liveliness tokens that name the robot of the router with the Zenoh id `id`, in
/// any fleet.
pub fn robot_of_router(id: &str) -> String {
    format!("*/*/{OWN}/alive/{id}")
}

/// The router serves another robot than the program joins as. A router with the access control of `rect-router init`
/// forwards only what its own robot publishes, and drops the rest without an error to the sender.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the router at {endpoint} serves {}, but this program joins as {}: the router's access control may drop whatever it \
     publishes. Join as {}, or at the router of {}; a program that uses another name on purpose sets the option \
     `allow_name_mismatch`",
    .serves.with_fleet_unlike(.joins), .joins.with_fleet_unlike(.serves), .serves.with_fleet_unlike(.joins),
    .joins.with_fleet_unlike(.serves)
)]
pub struct WrongRobot {
    /// The endpoint of the router.
    pub endpoint: String,
    /// The robot and fleet that the router serves.
    pub serves: KeySpace,
    /// The robot and fleet that the program joins as.
    pub joins: KeySpace,
}

impl KeySpace {
    /// Checks the keys of the liveliness tokens that match [`robot_of_router`]. A router without such tokens serves no
    /// robot, and accepts all names.
    ///
    /// # Errors
    /// Returns [`WrongRobot`] if there are tokens, and none is of this robot.
    pub fn check_router<T: AsRef<str>>(
        &self,
        endpoint: &str,
        tokens: impl IntoIterator<Item = T>,
    ) -> Result<(), WrongRobot> {
        let mut other = None;
        for keys in tokens
            .into_iter()
            .filter_map(|key| Self::of_key(key.as_ref()))
        {
            if keys == *self {
                return Ok(());
            }
            other = other.or(Some(keys));
        }
        other.map_or(Ok(()), |serves| {
            Err(WrongRobot {
                endpoint: endpoint.to_owned(),
                serves,
                joins: self.clone(),
            })
        })
    }

    /// Returns the fleet and robot of a key of any fleet.
    fn of_key(key: &str) -> Option<Self> {
        let mut parts = key.split('/').map(Name::new);
        let (fleet, robot) = (parts.next()?.ok()?, parts.next()?.ok()?);
        Some(Self { fleet, robot })
    }

    /// Describes the robot for an error message. The fleet is named only if it is not that of `other`.
    fn with_fleet_unlike(&self, other: &Self) -> String {
        let Self { fleet, robot } = self;
        if *fleet == other.fleet {
            format!("the robot {robot}")
        } else {
            format!("the robot {robot} of the fleet {fleet}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const REFUSED: &str = "Can not create a new TCP link bound to tcp/127.0.0.1:9: [127.0.0.1:9: Connection refused (os \
        error 111) at /x/tcp.rs:105.] at /x/tcp.rs:133. at /x/unicast.rs:61.";
    const NO_LOGIN: &str =
        "Received a close message (reason 0) in response to an InitSyn on: tcp/127.0.0.1:1 => \
        tcp/127.0.0.1:2 at /x/open.rs:256.";
    const WRONG_LOGIN: &str =
        "Received a close message (reason GENERIC) in response to an OpenSyn on: \
        TransportLinkUnicast { link: Link { src: tcp/127.0.0.1:1 } } at /x/open.rs:525.";
    const FULL: &str = "Received a close message (reason INVALID) in response to an OpenSyn on: TransportLinkUnicast";
    const NO_LOGINS: &str = "UsrPwd extension - Recv InitSyn. Decoding error. at /x/usrpwd.rs:304.";

    fn attempts(login: Login) -> JoinAttempts {
        JoinAttempts::new("tcp/127.0.0.1:9", login, Duration::from_secs(3))
    }

    fn keys(fleet: &str, robot: &str) -> KeySpace {
        let name = |text| Name::new(text).expect("valid name");
        let (fleet, robot) = (name(fleet), name(robot));
        KeySpace { fleet, robot }
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn retries_until_the_timeout_if_no_router_answers() {
        let mut attempts = attempts(Login::given("fleet", "x"));
        let (mut elapsed, mut pauses) = (Duration::ZERO, Vec::new());
        let error = loop {
            match attempts.on_failure(elapsed, Some(REFUSED)) {
                Ok(pause) => {
                    pauses.push(pause);
                    elapsed += pause;
                }
                Err(error) => break error,
            }
        };
        assert_eq!(pauses, [100, 200, 400, 800, 1000, 500].map(ms));
        assert_eq!(elapsed, ms(3000));
        let reason = "Connection refused".to_owned();
        assert_eq!(error, JoinError::NoRouter { reason });
    }

    #[test]
    fn reports_the_timeout_if_the_router_does_not_answer() {
        let error = attempts(Login::given("fleet", "x")).on_failure(ms(3000), None);
        let reason = "no answer within 3 s".to_owned();
        assert_eq!(error, Err(JoinError::NoRouter { reason }));
    }

    #[test]
    fn does_not_retry_after_a_refused_login() {
        let unreadable = Login::of_file("/etc/rect/users", Err("Permission denied".to_owned()));
        let wrong = Login::of_file("/etc/rect/users", Ok("fleet:x"));
        for (login, reason, expected) in [
            (
                unreadable,
                NO_LOGIN,
                "/etc/rect/users cannot be read: Permission denied",
            ),
            (wrong, WRONG_LOGIN, "of user fleet in /etc/rect/users"),
            (Login::given("me", "x"), WRONG_LOGIN, "of user me"),
        ] {
            match attempts(login).on_failure(ms(1), Some(reason)) {
                Err(JoinError::Login(refused)) => {
                    let text = refused.to_string();
                    assert!(
                        text.contains(expected) && text.contains("RECT_LOGIN"),
                        "{text}"
                    );
                }
                other => panic!("{reason}: {other:?}"),
            }
        }
    }

    #[test]
    fn retries_without_a_login_if_none_is_required() {
        let mut attempts = attempts(Login::given("fleet", "x"));
        assert_eq!(attempts.credentials(), Some(("fleet", "x")));
        assert_eq!(
            attempts.on_failure(ms(1), Some(NO_LOGINS)),
            Ok(Duration::ZERO)
        );
        assert_eq!(attempts.credentials(), None);
    }

    #[test]
    fn retries_if_the_router_has_too_many_sessions() {
        let mut attempts = attempts(Login::given("fleet", "x"));
        assert_eq!(attempts.on_failure(ms(1), Some(FULL)), Ok(FIRST_PAUSE));
        match attempts.on_failure(ms(3000), Some(FULL)) {
            Err(JoinError::NoRouter { reason }) => {
                assert!(reason.contains("max_sessions"), "{reason}");
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn compares_the_routers_robot_with_the_programs() {
        let me = keys("rect", "wombat-7");
        let check = |tokens: &[&str]| me.check_router("tcp/127.0.0.1:7447", tokens);
        assert_eq!(check(&[]), Ok(()));
        assert_eq!(check(&["rect/wombat-7/@rect/alive/ab12"]), Ok(()));
        assert_eq!(check(&["nonsense", "a b/c/@rect/alive/ab12"]), Ok(()));
        let other = check(&["rect/wombat-1/@rect/alive/ab12"]).expect_err("another robot");
        let text = other.to_string();
        assert!(
            text.contains("serves the robot wombat-1,")
                && text.contains("joins as the robot wombat-7:"),
            "{text}"
        );
        let other = check(&["lions/wombat-7/@rect/alive/ab12"]).expect_err("another fleet");
        let text = other.to_string();
        assert!(
            text.contains("Join as the robot wombat-7 of the fleet lions, or"),
            "{text}"
        );
        let both = [
            "rect/wombat-1/@rect/alive/ab12",
            "rect/wombat-7/@rect/alive/ab12",
        ];
        assert_eq!(check(&both), Ok(()));
    }
}
