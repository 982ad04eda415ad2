//! The folder in which programs of a user keep what they remember.
use std::{ffi::OsString, path::PathBuf};

/// Returns `<folder>/rect/<rest>`. The folder is that of the user's state (`XDG_STATE_HOME`, else `~/.local/state`). `None` if neither
/// `XDG_STATE_HOME` nor `HOME` is set. `variable` returns an environment variable.
pub fn state_folder(rest: &str, variable: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let folder = |name| {
        let value = variable(name).filter(|value| !value.is_empty());
        value.map(PathBuf::from)
    };
    let home = || Some(folder("HOME")?.join(".local/state"));
    let state = folder("XDG_STATE_HOME").or_else(home);
    Some(state?.join("rect").join(rest))
}
