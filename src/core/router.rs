//! Decides how a program joins a router: when to try again, why it can't join, and whether the router serves the robot that
//! the program joins as. It is given the time and what Zenoh answers; sessions do the I/O.
use std::time::Duration;

use super::{
    key::{Place, OWN},
    login::{Login, LoginRefused},
    name::Name,
    wording,
};

/// How long to wait for the router's answer about the robot that it serves. A router answers within a millisecond; one whose
/// access control forbids the question does not answer.
pub const ROBOT_TIMEOUT: Duration = Duration::from_secs(1);

/// The minimum time for an attempt, even at the end of the timeout, so that a timeout of 0 joins a router that is there.
const SHORTEST_ATTEMPT: Duration = Duration::from_millis(100);
/// The pause after the first failed attempt; each further one is twice as long.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// The attempts to join one router.
#[derive(Debug)]
pub struct Joining {
    endpoint: String,
    login: Login,
    timeout: Duration,
    pause: Duration,
    uses_login: bool,
}

/// Why a program can't join a router.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum JoinError {
    /// No router answers within the timeout.
    NoRouter {
        /// Why the last attempt failed.
        reason: String,
    },
    /// The router asks for a login, and this program's is missing or wrong.
    Login(LoginRefused),
}

/// What Zenoh's reason for a failed attempt means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Refusal {
    Login,
    /// The router asks for no login, and Zenoh's client insists on giving one.
    NoLoginsThere,
    Full,
    Other,
}

impl Joining {
    /// For the router at `endpoint`, which may take up to `timeout` to answer.
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

    /// Returns how long the next attempt may take, `elapsed` after the first one began.
    pub fn limit(&self, elapsed: Duration) -> Duration {
        self.remaining(elapsed).max(SHORTEST_ATTEMPT)
    }

    /// Handles a failed attempt: returns the pause before the next one. `reason` is what Zenoh reports, `None` if the
    /// attempt took longer than [`limit`](Self::limit); `elapsed` is the time since the first attempt began.
    ///
    /// # Errors
    /// [`JoinError`]: further attempts are pointless, or the time is over.
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
            Refusal::NoLoginsThere if self.uses_login => {
                self.uses_login = false;
                return Ok(Duration::ZERO);
            }
            _ => {}
        }
        let remaining = self.remaining(elapsed);
        if remaining.is_zero() {
            let reason = self.shown(refusal, reason);
            return Err(JoinError::NoRouter { reason });
        }
        let pause = self.pause.min(remaining);
        self.pause = (self.pause * 2).min(LONGEST_PAUSE);
        Ok(pause)
    }

    fn remaining(&self, elapsed: Duration) -> Duration {
        self.timeout.saturating_sub(elapsed)
    }

    fn shown(&self, refusal: Refusal, reason: Option<&str>) -> String {
        match (refusal, reason) {
            (Refusal::Full, _) => "it has as many sessions as it accepts \
                (transport/unicast/max_sessions in its configuration)"
                .to_owned(),
            (_, Some(reason)) => {
                system_error(reason).unwrap_or_else(|| wording::on_one_line(reason))
            }
            (_, None) => format!("no answer within {}", wording::duration(self.timeout)),
        }
    }
}

impl Refusal {
    /// Reads the reason that Zenoh 1.10 gives for a session that does not open. Its routers close the link of a client without
    /// a login in answer to the first message (InitSyn), that of a client with a wrong one in answer to the second (OpenSyn).
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
            Self::NoLoginsThere
        } else {
            Self::Other
        }
    }
}

/// Returns what the system says is wrong, if Zenoh quotes it: "Connection refused".
fn system_error(reason: &str) -> Option<String> {
    let (before, _) = reason.split_once(" (os error ")?;
    let said = before.rsplit([':', '[', ',']).next()?.trim();
    (!said.is_empty()).then(|| said.to_owned())
}

/// Returns the key expression of the liveliness tokens that name the robot of the router with that Zenoh id, in any fleet.
pub fn robot_of_router(id: &str) -> String {
    format!("*/*/{OWN}/alive/{id}")
}

/// The router serves another robot than the program joins as. A router with `rect-router init`'s access control passes on
/// what its own robot says and drops the rest, without an error to the sender.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the router at {endpoint} serves {}, but this program joins as {}: the router's access control may drop whatever it \
     publishes. Join as {serves}, or at the router of {joins}; a program that uses another name on purpose sets the option \
     `allow_name_mismatch`",
    .serves.with_fleet_unlike(.joins), .joins.with_fleet_unlike(.serves),
    serves = .serves.robot, joins = .joins.robot
)]
pub struct WrongRobot {
    /// Where the router is.
    pub endpoint: String,
    /// The robot and fleet that the router serves.
    pub serves: Place,
    /// The robot and fleet that the program joins as.
    pub joins: Place,
}

