"""The executor of the nodes calls all that is ready, in the middleware as it is."""

import pytest
from calls import wait_until
from rclpy.clock import Clock, ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import Trigger

from pushfric_msgs.srv import StablePushes
from pushfric_ros.node_kit.executor import NodeExecutor
from pushfric_ros.node_kit.qos import RELIABLE
from pushfric_ros.node_kit.turns import Turns

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
AT_ONCE = 1e-9  # period of a timer that is always due [s]


class Spun:
    """A node, and the executor that spins it in the test's own thread."""

    def __init__(self) -> None:
        self.node, self.executor = Node("spun"), NodeExecutor()
        self.executor.add_node(self.node)

    def until(self, done, what: str) -> None:
        wait_until(lambda: done() or self.executor.spin_once(timeout_sec=0.1), what, 60.0)

    def timer(self, callback, period: float = AT_ONCE):
        return self.node.create_timer(period, callback, clock=STEADY)


@pytest.fixture
def spun(ros):
    spun = Spun()
    yield spun
    spun.executor.remove_node(spun.node)
    spun.node.destroy_node()
    spun.executor.shutdown()


def test_it_calls_whatever_is_ready(ros, spun):
    called = set()

    def answer(_, response):
        called.add("service")
        return response

    peer = ros.node("peer")
    spun.timer(lambda: called.add("timer"))
    spun.node.create_subscription(String, "said", lambda msg: called.add(msg.data), RELIABLE)
    spun.node.create_service(Trigger, "asked", answer)
    spun.node.create_guard_condition(lambda: called.add("guard")).trigger()
    peer.create_service(Trigger, "asked_back", lambda _, response: response)
    asked_back = spun.node.create_client(Trigger, "asked_back")
    out, asked = peer.create_publisher(String, "said", RELIABLE), peer.create_client(Trigger, "asked")
    ready = (out.get_subscription_count, asked.service_is_ready, asked_back.service_is_ready)
    spun.until(lambda: all(one() for one in ready), "they find each other")
    out.publish(String(data="subscription"))
    asked.call_async(Trigger.Request())
    asked_back.call_async(Trigger.Request()).add_done_callback(lambda _: called.add("client"))
    spun.until(lambda: called == {"timer", "subscription", "service", "guard", "client"}, "all are called")


def test_a_service_that_is_worked_on_in_turns_takes_what_came_meanwhile(ros, spun):
    turns = Turns(spun.node, 10.0)
    late = []

    def begin(_):
        if not late:
            late.append(asked.call_async(StablePushes.Request()))
            assert _has_come(spun.node)
        return iter_to(StablePushes.Response()), None

    turns.serve(StablePushes, "asked", begin)
    asked = ros.node("peer").create_client(StablePushes, "asked")
    ros.wait_for(asked.service_is_ready, what="the service")
    first = asked.call_async(StablePushes.Request())
    spun.until(lambda: first.done() and late and late[0].done(), "the answers")
    assert turns.answered == 2


def iter_to(response):
    """Work of no slices."""
    return response
    yield


def _has_come(node: Node) -> bool:
    """Wait until a request waits to be taken."""
    (service,) = [one for one in node.services if one.srv_type is StablePushes]
    waiting = rclpy_implementation.WaitSet(0, 0, 0, 0, 1, 0, node.context.handle)
    waiting.clear_entities()
    waiting.add_service(service.handle)
    waiting.wait(int(60e9))
    return bool(waiting.get_ready_entities("service"))


def test_a_callback_that_waits_holds_up_no_other(spun):
    came, reached = Future(), []

    async def wait():
        waiting.cancel()
        reached.append("waits")
        reached.append(await came)

    waiting = spun.timer(wait)
    spun.until(lambda: reached, "it waits")
    other = spun.timer(lambda: came.set_result("goes on"))
    spun.until(lambda: len(reached) == 2, "it goes on")
    other.cancel()
    assert reached == ["waits", "goes on"]


def test_a_timer_that_another_callback_cancels_is_not_called(spun):
    called = []
    first = spun.timer(lambda: (called.append("first"), second.cancel()))
    second = spun.timer(lambda: called.append("second"))
    spun.until(lambda: called, "the first is called")
    first.cancel()
    spun.executor.spin_once(timeout_sec=0.0)
    assert called == ["first"]


def test_it_sees_what_is_made_and_destroyed_meanwhile(spun):
    called = []

    def replace():
        called.append("old")
        spun.node.destroy_timer(old)
        spun.timer(lambda: called.append("new"))

    old = spun.timer(replace)
    spun.until(lambda: "new" in called, "the new one is called")
    assert called.count("old") == 1


def test_what_a_callback_raises_comes_out(spun):
    def fail():
        raise RuntimeError("it failed")

    async def fail_later():
        fail()

    for one in (fail, fail_later):
        timer = spun.timer(one)
        with pytest.raises(RuntimeError, match="it failed"):
            spun.until(lambda: False, "it fails")
        spun.node.destroy_timer(timer)


def test_a_client_that_cannot_be_answered_ends_no_node(ros, spun, monkeypatch):
    service = spun.node.create_service(Trigger, "asked", lambda _, response: response)
    client, answer = ros.node("peer").create_client(Trigger, "asked"), service.send_response

    def unknown(*_):
        monkeypatch.setattr(service, "send_response", answer)
        raise rclpy_implementation.RCLError("failed to send response (timeout): client will not receive response")

    monkeypatch.setattr(service, "send_response", unknown)
    spun.until(client.service_is_ready, "they find each other")
    client.call_async(Trigger.Request())
    spun.until(lambda: service.send_response == answer, "the call")
    again = client.call_async(Trigger.Request())
    spun.until(again.done, "the answer to another call")
