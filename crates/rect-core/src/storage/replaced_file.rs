//! Reads and replaces a small file atomically: after a power failure at any moment, the file has either the old text or the new one.
use std::{
    ffi::OsString,
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
};

use super::regular_file;

/// Prefix of the name of a temporary file, followed by the name of the file that it replaces and a dash.
const TEMPORARY_PREFIX: &str = ".new-";
/// Number of random characters at the end of the name of a temporary file.
const RANDOM_CHARACTERS: usize = 6;

/// The steps of a replacement, after each of which it may be interrupted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Created,
    Written,
    OnDisk,
    InPlace,
    Recorded,
}

/// A file that is replaced as a whole.
#[derive(Clone, Debug)]
pub struct ReplacedFile {
    path: PathBuf,
}

impl ReplacedFile {
    /// Names the file at `path`, which need not exist yet.
    pub fn new(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
        }
    }

    /// Returns the path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the text of the file; an empty text if there is no file.
    ///
    /// # Errors
    /// Fails if the file is not a regular file, cannot be read, or is larger than `max_bytes`.
    pub fn read(&self, max_bytes: u64) -> io::Result<String> {
        match regular_file::read_to_string(&self.path, max_bytes) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(String::new()),
            read => read,
        }
    }

    /// Removes the temporary files of processes that were killed during a replacement, and returns their number.
    ///
    /// # Errors
    /// Fails if the folder cannot be read or a file cannot be removed.
    pub fn remove_leftovers(&self) -> io::Result<usize> {
        let Target { folder, prefix, .. } = self.target()?;
        let prefix = prefix.into_encoded_bytes();
        let mut removed = 0;
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            let name = entry.file_name().into_encoded_bytes();
            let is_left = name
                .strip_prefix(&prefix[..])
                .is_some_and(|random| random.len() == RANDOM_CHARACTERS);
            if is_left && entry.file_type()?.is_file() {
                fs::remove_file(entry.path())?;
                removed += 1;
            }
        }
        Ok(removed)
    }

    /// Returns the location of the file. If its path is a symbolic link, that is the location the link leads to, so that the
    /// link itself is kept.
    fn target(&self) -> io::Result<Target> {
        let path = match fs::canonicalize(&self.path) {
            Ok(path) => path,
            // There is no file yet, but a link may lead to its future location.
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                match fs::read_link(&self.path) {
                    Ok(target) => self.path.parent().unwrap_or(Path::new("/")).join(target),
                    Err(_) => self.path.clone(),
                }
            }
            Err(error) => return Err(error),
        };
        let mut prefix = OsString::from(TEMPORARY_PREFIX);
        prefix.push(path.file_name().unwrap_or_default());
        prefix.push("-");
        let folder = match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
            _ => PathBuf::from("."),
        };
        Ok(Target {
            path,
            folder,
            prefix,
        })
    }

    /// Replaces the text of the file, or its bytes.
    ///
    /// # Errors
    /// Fails if the file is not a regular file or cannot be written. The file has its old text then, unless only the last step
    /// failed, which makes the replacement durable.
    pub fn replace(&self, text: impl AsRef<[u8]>) -> io::Result<()> {
        self.replace_in_steps(text.as_ref(), |_| Ok(()))
    }

    /// Replaces the text. Calls `after` after each step; if it returns an error, the replacement stops there.
    fn replace_in_steps(
        &self,
        text: &[u8],
        mut after: impl FnMut(Step) -> io::Result<()>,
    ) -> io::Result<()> {
        let Target {
            path,
            folder,
            prefix,
        } = self.target()?;
        if fs::metadata(&path).is_ok_and(|existing| !existing.is_file()) {
            let problem = "it is not a regular file, and is not replaced";
            return Err(io::Error::new(io::ErrorKind::InvalidInput, problem));
        }
        let mut new = tempfile::Builder::new()
            .prefix(&prefix)
            .rand_bytes(RANDOM_CHARACTERS)
            .tempfile_in(&folder)?;
        if let Ok(before) = fs::metadata(&path) {
            new.as_file().set_permissions(before.permissions())?;
        }
        after(Step::Created)?;
        new.write_all(text)?;
        after(Step::Written)?;
        new.as_file().sync_all()?;
        after(Step::OnDisk)?;
        new.persist(&path).map_err(|error| error.error)?;
        after(Step::InPlace)?;
        // The new name is durable only once the folder is written, too.
        File::open(&folder)?.sync_all()?;
        after(Step::Recorded)
    }
}

