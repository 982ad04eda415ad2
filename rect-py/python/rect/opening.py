"""Opens and completes the session of a robot."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from rect import _rect
from rect.decoder import Decoder
from rect.events import follow_links
from rect.executor import Executor
from rect.log import ProgramLog
from rect.options import Options, tokens_of_router
from rect.program import Presence, name_of_script
from rect.recipients import Recipients
from rect.session import Session
from rect.state import State

if TYPE_CHECKING:
    import zenoh


def open_session(options: Options) -> Session:
    """Opens the session of a robot. Raises the errors of `rect.connect`."""
    session = Session(options)
    try:
        session.decoder = Decoder(session)
        session.program = Presence(session, name_of_script() if options.program == "" else options.program)
        session.recipients = Recipients(session)
        session.state = State(session)
        session.log = ProgramLog(session)
        if session.is_direct:
            presence = _rect.direct_presence(session.key_space, str(session.zenoh.zid()))
            Executor(session, presence).start("rect presence")
            Executor(session, _rect.throttle(session.key_space), session.warn).start("rect throttle")
        else:
            if not options.allow_name_mismatch:
                tokens = tokens_of_router(session.zenoh)
                is_closed = not tokens and _is_closed(session.zenoh)
                _rect.check_router(session.key_space, options.endpoint, tokens, is_closed)
            session.links = follow_links(session)
    except BaseException:
        session.close()
        raise
    return session


def _is_closed(session: zenoh.Session) -> bool:
    """Returns whether the router, which has not named its robot, has closed the session."""
    for _ in range(3):
        time.sleep(0.03)
        if not session.info.routers_zid() and not session.info.peers_zid():
            return True
    return False
