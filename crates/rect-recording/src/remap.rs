//! Replays a recording under other names.
use std::str::FromStr;

/// Replaces a robot, or a robot and the beginning of a topic: `wombat-1=wombat-9`, `wombat-1/arm=wombat-1/gripper`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remap {
    before: String,
    after: String,
}

/// The text is not a replacement of names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("write FROM=TO, such as wombat-1=wombat-9 or wombat-1/arm=wombat-1/gripper")]
pub struct RemapError;

impl FromStr for Remap {
    type Err = RemapError;

    fn from_str(text: &str) -> Result<Self, RemapError> {
        let (before, after) = text.split_once('=').ok_or(RemapError)?;
        let [before, after] = [before, after].map(|name| name.trim_matches('/').to_owned());
        if before.is_empty() || after.is_empty() {
            return Err(RemapError);
        }
        Ok(Self { before, after })
    }
}

impl Remap {
    /// Returns the new form of `<robot>/<topic>`. `None`: it does not begin with what is replaced.
    fn replaced(&self, topic: &str) -> Option<String> {
        let rest = topic.strip_prefix(&self.before)?;
        (rest.is_empty() || rest.starts_with('/')).then(|| format!("{}{rest}", self.after))
    }
}

/// Returns `<robot>/<topic>` in the form that the first matching replacement gives it.
pub fn remapped(remaps: &[Remap], topic: &str) -> String {
    let topic = topic.trim_start_matches('/');
    let replaced = remaps.iter().find_map(|remap| remap.replaced(topic));
    replaced.unwrap_or_else(|| topic.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_matching_replacement_is_applied_to_whole_parts() {
        let remaps = ["a/arm=a/gripper", "a=z", "b/x=c/y"].map(|text| text.parse().expect(text));
        for (topic, expected) in [
            ("a/arm/angle", "a/gripper/angle"),
            ("a/army", "z/army"),
            ("b/x", "c/y"),
            ("b/xy", "b/xy"),
            ("/a/b", "z/b"),
        ] {
            assert_eq!(remapped(&remaps, topic), expected);
        }
    }

    #[test]
    fn incomplete_replacements_are_refused() {
        for text in ["", "a", "=", "a=", "=b", "/=b"] {
            assert_eq!(text.parse::<Remap>(), Err(RemapError), "{text}");
        }
    }
}
