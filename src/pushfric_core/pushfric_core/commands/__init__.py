"""The command line: a module for each command or a few of a kind, loaded when one is called."""

SECTIONS = {
    "Estimates and bags": {
        "estimate": "Estimate from a bag or a CSV, as fast as possible.",
        "report": "Write the result of a run as one HTML page to hand on, with tested predictions and downloads.",
        "view": "Look through a run in a browser, moment by moment: from its bag, without a node graph.",
        "recognize": "Rank the hypotheses in the object's file by how well they explain the data (section 5.2).",
        "bag": "Check and recover bags.",
    },
    "Planning": {
        "predict": "Predict where pushes with a point take the object: its twist, whether the tip sticks or slides,"
        " the spread.",
        "stable": "Say which pushes with an edge or two fingers hold the object while they turn it about a centre.",
        "export": "Write a model for a simulator or a planner: MJCF, SDF or JSON.",
        "region": "Say where p_CF can lie, without support points (section 6.2), and which pushes would narrow it down.",
    },
    "Camera": {
        "calibrate": "Calibrate the camera: print a board, then calibrate the lens, then the table; and find the pusher's tip.",
        "edit": "Find an object's outline in a picture or a scan; correct it, and draw its support points, in a browser.",
        "track": "Track the object in the images of a bag again, and say how the poses differ from the recorded ones.",
    },
    "Installation": {},
}
"""The sections of the list of commands: each command's name and the first paragraph of its help; its function's docstring
adds to that."""

COMMANDS = {name: text for section in SECTIONS.values() for name, text in section.items()}

MODULES = {"predict": "planning", "stable": "planning", "export": "planning", "report": "view"}
"""Modules of the commands whose name is not that of a module."""
