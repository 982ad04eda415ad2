//! Owns the lines of a login file (Zenoh's `transport/auth/usrpwd/dictionary_file`): `user:password`, one a line.

/// A user and the password.
pub type Login<'a> = (&'a str, &'a str);

/// All that are in the text, in order; lines of another form are passed over.
pub fn logins(text: &str) -> impl Iterator<Item = Login<'_>> {
    let lines = text.lines().filter_map(|line| line.split_once(':'));
    lines.map(|(user, password)| (user.trim(), password.trim()))
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
}
