"""RECT, the Robot Extensible Communication Toolkit: robots communicate over TCP, UDP and Bluetooth Low Energy.

    import rect

    with rect.connect("wombat-1") as robot:
        robot.publish("arm/angle", {"degrees": 12.5})
        for message in robot.subscribe("*/arm/angle"):
            print(message.sender, message.value)

`connect` joins a fleet and returns a `Robot`, which publishes, subscribes, requests, serves, streams and transfers.
`rect.aio` is the API for asyncio. All errors are subclasses of `RectError`.
"""

from rect import _rect
from rect._rect import Codec, Dictionary, __version__
from rect.action import Action, Goal
from rect.action_run import ActionRun, Feedback, KnownGoal
from rect.alert import Alert
from rect.annotations import complete as _complete_annotations
from rect.choices import (
    Confirmation,
    ConnectionState,
    EventKind,
    Level,
    LossyFormat,
    Phase,
    PixelFormat,
    StreamMode,
    Urgency,
    WhenBusy,
    WhenFull,
)
from rect.deadman import Deadman
from rect.errors import (
    ActionError,
    Cancelled,
    Closed,
    CodecError,
    DictionaryError,
    FileError,
    Interrupted,
    InvalidNameError,
    InvalidTopicError,
    LoginRefused,
    MismatchError,
    NoAction,
    NoGoal,
    NoParameters,
    NoRouter,
    NoService,
    NotReachable,
    NotRetained,
    NotStored,
    OptionError,
    ParameterError,
    PayloadError,
    RecordingError,
    RectError,
    ServiceError,
    ServiceRefused,
    ThreadError,
    TimedOut,
    TransferError,
    TransferFailed,
    TransferRefused,
    WrongRobot,
    ZenohError,
)
from rect.events import Counters, Event, Events
from rect.log_handler import LogHandler
from rect.logs import LogLine, Logs
from rect.message import Message, Retained
from rect.parameter_types import Bool, Choice, Integer, Number, Numbers, Parameter, Text
from rect.parameters import GroupOptions, ParameterChange, ParameterGroup
from rect.program import Program, ServiceEntry
from rect.publisher import Publisher
from rect.recording import RecordedEvent, RecordedMessage, RecordedRequest, Recorder, Recording
from rect.registry import Connection, Connections, LinkLane, LinkPath, Peer
from rect.reply import Gathered, Outcome, Reply
from rect.request import Replies
from rect.robot import Robot, connect
from rect.service import Refusal, Request, Service
from rect.session import Session as _Session
from rect.stop import FleetStop, Stop
from rect.stream import Frame, StreamSender, Watcher
from rect.subscriber import SenderCounts, Subscriber, Subscription
from rect.transfer import OutgoingTransfer, Progress, Received, Transfers
from rect.values import Cbor, Payload, Picture

__all__ = [
    "Action",
    "ActionError",
    "ActionRun",
    "Alert",
    "Bool",
    "Cancelled",
    "Cbor",
    "Choice",
    "Closed",
    "Codec",
    "CodecError",
    "Confirmation",
    "Connection",
    "ConnectionState",
    "Connections",
    "Counters",
    "Deadman",
    "Dictionary",
    "DictionaryError",
    "Event",
    "EventKind",
    "Events",
    "Feedback",
    "FileError",
    "FleetStop",
    "Frame",
    "Gathered",
    "Goal",
    "GroupOptions",
    "Integer",
    "Interrupted",
    "InvalidNameError",
    "InvalidTopicError",
    "KnownGoal",
    "Level",
    "LinkLane",
    "LinkPath",
    "LogHandler",
    "LogLine",
    "LoginRefused",
    "Logs",
    "LossyFormat",
    "Message",
    "MismatchError",
    "NoAction",
    "NoGoal",
    "NoParameters",
    "NoRouter",
    "NoService",
    "NotReachable",
    "NotRetained",
    "NotStored",
    "Number",
    "Numbers",
    "OptionError",
    "Outcome",
    "OutgoingTransfer",
    "Parameter",
    "ParameterChange",
    "ParameterError",
    "ParameterGroup",
    "Payload",
    "PayloadError",
    "Peer",
    "Phase",
    "Picture",
    "PixelFormat",
    "Program",
    "Progress",
    "Publisher",
    "Received",
    "RecordedEvent",
    "RecordedMessage",
    "RecordedRequest",
    "Recorder",
    "Recording",
    "RecordingError",
    "RectError",
    "Refusal",
    "Replies",
    "Reply",
    "Request",
    "Retained",
    "Robot",
    "SenderCounts",
    "Service",
    "ServiceEntry",
    "ServiceError",
    "ServiceRefused",
    "Stop",
    "StreamMode",
    "StreamSender",
    "Subscriber",
    "Subscription",
    "Text",
    "ThreadError",
    "TimedOut",
    "TransferError",
    "TransferFailed",
    "TransferRefused",
    "Transfers",
    "Urgency",
    "Watcher",
    "WhenBusy",
    "WhenFull",
    "WrongRobot",
    "ZenohError",
    "__version__",
    "connect",
]

_complete_annotations({"Phase": Phase, "Robot": Robot, "Session": _Session, "_rect": _rect})
