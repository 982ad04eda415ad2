use zenoh_buffers::ZBuf;
use zenoh_codec::{WCodec, Zenoh080};
use zenoh_protocol::{
    core::{CongestionControl, Encoding, Priority, Reliability},
    network::{
        declare::{self, DeclareBody, DeclareKeyExpr, UndeclareKeyExpr},
        push, request, response, Declare, Mapping, NetworkBody, NetworkMessage, Push, Request,
        Response, ResponseFinal,
    },
    transport::KeepAlive,
    zenoh::{ConsolidationMode, PushBody, Put, Query, Reply, RequestBody, ResponseBody},
};

use super::*;
use crate::lanes::batch_kind::{self, tests::fragment};

const KEEP: Duration = Duration::from_secs(5);
/// The number of bytes that a link adds to a batch in these tests.
const OVERHEAD: u64 = 9;

fn data_lane() -> Lane {
    Lane::of(Priority::Data)
}

fn put(bytes: usize) -> Put {
    Put {
        timestamp: None,
        encoding: Encoding::empty(),
        ext_sinfo: None,
        ext_attachment: None,
        ext_unknown: Vec::new(),
        payload: ZBuf::from(vec![7; bytes]),
    }
}

fn push(expr: WireExpr<'static>, bytes: usize) -> NetworkBody {
    NetworkBody::Push(Push {
        wire_expr: expr,
        ext_qos: push::ext::QoSType::new(Priority::Data, CongestionControl::Drop, false),
        ext_tstamp: None,
        ext_nodeid: push::ext::NodeIdType { node_id: 3 },
        ext_ts_stack: None,
        payload: PushBody::Put(put(bytes)),
    })
}

fn declare(body: DeclareBody) -> NetworkBody {
    NetworkBody::Declare(Declare {
        interest_id: None,
        ext_qos: declare::ext::QoSType::DECLARE,
        ext_tstamp: None,
        ext_nodeid: declare::ext::NodeIdType::DEFAULT,
        body,
    })
}

fn declared(id: u16, key: WireExpr<'static>) -> Vec<u8> {
    let body = DeclareBody::DeclareKeyExpr(DeclareKeyExpr { id, wire_expr: key });
    framed([declare(body)])
}

