"""The command `import`, which `./pushfric` starts as `python bench/public`."""

import pathlib
import sys
import tempfile
from typing import Annotated

import typer

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2]))  # started as `python bench/public`, from any folder

from bench.program import start
from bench.public import cpush, mitpush, stablepush, zhou2015
from pushfric_core import InvalidInput
from pushfric_core.commands.application import Application
from pushfric_core.commands.console import say, warn
from pushfric_core.files.disk import make_folder
from pushfric_core.wording import counted

app = Application(pretty_exceptions_enable=False)

DATA_SETS = {one.NAME: one for one in (zhou2015, stablepush, mitpush, cpush)}


SOURCES = """Part of the data set: for zhou2015 a log or push_points.csv, for stablepush stable_pushes.csv, for mitpush a clone
of PlanarManipulationToolBox, for cpush the files of one or more runs."""
OUT = "Folder to write: the bag, or a bag for each of several logs or objects; for mitpush and cpush, CSV files."


@app.command()
def import_(
    dataset: Annotated[str, typer.Argument(help=f"Name of the public data set: {', '.join(DATA_SETS)}.", show_default=False)],
    sources: Annotated[list[pathlib.Path], typer.Argument(help=SOURCES, show_default=False)],
    out: Annotated[pathlib.Path, typer.Option(help=OUT, show_default=False)],
) -> None:
    """Turn a public data set of real pushes into bags of observations, each with its object.yaml."""
    if dataset not in DATA_SETS:
        raise InvalidInput(f"unknown data set {dataset!r}; expected {' or '.join(DATA_SETS)}")
    if len(sources) > 1 and dataset != cpush.NAME:
        raise InvalidInput(f"{sources[1]}: only {cpush.NAME} takes more than one source")
    if out.exists():
        raise InvalidInput(f"{out}: exists already; expected the name of a folder to make")
    make_folder(out.parent)
    with tempfile.TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as around:  # vanishes if something fails
        draft = pathlib.Path(around, out.name)  # the files of a bag are named after its folder
        imported = DATA_SETS[dataset].import_pushes(sources if dataset == cpush.NAME else sources[0], draft)
        left_out = [one for one in imported if isinstance(one, InvalidInput)]
        if len(left_out) == len(imported):
            raise left_out[0]
        draft.rename(out)
    for one in imported:
        if isinstance(one, InvalidInput):
            warn(f"left out: {one}")
        else:
            say(f"{out / one.path.relative_to(draft)}: {counted(one.observations, 'observation')} of {one.object}")
    if left_out:
        warn(f"{counted(len(left_out), 'part')} of the data set left out")


if __name__ == "__main__":
    start(app, "./pushfric import")
