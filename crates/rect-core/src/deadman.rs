//! A dead man's switch: decides whether a robot follows the commands of its commander, and when it has lost them.
//!
//! It is lost before the first command, when none arrives for some time, when the commander cannot be reached, and while the fleet is
//! [stopped](crate::stop). After a stop, commands count only once a neutral one has arrived: the release alone moves nothing, and a stick
//! that somebody still holds does not either.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use serde_json::Value;

use crate::{
    message::{payload::Payload, Message},
    name::Name,
    text::humanize,
};

/// The shortest time without commands after which a commander is lost.
pub const MIN_WITHIN: Duration = Duration::from_millis(20);
/// The longest one.
pub const MAX_WITHIN: Duration = Duration::from_secs(60);

/// Why the commander is lost when the switch ends.
pub const ENDED: &str = "the dead man's switch has ended";
/// How long a robot follows after a program of its commander has ended.
const PROGRAM_GONE: Duration = Duration::from_millis(100);
/// How long the commands of a robot that has returned do not count: meanwhile its router sends the stops that were pressed since.
const RETURNING: Duration = Duration::from_millis(500);
/// The maximum number of robots that are remembered as unreachable.
const MAX_ROBOTS: usize = 256;

/// Whether a robot follows its commander.
#[derive(Debug)]
pub struct Deadman {
    within: Duration,
    /// When the commander is lost; `None` while it is.
    deadline: Option<Instant>,
    commander: Option<Name>,
    /// The robots that cannot be reached, or have returned, and then when their commands count.
    away: BTreeMap<Name, Option<Instant>>,
    is_stopped: bool,
    needs_neutral: bool,
    /// Why the commander was lost, until the program is notified.
    lost: Option<String>,
}

impl Deadman {
    /// Creates a switch, which begins as lost. `within`: how long the robot follows without another command.
    ///
    /// # Errors
    /// Returns why the time is invalid.
    pub fn new(within: Duration) -> Result<Self, String> {
        if !(MIN_WITHIN..=MAX_WITHIN).contains(&within) {
            return Err("it must be between 0.02 and 60 seconds".to_owned());
        }
        Ok(Self {
            within,
            deadline: None,
            commander: None,
            away: BTreeMap::new(),
            is_stopped: false,
            needs_neutral: false,
            lost: Some("no command has arrived yet".to_owned()),
        })
    }

    /// Returns whether a command counts, so that the program may carry it out. A retained or replayed message and one without a value
    /// never do.
    pub fn on_command<T>(&mut self, now: Instant, message: &Message<T>) -> bool {
        if message.retained.is_some() || message.replayed || message.problem().is_some() {
            return false;
        }
        if self.is_stopped || self.is_away(now, &message.sender) {
            return false;
        }
        if self.needs_neutral {
            if !is_neutral(&message.payload) {
                return false;
            }
            self.needs_neutral = false;
        }
        if self.commander.as_ref() != Some(&message.sender) {
            self.commander = Some(message.sender.clone());
        }
        self.deadline = Some(now + self.within);
        true
    }

    /// Handles that a robot cannot be reached any more.
    pub fn on_gone(&mut self, robot: &Name) {
        if self.commander.as_ref() == Some(robot) {
            self.lose(|| format!("{robot} cannot be reached"));
        }
        if self.away.len() < MAX_ROBOTS {
            self.away.insert(robot.clone(), None);
        }
    }

    /// Handles that a robot can be reached again. Its commands count a moment later: before, it may have pressed a stop that is not known
    /// here.
    pub fn on_returned(&mut self, now: Instant, robot: &Name) {
        if let Some(until) = self.away.get_mut(robot) {
            until.get_or_insert(now + RETURNING);
        }
    }

    fn is_away(&mut self, now: Instant, robot: &Name) -> bool {
        let has_returned = match self.away.get(robot) {
            None => return false,
            Some(until) => until.is_some_and(|until| until <= now),
        };
        if has_returned {
            self.away.remove(robot);
        }
        !has_returned
    }

    /// Handles that a program of a robot has ended. It may be another one than the commander, whose next command is soon due then.
    pub fn on_program_gone(&mut self, now: Instant, robot: &Name) {
        if self.commander.as_ref() == Some(robot) {
            let soon = now + PROGRAM_GONE;
            self.deadline = self.deadline.map(|deadline| deadline.min(soon));
        }
    }

