//! Implements `rect action list`.
use std::{
    collections::BTreeMap,
    process::ExitCode,
    time::{Duration, Instant},
};

use clap::Args;
use rect::{Error, KnownGoal, Name, Pattern, Payload, Phase, Program, Robot};
use rect_core::{
    action::{feedback_topic, state::Feedback, to_payload},
    text::humanize::duration,
};
use rect_dashboard::programs;
use rect_terminal::{self as terminal, Cell, Style, Table};
use serde_json::{json, Map, Value as Json};
use tokio::time::timeout_at;

use crate::{
    display, report,
    session::{name, JoinArguments},
    Done, Failure,
};

/// How long to wait for the progress of goals that run, which programs report up to ten times per second.
const PROGRESS_WITHIN: Duration = Duration::from_millis(400);

/// List the actions of a robot, or of all robots of the fleet, and their goals
///
/// Goals are listed that have not ended, or did so within the last ten minutes, the newest first.
#[derive(Args)]
#[command(after_help = "Example: rect action list wombat-2")]
pub struct ListArguments {
    /// The robot [default: all]
    #[arg(value_parser = name)]
    robot: Option<Name>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// The progress of goals, by robot and topic of their feedback.
type Progress = BTreeMap<(Name, String), Option<f64>>;
/// The programs of robots.
type Catalogues = Vec<(Name, Vec<Program>)>;

/// Runs `rect action list`.
pub async fn run(arguments: ListArguments) -> Done {
    let own = arguments.join.join_unnamed().await?;
    let robot = arguments.robot.as_ref();
    let catalogues = catalogues(&own, robot).await?;
    let goals = own.goals(robot).await?;
    let progress = progress(&own, robot, &goals).await?;
    own.close().await?;
    let progress = |goal: &KnownGoal| {
        let topic = feedback_topic(&goal.action, &goal.id);
        let known = progress.get(&(goal.robot.clone(), topic));
        known
            .copied()
            .flatten()
            .filter(|_| !goal.state.phase.is_end())
    };
    if arguments.json {
        let robots = catalogues.iter().map(|(robot, programs)| {
            let actions = programs.iter().flat_map(|program| {
                let actions = program.actions();
                actions.map(|(action, about)| {
                    (
                        action.to_owned(),
                        json!({"program": program.name, "about": about}),
                    )
                })
            });
            (
                robot.to_string(),
                Json::from(actions.collect::<Map<_, _>>()),
            )
        });
        let actions = robots.collect::<Map<_, _>>();
        let goals = goals.iter().map(|goal| as_json(goal, progress(goal)));
        let goals: Vec<_> = goals.collect();
        terminal::json(&json!({"actions": actions, "goals": goals}))?;
        return Ok(ExitCode::SUCCESS);
    }
    print_actions(&catalogues);
    if !goals.is_empty() {
        terminal::outln!("");
        print_goals(&goals, progress);
    }
    Ok(ExitCode::SUCCESS)
}

/// Asks one robot or all for their programs. Of several robots, those that do not answer are reported on standard error.
async fn catalogues(own: &Robot, robot: Option<&Name>) -> Result<Catalogues, Failure> {
    if let Some(robot) = robot {
        return Ok(vec![(robot.clone(), own.programs(robot).await?)]);
    }
    let mut robots = own.peers().await?;
    robots.push(own.name().clone());
    let mut catalogues = Vec::new();
    for (robot, answer) in programs::query(own, robots).await {
        match answer {
            Ok(programs) => catalogues.push((robot, programs)),
            // This computer may be no robot.
            Err(Error::NoService { .. }) if robot == *own.name() => {}
            Err(error) => report(&error),
        }
    }
    Ok(catalogues)
}

/// Receives feedback of the goals that run for a moment.
async fn progress(
    own: &Robot,
    robot: Option<&Name>,
    goals: &[KnownGoal],
) -> Result<Progress, Failure> {
    let running = goals.iter().filter(|goal| !goal.state.phase.is_end());
    let running = running.count();
    let mut progress = Progress::new();
    if running == 0 {
        return Ok(progress);
    }
    let pattern = Pattern::of(robot.cloned(), &feedback_topic("*", "*"))?;
    let feedback = own.subscribe::<Payload>(pattern).await?;
    let until = Instant::now() + PROGRESS_WITHIN;
    while progress.len() < running {
        let Ok(Some(message)) = timeout_at(until.into(), feedback.next()).await else {
            break;
        };
        if let Ok(feedback) = Feedback::read(&message.payload) {
            let key = (message.sender, message.topic.as_str().to_owned());
            progress.insert(key, feedback.progress);
        }
    }
    Ok(progress)
}

fn print_actions(catalogues: &[(Name, Vec<Program>)]) {
    let mut table = Table::new(&["ACTION", "PROGRAM", "?ABOUT"]);
    for (robot, programs) in catalogues {
        for program in programs {
            for (action, about) in program.actions() {
                table.row(vec![
                    Cell::styled(Style::Name, format!("{robot}/{action}")),
                    program.name.as_ref().map_or("-", Name::as_str).into(),
                    about.into(),
                ]);
            }
        }
    }
    table.print();
}

fn print_goals(goals: &[KnownGoal], progress: impl Fn(&KnownGoal) -> Option<f64>) {
    let mut table = Table::new(&["GOAL", "PHASE", "SINCE", "PROGRESS", "BY", "?REASON"]);
    for goal in goals {
        let state = &goal.state;
        let place = format!("{}/{}/{}", goal.robot, goal.action, goal.id);
        let phase = match style(state.phase) {
            Some(style) => Cell::styled(style, state.phase.as_str()),
            None => state.phase.as_str().into(),
        };
        let percent = progress(goal).map(|progress| format!("{:.0} %", progress * 100.0));
        table.row(vec![
            Cell::styled(Style::Name, place),
            phase,
            duration(state.age).into(),
            percent.into(),
            state.by.as_str().into(),
            state.reason.as_str().into(),
        ]);
    }
    table.print();
}

fn style(phase: Phase) -> Option<Style> {
    match phase {
        Phase::Waiting => Some(Style::Faint),
        Phase::Running => None,
        Phase::Done => Some(Style::Good),
        Phase::Failed | Phase::Lost => Some(Style::Wrong),
        Phase::Cancelling | Phase::Cancelled | Phase::Preempted | Phase::Refused => {
            Some(Style::Poor)
        }
    }
}

fn as_json(goal: &KnownGoal, progress: Option<f64>) -> Json {
    let state = &goal.state;
    json!({
        "robot": goal.robot,
        "action": goal.action,
        "id": goal.id,
        "phase": state.phase,
        "since_s": state.age.as_secs_f64(),
        "progress": progress,
        "reason": state.reason,
        "goal": state.goal.as_ref().map(|goal| display::json(&to_payload(goal))),
        "result": state.result().as_ref().map(display::json),
        "result_bytes": state.transfer.as_ref().map(|large| large.size_bytes),
        "by": state.by,
        "program": state.program,
        "began_ms": state.began_ms,
        "ended_ms": state.ended_ms,
    })
}
