//! Owns the lines of a login file (Zenoh's `transport/auth/usrpwd/dictionary_file`): `user:password`, one a line; and what a
//! program logs in with.

/// The environment variable that names the login file for all programs that do not name one.
pub const FILE_VARIABLE: &str = "RECT_LOGIN";

/// Where `rect-router init` puts the logins.
pub const DEFAULT_FILE: &str = "/etc/rect/users";

/// A user and the password, as a line of the file has them.
pub type Line<'a> = (&'a str, &'a str);

/// All that are in the text, in order; lines of another form are passed over.
pub fn logins(text: &str) -> impl Iterator<Item = Line<'_>> {
    let lines = text.lines().filter_map(|line| line.split_once(':'));
    lines.map(|(user, password)| (user.trim(), password.trim()))
}

/// Returns the login file of programs that name none: `given`, the value of [`FILE_VARIABLE`], else [`DEFAULT_FILE`].
pub fn default_file(given: Option<String>) -> String {
    let given = given.filter(|given| !given.is_empty());
    given.unwrap_or_else(|| DEFAULT_FILE.to_owned())
}

/// The credentials of a program at its router.
#[derive(Clone, PartialEq, Eq)]
pub struct Login {
    credentials: Option<(String, String)>,
    /// Where the credentials are from, or why there are none.
    source: Source,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Source {
    Given,
    File(String),
    Unreadable { file: String, reason: String },
    Empty { file: String },
}

/// The router asks for a login, and the program's is missing or wrong.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the router at {endpoint} {what}. Give it the login file of its team by the environment variable {FILE_VARIABLE} \
     (`rect` also takes `--users`, a program the options `login_file` and `login`); on the robot itself, members of the \
     group rect may read {DEFAULT_FILE}: `sudo usermod -aG rect $USER`"
)]
pub struct LoginRefused {
    /// Where the router is.
    pub endpoint: String,
    /// The refusal, and the origin of the program's login.
    pub what: String,
}

impl Login {
    /// A user and password that the program names.
    pub fn given(user: impl Into<String>, password: impl Into<String>) -> Self {
        Self {
            credentials: Some((user.into(), password.into())),
            source: Source::Given,
        }
    }

    /// The first login of a file; `text`: what is in it, or why it can't be read.
    pub fn of_file(file: impl Into<String>, text: Result<&str, String>) -> Self {
        let file = file.into();
        let first = text.map(|text| logins(text).next());
        let (credentials, source) = match first {
            Ok(Some((user, password))) => (
                Some((user.to_owned(), password.to_owned())),
                Source::File(file),
            ),
            Ok(None) => (None, Source::Empty { file }),
            Err(reason) => (None, Source::Unreadable { file, reason }),
        };
        Self {
            credentials,
            source,
        }
    }

    /// User and password, if there are any.
    pub fn credentials(&self) -> Option<(&str, &str)> {
        let (user, password) = self.credentials.as_ref()?;
        Some((user, password))
    }

    /// Returns the error to report if the router at `endpoint` refuses it.
    pub fn refused_by(&self, endpoint: &str) -> LoginRefused {
        let user = self.credentials().map_or("", |(user, _)| user);
        let what = match &self.source {
            Source::Given => {
                format!("refused the login of user {user}: the user or the password is wrong")
            }
            Source::File(file) => {
                format!(
                    "refused the login of user {user} in {file}: the user or the password is wrong"
                )
            }
            Source::Unreadable { file, reason } => {
                format!("asks for a login, and the login file {file} can't be read: {reason}")
            }
            Source::Empty { file } => {
                format!("asks for a login, and the login file {file} has no line `user:password`")
            }
        };
        LoginRefused {
            endpoint: endpoint.to_owned(),
            what,
        }
    }
}

impl std::fmt::Debug for Login {
    /// Without the password.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let user = self.credentials().map(|(user, _)| user);
        write!(f, "Login({user:?}, {:?})", self.source)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_a_login_and_a_password_may_hold_colons() {
        let text = "\nwombat-1: a:b \nno login\n config:c";
        let all: Vec<_> = logins(text).collect();
        assert_eq!(all, [("wombat-1", "a:b"), ("config", "c")]);
    }

    #[test]
    fn the_login_of_a_file_is_its_first_line() {
        let login = Login::of_file("users", Ok("fleet:a:b\nconfig:c\n"));
        assert_eq!(login.credentials(), Some(("fleet", "a:b")));
        assert!(!format!("{login:?}").contains("a:b"));
        for none in [
            Login::of_file("users", Ok("nothing")),
            Login::of_file("users", Err("gone".to_owned())),
        ] {
            assert_eq!(none.credentials(), None);
        }
    }

    #[test]
    fn an_empty_variable_names_no_file() {
        assert_eq!(default_file(None), DEFAULT_FILE);
        assert_eq!(default_file(Some(String::new())), DEFAULT_FILE);
        assert_eq!(default_file(Some("/tmp/users".to_owned())), "/tmp/users");
    }
}
