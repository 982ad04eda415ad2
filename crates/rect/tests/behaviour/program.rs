//! Tests the programs of a robot: their names, the catalogue of their services, and refused services:
//! `cargo test -p rect-robot --test behaviour program`
use std::{
    future::Future,
    time::{Duration, Instant},
};

use rect::{Error, Event, Options, Payload, Program, Robot, Service, ServiceOptions};
use tokio::sync::mpsc;
use zenoh::{query::Query, Session, Wait};

use crate::{
    joining::router,
    pair::{dialling, free_endpoint, TIMEOUT},
};

/// The key at which programs of the robot `a` register at its router.
const REGISTER: &str = "rect/a/@rect/@set/program";

/// Returns the options of the program `arm` of the robot `a`.
fn arm() -> Options {
    let options = Options::new("a").expect("a name").login_file("/none");
    options.program("arm").expect("a name")
}

async fn serve(robot: &Robot, topic: &str, about: &str) -> Result<Service, Error> {
    let options = ServiceOptions {
        about: about.to_owned(),
        ..ServiceOptions::default()
    };
    let answer = |_| async { Ok::<_, String>("done") };
    robot.serve_with(topic, options, answer).await
}

/// Returns the topics of a program's services, each with its description.
fn services(program: &Program) -> Vec<(&str, &str)> {
    (program.services.iter())
        .map(|service| (service.topic.as_str(), service.about.as_str()))
        .collect()
}

async fn in_time<T>(future: impl Future<Output = T>) -> T {
    let limited = tokio::time::timeout(TIMEOUT, future);
    limited.await.expect("in time")
}