impl Place {
    /// Checks the keys of the liveliness tokens under [`robot_of_router`]: a router without any serves no robot, and accepts
    /// all names.
    ///
    /// # Errors
    /// [`WrongRobot`]: there are some, and none is of this robot.
    pub fn check_router<T: AsRef<str>>(
        &self,
        endpoint: &str,
        tokens: impl IntoIterator<Item = T>,
    ) -> Result<(), WrongRobot> {
        let mut other = None;
        for place in tokens
            .into_iter()
            .filter_map(|key| Self::of_key(key.as_ref()))
        {
            if place == *self {
                return Ok(());
            }
            other = other.or(Some(place));
        }
        other.map_or(Ok(()), |serves| {
            Err(WrongRobot {
                endpoint: endpoint.to_owned(),
                serves,
                joins: self.clone(),
            })
        })
    }

    /// Returns whose a key of any fleet is.
    fn of_key(key: &str) -> Option<Self> {
        let mut parts = key.split('/').map(Name::new);
        let (fleet, robot) = (parts.next()?.ok()?, parts.next()?.ok()?);
        Some(Self { fleet, robot })
    }

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

    fn joining(login: Login) -> Joining {
        Joining::new("tcp/127.0.0.1:9", login, Duration::from_secs(3))
    }

    fn place(fleet: &str, robot: &str) -> Place {
        let name = |text| Name::new(text).expect("a name");
        let (fleet, robot) = (name(fleet), name(robot));
        Place { fleet, robot }
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn an_absent_router_is_tried_again_until_the_timeout_and_no_longer() {
        let mut joining = joining(Login::given("fleet", "x"));
        let (mut elapsed, mut pauses) = (Duration::ZERO, Vec::new());
        let error = loop {
            match joining.on_failure(elapsed, Some(REFUSED)) {
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
    fn a_router_that_does_not_answer_is_reported_with_the_timeout() {
        let error = joining(Login::given("fleet", "x")).on_failure(ms(3000), None);
        let reason = "no answer within 3 s".to_owned();
        assert_eq!(error, Err(JoinError::NoRouter { reason }));
    }

    #[test]
    fn a_refused_login_ends_the_attempts_at_once() {
        let unreadable = Login::of_file("/etc/rect/users", Err("Permission denied".to_owned()));
        let wrong = Login::of_file("/etc/rect/users", Ok("fleet:x"));
        for (login, reason, said) in [
            (
                unreadable,
                NO_LOGIN,
                "/etc/rect/users can't be read: Permission denied",
            ),
            (wrong, WRONG_LOGIN, "of user fleet in /etc/rect/users"),
            (Login::given("me", "x"), WRONG_LOGIN, "of user me"),
        ] {
            match joining(login).on_failure(ms(1), Some(reason)) {
                Err(JoinError::Login(refused)) => {
                    let text = refused.to_string();
                    assert!(text.contains(said) && text.contains("RECT_LOGIN"), "{text}");
                }
                other => panic!("{reason}: {other:?}"),
            }
        }
    }

    #[test]
    fn a_router_without_logins_is_joined_without_one() {
        let mut joining = joining(Login::given("fleet", "x"));
        assert_eq!(joining.credentials(), Some(("fleet", "x")));
        assert_eq!(
            joining.on_failure(ms(1), Some(NO_LOGINS)),
            Ok(Duration::ZERO)
        );
        assert_eq!(joining.credentials(), None);
    }

    #[test]
    fn a_router_without_room_is_tried_again_and_reported_as_such() {
        let mut joining = joining(Login::given("fleet", "x"));
        assert_eq!(joining.on_failure(ms(1), Some(FULL)), Ok(FIRST_PAUSE));
        match joining.on_failure(ms(3000), Some(FULL)) {
            Err(JoinError::NoRouter { reason }) => {
                assert!(reason.contains("max_sessions"), "{reason}");
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_robot_of_the_router_is_compared_with_the_programs() {
        let me = place("rect", "wombat-7");
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
        assert!(text.contains("wombat-7 of the fleet lions"), "{text}");
        let both = [
            "rect/wombat-1/@rect/alive/ab12",
            "rect/wombat-7/@rect/alive/ab12",
        ];
        assert_eq!(check(&both), Ok(()));
    }
}
