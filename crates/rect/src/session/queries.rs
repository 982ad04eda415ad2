//! Declares publishers, publishes, queries and answers on a Zenoh session as the core's actions say.
use rect_core::{
    driver::{Answer, Get, RetainedReply, Sample, Target},
    message::{payload::Payload, urgency::Qos},
};
use zenoh::{
    bytes::{Encoding, ZBytes},
    handlers::{CallbackDrop, DefaultHandler},
    liveliness::Liveliness,
    pubsub::{PublicationBuilder, Publisher, PublisherBuilder},
    query::{ConsolidationMode, Query, QueryTarget, Reply},
    sample::SourceInfo,
    session::SessionGetBuilder,
    Session, Wait,
};

use super::convert::{self, congestion_control, priority};
use crate::error::Error;

/// Declares a publisher.
pub(super) fn publisher(
    session: &Session,
    key: String,
    qos: Qos,
) -> Result<Publisher<'static>, Error> {
    let declared = session
        .declare_publisher(key)
        .priority(priority(qos))
        .express(qos.express)
        .congestion_control(congestion_control(qos))
        .wait();
    declared.map_err(Error::zenoh("cannot declare the publisher"))
}

pub(super) fn put(
    publisher: &Publisher<'static>,
    payload: Payload,
    attachment: Option<Vec<u8>>,
) -> Result<(), Error> {
    let put = publisher
        .put(payload.bytes)
        .encoding(Encoding::from(payload.encoding.as_str()))
        .attachment(attachment);
    put.wait().map_err(Error::zenoh("cannot send the message"))
}

pub(super) fn put_once(
    session: &Session,
    key: &str,
    payload: Payload,
    qos: Qos,
) -> Result<(), Error> {
    let put = with_qos(session.put(key, payload.bytes), qos)
        .encoding(Encoding::from(payload.encoding.as_str()));
    put.wait().map_err(Error::zenoh("cannot send the message"))
}

/// Sets the quality of service of a message.
fn with_qos<'a, 'b, T>(
    message: PublicationBuilder<PublisherBuilder<'a, 'b>, T>,
    qos: Qos,
) -> PublicationBuilder<PublisherBuilder<'a, 'b>, T> {
    message
        .priority(priority(qos))
        .express(qos.express)
        .congestion_control(congestion_control(qos))
}

/// Publishes a retained message, or that its topic is forgotten.
pub(super) fn put_retained(
    session: &Session,
    key: &str,
    payload: Option<Payload>,
    qos: Qos,
    attachment: Vec<u8>,
    number: u32,
) -> Result<(), Error> {
    let source = source(session, number);
    let sent = match payload {
        Some(payload) => with_qos(session.put(key, payload.bytes), qos)
            .encoding(Encoding::from(payload.encoding.as_str()))
            .attachment(attachment)
            .source_info(source)
            .wait(),
        None => with_qos(session.delete(key), qos)
            .attachment(attachment)
            .source_info(source)
            .wait(),
    };
    sent.map_err(Error::zenoh("cannot send the message"))
}

/// Returns the source information by which zenoh-ext tells old messages from new ones.
fn source(session: &Session, number: u32) -> SourceInfo {
    SourceInfo::new(session.id(), number)
}

/// Sends a query. `on_end` is called exactly once, after the last reply or if the query cannot be sent.
pub(super) fn get(
    session: &Session,
    get: Get,
    on_reply: impl Fn(Result<Sample, Payload>) + Send + Sync + 'static,
    on_end: impl FnOnce() + Send + Sync + 'static,
) {
    let mut on_end = Some(on_end);
    let handler = CallbackDrop {
        callback: move |reply: Reply| on_reply(convert::reply(reply)),
        drop: move || {
            if let Some(on_end) = on_end.take() {
                on_end();
            }
        },
    };
    let key = get.selector.clone();
    let sent = if get.liveliness {
        let liveliness: Liveliness = session.liveliness();
        let asked = liveliness.get(get.selector).timeout(get.timeout);
        asked.with(handler).wait()
    } else {
        builder(session, get).with(handler).wait()
    };
    if let Err(error) = sent {
        // `on_end` has been called.
        tracing::debug!("cannot query {key}: {error}");
    }
}

/// Prepares a query for data.
pub(super) fn builder<'a>(
    session: &'a Session,
    get: Get,
) -> SessionGetBuilder<'a, 'static, DefaultHandler> {
    let target = match get.target {
        Target::All => QueryTarget::All,
        Target::BestMatching => QueryTarget::BestMatching,
    };
    let prepared = session
        .get(get.selector)
        .target(target)
        .consolidation(ConsolidationMode::None)
        .priority(priority(get.qos))
        .express(get.qos.express)
        .congestion_control(congestion_control(get.qos))
        .timeout(get.timeout)
        .attachment(get.attachment);
    match get.payload {
        Some(Payload { bytes, encoding }) => prepared.payload(bytes).encoding(encoding.as_str()),
        None => prepared,
    }
}

/// Answers a query. An answer that cannot be sent is repeated by the protocols that need it.
pub(super) fn answer(query: &Query, answer: Answer) {
    if let Err(error) = try_answer(query, answer, None) {
        tracing::debug!("cannot reply on {}: {error}", query.key_expr());
    }
}

/// Answers a query with the values of retained topics.
pub(super) fn answer_retained(session: &Session, query: &Query, replies: Vec<RetainedReply>) {
    for reply in replies {
        let sent = query
            .reply(&reply.key, reply.payload.bytes)
            .encoding(reply.payload.encoding.as_str())
            .attachment(reply.attachment)
            .source_info(source(session, reply.number));
        if let Err(error) = sent.wait() {
            tracing::debug!("cannot reply on {}: {error}", reply.key);
        }
    }
}

/// Answers a query. `mark` is the attachment of a reply.
pub(super) fn try_answer(query: &Query, answer: Answer, mark: Option<&[u8]>) -> zenoh::Result<()> {
    match answer {
        Answer::Reply { key, payload } => {
            let reply = query.reply(key, payload.bytes).attachment(mark);
            reply.encoding(payload.encoding.as_str()).wait()
        }
        Answer::Error(payload) => {
            let reply = query.reply_err(payload.bytes);
            reply.encoding(payload.encoding.as_str()).wait()
        }
        Answer::None => Ok(()),
    }
}

/// Returns the payload of a query, which is empty if there is none.
pub(super) fn payload_of(query: &Query) -> Payload {
    let empty = (ZBytes::new(), Encoding::default());
    let bytes = query.payload().unwrap_or(&empty.0);
    convert::payload(bytes, query.encoding().unwrap_or(&empty.1))
}
