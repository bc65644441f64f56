"""The commands `reproduce` and `study`, which `./pushfric` starts as `python bench/paper reproduce`."""

import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2]))  # started as `python bench/paper`, from any folder

from bench.paper.reproduce import reproduce
from bench.paper.study import study
from bench.program import start
from pushfric_core.commands.application import Application

app = Application(pretty_exceptions_enable=False)
app.command()(reproduce)
app.command()(study)

if __name__ == "__main__":
    start(app, "./pushfric")
