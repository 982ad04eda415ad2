//! Decides who may see and use the page: checks logins, limits attempts, and keeps the sessions of browsers.
use std::{
    collections::HashMap,
    fs,
    net::IpAddr,
    path::Path,
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use rand::{rngs::OsRng, RngCore};
use rect_core::session::login::logins;
use sha2::{Digest, Sha256};

use crate::permits::address_block;

/// The name of the cookie that identifies a session.
pub const COOKIE: &str = "rect_session";
/// How long a session lasts.
pub const LASTS: Duration = Duration::from_secs(12 * 3600);
/// The largest number of sessions. Beyond it, the one that ends first is ended.
const MAX_SESSIONS: usize = 100;
/// The number of wrong logins that one address may try in [`WINDOW`].
const MAX_ATTEMPTS: u32 = 8;
/// The number of wrong logins that all addresses of a block may try together, apart from known ones.
const MAX_ATTEMPTS_OF_BLOCK: u32 = 64;
const WINDOW: Duration = Duration::from_secs(60);
/// The largest number of addresses and blocks whose attempts are counted. Beyond it, only known addresses may log in.
const MAX_SOURCES: usize = 1000;

/// The rights of a browser.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Access {
    /// Nothing but log in.
    None,
    /// Look, and press Stop.
    Look,
    /// Everything.
    Change,
}

/// The logins of the team, and the sessions of browsers.
pub struct Logins {
    /// Hashes of user and password. Comparing them takes the same time for each guess of a password.
    known: Vec<[u8; 32]>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// By the hashes of their tokens.
    sessions: HashMap<[u8; 32], Session>,
    attempts: HashMap<Source, Attempts>,
}

struct Session {
    user: String,
    ends: Instant,
    address: IpAddr,
}

/// A source of wrong logins.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Source {
    Address(IpAddr),
    Block(IpAddr),
}

struct Attempts {
    since: Instant,
    wrong: u32,
}

/// Why a login is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// The user or the password is wrong.
    Wrong,
    /// There were too many wrong logins from this address.
    TooMany,
}

impl Logins {
    /// Reads a login file.
    ///
    /// # Errors
    /// Fails if the file cannot be read or contains no login.
    pub fn read(file: &Path) -> Result<Self, String> {
        let named = |problem: String| format!("{}: {problem}", file.display());
        let text = fs::read_to_string(file).map_err(|error| named(error.to_string()))?;
        let known: Vec<_> = logins(&text)
            .map(|(user, password)| hash_of(user, password))
            .collect();
        match known.is_empty() {
            true => Err(named(
                "contains no login; write one as user:password".to_owned(),
            )),
            false => Ok(Self {
                known,
                state: Mutex::default(),
            }),
        }
    }

    /// Checks a login from an address. Returns the token of a new session.
    ///
    /// # Errors
    /// Fails if it is wrong, or if there were too many wrong ones.
    pub fn log_in(
        &self,
        from: IpAddr,
        user: &str,
        password: &str,
        now: Instant,
    ) -> Result<String, Refused> {
        let from = address(from);
        let mut state = self.state();
        state
            .attempts
            .retain(|_, attempts| now.duration_since(attempts.since) < WINDOW);
        // Somebody at this computer, or where somebody has logged in, is not kept out by others.
        let is_known = from.is_loopback() || state.is_known(from, now);
        let sources = sources(from, is_known);
        let is_counted = state.attempts.contains_key(&Source::Address(from));
        let has_room = is_known || is_counted || state.attempts.len() < MAX_SOURCES;
        if !has_room
            || sources
                .iter()
                .any(|(source, max)| state.wrong(source) >= *max)
        {
            return Err(Refused::TooMany);
        }
        let hash = hash_of(user.trim(), password.trim());
        if !self.known.contains(&hash) {
            for (source, _) in sources {
                let attempts = state.attempts.entry(source).or_insert(Attempts {
                    since: now,
                    wrong: 0,
                });
                attempts.wrong += 1;
            }
            return Err(Refused::Wrong);
        }
        state.sessions.retain(|_, session| session.ends > now);
        if state.sessions.len() >= MAX_SESSIONS {
            let first = state
                .sessions
                .iter()
                .min_by_key(|(_, session)| session.ends);
            if let Some(first) = first.map(|(token, _)| *token) {
                state.sessions.remove(&first);
            }
        }
        let token = new_token();
        let ends = now + LASTS;
        let session = Session {
            user: user.trim().to_owned(),
            ends,
            address: from,
        };
        state
            .sessions
            .insert(Sha256::digest(&token).into(), session);
        Ok(token)
    }

    /// Returns who has logged in, if a session of that token lasts.
    pub fn user(&self, token: &str, now: Instant) -> Option<String> {
        let state = self.state();
        let hash: [u8; 32] = Sha256::digest(token).into();
        let session = state.sessions.get(&hash)?;
        (session.ends > now).then(|| session.user.clone())
    }

    /// Returns whether a session that lasts began at that address.
    pub fn is_known(&self, from: IpAddr, now: Instant) -> bool {
        self.state().is_known(address(from), now)
    }

