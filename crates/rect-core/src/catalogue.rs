//! The catalogue of a robot: which programs run there, and what they serve.
//!
//! Each program has a liveliness token ([`token`]), which ends in a revision. Its services stand in the catalogue alone, which the robot's
//! router keeps ([`keeper`]). Programs register there ([`registration`], [`presence`]), and the registry answers the question
//! `catalogue`. So a service costs no bytes on the air until somebody asks.
pub mod keeper;
pub mod presence;
pub mod registration;
pub mod requester_wait;
pub mod token;

use std::time::Duration;

use serde::{Deserialize, Serialize};

pub use crate::{
    name::{instance::Instance, key::CATALOGUE},
    parameters::MAX_ABOUT,
};
use crate::{
    name::{topic::Topic, Name},
    parameters::Declaration,
};

/// The part after `@rect/` of the key at which a program registers. Access control grants it separately (`@set`).
pub const REGISTER: &str = "@set/program";
/// The time within which something that the catalogue lists can be reached, since it was just declared.
pub const DECLARED_WITHIN: Duration = Duration::from_secs(1);
/// The pause between two attempts to reach it.
pub const PAUSE: Duration = Duration::from_millis(100);
/// The maximum number of programs of a robot.
pub const MAX_PROGRAMS: usize = 64;
/// The maximum number of services of a program.
pub const MAX_SERVICES: usize = 256;
/// The maximum size of a catalogue or a registration, in bytes.
pub const MAX_BYTES: usize = 1 << 20;

/// A service of a program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ServiceEntry {
    /// The topic.
    pub topic: Topic,
    /// Its purpose, in the program's words; empty if there are none.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub about: String,
    /// Whether other programs of the robot may serve the same topic. Then each of them answers.
    #[serde(skip_serializing_if = "is_false")]
    pub several: bool,
    /// The parameters that are changed there, if it is not an ordinary service.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parameters: Option<Declaration>,
}

/// A program of a robot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Program {
    /// The name; `None` if the program has none.
    #[serde(rename = "program", skip_serializing_if = "Option::is_none")]
    pub name: Option<Name>,
    /// The run of the program.
    pub instance: Instance,
    /// The services, in alphabetical order.
    pub services: Vec<ServiceEntry>,
}

/// Why bytes are not a catalogue, or not a registration.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct CatalogueError(String);

/// A program as it stands in a document.
#[derive(Deserialize)]
struct ProgramDocument {
    program: Option<String>,
    instance: String,
    #[serde(default)]
    services: Vec<ServiceDocument>,
}

#[derive(Deserialize)]
struct ServiceDocument {
    topic: String,
    #[serde(default)]
    about: String,
    #[serde(default)]
    several: bool,
    #[serde(default)]
    parameters: Option<Declaration>,
}

impl ServiceDocument {
    fn checked(self) -> Result<ServiceEntry, CatalogueError> {
        let wrong = |error: String| CatalogueError(error);
        let name = self.topic.rsplit('/').next();
        let Some(parameters) = self.parameters else {
            let action = name.and_then(Topic::of_action);
            if let Some(topic) = action.filter(|topic| topic.as_str() == self.topic) {
                return Ok(ServiceEntry::new(topic, &self.about, false));
            }
            let topic = Topic::new(&self.topic).map_err(|error| wrong(error.to_string()))?;
            return Ok(ServiceEntry::new(topic, &self.about, self.several));
        };
        let group = name.and_then(Topic::of_parameters);
        let topic = group.filter(|topic| topic.as_str() == self.topic);
        let topic =
            topic.ok_or_else(|| wrong(format!("{:?} cannot have parameters", self.topic)))?;
        Ok(ServiceEntry {
            parameters: Some(parameters),
            ..ServiceEntry::new(topic, &self.about, false)
        })
    }
}

impl ServiceEntry {
    /// Creates a service; `about` is cut, and its control characters become spaces.
    pub fn new(topic: Topic, about: &str, several: bool) -> Self {
        let printable = |c: char| if c.is_control() { ' ' } else { c };
        let about: String = about.trim().chars().take(MAX_ABOUT).collect();
        Self {
            topic,
            about: about.chars().map(printable).collect(),
            several,
            parameters: None,
        }
    }

    /// Creates a group of parameters. `None` if its name is invalid.
    pub fn of_parameters(group: &str, about: &str, declaration: Declaration) -> Option<Self> {
        Some(Self {
            parameters: Some(declaration),
            ..Self::new(Topic::of_parameters(group)?, about, false)
        })
    }

