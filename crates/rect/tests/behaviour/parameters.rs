//! Tests parameters between robots that are linked directly: `cargo test -p rect-robot --test behaviour parameters`
use std::{
    fs,
    sync::{
        atomic::{AtomicUsize, Ordering},
        Arc, Mutex,
    },
    time::Duration,
};

use rect::{Error, GroupOptions, Parameter, ParameterOrder, ParameterValue, Value};
use tokio::time::timeout;
use zenoh::Wait;

use crate::pair::{free_endpoint, listening, pair, stock_client, TIMEOUT};

#[derive(Debug, rect::Parameters)]
struct Drive {
    /// Gain of the heading
    #[parameter(default = 1.0, min = 0.0, max = 10.0, unit = "1/s")]
    kp: f64,
    #[parameter(choices("left", "right"))]
    side: String,
    turbo: bool,
    #[parameter(default = 7, read_only)]
    serial: u8,
}

fn kept_in(folder: &tempfile::TempDir) -> GroupOptions<Drive> {
    GroupOptions::new("drive").file(folder.path().join("drive.json"))
}

#[tokio::test(flavor = "multi_thread")]
async fn another_robot_sees_the_declaration_sets_values_and_sees_them() {
    let (a, b) = pair("a", "b").await;
    let folder = tempfile::tempdir().expect("a folder");
    let notified: Arc<Mutex<Vec<String>>> = Arc::default();
    let telling = notified.clone();
    let options = kept_in(&folder)
        .about("how it drives")
        .check(|drive| match drive.turbo && drive.kp > 5.0 {
            true => Err("turbo needs a kp of at most 5".to_owned()),
            false => Ok(()),
        })
        .on_change(move |drive, change| {
            let names = change.changed.iter().map(|changed| changed.name.as_str());
            let names: Vec<_> = names.collect();
            let text = format!("{} {} by {}", names.join(","), drive.kp, change.by);
            telling.lock().expect("not poisoned").push(text);
        });
    let drive = a.parameters(options).await.expect("declared");
    assert_eq!((drive.get().kp, drive.get().side.as_str()), (1.0, "left"));

    let programs = b.programs("a").await.expect("a catalogue");
    let (group, declaration) = programs[0].parameters().next().expect("a group");
    assert_eq!(group, "drive");
    let kp = &declaration.parameters()[0];
    assert_eq!(
        (kp.max, kp.about.as_str()),
        (Some(10.0), "Gain of the heading")
    );
    assert_eq!(declaration.parameters()[3].max, Some(255.0));
    assert_eq!(b.services("a").await.expect("services"), []);

    let values = b
        .subscribe::<Value>("a/parameters/drive")
        .await
        .expect("subscribed");
    let order = ParameterOrder::set([("kp", ParameterValue::from(2)), ("side", "right".into())]);
    let set = b
        .set_parameters("a", "drive", order.stored())
        .await
        .expect("set");
    assert_eq!(set["kp"], ParameterValue::Number(2.0));
    assert_eq!((drive.get().kp, drive.get().side.as_str()), (2.0, "right"));
    assert_eq!(*notified.lock().expect("not poisoned"), ["kp,side 2 by b"]);
    let text = fs::read_to_string(folder.path().join("drive.json")).expect("stored");
    assert!(text.contains("\"kp\": 2.0"), "{text}");
    loop {
        let message = timeout(TIMEOUT, values.next())
            .await
            .expect("in time")
            .expect("open");
        let value = message.value.expect("a value");
        if value["changed"] == serde_json::json!(["kp", "side"]) {
            assert_eq!(
                (&value["values"]["kp"], &value["by"]),
                (&2.0.into(), &"b".into())
            );
            break;
        }
    }

    for (order, reason) in [
        (ParameterOrder::set([("kp", 11.0)]), "the maximum is 10 1/s"),
        (ParameterOrder::set([("kpp", 1.0)]), "did you mean kp?"),
        (ParameterOrder::set([("serial", 1)]), "read-only"),
        (
            ParameterOrder::set([("kp", ParameterValue::from(6)), ("turbo", true.into())]),
            "turbo needs a kp",
        ),
    ] {
        let refused = b
            .set_parameters("a", "drive", order)
            .await
            .expect_err(reason);
        assert!(refused.to_string().contains(reason), "{refused}");
        assert_eq!((drive.get().kp, drive.get().turbo), (2.0, false));
    }
    let unknown = b
        .set_parameters("a", "driv", [("kp", 1.0)])
        .await
        .expect_err("none");
    assert!(
        unknown.to_string().contains("did you mean drive?"),
        "{unknown}"
    );

    let second = a
        .parameters::<Drive>(kept_in(&folder))
        .await
        .expect_err("twice");
    assert!(matches!(second, Error::ServiceRefused { .. }), "{second}");
    drive.set([("serial", 9)]).expect("its own");
    drop(drive);
    let again = a
        .parameters::<Drive>(kept_in(&folder))
        .await
        .expect("declared again");
    assert_eq!((again.get().kp, again.get().serial), (2.0, 9));
    let reset = b
        .set_parameters("a", "drive", ParameterOrder::reset_all())
        .await;
    assert_eq!(reset.expect("reset")["kp"], ParameterValue::Number(1.0));
    assert_eq!((again.get().kp, again.get().serial), (1.0, 9));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_program_of_stock_zenoh_sets_and_reads_parameters() {
    let endpoint = free_endpoint();
    let robot = listening("a", &endpoint).await;
    let parameters = vec![
        Parameter::new("kp", 1.0),
        Parameter::new("points", vec![0.0]),
    ];
    let options = GroupOptions::with("drive", parameters).without_file();
    let drive = robot.parameters(options).await.expect("declared");
    let stock = stock_client(&endpoint);
    let ask = |payload: &str| {
        let replies = stock
            .get("rect/a/@rect/@set/parameters/drive")
            .payload(payload.to_owned())
            .wait()
            .expect("asked");
        let reply = replies.recv().expect("a reply");
        match reply.into_result() {
            Ok(sample) => ("ok", sample.payload().to_bytes().to_vec()),
            Err(error) => ("error", error.payload().to_bytes().to_vec()),
        }
    };
    let asked = tokio::task::block_in_place(|| ask(r#"{"set": {"kp": 2, "points": [1, 2]}}"#));
    assert_eq!(asked.0, "ok");
    assert_eq!(
        drive.get()["points"],
        ParameterValue::Numbers(vec![1.0, 2.0])
    );
    let (outcome, reason) = tokio::task::block_in_place(|| ask(r#"{"set": {"kp": "fast"}}"#));
    assert_eq!(outcome, "error");
    let reason = String::from_utf8(reason).expect("text");
    assert!(reason.contains("kp cannot be \"fast\""), "{reason}");
    // Without a file, the requester learns that nothing is stored.
    let order = ParameterOrder::set([("kp", 3.0)]).stored();
    let stored = robot
        .set_parameters("a", "drive", order)
        .await
        .expect_err("not stored");
    assert!(matches!(&stored, Error::NotStored { .. }), "{stored}");
    assert_eq!(drive.get()["kp"], ParameterValue::Number(3.0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_changes_ends_with_the_last_one_for_everybody() {
    let (a, b) = pair("a", "b").await;
    let folder = tempfile::tempdir().expect("a folder");
    let drive = a
        .parameters::<Drive>(kept_in(&folder))
        .await
        .expect("declared");
    let values = b
        .subscribe::<Value>("a/parameters/drive")
        .await
        .expect("subscribed");
    for n in 1..=200 {
        let kp = f64::from(n) / 20.0;
        b.set_parameters("a", "drive", [("kp", kp)])
            .await
            .expect("set");
    }
    assert_eq!(drive.get().kp, 10.0);
    let last = async {
        let mut kp = serde_json::Value::Null;
        while kp != 10.0 {
            let message = values.next().await.expect("open");
            kp = message.value.expect("a value")["values"]["kp"].clone();
        }
    };
    timeout(TIMEOUT, last).await.expect("the last values");
    let quiet = Duration::from_millis(500);
    let later = timeout(quiet, values.next()).await;
    assert!(later.is_err(), "{later:?}");
    drop(drive);
    let text = fs::read_to_string(folder.path().join("drive.json")).expect("stored");
    assert!(text.contains("\"kp\": 10.0"), "{text}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_that_is_interrupted_is_sent_again() {
    let endpoint = free_endpoint();
    let robot = listening("b", &endpoint).await;
    // A program that ends the first order without a reply.
    let stock = stock_client(&endpoint);
    let key = "rect/a/@rect/@set/parameters/drive";
    let orders = Arc::new(AtomicUsize::new(0));
    let counted = orders.clone();
    let _service = stock
        .declare_queryable(key)
        .complete(true)
        .callback(move |query| {
            if counted.fetch_add(1, Ordering::Relaxed) > 0 {
                let reply = query.reply(key, r#"{"values": {"kp": 2.0}}"#);
                let reply = reply.encoding(zenoh::bytes::Encoding::APPLICATION_JSON);
                reply.wait().expect("replied");
            }
        })
        .wait()
        .expect("served");
    let set = async {
        loop {
            match robot.set_parameters("a", "drive", [("kp", 2.0)]).await {
                // The robot has not discovered the program yet.
                Err(Error::NoParameters { .. }) => {}
                set => return set,
            }
        }
    };
    let set = timeout(TIMEOUT, set).await.expect("in time").expect("set");
    assert_eq!(set["kp"], ParameterValue::Number(2.0));
    assert_eq!(orders.load(Ordering::Relaxed), 2);
}
