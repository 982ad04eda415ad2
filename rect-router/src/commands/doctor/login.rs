//! Owns what can be wrong with the login file of this computer.
use std::{fs, io::ErrorKind, os::unix::fs::PermissionsExt, path::Path};

use rect::core::login::logins;

use super::Finding;

const ABOUT: &str = "login";
/// Reading or writing by users who are neither the file's owner nor of its group.
const OTHERS: u32 = 0o006;

/// What is to report about the file. A missing one is nothing to report: a router may require no login.
pub fn findings(file: &Path) -> Vec<Finding> {
    let path = file.display();
    let text = match fs::read_to_string(file) {
        Ok(text) => text,
        Err(error) if error.kind() == ErrorKind::NotFound => return Vec::new(),
        Err(error) => {
            let advice = match error.kind() {
                ErrorKind::PermissionDenied => "`sudo usermod -aG rect $USER`, and log in again",
                _ => "name the team's login file with --users",
            };
            return vec![Finding::poor(
                ABOUT,
                format!("cannot read the login file {path}: {error}"),
                advice,
            )];
        }
    };
    let mut findings = Vec::new();
    let mode = fs::metadata(file).map_or(0, |data| data.permissions().mode());
    if mode & OTHERS != 0 {
        let what = format!("every user of this computer can read or write the login file {path}");
        findings.push(Finding::poor(
            ABOUT,
            what,
            format!("`sudo chmod 640 {path}`"),
        ));
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
    use super::{super::Verdict, *};

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
    fn a_private_file_with_a_login_is_good() {
        let found = verdicts("fleet:secret\n", 0o640);
        assert!(
            matches!(&found[..], [(Verdict::Good, what)] if what.contains("as fleet")),
            "{found:?}"
        );
    }

    #[test]
    fn a_file_that_every_user_can_read_or_write_is_reported() {
        for mode in [0o644, 0o642] {
            let found = verdicts("fleet:secret\n", mode);
            assert!(
                matches!(found[0], (Verdict::Poor, _)),
                "{mode:o}: {found:?}"
            );
        }
    }

    #[test]
    fn a_file_without_a_login_is_wrong_and_a_missing_file_is_not_reported() {
        let found = verdicts("no login\n", 0o640);
        assert!(matches!(&found[..], [(Verdict::Wrong, _)]), "{found:?}");
        assert_eq!(findings(Path::new("/nowhere/users")), []);
    }
}