    /// Handles that the fleet was stopped, for this reason, or released (`None`).
    pub fn on_stop(&mut self, stopped: Option<String>) {
        self.is_stopped = stopped.is_some();
        if let Some(reason) = stopped {
            self.needs_neutral = true;
            self.lose(|| reason);
        }
    }

    /// Returns why the commander was lost, once for each loss. Call it after each event, and at the [`deadline`](Self::deadline).
    pub fn poll(&mut self, now: Instant) -> Option<String> {
        if self.deadline.is_some_and(|deadline| deadline <= now) {
            let within = humanize::duration(self.within);
            match self.commander.take() {
                Some(robot) => self.lose(|| format!("no command of {robot} for {within}")),
                None => self.lose(|| format!("no command for {within}")),
            }
        }
        self.lost.take()
    }

    /// Returns when to call [`poll`](Self::poll) if nothing happens before.
    pub fn deadline(&self) -> Option<Instant> {
        self.deadline
    }

    /// Returns whether the robot follows commands.
    pub fn is_following(&self) -> bool {
        self.deadline.is_some()
    }

    /// Returns whether it waits for a neutral command after a stop.
    pub fn needs_neutral(&self) -> bool {
        self.needs_neutral
    }

    fn lose(&mut self, reason: impl FnOnce() -> String) {
        if self.deadline.take().is_some() {
            self.lost = Some(reason());
        }
    }
}

/// Returns whether a command moves nothing: all its numbers are 0, and nothing in it is true. Of bytes that are neither JSON nor CBOR,
/// all are 0.
pub fn is_neutral(payload: &Payload) -> bool {
    match payload.value::<Value>() {
        Ok(value) => is_zero(&value),
        Err(_) => payload.bytes.iter().all(|byte| *byte == 0),
    }
}

