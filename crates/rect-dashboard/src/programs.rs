//! Asks robots for their programs.
use rect::{Error, Name, Program, Robot};
use tokio::task::JoinSet;

/// The programs of one robot, or why it did not answer.
pub type Answer = (Name, Result<Vec<Program>, Error>);

/// Asks the robots at the same time, and returns their answers, ordered by their names. A robot that does not answer delays none of the
/// others.
pub async fn query(robot: &Robot, robots: impl IntoIterator<Item = Name>) -> Vec<Answer> {
    let mut asking = JoinSet::new();
    for name in robots {
        let robot = robot.clone();
        asking.spawn(async move {
            let answer = robot.programs(&name).await;
            (name, answer)
        });
    }
    let mut answers = asking.join_all().await;
    answers.sort_by(|(one, _), (other, _)| one.cmp(other));
    answers
}
