"""A visitor of the live view: reads what a page at the given address is sent, until the run ends, in a process of its own."""

import sys

from tornado.ioloop import IOLoop
from tornado.websocket import websocket_connect


async def look(url: str) -> None:
    """Read all that comes."""
    socket = await websocket_connect(f"{url.replace('http', 'ws', 1)}live")
    while await socket.read_message() is not None:
        pass


if __name__ == "__main__":
    IOLoop.current().run_sync(lambda: look(sys.argv[1]))