/// The location of the file, and the prefix of the name of the temporary file that replaces it.
struct Target {
    path: PathBuf,
    folder: PathBuf,
    prefix: OsString,
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn an_interruption_at_any_step_leaves_the_old_text_or_the_new_one() {
        use Step::{Created, InPlace, OnDisk, Recorded, Written};
        for interrupted_after in [Created, Written, OnDisk, InPlace, Recorded] {
            let folder = tempfile::tempdir().expect("a folder");
            let replaced = ReplacedFile::new(&folder.path().join("connections.json"));
            assert_eq!(replaced.read(1000).expect("nothing yet"), "");
            replaced.replace("old").expect("written");
            let result =
                replaced.replace_in_steps(b"new", |step| match step == interrupted_after {
                    true => Err(io::Error::other("power failure")),
                    false => Ok(()),
                });
            assert!(result.is_err());
            let is_new = matches!(interrupted_after, InPlace | Recorded);
            assert_eq!(
                replaced.read(1000).expect("exists"),
                if is_new { "new" } else { "old" }
            );
            // A leftover temporary file does not disturb the next replacement.
            replaced.replace("newer").expect("written");
            assert_eq!(replaced.read(1000).expect("exists"), "newer");
        }
    }

    #[test]
    fn replacing_preserves_the_permissions() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("connections.json");
        let replaced = ReplacedFile::new(&path);
        replaced.replace("old").expect("written");
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).expect("set");
        replaced.replace("new").expect("written");
        let mode = fs::metadata(&path).expect("exists").permissions().mode();
        assert_eq!(mode & 0o777, 0o640);
    }

    #[test]
    fn replaces_the_target_of_a_symbolic_link_and_keeps_the_link() {
        let folder = tempfile::tempdir().expect("a folder");
        let real = folder.path().join("real");
        fs::create_dir(&real).expect("a folder");
        let (file, link) = (
            real.join("list.json"),
            folder.path().join("connections.json"),
        );
        std::os::unix::fs::symlink("real/list.json", &link).expect("a link");
        let replaced = ReplacedFile::new(&link);
        // The first replacement creates the file.
        for text in ["first", "second"] {
            replaced.replace(text).expect("written");
            assert!(fs::symlink_metadata(&link).expect("exists").is_symlink());
            assert_eq!(fs::read_to_string(&file).expect("exists"), text);
        }
    }

    #[test]
    fn removes_only_temporary_files_of_killed_processes() {
        let folder = tempfile::tempdir().expect("a folder");
        let in_folder = |name: &str| folder.path().join(name);
        let replaced = ReplacedFile::new(&in_folder("connections.json"));
        replaced.replace("text").expect("written");
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
        assert_eq!(replaced.remove_leftovers().expect("removed"), 1);
        assert!(others.iter().all(|name| in_folder(name).exists()));
        assert_eq!(
            fs::read_dir(folder.path()).expect("exists").count(),
            others.len()
        );
    }

    #[test]
    fn neither_reads_nor_replaces_a_pipe() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("connections.json");
        nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).expect("a pipe");
        let replaced = ReplacedFile::new(&path);
        assert!(replaced.read(1000).is_err() && replaced.replace("text").is_err());
        assert!(!fs::metadata(&path).expect("exists").is_file());
    }
}
