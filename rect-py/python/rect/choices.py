"""Defines the types of the strings that stand for a choice.

Each type is a `Literal`: an editor offers its values, and a type checker reports any other value.
"""

from typing import Literal

Urgency = Literal["urgent", "normal", "bulk"]
"""The urgency of a message: `urgent` messages overtake all others, and `bulk` messages are overtaken by all others."""

WhenFull = Literal["drop_oldest", "drop_newest", "block"]
"""The rule for a full receive queue: `drop_oldest` drops the item that has waited longest, `drop_newest` drops the item
that arrived last, and `block` makes the sender wait (backpressure)."""

StreamMode = Literal["adaptive", "video", "fixed", "sensor"]
"""The mode of a stream: `adaptive` adjusts the size, quality and rate of pictures to the link, `video` sends pictures
as video, `fixed` sends frames unchanged up to a maximum rate, and `sensor` sends every value."""

LossyFormat = Literal["jpeg", "webp"]
"""The lossy format of an adaptive stream's pictures. WebP pictures are smaller and take longer to encode."""

PixelFormat = Literal["grey8", "rgb8", "rgba8"]
"""The channels of a picture's pixels, one byte each."""

Level = Literal["debug", "info", "warn", "error"]
"""How important a line of a log, or an alert, is: `debug` helps to find a fault in the program, `info` reports
normal events, `warn` is something that somebody should look at, and `error` is something that has failed."""

EventKind = Literal[
    "peer_up",
    "peer_down",
    "program_up",
    "program_down",
    "link_up",
    "link_down",
    "link_silent",
    "link_resumed",
    "path_switched",
    "router_up",
    "router_down",
]
"""The kind of an `Event`:

- `peer_up`, `peer_down`: a robot of the fleet became reachable, or is no longer reachable;
- `program_up`, `program_down`: a named program of a robot is known, or has ended or is no longer reachable;
- `link_up`, `link_down`: a link of this robot's router was opened or closed, or, without a router, a link of this
  program. A second `link_up` for the same link names the robot, if the robot was unknown at first;
- `link_silent`, `link_resumed`: nothing has been received over a link for longer than usual, or something again;
- `path_switched`: another path carries the bulk of a link whose method is `any`;
- `router_up`, `router_down`: this program connected to its router, or lost the connection.
"""

ConnectionState = Literal["connected", "connecting", "discovered"]
"""The state of a `Connection`: `connected` has a link, `connecting` is configured and has no link yet, and `discovered`
is a robot whose advertisement was received and to which there is no link."""

Confirmation = Literal["confirmed", "waiting", "ended"]
"""How far a robot has followed a stop of the fleet, or its release: `confirmed` knows all stops and releases that this
program knows, `waiting` takes part and has not confirmed, and `ended` is a robot whose program that took part has
ended."""

Phase = Literal["waiting", "running", "cancelling", "done", "refused", "failed", "cancelled", "preempted", "lost"]
"""How far a goal of an action has come:

- `waiting` for the end of another goal, `running`, or `cancelling`: still running, and asked to end;
- `done`: carried out;
- `refused`: not accepted, so that it never began;
- `failed`: the handler has raised an exception;
- `cancelled`: somebody has cancelled it, its client has ended, or the fleet is stopped;
- `preempted`: a newer goal has taken its place;
- `lost`: the program that carried it out has ended, so that nobody knows how far it came.
"""

WhenBusy = Literal["preempt", "refuse"]
"""The rule for a new goal while another one runs: `preempt` asks the other one to end and begins the new one then,
and `refuse` does not accept the new one."""
