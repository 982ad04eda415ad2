//! Owns the file of connections on disk: read whole, replaced whole. Whenever the power goes, the old text or the new one
//! is there afterwards, never a part.
use std::{
    ffi::OsString,
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
};

use sha2::{Digest, Sha256};

use super::file::MAX_BYTES;
use crate::regular_file;

/// The name of the temporary file for a new text begins with this, the file's own name and a dash.
const NEW: &str = ".new-";
/// How many characters follow, chosen at random.
const RANDOM: usize = 6;

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
        match regular_file::read_to_string(&self.path, MAX_BYTES) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(String::new()),
            read => read,
        }
    }

    /// Removes what a process left that was killed while it replaced the file.
    pub fn remove_leftovers(&self) -> io::Result<usize> {
        let Place { folder, new, .. } = self.place()?;
        let new = new.into_encoded_bytes();
        let mut removed = 0;
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            let name = entry.file_name().into_encoded_bytes();
            let is_left = name
                .strip_prefix(&new[..])
                .is_some_and(|random| random.len() == RANDOM);
            if is_left && entry.file_type()?.is_file() {
                fs::remove_file(entry.path())?;
                removed += 1;
            }
        }
        Ok(removed)
    }

    /// Returns where the file is. Where its path is a symbolic link, that is the place the link leads to: the link stays.
    fn place(&self) -> io::Result<Place> {
        let path = match fs::canonicalize(&self.path) {
            Ok(path) => path,
            // There is no file yet; a link may say where it is to be.
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                match fs::read_link(&self.path) {
                    Ok(target) => self.path.parent().unwrap_or(Path::new("/")).join(target),
                    Err(_) => self.path.clone(),
                }
            }
            Err(error) => return Err(error),
        };
        let mut new = OsString::from(NEW);
        new.push(path.file_name().unwrap_or_default());
        new.push("-");
        let folder = match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
            _ => PathBuf::from("."),
        };
        Ok(Place { path, folder, new })
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
        let Place { path, folder, new } = self.place()?;
        if fs::metadata(&path).is_ok_and(|there| !there.is_file()) {
            let what = "it is not a regular file, and is not replaced";
            return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
        }
        let mut new = tempfile::Builder::new()
            .prefix(&new)
            .rand_bytes(RANDOM)
            .tempfile_in(&folder)?;
        if let Ok(before) = fs::metadata(&path) {
            new.as_file().set_permissions(before.permissions())?;
        }
        after(Step::Created)?;
        new.write_all(text.as_bytes())?;
        after(Step::Written)?;
        new.as_file().sync_all()?;
        after(Step::OnDisk)?;
        new.persist(&path).map_err(|error| error.error)?;
        after(Step::InPlace)?;
        // The name is on disk only when its folder is.
        File::open(&folder)?.sync_all()?;
        after(Step::Recorded)
    }
}

/// Where the file is, and how what is to replace it is called before.
struct Place {
    path: PathBuf,
    folder: PathBuf,
    new: OsString,
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
    fn a_symbolic_link_stays_and_its_file_is_replaced() {
        let folder = tempfile::tempdir().expect("a folder");
        let real = folder.path().join("real");
        fs::create_dir(&real).expect("a folder");
        let (file, link) = (
            real.join("list.json"),
            folder.path().join("connections.json"),
        );
        std::os::unix::fs::symlink("real/list.json", &link).expect("a link");
        let store = Store::new(&link);
        // First there is no file yet.
        for text in ["first", "second"] {
            store.replace(text).expect("written");
            assert!(fs::symlink_metadata(&link).expect("there").is_symlink());
            assert_eq!(fs::read_to_string(&file).expect("there"), text);
        }
    }

    #[test]
    fn leftovers_of_a_killed_process_are_removed_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a folder");
        let in_folder = |name: &str| folder.path().join(name);
        let store = Store::new(&in_folder("connections.json"));
        store.replace("text").expect("written");
        let others = [
            "connections.json",
            ".new-connections.json",
            ".new-connections.json-longer-name",
            ".new-other.json-abc123",
            "users",
        ];
        for name in others {
            fs::write(in_folder(name), "text").expect("written");
        }
        fs::write(in_folder(".new-connections.json-aBc123"), "half a te").expect("written");
        assert_eq!(store.remove_leftovers().expect("removed"), 1);
        assert!(others.iter().all(|name| in_folder(name).exists()));
        assert_eq!(
            fs::read_dir(folder.path()).expect("there").count(),
            others.len()
        );
    }

    #[test]
    fn a_pipe_in_its_place_is_neither_read_nor_replaced() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("connections.json");
        nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).expect("a pipe");
        let store = Store::new(&path);
        assert!(store.read().is_err() && store.replace("text").is_err());
        assert!(!fs::metadata(&path).expect("there").is_file());
    }

    #[test]
    fn texts_differ_by_their_revision() {
        assert_eq!(revision("a"), revision("a"));
        assert_ne!(revision("a"), revision("b"));
        assert_eq!(revision("").len(), 16);
    }
}
