//! Implements [`Peer`] with gRPC, using tonic: published messages share one stream, a request is a unary call. The service
//! is written by hand as tonic's generator would write it, because the generator requires protoc:
//!
//! ```text
//! message Message { bytes payload = 1; }
//! service Bench {
//!   rpc Echo(stream Message) returns (stream Message);
//!   rpc Flood(stream Message) returns (Message);
//!   rpc Ask(Message) returns (Message);
//! }
//! ```
use std::{
    convert::Infallible,
    future::Future,
    sync::Arc,
    task::{Context, Poll},
};

use bytes::Bytes;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{
    body::Body,
    client,
    codegen::{http, http::uri::PathAndQuery, BoxFuture, Service},
    server::{self, ClientStreamingService, NamedService, StreamingService, UnaryService},
    transport::{Channel, Endpoint, Server},
    Request, Response, Status, Streaming,
};
use tonic_prost::ProstCodec;

use super::{
    arrivals::ArrivalCounter,
    peer::{About, Meeting, Outcome, Peer},
};

/// The capacity of the queues, the same as that of a subscriber of RECT or Zenoh.
const WAITING: usize = 256;

#[derive(Clone, PartialEq, prost::Message)]
struct Message {
    #[prost(bytes = "bytes", tag = "1")]
    payload: Bytes,
}

type Codec = ProstCodec<Message, Message>;

pub struct Grpc {
    client: client::Grpc<Channel>,
    echo: mpsc::Sender<Message>,
    echoes: Streaming<Message>,
    flood: mpsc::Sender<Message>,
}

impl Peer for Grpc {
    async fn serve(meeting: Meeting, arrivals: Arc<ArrivalCounter>) -> Outcome<()> {
        let server = Server::builder().add_service(Bench { arrivals });
        Ok(server.serve(meeting.address).await?)
    }

    async fn join(meeting: Meeting) -> Outcome<Self> {
        let endpoint = Endpoint::from_shared(format!("http://{}", meeting.address))?;
        let mut client = client::Grpc::new(endpoint.connect().await?);
        let (echo, messages) = mpsc::channel(WAITING);
        client.ready().await?;
        let messages = Request::new(ReceiverStream::new(messages));
        let path = PathAndQuery::from_static("/Bench/Echo");
        let echoes = client.streaming(messages, path, Codec::default()).await?;
        let (flood, messages) = mpsc::channel(WAITING);
        let mut flooding = client.clone();
        tokio::spawn(async move {
            flooding.ready().await?;
            let messages = Request::new(ReceiverStream::new(messages));
            let path = PathAndQuery::from_static("/Bench/Flood");
            let ended = flooding.client_streaming::<_, Message, Message, _>(
                messages,
                path,
                Codec::default(),
            );
            Outcome::Ok(ended.await?)
        });
        Ok(Self {
            client,
            echo,
            echoes: echoes.into_inner(),
            flood,
        })
    }

    async fn publish(&self, about: About, payload: Bytes) -> Outcome<()> {
        let stream = match about {
            About::Echo => &self.echo,
            About::Flood => &self.flood,
        };
        Ok(stream.send(Message { payload }).await?)
    }

    async fn next_echo(&mut self) -> Outcome<Bytes> {
        let message = self.echoes.message().await?;
        Ok(message.ok_or("the stream ended")?.payload)
    }

    async fn request(&mut self, payload: Bytes) -> Outcome<Bytes> {
        self.client.ready().await?;
        let request = Request::new(Message { payload });
        let path = PathAndQuery::from_static("/Bench/Ask");
        let answer = self.client.unary(request, path, Codec::default());
        let answer: Response<Message> = answer.await?;
        Ok(answer.into_inner().payload)
    }
}

#[derive(Clone)]
struct Bench {
    arrivals: Arc<ArrivalCounter>,
}

impl NamedService for Bench {
    const NAME: &'static str = "Bench";
}

impl Service<http::Request<Body>> for Bench {
    type Response = http::Response<Body>;
    type Error = Infallible;
    type Future = BoxFuture<Self::Response, Self::Error>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, request: http::Request<Body>) -> Self::Future {
        let arrivals = self.arrivals.clone();
        Box::pin(async move {
            let mut grpc = server::Grpc::new(Codec::default());
            Ok(match request.uri().path() {
                "/Bench/Echo" => grpc.streaming(Echo, request).await,
                "/Bench/Flood" => grpc.client_streaming(Flood(arrivals), request).await,
                "/Bench/Ask" => grpc.unary(Ask(arrivals), request).await,
                _ => Status::unimplemented("no such method").into_http(),
            })
        })
    }
}

type Answering<T> = std::pin::Pin<Box<dyn Future<Output = Result<Response<T>, Status>> + Send>>;

struct Echo;

impl StreamingService<Message> for Echo {
    type Response = Message;
    type ResponseStream = Streaming<Message>;
    type Future = Answering<Streaming<Message>>;

    fn call(&mut self, messages: Request<Streaming<Message>>) -> Self::Future {
        Box::pin(async { Ok(Response::new(messages.into_inner())) })
    }
}

struct Flood(Arc<ArrivalCounter>);

impl ClientStreamingService<Message> for Flood {
    type Response = Message;
    type Future = Answering<Message>;

    fn call(&mut self, messages: Request<Streaming<Message>>) -> Self::Future {
        let arrivals = self.0.clone();
        let mut messages = messages.into_inner();
        Box::pin(async move {
            while messages.message().await?.is_some() {
                arrivals.on_message();
            }
            Ok(Response::new(Message::default()))
        })
    }
}

struct Ask(Arc<ArrivalCounter>);

impl UnaryService<Message> for Ask {
    type Response = Message;
    type Future = Answering<Message>;

    fn call(&mut self, request: Request<Message>) -> Self::Future {
        let payload = self.0.answer(request.into_inner().payload);
        Box::pin(async { Ok(Response::new(Message { payload })) })
    }
}
