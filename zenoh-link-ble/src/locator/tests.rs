//! Tests the parser of locators: `cargo test -p zenoh-link-ble --lib locator`
use super::*;

fn connect(text: &str) -> Result<ConnectLocator, LocatorError> {
    ConnectLocator::parse(&text.parse().expect("an endpoint"))
}

fn listen(text: &str) -> Result<ListenLocator, LocatorError> {
    ListenLocator::parse(&text.parse().expect("an endpoint"))
}

#[test]
fn address_with_every_option_is_parsed() {
    let read = connect(
        "ble/DC:A6:32:01:02:03#adapter=hci1;psm=128;addr_type=random;sec=medium;mtu=500;timeout=3000;plain=true;queue=100000;backlog=700;droppable=50;linger=1000",
    )
    .expect("valid");
    assert_eq!(read.target.to_string(), "DC:A6:32:01:02:03");
    assert_eq!(read.adapter.as_deref(), Some("hci1"));
    assert_eq!(read.psm, Psm::new(128));
    assert_eq!(read.address_kind, Some(AddressType::Random));
    assert_eq!(read.security, Security::Medium);
    assert_eq!(read.mtu, 500);
    assert_eq!(read.timeout, Duration::from_secs(3));
    assert_eq!(read.queueing.bounds.bytes, 100_000);
    assert_eq!(read.queueing.bounds.backlog, Duration::from_millis(700));
    assert_eq!(read.queueing.bounds.droppable, Duration::from_millis(50));
    assert_eq!(read.queueing.linger, Duration::from_secs(1));
    assert_eq!(read.plain, Some(true));
}

#[test]
fn bare_name_uses_the_defaults() {
    let read = connect("ble/wombat-2").expect("valid");
    assert_eq!(read.target, Target::Name("wombat-2".to_owned()));
    assert_eq!((read.psm, read.adapter, read.plain), (None, None, None));
    assert_eq!(read.queueing, Queueing::default());
    assert_eq!(
        (read.mtu, read.timeout),
        (DEFAULT_MTU, DEFAULT_CONNECT_TIMEOUT)
    );
}

#[test]
fn listen_locator_has_an_adapter_and_a_name() {
    let read = listen("ble/hci0#name=wombat-1;max_links=3;wait=true").expect("valid");
    assert_eq!(
        (read.adapter.as_str(), read.name.as_deref()),
        ("hci0", Some("wombat-1"))
    );
    assert_eq!((read.max_links, read.wait), (3, true));
    assert!(!listen("ble/hci0").expect("valid").wait);
}

#[test]
fn limits_of_options_are_enforced_on_both_sides() {
    for good in [
        "psm=128",
        "psm=255",
        "mtu=128",
        "mtu=8000",
        "queue=65536",
        "queue=67108864",
        "backlog=50",
        "backlog=600000",
        "droppable=20",
        "droppable=10000",
        "linger=0",
        "linger=60000",
        "timeout=100",
        "timeout=60000",
    ] {
        assert!(connect(&format!("ble/w#{good}")).is_ok(), "{good}");
    }
    for bad in [
        "psm=127",
        "psm=256",
        "psm=",
        "psm=x",
        "mtu=127",
        "mtu=8001",
        "queue=65535",
        "queue=67108865",
        "backlog=49",
        "backlog=600001",
        "droppable=19",
        "droppable=10001",
        "linger=60001",
        "linger=-1",
        "timeout=99",
        "timeout=60001",
        "sec=none",
        "addr_type=le",
        "plain=1",
        "adapter=eth0",
    ] {
        let error = connect(&format!("ble/w#{bad}")).expect_err(bad);
        let key = bad.split('=').next().unwrap_or_default();
        assert!(error.to_string().contains(key), "{error}");
    }
    for bad in [
        "max_links=0",
        "max_links=65",
        "name=",
        "name=a b",
        "name=hci0",
        "name=sim-1",
    ] {
        assert!(listen(&format!("ble/hci0#{bad}")).is_err(), "{bad}");
    }
    assert!(listen(&format!("ble/hci0#name={}", "x".repeat(29))).is_ok());
    assert!(listen(&format!("ble/hci0#name={}", "x".repeat(30))).is_err());
}

#[test]
fn fleet_is_required_for_any_peer_and_rejected_otherwise() {
    let read = connect("ble/*#fleet=lions;adapter=hci1").expect("valid");
    assert_eq!(read.target, Target::Fleet("lions".to_owned()));
    assert_eq!(connect("ble/*"), Err(LocatorError::NoFleet));
    assert_eq!(
        connect("ble/wombat-2#fleet=lions"),
        Err(LocatorError::FleetWithPeer)
    );
    assert!(connect("ble/*#fleet=").is_err() && listen("ble/*#fleet=lions").is_err());
    let read = listen("ble/hci0#fleet=lions").expect("valid");
    assert_eq!(read.fleet.as_deref(), Some("lions"));
}

#[test]
fn secret_that_would_not_be_proved_is_rejected() {
    let both = "ble/wombat-2#plain=true;secret=/etc/rect/users";
    assert_eq!(connect(both), Err(LocatorError::PlainWithSecret));
    assert!(connect("ble/wombat-2#plain=false;secret=/etc/rect/users").is_ok());
    // With sec=high, the passkey is derived from the secret.
    assert!(connect(&format!("{both};sec=high")).is_ok());
}

#[test]
fn unknown_option_is_reported_with_the_known_ones() {
    let error = connect("ble/wombat-2#speed=fast")
        .expect_err("unknown")
        .to_string();
    assert!(
        error.contains("`speed`") && error.contains("psm"),
        "{error}"
    );
}

#[test]
fn adapter_is_rejected_as_peer_and_peer_as_adapter() {
    assert!(matches!(
        connect("ble/hci0"),
        Err(LocatorError::AdapterAsTarget { .. })
    ));
    assert!(matches!(
        listen("ble/wombat-1"),
        Err(LocatorError::Adapter { .. })
    ));
    assert!(matches!(
        connect("ble/wombat 2"),
        Err(LocatorError::Target { .. })
    ));
}
