"""Services whose answers take long: requests are taken as they come, and worked on in turns, a slice at a time.

So a short request is answered soon, however long the others are, and the node's timers go on. A request whose time is over is
refused; once a service has no clients left, its requests are dropped. rclpy answers one request after another, and does
not say which client a request is from.

ROS 2 sends each answer to all clients of a service. So each client that asks for a service below one of these, by any name of
its own, gets one.
"""

import math
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator
from functools import partial
from typing import Any, NamedTuple

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.service import Service

from pushfric_core.errors import PushfricError
from pushfric_ros.node_kit.qos import REQUESTS
from pushfric_ros.node_kit.timers import wall_timer

TURN = 0.02
"""The executor gets its turn after this long, and one slice [s]."""

PATIENCE = 1.0
"""Whether a service still has clients is asked when a request is this old, and this often of one's own services [s]: a new
client may not be known yet, and to ask takes long."""

SHARE = 10
"""This many clients may share a service: one with one open call, and rclpy's queue, loses no answer among those to others."""

LOOK = 0.1
"""New clients, and those that have gone, are looked for this often [s]."""

Begin = Callable[[Any], tuple["Answer", "Refuse"]]
"""Begins the work for a request, in which a ValueError or PushfricError says why it fails."""

Answer = Generator[None, None, Any]
"""The work for a request: it pauses after each slice, and returns the response."""

Refuse = Callable[[str], Any]
"""Makes the response to a request that failed; called with the reason."""


class Turns:
    """The services of a node that are worked on in turns.

    Args:
        node: the node.
        longest: the work for a request ends after this long [s].
    Attributes:
        answered: number of requests that were answered.
        refused: number of those that failed.
        dropped: number of requests without an answer, as no client was left, or could be reached in time.
    """

    def __init__(self, node: Node, longest: float) -> None:
        self._node, self._longest = node, longest
        self.answered = self.refused = self.dropped = 0
        self._offered: dict[str, tuple[Any, Begin]] = {}  # types of the services, by name
        self._begin: dict[Service, Begin] = {}
        self._own: dict[str, tuple[Service, float]] = {}  # of single clients, and when these were last there [s], by name
        self._calls: deque[_Call] = deque()
        self._unreached: list[tuple[float, _Call]] = []  # whose client could not be reached, and when to try again [s]
        self._more = node.create_guard_condition(self._work)
        wall_timer(node, LOOK, self._look)

    @property
    def waiting(self) -> int:
        """Number of requests that have no answer yet."""
        return len(self._calls) + len(self._unreached)

    def serve(self, kind: Any, name: str, begin: Begin) -> None:
        """Offer a service, whose requests have a `deadline`, and one to each client that asks for one below it."""
        name = self._node.resolve_service_name(name)
        self._offered[name] = kind, begin
        self._serve(kind, name, begin)

    def _serve(self, kind: Any, name: str, begin: Begin) -> Service:
        service = self._node.create_service(kind, name, lambda request, _: request, qos_profile=REQUESTS)
        # the executor hands over the request, which the callback returns, with the header that says who asked
        service.send_response = partial(self._receive, service)  # type: ignore[method-assign]
        self._begin[service] = begin
        return service

    def _look(self) -> None:
        """Serve the clients that have come with a name of their own, and no longer those that have gone."""
        now = time.monotonic()
        for name, _ in self._node.get_service_names_and_types():
            service, seen = self._own.get(name, (None, -math.inf))
            offered = self._offered.get(name.rpartition("/")[0])
            if offered and now - seen > PATIENCE and self._node.count_clients(name):
                kind, begin = offered
                self._own[name] = service or self._serve(kind, name, begin), now
        for name, (service, seen) in list(self._own.items()):
            if now - seen > 2 * PATIENCE:  # a client that is there may be missed for a moment
                del self._own[name], self._begin[service]
                self._node.destroy_service(service)
        self._calls.extend(call for due, call in self._unreached if now >= due)
        self._unreached = [(due, call) for due, call in self._unreached if now < due]
        self._more.trigger()

    def _work(self) -> None:
        begin = time.monotonic()
        while self._calls and time.monotonic() - begin < TURN:
            call = self._calls.popleft()
            age = time.monotonic() - call.came
            gone = call.service not in self._begin or (call.response is not None and not age <= call.allowed)
            if gone or (age > PATIENCE and not self._node.count_clients(call.service.service_name)):
                self.dropped += 1
                continue
            if call.response is None:
                call = call._replace(response=self._slice(call))
            if call.response is None:
                self._calls.append(call)
            elif self._respond(call):  # each try may hold up the others
                self._unreached.append((call.came + 2 * (time.monotonic() - call.came), call))
        if self._calls:
            self._more.trigger()

    def _slice(self, call: "_Call") -> Any:
        """Work a little; return the response, or None if the work goes on."""
        try:
            if not time.monotonic() <= call.came + call.allowed:  # nor if it is not a number
                raise ValueError(f"no answer within {call.allowed:g} s")
            if call.clients > SHARE:
                name = call.service.service_name
                raise ValueError(f"more than {SHARE} clients share {name}, and lose answers: each must ask {name}/ITS_OWN_NAME")
            next(call.answer)
        except StopIteration as end:
            return end.value
        except (ValueError, PushfricError) as error:
            self.refused += 1
            return call.refuse(str(error))
        return None

    def _respond(self, call: "_Call") -> bool:
        """Answer; return whether to try again, as the middleware may not know yet how to reach a client."""
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            try:
                Service.send_response(call.service, call.response, call.header)
            except rclpy_implementation.RCLError:
                return self._node.context.ok()
        self.answered += not warned
        return bool(warned)

    def _receive(self, service: Service, request: Any, header: Any) -> None:
        """Take a request, and all that wait behind it."""
        self._take(service, request, header)
        with service.handle:
            while (taken := service.handle.service_take_request(service.srv_type.Request))[1] is not None:
                self._take(service, *taken)
        self._more.trigger()

    def _take(self, service: Service, request: Any, header: Any) -> None:
        waited = (time.time_ns() - header.received_timestamp) / 1e9 if header.received_timestamp else 0.0
        allowed = min(request.deadline, self._longest) if request.deadline else self._longest
        came = time.monotonic() - max(waited, 0.0)
        clients = self._node.count_clients(service.service_name)
        self._calls.append(_Call(service, header, came, allowed, clients, *self._begin[service](request)))


class _Call(NamedTuple):
    """A request that is worked on."""

    service: Service
    header: Any  # says who asked
    came: float  # by time.monotonic() [s]
    allowed: float  # how long the work may take [s]
    clients: int  # of the service
    answer: Answer
    refuse: Refuse
    response: Any = None  # that could not be sent yet
