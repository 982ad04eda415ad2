//! Checks that this crate has everything of the published crate zenoh-link 1.10.2:
//! `cargo test -p zenoh-link --test compatibility`.
//!
//! The lists in this file were taken from the published crate. If its source is on the machine (cargo does not fetch it
//! while the patch is in place), the list of features is also compared with the source.

use std::{collections::BTreeMap, fs, path::Path};

use toml::Table;
// Each name must be public and of the kind in which it is used below.
use zenoh_link::{
    quic, quic_datagram, serial, tcp, tls, udp, unixpipe, unixsock_stream, vsock, ws, EndPoint,
    Link, LinkAuthId, LinkConfigurator, LinkKind, LinkManagerBuilderMulticast,
    LinkManagerBuilderUnicast, LinkManagerMulticast, LinkManagerUnicast, LinkMulticast,
    LinkUnicast, Locator, LocatorInspector, NewLink, NewLinkChannelSender, ALL_SUPPORTED_LINKS,
};

const STOCK_FEATURES: &[(&str, &[&str])] = &[
    ("transport_quic", &["zenoh-link-quic"]),
    ("transport_quic_datagram", &["zenoh-link-quic_datagram"]),
    ("transport_serial", &["zenoh-link-serial"]),
    (
        "transport_tcp",
        &["zenoh-config/transport_tcp", "zenoh-link-tcp"],
    ),
    ("transport_tls", &["zenoh-link-tls"]),
    ("transport_udp", &["zenoh-link-udp"]),
    (
        "transport_unixpipe",
        &[
            "zenoh-link-unixpipe",
            "zenoh-link-unixpipe/transport_unixpipe",
        ],
    ),
    ("transport_unixsock-stream", &["zenoh-link-unixsock_stream"]),
    ("transport_vsock", &["zenoh-link-vsock"]),
    ("transport_ws", &["zenoh-link-ws"]),
    (
        "uring",
        &[
            "zenoh-link-commons/uring",
            "zenoh-link-quic/uring",
            "zenoh-link-quic_datagram/uring",
            "zenoh-link-serial/uring",
            "zenoh-link-tcp/uring",
            "zenoh-link-tls/uring",
            "zenoh-link-udp/uring",
            "zenoh-link-unixpipe/uring",
            "zenoh-link-unixsock_stream/uring",
            "zenoh-link-vsock/uring",
            "zenoh-link-ws/uring",
        ],
    ),
];

#[test]
fn every_feature_is_unchanged() {
    let mut expected: BTreeMap<String, Vec<String>> = STOCK_FEATURES
        .iter()
        .map(|(name, parts)| {
            (
                (*name).to_owned(),
                parts.iter().map(|p| (*p).to_owned()).collect(),
            )
        })
        .collect();
    if let Some(uring) = expected.get_mut("uring") {
        uring.extend(["zenoh-link-any/uring", "zenoh-link-ble/uring"].map(str::to_owned));
        uring.sort();
    }
    assert_eq!(
        features(Path::new(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/Cargo.toml"
        ))),
        expected
    );
}

#[test]
fn optional_dependencies_are_features() {
    let ours = manifest(Path::new(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/Cargo.toml"
    )));
    for link in [
        "quic",
        "quic_datagram",
        "serial",
        "tcp",
        "tls",
        "udp",
        "unixpipe",
        "unixsock_stream",
        "vsock",
        "ws",
    ] {
        let dependency = &ours["dependencies"][&format!("zenoh-link-{link}")];
        assert_eq!(dependency["optional"].as_bool(), Some(true), "{link}");
        assert_eq!(dependency["version"].as_str(), Some("=1.10.2"), "{link}");
    }
}

#[test]
fn feature_list_matches_the_published_crate() {
    let registry = std::env::var_os("CARGO_HOME")
        .map(std::path::PathBuf::from)
        .or_else(|| Some(Path::new(&std::env::var_os("HOME")?).join(".cargo")))
        .map(|cargo| cargo.join("registry/src"));
    let stock = registry
        .and_then(|dir| fs::read_dir(dir).ok())
        .into_iter()
        .flatten()
        .flatten()
        .map(|index| index.path().join("zenoh-link-1.10.2/Cargo.toml"))
        .find(|manifest| manifest.exists());
    let Some(stock) = stock else {
        println!("skipped: the source of the published crate is not on this machine");
        return;
    };
    let listed: BTreeMap<String, Vec<String>> = STOCK_FEATURES
        .iter()
        .map(|(name, parts)| {
            (
                (*name).to_owned(),
                parts.iter().map(|p| (*p).to_owned()).collect(),
            )
        })
        .collect();
    assert_eq!(features(&stock), listed);
}

