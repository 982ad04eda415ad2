//! Asks for what the survey cannot do itself: moving the robots, and switching radios.
use std::{
    fmt,
    io::{self, IsTerminal},
    path::PathBuf,
    time::Instant,
};

use rect_terminal::{paint_err, Style};
use tokio::{process::Command, task::spawn_blocking};

use super::label::Label;
use crate::Failure;

/// The one who carries out the steps.
pub enum Guide {
    /// The person at the terminal.
    Person,
    /// A program, which gets the step as its arguments.
    Program(PathBuf),
    /// Nobody: all steps are skipped.
    Nobody,
}

/// A step that the survey asks for.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    Place(Label),
    RadioOff,
    RadioOn,
    WifiOff,
    WifiOn,
}

impl Step {
    /// Returns the arguments for a program.
    fn arguments(&self) -> [String; 2] {
        let [what, how] = match self {
            Self::Place(label) => return ["place".to_owned(), label.argument()],
            Self::RadioOff => ["radio", "off"],
            Self::RadioOn => ["radio", "on"],
            Self::WifiOff => ["wifi", "off"],
            Self::WifiOn => ["wifi", "on"],
        };
        [what.to_owned(), how.to_owned()]
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Place(label) => write!(f, "Put the two robots like this: {label}."),
            Self::RadioOff => f.write_str(
                "Switch Bluetooth off on one robot: `sudo rfkill block bluetooth`.",
            ),
            Self::RadioOn => f.write_str(
                "Switch it on again: `sudo rfkill unblock bluetooth`. Press Enter as soon as it is done.",
            ),
            Self::WifiOff => f.write_str(
                "Switch the Wi-Fi off on one robot: `sudo rfkill block wifi`. Not if your terminal uses it.",
            ),
            Self::WifiOn => f.write_str("Switch the Wi-Fi on again: `sudo rfkill unblock wifi`."),
        }
    }
}

impl Guide {
    /// Has a step carried out. Returns from when on its effects are expected: since the program was started, or since the person
    /// has pressed Enter. `None` if the step is skipped.
    pub async fn ask(&self, step: &Step) -> Result<Option<Instant>, Failure> {
        match self {
            Self::Nobody => Ok(None),
            Self::Program(program) => {
                let arguments = step.arguments();
                super::say(&format!("{} {}", program.display(), arguments.join(" ")));
                let began = Instant::now();
                let status = Command::new(program).args(arguments).status().await;
                let status =
                    status.map_err(|error| format!("cannot run {}: {error}", program.display()))?;
                Ok(status.success().then_some(began))
            }
            Self::Person => {
                if !io::stdin().is_terminal() {
                    return Err(
                        "the survey asks at a terminal: use --by or --here without one".into(),
                    );
                }
                let question = paint_err(Style::Heading, &step.to_string());
                rect_terminal::errln!(
                    "\n{question} Then press Enter (s and Enter: skip this step)"
                );
                let answer = spawn_blocking(|| {
                    let mut line = String::new();
                    io::stdin().read_line(&mut line).map(|_| line)
                });
                let is_skipped = answer.await??.trim().eq_ignore_ascii_case("s");
                Ok((!is_skipped).then(Instant::now))
            }
        }
    }
}