    /// Ends a session.
    pub fn log_out(&self, token: &str) {
        let hash: [u8; 32] = Sha256::digest(token).into();
        self.state().sessions.remove(&hash);
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn is_known(&self, from: IpAddr, now: Instant) -> bool {
        let mut sessions = self.sessions.values();
        sessions.any(|session| session.address == from && session.ends > now)
    }

    fn wrong(&self, source: &Source) -> u32 {
        self.attempts
            .get(source)
            .map_or(0, |attempts| attempts.wrong)
    }
}

/// Returns the address whose attempts are counted: all of the loopback interface are one.
fn address(from: IpAddr) -> IpAddr {
    match from.to_canonical() {
        ip if ip.is_loopback() => address_block(ip),
        ip => ip,
    }
}

/// Returns the sources of a wrong login, with the number of wrong ones that each may try.
fn sources(from: IpAddr, is_known: bool) -> Vec<(Source, u32)> {
    let mut sources = vec![(Source::Address(from), MAX_ATTEMPTS)];
    let block = address_block(from);
    if !is_known && block != from {
        sources.push((Source::Block(block), MAX_ATTEMPTS_OF_BLOCK));
    }
    sources
}

fn hash_of(user: &str, password: &str) -> [u8; 32] {
    // No user contains a colon.
    Sha256::digest(format!("{user}:{password}")).into()
}

fn new_token() -> String {
    let mut random = [0; 32];
    OsRng.fill_bytes(&mut random);
    random.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);
    const THERE: IpAddr = IpAddr::V4(std::net::Ipv4Addr::BROADCAST);

    fn logins() -> Logins {
        let file = tempfile::NamedTempFile::new().expect("file");
        fs::write(
            file.path(),
            "team:secret secret\n# no login\nmentor: other\n",
        )
        .expect("written");
        Logins::read(file.path()).expect("logins")
    }

    #[test]
    fn sessions_begin_with_a_login_and_end() {
        let (logins, now) = (logins(), Instant::now());
        let token = logins
            .log_in(HERE, "team", "secret secret", now)
            .expect("right");
        let other = logins.log_in(HERE, "mentor", "other", now).expect("right");
        assert_ne!(token, other);
        assert_eq!(logins.user(&token, now).as_deref(), Some("team"));
        assert_eq!(
            (logins.user("", now), logins.user(&token, now + LASTS)),
            (None, None)
        );
        logins.log_out(&token);
        assert_eq!(logins.user(&token, now), None);
        assert_eq!(logins.user(&other, now).as_deref(), Some("mentor"));
    }

    #[test]
    fn wrong_logins_are_limited_for_their_address_alone() {
        let (logins, now) = (logins(), Instant::now());
        for _ in 0..MAX_ATTEMPTS {
            assert_eq!(
                logins.log_in(HERE, "team", "guess", now),
                Err(Refused::Wrong)
            );
        }
        let right = |from, now| logins.log_in(from, "team", "secret secret", now);
        assert_eq!(right(HERE, now), Err(Refused::TooMany));
        assert!(right(THERE, now).is_ok() && right(HERE, now + WINDOW).is_ok());
    }

    #[test]
    fn many_addresses_of_one_block_lock_out_only_their_block() {
        let (logins, now) = (logins(), Instant::now());
        let address = |number: u16| IpAddr::from([0xfd00, 0, 0, 1, 0, 0, 1, number]);
        let right = |from| logins.log_in(from, "mentor", "other", now);
        let known = address(0);
        assert!(right(known).is_ok() && logins.is_known(known, now));
        for number in 1..=2000 {
            assert!(logins
                .log_in(address(number), "team", "guess", now)
                .is_err());
        }
        assert!(logins.state().attempts.len() < MAX_SOURCES);
        assert_eq!(right(address(3000)), Err(Refused::TooMany));
        assert!(right(THERE).is_ok() && right(known).is_ok());
    }

    #[test]
    fn known_addresses_and_this_computer_can_log_in_when_too_many_others_try() {
        let (logins, now) = (logins(), Instant::now());
        let right = |from| logins.log_in(from, "mentor", "other", now);
        let address =
            |number: u16| IpAddr::from([10, 0, number.to_be_bytes()[0], number.to_be_bytes()[1]]);
        let known = address(u16::MAX);
        assert!(right(known).is_ok());
        for number in 1..=2000 {
            assert!(logins
                .log_in(address(number), "team", "guess", now)
                .is_err());
        }
        assert_eq!(logins.state().attempts.len(), MAX_SOURCES);
        assert_eq!(right(THERE), Err(Refused::TooMany));
        assert!(right(known).is_ok() && right(HERE).is_ok());
    }

    #[test]
    fn the_number_of_sessions_is_limited() {
        let (logins, now) = (logins(), Instant::now());
        let log_in =
            |after| logins.log_in(HERE, "mentor", "other", now + Duration::from_secs(after));
        let first = log_in(0).expect("right");
        for after in 1..=MAX_SESSIONS as u64 {
            log_in(after).expect("right");
        }
        assert_eq!(logins.user(&first, now), None);
        assert_eq!(logins.state().sessions.len(), MAX_SESSIONS);
    }
}
