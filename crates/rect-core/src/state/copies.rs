//! Which values of other robots a router has copies of, and when it asks their routers.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use zenoh_keyexpr::{keyexpr, OwnedKeyExpr};

use super::{
    page::{Page, Question},
    Position,
};
use crate::{driver::Id, name::Name};

/// The pause before a router that has not answered is asked again. It doubles until [`LONGEST_PAUSE`].
const PAUSE: Duration = Duration::from_secs(1);
const LONGEST_PAUSE: Duration = Duration::from_secs(30);
/// The time after which a reachable robot whose router keeps no values any more has forgotten them.
const FORGOTTEN_AFTER: Duration = Duration::from_secs(20);
/// The maximum number of robots.
const MAX_ROBOTS: usize = 256;
/// The maximum number of pages of one answer.
const MAX_PAGES: u32 = 64;

/// The knowledge about another robot.
#[derive(Debug)]
pub(super) struct Copied {
    /// The runs of its router that have a token, the newest last.
    runs: Vec<u32>,
    /// The number of tokens of its presence.
    presence: usize,
    /// Since when it is reachable without keeping values.
    without: Option<Instant>,
    /// Whether it has forgotten all of its values.
    pub(super) is_empty: bool,
    /// The position up to which everything is known.
    position: Option<Position>,
    /// The topics of which everything up to the position is known.
    fetched: Vec<OwnedKeyExpr>,
    /// Whether values that its router has not sent are forgotten.
    pub(super) is_complete: bool,
    /// The own number of the last change of that.
    pub(super) complete_at: u64,
    asking: Option<Asking>,
    /// Whether something may be missing.
    is_behind: bool,
    retry_at: Option<Instant>,
    pause: Duration,
}

/// A question that is not answered yet.
#[derive(Debug)]
struct Asking {
    id: Id,
    keys: Vec<OwnedKeyExpr>,
    /// Whether nothing was known of these topics.
    is_new: bool,
    /// Whether values of other topics are known.
    adds: bool,
    since: Option<Position>,
    is_answered: bool,
    has_more: bool,
    pages: u32,
}

/// The meaning of a page for the copies.
#[derive(Debug)]
pub(super) struct Arrived {
    /// Values of another run than this one, of those topics, are forgotten if the page did not contain them.
    pub(super) forgotten: Option<Vec<OwnedKeyExpr>>,
    /// Whether everything of the robot's topics that programs subscribe to is known now.
    pub(super) is_complete: bool,
}

/// The other robots.
#[derive(Debug, Default)]
pub(super) struct Copies(BTreeMap<Name, Copied>);

impl Copied {
    fn new() -> Self {
        Self {
            runs: Vec::new(),
            presence: 0,
            without: None,
            is_empty: false,
            position: None,
            fetched: Vec::new(),
            is_complete: false,
            complete_at: 0,
            asking: None,
            is_behind: false,
            retry_at: None,
            pause: PAUSE,
        }
    }

    /// Returns whether everything of those topics that this robot has is known.
    pub(super) fn covers(&self, fleet: &Name, robot: &Name, keys: &[OwnedKeyExpr]) -> bool {
        let mut own = keys.iter().filter(|key| is_of(fleet, robot, key));
        self.position.is_some()
            && own.all(|key| self.fetched.iter().any(|fetched| fetched.includes(key)))
    }

    /// Returns the position up to which everything is known.
    pub(super) fn position(&self) -> Option<Position> {
        self.position
    }

    /// Returns the topics of which everything is known.
    pub(super) fn fetched(&self) -> &[OwnedKeyExpr] {
        &self.fetched
    }

    /// Handles that its values may have changed without this router's knowledge.
    pub(super) fn on_behind(&mut self) {
        self.is_behind = true;
    }

    /// Handles that everything up to that position is known.
    pub(super) fn on_known(&mut self, at: Position) {
        self.position = Some(at);
    }

    /// Asks no question before that time, unless its router appears.
    fn wait(&mut self, now: Instant) {
        self.retry_at = Some(now + self.pause);
        self.pause = LONGEST_PAUSE.min(2 * self.pause);
    }
}

impl Copies {
    pub(super) fn get(&self, robot: &Name) -> Option<&Copied> {
        self.0.get(robot)
    }

    pub(super) fn get_mut(&mut self, robot: &Name) -> Option<&mut Copied> {
        self.0.get_mut(robot)
    }

    /// Returns the robot whose router was asked.
    pub(super) fn asked(&self, id: Id) -> Option<&Name> {
        let mut all = self.0.iter();
        let is_asked = |copied: &Copied| copied.asking.as_ref().is_some_and(|one| one.id == id);
        all.find(|(_, copied)| is_asked(copied))
            .map(|(robot, _)| robot)
    }