fn numbered(scope: u16, suffix: &'static str, mapping: Mapping) -> WireExpr<'static> {
    WireExpr {
        scope,
        suffix: suffix.into(),
        mapping,
    }
}

fn encoded(body: NetworkBody) -> Vec<u8> {
    let message = NetworkMessage {
        body,
        reliability: Reliability::Reliable,
    };
    let mut bytes = Vec::new();
    assert!(Zenoh080::new().write(&mut bytes, &message).is_ok());
    bytes
}

fn framed(messages: impl IntoIterator<Item = NetworkBody>) -> Vec<u8> {
    let messages = messages.into_iter().flat_map(encoded);
    batch_kind::tests::framed(&messages.collect::<Vec<_>>())
}

/// A link that is asked for its usage, and the bytes that it has sent.
struct Link {
    keys: KeyTable,
    usage: Usage,
    now: Instant,
    sent: u64,
}

impl Link {
    fn new() -> Self {
        let mut link = Self {
            keys: KeyTable::default(),
            usage: Usage::default(),
            now: Instant::now(),
            sent: 0,
        };
        assert_eq!(link.usage.ask(link.now, KEEP), UsageReport::default());
        link
    }

    fn send(&mut self, lane: Lane, batch: &[u8]) {
        let bytes = batch.len() as u64 + OVERHEAD;
        let size = Size {
            bytes,
            cost: 2 * bytes,
        };
        self.sent += bytes;
        self.usage.on_batch(&self.keys, lane, batch, size, self.now);
    }

    /// Returns what was counted, after a check that it adds up to what was sent.
    fn counted(&mut self) -> Vec<(Purpose, u64)> {
        let report = self.usage.ask(self.now, KEEP);
        let mut total = Size::default();
        report.sent.iter().for_each(|(_, size)| total += *size);
        let expected = Size {
            bytes: self.sent,
            cost: 2 * self.sent,
        };
        assert_eq!(total, expected);
        let sent = report.sent.into_iter();
        sent.map(|(purpose, size)| (purpose, size.bytes)).collect()
    }
}

fn key(key: &str) -> Purpose {
    Purpose::Key(key.to_owned())
}

#[test]
fn keys_that_either_side_has_declared_are_known_by_their_numbers() {
    let mut link = Link::new();
    let robot = declared(7, WireExpr::from("rect/wombat-1"));
    link.keys.on_batch(Side::Own, &robot);
    let pose = declared(8, numbered(7, "/pose", Mapping::Sender));
    link.keys.on_batch(Side::Own, &pose);
    let other = declared(7, WireExpr::from("rect/wombat-2/camera"));
    link.keys.on_batch(Side::Peer, &other);
    for expr in [
        numbered(8, "", Mapping::Sender),
        numbered(7, "/arm/angle", Mapping::Sender),
        numbered(7, "", Mapping::Receiver),
        numbered(0, "rect/wombat-1/pose", Mapping::Receiver),
        // Nobody has declared this one.
        numbered(9, "/arm/angle", Mapping::Sender),
    ] {
        link.send(data_lane(), &framed([push(expr, 100)]));
    }
    let counted = link.counted();
    let purposes: Vec<_> = counted.iter().map(|(purpose, _)| purpose.clone()).collect();
    let expected = [
        key("rect/wombat-1/arm/angle"),
        key("rect/wombat-1/pose"),
        key("rect/wombat-2/camera"),
        Purpose::Other,
    ];
    assert_eq!(purposes, expected);
    let undeclared = declare(DeclareBody::UndeclareKeyExpr(UndeclareKeyExpr { id: 8 }));
    link.keys.on_batch(Side::Own, &framed([undeclared]));
    let before = counted[3].1;
    let again = framed([push(numbered(8, "", Mapping::Sender), 100)]);
    link.send(data_lane(), &again);
    assert_eq!(link.counted()[3].1, before + again.len() as u64 + OVERHEAD);
}

#[test]
fn each_message_of_a_frame_counts_with_its_share_of_what_is_added() {
    let mut link = Link::new();
    let messages = [
        push(WireExpr::from("a"), 300),
        push(WireExpr::from("b"), 100),
        push(WireExpr::from("a"), 300),
    ];
    let batch = framed(messages);
    link.send(data_lane(), &batch);
    let [(a, of_a), (b, of_b)] = &link.counted()[..] else {
        panic!("two keys are expected");
    };
    assert_eq!((a, b), (&key("a"), &key("b")));
    assert_eq!(of_a + of_b, batch.len() as u64 + OVERHEAD);
    assert!(
        (600..640).contains(of_a) && (100..120).contains(of_b),
        "{of_a} {of_b}"
    );
}

#[test]
fn requests_and_replies_count_for_their_keys() {
    let mut link = Link::new();
    let request = NetworkBody::Request(Request {
        id: 5,
        wire_expr: WireExpr::from("rect/wombat-1/grab"),
        ext_qos: request::ext::QoSType::DEFAULT,
        ext_tstamp: None,
        ext_nodeid: request::ext::NodeIdType::DEFAULT,
        ext_target: request::ext::QueryTarget::DEFAULT,
        ext_budget: None,
        ext_timeout: Some(Duration::from_secs(1)),
        ext_ts_stack: None,
        payload: RequestBody::Query(Query {
            consolidation: ConsolidationMode::DEFAULT,
            parameters: String::new(),
            ext_sinfo: None,
            ext_body: None,
            ext_attachment: None,
            ext_unknown: Vec::new(),
        }),
    });
    let reply = NetworkBody::Response(Response {
        rid: 5,
        wire_expr: WireExpr::from("rect/wombat-1/grab"),
        payload: ResponseBody::Reply(Reply {
            consolidation: ConsolidationMode::DEFAULT,
            ext_unknown: Vec::new(),
            payload: PushBody::Put(put(50)),
        }),
        ext_qos: response::ext::QoSType::DEFAULT,
        ext_tstamp: None,
        ext_respid: None,
        ext_ts_stack: None,
    });
    let end = NetworkBody::ResponseFinal(ResponseFinal {
        rid: 5,
        ext_qos: response::ext::QoSType::DEFAULT,
        ext_tstamp: None,
    });
    // A reply in fragments, too.
    let large = encoded(reply.clone());
    link.send(data_lane(), &framed([request, reply, end]));
    link.send(data_lane(), &fragment(true, &large[..40]));
    link.send(data_lane(), &fragment(false, &large[40..]));
    let purposes: Vec<_> = link
        .counted()
        .into_iter()
        .map(|(purpose, _)| purpose)
        .collect();
    assert_eq!(purposes, [key("rect/wombat-1/grab"), Purpose::Zenoh]);
}

#[test]
fn fragments_count_for_the_message_that_they_belong_to_on_their_lane() {
    let mut link = Link::new();
    let (urgent, camera) = (Lane::of(Priority::RealTime), Lane::of(Priority::DataLow));
    let message = encoded(push(WireExpr::from("camera"), 900));
    link.send(camera, &fragment(true, &message[..300]));
    link.send(urgent, &framed([push(WireExpr::from("stop"), 1)]));
    link.send(camera, &fragment(false, &message[300..600]));
    link.send(camera, &fragment(false, &message[600..]));
    // The first fragment of this one was sent before anybody asked.
    link.send(data_lane(), &fragment(false, &[0; 50]));
    let counted = link.counted();
    let purposes: Vec<_> = counted.iter().map(|(purpose, _)| purpose.clone()).collect();
    assert_eq!(purposes, [key("camera"), key("stop"), Purpose::Other]);
    assert!(counted[0].1 > 900 && counted[2].1 < 100, "{counted:?}");
}

#[test]
fn what_cannot_be_parsed_counts_as_other() {
    let mut link = Link::new();
    let valid = framed([push(WireExpr::from("a"), 30), push(WireExpr::from("b"), 30)]);
    for end in 1..=valid.len() {
        link.send(data_lane(), &valid[..end]);
        link.keys.on_batch(Side::Peer, &valid[..end]);
    }
    link.send(data_lane(), &[]);
    link.send(data_lane(), &[0xff; 100]);
    link.send(data_lane(), &fragment(true, &[]));
    let mut bytes = valid.clone();
    for at in 0..bytes.len() {
        for flipped in [0x01, 0x20, 0x80, 0xff] {
            bytes[at] ^= flipped;
            link.send(data_lane(), &bytes);
            bytes[at] ^= flipped;
        }
    }
    link.sent -= OVERHEAD;
    assert!(link
        .counted()
        .iter()
        .any(|(purpose, _)| *purpose == Purpose::Other));
}

#[test]
fn messages_of_zenoh_and_of_the_link_have_purposes_of_their_own() {
    let mut link = Link::new();
    link.send(Lane::first(), &declared(1, WireExpr::from("a")));
    // The link compresses these.
    link.send(Lane::first(), &[0xff; 20]);
    let mut keep_alive = Vec::new();
    assert!(Zenoh080::new().write(&mut keep_alive, &KeepAlive).is_ok());
    link.send(data_lane(), &keep_alive);
    let own = Size {
        bytes: 11,
        cost: 22,
    };
    link.usage.on_own(own, link.now);
    link.sent += 11;
    let counted = link.counted();
    assert_eq!(counted[1], (Purpose::Link, 11));
    assert_eq!(counted[0].0, Purpose::Zenoh);
    assert_eq!(counted.len(), 2);
}

#[test]
fn nothing_is_counted_unless_somebody_has_asked_recently() {
    let mut link = Link::new();
    let batch = framed([push(WireExpr::from("a"), 30)]);
    link.now += KEEP;
    link.send(data_lane(), &batch);
    assert!(link.usage.count.is_none());
    assert_eq!(link.usage.ask(link.now, KEEP), UsageReport::default());
}

#[test]
fn the_count_covers_the_last_five_seconds() {
    let mut link = Link::new();
    let batch = framed([push(WireExpr::from("a"), 30)]);
    link.send(data_lane(), &framed([push(WireExpr::from("b"), 30)]));
    for _ in 0..100 {
        link.now += Duration::from_millis(100);
        link.usage.ask(link.now, KEEP);
        link.send(data_lane(), &batch);
    }
    link.now += Duration::from_millis(90);
    let report = link.usage.ask(link.now, KEEP);
    assert_eq!(report.sent.len(), 1, "b was sent earlier");
    let per_s = report.sent[0].1.bytes as f64 / report.window.as_secs_f64();
    let expected = 10.0 * (batch.len() as u64 + OVERHEAD) as f64;
    assert!(
        (0.95..1.05).contains(&(per_s / expected)),
        "{per_s} of {expected}"
    );
    // After a long silence everything is forgotten.
    link.usage.ask(link.now, Duration::from_secs(30));
    link.now += Duration::from_secs(20);
    assert_eq!(link.usage.ask(link.now, KEEP).sent, []);
}

#[test]
fn keys_and_declarations_are_limited() {
    let mut link = Link::new();
    for number in 0..1000 {
        let name: &'static str = Box::leak(format!("k/{number}").into_boxed_str());
        link.send(data_lane(), &framed([push(WireExpr::from(name), 1)]));
    }
    let counted = link.counted();
    assert_eq!(counted.len(), MAX_KEYS + 1);
    let long: &'static str = Box::leak("x".repeat(60_000).into_boxed_str());
    for number in 1..=u16::MAX {
        let batch = declared(number, WireExpr::from(long));
        link.keys.on_batch(Side::Peer, &batch);
        if number == 10 {
            break;
        }
    }
    let mut known = 0;
    for number in 1..=10 {
        let expr = numbered(number, "", Mapping::Receiver);
        known += usize::from(link.keys.append(Side::Own, &expr, &mut String::new()));
    }
    assert_eq!(known, 4);
}
