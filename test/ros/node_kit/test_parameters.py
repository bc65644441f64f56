"""What others are told of a node's parameters."""

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.parameter import Parameter

from pushfric_ros.nodes.estimator import EstimatorNode


def test_every_parameter_can_be_asked_for(ros):
    """One without a value made rclpy answer with nothing at all: `ros2 param dump` printed {}."""
    ros.compose(EstimatorNode(parameter_overrides=[Parameter("object", value="wood_rect4")]))
    peer = ros.node("peer")
    clients = {kind: peer.create_client(kind, f"/estimator/{name}") for kind, name in
               ((ListParameters, "list_parameters"), (GetParameters, "get_parameters"))}  # fmt: skip
    for client in clients.values():
        assert client.wait_for_service(10.0)
    listed = clients[ListParameters].call(ListParameters.Request(), 10.0).result.names
    values = clients[GetParameters].call(GetParameters.Request(names=listed), 10.0).values
    assert {"object", "exclude_pushes", "cor_radius"} <= set(listed)
    assert len(values) == len(listed)
