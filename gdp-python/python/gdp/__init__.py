"""The Global Data Plane: publish, subscribe, serve and call names, with asyncio.

    async with gdp.open() as session:
        async for sample in session.subscribe("/chatter"):
            print(sample.payload)

`gdp.open()` uses the keyring and the switch that `gdp-ctl topic` uses: GDP_KEYRING and GDP_SWITCH,
or what `gdp-ctl join` wrote. `gdp.blocking` has the same without asyncio.
"""

from ._gdp import (
    Call,
    ConfigError,
    GdpError,
    LinkError,
    MessageError,
    NoReplyError,
    NotFoundError,
    RightsError,
    Sample,
)
from ._session import (
    Client,
    Publisher,
    RosMessage,
    RosPublisher,
    RosSubscriber,
    Server,
    Session,
    Subscriber,
    open,
)

__all__ = [
    "Call",
    "Client",
    "ConfigError",
    "GdpError",
    "LinkError",
    "MessageError",
    "NoReplyError",
    "NotFoundError",
    "Publisher",
    "RightsError",
    "RosMessage",
    "RosPublisher",
    "RosSubscriber",
    "Sample",
    "Server",
    "Session",
    "Subscriber",
    "open",
]