    /// Returns the robots whose routers keep values now.
    pub(super) fn keeping(&self) -> impl Iterator<Item = &Name> {
        let keeping = self.0.iter().filter(|(_, copied)| !copied.runs.is_empty());
        keeping.map(|(robot, _)| robot)
    }

    pub(super) fn all(&self) -> impl Iterator<Item = (&Name, &Copied)> {
        self.0.iter()
    }

    fn known(&mut self, robot: &Name) -> Option<&mut Copied> {
        if self.0.len() >= MAX_ROBOTS && !self.0.contains_key(robot) {
            let is_gone = |copied: &Copied| copied.runs.is_empty() && copied.presence == 0;
            self.0.retain(|_, copied| !is_gone(copied));
            if self.0.len() >= MAX_ROBOTS {
                return None;
            }
        }
        Some(self.0.entry(robot.clone()).or_insert_with(Copied::new))
    }

    /// Handles a token of a router that keeps values, which appeared or ended.
    pub(super) fn on_token(&mut self, robot: &Name, run: u32, is_up: bool, now: Instant) {
        let Some(copied) = self.known(robot) else {
            return;
        };
        copied.runs.retain(|known| *known != run);
        if is_up {
            if copied.runs.len() >= 4 {
                copied.runs.remove(0);
            }
            copied.runs.push(run);
            copied.is_empty = false;
            // A link was interrupted, or the router was restarted.
            (copied.is_behind, copied.retry_at, copied.pause) = (true, None, PAUSE);
        }
        copied.on_presence(now);
    }

    /// Handles a token of the presence of a robot.
    pub(super) fn on_presence(&mut self, robot: &Name, is_up: bool, now: Instant) {
        let Some(copied) = self.known(robot) else {
            return;
        };
        match is_up {
            true => copied.presence += 1,
            false => copied.presence = copied.presence.saturating_sub(1),
        }
        copied.on_presence(now);
    }

    /// Returns the robots that have forgotten all of their values, since their routers keep none any more.
    pub(super) fn emptied(&mut self, now: Instant) -> Vec<Name> {
        let mut emptied = Vec::new();
        for (robot, copied) in &mut self.0 {
            let is_due = copied
                .without
                .is_some_and(|since| now >= since + FORGOTTEN_AFTER);
            if is_due {
                (copied.position, copied.fetched) = (None, Vec::new());
                (copied.without, copied.is_empty) = (None, true);
                emptied.push(robot.clone());
            }
        }
        emptied
    }

    /// Returns the next question.
    pub(super) fn next_question(
        &mut self,
        now: Instant,
        place: (&Name, &Name),
        interests: &[OwnedKeyExpr],
        id: impl FnOnce() -> Id,
    ) -> Option<(Id, Name, Question)> {
        let (fleet, own) = place;
        for (robot, copied) in &mut self.0 {
            let Some(&run) = copied.runs.last() else {
                continue;
            };
            copied.retry_at = copied.retry_at.filter(|at| now < *at);
            if copied.retry_at.is_some() || copied.asking.is_some() || robot == own {
                continue;
            }
            let keys = || interests.iter().filter(|key| is_of(fleet, robot, key));
            let is_known = |key: &OwnedKeyExpr| {
                let mut fetched = copied.fetched.iter();
                copied.position.is_some_and(|Position(of, _)| of == run)
                    && fetched.any(|fetched| fetched.includes(key))
            };
            let new: Vec<_> = keys().filter(|key| !is_known(key)).cloned().collect();
            let asking = if !new.is_empty() {
                (new, true, None)
            } else if copied.is_behind && keys().next().is_some() {
                (keys().cloned().collect(), false, copied.position)
            } else {
                continue;
            };
            let (keys, is_new, since) = asking;
            let adds = is_new && copied.position.is_some_and(|Position(of, _)| of == run);
            // Otherwise the answer contains everything.
            copied.is_behind &= adds;
            let id = id();
            let question = question(own, adds, since, &keys);
            copied.asking = Some(Asking {
                id,
                keys,
                is_new,
                adds,
                since,
                is_answered: false,
                has_more: false,
                pages: 0,
            });
            return Some((id, robot.clone(), question));
        }
        None
    }

