"""RECT: robots that talk over TCP, UDP and Bluetooth Low Energy, on Zenoh.

    import rect

    with rect.connect("wombat-1") as robot:
        robot.publish("arm/angle", {"degrees": 12.5})
        for message in robot.subscribe("*/arm/angle"):
            print(message.sender, message.value)

`rect.aio` is the same for asyncio.
"""

from rect._rect import Codec, Dictionary, __version__
from rect.errors import (
    Closed,
    CodecError,
    DictionaryError,
    FileError,
    InvalidNameError,
    InvalidTopicError,
    LoginRefused,
    NoRouter,
    NoService,
    OptionError,
    PayloadError,
    RectError,
    ServiceError,
    TimedOut,
    TransferError,
    TransferFailed,
    TransferRefused,
    WrongRobot,
    ZenohError,
)
from rect.message import Message
from rect.registry import Connection, Connections
from rect.request import Replies, Reply
from rect.robot import Robot, connect
from rect.service import Refusal, Request, Service
from rect.state import Counters, Event, Events
from rect.stream import Frame, Stream, Watch
from rect.subscriber import Subscriber, Subscription, Tally
from rect.transfer import Progress, Received, Transfers
from rect.values import Cbor, Payload, Picture

__all__ = [
    "Cbor",
    "Closed",
    "Codec",
    "CodecError",
    "Connection",
    "Connections",
    "Counters",
    "Dictionary",
    "DictionaryError",
    "Event",
    "Events",
    "FileError",
    "Frame",
    "InvalidNameError",
    "InvalidTopicError",
    "LoginRefused",
    "Message",
    "NoRouter",
    "NoService",
    "OptionError",
    "Payload",
    "PayloadError",
    "Picture",
    "Progress",
    "Received",
    "RectError",
    "Refusal",
    "Replies",
    "Reply",
    "Request",
    "Robot",
    "Service",
    "ServiceError",
    "Stream",
    "Subscriber",
    "Subscription",
    "Tally",
    "TimedOut",
    "TransferError",
    "TransferFailed",
    "TransferRefused",
    "Transfers",
    "Watch",
    "WrongRobot",
    "ZenohError",
    "__version__",
    "connect",
]