fn is_zero(value: &Value) -> bool {
    match value {
        Value::Null | Value::Bool(false) => true,
        Value::Bool(true) => false,
        Value::Number(number) => number.as_f64() == Some(0.0),
        // A text such as "stop" says nothing about numbers, except for one that is a number.
        Value::String(text) => text
            .trim()
            .parse()
            .map_or(true, |number: f64| number == 0.0),
        Value::Array(values) => values.iter().all(is_zero),
        Value::Object(fields) => fields.values().all(is_zero),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{
        payload::{Json, ToPayload},
        retained::Retained,
    };

    fn command(sender: &str, value: impl serde::Serialize) -> Message {
        Message::new(
            Name::new(sender).expect("valid"),
            "drive".parse().expect("valid"),
            Json(value).to_payload().expect("valid"),
        )
    }

    fn switch() -> (Deadman, Instant) {
        (
            Deadman::new(Duration::from_millis(300)).expect("valid"),
            Instant::now(),
        )
    }

    fn after(start: Instant, ms: u64) -> Instant {
        start + Duration::from_millis(ms)
    }

    #[test]
    fn it_is_lost_before_the_first_command_and_without_further_ones() {
        let (mut switch, start) = switch();
        assert_eq!(
            switch.poll(start).as_deref(),
            Some("no command has arrived yet")
        );
        assert_eq!(
            (switch.poll(after(start, 10_000)), switch.is_following()),
            (None, false)
        );
        for ms in (10_000..11_000).step_by(100) {
            assert!(switch.on_command(after(start, ms), &command("laptop", [1.0, 1.0])));
            assert_eq!(switch.poll(after(start, ms)), None);
        }
        assert_eq!(switch.deadline(), Some(after(start, 11_200)));
        assert_eq!(switch.poll(after(start, 11_199)), None);
        let lost = switch.poll(after(start, 11_200)).expect("lost");
        assert_eq!(lost, "no command of laptop for 300 ms");
        assert_eq!(
            (switch.poll(after(start, 12_000)), switch.deadline()),
            (None, None)
        );
        // It follows again.
        assert!(switch.on_command(after(start, 12_000), &command("laptop", [1.0, 1.0])));
    }

    #[test]
    fn retained_replayed_and_unreadable_messages_are_no_sign_of_life() {
        let (mut switch, start) = switch();
        let plain = command("laptop", 1.0);
        let retained = Message {
            retained: Some(Retained {
                age: Duration::ZERO,
                has_ended: false,
                is_forgotten: false,
            }),
            ..plain.clone()
        };
        let replayed = Message {
            replayed: true,
            ..plain.clone()
        };
        for message in [retained, replayed] {
            assert!(!switch.on_command(start, &message));
        }
        assert!(!switch.is_following());
        assert!(switch.on_command(start, &plain));
    }

    #[test]
    fn the_commander_may_be_gone_and_another_robot_may_not() {
        let (mut switch, start) = switch();
        switch.poll(start);
        assert!(switch.on_command(start, &command("laptop", 1.0)));
        switch.on_gone(&Name::new("base").expect("valid"));
        assert_eq!(switch.poll(start), None);
        switch.on_gone(&Name::new("laptop").expect("valid"));
        assert_eq!(
            switch.poll(start).as_deref(),
            Some("laptop cannot be reached")
        );
        switch.on_gone(&Name::new("laptop").expect("valid"));
        assert_eq!(switch.poll(start), None);
    }

    #[test]
    fn commands_of_a_robot_that_has_returned_count_a_moment_later() {
        let (mut switch, start) = switch();
        let laptop = Name::new("laptop").expect("valid");
        switch.on_returned(start, &laptop);
        assert!(switch.on_command(start, &command("laptop", 1.0)));
        switch.on_gone(&laptop);
        // A message may arrive before the event.
        assert!(!switch.on_command(after(start, 5000), &command("laptop", 1.0)));
        assert!(switch.on_command(after(start, 5000), &command("base", 1.0)));
        switch.on_returned(after(start, 5000), &laptop);
        switch.on_returned(after(start, 5400), &laptop);
        assert!(!switch.on_command(after(start, 5499), &command("laptop", 1.0)));
        assert!(switch.on_command(after(start, 5500), &command("laptop", 1.0)));
    }

    #[test]
    fn after_the_end_of_a_program_the_next_command_is_due_soon() {
        let mut switch = Deadman::new(Duration::from_secs(5)).expect("valid");
        let (start, laptop) = (Instant::now(), Name::new("laptop").expect("valid"));
        switch.poll(start);
        assert!(switch.on_command(start, &command("laptop", 1.0)));
        switch.on_program_gone(start, &laptop);
        assert_eq!(switch.deadline(), Some(after(start, 100)));
        // It was another one.
        assert!(switch.on_command(after(start, 50), &command("laptop", 1.0)));
        assert_eq!(switch.deadline(), Some(after(start, 5050)));
        switch.on_program_gone(after(start, 50), &laptop);
        assert!(switch.poll(after(start, 150)).is_some());
    }

    #[test]
    fn a_stop_holds_until_it_is_released_and_a_neutral_command_has_arrived() {
        let (mut switch, start) = switch();
        switch.poll(start);
        assert!(switch.on_command(start, &command("laptop", 1.0)));
        switch.on_stop(Some("stopped by base".to_owned()));
        assert_eq!(switch.poll(start).as_deref(), Some("stopped by base"));
        for value in [1.0, 0.0] {
            assert!(!switch.on_command(start, &command("laptop", value)));
        }
        switch.on_stop(None);
        assert!(!switch.on_command(start, &command("laptop", [0.0, 0.1])));
        assert!(switch.needs_neutral() && !switch.is_following());
        assert!(switch.on_command(start, &command("laptop", [0.0, 0.0])));
        assert!(switch.on_command(start, &command("laptop", [0.0, 0.1])));
        assert_eq!(switch.poll(start), None);
    }

    #[test]
    fn a_neutral_command_has_no_number_but_0() {
        let json =
            |text: &str| Payload::new(text.to_owned(), crate::message::encoding::Encoding::JSON);
        for neutral in [
            "0",
            "0.0",
            "-0.0",
            "[0,0]",
            r#"{"left":0,"mode":"arcade","boost":false}"#,
            "null",
        ] {
            assert!(is_neutral(&json(neutral)), "{neutral}");
        }
        for moving in ["1e-9", "[0,-1]", "true", r#"{"a":[{"b":0.1}]}"#] {
            assert!(!is_neutral(&json(moving)), "{moving}");
        }
        let bytes = |bytes: [u8; 4]| {
            Payload::new(bytes.to_vec(), crate::message::encoding::Encoding::BYTES)
        };
        assert!(is_neutral(&bytes([0; 4])) && !is_neutral(&bytes([0, 0, 1, 0])));
    }

    #[test]
    fn times_out_of_range_are_refused() {
        for ms in [0, 19, 60_001] {
            assert!(Deadman::new(Duration::from_millis(ms)).is_err());
        }
    }
}