    /// Handles a page of an answer, whose values were copied.
    pub(super) fn on_page(
        &mut self,
        id: Id,
        page: &Page,
        interests: &[OwnedKeyExpr],
        fleet: &Name,
    ) -> Option<Arrived> {
        let mut all = self.0.iter_mut();
        let is_asked = |copied: &Copied| copied.asking.as_ref().is_some_and(|one| one.id == id);
        let (robot, copied) = all.find(|(_, copied)| is_asked(copied))?;
        let asking = copied.asking.as_mut()?;
        let before = asking.since.filter(|Position(run, _)| *run == page.run);
        asking.is_answered = true;
        asking.since = Some(Position(page.run, page.at));
        asking.pages += 1;
        copied.pause = PAUSE;
        let is_stuck = before.is_some_and(|Position(_, number)| page.at <= number);
        let is_wanted = !asking.keys.is_empty();
        asking.has_more = page.more && is_wanted && !is_stuck && asking.pages < MAX_PAGES;
        if asking.has_more {
            return Some(Arrived {
                forgotten: None,
                is_complete: false,
            });
        }
        let previous = copied.position.filter(|Position(run, _)| *run == page.run);
        let keys = asking.keys.clone();
        let is_new = asking.is_new || previous.is_none();
        copied.position = Some(match (asking.is_new, previous) {
            (true, Some(earlier)) if !copied.fetched.is_empty() => earlier,
            _ => Position(page.run, page.at),
        });
        match asking.is_new && previous.is_some() {
            true => {
                copied
                    .fetched
                    .retain(|fetched| !keys.iter().any(|key| key.includes(fetched)));
                copied.fetched.extend(keys.iter().cloned());
            }
            false => copied.fetched.clone_from(&keys),
        }
        if copied.runs.last() != Some(&page.run) {
            copied.runs.retain(|run| *run != page.run);
            copied.runs.push(page.run);
        }
        let was_complete = copied.is_complete && previous.is_some();
        copied.is_complete = page.complete.iter().any(|(robot, _)| robot.is_empty());
        let has_completed = copied.is_complete && (is_new || !was_complete);
        let forgotten = match is_new {
            true => keys,
            false => copied.fetched.clone(),
        };
        Some(Arrived {
            forgotten: has_completed.then_some(forgotten),
            is_complete: has_completed && copied.covers(fleet, robot, interests),
        })
    }

    /// Handles that a question has ended. Returns the next one if there is more.
    pub(super) fn on_ended(
        &mut self,
        id: Id,
        own: &Name,
        now: Instant,
    ) -> Option<(Name, Question)> {
        let mut all = self.0.iter_mut();
        let is_asked = |copied: &Copied| copied.asking.as_ref().is_some_and(|one| one.id == id);
        let (robot, copied) = all.find(|(_, copied)| is_asked(copied))?;
        let asking = copied.asking.as_mut()?;
        if std::mem::take(&mut asking.has_more) {
            asking.is_answered = false;
            let question = question(own, asking.adds, asking.since, &asking.keys);
            return Some((robot.clone(), question));
        }
        if !asking.is_answered {
            copied.is_behind = true;
            copied.wait(now);
        }
        copied.asking = None;
        None
    }

    /// Handles that programs subscribe to other topics than before.
    pub(super) fn on_interests(&mut self, interests: &[OwnedKeyExpr]) {
        for copied in self.0.values_mut() {
            let fetched = std::mem::take(&mut copied.fetched);
            let is_known = |key: &&OwnedKeyExpr| fetched.iter().any(|known| known.includes(key));
            let known: Vec<_> = interests.iter().filter(is_known).cloned().collect();
            // The copies of topics that are a part of a new key stay.
            let is_part = |key: &OwnedKeyExpr| {
                !known.iter().any(|known| known.includes(key))
                    && interests.iter().any(|interest| interest.includes(key))
            };
            let parts: Vec<_> = fetched.iter().filter(|key| is_part(key)).cloned().collect();
            copied.fetched = [known, parts].concat();
            // The values that an answer contains of other topics are not kept, so that these are not known afterwards.
            if let Some(asking) = &mut copied.asking {
                let is_kept =
                    |key: &OwnedKeyExpr| interests.iter().any(|interest| interest.includes(key));
                asking.keys.retain(is_kept);
            }
        }
    }

    /// Returns when something is due next.
    pub(super) fn next(&self) -> Option<Instant> {
        let times = self.0.values().flat_map(|copied| {
            let retry = copied
                .retry_at
                .filter(|_| !copied.runs.is_empty() && copied.asking.is_none());
            [retry, copied.without.map(|since| since + FORGOTTEN_AFTER)]
        });
        times.flatten().min()
    }
}

impl Copied {
    fn on_presence(&mut self, now: Instant) {
        self.without = match self.presence > 0 && self.runs.is_empty() {
            true => self.without.or(Some(now)),
            false => None,
        };
    }
}

fn question(own: &Name, adds: bool, since: Option<Position>, keys: &[OwnedKeyExpr]) -> Question {
    Question::Since {
        by: Some(own.to_string()),
        adds,
        since,
        keys: keys.iter().map(ToString::to_string).collect(),
    }
}

/// Returns whether a key expression selects topics of a robot.
pub(super) fn is_of(fleet: &Name, robot: &Name, key: &keyexpr) -> bool {
    let topics = format!("{fleet}/{robot}/**");
    keyexpr::new(&topics).is_ok_and(|topics| topics.intersects(key))
}