#[test]
fn every_public_item_exists() {
    // Checks the modules by their locator prefixes.
    let prefixes = [
        quic::QUIC_LOCATOR_PREFIX,
        quic_datagram::QUIC_DATAGRAM_LOCATOR_PREFIX,
        serial::SERIAL_LOCATOR_PREFIX,
        tcp::TCP_LOCATOR_PREFIX,
        tls::TLS_LOCATOR_PREFIX,
        udp::UDP_LOCATOR_PREFIX,
        unixpipe::UNIXPIPE_LOCATOR_PREFIX,
        unixsock_stream::UNIXSOCKSTREAM_LOCATOR_PREFIX,
        vsock::VSOCK_LOCATOR_PREFIX,
        ws::WS_LOCATOR_PREFIX,
        zenoh_link::ble::BLE_LOCATOR_PREFIX,
    ];
    assert_eq!(
        prefixes,
        [
            "quic",
            "quic",
            "serial",
            "tcp",
            "tls",
            "udp",
            "unixpipe",
            "unixsock-stream",
            "vsock",
            "ws",
            "ble"
        ]
    );
    // The functions, by their signatures.
    let _: fn(NewLinkChannelSender, &EndPoint) -> zenoh::Result<LinkManagerUnicast> =
        LinkManagerBuilderUnicast::make;
    let _: fn(LinkKind) -> zenoh::Result<LinkManagerMulticast> = LinkManagerBuilderMulticast::make;
    let _: fn(&LocatorInspector, &Locator) -> zenoh::Result<bool> = LocatorInspector::is_reliable;
    let _ = LocatorInspector::is_multicast;
    let _ = LinkConfigurator::configurations;
    // Checks that the re-exported names are types.
    fn is_type<T>() {}
    is_type::<(Link, LinkAuthId, LinkMulticast, LinkUnicast, NewLink)>();
    fn has_stock_traits<T: std::fmt::Debug + Default>() {}
    has_stock_traits::<LocatorInspector>();
    has_stock_traits::<LinkConfigurator>();
}

#[test]
fn links_have_the_order_of_the_published_crate() {
    use LinkKind::*;
    assert_eq!(
        ALL_SUPPORTED_LINKS,
        [
            Quic,
            QuicDatagram,
            Tcp,
            Tls,
            Udp,
            Ws,
            UnixsockStream,
            Serial,
            Unixpipe,
            Vscock,
            Ble,
            Any,
            Placeholder
        ]
    );
}

#[test]
fn selects_links_in_the_order_of_the_protocols() {
    use LinkKind::*;
    let kinds = LinkKind::new_supported_links(["ws", "quic", "pigeon", "ble", "vsock"].into_iter());
    assert_eq!(kinds, [Ws, Quic, QuicDatagram, Ble, Vscock]);
}

#[test]
fn selects_the_link_of_a_locator() {
    for (locator, kind, reliable) in [
        ("tcp/127.0.0.1:1", LinkKind::Tcp, true),
        ("udp/127.0.0.1:1", LinkKind::Udp, false),
        ("tls/localhost:1", LinkKind::Tls, true),
        ("quic/localhost:1", LinkKind::Quic, true),
        ("quic/localhost:1?rel=1", LinkKind::Quic, true),
        ("quic/localhost:1?rel=0", LinkKind::QuicDatagram, false),
        ("ws/localhost:1", LinkKind::Ws, true),
        ("unixsock-stream//tmp/x", LinkKind::UnixsockStream, true),
        ("unixpipe//tmp/x", LinkKind::Unixpipe, true),
        ("serial//dev/ttyS0", LinkKind::Serial, false),
        ("vsock/1:1", LinkKind::Vscock, true),
        ("ble/wombat-2", LinkKind::Ble, true),
    ] {
        let parsed: Locator = locator.parse().expect("a locator");
        assert_eq!(
            LinkKind::try_from(&parsed).expect("a link"),
            kind,
            "{locator}"
        );
        assert_eq!(
            LocatorInspector.is_reliable(&parsed).expect("a link"),
            reliable,
            "{locator}"
        );
    }
}

#[test]
fn error_names_an_unknown_protocol() {
    let locator: Locator = "pigeon/home".parse().expect("a locator");
    let error = LinkKind::try_from(&locator)
        .expect_err("no link")
        .to_string();
    assert!(
        error.contains("Unicast not supported for pigeon protocol"),
        "{error}"
    );
}

#[tokio::test]
async fn only_udp_supports_multicast() {
    for (locator, multicast) in [
        ("udp/224.0.0.1:7446", true),
        ("udp/127.0.0.1:1", false),
        ("ble/wombat-2", false),
    ] {
        let parsed: Locator = locator.parse().expect("a locator");
        assert_eq!(
            LocatorInspector
                .is_multicast(&parsed)
                .await
                .expect("a link"),
            multicast,
            "{locator}"
        );
    }
    assert!(LinkManagerBuilderMulticast::make(LinkKind::Udp).is_ok());
    let error = LinkManagerBuilderMulticast::make(LinkKind::Ble)
        .err()
        .expect("no groups")
        .to_string();
    assert!(
        error.contains("Multicast not supported for link Ble"),
        "{error}"
    );
}

fn features(manifest_path: &Path) -> BTreeMap<String, Vec<String>> {
    let manifest = manifest(manifest_path);
    let features = manifest["features"].as_table().expect("a table");
    features
        .iter()
        .map(|(name, parts)| {
            let parts = parts.as_array().expect("a list").iter();
            let mut parts: Vec<String> = parts
                .map(|p| p.as_str().expect("text").to_owned())
                .collect();
            parts.sort();
            (name.clone(), parts)
        })
        .collect()
}

fn manifest(path: &Path) -> Table {
    fs::read_to_string(path)
        .expect("a manifest")
        .parse()
        .expect("TOML")
}
