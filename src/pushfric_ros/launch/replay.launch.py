"""A bag played into a live estimator."""

import pathlib

from pushfric_ros.bags import data_points
from pushfric_ros.graph import graph
from pushfric_ros.graph.launch import launch_description

ARGUMENTS = {
    "bag": (None, "path of the bag"),
    "object": ("", "name of an object of Table 1, or path of an object YAML; empty: the bag's own object.yaml"),
    "rate": ("1.0", "multiple of the recorded speed"),
}


def replay(values, _):
    bag = pathlib.Path(values["bag"])
    settings = data_points.recorded_settings(bag)
    source = data_points.source_of(bag, settings.with_forces)
    object_name = values["object"] or str(data_points.object_beside(bag))
    return source.namespace, graph.replay(str(bag), object_name, source, float(values["rate"]), settings)


def generate_launch_description():
    return launch_description(ARGUMENTS, replay)
