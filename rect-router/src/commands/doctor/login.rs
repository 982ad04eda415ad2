//! Checks the login file of this computer.
use std::{io::ErrorKind, path::Path};

use rect_core::session::login::logins;

use crate::{
    config::{read_login_file, ExposedLogins},
    doctor::Finding,
};

const ABOUT: &str = "login";

/// Examines the login file. A missing file is not reported: a router may require no login.
pub fn findings(file: &Path) -> Vec<Finding> {
    let path = file.display();
    let text = match read_login_file(file) {
        Ok(text) => text,
        Err(error) if error.kind() == ErrorKind::NotFound => return Vec::new(),
        Err(error) => {
            let advice = match error.kind() {
                ErrorKind::PermissionDenied => "`sudo usermod -aG rect $USER`, and log in again",
                _ => "give the team's login file with --users",
            };
            return vec![Finding::poor(
                ABOUT,
                format!("cannot read the login file {path}: {error}"),
                advice,
            )];
        }
    };
    let mut findings = Vec::new();
    if let Some(exposed) = ExposedLogins::find(file) {
        let advice = format!("`sudo {}`", exposed.remedy());
        findings.push(Finding::poor(ABOUT, exposed.to_string(), advice));
    }
    findings.push(match logins(&text).next() {
        Some((user, _)) => Finding::good(ABOUT, format!("programs log in as {user}, from {path}")),
        None => Finding::wrong(
            ABOUT,
            format!("the login file {path} has no line `user:password`"),
            "copy the team's login file from another robot",
        ),
    });
    findings
}

#[cfg(test)]
mod tests {
    use std::{fs, os::unix::fs::PermissionsExt};

    use nix::{sys::stat::Mode, unistd::mkfifo};

    use super::*;
    use crate::doctor::Verdict;

    fn verdicts(text: &str, mode: u32) -> Vec<(Verdict, String)> {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("users");
        fs::write(&file, text).expect("written");
        fs::set_permissions(&file, fs::Permissions::from_mode(mode)).expect("set");
        let findings = findings(&file).into_iter();
        findings
            .map(|finding| (finding.verdict, finding.what))
            .collect()
    }

    #[test]
    fn accepts_a_private_file_with_a_login() {
        let found = verdicts("fleet:secret\n", 0o640);
        assert!(
            matches!(&found[..], [(Verdict::Good, what)] if what.contains("as fleet")),
            "{found:?}"
        );
    }

    #[test]
    fn reports_a_file_that_every_user_can_read_or_write() {
        for mode in [0o644, 0o642] {
            let found = verdicts("fleet:secret\n", mode);
            assert!(
                matches!(found[0], (Verdict::Poor, _)),
                "{mode:o}: {found:?}"
            );
        }
    }

    #[test]
    fn reports_a_file_without_a_login_but_not_a_missing_file() {
        let found = verdicts("no login\n", 0o640);
        assert!(matches!(&found[..], [(Verdict::Wrong, _)]), "{found:?}");
        assert_eq!(findings(Path::new("/nowhere/users")), []);
    }

    #[test]
    fn reports_a_pipe_without_blocking() {
        let folder = tempfile::tempdir().expect("a folder");
        let pipe = folder.path().join("users");
        mkfifo(&pipe, Mode::S_IRWXU).expect("a pipe");
        let found = findings(&pipe);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].what.contains("not a regular file"), "{found:?}");
    }
}
