//! Tests of the router that many fleets share (`config/cloud.json5`), and of robots that connect to it:
//! `cargo test -p rect-router --test behaviour cloud`

use std::{fs, path::Path, time::Instant};

use crate::support::{
    admin, arrives, client_with, init, program, rect_router, start_with, text_of, Air, Router,
    AS_ROBOTS, DEADLINE,
};
use zenoh::{Session, Wait};

/// The cloud's router with the fleets `red` and `blue`.
struct Cloud {
    folder: String,
    _router: Router,
    endpoint: String,
}

impl Cloud {
    fn start(root: &Path) -> Self {
        let folder = root.join("cloud").display().to_string();
        let args = ["init", "cloud", "--fleets", "red,blue", "--folder", &folder];
        let output = rect_router(&args);
        assert!(output.status.success(), "{}", text_of(&output));
        let config = format!("{folder}/robot.json5");
        let mut router = Router::start(&["-c", &config, "-l", "tcp/127.0.0.1:0"]);
        let endpoint = router.listener();
        router.up();
        Self {
            folder,
            _router: router,
            endpoint,
        }
    }

    /// Returns the login of a fleet as a line of a login file.
    fn login(&self, fleet: &str) -> String {
        let users = fs::read_to_string(format!("{}/users", self.folder)).expect("exists");
        let is_its = |line: &&str| line.starts_with(&format!("{fleet}:"));
        users.lines().find(is_its).expect("a login").to_owned()
    }

    /// Opens a stock client that logs in as a fleet.
    fn client(&self, fleet: &str) -> Session {
        let login = self.login(fleet);
        let password = login.split_once(':').expect("a login").1;
        let login = format!("{{ user: '{fleet}', password: '{password}' }}");
        client_with(&self.endpoint, &[("transport/auth/usrpwd", &login)]).expect("let in")
    }
}

/// Starts the router of a fleet's base station, which connects to the cloud. Returns it with a session of a program.
fn base_station(air: &Air, root: &Path, cloud: &Cloud, fleet: &str) -> (Router, Session) {
    let users = root.join(format!("{fleet}-users"));
    let secret = format!("fleet:the secret of the fleet {fleet}");
    fs::write(&users, format!("{secret}\n{}\n", cloud.login(fleet))).expect("written");
    let (name, users) = (format!("{fleet}-base"), users.display().to_string());
    let more = ["--base-station", "--fleet", fleet, "--users", &users];
    let folder = init(
        root,
        &name,
        &[&more[..], &["--cloud", &cloud.endpoint]].concat(),
    );
    let socket = format!("unixsock-stream/{folder}/router.sock");
    let id = ID[usize::from(fleet == "blue")];
    let more = ["-i", id, "-l", &socket, "--cfg", AS_ROBOTS];
    let (router, _) = start_with(air, &folder, &name, &more);
    let program = program(&folder, &socket);
    (router, program)
}

/// The ids of the two base stations.
const ID: [&str; 2] = ["4ed", "b1e"];

#[test]
fn a_fleet_reaches_its_own_robots_over_the_cloud_and_no_others() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let cloud = Cloud::start(root.path());
    let (_red, red) = base_station(&air, root.path(), &cloud, "red");
    let (_blue, blue) = base_station(&air, root.path(), &cloud, "blue");
    let (our_client, their_client) = (cloud.client("red"), cloud.client("blue"));

    assert!(arrives(&red, &our_client, "red/red-base/arm/angle"));
    assert!(arrives(&our_client, &red, "red/laptop/mark"));
    assert!(arrives(&blue, &their_client, "blue/blue-base/arm/angle"));

    let received = [
        blue.declare_subscriber("red/**"),
        their_client.declare_subscriber("red/**"),
        their_client.declare_subscriber("**"),
    ]
    .map(|subscriber| subscriber.wait().expect("declared"));
    // The same path, and longer ones, have had time to carry something.
    for _ in 0..10 {
        assert!(arrives(&red, &our_client, "red/red-base/mark"));
    }
    for other in received {
        assert!(other.try_recv().expect("open").is_none(), "it arrived");
    }
}

#[test]
fn routers_of_different_fleets_do_not_know_each_other() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let cloud = Cloud::start(root.path());
    let (_red, red) = base_station(&air, root.path(), &cloud, "red");
    let (_blue, blue) = base_station(&air, root.path(), &cloud, "blue");
    assert!(arrives(&red, &cloud.client("red"), "red/red-base/mark"));
    assert!(arrives(&blue, &cloud.client("blue"), "blue/blue-base/mark"));
    for (program, own, other) in [(&red, 0, 1), (&blue, 1, 0)] {
        let key = format!("@/{}/router/linkstate/*", ID[own]);
        let network = admin(program, &key).expect("an answer");
        // With the quotes: the random identifier of the cloud's router may contain one of these.
        let has_node = |id| network.contains(&format!("\"{id}\""));
        assert!(has_node(ID[own]) && !has_node(ID[other]), "{network}");
    }

    // The subscriber of a program reaches the base station of its fleet, and not the other one.
    let client = cloud.client("blue");
    let _subscriber = client.declare_subscriber("blue/plan/**").wait();
    let subscribers = |program: &Session, id| {
        let replies = program.get(format!("@/{id}/router/subscriber/**")).wait();
        let replies = replies.expect("a query").into_iter();
        let samples = replies.filter_map(|reply| reply.into_result().ok());
        samples
            .map(|sample| sample.key_expr().to_string())
            .collect::<String>()
    };
    let deadline = Instant::now() + DEADLINE;
    while !subscribers(&blue, ID[1]).contains("blue/plan") {
        assert!(Instant::now() < deadline, "it is not declared");
    }
    let of_others = subscribers(&red, ID[0]);
    assert!(!of_others.contains("blue"), "{of_others}");
}

#[test]
fn a_robot_needs_the_login_of_its_fleet_for_the_cloud() {
    let root = tempfile::tempdir().expect("a folder");
    let folder = root.path().join("robot").display().to_string();
    let cloud = ["--cloud", "tls/cloud.example.org:7448", "--folder", &folder];
    let output = rect_router(&[&["init", "wombat-1", "--fleet", "red"], &cloud[..]].concat());
    assert!(!output.status.success());
    let text = text_of(&output);
    assert!(
        text.contains("the login file has no line `red:<password>`"),
        "{text}"
    );
    assert!(!Path::new(&folder).exists());
}
