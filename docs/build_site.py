"""The documentation as a site: the pages of this folder, and those that follow from the project itself.

`./pushfric docs` builds it. Every warning is an error; nothing in the site is loaded from elsewhere.
"""

import argparse
import inspect
import itertools
import logging
import os
import pathlib
import re
import shutil
import sys
import tempfile
from typing import Any

from docutils.nodes import SkipNode, math, math_block
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))  # started as `python docs/build_site.py`, from any folder

import pushfric_core
from docs.markdown import table
from pushfric_core.commands.cli import catalog, load
from pushfric_core.commands.program import run, undoing

ROOT = pathlib.Path(__file__).resolve().parents[1]

CONFIGURATION: dict[str, Any] = {
    "project": "pushfric",
    "author": "the pushfric authors",
    "release": pushfric_core.__version__,
    "extensions": ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "docs.build_site"],
    "exclude_patterns": ["bags"],
    "myst_heading_anchors": 4,
    "myst_enable_extensions": ["dollarmath"],
    "html_math_renderer": "mathml",
    "nb_execution_mode": "force",
    "nb_execution_raise_on_error": True,
    "nb_execution_show_tb": True,
    "html_theme": "furo",
    "html_title": "pushfric",
    "html_show_copyright": False,
    "autodoc_member_order": "bysource",
    "autodoc_typehints": "description",
    "autodoc_class_signature": "mixed",
    "python_use_unqualified_type_names": True,
    "add_module_names": False,
    "smartquotes": False,
    "autodoc_typehints_description_target": "documented",
    "html_static_path": ["site.css", "copy.js"],
    "html_css_files": ["site.css"],
    "html_js_files": ["copy.js"],
}


def setup(app: Sphinx) -> None:
    """This module is one of the extensions."""
    app.connect("autodoc-process-docstring", plain_docstring)
    app.connect("autodoc-skip-member", without_fields)
    app.add_html_math_renderer("mathml", (mathml, None), (mathml, None))


PARTS = {
    "Learn": ("tutorial", "install", "data_to_verdict", "glossary"),
    "Operate": ("hardware", "calibrate", "cell", "safety", "security", "view", "graph", "interfaces", "reliability"),
    "Research": ("estimation", "derivation", "pushes", "public_data", "paper", "files", "many"),
    "Plan": ("planning", "limit_surface", "conventions"),
    "Reference": ("commands", "python"),
    "Project": ("architecture", "contributing"),
}
"""The parts of the site and their pages; those of this folder, and those made here."""


def front_page() -> str:
    """The page with the film and the three doors, and the tables of contents."""
    contents = [
        f"\n```{{toctree}}\n:caption: {part}\n:hidden:\n\n{chr(10).join(pages)}\n```\n" for part, pages in PARTS.items()
    ]
    return (ROOT / "docs/index.md").read_text(encoding="utf-8") + "".join(contents)


def contributing() -> str:
    """The page from the folder above, with links as they are from this one."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    return text.replace("](docs/", "](").replace("](CONTRIBUTING.md)", "](contributing.md)")


def commands() -> str:
    """Each command with its arguments and options."""
    return "\n".join(["# Command line\n", *(line for name in catalog() for line in section(f"pushfric {name}", load(name)))])


def section(name: str, command: Any) -> list[str]:
    """A command, or a group of commands, one after the other."""
    rows = [(f"`{' / '.join((*one.opts, *one.secondary_opts))}`", described(one)) for one in command.params]
    options = [table(("argument or option", "what"), rows)] if rows else []
    inner = getattr(command, "commands", {}).values()
    return [
        f"## {name}\n",
        f"{command.help}\n",
        *options,
        *(line for one in inner for line in section(f"{name} {one.name}", one)),
    ]


def described(option: Any) -> str:
    """The help of an argument or option, and its default."""
    shown = option.show_default if isinstance(option.show_default, str) else option.default if option.show_default else None
    default = "" if shown in (None, "", False, ()) or callable(shown) else f" Default: `{shown}`."
    return (option.help or "").replace("\\[", "[") + default


def python_names() -> str:
    """Each public name of pushfric_core, by module."""
    homes = pushfric_core._HOMES
    lines = ["# Python", "", "Every name is imported as in `from pushfric_core import Estimator`."]
    for module, names in itertools.groupby(sorted(homes, key=homes.__getitem__), homes.__getitem__):
        lines += ["", f"## {module.removeprefix('pushfric_core.')}", "", "```{eval-rst}"]
        for name in names:
            value = getattr(pushfric_core, name)
            kind = "autoclass" if inspect.isclass(value) else "autofunction" if callable(value) else "autodata"
            lines += [f".. {kind}:: {module}.{name}", *(["   :members:"] if kind == "autoclass" else []), ""]
        lines.append("```")
    return "\n".join(lines)


def plain_docstring(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Write a docstring, which is plain text with `code`, as the parser wants it; add the comments that describe fields."""
    pieces = re.split(r"(`[^`]*`|^ *>>>.*(?:\n.+)*)", "\n".join(lines), flags=re.MULTILINE)
    lines[:] = "".join(as_markup(one) for one in pieces).split("\n")
    if what == "class":
        commented = re.findall(r"^    (\w+): [^#\n]*?(?:  # (.*))$", inspect.getsource(obj), re.MULTILINE)
        for field, comment in commented:
            lines += [f"* ``{field}``: " + re.sub(r"([*|\\`])", r"\\\1", comment), ""]


