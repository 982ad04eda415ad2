//! Checks that this crate has everything of the published crate zenoh-link 1.10.2:
//! `cargo test -p zenoh-link --test compatibility`.
//!
//! The lists in this file were taken from the published crate. If its source is on the machine (cargo does not fetch it
//! while the patch is in place), the list of features is also compared with the source.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

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

/// The links of the published crate, each of which is an optional dependency and therefore a feature.
const LINKS: [&str; 10] = [
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
];

#[test]
fn every_feature_of_the_table_is_unchanged() {
    let mut expected = stock_features();
    // `ble` is for the other drop-in.
    expected.insert("ble".to_owned(), vec!["dep:zenoh-link-ble".to_owned()]);
    if let Some(uring) = expected.get_mut("uring") {
        uring.push("zenoh-link-ble?/uring".to_owned());
        uring.sort();
    }
    assert_eq!(features(&crate_manifest("zenoh-link-table")), expected);
}

#[test]
fn both_drop_ins_have_the_features_of_the_published_crate_and_no_others() {
    let links = LINKS.map(|link| format!("zenoh-link-{link}"));
    let mut expected: Vec<_> = stock_features().into_keys().chain(links).collect();
    expected.sort();
    for drop_in in ["zenoh-link", "zenoh-link-with-ble"] {
        let features = features(&crate_manifest(drop_in));
        assert_eq!(
            features.keys().cloned().collect::<Vec<_>>(),
            expected,
            "{drop_in}"
        );
        for (name, parts) in &features {
            // A feature enables the one of the same meaning in the table, either itself or through that of the link.
            let (feature, forwarded) = match (
                &STOCK_FEATURES.iter().find(|(stock, _)| stock == name),
                &parts[..],
            ) {
                (Some(_), [link]) if name != "uring" => (name, features[link].concat()),
                (_, [one]) if name == "uring" => (name, one.clone()),
                (None, [one]) => {
                    let link = name
                        .trim_start_matches("zenoh-link-")
                        .replace("unixsock_stream", "unixsock-stream");
                    assert_eq!(
                        *one,
                        format!("zenoh-link-table/transport_{link}"),
                        "{drop_in}"
                    );
                    continue;
                }
                _ => panic!("{drop_in}: {name} = {parts:?}"),
            };
            assert_eq!(
                forwarded,
                format!("zenoh-link-table/{feature}"),
                "{drop_in}"
            );
        }
    }
}

#[test]
fn drop_in_depends_on_none_of_our_links() {
    let dependencies = &manifest(&crate_manifest("zenoh-link"))["dependencies"];
    let names: Vec<_> = dependencies.as_table().expect("a table").keys().collect();
    assert_eq!(names, ["zenoh-link-table"]);
    let table = manifest(&crate_manifest("zenoh-link-table"));
    for link in [
        "link-lanes",
        "rect-links",
        "zenoh-link-any",
        "zenoh-link-placeholder",
    ] {
        assert!(table["dependencies"].get(link).is_none(), "{link}");
    }
    let ble = &table["dependencies"]["zenoh-link-ble"];
    assert_eq!(ble["optional"].as_bool(), Some(true));
    assert!(!features(&crate_manifest("zenoh-link-table")).contains_key("default"));
}

#[test]
fn optional_dependencies_have_the_version_of_the_published_crate() {
    let table = manifest(&crate_manifest("zenoh-link-table"));
    for link in LINKS {
        let dependency = &table["dependencies"][&format!("zenoh-link-{link}")];
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
    assert_eq!(features(&stock), stock_features());
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
            "ws"
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
            Registered
        ]
    );
}

#[test]
fn selects_links_in_the_order_of_the_protocols() {
    use LinkKind::*;
    let kinds = LinkKind::new_supported_links(["ws", "quic", "pigeon", "vsock"].into_iter());
    assert_eq!(kinds, [Ws, Quic, QuicDatagram, Vscock]);
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
    for (locator, multicast) in [("udp/224.0.0.1:7446", true), ("udp/127.0.0.1:1", false)] {
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
    let error = LinkManagerBuilderMulticast::make(LinkKind::Registered)
        .err()
        .expect("no groups")
        .to_string();
    assert!(
        error.contains("Multicast not supported for link Registered"),
        "{error}"
    );
}

fn stock_features() -> BTreeMap<String, Vec<String>> {
    let listed = STOCK_FEATURES.iter();
    listed
        .map(|(name, parts)| {
            (
                (*name).to_owned(),
                parts.iter().map(|p| (*p).to_owned()).collect(),
            )
        })
        .collect()
}

fn crate_manifest(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    folder.with_file_name(name).join("Cargo.toml")
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
