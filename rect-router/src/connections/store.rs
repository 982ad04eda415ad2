//! Owns the file of connections on disk: read whole, replaced whole. Whenever the power goes, the old text or the new one
//! is there afterwards, never a part.
use std::{
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
};

use sha2::{Digest, Sha256};

/// Where a replacement may be cut off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Created,
    Written,
    OnDisk,
    InPlace,
    Recorded,
}

/// A file that is replaced as a whole.
pub struct Store {
    path: PathBuf,
}

impl Store {
    /// The file may be missing until something is put into it.
    pub fn new(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
        }
    }

    /// Its text, empty where there is no file.
    pub fn read(&self) -> io::Result<String> {
        match fs::read_to_string(&self.path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(String::new()),
            read => read,
        }
    }

    /// Puts this text in its place.
    pub fn replace(&self, text: &str) -> io::Result<()> {
        self.replace_in_steps(text, |_| Ok(()))
    }

    /// `after` is asked after each step; an error cuts it off there.
    fn replace_in_steps(
        &self,
        text: &str,
        mut after: impl FnMut(Step) -> io::Result<()>,
    ) -> io::Result<()> {
        let folder = self.path.parent().unwrap_or(Path::new("/"));
        let mut new = tempfile::Builder::new()
            .prefix(".connections-")
            .tempfile_in(folder)?;
        if let Ok(before) = fs::metadata(&self.path) {
            new.as_file().set_permissions(before.permissions())?;
        }
        after(Step::Created)?;
        new.write_all(text.as_bytes())?;
        after(Step::Written)?;
        new.as_file().sync_all()?;
        after(Step::OnDisk)?;
        new.persist(&self.path).map_err(|error| error.error)?;
        after(Step::InPlace)?;
        // The name is on disk only when its folder is.
        File::open(folder)?.sync_all()?;
        after(Step::Recorded)
    }
}

/// What tells one text from another, for `expect=`.
pub fn revision(text: &str) -> String {
    let digest = Sha256::digest(text.as_bytes());
    digest
        .iter()
        .take(8)
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn cut_off_at_any_step_the_old_text_or_the_new_one_is_there() {
        use Step::{Created, InPlace, OnDisk, Recorded, Written};
        for cut in [Created, Written, OnDisk, InPlace, Recorded] {
            let folder = tempfile::tempdir().expect("a folder");
            let store = Store::new(&folder.path().join("connections.json"));
            assert_eq!(store.read().expect("nothing yet"), "");
            store.replace("old").expect("written");
            let cut_off = store.replace_in_steps("new", |step| match step == cut {
                true => Err(io::Error::other("the power is gone")),
                false => Ok(()),
            });
            assert!(cut_off.is_err());
            let is_new = matches!(cut, InPlace | Recorded);
            assert_eq!(
                store.read().expect("there"),
                if is_new { "new" } else { "old" }
            );
            // And whatever was left behind is in nobody's way.
            store.replace("newer").expect("written");
            assert_eq!(store.read().expect("there"), "newer");
        }
    }

    #[test]
    fn who_may_read_the_file_stays() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("connections.json");
        let store = Store::new(&path);
        store.replace("old").expect("written");
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).expect("set");
        store.replace("new").expect("written");
        let mode = fs::metadata(&path).expect("there").permissions().mode();
        assert_eq!(mode & 0o777, 0o640);
    }

    #[test]
    fn texts_differ_by_their_revision() {
        assert_eq!(revision("a"), revision("a"));
        assert_ne!(revision("a"), revision("b"));
        assert_eq!(revision("").len(), 16);
    }
}
