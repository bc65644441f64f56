"""The stage that tests of the actuator push with, patient with a busy machine."""

STAGE = {
    "line_origin": [0.0, 0.0],
    "line_direction": [0.0, 1.0],
    "tip_radius": 0.003,
    "stroke": 0.06,
    "max_speed": 0.1,
    "silence": 5.0,  # for a busy machine
    "owner_timeout": 5.0,
    "memory": "",
}
