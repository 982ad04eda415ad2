//! Names a place: the distance of the two robots, and whether a person stands between them.
use std::{fmt, str::FromStr};

use serde::{Serialize, Serializer};

/// Largest distance that is accepted, in metres.
const MAX_M: f64 = 10_000.0;

/// Where the two robots are.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    pub text: String,
    /// The distance of the robots, if it is known, in metres.
    pub distance_m: Option<f64>,
    /// Whether a person stands between them.
    pub behind_body: bool,
}

/// The text is not a place.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("{0:?} is not a place; write a distance in metres, such as 5m, or 5m+body with a person in between")]
pub struct ParseLabelError(String);

impl Label {
    /// Returns a place without a distance.
    pub fn named(text: &str) -> Self {
        Self {
            text: text.to_owned(),
            distance_m: None,
            behind_body: false,
        }
    }

    /// Returns the text that is parsed as this place.
    pub fn argument(&self) -> String {
        match (self.distance_m, self.behind_body) {
            (Some(m), false) => format!("{m}m"),
            (Some(m), true) => format!("{m}m+body"),
            (None, _) => self.text.clone(),
        }
    }
}

impl FromStr for Label {
    type Err = ParseLabelError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let wrong = || ParseLabelError(text.to_owned());
        let (distance, behind_body) = match text.strip_suffix("+body") {
            Some(distance) => (distance, true),
            None => (text, false),
        };
        let metres = distance.strip_suffix('m').ok_or_else(wrong)?;
        let metres: f64 = metres.trim().parse().map_err(|_| wrong())?;
        if !(metres > 0.0 && metres <= MAX_M) {
            return Err(wrong());
        }
        let body = if behind_body {
            ", a person in between"
        } else {
            ""
        };
        Ok(Self {
            text: format!("{metres} m apart{body}"),
            distance_m: Some(metres),
            behind_body,
        })
    }
}

impl fmt::Display for Label {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl Serialize for Label {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_distances() {
        let far: Label = "30m".parse().expect("a place");
        assert_eq!((far.distance_m, far.behind_body), (Some(30.0), false));
        let body: Label = "5m+body".parse().expect("a place");
        assert_eq!(body.text, "5 m apart, a person in between");
        for label in [far, body] {
            assert_eq!(label.argument().parse(), Ok(label));
        }
        for wrong in [
            "", "5", "m", "-1m", "nanm", "infm", "5 km", "99999m", "5m+wall",
        ] {
            assert!(wrong.parse::<Label>().is_err(), "{wrong}");
        }
    }
}