def as_markup(piece: str) -> str:
    """`code` between double backticks; examples as they are; other text with the marks of the markup escaped."""
    if piece.startswith("`"):
        return f"`{piece}`"
    return piece if piece.lstrip().startswith(">>>") else re.sub(r"([*|\\])", r"\\\1", piece)


def without_fields(app: Sphinx, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """Leave out what a named tuple says of its fields by itself."""
    return True if (inspect.getdoc(obj) or "").startswith("Alias for field number") else None


def mathml(translator: HTML5Translator, node: math | math_block) -> None:
    """Write a formula as MathML, which browsers draw by themselves."""
    translator.body.append(convert(node.astext(), display="block" if isinstance(node, math_block) else "inline"))
    raise SkipNode


LINK = re.compile(r"\[([^\]]*)\]\(([^)]*)\)")
"""A link: its text and its target."""


def on_the_site(target: str, folder: pathlib.Path) -> bool:
    """Whether a link's target is an address, a heading, or a file among the sources of the site."""
    file, _, heading = target.partition("#")
    return "://" in target or bool(heading and not file) or (".." not in file and (folder / file).is_file())


def write_sources(folder: pathlib.Path) -> None:
    """All pages of the site, and what they show."""
    shutil.copytree(
        ROOT / "docs", folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("*.py", "requirements.txt", "api.md")
    )
    (folder / "bags").symlink_to(ROOT / "bags")  # the notebooks read one
    made = {"index": front_page(), "commands": commands(), "python": python_names(), "contributing": contributing()}
    for page, text in made.items():
        (folder / f"{page}.md").write_text(text, encoding="utf-8")
    for page in folder.glob("*.md"):
        text = page.read_text(encoding="utf-8").replace("](api.md)", "](python.md)").replace("```csv", "```text")
        # sources, folders, and other files of the project are not part of the site: a link to one becomes its text
        page.write_text(LINK.sub(lambda link: link[0] if on_the_site(link[2], folder) else link[1], text), encoding="utf-8")


def quiet_kernel(folder: pathlib.Path) -> None:
    """Let the notebooks' kernel keep its files here, and say nothing but errors."""
    profile = folder / "profile_default"
    profile.mkdir(parents=True)
    (profile / "ipython_kernel_config.py").write_text("c.IPKernelApp.log_level = 40\n", encoding="utf-8")
    os.environ["IPYTHONDIR"] = os.environ["JUPYTER_RUNTIME_DIR"] = str(folder)
    logging.getLogger("traitlets").setLevel(logging.WARNING)


def main() -> int:
    parser = argparse.ArgumentParser(prog="./pushfric docs", description="Build the documentation as a site.")
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "site", help="folder of the site (default: site/)")
    out = parser.parse_args().out
    with tempfile.TemporaryDirectory() as folder:
        sources = pathlib.Path(folder) / "sources"
        write_sources(sources)
        quiet_kernel(pathlib.Path(folder) / "ipython")
        site = Sphinx(sources, None, out, f"{folder}/doctrees", "html", CONFIGURATION, status=None, warningiserror=True)
        site.build()
    if site.statuscode == 0:
        print(f"site: {out / 'index.html'}")
    return site.statuscode


if __name__ == "__main__":
    run(undoing(main))