/// Waits until the programs of `a` are as expected, seen from another robot.
async fn until_programs(from: &Robot, is_so: impl Fn(&[Program]) -> bool) -> Vec<Program> {
    let deadline = Instant::now() + TIMEOUT;
    loop {
        match from.programs("a").await {
            Ok(programs) if is_so(&programs) => return programs,
            Ok(_) | Err(Error::NoService { .. }) if Instant::now() < deadline => {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
            other => panic!("{other:?}"),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn program_without_a_router_answers_for_itself() {
    let endpoint = free_endpoint();
    let b = dialling("b", &endpoint).await;
    let events = b.events().await.expect("subscribed");
    let a = arm().listen(&endpoint).connect().await.expect("connected");
    let is_of_arm = |event: &Event| match event {
        Event::ProgramUp { robot, program } => Some((*robot == "a" && *program == "arm", true)),
        Event::ProgramDown { robot, program } => Some((*robot == "a" && *program == "arm", false)),
        _ => None,
    };
    let next_of_a_program = || async {
        loop {
            let event = in_time(events.next()).await.expect("not closed");
            if let Some(found) = is_of_arm(&event) {
                return found;
            }
        }
    };
    assert_eq!(next_of_a_program().await, (true, true));

    let grab = serve(&a, "grab", "closes the gripper").await;
    let grab = grab.expect("served");
    let _look = serve(&a, "look", "").await.expect("served");
    let found = until_programs(&b, |programs| programs[0].services.len() == 2).await;
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].title(), "arm");
    let expected = [("grab", "closes the gripper"), ("look", "")];
    assert_eq!(services(&found[0]), expected);

    let refused = serve(&a, "grab", "").await.expect_err("served already");
    assert!(
        matches!(refused, Error::ServiceRefused { .. }),
        "{refused:?}"
    );
    let text = refused.to_string();
    assert!(
        text.starts_with("grab is served by this program already"),
        "{text}"
    );
    drop(grab);
    let found = until_programs(&b, |programs| programs[0].services.len() == 1).await;
    assert_eq!(services(&found[0]), [("look", "")]);
    serve(&a, "grab", "").await.expect("free again");
    a.close().await.expect("closed");
    assert_eq!(next_of_a_program().await, (true, false));
}

#[tokio::test(flavor = "multi_thread")]
async fn several_services_of_one_topic_need_the_consent_of_each() {
    let a = arm().listen(free_endpoint()).connect().await;
    let a = a.expect("connected");
    let serve = |allow_several| {
        let options = ServiceOptions {
            allow_several,
            ..ServiceOptions::default()
        };
        let answer = |_| async { Ok::<_, String>("done") };
        a.serve_with("look", options, answer)
    };
    let _first = serve(true).await.expect("served");
    let refused = serve(false).await.expect_err("the second one does not");
    assert!(
        matches!(refused, Error::ServiceRefused { .. }),
        "{refused:?}"
    );
    let _second = serve(true).await.expect("served");
    let replies = a.request_all::<Payload>("look", "").await.expect("asked");
    let mut count = 0;
    while let Some(reply) = in_time(replies.next()).await {
        assert!(reply.expect("a reply").is_shared);
        count += 1;
    }
    assert_eq!(count, 2, "each of them answers");
    let reply = in_time(a.request::<Payload>("a", "look", "")).await;
    assert!(
        reply.expect("a reply").is_shared,
        "a request says that several may carry it out"
    );
    let _alone = self::serve(&a, "grab", "").await.expect("served");
    let reply = in_time(a.request::<Payload>("a", "grab", "")).await;
    assert!(!reply.expect("a reply").is_shared);
}

/// Declares a catalogue that accepts or refuses registrations, and passes them on.
fn catalogue(
    router: &Session,
    refused: Option<&'static str>,
) -> mpsc::UnboundedReceiver<serde_json::Value> {
    let (registered, registrations) = mpsc::unbounded_channel();
    let answer = move |query: Query| {
        let payload = query.payload().expect("a program").to_bytes();
        let _ = registered.send(serde_json::from_slice(&payload).expect("JSON"));
        let replied = match refused {
            Some(reason) => query.reply_err(reason).wait(),
            None => query.reply(REGISTER, "{}").wait(),
        };
        replied.expect("replied");
    };
    let queryable = router.declare_queryable(REGISTER).callback(answer);
    queryable.background().wait().expect("declared");
    registrations
}

#[tokio::test(flavor = "multi_thread")]
async fn service_that_the_router_refuses_receives_no_requests() {
    let endpoint = free_endpoint();
    let router = router(&endpoint, &[]);
    let reason = "grab is served by the program claw already. End that program";
    let _registrations = catalogue(&router, Some(reason));
    let a = arm().router(&endpoint).timeout(TIMEOUT).connect().await;
    let a = a.expect("connected");
    match serve(&a, "grab", "").await {
        Err(Error::ServiceRefused { reason: given }) => assert_eq!(given, reason),
        other => panic!("{other:?}"),
    }
    let error = a.request::<Payload>("a", "grab", "").await;
    let error = error.expect_err("nobody serves it");
    assert!(matches!(error, Error::NoService { .. }), "{error:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn program_registers_its_name_and_each_change_of_its_services() {
    let endpoint = free_endpoint();
    let router = router(&endpoint, &[]);
    let mut registrations = catalogue(&router, None);
    let a = arm().router(&endpoint).timeout(TIMEOUT).connect().await;
    let a = a.expect("connected");
    let first = in_time(registrations.recv()).await.expect("registered");
    assert_eq!(first["program"], "arm", "{first}");
    assert_eq!(first["services"], serde_json::json!([]), "{first}");
    let grab = serve(&a, "grab", "closes the gripper").await;
    let served = in_time(registrations.recv()).await.expect("registered");
    assert_eq!(served["instance"], first["instance"], "{served}");
    let expected = serde_json::json!([{"topic": "grab", "about": "closes the gripper"}]);
    assert_eq!(served["services"], expected, "{served}");
    drop(grab.expect("served"));
    let ended = in_time(registrations.recv()).await.expect("registered");
    assert_eq!(ended["services"], serde_json::json!([]), "{ended}");
}

#[tokio::test(flavor = "multi_thread")]
async fn program_registers_when_the_catalogue_appears_after_it() {
    // As that of RECT's plugin, which a stock zenohd loads after it has begun to listen.
    let endpoint = free_endpoint();
    let router = router(&endpoint, &[]);
    let a = arm().router(&endpoint).timeout(TIMEOUT).connect().await;
    let a = a.expect("connected");
    let _grab = serve(&a, "grab", "").await.expect("nobody refuses it");
    let mut registrations = catalogue(&router, None);
    let registered = in_time(registrations.recv()).await.expect("registered");
    let expected = serde_json::json!([{"topic": "grab"}]);
    assert_eq!(registered["services"], expected, "{registered}");
}
