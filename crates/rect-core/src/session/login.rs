//! Parses login files (Zenoh's `transport/auth/usrpwd/dictionary_file`), which have one `user:password` per line, and
//! holds the login of a program.

/// The environment variable that names the login file, for programs that do not set one.
pub const FILE_VARIABLE: &str = "RECT_LOGIN";

/// The path at which `rect-router init` stores the logins.
pub const DEFAULT_FILE: &str = "/etc/rect/users";

/// A user and the password, as in one line of the file.
pub type Line<'a> = (&'a str, &'a str);

/// Returns all logins in the text, in order. Lines of another form are skipped.
pub fn logins(text: &str) -> impl Iterator<Item = Line<'_>> {
    let lines = text.lines().filter_map(|line| line.split_once(':'));
    lines.map(|(user, password)| (user.trim(), password.trim()))
}

/// Returns the login file of programs that do not set one: `given`, the value of [`FILE_VARIABLE`], or else
/// [`DEFAULT_FILE`].
pub fn default_file(given: Option<String>) -> String {
    let given = given.filter(|given| !given.is_empty());
    given.unwrap_or_else(|| DEFAULT_FILE.to_owned())
}

/// The credentials of a program at its router.
#[derive(Clone, PartialEq, Eq)]
pub struct Login {
    credentials: Option<(String, String)>,
    /// The origin of the credentials, or the reason why there are none.
    source: Source,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Source {
    Given,
    File(String),
    Unreadable { file: String, reason: String },
    Empty { file: String },
}

/// The router requires a login, and the program's is missing or wrong.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the router at {endpoint} {refusal}. Specify the team's login file with the environment variable {FILE_VARIABLE}, the \
     option `--users` of `rect`, or the options `login_file` and `login` of a program. On the robot itself, members of the \
     group rect may read {DEFAULT_FILE}: `sudo usermod -aG rect $USER`"
)]
pub struct LoginRefused {
    /// The endpoint of the router.
    pub endpoint: String,
    /// The refusal, with the origin of the program's login.
    pub refusal: String,
}

impl Login {
    /// Creates a login from a user and password that the program specifies.
    pub fn given(user: impl Into<String>, password: impl Into<String>) -> Self {
        Self {
            credentials: Some((user.into(), password.into())),
            source: Source::Given,
        }
    }

    /// Creates a login from the first line of a login file. `text` is the content of the file, or the reason why it
    /// cannot be read.
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

    /// Returns the user and password, if there are any.
    pub fn credentials(&self) -> Option<(&str, &str)> {
        let (user, password) = self.credentials.as_ref()?;
        Some((user, password))
    }

    /// Returns the error to report if the router at `endpoint` refuses the login.
    pub fn refused_by(&self, endpoint: &str) -> LoginRefused {
        let user = self.credentials().map_or("", |(user, _)| user);
        let refusal = match &self.source {
            Source::Given => {
                format!("refused the login of user {user}: the user or the password is wrong")
            }
            Source::File(file) => {
                format!(
                    "refused the login of user {user} in {file}: the user or the password is wrong"
                )
            }
            Source::Unreadable { file, reason } => {
                format!("requires a login, but the login file {file} cannot be read: {reason}")
            }
            Source::Empty { file } => {
                format!("requires a login, but the login file {file} has no line `user:password`")
            }
        };
        LoginRefused {
            endpoint: endpoint.to_owned(),
            refusal,
        }
    }
}

impl std::fmt::Debug for Login {
    /// Omits the password.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let user = self.credentials().map(|(user, _)| user);
        write!(f, "Login({user:?}, {:?})", self.source)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_line_is_a_login_and_passwords_may_contain_colons() {
        let text = "\nwombat-1: a:b \nno login\n config:c";
        let all: Vec<_> = logins(text).collect();
        assert_eq!(all, [("wombat-1", "a:b"), ("config", "c")]);
    }

    #[test]
    fn uses_the_first_login_of_a_file() {
        let login = Login::of_file("users", Ok("fleet:a:b\nconfig:c\n"));
        assert_eq!(login.credentials(), Some(("fleet", "a:b")));
        assert!(!format!("{login:?}").contains("a:b"));
        for none in [
            Login::of_file("users", Ok("nothing")),
            Login::of_file("users", Err("no such file".to_owned())),
        ] {
            assert_eq!(none.credentials(), None);
        }
    }

    #[test]
    fn an_empty_variable_selects_the_default_file() {
        assert_eq!(default_file(None), DEFAULT_FILE);
        assert_eq!(default_file(Some(String::new())), DEFAULT_FILE);
        assert_eq!(default_file(Some("/tmp/users".to_owned())), "/tmp/users");
    }
}
