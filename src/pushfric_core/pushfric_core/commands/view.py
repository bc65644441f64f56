"""The command `view`."""

import html
import http
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Annotated
from urllib.parse import urlsplit

import typer

from pushfric_core.cell.node_settings import VIEW_PORT, is_loopback
from pushfric_core.commands.application import Application
from pushfric_core.commands.console import say, warn
from pushfric_core.commands.options import CellOption, Input, ObjectOption, PartialFlag
from pushfric_core.errors import InvalidInput

READING = """<!doctype html><html lang="en"><meta charset="utf-8"><meta http-equiv="refresh" content="1"><title>pushfric</title>
<p role="status">Reading {} …</p></html>"""
"""Shown until the page of the run is made, which takes a minute for 10 000 observations."""

app = Application()


@app.command()
def view(
    source: Input,
    port: Annotated[int, typer.Option(help="Port on this machine.", min=0, max=65535)] = VIEW_PORT,
    object_name: ObjectOption = "",
    partial: PartialFlag = False,
    namespace: CellOption = None,
) -> None:
    """Needs no node graph. Ctrl-C ends it; other machines can be given the file that report writes."""
    page = READING.format(html.escape(str(source))).encode()

    class PageHandler(BaseHTTPRequestHandler):
        """Answers every address with the page, if it is asked by a name of this machine: others may lead here, too."""

        def do_GET(self) -> None:
            allowed = is_loopback(urlsplit(f"//{self.headers.get('Host', '')}").hostname or "")
            self.send_response(http.HTTPStatus.OK if allowed else http.HTTPStatus.FORBIDDEN)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            if allowed:
                self.wfile.write(page)

        def log_message(self, *_: object) -> None:
            """Not to the operator."""

    try:
        server = HTTPServer(("127.0.0.1", port), PageHandler)
    except OSError as error:
        raise InvalidInput(f"--port {port}: {error.strerror}; choose another, or 0 for any") from error
    serving = threading.Thread(target=server.serve_forever, daemon=True)
    serving.start()
    say(f"view: http://127.0.0.1:{server.server_port}/ (Ctrl-C ends it)")
    from pushfric_core.offline.estimation import Choices, estimate_from  # imported late: a page is shown before
    from pushfric_core.offline.run_page import run_page

    estimation = estimate_from(source, Choices(object_name, partial=partial, namespace=namespace), warn, whole_course=True)
    page = run_page(estimation, namespace=namespace).encode()
    serving.join()
