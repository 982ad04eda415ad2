//! Tests connecting to a router: logins, the robot of the router, and the timeout. The router is a stock one in this process:
//! `cargo test -p rect-robot --test behaviour joining`
use std::{
    future::Future,
    io::Read,
    net::TcpListener,
    path::Path,
    time::{Duration, Instant},
};

use rect::{Error, Options, Robot};

use crate::pair::{free_endpoint, TIMEOUT};
use serde_json::{json, Value};
use zenoh::{Config, Session, Wait};

/// Upper limit of the time until a refusal is reported, far below the timeout of the attempt.
const AT_ONCE: Duration = Duration::from_secs(5);

/// Starts a stock router with `settings` besides the basic ones.
pub fn router(endpoint: &str, settings: &[(&str, Value)]) -> Session {
    let mut config = Config::default();
    let base = [
        ("mode", json!("router")),
        ("listen/endpoints", json!([endpoint])),
        ("scouting/multicast/enabled", json!(false)),
    ];
    for (key, value) in base.iter().chain(settings) {
        let text = value.to_string();
        config.insert_json5(key, &text).expect("a setting");
    }
    zenoh::open(config).wait().expect("a router")
}

/// Starts a router that requires a login; returns it with its endpoint and its login file.
fn router_with_logins(folder: &Path) -> (Session, String, String) {
    let (endpoint, file) = (free_endpoint(), folder.join("users"));
    std::fs::write(&file, "fleet:secret\n").expect("written");
    let file = file.display().to_string();
    let logins = ("transport/auth/usrpwd/dictionary_file", json!(file));
    (router(&endpoint, &[logins]), endpoint, file)
}

fn options(robot: &str, endpoint: &str) -> Options {
    let options = Options::new(robot).expect("a name").login_file("/none");
    options.router(endpoint).timeout(TIMEOUT)
}

/// Returns the error with which connecting is refused, at once.
async fn refused(options: Options) -> Error {
    let began = Instant::now();
    let refused = options.connect().await.expect_err("not connected");
    assert!(began.elapsed() < AT_ONCE, "{:?}", began.elapsed());
    refused
}

#[tokio::test(flavor = "multi_thread")]
async fn missing_or_wrong_login_fails_at_once_with_advice() {
    let folder = tempfile::tempdir().expect("a folder");
    let (_router, endpoint, file) = router_with_logins(folder.path());
    let missing = options("wombat-1", &endpoint);
    let wrong = options("wombat-1", &endpoint).login("fleet", "guessed");
    for (options, expected) in [
        (
            missing,
            "requires a login, but the login file /none cannot be read: No such file",
        ),
        (
            wrong,
            "refused the login of user fleet: the user or the password is wrong",
        ),
    ] {
        let error = refused(options).await;
        assert!(matches!(error, Error::LoginRefused(_)), "{error:?}");
        let text = error.to_string();
        assert!(
            text.contains(expected) && text.contains("RECT_LOGIN"),
            "{text}"
        );
        assert!(text.contains(&endpoint), "{text}");
    }
    let right = options("wombat-1", &endpoint).login_file(&file).connect();
    right
        .await
        .expect("connected")
        .close()
        .await
        .expect("closed");
}

#[tokio::test(flavor = "multi_thread")]
async fn connects_with_a_login_to_a_router_without_logins() {
    let endpoint = free_endpoint();
    let _router = router(&endpoint, &[]);
    let robot = options("wombat-1", &endpoint).login("fleet", "secret");
    let robot = robot.connect().await.expect("connected");
    // Urgent messages use a separate session, which is opened like the first one.
    robot.urgent().publish("x", "now").await.expect("published");
}

#[tokio::test(flavor = "multi_thread")]
async fn router_of_another_robot_is_rejected() {
    let endpoint = free_endpoint();
    let router = router(&endpoint, &[]);
    let join = |robot: &str| options(robot, &endpoint).connect();
    // A router without a robot accepts all names.
    join("wombat-7")
        .await
        .expect("connected")
        .close()
        .await
        .expect("closed");
    let token = format!("rect/wombat-1/@rect/alive/{}", router.zid());
    let _token = router
        .liveliness()
        .declare_token(token)
        .wait()
        .expect("a token");
    let error = refused(options("wombat-7", &endpoint)).await;
    assert!(matches!(error, Error::WrongRobot(_)), "{error:?}");
    let text = error.to_string();
    assert!(
        text.contains("serves the robot wombat-1,") && text.contains("wombat-7:"),
        "{text}"
    );
    let lions = options("wombat-1", &endpoint)
        .fleet("lions")
        .expect("a name");
    let text = refused(lions).await.to_string();
    assert!(text.contains("wombat-1 of the fleet lions"), "{text}");
    join("wombat-1").await.expect("connected");
    let on_purpose = options("wombat-7", &endpoint).allow_name_mismatch();
    let robot: Robot = on_purpose.connect().await.expect("connected");
    robot.publish("x", "now").await.expect("published");
}

#[tokio::test(flavor = "multi_thread")]
async fn connect_times_out_without_listener_and_without_reply() {
    let silent = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = silent.local_addr().expect("an address");
    let silent = std::thread::spawn(move || {
        let (mut stream, _) = silent.accept().expect("a connection");
        // Reads until the other end closes the connection.
        let _ = stream.read_to_end(&mut Vec::new());
    });
    for (endpoint, expected) in [
        (free_endpoint(), "Connection refused"),
        (format!("tcp/{address}"), "no answer within 1 s"),
    ] {
        let began = Instant::now();
        let timeout = Duration::from_secs(1);
        let joined = options("wombat-1", &endpoint).timeout(timeout).connect();
        let error = joined.await.expect_err("no router");
        let took = began.elapsed();
        assert!(
            timeout <= took && took < Duration::from_millis(1500),
            "{took:?}"
        );
        assert!(matches!(error, Error::NoRouter { .. }), "{error:?}");
        assert!(error.to_string().contains(expected), "{error}");
    }
    silent.join().expect("no panic");
}

#[tokio::test(flavor = "multi_thread")]
async fn connect_waits_for_a_router_that_starts_later() {
    let endpoint = free_endpoint();
    let joining = tokio::spawn(options("wombat-1", &endpoint).connect());
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert!(!joining.is_finished());
    let _router = router(&endpoint, &[]);
    joining.await.expect("no panic").expect("connected");
}

#[tokio::test]
async fn runtime_with_a_single_thread_is_refused_with_advice() {
    for options in [
        options("wombat-1", &free_endpoint()),
        options("wombat-1", "").listen(free_endpoint()),
    ] {
        let error = refused(options).await;
        assert!(matches!(error, Error::Runtime { .. }), "{error:?}");
        let text = error.to_string();
        assert!(text.contains("this one has a single thread"), "{text}");
    }
}

#[test]
fn program_without_a_runtime_is_refused_with_advice() {
    let refused = std::pin::pin!(refused(options("wombat-1", &free_endpoint())));
    let waker = std::task::Waker::noop();
    let polled = refused.poll(&mut std::task::Context::from_waker(waker));
    let std::task::Poll::Ready(error) = polled else {
        panic!("the call waits");
    };
    assert!(
        error.to_string().contains("there is none here"),
        "{error:?}"
    );
}
