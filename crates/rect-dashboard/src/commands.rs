//! Executes the commands of the page that are answered: publish, request, connections, check, parameters, actions, stop and record.
use std::time::{Duration, Instant};

use rect::{Error, Name, NamedConnection, ParameterOrder, Payload, Phase, Topic};
use rect_core::message::payload;
use rect_recording::view;
use serde_json::{json, Value};

use crate::{
    login::Access,
    protocol::{Command, ConnectionForm},
    App,
};

/// How long a service may take.
const TIMEOUT: Duration = Duration::from_secs(5);

type Answer = Result<Value, String>;

/// Returns the number of a command that is answered; 0 for the others.
pub fn id_of(command: &Command) -> u32 {
    match command {
        Command::Show { .. } => 0,
        Command::Watch { id, .. }
        | Command::Log { id, .. }
        | Command::Unwatch { id }
        | Command::Key { id }
        | Command::Publish { id, .. }
        | Command::Request { id, .. }
        | Command::Connect { id, .. }
        | Command::Disconnect { id, .. }
        | Command::Check { id, .. }
        | Command::SetParameters { id, .. }
        | Command::StartAction { id, .. }
        | Command::CancelAction { id, .. }
        | Command::Stop { id }
        | Command::ReleaseStop { id }
        | Command::Record { id, .. } => *id,
    }
}

/// Executes a command. `user`: the user who has logged in, if there are logins.
///
/// # Errors
/// Fails with what the user of the page reads.
pub async fn execute(app: &App, command: Command, access: Access, user: Option<&str>) -> Answer {
    // A stop is always permitted to those who see the page, because somebody may be in danger.
    let is_permitted = matches!(command, Command::Stop { .. } | Command::Check { .. });
    if access < Access::Change && !is_permitted {
        return Err(match app.read_only {
            true => "this dashboard only shows: it was started with --read-only".to_owned(),
            false => "changes require a login: log in with one of the team's login file".to_owned(),
        });
    }
    match command {
        Command::Publish {
            to,
            topic,
            value,
            urgent,
            ..
        } => publish(app, to.as_deref(), &topic, value, urgent).await,
        Command::Request {
            robot,
            topic,
            value,
            ..
        } => request(app, &robot, &topic, value).await,
        Command::Connect {
            robot, connection, ..
        } => connect(app, &robot, connection).await,
        Command::Disconnect { robot, name, .. } => {
            let removed = app.robot.remove_connection_of(robot.as_str(), &name);
            removed.await.map(|()| Value::Null).map_err(text)
        }
        Command::Check { robot, .. } => {
            let robot = Name::new(&robot).map_err(text)?;
            let findings = app.robot.query_registry(robot, "doctor", "");
            findings.await.map_err(text)
        }
        Command::SetParameters {
            robot,
            group,
            set,
            reset,
            ..
        } => {
            let order = match (set.is_empty(), reset.is_empty()) {
                (_, true) => ParameterOrder::set(set),
                (true, false) => ParameterOrder::reset(reset),
                (false, false) => return Err("set parameters or reset them, not both".to_owned()),
            };
            let setting = app.robot.with_timeout(TIMEOUT);
            match setting.set_parameters(robot.as_str(), &group, order).await {
                Ok(in_force) => Ok(json!(in_force)),
                Err(error) => Err(refusal(error)),
            }
        }
        Command::StartAction {
            robot,
            action,
            value,
            ..
        } => start(app, &robot, &action, value).await,
        Command::CancelAction {
            robot,
            action,
            goal,
            ..
        } => {
            let finding = app.robot.with_timeout(TIMEOUT);
            let found = finding.find(robot.as_str(), &action, &goal).await;
            let cancelled = found.map_err(text)?.cancel().await;
            cancelled.map(|()| Value::Null).map_err(refusal)
        }
        Command::Stop { .. } => {
            let by = user.unwrap_or("dashboard");
            app.stop.press(by).await.map(|()| Value::Null)
        }
        Command::ReleaseStop { .. } => app.stop.release().await.map(|()| Value::Null),
        Command::Record { on, .. } => {
            let recording = app.recording.as_ref();
            let recording =
                recording.ok_or("start the dashboard with --record <folder> to make recordings")?;
            let file = match on {
                true => recording.start().await?,
                false => recording.finish().await?,
            };
            recording.show(&app.browsers).await;
            Ok(file.into())
        }
        Command::Show { .. }
        | Command::Watch { .. }
        | Command::Log { .. }
        | Command::Unwatch { .. }
        | Command::Key { .. } => Ok(Value::Null),
    }
}

async fn publish(app: &App, to: Option<&str>, topic: &str, value: String, urgent: bool) -> Answer {
    let robot = match urgent {
        true => app.robot.urgent(),
        false => app.robot.clone(),
    };
    let topic = Topic::new(topic).map_err(text)?;
    let payload = payload::typed(value);
    let sent = match to {
        Some(to) => {
            robot
                .send(Name::new(to).map_err(text)?, topic, payload)
                .await
        }
        None => robot.publish(topic, payload).await,
    };
    sent.map(|()| Value::Null).map_err(text)
}

async fn request(app: &App, robot: &str, topic: &str, value: String) -> Answer {
    let started = Instant::now();
    let name = Name::new(robot).map_err(text)?;
    let topic = Topic::new(topic).map_err(text)?;
    let reply = app
        .robot
        .with_timeout(TIMEOUT)
        .request::<Payload>(name, topic, payload::typed(value))
        .await
        .map_err(text)?;
    Ok(json!({"reply": view::value(&reply.payload), "ms": milliseconds(started)}))
}

/// Starts a goal, which goes on when the page is closed.
async fn start(app: &App, robot: &str, action: &str, value: String) -> Answer {
    let starting = app.robot.with_timeout(TIMEOUT);
    let run = starting.start(robot, action, payload::typed(value)).await;
    let run = run.map_err(text)?;
    match run.phase() {
        Phase::Refused => Err(format!("refused: {}", run.reason())),
        _ => Ok(json!({"goal": run.id()})),
    }
}

async fn connect(app: &App, robot: &str, form: ConnectionForm) -> Answer {
    let ConnectionForm {
        name,
        method,
        address,
        port,
    } = form;
    let connection = NamedConnection::new(name, method, address);
    let connection = port.into_iter().fold(connection, NamedConnection::port);
    let added = app.robot.add_connection_of(robot, &connection);
    added.await.map(|()| Value::Null).map_err(text)
}

fn milliseconds(since: Instant) -> f64 {
    (since.elapsed().as_secs_f64() * 10_000.0).round() / 10.0
}

/// Returns the reason of a refusal alone: the page shows it beside what was refused.
fn refusal(error: Error) -> String {
    match error {
        Error::Service { payload, .. } => String::from_utf8_lossy(&payload.bytes).into_owned(),
        error => text(error),
    }
}

fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}
