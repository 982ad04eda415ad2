"""Opens and completes the session of a robot."""

from __future__ import annotations

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
                _rect.check_router(session.key_space, options.endpoint, tokens_of_router(session.zenoh))
            session.links = follow_links(session)
    except BaseException:
        session.close()
        raise
    return session