    /// Creates an action. `None` if its name is invalid.
    pub fn of_action(action: &str, about: &str) -> Option<Self> {
        Some(Self::new(Topic::of_action(action)?, about, false))
    }

    /// Returns whether two services cannot exist at the same time, because they have one topic and do not both allow that.
    pub fn excludes(&self, other: &Self) -> bool {
        self.topic == other.topic && !(self.several && other.several)
    }
}

impl Program {
    /// Reads the registration of a program.
    ///
    /// # Errors
    /// Returns the reason why the bytes are not one.
    pub fn read(bytes: &[u8]) -> Result<Self, CatalogueError> {
        Self::checked(parsed(bytes)?)
    }

    /// Returns the registration as JSON.
    pub fn to_json(&self) -> String {
        // Names, numbers and texts can always be serialized.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Adds a service, in alphabetical order.
    pub(crate) fn add(&mut self, service: ServiceEntry) {
        let comes_before = |other: &ServiceEntry| other.topic.as_str() < service.topic.as_str();
        let at = self.services.partition_point(comes_before);
        self.services.insert(at, service);
    }

    /// Returns the program's groups of parameters with their declarations.
    pub fn parameters(&self) -> impl Iterator<Item = (&str, &Declaration)> {
        let services = self.services.iter();
        services
            .filter_map(|service| Some((service.topic.parameters()?, service.parameters.as_ref()?)))
    }

    /// Returns the program's actions with their descriptions.
    pub fn actions(&self) -> impl Iterator<Item = (&str, &str)> {
        let services = self.services.iter();
        services.filter_map(|service| Some((service.topic.action()?, service.about.as_str())))
    }

    /// Returns the program's services for requests.
    pub fn requestable(&self) -> impl Iterator<Item = &ServiceEntry> {
        let is_ordinary = |service: &&ServiceEntry| {
            service.parameters.is_none() && service.topic.action().is_none()
        };
        self.services.iter().filter(is_ordinary)
    }

    /// Returns whether the program serves a topic.
    pub fn serves(&self, topic: &Topic) -> bool {
        self.services.iter().any(|service| service.topic == *topic)
    }

    /// Returns the name, or the text for a program without one.
    pub fn title(&self) -> &str {
        self.name
            .as_ref()
            .map_or("a program without a name", Name::as_str)
    }

    fn checked(document: ProgramDocument) -> Result<Self, CatalogueError> {
        if document.services.len() > MAX_SERVICES {
            let count = document.services.len();
            return Err(CatalogueError(format!(
                "a program has {count} services, and at most {MAX_SERVICES} are allowed"
            )));
        }
        let name = document.program.as_deref().map(Name::new).transpose();
        let services = document.services.into_iter().map(ServiceDocument::checked);
        let services = services.collect::<Result<Vec<_>, _>>();
        Ok(Self {
            name: name.map_err(|error| CatalogueError(error.to_string()))?,
            instance: Instance::parse(&document.instance)
                .ok_or_else(|| CatalogueError("an instance has 8 hexadecimal digits".to_owned()))?,
            services: services?,
        })
    }
}

/// Reads the catalogue of a robot: its programs, in the order in which they began.
///
/// # Errors
/// Returns the reason why the bytes are not one.
pub fn read(bytes: &[u8]) -> Result<Vec<Program>, CatalogueError> {
    let documents: Vec<ProgramDocument> = parsed(bytes)?;
    if documents.len() > MAX_PROGRAMS {
        let count = documents.len();
        return Err(CatalogueError(format!(
            "it has {count} programs, and at most {MAX_PROGRAMS} are allowed"
        )));
    }
    documents.into_iter().map(Program::checked).collect()
}

fn parsed<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Result<T, CatalogueError> {
    if bytes.len() > MAX_BYTES {
        return Err(CatalogueError(format!(
            "it has {} bytes, and at most {MAX_BYTES} are allowed",
            bytes.len()
        )));
    }
    serde_json::from_slice(bytes).map_err(|error| CatalogueError(error.to_string()))
}

#[allow(clippy::trivially_copy_pass_by_ref)] // serde's form.
fn is_false(value: &bool) -> bool {
    !value
}

/// Names of files that say nothing about a program: interpreters, test runners, and this project's commands.
const UNNAMED: [&str; 9] = [
    "",
    "-",
    "-c",
    "python",
    "pytest",
    "ipython",
    "ipykernel_launcher",
    "__main__",
    "rect",
];

/// The environment variable with the name of a program, which `rect run` sets.
pub const PROGRAM_VARIABLE: &str = "RECT_PROGRAM";

/// Returns the name of a program whose executable or script is `file`. `None` for interpreters and test runners, and if nothing of a
/// name remains. Characters that names do not allow become `-`.
pub fn program_name(file: &str) -> Option<Name> {
    let mut parts = file.rsplit(['/', '\\']);
    let stem = parts.next()?;
    // The tests that Cargo builds.
    if parts.next() == Some("deps") {
        return None;
    }
    let stem = stem.strip_suffix(".py").unwrap_or(stem);
    let stem = stem.strip_suffix(".exe").unwrap_or(stem);
    let is_version = |c: char| c.is_ascii_digit() || c == '.';
    if UNNAMED.contains(&stem.trim_end_matches(is_version)) {
        return None;
    }
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    let name: String = stem
        .chars()
        .map(|c| if allowed(c) { c } else { '-' })
        .take(crate::name::MAX_BYTES)
        .collect();
    Name::new(&name).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn program() -> Program {
        let service = |topic, about, several| {
            ServiceEntry::new(Topic::new(topic).expect("valid"), about, several)
        };
        Program {
            name: Some(Name::new("arm").expect("valid")),
            instance: Instance(0x1f),
            services: vec![
                service("grab", "closes the gripper", false),
                service("look", "", true),
            ],
        }
    }

    #[test]
    fn registrations_round_trip_and_leave_out_what_is_usual() {
        let json = program().to_json();
        assert_eq!(
            json,
            r#"{"program":"arm","instance":"0000001f","services":[{"topic":"grab","about":"closes the gripper"},{"topic":"look","several":true}]}"#
        );
        assert_eq!(Program::read(json.as_bytes()), Ok(program()));
        assert_eq!(read(format!("[{json}]").as_bytes()), Ok(vec![program()]));
        let unnamed = Program::read(br#"{"instance":"0000001F"}"#).expect("valid");
        assert_eq!((unnamed.name, unnamed.services.len()), (None, 0));
    }

    #[test]
    fn wrong_documents_are_rejected_with_a_reason() {
        let many = |count| {
            format!(
                r#"{{"instance":"0000001f","services":[{}]}}"#,
                vec![r#"{"topic":"a"}"#; count].join(",")
            )
        };
        assert!(Program::read(many(MAX_SERVICES).as_bytes()).is_ok());
        for (wrong, reason) in [
            (many(MAX_SERVICES + 1), "at most 256"),
            (" ".repeat(MAX_BYTES + 1), "at most 1048576"),
            (
                r#"{"instance":"+000001f"}"#.to_owned(),
                "8 hexadecimal digits",
            ),
            (
                r#"{"instance":"0000001f","services":[{"topic":"a*"}]}"#.to_owned(),
                "a*",
            ),
            (
                r#"{"instance":"0000001f","program":"a b"}"#.to_owned(),
                "a b",
            ),
            (String::new(), "EOF"),
        ] {
            let error = Program::read(wrong.as_bytes()).expect_err(reason);
            assert!(error.to_string().contains(reason), "{error}");
        }
        let programs = vec![program().to_json(); MAX_PROGRAMS + 1];
        assert!(read(format!("[{}]", programs.join(",")).as_bytes()).is_err());
    }

    #[test]
    fn descriptions_are_short_and_printable() {
        let topic = || Topic::new("grab").expect("valid");
        assert_eq!(
            ServiceEntry::new(topic(), " a\nb\u{1b}[31m ", false).about,
            "a b [31m"
        );
        let long = ServiceEntry::new(topic(), &"ä".repeat(300), false).about;
        assert_eq!(long.chars().count(), MAX_ABOUT);
    }

    #[test]
    fn programs_are_named_by_their_file_except_for_interpreters() {
        for (file, name) in [
            ("/home/kipr/arm.py", Some("arm")),
            ("target/debug/arm drive", Some("arm-drive")),
            (r"C:\robots\arm.exe", Some("arm")),
            ("/usr/bin/python3.11", None),
            ("python3", None),
            ("/usr/bin/pytest", None),
            ("-c", None),
            ("rect", None),
            ("target/checked/deps/behaviour-1234", None),
            ("hci0", None),
        ] {
            assert_eq!(
                program_name(file).as_ref().map(Name::as_str),
                name,
                "{file}"
            );
        }
    }
}
