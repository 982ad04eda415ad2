//! Reports that a program declares more than its share.
use zenoh_link_table::admission::DECLARATIONS_PER_S;

use super::Finding;

/// Reports declarations of the robot's programs that had to wait, if there were any.
pub fn finding(delayed: u64) -> Option<Finding> {
    let what = format!(
        "{delayed} declarations had to wait: a program has made more than {DECLARATIONS_PER_S} per second"
    );
    let advice = "declare fewer subscribers, services and tokens, such as one subscriber with a wildcard; the router's log names the \
                  program's address";
    (delayed > 0).then(|| Finding::poor("declarations", what, advice))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_only_declarations_that_had_to_wait() {
        assert_eq!(finding(0), None);
        let finding = finding(300).expect("a finding");
        assert!(finding.what.starts_with("300 declarations"), "{finding:?}");
    }
}
